"""Run through contacts: segments with a constant mode, joined by impacts, and series of ever smaller bounces.

A segment is an ordinary run: the equations of motion with the constraints and friction forces of its mode, and with
events at which the mode ends. After it a transition applies the laws of contact, which give the next state and mode.
Frequent changes, impacts without friction and changes between sliding and sticking along a line, are resets of events
inside the compiled loop over steps, if their formulas can be written out. The run records them after the segment.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from lagrange.algorithm.constants import EARLIEST
from lagrange.algorithm.events.constants import CLOSEST
from lagrange.errors import StatementError, counted, listing
from lagrange.statement.expression import real_number
from lagrange.trajectory.contact.history import FRICTION, IMPULSE, LOST, TIME, ContactHistory
from lagrange.trajectory.contact.impacts_as_resets import WrittenFriction, WrittenImpacts, in_order, written_impacts
from lagrange.trajectory.contact.kinematics import TOUCHING, ContactState, Kinematics
from lagrange.trajectory.contact.modes import Mode, ModeEnd, PreparedMode, modes_of
from lagrange.trajectory.contact.stick_or_slide import OPEN
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
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory, with_fields

SMALLEST_BOUNCE = 1e-7
"""Speed of an impact, as a fraction of the largest in a series of ever weaker impacts, below which the infinitely many
further impacts are replaced by the time of their end. The height of the omitted bounces is 1e-14 of the first. Times of
flight then have 8 digits."""

FEWEST_FLIGHTS = 3
"""Smallest number of successive flights, each shorter than the one before, that count as accumulating impacts."""

UNKNOWN_IMPACTS, ELASTIC_IMPACTS = 16, 2**16
"""Largest number of impacts in one call of a compiled loop. The first is for a restitution that depends on the speed,
the second for impacts without loss of energy."""


class Bounces:
    """The present series of impacts in a run with ever shorter flights between them. It detects an accumulation.

    `contacts` has for each of the last `FEWEST_FLIGHTS` impacts the set of the contacts (indices) that take part in it.
    """

    def __init__(self) -> None:
        self._added: list[Any] = [np.empty((2, 0))]
        self.contacts: list[frozenset[int]] = []

    def add(self, times: Any, speeds: Any, contacts: Sequence[frozenset[int]]) -> None:
        """Add k impacts with `times` and `speeds` (k,). `contacts` has the sets of contacts of the last of them."""
        self._added.append((times, speeds))
        self.contacts = [*self.contacts, *contacts][-FEWEST_FLIGHTS:]

    @property
    def series(self) -> FloatArray:
        """Times and speeds of the impacts, (2, k), since the last flight that is not shorter than the one before."""
        if len(self._added) > 1:
            whole = np.concatenate(self._added, axis=1)
            again = np.flatnonzero(np.diff(whole[0], 2) >= 0)
            self._added = [whole[:, again[-1] + 1 if len(again) else 0 :]]
        return np.asarray(self._added[0])

    def most(self, restitutions: Sequence[float | None]) -> int:
        """Return the number of impacts that a compiled loop may handle before the run tests for an accumulation.

        `restitutions` has the restitution of each contact, or None if it depends on the speed. After the returned
        number of impacts the speed of a bouncing ball has decreased to about `SMALLEST_BOUNCE` of the largest in the
        series.
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
        """Time at which infinitely many impacts end, if each further flight shortens by the ratio of the last two.

        It is None after fewer than `FEWEST_FLIGHTS` flights, or if the last flight is not shorter than the one before.
        """
        times = self.series[0]
        if len(times) < FEWEST_FLIGHTS + 1:
            return None
        a, b, c = times[-3:].tolist()
        ratio = (c - b) / (b - a)
        return c + (c - b) * ratio / (1 - ratio) if ratio < 1 else None

    @property
    def accumulating(self) -> frozenset[int]:
        """Indices of the contacts whose impacts accumulate.

        The set is empty if the last impact is faster than `SMALLEST_BOUNCE` times the fastest of the series, or if
        `limit` is None. At least one impact must have been added.
        """
        speeds = self.series[1]
        slow = speeds[-1] <= SMALLEST_BOUNCE * speeds.max()
        return frozenset().union(*self.contacts) if slow and self.limit is not None else frozenset()


RECENT, HURRIED = 100, 1e-4
"""Test whether too frequent changes of the mode are the reason that a run reached its limit of steps or time. The first
number is the number of last changes that are examined. The second is the largest mean time between them, as a fraction
of the duration of the run, that counts as too frequent."""

SAMPLES, OVERLAP, ERRORS = 4, 1e-8, 10
"""Numbers of the test for missed impacts: the smallest number of times in a segment at which open gaps are tested, and
the overlap of bodies, as a fraction of the gap's terms, above which an impact was missed. This fraction is at least the
third number times `rtol`."""

NEARBY = 2.0**-16
"""Length of an interval at the end of a segment, as a fraction of the segment. The change of an event function over it
gives the function's time derivative."""

STEPS_OUTSIDE, SHORTEST_STEP = 60, 1e-12
"""Numbers of the search for the nearest start outside of all bodies, for an error message: the number of Newton steps
for each gap, and the change of every entry of the state below which the whole step is taken. Larger steps are
halved."""

MOST_AT_ONCE = 32
"""Largest number of changes of the mode at one instant. After this number the run ends, and the message names the
contacts."""

SHORTEST_REST = 2.0**-36
"""Shortest time from now to the end of accumulating impacts, as a fraction of the present time, for which results
report the contact as open until that end. With a shorter time the contact is reported as closed at once."""

TYPED, EARLY, EARLY_FALL = 1e-8, 1e-7, 1e-6
"""Numbers for the largest overlap of bodies at the start that counts as rounding. One limit is the first number times
the terms of the gaps. The other is the change of the gap early in the run: by its rate during the second fraction of
the run, plus by its acceleration during the third fraction. The larger limit holds."""

FAILED = (Status.UNRELIABLE, Status.NON_FINITE, Status.SINGULAR, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""Statuses of a segment after which it is run again without impacts and changes of the mode inside compiled code. Each
of them is then checked."""


def run_through_contacts(
    problem: Problem, integrator: Integrator, run: Callable[[Integrator, Problem], Trajectory]
) -> Trajectory:
    """Return the run of a problem with contacts. `run` runs a problem without contacts.

    Raises StatementError for a start inside a body, and for a run backwards in time.
    """
    # Transitions depend on the tolerance, which the method may state instead of the run.
    rtol = getattr(integrator, "rtol", None) if problem.rtol is None else real_number(problem.rtol, "rtol")
    if rtol != problem.rtol:
        problem = replace(problem, rtol=rtol)
    return _ContactRun(problem, partial(run, integrator)).trajectory()


class _ContactRun:
    """A run through contacts in progress: the trajectories `parts` of its segments so far, and their modes.

    `modes_so_far` are the modes, which begin at the times `begins`. `prepared` is the compiled mode of the last
    segment, and `part` its trajectory. `end_state` (2n,) is the state at the end of the segment before resets, or None
    without resets. `fired` are the contacts whose events ended the segment: pairs of contact index and kind of event.
    `rest_time` is the time at which the present accumulating impacts end, or infinity.
    """

    prepared: PreparedMode
    part: Trajectory
    end_state: FloatArray | None

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
        self.modes_so_far: list[Mode] = []
        self.begins: list[float] = []
        self.impacts = [[np.empty((0, FRICTION + len(contact.slip)))] for contact in self.contacts]
        self.rests: list[list[float]] = [[] for _ in self.contacts]
        self.bounces = Bounces()
        self.friction_in_loop = not any(event.reset or event.settings for event in problem.events)
        self.written = written_impacts(problem.model) if self.friction_in_loop else None
        self.rest_time, self.fired = math.inf, list[tuple[int, str]]()

    def trajectory(self) -> Trajectory:
        """Run the problem from segment to segment, and return the whole run with its history of contacts."""
        problem = self.problem
        try:
            transition = self.transitions.after(self._checked_start(), self.modes.all_open, ModeEnd())
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
                self.modes_so_far.append(transition.mode)
                self.parts.append(point_of(problem, self.parts[-1], transition.y, *stop))
                break
            segment = rest_of(segment, self.parts[-1], transition.y)
        run = joined(problem, self.parts, self._note())
        impacts, rests = tuple(map(np.concatenate, self.impacts)), tuple(map(tuple, self.rests))
        history = ContactHistory(np.array(self.begins), tuple(self.modes_so_far), impacts, rests)
        return with_fields(run, contacts=history)

    def _limit(self, end: float, mode: Mode, following: Mode) -> tuple[Status, str] | None:
        """Return the status of a run that reached a limit between two modes and a sentence on the cause, else None.

        There are limits of the number of steps, the wall time, and the number of changes at one instant. At the time
        `end` the mode changes from `mode` to `following`. The sentence may be "".
        """
        problem, begins = self.problem, self.begins
        if sum(part.steps + part.rejected for part in self.parts) + len(self.parts) >= problem.max_steps:
            status = Status.MAX_STEPS
        elif problem.max_wall is not None and time.perf_counter() - problem.began > problem.max_wall:
            status = Status.MAX_WALL
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
            f"It used up {status.value} in {len(begins)} changes of the mode, the last ones {between:.2g} apart in "
            f"time, by {what}. Raise {status.value}, change restitution or friction, or end the run before."
        )

    def _segment(self, segment: Problem, mode: Mode) -> Mode:
        """Run a segment that begins in `mode`, store it with the user's events, and return the mode at its end."""
        until = min(self.rest_time, segment.t1) if mode.bouncing else segment.t1
        if self.parts:
            states = self.parts[-1].y.max(axis=1, initial=0.0), -self.parts[-1].y.min(axis=1, initial=0.0)
            self.largest = np.max([self.largest, *states, np.abs(segment.y0)], axis=0)
        if self.parts and mode.immobile and self.modes.is_free_of_time(x.expression for x in self.problem.events):
            # The mode lasts forever, and no event of the user occurs.
            self.part, changes = resting_part(replace(segment, t1=until), self.parts[-1]), []
            self.end_state, self.fired = None, []
        else:
            changes = self._integrated(segment, mode, until)
        self.parts.append(self._verified(self.part, mode))
        self.begins += [segment.t0, *(t for t, _ in changes)]
        self.modes_so_far += [mode, *(following for _, following in changes)]
        return self.modes_so_far[-1]

    def _integrated(self, segment: Problem, mode: Mode, until: float) -> list[tuple[float, Mode]]:
        """Integrate a segment that begins in `mode`, at most to the time `until`.

        Its trajectory, the contacts whose events ended it, and the state at its end are stored in `part`, `fired` and
        `end_state`. Return the changes between sliding and sticking inside the segment: for each the time and the mode
        after it. If impacts or changes inside the loop over steps fail a test, the segment is integrated again without
        them.
        """
        users, written = len(self.problem.events), None if mode.closed else self.written
        friction = self.modes.friction(mode) if self.friction_in_loop else None
        most = self.bounces.most(self.kinematics.restitutions)
        outputs = segment.t_eval
        while True:
            self.prepared = prepared = self.modes.prepared(mode, segment, written, friction, most)
            chosen = with_fields(
                segment,
                model=prepared.model,
                events=prepared.events,
                t1=until,
                # For slips in a plane near zero the equations are stiff: tolerances then follow the segment's sizes.
                largest=None if mode.slowest else self.largest,
                t_eval=None if outputs is None else outputs[outputs <= until],
            )
            if friction is not None:
                chosen = friction.with_way(chosen, mode.ways[friction.which] or 0)
            self.part, self.fired = self.run(chosen), []
            if self.part.status is Status.EVENT:
                pairs = zip(prepared.ends, self.part.t_events[prepared.mode_events], strict=True)
                self.fired = [which for which, when in pairs if len(when) and when[-1] == self.part.span[1]]
            changes = [] if friction is None else self._passed_changes(friction, mode)
            if changes is None:
                friction, self.friction_in_loop = None, False
            elif written is not None and not self._passed_impacts(written):
                written = self.written = None
            else:
                break
        self._locate_end(chosen)
        part = self.part
        part = self.part = with_fields(part, t_events=part.t_events[:users], y_events=part.y_events[:users])
        if friction is not None and not part.status.complete:
            # The message must not name the additional coordinate of the friction model.
            at_end = part.status, self.problem, part.span[1], last_state(part)
            self.part = replace(part, message=message(*at_end, part.method, rtol=part.rtol))
        return changes

    def _verified(self, part: Trajectory, mode: Mode) -> Trajectory:
        """Return the segment `part`, which was run in `mode`, with the status UNRELIABLE if it missed an impact.

        The test is that the gaps of open contacts are not negative.
        """
        open_contacts = [i for i, state in enumerate(mode.states) if state == OPEN]
        if not open_contacts or not part.status.complete:
            return part
        times, states = part.t, part.y
        if self.problem.t_eval is not None or len(times) < SAMPLES:
            times = np.linspace(*part.span, SAMPLES + 1)[1:]
            states = part.dense(times)
        # Negative, to count from the end: the last state is tested.
        stride = -(len(times) // SAMPLES)
        gaps, near = self.kinematics.gaps(times[::stride], states[:, ::stride])
        deepest = max(OVERLAP, ERRORS * (self.problem.rtol or 0.0)) / TOUCHING * near
        overlapping = [i for i in open_contacts if gaps[i].min() < -deepest]
        if not overlapping:
            return part
        names = listing(repr(self.contacts[i].name) for i in overlapping)
        note = (
            f"The gap of {names} became negative, down to {gaps[overlapping].min():.2g}: an impact was missed, and the "
            "run does not follow the motion. Lower rtol, or take another method."
        )
        return replace(part, status=Status.UNRELIABLE, message=f"{part.message} {note}")

    def _passed_changes(self, friction: WrittenFriction, mode: Mode) -> list[tuple[float, Mode]] | None:
        """Return pairs (time, mode after it) of the changes between sliding and sticking in the last segment, or None.

        None means that the segment must be run again without such changes inside compiled code: a step failed, or
        rounding opened a gap or began a slip. `friction` has the formulas of the changes, and `mode` is the mode at the
        start of the segment.
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

        It must if a step failed, or if the gap of another contact is zero at an impact. `written` has formulas of the
        impacts.
        """
        segment, users, end = self.part, len(self.problem.events), self.part.span[1]
        if segment.status in FAILED:
            return False
        times, which, before = in_order(segment.t_events[users:], segment.y_events[users:])
        inner = times.searchsorted(end)
        if not inner:
            return True
        times, which, before = times[:inner], which[:inner], before[:inner].T
        several = len(self.contacts) > 1
        if several:
            gaps, near = self.kinematics.gaps(times, before)
            gaps[which, np.arange(len(which))] = np.inf
            if (gaps <= near).any():
                return False
        values = written.kernel.at_times(times, before, self.kinematics.parameters)
        speeds = np.empty(len(times))
        for i, results in enumerate(values.reshape(len(self.contacts), 3, -1)):
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

        A Taylor series locates the zero only up to the tolerance of the run. The run continues from the corrected end.
        """
        part, (begin, end), friction = self.part, self.part.span, self.prepared.friction
        users = len(self.problem.events)
        occurred = zip(part.t_events[users:], part.y_events[users:], strict=True)
        before = next((states[-1] for times, states in occurred if len(times) and times[-1] == end), None)
        y = None if before is None else np.ascontiguousarray(before)
        if y is not None and self.fired:
            event, parameters = self.prepared.ends.index(self.fired[0]), segment.parameter_array
            rates, h = np.asarray(segment.model.kernel("rhs")(end, y, parameters)), NEARBY * (end - begin)
            times, states = np.array([end, end - h]), np.column_stack([y, y - h * rates])
            value, earlier = self.prepared.zeros(times, states, parameters)[event].tolist()
            late = h * value / (value - earlier) if value != earlier else 0.0
            if CLOSEST * abs(end) < abs(late) < h and end - late < self.problem.t1:
                y, end = y - late * rates, end - late
                part = replace(part, t=np.where(part.t == part.span[1], end, part.t), span=(begin, end))
        part = part if y is None else _ended(part, y)
        self.end_state = y if y is None or friction is None else friction.plain(y)
        self.part = part if friction is None else friction.plain_run(part)

    def _after(self, mode: Mode) -> Transition:
        """Return the transition after the last segment, which ended in `mode`: impacts, then a new state and mode.

        Contacts with accumulating impacts stay closed, but results report them as open until these impacts have ended.
        """
        t = self.part.span[1]
        touch = self.kinematics.at(t, last_state(self.part) if self.end_state is None else self.end_state)
        end = ModeEnd(*(tuple(i for i, other in self.fired if other == kind) for kind in ModeEnd._fields))
        transition = self.transitions.after(touch, mode, end)
        plastic: frozenset[int] = frozenset()
        if transition.impacts:
            self.bounces.add([t], [transition.speed], [frozenset(transition.impacts)])
            plastic = self.bounces.accumulating
        again = bool(plastic) and plastic.isdisjoint(transition.mode.closed)
        while again or transition.low_flights - plastic:
            plastic, again = plastic | transition.low_flights, False
            transition = self.transitions.after(touch, mode, end, plastic)
        settled = tuple(i for i in plastic if i in transition.mode.closed and i not in mode.closed)
        if settled and (rest := self.bounces.limit) is not None:
            self.bounces = Bounces()
            if rest - t > SHORTEST_REST * abs(t):
                transition = replace(transition, mode=replace(transition.mode, bouncing=settled))
                self.rest_time = rest
            for i in settled:
                self.rests[i].append(rest)
        for i, row in transition.impacts.items():
            self.impacts[i].append(row[None])
        return transition

    def _checked_start(self) -> ContactState:
        """Return the contacts at the start of the run, at a state without overlaps of bodies.

        An overlap that is only rounding is removed. Raises StatementError for a larger one: the start is inside a body.
        """
        problem, kin = self.problem, self.kinematics
        touch = kin.at(problem.t0, problem.y0)
        # A gap without a gradient at the start, such as the distance of equal points, has no error either.
        inside = [i for i, gap in enumerate(touch.gaps.tolist()) if gap < 0 and not -gap <= touch.near]
        if not inside:
            return touch
        # A gap that is a single coordinate has no terms to compare with: use its change early in the run.
        span = problem.t1 - problem.t0
        a = problem.model.kernel("rhs")(problem.t0, problem.y0, problem.parameter_array)[problem.model.layout.v]
        falls = np.abs(touch.convective + touch.directions @ a) * (EARLY_FALL * span) ** 2 / 2
        rounding = np.maximum(np.abs(touch.rates) * EARLY * span + falls, TYPED / TOUCHING * touch.near)
        deep = [i for i in inside if not -touch.gaps[i] <= rounding[kin.normals[i]]]
        if deep:
            gaps = listing(f"{self.contacts[i].name!r} is {touch.gaps[i]:.6g}" for i in deep)
            what = f"the gap {gaps}, below zero" if len(deep) == 1 else f"the gaps are below zero: {gaps}"
            raise StatementError(f"the initial state is inside a body: {what}. {self._nearest()}")
        return kin.at(problem.t0, kin.closed(touch, inside))

    def _nearest(self) -> str:
        """Return a sentence, for an error message, with the nearest start at which no gap is negative.

        Distances are measured by the kinetic energy. The search closes one gap after the other, the deepest first, by
        Newton steps for all gaps that it has closed.
        """
        problem, kin, layout = self.problem, self.kinematics, self.problem.model.layout
        y, active = problem.y0, list[int]()
        touch = kin.at(problem.t0, y)
        while len(active) < len(self.contacts) and touch.gaps.min() < -np.nan_to_num(touch.near):
            active.append(int(touch.gaps.argmin()))
            for _ in range(STEPS_OUTSIDE):
                if not np.isfinite(touch.responses).all():
                    break
                # Linearize gaps at y, and evaluate them at the given state. Full steps overshoot where gaps are curved.
                back = touch.directions[kin.normals] @ (problem.y0 - y)[layout.q]
                whole = kin.closed(replace(touch, y=problem.y0, gaps=touch.gaps + back, before=touch), active)
                y = whole if np.allclose(whole, y, rtol=0, atol=SHORTEST_STEP) else (y + whole) / 2
                touch = kin.at(problem.t0, y)
            if not np.abs(touch.gaps[active]).max() <= TYPED / TOUCHING * touch.near:
                return "Give a start at which the bodies do not overlap."
        if problem.model.statement.constraints:
            kernels = map(problem.model.kernel, ("constraints", "constraint_sizes"))
            off, sizes = (np.abs(kernel(problem.t0, y, problem.parameter_array)) for kernel in kernels)
            if (off > TYPED * sizes).any():
                return "Give a start at which the bodies do not overlap."
        entries = zip(layout.coordinates, y, problem.y0, strict=False)
        moved = listing(f"{name} = {value:.15g}" for name, value, old in entries if value != old)
        return f"The nearest start outside has {moved}."

    def _note(self) -> str:
        """Return sentences for the run's message on impacts that accumulate, and on contacts that depend on each other.

        Without such impacts and contacts the result is "".
        """
        sentences = []
        for contact, times in zip(self.contacts, self.rests, strict=True):
            if times:
                more = f" and {counted(len(times) - 1, 'later time')}" if len(times) > 1 else ""
                sentences.append(f"Infinitely many impacts of {contact.name!r} end at t = {number(times[0])}{more}.")
        shared = next((mode for mode in self.modes_so_far if mode.independent is not None), None)
        if shared is not None and shared.independent is not None:
            names = listing(repr(self.contacts[i].name) for i in shared.closed)
            count = len(self.modes.model_of(shared).statement.constraints)
            rank = f"rank {len(shared.independent)} of {count}"
            sentences.append(f"The contacts {names} depend on each other ({rank}): their smallest forces are given.")
        elif self.transitions.shared:
            sentences.append(self.transitions.shared)
        return " ".join(sentences)


def _ended(part: Trajectory, y: FloatArray) -> Trajectory:
    """Return a segment in which y (2n,) replaces the last state, if the end of the segment is an output."""
    if not len(part.t) or part.t[-1] != part.span[1] or (part.y[:, -1] == y).all():
        return part
    return replace(part, y=np.column_stack([part.y[:, :-1], y]))
