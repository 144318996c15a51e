"""Compiled series equal those of the interpreter: unrolled and in loops, with vectors of all widths."""

from __future__ import annotations

import copy
import pickle
import re
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings

from lagrange.algorithm.series.packing import Packing, operations, pack
from lagrange.compiler import machine
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine import numpy_machine
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm_series import CompiledJet
from lagrange.machine.numpy_machine import Jet, NumpySeries
from lagrange.program.catalogue import program_of
from lagrange.program.series import RULES, SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from tests.covering import examples
from tests.laws.mechanisms import functions_of, potentials
from tests.laws.test_random_systems import kinetic_energies
from tests.models import SYSTEMS, TARGETS, k, stated, x, y
from tests.series_systems import HELD, LARGER, ladder

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
def test_what_was_in_memory_before_does_not_matter(name: str, order: int) -> None:
    rng = np.random.default_rng(3)
    statement, program = system(name)
    kernel, target = compiled(name, 8, order), order or 9
    state, given = near(statement, rng), parameters(statement, program, rng)
    expected = kernel.rows(target, 0.3, state, 0.25, given)
    work = np.full(kernel.layout.size(target), np.nan)
    padded = np.zeros(2 * kernel.layout.padded)
    padded[: len(state)] = state
    assert kernel._series(0.3, 0.25, *map(address, (padded, *kernel.numbers(given), work)), target) == 0
    assert (kernel.layout.coefficients(work, target) == expected).all()
    assert np.isfinite(expected).all()


@pytest.mark.few
@pytest.mark.parametrize(("name", "order"), KERNELS)
def test_the_same_bits_twice_and_on_every_scale(name: str, order: int) -> None:
    """A scale that is a power of two changes exponents only, so x[k] scale**k has the same digits."""
    rng = np.random.default_rng(4)
    statement, program = system(name)
    kernel, expected = compiled(name, 8, order), order or 9
    state, given = near(statement, rng), parameters(statement, program, rng)
    first = kernel.rows(expected, 0.3, state, 1.0, given)
    kernel.rows(expected, 0.9, state + 0.05, 0.125, given)
    assert (kernel.rows(expected, 0.3, state, 1.0, given) == first).all()
    for scale in (2.0**-20, 0.25, -1.0, 2.0**9, -(2.0**-3)):
        powers = scale ** np.arange(expected + 1.0)
        assert (kernel.rows(expected, 0.3, state, scale, given) == first * powers[:, None]).all()


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
        runs = [partial(item.rows, 4, 0.0, state, 1.0, given) for item in series]
        for run in (*runs, *(partial(kernel, 0.0, state, given) for kernel in kernels)):
            with pytest.raises(SingularMassMatrix) if singular else nullcontext():
                assert np.isfinite(run()).all()


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
def test_random_systems(T: Any, V: Any, Q: Any, A: Any) -> None:
    """The systems have products in T, a potential linear in velocities, a force, and explicit time."""
    statement = stated(lagrangian=T - V + A * x.dot, forces={x: Q, y: sp.cos(t) - y.dot}, coordinates=[x, y])
    program, _ = series_program(euler_lagrange(statement))
    state = np.array([0.3, -0.4, 0.2, 0.5])
    for lanes, order in ((2, 6), (4, 0), (8, 10)):
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


@pytest.mark.parametrize("exact", [False, True])
def test_eliminated_rows_are_swapped_in_every_right_hand_side(exact: bool) -> None:
    """The entries are small integers, which are exact. Each column has its pivot below the diagonal."""
    matrix = np.array([[0.0, 2.0, 1.0, 0.0], [1.0, 0.0, 0.0, 3.0], [4.0, 1.0, 0.0, 1.0], [2.0, 0.0, 8.0, 1.0]])
    given = np.array([[sp.Rational(int(entry)) for entry in row] for row in matrix]) if exact else matrix
    eliminated = numpy_machine.Eliminated(given)
    for solution in np.array([[1.0, -2.0, 3.0, 0.5], [0.0, 1.0, 0.0, 0.0]]):
        result = eliminated.solve([sp.nsimplify(entry) for entry in matrix @ solution] if exact else matrix @ solution)
        assert np.array(result, dtype=float) == pytest.approx(solution, rel=1e-15, abs=1e-15)
