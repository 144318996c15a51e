"""Run a step program from start to end: bursts of compiled steps, and a look around between them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.driver import DriverState, Outcome
from lagrange.program.step import StepProgram
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

BURST = 0.02
"""Seconds of steps between two looks at the clock, the step limit and Ctrl-C."""

LARGEST_BURST = 16384

PathMaker = Callable[[FloatArray, FloatArray], Callable[[FloatArray], FloatArray]]
"""Makes the dense output from the accepted times (S+1,) and states (S+1, 2n)."""

_STATUS = {
    Outcome.DONE: Status.SUCCESS,
    Outcome.NON_FINITE: Status.NON_FINITE,
    Outcome.SINGULAR: Status.SINGULAR,
    Outcome.STEP_TOO_SMALL: Status.STEP_TOO_SMALL,
}


@dataclass(frozen=True)
class Tolerances:
    """What a driver is told, and notes for the user.

    That is the relative and absolute tolerance and the longest step, or the size of equal steps.
    """

    rtol: float = 0.0
    atol: float = 0.0
    step: float = 0.0
    longest: float = math.inf
    notes: tuple[str, ...] = ()


class _Rows:
    """The accepted states so far, in the pieces in which the driver wrote them."""

    def __init__(self, t: float, y: FloatArray) -> None:
        self.pieces = [(np.array([t]), y[None].copy())]

    def collect(self, state: DriverState, times: FloatArray, rows: FloatArray) -> None:
        """Keep what the last burst wrote; calling it twice, as Ctrl-C may, keeps it once."""
        written = state.count(DriverState.ROWS)
        kept = sum(len(piece[0]) for piece in self.pieces) - 1
        if written and kept < state.count(DriverState.STEPS):
            self.pieces.append((times[:written], rows[:written]))

    def joined(self) -> tuple[FloatArray, FloatArray]:
        """Return the times (S+1,) and states (S+1, 2n)."""
        times, states = zip(*self.pieces, strict=True)
        return np.concatenate(times), np.concatenate(states)


def drive(problem: Problem, step: StepProgram, name: str, tolerances: Tolerances, path_of: PathMaker) -> Trajectory:
    """Run a problem with a step program; see `Integrator.integrate` for what comes back."""
    began = time.perf_counter()
    model = problem.model
    kernel = model.kernel("rhs")
    parameters = problem.parameter_array
    size = tolerances.step * (1.0 if problem.t1 >= problem.t0 else -1.0)
    state = DriverState(problem.t0, problem.t1, problem.y0, tolerances.rtol, tolerances.atol, size)
    state.reals[DriverState.LONGEST] = tolerances.longest
    rows = _Rows(problem.t0, problem.y0)
    status, sentence = _first_look(problem, name, parameters)
    if status is None:
        driver = model.machine.driver(step, kernel, parameters)
        status = _bursts(problem, driver, state, rows, began)
        sentence = _closing(problem, step, name, state, status, parameters)
    times, states = rows.joined()
    path = path_of(times, states)
    t, y = times, states.T
    if problem.t_eval is not None:
        reached = (problem.t_eval - times[-1]) * (1 if problem.t1 >= problem.t0 else -1) <= 0
        t = problem.t_eval[reached]
        y = path(t)
    return Trajectory(
        t=t,
        y=y,
        status=status,
        message=" ".join([sentence, *tolerances.notes, *_small_state(states, tolerances.atol)]),
        method=name,
        steps=state.count(DriverState.STEPS),
        rejected=state.count(DriverState.REJECTED),
        evaluations=state.count(DriverState.EVALUATIONS) + 1,
        wall=time.perf_counter() - began,
        span=(float(times[0]), float(times[-1])),
        dense=path,
    )


def _small_state(states: FloatArray, atol: float) -> Iterator[str]:
    """Yield a note if the whole run stays so small that the absolute tolerance leaves it few digits, or none."""
    largest = float(np.max(np.abs(states)))
    if 0 < largest < 1e4 * atol:
        yield (
            f"No entry of the state exceeds {largest:.3g}, so atol = {atol:g} leaves it few digits, or none: lower "
            "atol to "
            f"some {1e-9 * largest:.0e}."
        )


def _first_look(problem: Problem, name: str, parameters: FloatArray) -> tuple[Status | None, str]:
    """Return a status and its sentence if the run cannot even begin."""
    model, y0 = problem.model, problem.y0
    q, v = np.split(y0, 2)
    singular, slope = model.column_without_inertia(problem.t0, q, v, parameters) is not None, y0
    try:
        slope = model.kernel("rhs")(problem.t0, y0, parameters)
    except SingularMassMatrix:
        singular = True
    if singular:
        detail = model.singular_message(problem.t0, y0)
        return Status.SINGULAR, message(Status.SINGULAR, problem, problem.t0, y0, name, detail=detail)
    if not np.isfinite(slope).all():
        return Status.NON_FINITE, message(Status.NON_FINITE, problem, problem.t0, problem.y0, name, slope=slope)
    return None, ""


def _bursts(problem: Problem, driver: Driver, state: DriverState, rows: _Rows, began: float) -> Status:
    """Advance until something ends the run, and return what did."""
    burst = 64
    times, states = np.empty(0), np.empty((0, len(problem.y0)))
    try:
        while True:
            left = problem.max_steps - state.count(DriverState.STEPS) - state.count(DriverState.REJECTED)
            if state.t != problem.t1 and left <= 0:
                return Status.MAX_STEPS
            if problem.max_wall is not None and time.perf_counter() - began > problem.max_wall:
                return Status.MAX_WALL
            budget = min(burst, left) if left > 0 else 1
            times, states = np.empty(budget), np.empty((budget + 4, len(problem.y0)))
            state.counts[DriverState.ROWS] = 0
            before = time.perf_counter()
            outcome = driver.advance(state, budget, times, states)
            rows.collect(state, times, states)
            if outcome is Outcome.STEP_TOO_SMALL:
                # A step may shrink below the spacing of times without a rejection: then no trial step is to blame.
                return _STATUS[state.cause] if state.count(DriverState.AFTER_REJECT) else Status.STEP_TOO_SMALL
            if outcome is not Outcome.PAUSED:
                return _STATUS[outcome]
            if time.perf_counter() - before < BURST:
                burst = min(2 * burst, LARGEST_BURST)
            if problem.progress is not None:
                problem.progress(state.t)
    except KeyboardInterrupt:
        rows.collect(state, times, states)
        return Status.INTERRUPTED


def _closing(
    problem: Problem, step: StepProgram, name: str, state: DriverState, status: Status, parameters: FloatArray
) -> str:
    """Return the sentence for the end of a run, with the culprit found by taking the failed step again."""
    if status is Status.SINGULAR:
        detail = problem.model.singular_message(state.t, state.y)
        return message(status, problem, state.t, state.y, name, detail=detail)
    if status is not Status.NON_FINITE:
        return message(status, problem, state.t, state.y, name)
    return message(status, problem, state.t, _failed_state(problem, step, state, parameters), name)


def _failed_state(problem: Problem, step: StepProgram, state: DriverState, parameters: FloatArray) -> FloatArray:
    """Return the state that a step from the last accepted one leads to, with its entries that are not finite."""
    kernel, n = problem.model.kernel("rhs"), len(state.y) // 2
    h = float(state.reals[DriverState.STEP] or 4.0 * state.reals[DriverState.H])

    def f(t: float, y: FloatArray) -> FloatArray:
        slope = kernel(t, np.concatenate([y, np.zeros(n)]) if step.partitioned else y, parameters)
        return slope[n:] if step.partitioned else slope

    with np.errstate(all="ignore"):
        try:
            if step.partitioned:
                return np.concatenate(step.function(f, state.t, state.y[:n], state.y[n:], h))
            moved = step.function(f, state.t, state.y, h)
        except SingularMassMatrix:
            return state.y
    return np.asarray(moved if step.control is None else moved[0])
