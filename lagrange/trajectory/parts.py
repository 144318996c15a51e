"""Runs in parts: over configurations where constraints become dependent, and over changes of parameters."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.algorithm.events.constants import CLOSEST
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.errors import StatementError, listing
from lagrange.statement.event import Event
from lagrange.trajectory.constraints.approach import NEAR, Independence, regularity
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.constraints.discontinuities import may_be_discontinuous
from lagrange.trajectory.events.actions import ALIKE, impacts
from lagrange.trajectory.events.end_messages import EventResult, accumulating, nowhere
from lagrange.trajectory.events.event_log import MOST_REPEATS, ChangeCounter
from lagrange.trajectory.integrator import Integrator, Problem, run_by
from lagrange.trajectory.measures.conservation import energy
from lagrange.trajectory.messages import message, number
from lagrange.trajectory.methods.explicit import RK4
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.paths.piecewise import PiecewisePath
from lagrange.trajectory.trajectory import FloatArray, ParameterHistory, Status, Trajectory, run_until


def last_state(part: Trajectory) -> FloatArray:
    """Return the state (2n,) at the end of a run, from the dense output if the end is not an output time."""
    known = len(part.t) > 0 and part.t[-1] == part.span[1]
    return np.ascontiguousarray(part.y[:, -1] if known else part.dense(np.array([part.span[1]]))[:, 0])


def rest_of(
    problem: Problem, parts: Sequence[Trajectory], begin: float, y: FloatArray, *, output_at_begin: bool = False
) -> Problem:
    """Return the rest of a problem from the time `begin` and the state `y` (2n,) on.

    The steps, wall time and events of the `parts` so far are subtracted from its limits. An output time that is
    `begin` is kept only if `output_at_begin`.
    """
    forward = 1.0 if problem.t1 >= problem.t0 else -1.0
    outputs = problem.t_eval
    if outputs is not None:
        ahead = forward * (outputs - begin)
        outputs = outputs[ahead >= 0 if output_at_begin else ahead > 0]
    steps = sum(part.steps + part.rejected for part in parts)
    wall = None if problem.max_wall is None else max(problem.max_wall - sum(part.wall for part in parts), 1e-3)
    times = [np.concatenate(times) for times in zip(*(part.t_events for part in parts), strict=True)]
    seen = [int((forward * (each - begin) <= 0).sum()) for each in times]
    return replace(
        problem,
        t0=begin,
        y0=y,
        t_eval=outputs,
        max_steps=max(problem.max_steps - steps, 1),
        max_wall=wall,
        events=tuple(_counted(event, count) for event, count in zip(problem.events, seen, strict=True)),
        began=time.perf_counter(),
        whole=problem.whole or problem,
    )


def _counted(event: Event, count: int) -> Event:
    """Return an event whose limit `terminal` is reduced by the number of its occurrences so far.

    The event itself is returned if its limit stays: methods prepare an event object once.
    """
    limit = max(event.terminal - count, min(event.terminal, 1))
    return event if limit == event.terminal else replace(event, terminal=limit)


def joined(
    problem: Problem, parts: Sequence[Trajectory], note: str = "", *, both_at_joints: bool = False
) -> Trajectory:
    """Return the parts of a run joined to one run, with a note after its message.

    Without output times the last state of a part and the first of the next may have the same time. The second is
    dropped, unless `both_at_joints`.
    """
    first, last = parts[0], parts[-1]
    t, y = np.concatenate([part.t for part in parts]), np.concatenate([part.y for part in parts], axis=1)
    if problem.t_eval is None and not both_at_joints:
        new = np.append(True, np.diff(t) != 0)
        t, y = t[new], y[:, new]
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


FAR = 0.03
"""Least singular value of the constraints at which equal steps begin, as a fraction of the value at the start.

Rounding errors of velocities are 1e-13 there."""

FIRST_DISTANCE, FARTHER = 1e-6, 1.5
"""First distance from the end at which that place is searched, as a fraction of the run, and its growth factor."""

SAMPLES, NEAREST_SAMPLE = 8, 0.25
"""Number of singular values whose extrapolated zero is the crossing, and the nearest of them.

They are taken between that distance and this fraction of it before the end.
"""

OFFSET = 0.3
"""Fraction of a step at which the crossing lies, away from the stages of rk4 at 0, 1/2 and 1."""

FEWEST_STEPS, DOUBLINGS = 8, 6
"""First number of steps to the crossing, and the most numbers that are tried, each twice the one before.

The search ends if two successive results agree to the tolerance, or better than the next two. With 64 and 128 steps
errors were 1e-13 to 1e-12.
"""

AGREEMENT, LEAST_AGREEMENT = 10.0, 1e-11
"""Largest accepted difference of two results: multiple of rtol, and least value, which is rounding noise.

It is relative to the largest coordinate, and to the largest velocity.
"""

MOST_NAMED = 3
"""Largest number of crossings, and of constraints, that a note names."""

MOST_CROSSINGS = 1000
"""Largest number of crossings that one run passes."""

ENDS = (Status.SINGULAR, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""Statuses of a run that ends before a crossing."""


@dataclass(frozen=True, eq=False)
class _Crossing:
    """A configuration where motions cross because constraints become dependent.

    Equal steps begin at the time `begin` in the state `y` (2n,). Motions cross at `time`, where the constraints `names`
    are dependent.
    """

    begin: float
    y: FloatArray
    time: float
    names: tuple[str, ...]


def run_over_crossings(integrator: Integrator, problem: Problem) -> Trajectory:
    """Run a problem by a method; a method with error control passes crossings of motions by equal steps of rk4."""
    found = run_by(integrator, problem)
    constrained = len(problem.model.equations.constraints) > 0
    if not constrained or found.status not in ENDS or not found.rtol or may_be_discontinuous(problem.model):
        return found
    parts, crossings = [found], list[_Crossing]()
    while len(crossings) < MOST_CROSSINGS and parts[-1].status in ENDS:
        crossing = _crossing_at_end(problem, parts[-1])
        if crossing is None:
            break
        over = _led_over(rest_of(problem, parts, crossing.begin, crossing.y), crossing, found.rtol)
        if over is None:
            break
        crossings.append(crossing)
        parts = [*parts[:-1], run_until(parts[-1], crossing.begin), over]
        if over.status is Status.SUCCESS and over.span[1] != problem.t1:
            parts.append(run_by(integrator, rest_of(problem, parts, over.span[1], last_state(over))))
    if not crossings:
        return found
    whole = joined(problem, parts, _crossed(crossings))
    return whole if problem.t_eval is not None else replace(whole, steps=len(whole.t) - 1)


def _crossing_at_end(problem: Problem, part: Trajectory) -> _Crossing | None:
    """Return the crossing before which a run ended, or None without a crossing or without dense output."""
    path = part.dense.path if isinstance(part.dense, OutputPath) else part.dense
    (begin, end), near = part.span, Independence(problem.model, problem.parameter_array, (problem.t0, problem.y0))
    if path is None or near.at(end, last_state(part)) > NEAR:
        return None

    def values(times: list[float]) -> FloatArray:
        return np.array([near.at(t, y) for t, y in zip(times, part.dense(np.array(times)).T, strict=True)])

    distance = FIRST_DISTANCE * (end - problem.t0)
    while abs(distance) < abs(end - begin) and values([end - distance])[0] < FAR:
        distance *= FARTHER
    shares = np.linspace(1.0, NEAREST_SAMPLE, SAMPLES)
    if not abs(distance) < abs(end - begin):
        return None
    polynomial = np.polyfit(shares, values((end - shares * distance).tolist()), 3)
    roots = [root.real for root in np.roots(polynomial) if abs(root.imag) < NEAREST_SAMPLE]
    if not roots or min(map(abs, roots)) > NEAREST_SAMPLE:
        return None
    found = regularity(problem.model, problem.parameter_array, near.start, (end, last_state(part)))
    if found is None or not found[1].rows:
        return None
    names = tuple(problem.model.equations.constraints.names[i] for i, _ in found[1].rows)
    at_begin = np.ascontiguousarray(part.dense(np.array([end - distance]))[:, 0])
    return _Crossing(end - distance, at_begin, end - min(roots, key=abs) * distance, names)


def _led_over(rest: Problem, crossing: _Crossing, rtol: float) -> Trajectory | None:
    """Return the run by equal steps over a crossing, or None if no two step lengths agree."""
    before, best, least = None, None, math.inf
    for way in _ways(rest, crossing):
        apart = math.inf if before is None else _apart(rest, before, way)
        if apart > least:
            break
        best, least, before = way, apart, way
        if apart <= rtol:
            break
    return best if least <= max(AGREEMENT * rtol, LEAST_AGREEMENT) else None


def _ways(rest: Problem, crossing: _Crossing) -> Iterator[Trajectory]:
    """Yield runs over a crossing by equal steps, each with half the step of the one before."""
    ahead = crossing.time - crossing.begin
    end = crossing.begin + 2.0 * ahead
    end = min(end, rest.t1) if ahead > 0 else max(end, rest.t1)
    wanted = rest.t_eval
    outputs = None if wanted is None else wanted[np.abs(wanted - crossing.begin) <= abs(end - crossing.begin)]
    for doubling in range(DOUBLINGS):
        step = abs(ahead) / (FEWEST_STEPS * 2**doubling + OFFSET)
        yield RK4().integrate(replace(rest, t1=end, t_eval=outputs, step=step, rtol=None, atol=None))


def _apart(rest: Problem, one: Trajectory, other: Trajectory) -> float:
    """Return the distance of the ends of two runs, relative to the largest coordinate, and velocity.

    It is infinite if one of them failed.
    """
    if not (one.status.complete and one.status is other.status):
        return math.inf
    a, b = (rest.model.layout.split(last_state(part)) for part in (one, other))
    return max(float(np.abs(x - y).max() / (np.abs(y).max() or 1.0)) for x, y in zip(a, b, strict=True))


def _crossed(crossings: Sequence[_Crossing]) -> str:
    """Return the note on a run over crossings."""
    places = [f"t = {number(one.time)}" for one in crossings[:MOST_NAMED]]
    places += [f"{len(crossings) - MOST_NAMED} later times"] * (len(crossings) > MOST_NAMED)
    names = list(map(repr, crossings[0].names[:MOST_NAMED]))
    names += [f"{len(crossings[0].names) - MOST_NAMED} more"] * (len(crossings[0].names) > MOST_NAMED)
    return (
        f"Equal steps of rk4 led over {listing(places)}, where constraints become dependent and other motions cross: "
        f"{listing(names)}."
    )


@dataclass(frozen=True, eq=False)
class _Behind:
    """The state `y` (2n,) and the parameters after an event. `result` ends the run if the reset is impossible."""

    y: FloatArray
    parameters: Mapping[Any, float]
    result: EventResult


def run_in_segments(problem: Problem, run: Callable[[Problem], Trajectory]) -> Trajectory:
    """Return the run of a problem whose events set parameters; `run` runs a problem with constant parameters.

    An event that sets parameters ends a segment. All resets at its time are computed from the state and the parameters
    before it.
    """
    # Each segment has the same event objects, so methods prepare them once.
    ending = tuple(_ending(event, problem) if event.settings else event for event in problem.events)
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
        last = status_at_end(problem, parts)
        parts[-1] = before_outputs_at_end(problem, parts[-1])
        rest = rest_of(segment, parts[-1:], end, behind.y, output_at_begin=True)
        rest = replace(rest, parameters=behind.parameters, step=parts[0].step)
        added.append(added[-1] + energy(rest, behind.y) - energy(segment, before))
        begins, values, segment = [*begins, end], [*values, rest.parameter_array], rest
        if last is not None:
            parts.append(point_of(problem, parts[-1], behind.y, last))
            break
    found = joined(problem, parts, _told(problem, parts), both_at_joints=True)
    return replace(found, history=ParameterHistory(np.array(begins), np.stack(values), np.array(added)))


def _ending(event: Event, problem: Problem) -> Event:
    """Return an event that sets parameters as a terminal event, which ends a segment.

    Its reset marks it as a contact. With constraints the reset is left out: the state after it must satisfy them with
    the new parameters.
    """
    reset = {} if problem.model.equations.constraints else event.reset
    return Event(event.expression, event.direction, 1, reset)


def _acting(problem: Problem, part: Trajectory) -> list[int]:
    """Return the numbers of the events with resets or settings that occurred at the end of a segment."""
    if part.status not in (Status.EVENT, Status.SUCCESS):
        return []
    end = part.span[1]
    changing = [i for i, event in enumerate(problem.events) if event.reset or event.settings]
    return [i for i in changing if len(part.t_events[i]) and part.t_events[i][-1] == end]


def _is_begin(problem: Problem, met: Sequence[int], begin: float, end: float) -> bool:
    """Return True if the end of a segment is the zero at its beginning, found again because of rounding."""
    moved = any(problem.events[i].reset for i in met)
    return bool(met) and not moved and abs(end - begin) <= CLOSEST * max(abs(end), EARLIEST)


def status_at_end(problem: Problem, parts: Sequence[Trajectory]) -> Status | None:
    """Return the status if the run ends with these segments, or None if it goes on."""
    for i, event in enumerate(problem.events):
        if event.terminal and sum(len(part.t_events[i]) for part in parts) >= event.terminal:
            return Status.EVENT
    return Status.SUCCESS if parts[-1].span[1] == problem.t1 else None


def _behind(segment: Problem, problem: Problem, acting: Sequence[int], t: float, before: FloatArray) -> _Behind:
    """Return the state and the parameters after the events `acting` at time t; `before` (2n,) is the state there."""
    model, y, resets = problem.model, before.copy(), [problem.events[i] for i in acting]
    effects = impacts(model, resets)
    for impact in effects:
        impact.apply(t, before, segment.parameter_array, y)
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
    named = {row for impact in effects for row in impact.rows}
    follows = [row for row in (model.layout.v.start + i for i in model.equations.first_order) if row not in named]
    y[follows] = 0.0
    try:
        array = model.parameter_array(parameters)
        return _Behind(consistent_start(model, t, y, array), parameters, EventResult())
    except StatementError as refusal:
        return _Behind(y, parameters, EventResult(Status.DIVERGED, f"The reset there is impossible: {refusal}"))


def _told(problem: Problem, parts: Sequence[Trajectory]) -> str:
    """Return the note on the step that the method chose for the first segment; the others use it, too."""
    step = parts[0].step
    if problem.step is not None or step is None or len(parts) == 1:
        return ""
    return f"No step was given: equal steps of {number(step)} were taken."


def _name(problem: Problem, i: int) -> str:
    return problem.model.statement.quote(problem.events[i].expression)


def before_outputs_at_end(problem: Problem, part: Trajectory) -> Trajectory:
    """Return a segment with one state at the event that ends it, the state before; with output times, with none."""
    count = int(np.searchsorted(abs(part.t - part.span[0]), abs(part.span[1] - part.span[0])))
    count += problem.t_eval is None
    return replace(part, t=part.t[:count], y=part.y[:, :count])


def point_of(problem: Problem, part: Trajectory, y: FloatArray, status: Status, cause: str = "") -> Trajectory:
    """Return a part of zero length after the segment `part`: the state `y` (2n,) with a status, as the end of a run."""
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
