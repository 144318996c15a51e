"""Run through contacts: segments with a constant mode, joined by impacts and changes of the mode."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lagrange.algorithm.events.constants import CLOSEST
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.errors import StatementError, counted, listing
from lagrange.statement.expression import real_number
from lagrange.trajectory.contact.complementarity import OPEN
from lagrange.trajectory.contact.history import FRICTION, IMPULSE, LOST, TIME, ContactHistory
from lagrange.trajectory.contact.kinematics import TOUCHING, Kinematics, Touch
from lagrange.trajectory.contact.modes import CONE, GAP, RELEASE, SLIP, Mode, PreparedMode, modes_of
from lagrange.trajectory.contact.resets import WrittenFriction, WrittenImpacts, in_order, written_impacts
from lagrange.trajectory.contact.transition import Transition, Transitions, Undetermined
from lagrange.trajectory.ending_messages import message, number
from lagrange.trajectory.integrator import Integrator, Problem
from lagrange.trajectory.segments import (
    before_outputs_at_end,
    joined,
    last_state,
    point_of,
    rest_of,
    resting_part,
    status_at_end,
)
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

RECENT, HURRIED = 100, 1e-4
"""Number of changes of the mode by which a run is judged that used up a limit, and the mean time between them, as a
fraction of the span, below which they are the cause."""

SAMPLES, OVERLAP, ERRORS = 4, 1e-8, 10
"""Least number of times in a segment at which open gaps are tested; and the overlap that shows a missed impact, as a
fraction of the terms of the gap: the second number, or the third times `rtol`, whichever is larger.
"""

NEARBY = 2.0**-16
"""Fraction of a segment, before its end, over which the derivative of an event is approximated by a difference. Zeros
at the end are nearer.
"""

STEPS_OUTSIDE, CLOSED_START = 60, 1e-6
"""Number of steps for each gap in the search for the nearest start outside of all bodies, which an error message shows;
and the largest gap at its end that counts as closed.
"""

MOST_AT_ONCE = 32
"""Largest number of changes of the mode at one instant."""

SHORTEST_REST = 2.0**-36
"""Time until impacts have ended, relative to the time of the run, below which no separate segment is run."""

SMALLEST_BOUNCE = 1e-7
"""Speed of an impact, relative to the largest of a series of decreasing impacts, below which the rest of the series is
summed. The height of the omitted bounces is 1e-14 of the first. Times of flight then have 8 digits.
"""

FEWEST_FLIGHTS = 3
"""Smallest number of flights, each shorter than the one before, that count as an accumulation."""

UNKNOWN_IMPACTS, ELASTIC_IMPACTS = 16, 2**16
"""Largest number of impacts in one call of a compiled loop. The first is for a restitution that depends on the speed,
the second for impacts without loss of energy.
"""

EARLY = 1e-7
"""Part of a run early in which a gap may still be negative: its motion there is taken for rounding of the start."""

FAILED = (Status.UNRELIABLE, Status.NON_FINITE, Status.SINGULAR, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""Statuses after which a segment is run again, with a check of each impact and each change of the mode."""


def run_through_contacts(
    problem: Problem, integrator: Integrator, run: Callable[[Integrator, Problem], Trajectory]
) -> Trajectory:
    """Return the run of a problem whose statement has contacts. `run` runs a problem without contacts.

    Raises StatementError for a start inside a body, and for a run backwards in time.
    """
    # Transitions depend on the tolerance, which the method may state instead of the run.
    rtol = getattr(integrator, "rtol", None) if problem.rtol is None else real_number(problem.rtol, "rtol")
    if rtol != problem.rtol:
        problem = replace(problem, rtol=rtol)
    return _ContactRun(problem, partial(run, integrator)).trajectory()


class _Bounces:
    """The present series of impacts with ever shorter flights between them. It may accumulate at a finite time.

    `contacts` has the last `FEWEST_FLIGHTS` impacts: the set of the contacts that take part in each.
    """

    def __init__(self) -> None:
        self._added = [np.empty((2, 0))]
        self.contacts: list[frozenset[int]] = []

    def add(self, times: Any, speeds: Any, contacts: Sequence[frozenset[int]]) -> None:
        """Add impacts with `times` and `speeds` (k,), and the contacts that take part in the last of them."""
        self._added.append(np.array([times, speeds]))
        self.contacts = [*self.contacts, *contacts][-FEWEST_FLIGHTS:]

    @property
    def series(self) -> FloatArray:
        """Times and speeds of the impacts, (2, k), since the last flight that is not shorter than the one before."""
        whole = np.concatenate(self._added, axis=1)
        again = np.flatnonzero(np.diff(whole[0], 2) >= 0)
        self._added = [whole[:, again[-1] + 1 if len(again) else 0 :]]
        return self._added[0]

    def most(self, restitutions: Sequence[float | None]) -> int:
        """Return the number of impacts that a compiled loop may handle before the run tests for an accumulation.

        `restitutions` has the value of each contact, None if it depends on the speed. After this number of impacts
        the speed of a bouncing ball has decreased to about `SMALLEST_BOUNCE` of the largest speed in the series.
        """
        constants = [e for e in restitutions if e is not None and e > 0]
        weakest = min(constants, default=1.0)
        if len(constants) < len(restitutions) or weakest == 1.0:
            return UNKNOWN_IMPACTS if None in restitutions else ELASTIC_IMPACTS
        speeds = self.series[1]
        share = speeds[-1] / speeds.max() if len(speeds) else 1.0
        return max(1, math.ceil(math.log(SMALLEST_BOUNCE / share) / math.log(weakest)))

    @property
    def limit(self) -> float | None:
        """The limit of the times of impact, if each of the last flights is shorter by the same ratio; else None."""
        times = self.series[0]
        if len(times) < FEWEST_FLIGHTS + 1:
            return None
        a, b, c = times[-3:].tolist()
        ratio = (c - b) / (b - a)
        return c + (c - b) * ratio / (1 - ratio) if ratio < 1 else None


class _ContactRun:
    """A run in progress: its `parts`, and the mode, time and state at which it continues.

    `prepared` is the compiled mode of the last segment, `part` its trajectory, and `end_state` (2n,) the state at its
    end before any reset. `fired` are the contacts whose events ended it: pairs of contact index and kind of event.
    """

    prepared: PreparedMode
    part: Trajectory
    end_state: FloatArray

    def __init__(self, problem: Problem, run: Callable[[Problem], Trajectory]) -> None:
        if problem.t1 < problem.t0:
            raise StatementError(
                f"the run goes backwards from t = {problem.t0:g} to {problem.t1:g}, and impacts that lose energy "
                "cannot be undone: run forwards."
            )
        self.problem, self.run = problem, run
        self.modes = modes_of(problem.model)
        self.kinematics = Kinematics(problem.model, problem.parameter_array)
        self.contacts = problem.model.statement.contacts
        self.transitions = Transitions(self.modes, self.kinematics, problem.t1 - problem.t0, problem.rtol or 0.0)
        self.parts: list[Trajectory] = []
        self.largest = np.abs(problem.y0)
        self.kept: list[Mode] = []
        self.begins: list[float] = []
        self.impacts = [[np.empty((0, FRICTION + len(contact.slip)))] for contact in self.contacts]
        self.rests: list[list[float]] = [[] for _ in self.contacts]
        self.bounces = _Bounces()
        self.frictions = not any(event.reset or event.settings for event in problem.events)
        self.written = written_impacts(problem.model) if self.frictions else None
        self.rest_time = math.inf
        self.fired: list[tuple[int, str]] = []

    def trajectory(self) -> Trajectory:
        """Run the problem from segment to segment, and return the whole run with its history of contacts."""
        problem, n = self.problem, len(self.contacts)
        try:
            transition = self.transitions.after(self._checked_start(), Mode((OPEN,) * n, (None,) * n))
        except Undetermined as refusal:
            raise StatementError(f"the motion cannot start at the initial state: {refusal}") from refusal
        for i, row in transition.impacts.items():
            self.impacts[i].append(row[None])
        segment = problem if transition.y is problem.y0 else replace(problem, y0=transition.y)
        while True:
            mode = self._segment(segment, transition.mode)
            part, last = self.parts[-1], status_at_end(problem, self.parts)
            end, goes_on = part.span[1], bool(self.fired)
            if mode.bouncing and self.rest_time <= end:
                mode, self.rest_time = replace(mode, bouncing=()), math.inf
                goes_on = last is None and (goes_on or part.status is Status.SUCCESS)
            if part.status is Status.UNRELIABLE or last is Status.EVENT or not goes_on:
                break
            try:
                transition = self._after(mode)
            except Undetermined as refusal:
                text = message(Status.SINGULAR, problem, end, last_state(part), part.method, cause=str(refusal))
                self.parts[-1] = replace(part, status=Status.SINGULAR, message=text)
                break
            self.parts[-1] = _ended(before_outputs_at_end(problem, self.parts[-1]), transition.before)
            stop = (last, "") if last is not None else self._limit(end, mode, transition.mode)
            if stop is not None:
                self.begins.append(end)
                self.kept.append(transition.mode)
                self.parts.append(point_of(problem, self.parts[-1], transition.y, *stop))
                break
            segment = rest_of(segment, self.parts[-1:], end, transition.y, output_at_begin=True)
        run = joined(problem, self.parts, self._note(), both_at_joints=True)
        impacts, rests = tuple(map(np.concatenate, self.impacts)), tuple(map(tuple, self.rests))
        return replace(run, contacts=ContactHistory(np.array(self.begins), tuple(self.kept), impacts, rests))

    def _limit(self, end: float, mode: Mode, following: Mode) -> tuple[Status, str] | None:
        """Return the status and the cause for a run that reached a limit between two modes; else None.

        There are limits of steps, of time, and of changes of the mode at one instant. At the time `end` the run would
        change from `mode` to `following`.
        """
        problem, begins = self.problem, self.begins
        if sum(part.steps + part.rejected for part in self.parts) + len(self.parts) >= problem.max_steps:
            status, limit = Status.MAX_STEPS, "max_steps"
        elif problem.max_wall is not None and time.perf_counter() - problem.began > problem.max_wall:
            status, limit = Status.MAX_WALL, "max_wall"
        elif sum(abs(end - t) <= CLOSEST * max(abs(end), EARLIEST) for t in begins[-MOST_AT_ONCE:]) < MOST_AT_ONCE:
            return None
        else:
            states = zip(self.contacts, mode.states, following.states, strict=True)
            changed = [each for each, old, new in states if old != new or set(mode.states) == {OPEN}]
            return Status.SINGULAR, (
                f"Contacts open, close, slide or stick {MOST_AT_ONCE} times at one instant, at "
                f"{listing(repr(each.name) for each in changed)}: the laws of contact give no motion after it. Change "
                "restitution or friction, or end the run before."
            )
        recent = begins[-RECENT:]
        between = (recent[-1] - recent[0]) / RECENT
        if len(recent) < RECENT or between > HURRIED * (problem.t1 - problem.t0):
            return status, ""
        pairs = zip(self.contacts, self.impacts, strict=True)
        names = [repr(each.name) for each, rows in pairs if len(rows[-1]) and rows[-1][-1, TIME] >= recent[0]]
        what = f"impacts of {listing(names)}" if names else "changes between sliding and sticking"
        return status, (
            f"It used up {limit} in {len(begins)} changes of the mode, the last ones {between:.2g} apart in time, "
            f"by {what}. Raise {limit}, change restitution or friction, or end the run before."
        )

    def _segment(self, segment: Problem, mode: Mode) -> Mode:
        """Run a segment that begins in `mode`, store it with the user's events, and return the mode at its end."""
        users, written = len(self.problem.events), None if mode.closed else self.written
        friction = self.modes.friction(mode) if self.frictions else None
        until = min(self.rest_time, segment.t1) if mode.bouncing else segment.t1
        most = self.bounces.most(self.kinematics.restitutions)
        part, changes = None, list[tuple[float, Mode]]()
        if self.parts:
            states = self.parts[-1].y.max(axis=1, initial=0.0), -self.parts[-1].y.min(axis=1, initial=0.0)
            self.largest = np.max([self.largest, *states, np.abs(segment.y0)], axis=0)
        zeros = [event.expression for event in self.problem.events]
        if self.parts and mode.still and self.modes.without_time(zeros):
            # The mode lasts forever, and no event of the user occurs.
            part, friction = resting_part(replace(segment, t1=until), self.parts[-1]), None
            self.part, self.end_state, self.fired = part, segment.y0, []
        while part is None:
            self.prepared = prepared = self.modes.prepared(mode, segment, written, friction, most)
            chosen = replace(
                segment,
                model=prepared.model,
                events=prepared.events,
                t1=until,
                # A slip in a plane that is smaller than the errors of a run is stiff.
                largest=None if mode.slowest else self.largest,
                t_eval=None if segment.t_eval is None else segment.t_eval[segment.t_eval <= until],
            )
            if friction is not None:
                chosen = friction.with_way(chosen, mode.ways[friction.which] or 0)
            self.part, self.fired = self.run(chosen), []
            if self.part.status is Status.EVENT:
                pairs = zip(prepared.ends, self.part.t_events[prepared.mode_events], strict=True)
                self.fired = [which for which, when in pairs if len(when) and when[-1] == self.part.span[1]]
            if friction is not None:
                passed = self._passed_changes(friction, mode)
                if passed is None:
                    friction, self.frictions = None, False
                    continue
                changes = passed
            if written is not None and not self._passed_impacts(written):
                written = self.written = None
                continue
            self._locate_end(chosen)
            part = replace(self.part, t_events=self.part.t_events[:users], y_events=self.part.y_events[:users])
        if friction is not None and not part.status.complete:
            # The message names coordinates of the system only.
            at_end = part.status, self.problem, part.span[1], last_state(part)
            part = replace(part, message=message(*at_end, part.method, rtol=part.rtol))
        self.parts.append(self._verified(part, mode))
        self.begins += [segment.t0, *(t for t, _ in changes)]
        self.kept += [mode, *(following for _, following in changes)]
        return self.kept[-1]

    def _verified(self, part: Trajectory, mode: Mode) -> Trajectory:
        """Return the segment `part`, with the status UNRELIABLE if bodies overlap because an impact was missed.

        `mode` is the mode of the segment, by which open contacts are known.
        """
        still_open = [i for i, state in enumerate(mode.states) if state == OPEN]
        if not still_open or not part.status.complete:
            return part
        times, states = part.t, part.y
        if self.problem.t_eval is not None or len(times) < SAMPLES:
            times = np.linspace(*part.span, SAMPLES + 1)[1:]
            states = part.dense(times)
        # Count from the end, so that the last state is tested.
        stride = -(len(times) // SAMPLES)
        gaps, near = self.kinematics.gaps(times[::stride], states[:, ::stride])
        deepest = max(OVERLAP, ERRORS * (self.problem.rtol or 0.0)) / TOUCHING * near
        overlapping = [i for i in still_open if gaps[i].min() < -deepest]
        if not overlapping:
            return part
        names = listing(repr(self.contacts[i].name) for i in overlapping)
        note = (
            f"The gap of {names} became negative, down to {gaps[overlapping].min():.2g}: an impact was missed, and the "
            "run does not follow the motion. Lower rtol, or take another method."
        )
        return replace(part, status=Status.UNRELIABLE, message=f"{part.message} {note}")

    def _passed_changes(self, friction: WrittenFriction, mode: Mode) -> list[tuple[float, Mode]] | None:
        """Return the changes between sliding and sticking in the last segment: for each the time and the mode after it.

        None means that the segment must be run again without compiled changes: a step failed, or rounding opened the
        gap or began a slip.
        """
        segment, last = self.part, last_state(self.part)
        if segment.status in FAILED:
            return None
        changes = slice(-len(friction.events), None)
        times, _, before = in_order(segment.t_events[changes], segment.y_events[changes])
        states, at = np.column_stack([before.T, last]), np.append(times, segment.span[1])
        ways = states[friction.model.layout.q.stop - 1]
        if not self.kinematics.held(friction.which, at, friction.plain(states), ways == 0):
            return None
        following = {way: mode.going(friction.which, way) for way in (-1, 0, 1)}
        pairs = zip(times.tolist(), ways[1:].tolist(), strict=True)
        return [(t, following[round(way)]) for t, way in pairs if not (self.fired and t == segment.span[1])]

    def _passed_impacts(self, written: WrittenImpacts) -> bool:
        """Record the impacts inside the last segment. Return False if it must be run again without compiled impacts.

        This is so if a step failed, or if another gap is closed at an impact: such impacts need a test of their own.
        `written` has the formulas of the impacts.
        """
        segment, users, end = self.part, len(self.problem.events), self.part.span[1]
        if segment.status in FAILED:
            return False
        times, which, before = in_order(segment.t_events[users:], segment.y_events[users:])
        inner = np.searchsorted(times, end)
        if not inner:
            return True
        times, which, before = times[:inner], which[:inner], before[:inner].T
        several = len(self.contacts) > 1
        if several:
            gaps, near = self.kinematics.gaps(times, before)
            gaps[which, np.arange(len(which))] = np.inf
            if (gaps <= near).any():
                return False
        numbers = np.asarray(written.kernel(times, before, self.kinematics.parameters))
        speeds = np.empty(len(times))
        for i, results in enumerate(numbers.reshape(len(self.contacts), 3, -1)):
            mine = which == i if several else slice(None)
            impulses, lost, speeds[mine] = results[:, mine]
            if self.kinematics.restitutions[i] is None:
                for speed in speeds[mine].tolist():
                    self.kinematics.restitution(i, speed)
            rows = np.zeros((len(impulses), FRICTION + len(self.contacts[i].slip)))
            rows[:, TIME], rows[:, IMPULSE], rows[:, LOST] = times[mine], impulses, lost
            self.impacts[i].append(rows)
        self.bounces.add(times, speeds, [frozenset([i]) for i in which[-FEWEST_FLIGHTS:].tolist()])
        return True

    def _locate_end(self, segment: Problem) -> None:
        """Move the end of the last segment closer to the zero of the event that ended it, by one secant step.

        The end is the one before any reset. A series locates the zero only up to the tolerance of the run. The run
        continues from the corrected end.
        """
        part, (begin, end), users = self.part, self.part.span, len(self.problem.events)
        fired = zip(part.t_events[users:], part.y_events[users:], strict=True)
        at_end = (states[-1] for times, states in fired if len(times) and times[-1] == end)
        y = next(map(np.ascontiguousarray, at_end), None)
        y = last_state(part) if y is None else y
        if self.fired:
            event, parameters = self.prepared.ends.index(self.fired[0]), segment.parameter_array
            rates, h = np.asarray(segment.model.kernel("rhs")(end, y, parameters)), NEARBY * (end - begin)
            times, states = np.array([end, end - h]), np.column_stack([y, y - h * rates])
            value, before = self.prepared.zeros(times, states, parameters)[event].tolist()
            late = h * value / (value - before) if value != before else 0.0
            if CLOSEST * abs(end) < abs(late) < h and end - late < self.problem.t1:
                y, end = y - late * rates, end - late
                part = replace(part, t=np.where(part.t == part.span[1], end, part.t), span=(begin, end))
        self.end_state, self.part, friction = y, _ended(part, y), self.prepared.friction
        if friction is not None:
            self.end_state, self.part = friction.plain(y), friction.plain_run(self.part)

    def _after(self, mode: Mode) -> Transition:
        """Return the state and the mode after the last segment, which ended in `mode`, and after impacts at its end."""
        t = self.part.span[1]
        touch = self.kinematics.at(t, self.end_state)
        ends = {kind: [i for i, other in self.fired if other == kind] for kind in (RELEASE, GAP, SLIP, CONE)}
        transition = self.transitions.after(touch, mode, **ends)
        if transition.impacts:
            self.bounces.add([t], [transition.speed], [frozenset(transition.impacts)])
        speeds = self.bounces.series[1]
        small = bool(transition.impacts) and bool(speeds[-1] <= SMALLEST_BOUNCE * speeds.max())
        accumulated = small and self.bounces.limit is not None
        plastic = frozenset().union(*self.bounces.contacts) if accumulated else frozenset()
        while transition.unseen - plastic or (accumulated and not plastic & set(transition.mode.closed)):
            plastic |= transition.unseen
            transition = self.transitions.after(touch, mode, **ends, plastic=plastic)
            accumulated = False
        settled = tuple(i for i in plastic if i in transition.mode.closed and i not in mode.closed)
        if settled and (rest := self.bounces.limit) is not None:
            self.bounces = _Bounces()
            if rest - t > SHORTEST_REST * abs(t):
                transition = replace(transition, mode=replace(transition.mode, bouncing=settled))
                self.rest_time = rest
            for i in settled:
                self.rests[i].append(rest)
        for i, row in transition.impacts.items():
            self.impacts[i].append(row[None])
        return transition

    def _checked_start(self) -> Touch:
        """Return the contacts at the start, with negative gaps closed that are rounding.

        Raises StatementError inside a body.
        """
        problem, kin = self.problem, self.kinematics
        touch = kin.at(problem.t0, problem.y0)
        # A gap without a gradient at the start, such as the distance of equal points, has no error either.
        inside = [i for i, gap in enumerate(touch.gaps.tolist()) if gap < 0 and not -gap <= touch.near]
        if not inside:
            return touch
        # A gap of one coordinate has no other terms: compare it with the way that it takes early in the run.
        short = EARLY * (problem.t1 - problem.t0)
        a = problem.model.kernel("rhs")(problem.t0, problem.y0, problem.parameter_array)[problem.model.layout.v]
        ways = np.abs(touch.rates) * short + np.abs(touch.bias + touch.directions @ a) * short**2 / 2
        deep = [i for i in inside if not -touch.gaps[i] <= ways[kin.normals[i]]]
        if deep:
            gaps = listing(f"{self.contacts[i].name!r} is {touch.gaps[i]:.6g}" for i in deep)
            what = f"the gap {gaps}, below zero" if len(deep) == 1 else f"the gaps are below zero: {gaps}"
            raise StatementError(f"the initial state is inside a body: {what}. {self._nearest()}")
        return kin.at(problem.t0, kin.closed(touch, inside))

    def _nearest(self) -> str:
        """Return a sentence with the start, nearest by the metric of the kinetic energy, at which no gap is negative.

        Gaps become closed one after the other, the deepest first; each step of the search has their tangents.
        """
        problem, kin, layout = self.problem, self.kinematics, self.problem.model.layout
        y, active = problem.y0, list[int]()
        touch = kin.at(problem.t0, y)
        while len(active) < len(self.contacts) and touch.gaps.min() < -np.nan_to_num(touch.near):
            active.append(int(touch.gaps.argmin()))
            for _ in range(STEPS_OUTSIDE):
                if not np.isfinite(touch.responses).all():
                    break
                # Tangents at y, followed back to the given state. Whole steps overshoot where gaps are curved.
                back = touch.directions[kin.normals] @ (problem.y0 - y)[layout.q]
                whole = kin.closed(replace(touch, y=problem.y0, gaps=touch.gaps + back), active)
                y = whole if np.allclose(whole, y, rtol=0, atol=CLOSED_START**2) else (y + whole) / 2
                touch = kin.at(problem.t0, y)
            if not np.abs(touch.gaps[active]).max() < CLOSED_START:
                return "Give a start at which the bodies do not overlap."
        moved = [
            f"{name} = {value:.9g}"
            for name, value, old in zip(layout.coordinates, y, problem.y0, strict=False)
            if value != old
        ]
        return f"The nearest start outside has {listing(moved)}."

    def _note(self) -> str:
        """Return sentences on impacts that accumulate and on contacts that depend on each other, or ""."""
        sentences = []
        for contact, times in zip(self.contacts, self.rests, strict=True):
            if times:
                more = f" and {counted(len(times) - 1, 'later time')}" if len(times) > 1 else ""
                sentences.append(f"Infinitely many impacts of {contact.name!r} end at t = {number(times[0])}{more}.")
        shared = next((mode for mode in self.kept if mode.kept is not None), None)
        if shared is not None and shared.kept is not None:
            names = listing(repr(self.contacts[i].name) for i in shared.closed)
            count = len(self.modes.model_of(shared).statement.constraints)
            rank = f"rank {len(shared.kept)} of {count}"
            sentences.append(f"The contacts {names} depend on each other ({rank}): their smallest forces are given.")
        elif self.transitions.shared:
            sentences.append(self.transitions.shared)
        return " ".join(sentences)


def _ended(part: Trajectory, y: FloatArray) -> Trajectory:
    """Return the segment `part` with y (2n,) in place of its last state, if the end of the segment is an output."""
    if not len(part.t) or part.t[-1] != part.span[1] or (part.y[:, -1] == y).all():
        return part
    return replace(part, y=np.column_stack([part.y[:, :-1], y]))
