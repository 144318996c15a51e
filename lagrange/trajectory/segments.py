"""Runs whose events set parameters: each such event ends a segment, and the next begins with the new parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.errors import StatementError, formula, listing
from lagrange.procedure.events.constants import CLOSEST
from lagrange.procedure.step.constants import EARLIEST
from lagrange.statement.event import Event
from lagrange.trajectory.conservation import energy
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.events.actions import ALIKE, impacts
from lagrange.trajectory.events.ending import EventResult, accumulating, nowhere
from lagrange.trajectory.events.event_log import MOST_REPEATS, ChangeCounter
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message, number
from lagrange.trajectory.parameter_history import ParameterHistory
from lagrange.trajectory.parts import joined, last_state, rest_of
from lagrange.trajectory.paths.piecewise import PiecewisePath
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory


@dataclass(frozen=True, eq=False)
class _Behind:
    """The state (2n,) and the parameters behind an event, and how the run ends where these are none."""

    y: FloatArray
    parameters: Mapping[Any, float]
    result: EventResult


def run_in_segments(problem: Problem, run: Callable[[Problem], Trajectory]) -> Trajectory:
    """Return the run of a problem whose events set parameters; `run` runs a problem with constant parameters.

    An event that sets parameters ends a segment. All resets at its time are computed from the state and the parameters
    before it.
    """
    # The same events in each segment: what methods prepare for them is kept.
    ending = tuple(_ending(event, problem) if event.settings else event for event in problem.events)
    segment, counter, acting = replace(problem, events=ending), ChangeCounter(), list[int]()
    parts, begins, values, added, tries = list[Trajectory](), [problem.t0], [problem.parameter_array], [0.0], 0
    while True:
        try:
            parts.append(run(segment))
        except StatementError as refusal:
            if not parts:
                raise
            parts.append(_point(problem, parts[-1], segment.y0, Status.NON_FINITE, str(refusal)))
            break
        end, met = parts[-1].span[1], _acting(problem, parts[-1])
        if tries < MOST_REPEATS and set(met) <= set(acting) and _is_begin(problem, met, segment.t0, end):
            tries += 1
            segment = replace(segment, y0=last_state(parts.pop()))
            continue
        acting, tries = met, 0
        if not any(problem.events[i].settings for i in acting):
            break
        before = parts[-1].y_events[acting[0]][-1]
        behind = _behind(segment, problem, acting, end, before)
        if behind.result.status is None and counter.accumulates(end, acting):
            behind = replace(behind, result=accumulating(_name(problem, acting[0])))
        if behind.result.status is not None:
            told = message(behind.result.status, problem, end, before, parts[-1].method, cause=behind.result.detail)
            parts[-1] = replace(parts[-1], status=behind.result.status, message=told)
            break
        last = _last(problem, parts)
        parts[-1] = _before_outputs_at_end(problem, parts[-1])
        rest = rest_of(segment, parts[-1:], end, behind.y)
        rest = replace(rest, parameters=behind.parameters, t_eval=_outputs_from(problem, end), step=parts[0].step)
        added.append(added[-1] + energy(rest, behind.y) - energy(segment, before))
        begins, values, segment = [*begins, end], [*values, rest.parameter_array], rest
        if last is not None:
            parts.append(_point(problem, parts[-1], behind.y, last))
            break
    found = joined(problem, parts, _told(problem, parts), both_at_joints=True)
    return replace(found, history=ParameterHistory(np.array(begins), np.stack(values), np.array(added)))


def _ending(event: Event, problem: Problem) -> Event:
    """Return an event that sets parameters as one that ends a segment.

    Its reset makes it a contact. States behind a reset meet constraints with the new parameters, not with the old.
    """
    reset = {} if problem.model.equations.constraints else event.reset
    return Event(event.expression, event.direction, 1, reset)


def _acting(problem: Problem, part: Trajectory) -> list[int]:
    """Return the events with resets, by number, at the end of a segment."""
    if part.status not in (Status.EVENT, Status.SUCCESS):
        return []
    end = part.span[1]
    changing = [i for i, event in enumerate(problem.events) if event.reset or event.settings]
    return [i for i in changing if len(part.t_events[i]) and part.t_events[i][-1] == end]


def _is_begin(problem: Problem, met: Sequence[int], begin: float, end: float) -> bool:
    """Return whether events that have begun a segment and end it are one zero, which rounding leaves ahead of it."""
    moved = any(problem.events[i].reset for i in met)
    return bool(met) and not moved and abs(end - begin) <= CLOSEST * max(abs(end), EARLIEST)


def _last(problem: Problem, parts: Sequence[Trajectory]) -> Status | None:
    """Return the status of a run that ends with these segments, or None."""
    for i, event in enumerate(problem.events):
        if event.terminal and sum(len(part.t_events[i]) for part in parts) >= event.terminal:
            return Status.EVENT
    return Status.SUCCESS if parts[-1].span[1] == problem.t1 else None


def _behind(segment: Problem, problem: Problem, acting: Sequence[int], t: float, before: FloatArray) -> _Behind:
    """Return the state and the parameters behind the events that act at a time."""
    model, y, resets = problem.model, before.copy(), [problem.events[i] for i in acting]
    for impact in impacts(model, resets, segment.parameter_array):
        impact.apply(t, before, y)
    parameters = dict(segment.parameters)
    for event in resets:
        nodes = tuple(model.equations.translate(value) for value in event.settings.values())
        found = model.function("settings", nodes)(t, before, segment.parameter_array) if nodes else ()
        for symbol, value in zip(event.settings, map(float, found), strict=True):
            old = parameters[symbol]
            free = old == segment.parameters[symbol] or np.isclose(old, value, rtol=ALIKE, atol=0.0)
            parameters[symbol] = value if free else np.nan
    if not (np.isfinite(y).all() and np.isfinite(list(parameters.values())).all()):
        return _Behind(y, parameters, nowhere(listing(_name(problem, i) for i in acting)))
    named = {row for impact in impacts(model, resets, segment.parameter_array) for row in impact.rows}
    follows = [row for row in (model.layout.v.start + i for i in model.equations.first_order) if row not in named]
    y[follows] = 0.0
    try:
        array = model.parameter_array(parameters)
        return _Behind(consistent_start(model, t, y, array), parameters, EventResult())
    except StatementError as refusal:
        return _Behind(y, parameters, EventResult(Status.DIVERGED, f"The reset there is impossible: {refusal}"))


def _told(problem: Problem, parts: Sequence[Trajectory]) -> str:
    """Return the note on the step of the first segment, where the user left it to the method; the others have it."""
    step = parts[0].step
    if problem.step is not None or step is None or len(parts) == 1:
        return ""
    return f"No step was given: equal steps of {number(step)} were taken."


def _name(problem: Problem, i: int) -> str:
    return formula(problem.events[i].expression.xreplace(dict(problem.model.statement.plain)), 80)


def _before_outputs_at_end(problem: Problem, part: Trajectory) -> Trajectory:
    """Return a segment that ends at an event with one state there, that before, or without it at an output time."""
    count = int(np.searchsorted(abs(part.t - part.span[0]), abs(part.span[1] - part.span[0])))
    count += problem.t_eval is None
    return replace(part, t=part.t[:count], y=part.y[:, :count])


def _outputs_from(problem: Problem, begin: float) -> FloatArray | None:
    """Return the output times from a time on."""
    forward = 1.0 if problem.t1 >= problem.t0 else -1.0
    return None if problem.t_eval is None else problem.t_eval[forward * (problem.t_eval - begin) >= 0]


def _point(problem: Problem, part: Trajectory, y: FloatArray, status: Status, cause: str = "") -> Trajectory:
    """Return the end of a run behind a segment, a state alone."""
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
