"""Loop over the calls of a compiled driver in a run, with limits, events and Ctrl-C between the calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lagrange.algorithm.constants import AFTER_BROKEN
from lagrange.machine.backend import Driver, SingularMassMatrix, quickly
from lagrange.machine.state import DriverState, Outcome, Outputs
from lagrange.statement.run_settings import PreparationTooLongError, preparation, preparation_ends
from lagrange.trajectory.constraints.discontinuities import Discontinuities, may_be_discontinuous
from lagrange.trajectory.dense_output import MotionsPath, OutputPath, StepPath
from lagrange.trajectory.ending_messages import (
    UNPROJECTED,
    coarse,
    event_after_outputs,
    events_fill,
    limited,
    message,
    outputs_alone,
    unsolved,
    without_tolerance,
)
from lagrange.trajectory.endings import (
    DOMAIN_PROBE,
    dependent_ahead,
    lost_inertia,
    slope_ahead,
    table_left,
    until_dependent,
    until_discontinuity,
)
from lagrange.trajectory.events.end_messages import EventResult
from lagrange.trajectory.events.event_driver import EventDriver
from lagrange.trajectory.events.event_log import EventLog
from lagrange.trajectory.events.series_watch import SeriesWatch
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.events.time_switches import TimeSwitches
from lagrange.trajectory.integrator import Problem, memory_limit
from lagrange.trajectory.outputs import AcceptedStates, FollowedSteps
from lagrange.trajectory.plan import IdleDriver, PathFunction, Plan, Planned, PreparedPlan, StepPlan, Watcher, prepared
from lagrange.trajectory.sizes import raise_to_noise, survey
from lagrange.trajectory.slow_runs import Pace, compiled_late, limiting_entry
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

SECONDS_PER_CALL = 0.02
"""Duration in seconds of the steps between two checks of the clock, of the step limit and of Ctrl-C."""

FIRST_STEPS_PER_CALL, MOST_STEPS_PER_CALL = 64, 16384
"""Smallest and largest number of steps in a driver call. The smallest is for slow steps. The largest bounds the memory
for rows that may remain unused."""

MOST_GROWTH = 16
"""Factor on the number of steps per call if the next call would still be shorter than `SECONDS_PER_CALL`. Otherwise the
factor is 2. A call costs some 10 us, which is the time of 50 steps of a small system."""

_STATUS = {
    Outcome.NON_FINITE: Status.NON_FINITE,
    Outcome.SINGULAR: Status.SINGULAR,
    Outcome.STEP_TOO_SMALL: Status.STEP_TOO_SMALL,
    Outcome.DIVERGED: Status.DIVERGED,
    Outcome.UNPROJECTED: Status.DIVERGED,
}

NOTHING = np.empty(0)
"""Empty array of times, for an event that did not occur."""

GOES_ON, PASSED, REACHED = EventResult(), EventResult(jumped=True), EventResult(Status.SUCCESS)
"""Results of a driver call without events: continue, continue after a switch of the forces, or end of the run."""


def drive_by(method: Planned, problem: Problem) -> Trajectory:
    """Run a problem by the plan of a method and return its trajectory. The model keeps the plan for later runs."""
    return drive(problem, method.name, lambda: prepared(method, problem))


def drive(problem: Problem, name: str, prepare: Callable[[], PreparedPlan]) -> Trajectory:
    """Run a problem by the plan that `prepare` returns. `name` is the method's name in messages.

    `max_wall` limits the time of the preparation, and separately the time of the steps.
    """
    if not isinstance(problem, Problem) or problem.max_wall is None:  # the method refuses other arguments
        return _driven(problem, prepare(), name)
    try:
        with preparation(problem.began, problem.max_wall):
            return _driven(problem, prepare(), name)
    except PreparationTooLongError as late:
        return not_begun(problem, name, str(late))


def not_begun(problem: Problem, name: str, cause: str) -> Trajectory:
    """Return the trajectory without steps of a run that reached `max_wall` before its first step.

    `name` is the method's name. `cause` says in the message what took so long.
    """
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


def _driven(problem: Problem, prepared_plan: PreparedPlan, name: str) -> Trajectory:
    began = time.perf_counter()
    idle = prepared_plan.take(problem)
    run = _at_start(problem, prepared_plan.plan, name, idle, began)
    # The idle driver comes from a run with the same parameters, which already tested a constant mass matrix.
    inert = idle is None or not problem.model.equations.structure.constant_mass
    status, sentence = _check_first_slope(problem, name, problem.parameter_array, inertia=inert)
    steps, detail = None, ""
    if status is None and (late := compiled_late(problem)):
        status = Status.MAX_WALL
        sentence = message(status, problem, run.state.t, run.state.y, name, cause=late)
    if status is None:
        try:
            steps = run.plan.driver(problem.model, problem.parameter_array) if idle is None else idle.driver
            run.watch_events(steps, None if idle is None else idle.memory)
            late = compiled_late(problem)
            # Compilation serves many runs and is not counted.
            preparation_ends()
            run.began = time.perf_counter()
            per_call = max(FIRST_STEPS_PER_CALL, prepared_plan.steps if idle is None else idle.steps)
            status, detail = (Status.MAX_WALL, late) if late else run.advance_to_end(steps, per_call)
        except SingularMassMatrix:
            status, detail = Status.SINGULAR, ""
    try:
        trajectory = run.ended(status, detail, sentence)
    except KeyboardInterrupt:
        # Ctrl-C was pressed after the last step. Finish the trajectory again, without an explanation of its end.
        trajectory = run.ended(Status.INTERRUPTED, "", "")
    if steps is not None and trajectory.status is Status.SUCCESS:
        tried = min(trajectory.steps + trajectory.rejected + 2, MOST_STEPS_PER_CALL)
        tried = tried if trajectory.wall < SECONDS_PER_CALL else 0
        prepared_plan.give(problem, idle, steps, run.state, tried, run.watch)
    return trajectory


def _at_start(problem: Problem, plan: Plan, name: str, idle: IdleDriver | None, began: float) -> _Run:
    """Return the run of a problem before its first step.

    `plan` is the plan of the method, and `name` the method's name. `began` is the start of the steps by
    `time.perf_counter`. The run advances the state of the driver `idle`, which a former run used, or a new state if
    None.
    """
    tolerances, equations = plan.tolerances, problem.model.equations
    state = tolerances.begin(problem.t0, problem.t1, problem.y0) if idle is None else idle.state
    if problem.largest is not None:
        np.maximum(state.floors, state.reals[DriverState.SHARE] * problem.largest, out=state.floors)
    if equations.rates_are_solved and isinstance(plan, StepPlan):
        # The motion does not depend on these velocities. They may jump within a step, whose end is projected.
        state.floors[equations.following] = np.inf
    alone = problem.t_eval is not None and (plan.writes_outputs or isinstance(plan, StepPlan))
    if problem.t_eval is not None and plan.writes_outputs:
        state.outputs = Outputs(problem.t_eval, len(problem.y0))
    rows = AcceptedStates(problem.t0, problem.y0, outputs_alone=alone)
    if may_be_discontinuous(problem.model):
        rows.discontinuities = Discontinuities(problem.model, problem.parameter_array, problem.t1 - problem.t0)
    return _Run(problem, plan, name, state, rows, began)


def _check_first_slope(
    problem: Problem, name: str, parameters: FloatArray, *, inertia: bool
) -> tuple[Status | None, str]:
    """Return a status and a message if the right-hand side has no value at the start of a run, else None and "".

    `name` is the method's name. If `inertia` is True, the status is SINGULAR also for a coordinate that has no inertia
    at the start, even if the right-hand side is finite.
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


@dataclass(eq=False)
class _Run:
    """A run in progress: its problem, plan and method's name, the driver's state, and the accepted states `rows`.

    `began` is the start of the steps by `time.perf_counter`. `watch` finds events and switching surfaces and handles
    them; it is None without any.
    """

    problem: Problem
    plan: Plan
    name: str
    state: DriverState
    rows: AcceptedStates
    began: float
    watch: Watcher | None = None

    def watch_events(self, driver: Driver, memory: Any) -> None:
        """Watch events, times at which forces switch, and output times on the steps of `driver`.

        `memory` is the memory of the watcher of events in a former run by this driver, which is used again, or None.
        """
        problem, plan, rows = self.problem, self.plan, self.rows
        self.watch = watch = plan.watch(problem, driver, memory)
        if not isinstance(plan, StepPlan):
            return
        if plan.tolerances.rtol:
            rows.switches = TimeSwitches.of(problem, self.state, watch if isinstance(watch, StepWatch) else None)
        if problem.t_eval is not None:
            watcher: Any = rows.switches or watch
            breaks, path_of = None if watcher is None else watcher.breaks, partial(plan.path_of, problem)
            rows.followed = FollowedSteps(problem, problem.t_eval, path_of, breaks)

    def advance_to_end(self, driver: Driver, per_call: int) -> tuple[Status, str]:
        """Advance the run to its end. Return its status and cause. The first driver call takes `per_call` steps."""
        problem, state, rows, pace = self.problem, self.state, self.rows, Pace(self.problem)
        advance = EventDriver(driver, self.watch).advance if isinstance(self.watch, StepWatch) else driver.advance
        result = GOES_ON if self.watch is None else self.watch.begin(state)
        counts, memory = state.integers, memory_limit(problem)
        try:
            while True:
                # At some points the motion has no Taylor series, and continues by short steps of another method.
                watch = self.watch
                while result.smooth and isinstance(watch, SeriesWatch) and (past := watch.continue_past(state)):
                    result = past
                    if result.jumped:
                        rows.add(state.t, state.y)
                at_edge = result.smooth and result.status is Status.STEP_TOO_SMALL
                if at_edge and not np.isfinite(self.slope_ahead()).all():
                    return Status.NON_FINITE, ""
                if result.status is not None:
                    return result.status, result.detail
                tries = counts[DriverState.STEPS] + counts[DriverState.REJECTED]
                is_at_end, left = state.t == problem.t1, problem.max_steps - tries
                if left <= 0 and not is_at_end:
                    return Status.MAX_STEPS, ""
                if problem.max_wall is not None and time.perf_counter() - self.began > problem.max_wall:
                    return Status.MAX_WALL, ""
                free_rows = rows.make_room(memory - state.kept)
                if free_rows <= 0 and not is_at_end:
                    return Status.MAX_MEMORY, events_fill(problem) if rows.dropped else ""
                # At the end time one more step is allowed, with which the driver reports that it is done.
                budget = min(per_call, max(min(left, free_rows), 1), pace.next_test - tries)
                counts[DriverState.ROWS] = 0
                times, states = rows.begin_call(budget)
                before = time.perf_counter()
                outcome = advance(state, budget, times, states)
                rows.collect(state)
                if (passed := rows.discontinuity()) is not None:
                    self.record_events()
                    return Status.SINGULAR, passed.what
                result = self.after_call(outcome, pace)
                if result.jumped:
                    rows.add(state.t, state.y)
                seconds = time.perf_counter() - before
                if seconds < SECONDS_PER_CALL:
                    growth = MOST_GROWTH if MOST_GROWTH * seconds < SECONDS_PER_CALL else 2
                    per_call = min(growth * per_call, MOST_STEPS_PER_CALL)
                if problem.progress is not None:
                    problem.progress(state.t)
        except KeyboardInterrupt:
            rows.collect(state)
            self.record_events()
            return Status.INTERRUPTED, ""

    def record_events(self) -> None:
        """Record the events on all accepted steps when the loop ends early, for example by Ctrl-C."""
        if self.watch is not None:
            self.watch.is_due(self.state)

    def after_call(self, outcome: Outcome, pace: Pace) -> EventResult:
        """Return the result of a driver call that stopped with `outcome`: the run continues, ends, or has jumped.

        Events on the steps of the call are handled here. `pace` tests whether the run is slow.
        """
        state, watch, switches = self.state, self.watch, self.rows.switches
        if outcome is Outcome.DONE and switches is not None and switches.passes(state):
            return PASSED
        if watch is not None and outcome is Outcome.DONE:
            return watch.end(state)
        if watch is not None and (outcome is Outcome.WATCHED or watch.is_due(state)):
            return watch.process(state)
        if outcome is Outcome.DONE:
            return REACHED
        return pace.test(state, self.rows.parts, self.without_event(outcome))

    def without_event(self, outcome: Outcome) -> EventResult:
        """Return the result of a driver call that stopped with `outcome`, for another reason than an event.

        If the driver needs larger floors (least absolute tolerances), they are raised, and the run continues.
        """
        problem, state = self.problem, self.state
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

    def slope_ahead(self) -> FloatArray:
        """Return the right-hand side (2n,) after a short step from the driver's state along its slope."""
        problem, state = self.problem, self.state
        h = DOMAIN_PROBE * (float(state.reals[DriverState.END]) - problem.t0)
        return slope_ahead(problem.model, state.t, state.y, problem.parameter_array, h)

    def ended(self, status: Status, detail: str, sentence: str) -> Trajectory:
        """Return the trajectory of the run, which ended with `status`.

        `sentence` is its message. If it is empty, the message is made from the status and from the cause `detail`, or
        "".
        """
        problem, rows = self.problem, self.rows
        if not sentence:
            status, detail = self.singular_end(status, detail)
            sentence = self.final_sentence(status, detail)
        rows.follow(last=True)
        accepted = rows.joined()
        run = self.trajectory(*accepted, status, sentence)
        # The states of an interrupted run are not tested, because the user waits.
        tested = len(problem.model.equations.constraints) > 0 and status is not Status.INTERRUPTED
        if tested and not rows.dropped:
            run = until_dependent(problem, self.plan.tolerances.rtol, run, accepted)
        if rows.passed is not None:
            series = self.plan.writes_outputs and not rows.dropped
            run = until_discontinuity(problem, run, rows.passed, series=series)
        return run

    def singular_end(self, status: Status, detail: str) -> tuple[Status, str]:
        """Return SINGULAR and the cause if the equations are singular at the end of the run.

        Otherwise return `status` and `detail`, a sentence on the cause, unchanged.
        """
        problem, state = self.problem, self.state
        stuck = status in (Status.STEP_TOO_SMALL, Status.DIVERGED)
        given_up = status is Status.MAX_STEPS and len(problem.model.equations.constraints) > 0
        if not (stuck or given_up) or detail not in ("", UNPROJECTED):
            return status, detail
        message = lost_inertia(problem, state.t, state.y)
        step = 0.0 if self.plan.tolerances.rtol else float(state.reals[DriverState.STEP])
        if not message and stuck and self.rows.discontinuities is not None:
            message = self.rows.discontinuities.ahead(state.t, state.y, step)
        if not message and step and status is Status.DIVERGED:
            message = dependent_ahead(problem, state.t, state.y, step)
        return (Status.SINGULAR, message) if message else (status, detail)

    def final_sentence(self, status: Status, cause: str) -> str:
        """Return the message of a run that ended with `status`. `cause` is a sentence on the cause, or "" if unknown.

        For an unknown cause the failed step is examined: the equations may have no value near the end.
        """
        problem, state, tolerances, t, y = self.problem, self.state, self.plan.tolerances, self.state.t, self.state.y
        if status is Status.SUCCESS and not cause:
            return message(status, problem, t, y, self.name)
        sentence_for = partial(message, status, problem, method=self.name, rtol=tolerances.rtol or None)
        stuck = status in (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.DIVERGED)
        if stuck and (sentence := table_left(problem, t, y, float(state.reals[DriverState.STEP]))):
            return sentence_for(t, y, cause=sentence)
        if sentence := without_tolerance(problem, status, tolerances, y):
            return sentence_for(t, y, cause=sentence)
        given_up = status in (Status.MAX_STEPS, Status.MAX_WALL) and not cause and tolerances.share > 0
        if given_up and (which := limiting_entry(problem, state)):
            atol = float(state.floors[which[1]]) / tolerances.margin
            return sentence_for(t, y, cause=limited(problem, status, y, which, atol))
        if status is Status.SINGULAR and cause:
            return sentence_for(t, y, detail=cause)
        if (fault := state.fault) is not None and not cause:
            return sentence_for(fault.t, fault.y, slope=fault.slope, detail=fault.detail)
        if status is Status.SINGULAR:
            return sentence_for(t, y, detail=problem.model.singular_message(t, y, None, problem.parameter_array))
        if status is Status.DIVERGED and cause in ("", UNPROJECTED):
            return sentence_for(t, y, detail=cause or unsolved(state.reals[DriverState.RESIDUAL]))
        if status is not Status.NON_FINITE or cause:
            return sentence_for(t, y, cause=cause)
        # The first point without a value may lie several steps ahead.
        slope, h = self.slope_ahead(), float(state.reals[DriverState.STEP] or state.reals[DriverState.H] / AFTER_BROKEN)
        for reach in (1, 2, 4, 8):
            if np.isfinite(slope).all():
                slope = slope_ahead(problem.model, t, y, problem.parameter_array, reach * h)
        return sentence_for(t, y, slope=slope)

    def trajectory(self, times: FloatArray, states: FloatArray, status: Status, sentence: str) -> Trajectory:
        """Return the trajectory through accepted times (S+1,) and states (S+1, 2n), with a status and a message."""
        problem, tolerances, counts = self.problem, self.plan.tolerances, self.state.integers
        t, y, path = self.outputs(times, states)
        notes = [*tolerances.notes, *coarse(problem, status, states, tolerances)]
        if self.rows.dropped:
            notes.append(outputs_alone(problem))
        if status is Status.EVENT and problem.t_eval is not None and (not len(t) or t[-1] != times[-1]):
            notes.append(event_after_outputs(t))
        watched: EventLog | Watcher | None = self.watch
        if watched is None and problem.events:
            watched = EventLog(len(problem.events), len(problem.y0))
        return Trajectory(
            t=t,
            y=y,
            status=status,
            message=" ".join([sentence, *notes]),
            method=self.name,
            steps=counts[DriverState.STEPS],
            rejected=counts[DriverState.REJECTED],
            evaluations=counts[DriverState.EVALUATIONS] + 1,
            wall=time.perf_counter() - self.began,
            span=(float(times[0]), float(times[-1])),
            dense=path,
            form=self.plan.form,
            step=None if tolerances.rtol else tolerances.step,
            rtol=tolerances.rtol or None,
            atol=tolerances.atol if tolerances.rtol and not tolerances.share else None,
            t_events=() if watched is None else watched.t_events[: len(problem.events)],
            y_events=() if watched is None else watched.y_events[: len(problem.events)],
        )

    def outputs(self, times: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray, PathFunction]:
        """Return the output times (N,), the states (2n, N) at these times, and the dense output.

        The dense output returns exactly these states at the output times. `times` (S+1,) and `states` (S+1, 2n) are
        the accepted states.
        """
        problem, rows = self.problem, self.rows
        path = None if rows.dropped else self.plan.path(problem, times, states, self.watch)
        if self.watch is None and rows.switches is not None and isinstance(path, StepPath):
            path = MotionsPath(times, states, rows.switches.breaks.since(0), path)
        if problem.t_eval is None and path is not None:
            return times, states.T, path
        requested = times if problem.t_eval is None else problem.t_eval
        t = requested[(requested - times[-1]) * (1 if problem.t1 >= problem.t0 else -1) <= 0]
        # If outputs are written during the run, all remaining output times equal its end.
        if rows.followed is not None:
            y = rows.followed.joined(len(t), states[-1])
        elif self.plan.writes_outputs or path is None:
            y = self.state.outputs.joined(t, lambda _rest: states[-1:].T)
        else:
            y = path(t)
        return t, y, OutputPath(t, y, path, outputs_alone(problem) if path is None else "")
