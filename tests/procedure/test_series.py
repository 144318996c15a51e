"""Series and whole Taylor integrators as procedures, against those of the machines: coefficients, steps, end states."""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings

import lagrange as lg
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.series.by_order import ByOrderJet
from lagrange.algorithm.series.image import Image
from lagrange.algorithm.series.integrator import TaylorProcedures
from lagrange.algorithm.series.looped import LoopedJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.series.written_out import WrittenJet
from lagrange.algorithm.taylor.constants import SMALLEST_RTOL
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import LagrangeError, StatementError
from lagrange.export.contents import ExportContents, module_of
from lagrange.machine.python_source import loaded
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.procedure.form import Procedure
from lagrange.procedure.interpreter import run
from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from lagrange.system import System
from tests.covering import examples
from tests.laws.test_random_systems import kinetic_energies, potentials
from tests.models import stated, x, y
from tests.series_systems import HELD, LARGER

FORMS = ("written out", "looped", "by order")
HIGHEST = 9
PAIRS = 15
"""Of six bodies."""

FITTED = 3
"""How often the scale of time may be fitted to the first step, which counts as an iteration."""
SYSTEMS = {**LARGER, **HELD}
SWITCHED = ("friction", "functions")
"""Systems whose series branch on sides of surfaces."""
RUNS = ("double-pendulum", "kepler", "pleiades", "cartesian-double-pendulum", "rolling-disc", "chain-of-springs")

few = settings(max_examples=examples(12), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


def view(values: Any) -> memoryview:
    return memoryview(np.ascontiguousarray(values, dtype=float).data)


def jet(program: SeriesProgram, form: str) -> tuple[Any, SeriesNumbers, Any]:
    """Return a series as a function of Python, and where its numbers and its rows stand."""
    numbers = SeriesNumbers(program, program.constants.parameters)
    made: LoopedJet | ByOrderJet | WrittenJet
    if form == "looped":
        made = LoopedJet(pack(program, 8, aligned=True), numbers)
    elif form == "by order":
        made = ByOrderJet(pack(program, 1), numbers)
    else:
        made = WrittenJet(pack(program, 1), numbers, HIGHEST)
    return loaded(made.build()), numbers, made.layout


def rows_of(program: SeriesProgram, form: str, order: int, t: float, state: Any, scale: float, parameters: Any) -> Any:
    """Return the coefficients of the state, by the procedure."""
    series, numbers, layout = jet(program, form)
    prepared = view([*parameters, *([math.nan] * (numbers.size + 1))])
    assert not loaded(numbers.prepare())(prepared)
    rows = view(np.full(layout.size(order), math.nan))
    singular = series(t, scale, view([*state, *np.zeros(len(state))]), prepared, prepared, rows, order)
    assert not singular
    return np.array(rows)[: (order + 1) * layout.width].reshape(order + 1, -1)[:, : len(state)]


def assert_same_rows(statement: Statement, program: SeriesProgram, form: str, order: int) -> None:
    """Sums in another order and an inverted matrix: some 1e-15 a term, more by what cancels."""
    rng = np.random.default_rng(order)
    state = np.array(statement.initial) + rng.uniform(-0.1, 0.1, len(statement.initial))
    parameters = np.array([statement.defaults[p] for p in statement.parameters])
    reference = NumpySeries(program)
    size = np.abs(reference.rows(order, 0.3, state, 1.0, parameters)[-2:]).max()
    scale = float(2.0 ** -round(np.log2(size) / order)) if size > 0 else 1.0
    theirs = reference.rows(order, 0.3, state, scale, parameters)[:, : len(state)]
    ours = rows_of(program, form, order, 0.3, state, scale, parameters)
    assert (ours[0] == state).all()
    top = np.maximum.accumulate(np.abs(theirs).max(axis=1))[:, None]
    assert np.isfinite(theirs).all() and (np.abs(ours - theirs) / top).max() < 1e-11


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_series_are_those_of_the_machines(name: str, form: str) -> None:
    statement = SYSTEMS[name]()
    program, _ = series_program(euler_lagrange(statement))
    assert bool(program.sides) == (name in SWITCHED)
    for order in () if name in SWITCHED else (4, HIGHEST):
        assert_same_rows(statement, program, form, order)


@few
@given(kinetic=kinetic_energies(x, y), potential=potentials(x, y))
def test_series_of_random_systems_are_those_of_the_machines(kinetic: Any, potential: Any) -> None:
    statement = stated(kinetic=kinetic, potential=potential, initial={x: 0.4, y: -0.3, x.dot: 0.2, y.dot: 0.5})
    program, _ = series_program(euler_lagrange(statement))
    if not program.sides:
        for form in FORMS:
            assert_same_rows(statement, program, form, 6)


@cache
def exported(scene: str) -> tuple[System, Procedure, Procedure, int]:
    """Return a scene, what prepares its numbers, its integrator, and how many numbers there are."""
    system = lg.scene(scene)
    asked = ExportContents(("rhs",), (), main=False, taylor=True)
    module = module_of(system.compile(), asked, ())
    return system, module.prepare, module.integrators[-1].procedure, module.prepared


def taken(
    scene: str, rtol: float, t_end: float, most: int, runs: Any = loaded
) -> tuple[Outcome, float, np.ndarray[Any, Any]]:
    """Return how a run by the procedure ended, when, and its last state."""
    system, prepare, integrate, size = exported(scene)
    model = system.compile()
    p, y, t = view(np.zeros(size)), view(system.statement.initial), view([0.0])
    assert not loaded(prepare)(view(model.parameter_array(None)), p)
    outcome = runs(integrate)(t, t_end, y, p, rtol, rtol, most)
    return Outcome(outcome), t[0], np.array(y)


def followed(system: System, t_end: float, rtol: float) -> Any:
    """Return the run of our own driver."""
    model = system.compile()
    names = (*model.statement.names, *(f"{name}_dot" for name in model.statement.names))
    start = dict(zip(names, model.statement.initial, strict=True))
    return lg.integrate(model, (0.0, t_end), start, method="taylor", rtol=rtol, atol=rtol)


@pytest.mark.parametrize("rtol", [1e-6, 1e-15])
@pytest.mark.parametrize("scene", RUNS)
def test_runs_are_those_of_our_driver(scene: str, rtol: float) -> None:
    """As many steps, to the same end but for rounding, which other steps would not reach: see the tolerances."""
    system = exported(scene)[0]
    t_end = 0.25 if scene == "pleiades" else 1.0 if system.statement.constraints else 3.0
    ours = followed(system, t_end, rtol)
    outcome, t, y = taken(scene, rtol, t_end, 2 * ours.steps + FITTED)
    assert (outcome, t) == (Outcome.DONE, t_end)
    assert y == pytest.approx(ours.y[:, -1], rel=1e-10, abs=1e-12 * np.abs(ours.y).max())
    assert taken(scene, rtol, t_end, ours.steps - 1)[0] is Outcome.PAUSED


def test_the_interpreter_takes_the_same_steps() -> None:
    done = taken("double-pendulum", 1e-9, 0.3, 50)
    interpreted = taken("double-pendulum", 1e-9, 0.3, 50, lambda procedure: lambda *args: run(procedure, *args)[0])
    assert interpreted[:2] == done[:2] == (Outcome.DONE, 0.3)
    assert interpreted[2] == pytest.approx(done[2], rel=1e-13)


def test_runs_go_back_and_stay() -> None:
    forth = taken("kepler", 1e-12, 0.0, 10)
    assert forth[:2] == (Outcome.DONE, 0.0)
    ours = followed(lg.scene("kepler"), -2.0, 1e-12)
    assert taken("kepler", 1e-12, -2.0, 1000)[2] == pytest.approx(ours.y[:, -1], rel=1e-11)


@pytest.mark.parametrize("scene", ["double-pendulum", "pleiades", "kepler"])
def test_orders_are_chosen_as_our_driver_chooses_them(scene: str) -> None:
    made = TaylorProcedures(lg.scene(scene).compile().series()[0].program, 100)
    for rtol in [*np.geomspace(SMALLEST_RTOL, 0.9, 400), 1e-14, np.nextafter(1e-14, 0), 1e-15]:
        held = [order for tolerance, order in made.orders if rtol < tolerance]
        assert held[-1] == made.order(float(rtol)) <= made.highest


def bodies(count: int) -> System:
    """Return bodies of mass 1 in space, which attract each other."""
    places = [lg.coordinates(f"x{i} y{i} z{i}") for i in range(count)]
    squares = [sum((p - q) ** 2 for p, q in zip(a, b, strict=True)) for a, b in combinations(places, 2)]
    return System(
        kinetic=sum(lg.kinetic_energy(1, place) for place in places),
        potential=-sum(1 / sp.sqrt(square) for square in squares),
        coordinates=[q for place in places for q in place],
    )


def test_what_is_read_together_stands_together() -> None:
    """Of six bodies only the forces on each, and the differences of places, are brought together one by one."""
    program = bodies(6).compile().series()[0].program
    packing = pack(program, 8, aligned=True)
    image = Image(packing, 0)
    wide = [operand for chunk in packing.computed if chunk.op != "linear" for operand in chunk.args]
    assert len(wide) == 4
    assert all(count >= PAIRS for operand in wide for _, _, count in image.runs(operand))
    values = sorted({value for chunk in packing.computed for value in chunk.values})
    assert values == sorted({value for chunk in pack(program, 8).computed for value in chunk.values})


def test_surfaces_are_refused_by_name() -> None:
    system = System(kinetic=x.dot**2 / 2, potential=sp.Abs(x), initial={x: 1.0})
    with pytest.raises(StatementError, match=r"crosses no switching surfaces .*leave out the content taylor"):
        TaylorProcedures(system.compile().series()[0].program, 0)


def test_constraints_ask_for_a_projection() -> None:
    program = lg.scene("cartesian-double-pendulum").compile().series()[0].program
    with pytest.raises(LagrangeError, match="a projection belongs to constraints"):
        TaylorProcedures(program, 0)


def test_a_singular_constant_matrix_is_said() -> None:
    m = lg.parameters("m")
    system = System(kinetic=m * x.dot**2 / 2 + m * x.dot * y.dot + m * y.dot**2 / 2 + y.dot**2 * m, potential=x * y)
    program = system.compile().series()[0].program
    numbers = SeriesNumbers(program, 1)
    for mass, singular in ((1.0, False), (0.0, True)):
        assert loaded(numbers.prepare())(view([mass, *([0.0] * (numbers.size + 1))])) is singular
