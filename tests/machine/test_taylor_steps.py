"""Taylor drivers of all machines in lockstep: the same times, steps, scales, limits and counts after each step.

The states agree as well where a decision is taken wrongly: a shorter step only costs. So every entry of `DriverState`
is compared, for series that terminate, fail, overflow, meet a wall, or have gaps, in any units, forwards and backwards.

With the same series machine code does what the interpreter of procedures does, to the last bit. Between machines the
series differ by rounding.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.algorithm.taylor.constants import PROBES
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import HELD
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.series.llvm_driver import CompiledJet, LlvmTaylorDriver
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.interpreter import Span, run
from lagrange.program.taylor import series_program
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from tests.models import SYSTEMS, c, hanging_rods, k, m, omega, stated, x, y, z

S = DriverState
ORDERS = (5, 8, 14)


def wall() -> Statement:
    """A wall that comes into sight when it is near."""
    return stated(kinetic=x.dot**2 / 2, potential=sp.exp(200 * (x - 1)), initial={x: 0.3, x.dot: 1.0})


def bump() -> Statement:
    """A narrow bump ahead of a free motion, whose series terminates: steps beyond it are found out and taken back."""
    return stated(kinetic=x.dot**2 / 2, potential=sp.exp(-((60 * (x - 1)) ** 2)) / 9, initial={x: 0.3, x.dot: 1.0})


def gaps() -> Statement:
    """A force in the fourth power of time: three of four coefficients are zero."""
    return stated(kinetic=x.dot**2 / 2, forces={x: t**4 / 5 + t**8}, initial={x: 0.2})


def late() -> Statement:
    """At rest, and pushed by what has no term of low order."""
    return stated(kinetic=x.dot**2 / 2, potential=x**12 / 3, initial={x: 0.01, x.dot: 0.4})


def thrown() -> Statement:
    return stated(kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=m * y * 9, initial={y: 1.0, x.dot: 2.0, y.dot: 3.0})


def tiny() -> Statement:
    """A motion of 1e-30 in 1e-20 s."""
    return stated(
        kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 1e40}, initial={x: 1e-30, x.dot: 3e-11}
    )


def three() -> Statement:
    """Six entries: a block of eight that is not full."""
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, potential=sp.exp(x * y) + z**4 / (1 + x**2), initial={z: 1.0}
    )


def slow() -> Statement:
    return stated(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 1e-40}, initial={x: 1e25})


def driven() -> Statement:
    """Friction and a force in time, a mass matrix that moves."""
    return stated(
        kinetic=m * (x.dot**2 + (2 + sp.sin(x)) * y.dot**2) / 2,
        potential=k * sp.sqrt(1 + x**2 + y**2),
        forces={x: sp.cos(omega * t) - c * x.dot * y},
        initial={x: 0.4, y.dot: 0.6},
    )


def pole() -> Statement:
    """x = 1 / (1 - t): the steps shrink until they are lost in the time."""
    return stated(kinetic=x.dot**2 / 2, potential=-(x**4) / 2, initial={x: 1.0, x.dot: 1.0})


SPECIAL = {made.__name__: made for made in (wall, gaps, late, thrown, tiny, slow, driven, pole)}


def rods() -> Statement:
    """Constraints: each step is projected."""
    return hanging_rods(2)


STATED = {
    "rods": rods,
    "bump": bump,
    "three": three,
    **SPECIAL,
    **{name: SYSTEMS[name] for name in ("double pendulum", "Kepler orbit", "blocks", "charge")},
}
TIMES = {"tiny": 3e-20, "slow": 3e20, "pole": 1.5, "wall": 2.0}


@cache
def drivers(name: str, order: int) -> tuple[Statement, list[Any]]:
    """Return a driver of each machine: interpreted, written out in vectors of several widths, and in loops."""
    statement = STATED[name]()
    program = series_program(euler_lagrange(statement))[0]
    given = np.array([*(statement.defaults[p] for p in statement.parameters), *[1.0] * program.sides])
    compiled = [CompiledJet(pack(program, lanes), which) for lanes, which in ((8, order), (1, order), (4, 0))]
    return statement, [
        NumpySeries(program).driver(order, given),
        *(LlvmTaylorDriver(jet, order, given) for jet in compiled),
    ]


def assert_lockstep(name: str, order: int, direction: int, tolerances: tuple[float, float], **bounds: float) -> Outcome:
    statement, machines = drivers(name, order)
    span = direction * TIMES.get(name, 6.0)
    start = np.array(statement.initial)
    states = [S(0.0, span, start, *tolerances, 0.0) for _ in machines]
    for driver, state in zip(machines, states, strict=True):
        # Without a step to take a run only begins.
        assert driver.advance(state, 0, np.zeros(2), np.zeros((6, len(start)))) is Outcome.PAUSED
        for which, value in bounds.items():
            if which == "longest":
                state.reals[S.LONGEST] = value
            else:
                setattr(state.taylor, which, value)
    outcome = Outcome.PAUSED
    for _ in range(60):
        outcomes = []
        for driver, state in zip(machines, states, strict=True):
            times, rows = np.zeros(2), np.zeros((6, len(start)))
            state.counts[S.ROWS] = 0
            outcomes.append(driver.advance(state, 1, times, rows))
            if state.counts[S.ROWS]:
                assert times[0] == state.t and (rows[0] == state.y).all()
        outcome = outcomes[0]
        assert outcomes == [outcome] * len(machines)
        for state in (states[0], *states[2:]):
            assert_same(state, states[1])
        if outcome is not Outcome.PAUSED:
            break
    assert name != "bump" or states[0].count(S.REJECTED) > 0
    return outcome


def assert_same(state: DriverState, first: DriverState) -> None:
    """Series of several forms differ by rounding, which is magnified where rows cancel."""
    assert (state.counts == first.counts).all()
    assert abs(state.taylor.low - first.taylor.low) <= 1e-15 * abs(first.t)
    assert state.reals == pytest.approx(first.reals, rel=1e-8)
    for name in ("scale", "next_limit", "limit", "rescalings", "failures", "inspect"):
        assert getattr(state.taylor, name) == pytest.approx(getattr(first.taylor, name), rel=1e-8)
    assert (abs(state.y - first.y) <= 1e-7 * np.maximum(abs(first.y), abs(first.y).max() * 1e-6)).all()


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", [name for name in STATED if name != "bump"])
def test_all_machines_take_the_same_taylor_steps(name: str, order: int, direction: int) -> None:
    assert_lockstep(name, order, direction, (1e-8, 1e-40 if name in ("tiny", "slow") else 1e-10))


@pytest.mark.parametrize(
    ("which", "value"), [("longest", 0.011), ("limit", 0.003), ("once", 0.007), ("scale", 2.0**30)]
)
@pytest.mark.parametrize("name", ["double pendulum", "thrown"])
def test_all_machines_keep_to_the_same_bounds(name: str, which: str, value: float) -> None:
    assert_lockstep(name, 8, 1, (1e-8, 1e-10), **{which: value})


@pytest.mark.parametrize("tolerances", [(1e-3, 0.0), (1e-12, 1e-3), (1e-15, 1e-15)])
@pytest.mark.parametrize("name", ["driven", "Kepler orbit"])
def test_all_machines_keep_to_the_same_tolerances(name: str, tolerances: tuple[float, float]) -> None:
    assert_lockstep(name, 14, 1, tolerances)


@pytest.mark.parametrize("order", [8, 14])
def test_all_machines_take_back_what_fails(order: int) -> None:
    assert_lockstep("bump", order, 1, (1e-8, 1e-10))


def place(span: Span) -> int:
    """Return the address of an array that the interpreter hands on."""
    return int(span.memory.ctypes.data) + 8 * span.start


def interpreted(
    compiled: CompiledJet, order: int, given: Any, state: DriverState
) -> Callable[[int, Any, Any], Outcome]:
    """Return the loop over steps, interpreted, with a compiled series."""
    layout, numbers = compiled.layout, compiled.numbers(given)
    procedure = taylor_steps(layout)
    work, held = np.zeros(layout.size(order)), HELD.structure()
    work[: layout.dimension] = state.y
    records = RUN.structure.from_buffer(state.floats), COUNTS.structure.from_buffer(state.integers)
    series = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_double, *[ctypes.c_void_p] * 4, ctypes.c_int64)(
        compiled.address
    )

    def jet(t: float, scale: float, y: Span, prepared: Span, constants: Span, rows: Span, order: int) -> bool:
        return bool(series(t, scale, place(y), place(prepared), place(constants), place(rows), order))

    def advance(budget: int, times: Any, rows: Any) -> Outcome:
        floors = state.reals[S.FLOORS :]
        output = state.outputs.record, state.outputs.times, state.outputs.states.ravel()
        kept = state.taylor, floors, held, *output
        (found,) = run(procedure, jet, *numbers, *records, *kept, times, rows.ravel(), budget, work, order)
        state.y[:] = work[: layout.dimension]
        return Outcome(found)

    return advance


@pytest.mark.parametrize(("order", "known"), [(4, True), (5, True), (6, True), (7, True), (8, True), (7, False)])
@pytest.mark.parametrize("name", ["late", "bump", "thrown", "driven", "pole", "blocks", "wall", "three"])
def test_machine_code_takes_the_steps_of_the_interpreter(name: str, order: int, known: bool) -> None:
    """States of two entries, of four and of more, with a series that is written out for an order and one for any."""
    statement = STATED[name]()
    program = series_program(euler_lagrange(statement))[0]
    given = np.array([*(statement.defaults[p] for p in statement.parameters), *[1.0] * program.sides])
    compiled = CompiledJet(pack(program, 4), order if known else 0)
    # Without a start of its own an entry that is zero gets a floor from its series.
    ours, theirs = (S(0.0, TIMES.get(name, 6.0), np.array(statement.initial), 1e-6, 1e-9, 0.0, 1e-3) for _ in range(2))
    driver, beside = LlvmTaylorDriver(compiled, order, given), interpreted(compiled, order, given, theirs)
    for budget in (1, 1, 3, 3, 3, 3):
        times, rows = np.zeros((2, 3)), np.zeros((2, 5, len(ours.y)))
        outcome = driver.advance(ours, budget, times[0], rows[0])
        assert beside(budget, times[1], rows[1]) is outcome
        assert (ours.reals == theirs.reals).all()
        assert (ours.counts == theirs.counts).all()
        assert bytes(ours.taylor) == bytes(theirs.taylor)
        assert (ours.y == theirs.y).all()
        count = ours.count(S.ROWS)
        assert (times[0] == times[1]).all()
        assert (rows[0, :count] == rows[1, :count]).all()
        if outcome is not Outcome.PAUSED:
            break
    assert name != "bump" or order < 7 or ours.count(S.REJECTED) > 0


def test_what_is_probed_does_not_depend_on_how_a_run_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step of a call was probed at 31 places, for the step before it was forgotten between calls."""
    statement = thrown()
    program = series_program(euler_lagrange(statement))[0]
    looks: list[float] = []
    real = NumpySeries.rows

    def counted(self: NumpySeries, order: int, t: float, *given: Any) -> Any:
        looks.append(t)
        return real(self, order, t, *given)

    monkeypatch.setattr(NumpySeries, "rows", counted)
    counts = []
    for budget in (1, 30):
        looks.clear()
        values = np.array([statement.defaults[p] for p in statement.parameters])
        driver = NumpySeries(program).driver(14, values)
        state = S(0.0, 2.0, np.array(statement.initial), 1e-8, 1e-8, 0.0)
        state.reals[S.LONGEST] = 0.1
        while driver.advance(state, budget, np.zeros(budget), np.zeros((budget + 4, 4))) is Outcome.PAUSED:
            pass
        counts.append(len(looks) - state.count(S.EVALUATIONS))
        assert state.count(S.STEPS) == 20
    assert counts == [PROBES - 1] * 2
