"""Drivers of both machines, step by step: the same times, steps, norms, causes and counts after each step.

A wrong decision about a step often only costs time, which no result shows. So every entry of `DriverState` is
compared, for all methods with step programs. Steps are accepted, rejected, not finite, unsolvable, singular, or too
short.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.step.memory import COUNTS, RUN
from lagrange.compiler import compile_model, machine, model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.machine.drivers import StepDriver
from lagrange.machine.llvm_machine import loop_layout
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.program.step import Control, StepProgram, trace
from lagrange.statement.coordinate import t
from lagrange.statement.scene.library import load
from lagrange.statement.statement import Statement
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.plan import StepPlan
from tests.models import TARGETS, c, k, m, stated, x, y
from tests.trajectory.runs import CONSTRAINED, CONTROLLED, FIXED, IMPLICIT, SLOPES, SPLITTINGS, STEPPED, planned

S = DriverState


def driven() -> Statement:
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=k * sp.sqrt(1 + x**2 + y**2) + x**4 / 4,
        forces={x: sp.cos(3 * t) - c * x.dot * y},
        initial={x: 0.4, y.dot: 0.6},
    )


def separable() -> Statement:
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2, potential=k * x**2 * y**2 + x**4, initial={x: 0.9, y: -0.4, y.dot: 0.6}
    )


def pole() -> Statement:
    """Return a system with the motion x = 1 / (1 - t)."""
    return stated(kinetic=x.dot**2 / 2, potential=-(x**4) / 2, initial={x: 1.0, x.dot: 1.0})


def edge() -> Statement:
    """Return a system whose forces have no value beyond x = 0."""
    return stated(kinetic=x.dot**2 / 2, potential=-sp.sqrt(x), initial={x: 1.0, x.dot: -3.0})


def degenerate() -> Statement:
    """Return a system whose mass matrix is singular from x = 1 on."""
    return stated(
        kinetic=x.dot**2 / 2 + (y.dot + x.dot) ** 2 / 2 * sp.Max(0, 1 - x), initial={x: 0.5, x.dot: 1.0, y.dot: 0.2}
    )


SYSTEMS: dict[str, Callable[[], Statement]] = {
    made.__name__: made for made in (driven, separable, pole, edge, degenerate)
}


@cache
def models(name: str) -> list[Model]:
    """Return a model on each machine."""
    statement = SYSTEMS[name]()
    equations = euler_lagrange(statement)
    return [model_of(statement, machine(target), equations) for target in TARGETS]


def assert_lockstep(
    drivers: list[Any], start: Any, end: float, step: float, tolerances: tuple[float, float], **reals: float
) -> Outcome:
    """Take single steps on both machines until the run ends, and compare all entries of their states."""
    states = [S(0.0, end, start, *tolerances, step) for _ in drivers]
    outcome = Outcome.PAUSED
    for state in states:
        for which, value in reals.items():
            state.reals[getattr(S, which)] = value
    for _ in range(60):
        outcomes = []
        for driver, state in zip(drivers, states, strict=True):
            times, rows = np.zeros(1), np.zeros((5, len(start)))
            state.counts[S.ROWS] = 0
            outcomes.append(driver.advance(state, 1, times, rows))
            if state.counts[S.ROWS]:
                assert times[0] == state.t and (rows[0] == state.y).all()
        assert outcomes[0] == outcomes[1]
        assert_same(*states)
        outcome = outcomes[0]
        # Where forces lose their values a step behind a rejected one is longer or shorter by chance.
        if outcome is not Outcome.PAUSED or states[0].cause is Outcome.NON_FINITE:
            break
    return outcome


def assert_same(ours: DriverState, theirs: DriverState) -> None:
    """Assert that two states are equal up to rounding, which is larger for error vectors and so for the next step."""
    counts = [i for i in range(len(ours.counts)) if i != S.EVALUATIONS]
    assert (ours.counts[counts] == theirs.counts[counts]).all()
    # By chance round-off takes one correction more.
    assert ours.count(S.EVALUATIONS) == pytest.approx(theirs.count(S.EVALUATIONS), rel=0.2)
    reals = [i for i in range(len(ours.reals)) if i not in (S.RESIDUAL, S.PREVIOUS)]
    assert ours.reals[reals] == pytest.approx(theirs.reals[reals], rel=1e-2)
    assert ours.reals[S.PREVIOUS] == pytest.approx(theirs.reals[S.PREVIOUS], rel=1e-1)
    assert ours.y == pytest.approx(theirs.y, rel=1e-3, abs=1e-3)


def drivers(name: str, system: str) -> list[Any]:
    result = []
    for compiled in models(system):
        start = np.array(compiled.statement.initial)
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, start)
        result.append(planned(name, problem).driver(compiled, compiled.parameter_array()))
    return result


def test_procedures_know_the_entries_of_a_run_by_name() -> None:
    state = S(0.0, 1.0, np.zeros(2), 1e-6, 1e-8, 0.1)
    for record, count in ((RUN, S.FLOORS), (COUNTS, len(state.counts))):
        assert [getattr(S, name.upper()) for name, _ in record.fields] == list(range(count))


TAKEN = [
    (name, system)
    for name in (*STEPPED, *IMPLICIT)
    for system in SYSTEMS
    # A splitting takes no forces of velocities, and no mass matrix that moves.
    if name not in SPLITTINGS or system not in ("driven", "degenerate")
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "system"), TAKEN)
def test_both_machines_decide_alike(name: str, system: str) -> None:
    if (name, system) in (("trapezoidal", "pole"), ("trapezoidal", "edge"), ("radau5", "edge")):
        pytest.skip("round-off decides which step is the last that has a solution")
    start = np.array(models(system)[0].statement.initial)
    for end in (2.0, -2.0):
        step = np.copysign(0.07 if system == "driven" else 0.021, end) if name in FIXED else 0.0
        outcome = assert_lockstep(drivers(name, system), start, end, step, (1e-5, 1e-7))
        if system in ("driven", "separable") and name in FIXED:
            assert outcome in (Outcome.DONE, Outcome.PAUSED)


@pytest.mark.parametrize(("which", "value"), [("LONGEST", 0.013), ("H", 0.5), ("H", 1e-7), ("PREVIOUS", 1e-3)])
@pytest.mark.parametrize("name", ["dopri5", "dop853", "verner9", "radau5", "radau3"])
def test_both_machines_keep_to_the_same_bounds(name: str, which: str, value: float) -> None:
    start = np.array(models("driven")[0].statement.initial)
    for tolerances in ((1e-3, 1e-9), (1e-9, 1e-4)):
        assert_lockstep(drivers(name, "driven"), start, 1.0, 0.0, tolerances, **{which: value})


# --- steps that are not numbers -------------------------------------------------------------------------------


def made(large: int) -> StepProgram:
    """Return a step whose state, first or second error vector is infinite."""

    def step(f: Any, t: Any, y: Any, h: Any) -> Any:
        first = f(t, y)
        parts = [y + first * h, first * (h * 1e-3), first * (h * 1e-3)]
        parts[large] = parts[large] + first * 1e308
        return tuple(parts)

    return trace(f"large{large}", step, control=Control(3, damped=True))


@pytest.mark.parametrize("large", [0, 1, 2])
def test_no_part_of_a_step_may_be_beyond_all_numbers(large: int) -> None:
    step, compiled = made(large), models("driven")
    both: list[Any] = [
        StepDriver(machine(target), step, item.kernel("rhs"), item.parameter_array())
        for target, item in zip(TARGETS, compiled, strict=True)
    ]
    start = 100 * np.array(compiled[0].statement.initial)
    states = [S(0.0, 1.0, start, 1e-6, 1e-6, 0.01) for _ in both]
    for driver, state in zip(both, states, strict=True):
        assert driver.advance(state, 1, np.zeros(1), np.zeros((5, 4))) is Outcome.PAUSED
        assert state.cause is Outcome.NON_FINITE
        assert (state.count(S.STEPS), state.count(S.REJECTED)) == (0, 1)
    assert_same(*states)


# --- procedure steps ------------------------------------------------------------------------------------------
# Steps of both machines: the memory beside a vector, and decisions that rounding does not take.


class Compiled:
    """A run by compiled code, one step per call."""

    def __init__(self, name: str, compiled: Model, step: float, share: float = 0.0) -> None:
        self.start = np.array(compiled.statement.initial)
        problem = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, self.start)
        plan = planned(name, problem)
        assert isinstance(plan, StepPlan)
        self.step, self.projected = plan.step, plan.projected
        self.driver: Any = plan.driver(compiled, compiled.parameter_array())
        self.state = DriverState(0.0, 1.0, self.start, 1e-6, 1e-8, step if name in FIXED else 0.0, share)

    def take(self) -> Outcome:
        times, rows = np.empty(1), np.empty((5, len(self.start)))
        self.state.counts[S.ROWS] = 0
        return Outcome(self.driver.advance(self.state, 1, times, rows))


@cache
def four_bar() -> Model:
    return compile_model(load("four-bar"), euler_lagrange(load("four-bar")))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "name", [name for name in (*SLOPES, *CONTROLLED, *STEPPED) if name not in CONSTRAINED + SPLITTINGS]
)
def test_the_projection_leaves_nothing_behind_the_entries_of_a_vector(name: str) -> None:
    """Six entries are in blocks of four. Norms are taken of whole blocks, so the padding must stay 0."""
    beside = Compiled(name, four_bar(), 0.01)
    layout = loop_layout(beside.step, 6, projected=True)
    for _ in range(5):
        beside.take()
        for vector in range(layout.errors + len(layout.step.errors)):
            place = layout.place(vector)
            assert not beside.driver._work[place + layout.length : place + layout.width].any()
