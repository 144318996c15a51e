"""Procedures as the builder makes them, and runs of user code that are those of our driver."""

import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
import lagrange.procedure
from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.members.taylor import MemberJet
from lagrange.algorithm.projection import KEPT_VIOLATION, PROJECTION_CORRECTIONS, RESOLVED, project
from lagrange.algorithm.series.exported_integrator import LOOP_LANES, LOOP_TILE, TaylorProcedures
from lagrange.algorithm.series.jets import ByOrderJet, WrittenJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.taylor.memory import SMALLEST_RTOL
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.errors import LagrangeError, StatementError
from lagrange.export.contents import ExportContents, module_of
from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.machine.numpy_machine import NumpySeries
from lagrange.machine.python_source import loaded, source
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure, Record
from lagrange.procedure.interpreter import run
from lagrange.procedure.rewrite import without_vectors
from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from lagrange.system import System
from tests.models import x
from tests.series_systems import HELD, LARGER

CLOCK = Record("Clock", (("t", REAL), ("steps", WHOLE)))


def gcd() -> Procedure:
    """Euclid's algorithm."""
    p = Builder("gcd", "The greatest common divisor of two positive numbers.")
    a, b = p.given("a", WHOLE), p.given("b", WHOLE)
    larger, smaller = p.variable(a, "larger"), p.variable(b, "smaller")
    with p.repeat(lambda: smaller.value > 0):
        rest = larger.value - (larger.value // smaller.value) * smaller.value
        larger.value = smaller.value
        smaller.value = rest
    p.leave(larger.value)
    return p.finish(WHOLE)


def test_an_algorithm_reads_as_in_the_book() -> None:
    assert run(gcd(), 54, 24) == (6,)
    assert source(gcd()) == (
        "def gcd(a, b):\n"
        '    """The greatest common divisor of two positive numbers."""\n'
        "    larger = a\n"
        "    smaller = b\n"
        "    while smaller > 0:\n"
        "        x13 = larger - _quotient(larger, smaller) * smaller\n"
        "        larger = smaller\n"
        "        smaller = x13\n"
        "    return larger\n"
    )


def broken(build: Callable[[Builder], Any]) -> str:
    """Return the message that refuses a procedure."""

    def whole() -> None:
        p = Builder("broken", "A malformed procedure.")
        build(p)
        p.finish()

    with pytest.raises(LagrangeError) as caught:
        whole()
    return str(caught.value)


def python_if(p: Builder) -> None:
    if p.given("x", REAL) > 0:
        p.note("never")


def wrong_kind(p: Builder) -> None:
    memory = p.array("memory")
    memory[0] = p.whole(1)


def mixed_kinds(p: Builder) -> None:
    p.given("x", REAL) + p.given("n", WHOLE)


def written_where_read(p: Builder) -> None:
    p.array("memory", read=True)[0] = 1.0


def from_another_way(p: Builder) -> None:
    x = p.given("x", REAL)
    with p.when(x < 0):
        y = x + 1.0
    p.leave(y + 1.0)


def without_results(p: Builder) -> None:
    with p.when(p.given("x", REAL) < 0):
        p.leave(1.0)
    p.finish(REAL)


def behind_the_end(p: Builder) -> None:
    x = p.given("x", REAL)
    p.leave()
    x + 1.0


def unknown_field(p: Builder) -> None:
    p.record("clock", CLOCK).hour = 1.0


def set_in_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    total = p.variable(0.0)
    with p.each(3) as i:
        total.value = memory[i]


def decided_in_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3) as i, p.when(memory[i] < 0):
        memory[i] = 0.0


def stored_elsewhere(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3):
        memory[0] = 1.0


def place_of_a_turn(p: Builder) -> None:
    memory = p.array("memory")
    with p.each(3) as i:
        memory[i] = memory[i + 1]


def sum_without_room(p: Builder) -> None:
    n, memory = p.given("n", WHOLE), p.array("memory")
    with p.each(n) as i:
        p.fold("add", memory[i])


def sum_outside(p: Builder) -> None:
    p.fold("add", p.given("x", REAL))


def turn_in_a_turn(p: Builder) -> None:
    with p.each(3), p.each(3):
        p.note("never")


def too_few_arguments(p: Builder) -> None:
    p.call(gcd(), 3)


def two_procedures_of_one_name(p: Builder) -> None:
    p.call(gcd(), 3, 4)
    p.call(gcd(), 5, 6)


def late_parameter(p: Builder) -> None:
    p.given("x", REAL) + 1.0
    p.given("y", REAL)


def two_of_one_name(p: Builder) -> None:
    p.given("x", REAL)
    p.given("x", REAL)


def late_otherwise(p: Builder) -> None:
    with p.when(p.given("x", REAL) < 0) as ways:
        p.note("below")
    p.note("between")
    with ways.otherwise():
        p.note("above")


def three_at_once(p: Builder) -> None:
    with p.each(6, width=3):
        p.note("again")


def loop_without_end(p: Builder) -> None:
    with p.loop(0, 3, 0):
        p.note("again")


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (python_if, "use `with p.when(...)` instead of `if`"),
        (wrong_kind, "an operand is a whole: give a real"),
        (mixed_kinds, "add cannot take real, whole"),
        (written_where_read, "is only read"),
        (from_another_way, "is read outside of its scope"),
        (without_results, "ends without results"),
        (behind_the_end, "no statement after the end"),
        (unknown_field, "the record Clock has no field hour: it has t, steps"),
        (set_in_a_turn, "sets a variable of an outer block"),
        (decided_in_a_turn, "has a When"),
        (stored_elsewhere, "stores at an index other than its own"),
        (place_of_a_turn, "at an index computed from its own"),
        (sum_without_room, "has no room for a whole block"),
        (sum_outside, "inside `each` only"),
        (turn_in_a_turn, "an `each` is inside another"),
        (too_few_arguments, "has 1 arguments, and the callee 2"),
        (two_procedures_of_one_name, "calls different procedures of one name among gcd, gcd"),
        (late_parameter, "before the first statement"),
        (two_of_one_name, "two parameters have one name"),
        (late_otherwise, "directly after the block of its condition"),
        (loop_without_end, "a step that is not above zero"),
        (three_at_once, "an `each` of 3 iterations at once, which are one of (1, 2, 4, 8)"),
    ],
)
def test_what_is_malformed_is_refused(build: Callable[[Builder], Any], said: str) -> None:
    assert said in broken(build)


# --- series ---------------------------------------------------------------------------------------------------
# Series and whole Taylor integrators as procedures, against those of the machines: coefficients, steps, end states.

FITTED = 3
"""How often the scale of time may be fitted to the first step, which counts as an iteration."""
FORMS = ("written out", "by order", "for members", "in loops")
HIGHEST = 9
SYSTEMS = {**LARGER, **HELD}
SWITCHED = ("friction", "functions")
"""Systems whose series branch on sides of surfaces."""
SLOW = ("double-pendulum", "cartesian-double-pendulum", "rolling-disc", "chain-of-springs")
RUNS = [
    *(("kepler", 1e-6), ("pleiades", 1e-15), ("heavy-top", 1e-9)),
    *(pytest.param(*row, marks=pytest.mark.slow) for row in (("kepler", 1e-15), ("pleiades", 1e-6))),
    *(pytest.param(scene, rtol, marks=pytest.mark.slow) for scene in SLOW for rtol in (1e-6, 1e-15)),
]


def view(values: Any) -> memoryview:
    return memoryview(np.ascontiguousarray(values, dtype=float).data)


def jet(program: SeriesProgram, form: str) -> tuple[Any, SeriesNumbers, Any]:
    """Return a series as a Python function, with the sizes of its numbers and its rows."""
    numbers = SeriesNumbers(program, program.constants.parameters)
    made: ByOrderJet | WrittenJet
    if form == "by order":
        made = ByOrderJet(pack(program, 1), numbers)
    elif form == "for members":
        made = MemberJet(pack(program, 1), numbers, HIGHEST)
    elif form == "in loops":
        made = ByOrderJet(pack(program, LOOP_LANES), numbers, tile=LOOP_TILE, paired=False)
    else:
        made = WrittenJet(pack(program, 1), numbers, HIGHEST)
    return loaded(without_vectors(made.build())), numbers, made.layout


def rows_of(program: SeriesProgram, form: str, order: int, t: float, state: Any, scale: float, parameters: Any) -> Any:
    """Return the Taylor coefficients of the state by the procedure."""
    series, numbers, layout = jet(program, form)
    prepared = view([*parameters, *([math.nan] * (numbers.size + 1))])
    assert not loaded(numbers.prepare())(prepared)
    rows = view(np.full(layout.size(order), math.nan))
    singular = series(t, scale, view([*state, *np.zeros(len(state))]), prepared, prepared, rows, order)
    assert not singular
    return np.array(rows)[: (order + 1) * layout.width].reshape(order + 1, -1)[:, : len(state)]


def assert_same_rows(statement: Statement, program: SeriesProgram, form: str, order: int) -> None:
    """Assert equality up to the rounding of sums in another order and an inverted matrix."""
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


@pytest.mark.few(1)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_series_are_those_of_the_machines(name: str, form: str) -> None:
    statement = SYSTEMS[name]()
    program, _ = series_program(euler_lagrange(statement))
    assert bool(program.sides) == (name in SWITCHED)
    for order in () if name in SWITCHED else (4, HIGHEST):
        assert_same_rows(statement, program, form, order)


@cache
def exported(scene: str) -> tuple[System, Procedure, Procedure, int]:
    """Return a scene, the procedure that prepares its numbers, its integrator, and the count of numbers."""
    system = lg.scene(scene)
    asked = ExportContents(("rhs",), (), main=False, taylor=True)
    module = module_of(system.compile(), asked, ())
    return system, module.prepare, module.integrators[-1].procedure, module.prepared


def taken(
    scene: str, rtol: float, t_end: float, most: int, runs: Any = loaded
) -> tuple[Outcome, float, np.ndarray[Any, Any]]:
    """Return the outcome of a run by the procedure, its end time and its last state."""
    system, prepare, integrate, size = exported(scene)
    model = system.compile()
    p, y, t = view(np.zeros(size)), view(system.statement.initial), view([0.0])
    assert not loaded(prepare)(view(model.parameter_array(None)), p)
    outcome = runs(integrate)(t, t_end, y, p, rtol, rtol, most)
    return Outcome(outcome), t[0], np.array(y)


def followed(system: System, t_end: float, rtol: float) -> Any:
    """Return the run by the package's driver."""
    model = system.compile()
    names = (*model.statement.names, *(f"{name}_dot" for name in model.statement.names))
    start = dict(zip(names, model.statement.initial, strict=True))
    return lg.integrate(model, (0.0, t_end), start, method="taylor", rtol=rtol, atol=rtol)


@pytest.mark.parametrize(("scene", "rtol"), RUNS)
def test_runs_are_those_of_our_driver(scene: str, rtol: float) -> None:
    """Both runs take the same number of steps to the same end up to rounding: series written out and in loops."""
    system = exported(scene)[0]
    t_end = 0.0625 if scene == "pleiades" else 1.0 if system.statement.constraints else 3.0
    ours = followed(system, t_end, rtol)
    outcome, t, y = taken(scene, rtol, t_end, 2 * ours.steps + FITTED)
    assert (outcome, t) == (Outcome.DONE, t_end)
    assert y == pytest.approx(ours.y[:, -1], rel=1e-10, abs=1e-12 * np.abs(ours.y).max())
    assert taken(scene, rtol, t_end, ours.steps - 1)[0] is Outcome.PAUSED


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", ["double-pendulum", "pleiades", "kepler"])
def test_orders_are_chosen_as_our_driver_chooses_them(scene: str) -> None:
    made = TaylorProcedures(lg.scene(scene).compile().series()[0].program, 100)
    for rtol in [*np.geomspace(SMALLEST_RTOL, 0.9, 400), 1e-14, np.nextafter(1e-14, 0), 1e-15]:
        held = [order for tolerance, order in made.orders if rtol < tolerance]
        assert held[-1] == made.order(float(rtol)) <= made.highest


def test_surfaces_are_refused_by_name() -> None:
    system = System(kinetic=x.dot**2 / 2, potential=sp.Abs(x), initial={x: 1.0})
    with pytest.raises(StatementError, match=r"crosses no switching surfaces .*leave 'taylor' out of contents"):
        TaylorProcedures(system.compile().series()[0].program, 0)


@pytest.mark.parametrize("count", [1, 3, 8, 11, None])
def test_products_that_are_added_up_are_rounded_once(count: int | None) -> None:
    """The remainder of products that cancel is the rounding of one fused operation, in vectors and one by one."""
    p = Builder("scalar_product", "The sum of products.")
    n, a, b = p.given("n", WHOLE), p.array("a", room=4, read=True), p.array("b", room=4, read=True)
    with p.each(n if count is None else count) as i:
        total = p.fold("dot", a[i], b[i])
    p.leave(total)
    procedure = p.finish(REAL)
    small = [(3 + i) * 2.0**-30 for i in range(16)]
    numbers = [1 + x for x in small], [(-1) ** (i // 4) * (1 - x) for i, x in enumerate(small)]
    expected = run(procedure, 11, *numbers)[0]
    assert CompiledProcedure(procedure, optimize=True)(11, *map(np.array, numbers)) == expected
    assert loaded(procedure)(11, *numbers) == pytest.approx(expected, abs=1e-15)


# --- projection -----------------------------------------------------------------------------------------------
# The loop of the projection: when a state moves, how far, and the outcome if it cannot be projected.

Answer = tuple[list[float], float, float]
"""Corrections, the violation, and the violation that would remain."""


def projected(
    answers: list[Answer | None], state: list[float], lost: list[float] | None = None
) -> tuple[Outcome, bool, list[float], list[float], int]:
    """Run the projection with given corrections. Return its result, the state, the rounding errors, and the calls."""
    asked = 0

    def corrections(_: float, __: Any, ___: Any, out: Any) -> bool:
        nonlocal asked
        answer = answers[min(asked, len(answers) - 1)]
        asked += 1
        for i, value in enumerate([] if answer is None else [*answer[0], answer[1], answer[2]]):
            out[i] = value
        return answer is None

    y, low = list(state), [0.0] * len(state) if lost is None else list(lost)
    outcome, moved = run(project.form(dimension=len(state), block=1), corrections, [], 0.5, y, low)
    return Outcome(outcome), bool(moved), y, low, asked


def test_a_state_and_its_rounding_error_move_as_one_number() -> None:
    """State and rounding errors together lose no bit of a correction below the spacing of the state."""
    state, lost, move = [1.0, -3.0], [2.0**-55, -(2.0**-54)], [2.0**-54 + 2.0**-80, 0.3]
    outcome, moved, after, low, asked = projected([(move, 1e-9, 0.0)], state, lost)
    assert (outcome, moved, asked) == (Outcome.DONE, True, 1)
    for i in range(2):
        total = Fraction(lost[i]) + Fraction(move[i])
        exact = Fraction(state[i]) + total
        # The sum of both small parts is rounded once, where it does not fit into a double.
        assert abs(Fraction(after[i]) + Fraction(low[i]) - exact) <= abs(total) * Fraction(1, 2**53)
    assert after[0] == 1.0
    assert low[0] > 0


MORE: list[Answer | None] = [([0.1], 1e-2, 1e-4), ([0.01], 1e-4, 1e-8), ([1e-3], 1e-8, 1e-16), ([9.0], 1.0, 0.0)]
ENDS: dict[str, tuple[list[Answer | None], Outcome, float, int]] = {
    "a violation of rounding stays": ([([1e-17], KEPT_VIOLATION, 0.0)], Outcome.DONE, 1.0, 1),
    "corrections are repeated until the violation is rounding": (MORE, Outcome.DONE, 1.111, 3),
    "a small violation that is not halved stays": ([([5.0], RESOLVED, 0.6 * RESOLVED)], Outcome.DONE, 1.0, 1),
    "a large one makes the step fail": ([([5.0], 2 * RESOLVED, 1.2 * RESOLVED)], Outcome.UNPROJECTED, 1.0, 1),
    "slow corrections end": (
        [([1e-3], 1e-2, 4e-3)],
        Outcome.UNPROJECTED,
        1 + 1e-3 * PROJECTION_CORRECTIONS,
        PROJECTION_CORRECTIONS,
    ),
    "a violation that is NaN is no success": ([([0.1], math.nan, 0.0)], Outcome.UNPROJECTED, 1.0, 1),
    "a remainder that is NaN is none": ([([0.1], 1.0, math.nan)], Outcome.UNPROJECTED, 1.0, 1),
    "a singular matrix changes nothing": ([None], Outcome.DONE, 1.0, 1),
}
"""Answers of the corrections; the outcome, the state that was 1, and the number of corrections asked for."""


@pytest.mark.parametrize("case", ENDS)
def test_each_end_of_a_projection(case: str) -> None:
    answers, outcome, state, count = ENDS[case]
    result, moved, after, _, asked = projected(answers, [1.0])
    assert (result, moved, asked) == (outcome, state != 1.0, count)
    assert after == ([pytest.approx(state)] if moved else [1.0])
