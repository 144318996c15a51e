"""Compiled series and polynomials of steps, and procedures for many members, equal those of the interpreter."""

import copy
import math
import pickle
import random
import re
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings

from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.dense.collocation import collocation_polynomial
from lagrange.algorithm.dense.polynomials import hermite_polynomial, runge_kutta_polynomial
from lagrange.algorithm.series.order_by_cost import operations
from lagrange.algorithm.series.packing import Packing, pack
from lagrange.compiler import machine
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine import numpy_machine
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.machine.llvm_series import CompiledJet
from lagrange.machine.model import Model
from lagrange.machine.numpy_machine import Jet, NumpySeries
from lagrange.procedure.form import REAL, Procedure, Record
from lagrange.procedure.interpreter import run
from lagrange.procedure.lane_values import UNIFORM, VARYING
from lagrange.procedure.lanes import ACTIVE, MemberProcedures
from lagrange.program.catalogue import program_of
from lagrange.program.series import RULES, SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.trajectory.methods.implicit import collocation_tableau
from lagrange.trajectory.methods.radau import POINTS
from lagrange.trajectory.tableaux.butcher import ButcherTableau
from lagrange.trajectory.tableaux.explicit import dop853
from tests.covering import examples
from tests.laws.mechanisms import functions_of, potentials
from tests.laws.test_random_systems import kinetic_energies
from tests.models import SYSTEMS, TARGETS, build, k, m, model, stated, x, y, z
from tests.procedure.random_functions import DATA, SIZE, TABLE, bits, example
from tests.procedure.verify import verify
from tests.series_systems import HELD, LARGER, ladder
from tests.trajectory.runs import exact

LANES = (1, 2, 4, 8)
ALL = {**LARGER, **HELD}
"""The systems of all tests of kernels."""

WRITTEN_OUT = {1: 4, 2: 7, 4: 11, 8: 6}
"""The order of the code that is written out, by lanes."""

few = settings(max_examples=examples(8), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


@cache
def system(name: str) -> tuple[Statement, SeriesProgram]:
    statement = ALL[name]()
    return statement, series_program(euler_lagrange(statement))[0]


@cache
def packing(name: str, lanes: int) -> Packing:
    return pack(system(name)[1], lanes)


@cache
def compiled(name: str, lanes: int, order: int) -> CompiledJet:
    """Return a compiled series, unrolled for an order or, with order 0, in loops."""
    return CompiledJet(packing(name, lanes), order)


def parameters(statement: Statement, program: SeriesProgram, rng: Any) -> Any:
    """Return the parameters and random signs of the switching surfaces."""
    return np.array([*(statement.defaults[p] for p in statement.parameters), *rng.choice([-1.0, 1.0], program.sides)])


def near(statement: Statement, rng: Any) -> Any:
    return np.array(statement.initial) + rng.uniform(-0.1, 0.1, len(statement.initial))


def natural(program: SeriesProgram, order: int, t: float, state: Any, given: Any) -> float:
    """Return the time scale for which all coefficients are of similar size, so that an error shows at every order."""
    size = np.abs(NumpySeries(program).rows(order, t, state, 1.0, given)[-2:]).max()
    return float(2.0 ** -round(np.log2(size) / order)) if size > 0 else 1.0


def assert_same_rows(kernel: CompiledJet, order: int, t: float, state: Any, given: Any) -> None:
    """Assert equality up to the rounding of sums in another order, fused products and an inverted matrix."""
    scale = natural(kernel.program, order, t, state, given)
    ours, theirs = (f(order, t, state, scale, given) for f in (kernel.rows, NumpySeries(kernel.program).rows))
    assert ours.shape == theirs.shape == (order + 1, 2 * kernel.program.dimension + len(kernel.program.watched))
    assert (ours[0] == theirs[0])[: len(state)].all()
    top = np.maximum.accumulate(np.abs(theirs).max(axis=1))[:, None]
    assert np.isfinite(theirs).all() and (np.abs(ours - theirs) / top).max() < 1e-11


@pytest.mark.few(1)
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("name", ALL)
def test_written_out(name: str, lanes: int) -> None:
    rng = np.random.default_rng(lanes)
    statement, program = system(name)
    order = WRITTEN_OUT[lanes]
    for time in (0.3, -1.1):
        assert_same_rows(
            compiled(name, lanes, order), order, time, near(statement, rng), parameters(statement, program, rng)
        )


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("name", ALL)
def test_in_loops(name: str, lanes: int) -> None:
    """One kernel serves all orders, up to the highest allowed and beyond."""
    rng = np.random.default_rng(10 + lanes)
    statement, program = system(name)
    for order in (1, 2, 3, 8, 17, 32):
        state, given = near(statement, rng), parameters(statement, program, rng)
        assert_same_rows(compiled(name, lanes, 0), order, 0.3, state, given)


@pytest.mark.slow
def test_every_rule_is_compiled() -> None:
    assert {rule.op for name in ALL for rule in system(name)[1].rules} == set(RULES)


# --- memory, bits, scales -------------------------------------------------------------------------------------

KERNELS = [(name, order) for name in ALL for order in (WRITTEN_OUT[8], 0)]


@pytest.mark.few
@pytest.mark.parametrize(("name", "order"), KERNELS)
def test_the_same_bits_twice_from_any_memory_and_on_every_scale(name: str, order: int) -> None:
    """A scale that is a power of two changes exponents only, so x[k] scale**k has the same digits."""
    rng = np.random.default_rng(4)
    statement, program = system(name)
    kernel, target = compiled(name, 8, order), order or 9
    state, given = near(statement, rng), parameters(statement, program, rng)
    first = kernel.rows(target, 0.3, state, 1.0, given)
    kernel.rows(target, 0.9, state + 0.05, 0.125, given)
    assert np.isfinite(first).all() and (kernel.rows(target, 0.3, state, 1.0, given) == first).all()
    work, padded = np.full(kernel.layout.size(target), np.nan), np.zeros(2 * kernel.layout.padded)
    padded[: len(state)] = state
    assert kernel._series(0.3, 1.0, *map(address, (padded, *kernel.numbers(given), work)), target) == 0
    assert (kernel.layout.coefficients(work, target) == first).all()
    for scale in (2.0**-20, 0.25, -1.0, 2.0**9, -(2.0**-3)):
        powers = scale ** np.arange(target + 1.0)
        assert (kernel.rows(target, 0.3, state, scale, given) == first * powers[:, None]).all()


@pytest.mark.parametrize("constant", [True, False])
def test_all_machines_call_the_same_matrices_singular(constant: bool) -> None:
    """A pivot of 1e-14 is below 2**-46 of its row and counts as singular; one of 2e-14 is not."""
    small = k if constant else y**2
    statement = stated(kinetic=(x.dot + y.dot) ** 2 / 2 + small * y.dot**2 / 2, potential=x**2)
    equations = euler_lagrange(statement)
    program = series_program(equations)[0]
    series: list[Any] = [NumpySeries(program), *(CompiledJet(pack(program, 8), order) for order in (4, 0))]
    kernels = [machine(target).load(program_of("rhs", equations)) for target in TARGETS]
    for pivot, singular in ((1e-14, True), (2e-14, False)):
        given, state = np.array([pivot] * constant), np.array([0.1, np.sqrt(pivot), 0.0, 0.0])
        calls = [partial(item.rows, 4, 0.0, state, 1.0, given) for item in series]
        for call in (*calls, *(partial(kernel, 0.0, state, given) for kernel in kernels)):
            with pytest.raises(SingularMassMatrix) if singular else nullcontext():
                assert np.isfinite(call()).all()


@pytest.mark.slow
def test_the_order_of_stated_constraints_scatters_no_operands() -> None:
    """A step of a ladder of 40 loops took 1.4 times as long with its constraints shuffled: 105 and 74 us."""
    stated_ladder = ladder(12)
    held = stated_ladder.constraints
    shuffled = tuple(held[i] for i in np.random.default_rng(1).permutation(len(held)))
    sources = []
    for statement in (stated_ladder, replace(stated_ladder, constraints=shuffled)):
        program, _ = series_program(euler_lagrange(statement))
        packing = pack(program, 8)
        operands = [operand for chunk in packing.computed for operand in chunk.args]
        sources.append(sum(len({packing.place[value][0] for value in operand.values}) for operand in operands))
        given = parameters(statement, program, np.random.default_rng(0))
        assert_same_rows(CompiledJet(packing, 0), 6, 0.3, np.array(statement.initial), given)
    assert sources[0] == sources[1]


@few
@given(kinetic_energies(x, y), potentials(x, y), functions_of(x, y, x.dot, y.dot), functions_of(x, y))
@pytest.mark.slow
def test_random_systems(T: Any, V: Any, Q: Any, A: Any) -> None:
    """The systems have products in T, a potential linear in velocities, a force, and explicit time."""
    statement = stated(lagrangian=T - V + A * x.dot, forces={x: Q, y: sp.cos(t) - y.dot}, coordinates=[x, y])
    program, _ = series_program(euler_lagrange(statement))
    state = np.array([0.3, -0.4, 0.2, 0.5])
    for lanes, order in ((2, 6), (8, 0)):
        assert_same_rows(CompiledJet(pack(program, lanes), order), order or 12, 0.3, state, np.empty(0))


# --- taylor cost ----------------------------------------------------------------------------------------------
# What a series costs is counted from its vectors, and orders and forms follow: counted here from its code as well.

NAMES = ("double pendulum", "Kepler orbit", "Henon-Heiles", "elastic pendulum", "blocks")


@cache
def packed(name: str, lanes: int = 8) -> Packing:
    return pack(series_program(euler_lagrange({**LARGER, **SYSTEMS}[name]()))[0], lanes)


def written(name: str, order: int) -> int:
    """Return the number of floating-point operations in the unrolled code of a series."""
    ir = CompiledJet(packed(name), order).ir
    jet = ir[ir.index("@taylor_jet(") :]
    jet = jet[: jet.index("\n}")]
    return len(re.findall(r" f(?:add|sub|mul|div) |@llvm\.fma", jet))


@pytest.mark.parametrize("order", [8, 16])
@pytest.mark.parametrize("name", NAMES)
def test_operations_are_those_of_the_code(name: str, order: int) -> None:
    """The code has 0.82 to 1.07 of the counted operations, since order 0 shares operations with the mass matrix."""
    assert 0.75 < written(name, order) / operations(packed(name), order) < 1.15


# --- interpreted series ---------------------------------------------------------------------------------------
# What a series in Python prepares: numbers of the parameters, and matrices ready for right-hand sides.


def stated_series(name: str) -> tuple[Statement, SeriesProgram]:
    statement = SYSTEMS[name]()
    return statement, series_program(euler_lagrange(statement))[0]


def test_what_depends_on_parameters_alone_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """If an array of parameters is overwritten, its numbers are computed again."""
    made = []

    def counted(*args: Any) -> Jet:
        made.append(args)
        return Jet(*args)

    monkeypatch.setattr(numpy_machine, "Jet", counted)
    statement, program = stated_series("elastic pendulum")
    values, state = np.array([statement.defaults[p] for p in statement.parameters]), np.array(statement.initial)
    series, given = NumpySeries(program), values.copy()
    rows = [series.rows(6, 0.0, state, 1.0, given) for _ in range(2)]
    assert len(made) == 1
    given *= 2.0
    other = series.rows(6, 0.0, state, 1.0, given)
    assert len(made) == 2
    given[:] = 0.0
    assert (series.rows(6, 0.0, state, 1.0, 2.0 * values) == other).all()
    assert len(made) == 2
    assert (rows[0] == rows[1]).all() and not (other == rows[0]).all()
    assert copy.deepcopy(series) is series
    assert (pickle.loads(pickle.dumps(series)).rows(6, 0.0, state, 1.0, values) == rows[0]).all()


# --- polynomials of steps: each kind of dense output has the same values on both machines and in the interpreter ---


GRID = np.array([0.0, 0.1, 0.25, 0.4, 0.6, 0.65, 0.9, 1.0, 1.2, 1.3])


def of_tableau(tableau: ButcherTableau) -> tuple[StepPolynomial, FloatArray, FloatArray, FloatArray]:
    """Return the dense output of a tableau, and its rows, abscissae and weights."""
    assert tableau.dense is not None
    rows = np.array([[*map(float, row), *[0.0] * (len(tableau.rows) - len(row))] for row in tableau.rows])
    abscissae = np.array([float(c) for c in tableau.abscissae])
    powers = max(map(len, tableau.dense.weights))
    weights = np.array([[*map(float, line), *[0.0] * (powers - len(line))] for line in tableau.dense.weights])
    return runge_kutta_polynomial(rows, abscissae, weights), rows, abscissae, weights


def of_points(stages: int) -> StepPolynomial:
    A, _, c = collocation_tableau(POINTS[stages])
    return collocation_polynomial(A, c)


KINDS: dict[str, StepPolynomial] = {
    "dop853": of_tableau(dop853())[0],
    **{f"Hermite, order {order}": hermite_polynomial(order) for order in (3, 4, 7)},
    **{f"collocation, {stages} stages": of_points(stages) for stages in POINTS},
}


def states_of(compiled: Model) -> FloatArray:
    return np.ascontiguousarray(exact(compiled, GRID[-1], t_eval=GRID).y.T)


def dense_of(compiled: Model, kind: StepPolynomial) -> Any:
    derivative = compiled.kernel("jacobian") if kind.derivative else None
    return compiled.machine.dense(kind, compiled.kernel("rhs"), compiled.parameter_array(), derivative)


@pytest.mark.parametrize("target", TARGETS)
def test_a_path_of_stages_is_the_formula_of_its_tableau(target: str) -> None:
    compiled = model("cart and pole", target)
    path, rows, abscissae, weights = of_tableau(dop853())
    states = states_of(compiled)
    c = dense_of(compiled, path).coefficients(GRID, states, np.array([3]))[:, :, 0]
    h, slopes = GRID[4] - GRID[3], np.zeros((len(rows), states.shape[1]))
    for i, row in enumerate(rows):
        slopes[i] = compiled.rhs(GRID[3] + abscissae[i] * h, states[3] + h * row @ slopes)
    for theta in (0.0, 0.3, 0.77, 1.0):
        share = weights @ theta ** np.arange(1, weights.shape[1] + 1)
        result = np.polynomial.polynomial.polyval(theta, c)
        # Weights up to 545 multiply what rounding does to 16 slopes near 1.
        assert result == pytest.approx(states[3] + h * share @ slopes, abs=1e-12)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_one_step_gets_does_not_depend_on_the_steps_of_its_block(kind: str, target: str) -> None:
    compiled = model("cart and pole", target)
    dense, states = dense_of(compiled, KINDS[kind]), states_of(compiled)
    together = dense.coefficients(GRID, states, np.arange(len(GRID) - 1))
    for step in range(len(GRID) - 1):
        assert (dense.coefficients(GRID, states, np.array([step]))[:, :, 0] == together[:, :, step]).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", KINDS)
def test_accepted_states_are_exact_forwards_and_back(kind: str, target: str) -> None:
    compiled = model("cart and pole", target)
    states = states_of(compiled)
    for times, rows in ((GRID, states), (GRID[::-1].copy(), states[::-1].copy())):
        out = np.empty((states.shape[1] + 1, 3 * len(times)))
        expected = np.repeat(times, 3)
        dense_of(compiled, KINDS[kind]).at(times, rows, expected, out[1:])
        assert (out[1:] == np.repeat(rows, 3, axis=0).T).all()


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("target", TARGETS)
def test_each_time_is_evaluated_on_its_step(target: str, direction: float) -> None:
    """There are few or many times on a step, unused steps, and a step of zero length at a jump."""
    compiled, rng = model("Henon-Heiles", target), np.random.default_rng(3)
    times = direction * np.sort(np.concatenate([rng.uniform(0.0, 9.0, 400), [4.0, 4.0]]))
    states = rng.normal(size=(len(times), 4))
    dense = dense_of(compiled, hermite_polynomial(3))
    c = dense.coefficients(times, states, np.arange(len(times) - 1))
    for count in (1, 2, 9, 5000):
        expected = direction * np.sort(rng.uniform(direction * times[0], direction * times[-1], count))
        out = np.empty((4, count))
        dense.at(times, states, expected, out)
        result = np.searchsorted(direction * times, direction * expected, side="right") - 1
        theta = (expected - times[result]) / (times[result + 1] - times[result])
        assert out == pytest.approx(np.polynomial.polynomial.polyval(theta, c[:, :, result], tensor=False), abs=1e-12)
    jump = np.array([direction * 4.0])
    out = np.empty((4, 1))
    dense.at(times, states, jump, out)
    assert (out[:, 0] == states[np.flatnonzero(times == jump[0])[-1]]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", ["dop853", "Hermite, order 3", "Hermite, order 7"])
def test_a_step_into_a_singular_configuration_is_a_parabola_and_the_others_keep_their_path(
    kind: str, target: str
) -> None:
    """At t = 1 the mass of z is round-off. The polynomial of that step is a parabola."""
    compiled = build(
        target,
        kinetic=m * (x.dot + z.dot) ** 2 / 2 + sp.Max(sp.Float(4e-15), 1 - t) * m * z.dot**2 / 2,
        potential=k * (x - z) ** 2 / 2,
        coordinates=[x, z],
        initial={x: 0.3},
    )
    times = np.array([0.0, 0.3, 0.6, 1.0])
    states = np.array([[0.3, 0.1, 0.0, 0.2], [0.31, 0.15, 0.1, 0.2], [0.33, 0.22, 0.1, 0.25], [0.4, 0.3, 0.2, 0.3]])
    dense = dense_of(compiled, KINDS[kind])
    c = dense.coefficients(times, states, np.arange(3))
    assert np.isfinite(c).all() and (np.abs(c[3, :, :2]) > 0).any()
    first = 0.4 * compiled.rhs(0.6, states[2])
    assert c[:3, :, 2] == pytest.approx(np.array([states[2], first, states[3] - states[2] - first]), rel=1e-12)
    assert (c[3:, :, 2] == 0).all()
    assert (dense.coefficients(times[:3], states[:3], np.arange(2)) == c[:, :, :2]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("stages", POINTS)
def test_the_stages_of_a_step_alone_solve_their_equations(stages: int, target: str) -> None:
    """The residuals of the stage equations are round-off, and the last stage is the end of the step."""
    compiled, h = model("double pendulum", target), 0.1
    states = np.ascontiguousarray(exact(compiled, h, t_eval=[0.0, h]).y.T)
    c = dense_of(compiled, of_points(stages)).coefficients(np.array([0.0, h]), states, np.array([0]))[:, :, 0]
    points = POINTS[stages]
    result = np.array([np.polynomial.polynomial.polyval(point, c) for point in points])
    slopes = [compiled.rhs(h * point, state) for point, state in zip(points, result, strict=True)]
    A, _, _ = collocation_tableau(points)
    assert (result - states[0])[:-1] == pytest.approx((h * np.array(A) @ slopes)[:-1], abs=1e-14)
    assert result[-1] == pytest.approx(states[1], abs=1e-14)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("order", [4, 11, 20])
@pytest.mark.parametrize("span", [0.3, -0.7, 1e-5, 3.0])
def test_the_polynomial_of_a_taylor_step_is_its_series(span: float, order: int, target: str) -> None:
    """The polynomial is in the fraction of the step, for any ratio of the step to the time scale of the series."""
    compiled = model("cart and pole", target)
    series, _ = compiled.series()
    start, parameters = np.array(compiled.statement.initial), compiled.parameter_array()
    times, states = np.array([0.5, 0.5 + span]), np.array([start, start + 1.0])
    c = series.dense(order, parameters).coefficients(times, states, np.array([0]))[:, :, 0]
    rows = series.rows(order, 0.5, start, 1.0, parameters)[:, : len(start)]
    h = times[1] - times[0]
    assert c == pytest.approx(rows * h ** np.arange(order + 1)[:, None], rel=1e-13)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("length", [2.0, 1.0])
def test_a_step_whose_stages_have_no_solution_is_a_straight_line(length: float, target: str) -> None:
    """For x'' = x with a_11 = 1/2 the matrix I - h J / 2 is singular at h = 2."""
    compiled = build(target, kinetic=x.dot**2 / 2, potential=-(x**2) / 2)
    kind = collocation_polynomial([[0.5, 0.0], [0.75, 0.25]], [0.5, 1.0])
    times, states = np.array([0.0, 2.0, 3.0]), np.array([[1.0, 0.0], [2.0, 1.0], [2.5, 1.5]])
    step = int(length == 1.0)
    part = slice(step, step + 2)
    result = dense_of(compiled, kind).coefficients(times[part], states[part], np.array([0]))[:, :, 0]
    straight = np.array([states[step], states[step + 1] - states[step]])
    assert result[:2] == pytest.approx(straight, abs=1e-15) if step == 0 else np.isfinite(result).all()
    assert (np.abs(result[2]).max() < 1e-15) == (step == 0)
    both = dense_of(compiled, kind).coefficients(times, states, np.arange(2))
    assert np.isfinite(both).all()


NUMBERS = (0.75, -1.5, math.nan, 1.0, -math.inf, 0.0, 1e-308, 1e308, -0.0, 3.25)


def interleaved(rows: Any) -> np.ndarray[Any, Any]:
    """Return the rows of all members in the order of machine code."""
    return np.ascontiguousarray(np.array(rows).T)


def interpreted(entry: Procedure) -> Any:
    """Return an entry procedure in the interpreter as a function of numbers and arrays."""

    def call(*arguments: Any) -> None:
        arrays: list[Any] = [item.ravel() if isinstance(item, np.ndarray) else item for item in arguments]
        records = [item.type.structure if isinstance(item.type, Record) else None for item in entry.parameters]
        pairs = zip(arrays, records, strict=True)
        run(entry, *[item if record is None else record.from_buffer(item) for item, record in pairs])

    return call


def in_lanes(procedure: Procedure, members: Any, lanes: int, active: int, life: str, *, own_n: bool) -> Any:
    """Run members side by side; return the results of each with its data and record."""
    xs, ys = (np.array([member[k] for member in members], dtype=float) for k in (0, 1))
    ns = np.array([member[2] for member in members], dtype=np.int64)
    data = interleaved([[*DATA, *[0.0] * 8] for _ in members])
    kept = np.zeros((2, lanes))
    kept[0], kept.view(np.int64)[1] = 0.25, 3
    shares = {
        "x": VARYING,
        "y": VARYING,
        "n": VARYING if own_n else UNIFORM,
        "data": VARYING,
        "table": UNIFORM,
        "kept": VARYING,
    }
    memory = {"x": xs, "y": ys, "n": ns, "data": data, "table": np.array(TABLE), "kept": kept}
    signature = tuple(shares[item.name] for item in procedure.parameters)
    entry = MemberProcedures(lanes).entry(procedure, signature)
    for item in (*entry.callees, entry):
        verify(item)
    results = [np.zeros(lanes, dtype=float if kind is REAL else np.int64) for kind in procedure.results]
    memory |= {f"result{k}": row for k, row in enumerate(results)}
    memory[ACTIVE] = np.array([active >> k & 1 for k in range(lanes)])
    given = [int(ns[0]) if item.name == "n" and not own_n else memory[item.name] for item in entry.parameters]
    call = interpreted(entry) if life == "interpreter" else CompiledProcedure(entry, optimize=life == "optimized")
    call(*given)
    result = []
    for lane in range(lanes):
        values: list[Any] = [row[lane].item() for row in results]
        after = [*map(float, data[:SIZE, lane]), float(kept[0, lane]), int(kept.view(np.int64)[1, lane])]
        result.append([bits(item) for item in (*values, *after)])
    return result


def alone(procedure: Procedure, member: Any) -> list[Any]:
    """Run a member in the interpreter."""
    (structure,) = (item.type.structure for item in procedure.parameters if isinstance(item.type, Record))
    data, kept = [*DATA, *[0.0] * 8], structure(0.25, 3)
    given = {"x": member[0], "y": member[1], "n": member[2], "data": data, "table": TABLE, "kept": kept}
    results = run(procedure, *(given[item.name] for item in procedure.parameters))
    plain = [
        int(item) if kind is not REAL else float(item) for item, kind in zip(results, procedure.results, strict=True)
    ]
    return [bits(item) for item in (*plain, *map(float, data[:SIZE]), kept.x, kept.count)]


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("seed", range(60))
def test_each_member_gives_what_it_gives_alone(seed: int, lanes: int, tmp_path: Path) -> None:
    """Half of the procedures also run in the interpreter, which has no vectors."""
    procedure = example(seed, tmp_path).form(option=seed % 3 == 0)
    draw = random.Random(seed)
    for own_n in (True, False):
        whole = draw.randrange(-3, 8)
        members = [
            (draw.choice(NUMBERS), draw.choice(NUMBERS), draw.randrange(-3, 8) if own_n else whole)
            for _ in range(lanes)
        ]
        active = draw.randrange(1, 2**lanes)
        for life in ("plain", "interpreter") if seed % 2 else ("optimized",):
            result = in_lanes(procedure, members, lanes, active, life, own_n=own_n)
            for lane, member in enumerate(members):
                if active >> lane & 1:
                    assert result[lane] == alone(procedure, member), (life, lane, member)
