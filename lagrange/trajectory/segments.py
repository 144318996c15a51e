"""Runs in segments, joined to one run: a new segment begins where parameters or contact modes change."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lagrange.algorithm.constants import EARLIEST
from lagrange.algorithm.events.constants import CLOSEST
from lagrange.errors import StatementError, listing
from lagrange.statement.event import Event
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.dense_output import OutputPath, PiecewisePath
from lagrange.trajectory.ending_messages import message, number
from lagrange.trajectory.events.end_messages import EventResult, accumulating, not_finite_after_reset
from lagrange.trajectory.events.event_log import MOST_REPEATS, ChangeCounter
from lagrange.trajectory.events.model_events import ALIKE, model_events
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.measures.conservation import energy
from lagrange.trajectory.trajectory import FloatArray, ParameterHistory, Status, Trajectory


def last_state(part: Trajectory) -> FloatArray:
    """Return the state (2n,) at the end of a run, from the dense output if the end is not an output time."""
    is_output = len(part.t) > 0 and part.t[-1] == part.span[1]
    return np.ascontiguousarray(part.y[:, -1] if is_output else part.dense(np.array([part.span[1]]))[:, 0])


def rest_of(problem: Problem, part: Trajectory, y: FloatArray) -> Problem:
    """Return the rest of a problem after its segment `part`, from the state `y` (2n,) on.

    The limits of the problem are reduced by the steps, wall time and events of the segment.
    """
    forward, begin = 1.0 if problem.t1 >= problem.t0 else -1.0, part.span[1]
    outputs = problem.t_eval
    if outputs is not None:
        outputs = outputs[forward * (outputs - begin) >= 0]
    wall = None if problem.max_wall is None else max(problem.max_wall - part.wall, 1e-3)
    events = list(problem.events)
    for i, times in enumerate(part.t_events):
        # The run ends at occurrence number `terminal`. Other events stay the same objects, so their plan is reused.
        count, terminal = int((forward * (times - begin) <= 0).sum()), events[i].terminal
        if (limit := max(terminal - count, min(terminal, 1))) != terminal:
            events[i] = replace(events[i], terminal=limit)
    return replace(
        problem,
        t0=begin,
        y0=y,
        t_eval=outputs,
        max_steps=max(problem.max_steps - part.steps - part.rejected, 1),
        max_wall=wall,
        events=tuple(events),
        began=time.perf_counter(),
        whole=problem.whole or problem,
    )


def joined(problem: Problem, parts: Sequence[Trajectory], note: str) -> Trajectory:
    """Return one run that joins the `parts` of a run in order. `note` is appended to the message of the last part."""
    first, last = parts[0], parts[-1]
    if len(parts) == 1 and problem.t_eval is None and not note:
        return first
    t, y = np.concatenate([part.t for part in parts]), np.concatenate([part.y for part in parts], axis=1)
    path = PiecewisePath(
        np.array([part.span[0] for part in parts] + [last.span[1]]), problem.y0, [part.dense for part in parts]
    )
    return replace(
        last,
        t=t,
        y=y,
        message=f"{last.message} {note}".rstrip(),
        method=first.method,
        steps=sum(part.steps for part in parts),
        rejected=sum(part.rejected for part in parts),
        evaluations=sum(part.evaluations for part in parts),
        wall=sum(part.wall for part in parts),
        span=(first.span[0], last.span[1]),
        dense=path if problem.t_eval is None else OutputPath(t, y, path),
        form=first.form,
        step=first.step,
        rtol=first.rtol,
        atol=first.atol,
        t_events=tuple(np.concatenate(times) for times in zip(*(part.t_events for part in parts), strict=True)),
        y_events=tuple(np.concatenate(states) for states in zip(*(part.y_events for part in parts), strict=True)),
    )


def run_in_segments(problem: Problem, run: Callable[[Problem], Trajectory]) -> Trajectory:
    """Return the run of a problem whose events set parameters. `run` runs a problem with constant parameters.

    An event that sets parameters ends a segment of the run. All resets at the time of the event are computed from the
    state and the parameters before the event.
    """
    # Each segment has the same event objects, so that methods prepare them once.
    # Events keep their resets, since an event with a direction and a reset is a contact. With constraints the reset is
    # left out, because the state after it has to satisfy the constraints with the new parameters.
    constrained = bool(problem.model.equations.constraints)
    ending = tuple(
        Event(event.expression, event.direction, 1, {} if constrained else event.reset) if event.settings else event
        for event in problem.events
    )
    segment, counter, acting = replace(problem, events=ending), ChangeCounter(), list[int]()
    parts, begins, values, added, tries = list[Trajectory](), [problem.t0], [problem.parameter_array], [0.0], 0
    while True:
        try:
            parts.append(run(segment))
        except StatementError as refusal:
            if not parts:
                raise
            parts.append(point_of(problem, parts[-1], segment.y0, Status.NON_FINITE, str(refusal)))
            break
        end, met = parts[-1].span[1], _acting(problem, parts[-1])
        # Rounding may make a segment end at once, by the event at which it began.
        again = bool(met) and set(met) <= set(acting) and not any(problem.events[i].reset for i in met)
        if tries < MOST_REPEATS and again and abs(end - segment.t0) <= CLOSEST * max(abs(end), EARLIEST):
            tries += 1
            segment = replace(segment, y0=last_state(parts.pop()))
            continue
        acting, tries = met, 0
        if not any(problem.events[i].settings for i in acting):
            break
        before = parts[-1].y_events[acting[0]][-1]
        y, parameters, result = _after_event(segment, problem, acting, end, before)
        if result.status is None and counter.accumulates(end, acting):
            result = accumulating(_name(problem, acting[0]))
        if result.status is not None:
            text = message(result.status, problem, end, before, parts[-1].method, cause=result.detail)
            parts[-1] = replace(parts[-1], status=result.status, message=text)
            break
        last = status_at_end(problem, parts)
        parts[-1] = before_outputs_at_end(problem, parts[-1])
        remainder = replace(rest_of(segment, parts[-1], y), parameters=parameters, step=parts[0].step)
        added.append(added[-1] + energy(remainder, y) - energy(segment, before))
        begins, values, segment = [*begins, end], [*values, remainder.parameter_array], remainder
        if last is not None:
            parts.append(point_of(problem, parts[-1], y, last))
            break
    step, chosen = parts[0].step, problem.step is None and len(parts) > 1
    note = f"No step was given: fixed steps of {number(step)} were taken." if chosen and step is not None else ""
    whole_run = joined(problem, parts, note)
    return replace(whole_run, history=ParameterHistory(np.array(begins), np.stack(values), np.array(added)))


def _acting(problem: Problem, part: Trajectory) -> list[int]:
    """Return the indices of the events at the end of the segment `part` that reset the state or set parameters."""
    if part.status not in (Status.EVENT, Status.SUCCESS):
        return []
    end = part.span[1]
    changing = [i for i, event in enumerate(problem.events) if event.reset or event.settings]
    return [i for i in changing if len(part.t_events[i]) and part.t_events[i][-1] == end]


def status_at_end(problem: Problem, parts: Sequence[Trajectory]) -> Status | None:
    """Return the status EVENT or SUCCESS if the run ends with the last of its `parts`, or None if it continues."""
    for i, event in enumerate(problem.events):
        if event.terminal and sum(len(part.t_events[i]) for part in parts) >= event.terminal:
            return Status.EVENT
    return Status.SUCCESS if parts[-1].span[1] == problem.t1 else None


def _after_event(
    segment: Problem, problem: Problem, acting: Sequence[int], t: float, before: FloatArray
) -> tuple[FloatArray, Mapping[Any, float], EventResult]:
    """Return the state (2n,) and the parameters after the events with indices `acting` at time t, and the result.

    The result ends the run if the reset is impossible. `before` (2n,) is the state before the events, and `segment` has
    the parameters before them. `problem` is the whole run, with all events.
    """
    model, y, events = problem.model, before.copy(), [problem.events[i] for i in acting]
    resets = model_events(model, events)
    for reset in resets:
        reset.apply(t, before, segment.parameter_array, y)
    parameters = dict(segment.parameters)
    for event in events:
        nodes = tuple(model.equations.translate(value) for value in event.settings.values())
        new_values = model.function("settings", nodes)(t, before, segment.parameter_array) if nodes else ()
        for symbol, value in zip(event.settings, map(float, new_values), strict=True):
            old = parameters[symbol]
            free = old == segment.parameters[symbol] or np.isclose(old, value, rtol=ALIKE, atol=0.0)
            parameters[symbol] = value if free else np.nan
    if not (np.isfinite(y).all() and np.isfinite(list(parameters.values())).all()):
        return y, parameters, not_finite_after_reset(listing(_name(problem, i) for i in acting))
    named = {row for reset in resets for row in reset.rows}
    follows = [row for row in model.equations.following if row not in named]
    y[follows] = 0.0
    try:
        array = model.parameter_array(parameters)
        return consistent_start(model, t, y, array), parameters, EventResult()
    except StatementError as refusal:
        return y, parameters, EventResult(Status.DIVERGED, f"The reset there is impossible: {refusal}")


def _name(problem: Problem, i: int) -> str:
    return problem.model.statement.quote(problem.events[i].expression)


def before_outputs_at_end(problem: Problem, part: Trajectory) -> Trajectory:
    """Return the segment `part` without the stored state after the event that ends it.

    Without output times, the state before the event is kept as the last one. With output times, no state at the time
    of the event is kept.
    """
    count = int(np.searchsorted(abs(part.t - part.span[0]), abs(part.span[1] - part.span[0])))
    count += problem.t_eval is None
    return replace(part, t=part.t[:count], y=part.y[:, :count])


def point_of(problem: Problem, part: Trajectory, y: FloatArray, status: Status, cause: str = "") -> Trajectory:
    """Return a part of zero duration after the segment `part`, with the state y (2n,) at the segment's end.

    `status` is the status of the run. `cause` is a sentence on the cause for its message, or "".
    """
    end, outputs = part.span[1], problem.t_eval is None or part.span[1] in problem.t_eval
    t = np.full(int(outputs), end)
    return replace(
        part,
        t=t,
        y=np.repeat(y[:, None], len(t), axis=1),
        status=status,
        message=message(status, problem, end, y, part.method, cause=cause),
        steps=0,
        rejected=0,
        evaluations=0,
        wall=0.0,
        span=(end, end),
        dense=PiecewisePath(np.array([end, end]), y, ()),
        t_events=tuple(times[:0] for times in part.t_events),
        y_events=tuple(states[:0] for states in part.y_events),
    )


def resting_part(segment: Problem, part: Trajectory) -> Trajectory:
    """Return a part of a run in which nothing moves, from the end of `part` to the end of `segment`."""
    t, (begin, end), y = segment.t_eval, (part.span[1], segment.t1), segment.y0
    t = np.array([begin, end]) if t is None else t
    return replace(
        point_of(segment, part, y, Status.SUCCESS),
        t=t,
        y=np.repeat(y[:, None], len(t), axis=1),
        message=message(Status.SUCCESS, segment, end, y, part.method),
        span=(begin, end),
        dense=PiecewisePath(np.array([begin, end]), y, ()),
    )
