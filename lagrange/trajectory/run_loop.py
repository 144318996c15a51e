"""Run a plan from start to end: calls of a compiled driver, with limits, events and Ctrl-C between the calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.calls import quickly
from lagrange.machine.state import DriverState, Outcome, Outputs
from lagrange.statement.run_settings import PreparationTooLongError, preparation, preparation_ends
from lagrange.trajectory.endings import (
    dependent_ahead,
    lost_inertia,
    rank_lost,
    slope_ahead,
    table_left,
    until_dependent,
    until_discontinuity,
)
from lagrange.trajectory.events.end_messages import EventResult
from lagrange.trajectory.events.event_log import EventLog
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.events.time_switches import TimeSwitches
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import (
    UNPROJECTED,
    coarse,
    event_behind_outputs,
    events_fill,
    limited,
    message,
    outputs_alone,
    unsolved,
    without_tolerance,
)
from lagrange.trajectory.outputs import AcceptedStates
from lagrange.trajectory.pace import Pace, compiled_late, limiting_entry, memory_limit
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.paths.step_paths import MotionsPath, StepPath
from lagrange.trajectory.plan import PathFunction, Plan, Planned, PreparedPlan, StepPlan, Watcher, prepared
from lagrange.trajectory.sizes import raise_to_noise, survey
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

SECONDS_PER_CALL = 0.02
"""Seconds of steps between two checks of the clock, the step limit and Ctrl-C."""

FIRST_STEPS_PER_CALL, MOST_STEPS_PER_CALL = 64, 16384
"""Numbers of steps per call of the driver: smallest and largest. The first is small because a step may be slow. The
largest bounds the memory for rows that may remain unused.
"""

MOST_GROWTH = 16
"""Largest factor on the steps per call, used if the next call would still be shorter than `SECONDS_PER_CALL`; else it
is 2. A call costs some 10 us, as much as 50 steps of a small system.
"""

_STATUS = {
    Outcome.NON_FINITE: Status.NON_FINITE,
    Outcome.SINGULAR: Status.SINGULAR,
    Outcome.STEP_TOO_SMALL: Status.STEP_TOO_SMALL,
    Outcome.DIVERGED: Status.DIVERGED,
    Outcome.UNPROJECTED: Status.DIVERGED,
}


NOTHING = np.empty(0)
"""Times and states before the first call of the driver: empty."""

GOES_ON, REACHED = EventResult(), EventResult(Status.SUCCESS)
"""Results of a driver call without events: continue; or the end is reached."""


def drive(problem: Problem, plan: Plan, name: str) -> Trajectory:
    """Run a problem by a plan and return its trajectory. `name` is the method's name in messages."""
    return _within_time(problem, name, lambda: PreparedPlan(plan))


def drive_by(method: Planned, problem: Problem, name: str) -> Trajectory:
    """Run a problem by the plan of a method and return its trajectory. The model keeps the plan for later runs."""
    return _within_time(problem, name, lambda: prepared(method, problem))


def _within_time(problem: Problem, name: str, prepare: Callable[[], PreparedPlan]) -> Trajectory:
    """Prepare and run a problem. The limit `max_wall` applies to the preparation, and again to the steps."""
    if not isinstance(problem, Problem) or problem.max_wall is None:  # the method checks its problem
        return _driven(problem, prepare(), name)
    try:
        with preparation(problem.began, problem.max_wall):
            return _driven(problem, prepare(), name)
    except PreparationTooLongError as late:
        return not_begun(problem, name, str(late))


def not_begun(problem: Problem, name: str, cause: str) -> Trajectory:
    """Return the trajectory of a run that reached `max_wall` before its first step, with its cause."""
    times = np.array([problem.t0])
    if problem.t_eval is not None:
        times = problem.t_eval[problem.t_eval == problem.t0]
    states = np.repeat(problem.y0[:, np.newaxis], len(times), axis=1)
    return Trajectory(
        t=times,
        y=states,
        status=Status.MAX_WALL,
        message=message(Status.MAX_WALL, problem, problem.t0, problem.y0, name, cause=cause),
        method=name,
        steps=0,
        rejected=0,
        evaluations=0,
        wall=0.0,
        span=(problem.t0, problem.t0),
        dense=OutputPath(np.array([problem.t0]), problem.y0[:, np.newaxis], None, "the run has no step."),
        t_events=(NOTHING,) * len(problem.events),
        y_events=(np.empty((0, len(problem.y0))),) * len(problem.events),
    )


def _driven(problem: Problem, kept: PreparedPlan, name: str) -> Trajectory:
    began = time.perf_counter()
    plan, parameters = kept.plan, problem.parameter_array
    tolerances, idle = plan.tolerances, kept.take(problem)
    state = tolerances.begin(problem.t0, problem.t1, problem.y0) if idle is None else idle.state
    if problem.largest is not None:
        np.maximum(state.floors, state.reals[DriverState.SHARE] * problem.largest, out=state.floors)
    alone = problem.t_eval is not None and (plan.writes_outputs or isinstance(plan, StepPlan))
    if problem.t_eval is not None and plan.writes_outputs:
        state.outputs = Outputs(problem.t_eval, len(problem.y0))
    rows = AcceptedStates(problem.t0, problem.y0, outputs_alone=alone)
    rows.look_at_constraints(problem.model, parameters, problem.t1 - problem.t0)
    # An idle driver has run with these parameters: a constant mass matrix is the same as then.
    inert = idle is None or not problem.model.equations.structure.constant_mass
    status, sentence = _check_first_slope(problem, name, parameters, inertia=inert)
    watch, detail = None, ""
    if status is None and (late := compiled_late(problem)):
        status, sentence = Status.MAX_WALL, message(Status.MAX_WALL, problem, state.t, state.y, name, cause=late)
    if status is None:
        try:
            steps = plan.driver(problem.model, parameters) if idle is None else idle.driver
            watch = plan.watch(problem, steps, None if idle is None else idle.memory)
            driver = steps if watch is None else watch.driver
            if isinstance(plan, StepPlan) and tolerances.rtol:
                rows.switches = TimeSwitches.of(problem, state, watch if isinstance(watch, StepWatch) else None)
            if problem.t_eval is not None and isinstance(plan, StepPlan):
                rows.followed = plan.followed(problem, problem.t_eval, rows.switches or watch)
            late = compiled_late(problem)
            # Compilation serves many runs and is not counted.
            preparation_ends()
            began = time.perf_counter()
            per_call = max(FIRST_STEPS_PER_CALL, kept.steps if idle is None else idle.steps)
            status, detail = (
                (Status.MAX_WALL, late)
                if late
                else _advance_to_end(problem, driver, watch, state, rows, began, per_call)
            )
        except SingularMassMatrix:
            status, detail = Status.SINGULAR, ""
    end = partial(_ended, problem, plan, state, rows, watch, name, began)
    try:
        run = end(status, detail, sentence)
    except KeyboardInterrupt:
        # Ctrl-C was pressed after the last step. Finish the trajectory again, without an explanation of its end.
        run = end(Status.INTERRUPTED, "", "")
    if run.status is Status.SUCCESS:
        tried = min(run.steps + run.rejected + 2, MOST_STEPS_PER_CALL)
        kept.give(problem, idle, steps, state, tried if run.wall < SECONDS_PER_CALL else 0, watch)
    return run


def _ended(
    problem: Problem,
    plan: Plan,
    state: DriverState,
    rows: AcceptedStates,
    watch: Watcher | None,
    name: str,
    began: float,
    status: Status,
    detail: str,
    sentence: str,
) -> Trajectory:
    """Return the trajectory of a run that has ended with a status, a `detail` for its message, and a last `sentence`.

    Both texts may be empty. `rows` are the accepted states, and `began` is the start by `perf_counter`.
    """
    if not sentence:
        status, detail = _why(problem, plan, state, rows, (status, detail))
        sentence = _final_sentence(problem, plan, name, state, status, detail)
    rows.follow(last=True)
    accepted = rows.joined()
    run = _trajectory(problem, plan, state, rows, accepted, watch, (name, status, sentence, began))
    # The states of an interrupted run are not tested, because the user waits.
    looked_at = len(problem.model.equations.constraints) > 0 and status is not Status.INTERRUPTED
    if looked_at and not rows.dropped:
        run = until_dependent(problem, plan.tolerances.rtol, run, accepted)
    if rows.passed is not None:
        series = plan.writes_outputs and not rows.dropped
        run = until_discontinuity(problem, run, rows.passed, series=series)
    return run


def _why(
    problem: Problem, plan: Plan, state: DriverState, rows: AcceptedStates, ended: tuple[Status, str]
) -> tuple[Status, str]:
    """Return the status and detail of the end of a run.

    The result is `ended`, or SINGULAR with a new detail if the equations are singular at the end.
    """
    status, detail = ended
    stuck = status in (Status.STEP_TOO_SMALL, Status.DIVERGED)
    given_up = status is Status.MAX_STEPS and len(problem.model.equations.constraints) > 0
    if not (stuck or given_up) or detail not in ("", UNPROJECTED):
        return ended
    message = lost_inertia(problem, state.t, state.y)
    step = 0.0 if plan.tolerances.rtol else float(state.reals[DriverState.STEP])
    if not message and stuck and rows.discontinuities is not None:
        message = rows.discontinuities.ahead(state.t, state.y, step)
    if not message and step and status is Status.DIVERGED:
        message = dependent_ahead(problem, state.t, state.y, step)
    return (Status.SINGULAR, message) if message else ended


def _trajectory(
    problem: Problem,
    plan: Plan,
    state: DriverState,
    rows: AcceptedStates,
    accepted: tuple[FloatArray, FloatArray],
    watch: Watcher | None,
    ended: tuple[str, Status, str, float],
) -> Trajectory:
    """Return the trajectory of a run. `ended` has the method's name, status, message and start by `perf_counter`."""
    name, status, sentence, began = ended
    tolerances, counts = plan.tolerances, state.integers
    times, states = accepted
    t, y, path = _outputs(problem, plan, state, rows, (times, states), watch)
    notes = [*tolerances.notes, *coarse(problem, status, states, tolerances)]
    if rows.dropped:
        notes.append(outputs_alone(problem))
    if status is Status.EVENT and problem.t_eval is not None and (not len(t) or t[-1] != times[-1]):
        notes.append(event_behind_outputs(t))
    watched: EventLog | Watcher | None = watch
    if watched is None and problem.events:
        watched = EventLog(len(problem.events), len(problem.y0))
    return Trajectory(
        t=t,
        y=y,
        status=status,
        message=" ".join([sentence, *notes]),
        method=name,
        steps=counts[DriverState.STEPS],
        rejected=counts[DriverState.REJECTED],
        evaluations=counts[DriverState.EVALUATIONS] + 1,
        wall=time.perf_counter() - began,
        span=(float(times[0]), float(times[-1])),
        dense=path,
        form=plan.form,
        step=None if tolerances.rtol else tolerances.step,
        rtol=tolerances.rtol or None,
        atol=tolerances.atol if tolerances.rtol and not tolerances.share else None,
        t_events=() if watched is None else watched.t_events[: len(problem.events)],
        y_events=() if watched is None else watched.y_events[: len(problem.events)],
    )


def _outputs(
    problem: Problem,
    plan: Plan,
    state: DriverState,
    rows: AcceptedStates,
    accepted: tuple[FloatArray, FloatArray],
    watch: Any,
) -> tuple[FloatArray, FloatArray, PathFunction]:
    """Return the output times (N,), the states there (2n, N), and a dense output that returns exactly these states."""
    times, states = accepted
    path = None if rows.dropped else plan.path(problem, times, states, watch)
    if watch is None and rows.switches is not None and isinstance(path, StepPath):
        path = MotionsPath(times, states, rows.switches.breaks.since(0), path)
    if problem.t_eval is None and path is not None:
        return times, states.T, path
    requested = times if problem.t_eval is None else problem.t_eval
    t = requested[(requested - times[-1]) * (1 if problem.t1 >= problem.t0 else -1) <= 0]

    def at_end(_rest: FloatArray) -> FloatArray:
        return states[-1:].T

    # If outputs are written during the run, all remaining output times equal its end.
    if rows.followed is not None:
        y = rows.followed.joined(len(t), states[-1])
    elif plan.writes_outputs or path is None:
        y = state.outputs.joined(t, at_end)
    else:
        y = path(t)
    return t, y, OutputPath(t, y, path, outputs_alone(problem) if path is None else "")


def _check_first_slope(
    problem: Problem, name: str, parameters: FloatArray, *, inertia: bool
) -> tuple[Status | None, str]:
    """Return a status and message if the right-hand side has no value at the start, else None and "".

    With `inertia`, coordinates without inertia are also searched for.
    """
    model, y0 = problem.model, problem.y0
    kernel = model.kernel("rhs")
    try:
        singular = inertia and model.column_without_inertia(problem.t0, *model.layout.split(y0), parameters) is not None
        if not singular and quickly(kernel, parameters, problem.t0, y0) is not None:
            return None, ""
        slope = y0 if singular else kernel(problem.t0, y0, parameters)
    except SingularMassMatrix:
        singular, slope = True, y0
    if singular:
        detail = model.singular_message(problem.t0, y0, None, parameters)
        return Status.SINGULAR, message(Status.SINGULAR, problem, problem.t0, y0, name, detail=detail)
    if not np.isfinite(slope).all():
        cause = table_left(problem, problem.t0, y0)
        return Status.NON_FINITE, message(Status.NON_FINITE, problem, problem.t0, y0, name, slope=slope, cause=cause)
    return None, ""


def _advance_to_end(
    problem: Problem,
    driver: Driver,
    watch: Watcher | None,
    state: DriverState,
    rows: AcceptedStates,
    began: float,
    per_call: int,
) -> tuple[Status, str]:
    """Advance until the run ends, and return its status and a detail; the first call takes `per_call` steps."""
    limit, counts, dimension = memory_limit(problem), state.integers, len(problem.y0)
    times, states, call, pace = NOTHING, NOTHING, 0, Pace(problem)
    result = GOES_ON if watch is None else watch.begin(state)
    try:
        while True:
            while result.smooth and watch is not None and (onwards := watch.continue_past(state)) is not None:
                result = onwards
                if result.jumped:
                    rows.add(state.t, state.y)
            stuck = result.status is Status.STEP_TOO_SMALL and result.smooth
            if stuck and not np.isfinite(_slope_ahead(problem, state)).all():
                return Status.NON_FINITE, ""
            if result.status is not None:
                return result.status, result.detail
            left = problem.max_steps - (tries := counts[DriverState.STEPS] + counts[DriverState.REJECTED])
            if state.t != problem.t1 and left <= 0:
                return Status.MAX_STEPS, ""
            if problem.max_wall is not None and time.perf_counter() - began > problem.max_wall:
                return Status.MAX_WALL, ""
            room = rows.make_room(limit - state.kept)
            if state.t != problem.t1 and room <= 0:
                return Status.MAX_MEMORY, events_fill(problem) if rows.dropped else ""
            budget = min(per_call, left, room, pace.next_look - tries) if left > 0 and room > 0 else 1
            # Resets are rows, too: each turn of the driver's loop writes a step or a reset, and finally the last step.
            times, states = np.empty(budget + 1), np.empty((budget + 5, dimension))
            counts[DriverState.ROWS] = 0
            call += 1
            before = time.perf_counter()
            outcome = driver.advance(state, budget, times, states)
            rows.collect(state, times, states, call)
            if lost := _lost_on_the_way(problem, rows, state):
                return Status.SINGULAR, _taken_over(watch, state, lost)
            if outcome is Outcome.DONE and rows.switches is not None and rows.switches.passes(state):
                rows.add(state.t, state.y)
                result = GOES_ON
            elif watch is not None and (outcome in (Outcome.WATCHED, Outcome.DONE) or watch.is_due(state)):
                result = watch.end(state) if outcome is Outcome.DONE else watch.process(state)
                if result.jumped:
                    rows.add(state.t, state.y)
            elif outcome is Outcome.DONE:
                result = REACHED
            else:
                result = pace.look(state, rows.parts, _after_call(problem, outcome, state))
            taken = time.perf_counter() - before
            per_call = per_call if taken >= SECONDS_PER_CALL else _more(per_call, taken)
            if problem.progress is not None:
                problem.progress(state.t)
    except KeyboardInterrupt:
        rows.collect(state, times, states, call)
        return Status.INTERRUPTED, _taken_over(watch, state)


def _more(per_call: int, taken: float) -> int:
    """Return the number of steps of the next call, after a call of `per_call` steps that took `taken` seconds."""
    growth = MOST_GROWTH if MOST_GROWTH * taken < SECONDS_PER_CALL else 2
    return min(growth * per_call, MOST_STEPS_PER_CALL)


def _lost_on_the_way(problem: Problem, rows: AcceptedStates, state: DriverState) -> str:
    """Return a sentence if the new states passed a discontinuity, or approach dependent constraints; else ""."""
    rows.passed = rows.discontinuity()
    if rows.passed is not None:
        return rows.passed.what
    ended = None if rows.approach is None else rows.approach.ends(state)
    return "" if ended is None else rank_lost(problem, state.y, *ended)


def _after_call(problem: Problem, outcome: Outcome, state: DriverState) -> EventResult:
    """Return the result of a driver call that ended early without an event. Raise floors if the driver asks for it."""
    if outcome is Outcome.PAUSED:
        return GOES_ON
    if outcome is Outcome.UNSCALED:
        survey(problem.model, problem.parameter_array, state)
        return GOES_ON
    if outcome is Outcome.BROKEN:
        return EventResult(state.fault.status)
    if outcome is Outcome.STEP_TOO_SMALL:
        if raise_to_noise(problem.model, problem.parameter_array, state):
            return GOES_ON
        # A step may become shorter than the spacing of times without a rejection: then no trial step is the cause.
        cause = state.cause if state.count(DriverState.AFTER_REJECT) else outcome
        return EventResult(_STATUS[cause], "" if cause is not Outcome.UNPROJECTED else UNPROJECTED, smooth=True)
    if outcome is Outcome.UNPROJECTED:
        return EventResult(_STATUS[outcome], UNPROJECTED)
    return EventResult(_STATUS[outcome], smooth=outcome is Outcome.NON_FINITE)


def _taken_over(watch: Watcher | None, state: DriverState, detail: str = "") -> str:
    """Record the events on all rows when the loop ends early, for example by Ctrl-C. Return `detail`."""
    if watch is not None:
        watch.is_due(state)
    return detail


def _final_sentence(problem: Problem, plan: Plan, name: str, state: DriverState, status: Status, cause: str) -> str:
    """Return the message of the end of a run. A failed step is repeated to find its cause."""
    if status is Status.SUCCESS and not cause:
        return message(status, problem, state.t, state.y, name)
    told = partial(message, status, problem, rtol=plan.tolerances.rtol or None)
    stuck = status in (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.DIVERGED)
    if stuck and (sentence := table_left(problem, state.t, state.y, float(state.reals[DriverState.STEP]))):
        return told(state.t, state.y, name, cause=sentence)
    if sentence := without_tolerance(problem, status, plan.tolerances, state.y):
        return told(state.t, state.y, name, cause=sentence)
    given_up = status in (Status.MAX_STEPS, Status.MAX_WALL) and not cause and plan.tolerances.share > 0
    if given_up and (which := limiting_entry(problem, state)):
        atol = float(state.floors[which[1]]) / plan.tolerances.margin
        return told(state.t, state.y, name, cause=limited(problem, status, state.y, which, atol))
    if status is Status.SINGULAR and cause:
        return told(state.t, state.y, name, detail=cause)
    if (fault := state.fault) is not None and not cause:
        return told(fault.t, fault.y, name, slope=fault.slope, detail=fault.detail)
    if status is Status.SINGULAR:
        detail = problem.model.singular_message(state.t, state.y, None, problem.parameter_array)
        return told(state.t, state.y, name, detail=detail)
    if status is Status.DIVERGED and cause not in ("", UNPROJECTED):
        return told(state.t, state.y, name, cause=cause)
    if status is Status.DIVERGED:
        return told(state.t, state.y, name, detail=cause or unsolved(state.reals[DriverState.RESIDUAL]))
    if status is not Status.NON_FINITE or cause:
        return told(state.t, state.y, name, cause=cause)
    return told(state.t, plan.failed(problem, state), name, slope=_slope_ahead(problem, state))


def _slope_ahead(problem: Problem, state: DriverState) -> FloatArray:
    """Return the right-hand side (2n,) a little ahead of the state of a driver, by `slope_ahead`."""
    length = float(state.reals[DriverState.END]) - problem.t0
    return slope_ahead(problem.model, state.t, state.y, problem.parameter_array, length)
