"""The watch of a run by Taylor steps: events, and the surfaces on which the equations of motion switch.

The driver returns before a step on which one of these functions may vanish. The roots of its polynomial on the step are
isolated here. The step is then taken whole, or up to the first root that changes the motion: there the run ends, the
state is reset, or the equations continue with the other side of a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from lagrange.algorithm.events.constants import TOGETHER
from lagrange.algorithm.taylor.constants import MOST_FAILURES
from lagrange.machine.backend import Series, SingularMassMatrix, TaylorDriver
from lagrange.machine.event_memory import EventMemory
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.actions import Impact, reset_state
from lagrange.trajectory.events.end_messages import (
    EventResult,
    accumulating,
    at_rest,
    rootless,
    sliding,
    undefined,
    without_series,
)
from lagrange.trajectory.events.event_log import Occurrence
from lagrange.trajectory.events.motion_start import SeriesStart
from lagrange.trajectory.events.series_on_step import EventSeries, signed_scale, state_at
from lagrange.trajectory.events.shared_watch import PlannedStep
from lagrange.trajectory.events.surfaces import (
    SHARE,
    Continuations,
    Sliding,
    clear,
    leaving,
    settled_sides,
    stated_sides,
)
from lagrange.trajectory.events.zeros_on_step import EventZero, Root, Side, may_vanish, roots
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState

CLOSE_ROOTS = 8.0
"""Distance of two zeros of one event, in units of simultaneous times, below which they are the same.

Steps of two lengths locate the same zero at slightly different times.
"""


class Watch(SeriesStart):
    """Watches the surfaces and the events along a run; indices count surfaces first, then events."""

    def __init__(
        self,
        series: Series,
        order: int,
        driver: TaylorDriver,
        parameters: FloatArray,
        impacts: Sequence[Impact],
        names: Callable[[], Sequence[str]],
        continuations: Continuations,
        memory: EventMemory | None = None,
    ) -> None:
        super().__init__(series, order, driver, parameters, impacts, names, memory)
        self.continuations = continuations

    def begin(self, state: DriverState) -> EventResult:
        """Begin a run or a new motion: without surfaces the loop finds the sides, else this method."""
        first, self.state, self.planned = self.state is None, state, PlannedStep()
        if not self.surfaces:
            self.leave_start_to_the_loop(state, first=first)
            return EventResult()
        return self._begin(state)

    def _begin(self, state: DriverState) -> EventResult:
        """Find the sides of surfaces and events at the start of a motion."""
        self.planned = PlannedStep()
        result = self.start(state, {})
        if result.status is None:
            self.pending = self.impacts_at_once(state, ())
        self.write(state)
        return result

    def process(self, state: DriverState) -> EventResult:
        """Set the length of the step that the driver proposes, or apply the pending events at its start."""
        self.read(state)
        try:
            return self._process(state)
        finally:
            self.write(state)

    def _process(self, state: DriverState) -> EventResult:
        if self.unbegun:
            return self._begin(state)
        if state.count(S.STEPS) < self.planned.steps:
            self.forget()
        if self.pending:
            return self._finish(state)
        look = self.ahead(state)
        if not np.isfinite(look.watched).all():
            result = undefined(self.names(), look.watched)
            # On a surface rounding may leave the state where a branch that begins there has no value.
            return replace(result, smooth=result.smooth or self._switches(look, 0.0))
        h, left = float(state.reals[S.H]), float(state.reals[S.END] - state.t - state.taylor.low)
        s, limiting = look.trusted(h / look.scale, hides_growth=self.hides_growth)
        if self.steep:
            s, limiting = look.verified(s, limiting, self.series, state.t, state.y, self.values)
        whole = s == h / look.scale
        if not whole and abs(s * look.scale) < TOGETHER * abs(state.t) + 2.0**-70 * abs(left):
            name, value = self.names()[limiting], float(look.watched[0, limiting])
            smooth = limiting < self.surfaces
            return rootless(name) if self.is_root(limiting) else without_series(name, value, smooth=smooth)
        for which in look.jumps(s, self.zero_sides):
            self.zero_sides[which] = Side(int(np.sign(look.watched[0, which])))
        found, after = self._roots(look, s, last=whole and h == left)
        cut = self.first_change(found, self.impacts, self.surfaces)
        if cut is not None:
            return self._shorten(cut.root.time, found, look, state)
        self.remember(state)
        self._record(found, look, state)
        self.zero_sides, self.starting = after, frozenset()
        state.taylor.next_limit = abs(h if whole else s * look.scale)
        state.taylor.inspect = int(
            self.steep or self.hides_growth or look.ends or not all(side.settled for side in after)
        )
        return EventResult()

    def end(self, state: DriverState) -> EventResult:
        """Apply the pending events at the end of the run, and return its result."""
        self.read_events(state)
        if not self.is_pending:
            return EventResult(Status.SUCCESS)
        self.read_sides(state)
        result = self._finish(state)
        ended = result.status in (Status.EVENT, Status.NON_FINITE, Status.DIVERGED) and not result.smooth
        return result if ended else EventResult(Status.SUCCESS, jumped=result.jumped)

    def is_due(self, state: DriverState) -> bool:
        """Return True if an event is pending at the state, even if no series begins there."""
        self.read(state)
        return bool(self.pending) and state.count(S.STEPS) == self.planned.steps

    def continue_past(self, state: DriverState) -> EventResult | None:
        """Leap over a point without a series; return the result after the leap or at a root, or None without a leap."""
        self.read(state)
        if self.unbegun and (begun := self._begin(state)).status is not None:
            return begun
        events = [self.surfaces + i for i, impact in enumerate(self.impacts) if not impact.root]
        for there in self.continuations.ahead(state):
            y = self.continuations.landing(state, there, switched=lambda soon: self._switches(self.ahead(state), soon))
            if y is None:
                continue
            sides = [self.zero_sides[i].sign for i in events]
            values = np.concatenate([self.parameters, stated_sides(self.series.program, there, y, self.parameters)])
            ends = np.sign(self.series.rows(self.order, there, y, signed_scale(state), values)[0, len(y) :][events])
            # A zero at the start of the motion is not an event, but a leap must not pass one with a reset.
            if all(
                b in (0, a) or (a == 0 and not self.impacts[i - self.surfaces].reset)
                for i, a, b in zip(events, sides, ends, strict=True)
            ):
                self.continuations.land(state, there, y, state.count(S.STEPS) + self.jumps)
                self.jump()
                self.driver.restart(state)
                done = there == state.reals[S.END]
                return replace(EventResult(Status.SUCCESS) if done else self.begin(state), jumped=True)
        return self._rootless(state)

    def _switches(self, look: EventSeries, soon: float) -> bool:
        """Return True if the state is on a surface, or reaches one within the time `soon`."""
        return any(which in self.starting or look.falls(which, soon) for which in range(self.surfaces))

    def _rootless(self, state: DriverState) -> EventResult | None:
        """Return the end of the run at a square root that becomes zero where the state is, or None."""
        look, soon = self.ahead(state), SHARE * abs(float(state.reals[S.END] - state.reals[S.START]))
        for which in filter(self.is_root, range(len(self.zero_sides))):
            # The radicand is the square of the root and falls twice as fast.
            if look.watched[0, which] == 0 or look.falls(which, 2 * soon):
                return replace(rootless(self.names()[which]), smooth=False)
        return None

    def _roots(self, look: EventSeries, s: float, *, last: bool) -> tuple[list[EventZero], list[Side]]:
        """Return the roots of all surfaces and events on a step, in order, and the sides at its end."""
        found: list[EventZero] = []
        after = []
        for which, before in enumerate(self.zero_sides):
            g, noise = look.watched[:, which], float(look.noise[which])
            if which in self.starting:
                # A function that starts at zero is divided by time: this removes the known root.
                g, noise = g[1:], 0.0
            surely = before.settled and before.sign * g[0] > 0 and not may_vanish(g, s, noise=noise)
            zeros, side = ([], before) if surely else roots(g, s, before, noise=noise, last=last)
            found += [EventZero(which, root) for root in zeros]
            after.append(side)
        return sorted(found, key=lambda m: m.root.time), after

    def _shorten(self, s: float, found: list[EventZero], look: EventSeries, state: DriverState) -> EventResult:
        """End the step at the root at s, whose events are pending until the driver returns there."""
        while True:
            close = TOGETHER * max(abs(state.t / look.scale), s)
            here = (m for m in found if abs(m.root.time - s) <= close)
            pending = self.pending = [m for m in here if m.root.time == s or look.is_zero_at(m.which, s)]
            if s == 0:
                return self._finish(state)
            # The shorter step has better resolved roots, which replace the others; one may change the motion before s.
            found, after = self._roots(look, s, last=False)
            first = self.first_change((m for m in found if m.root.time < s - close), self.impacts, self.surfaces)
            if first is None:
                break
            s = first.root.time
        waiting = {m.which for m in pending}
        late = [m for m in found if m.root.time >= s - close]
        self.remember(state)
        self.pending = pending + [m for m in late if m.which not in waiting]
        if any(self.is_root(m.which) for m in self.pending):
            # Forces may have a kink there, with the rounded state on its other side: the test of the step would fail.
            state.taylor.failures = MOST_FAILURES
        # An event at the end does not count a second time just before it.
        until = dict.fromkeys(waiting, s - CLOSE_ROOTS * close)
        self._record((m for m in found if m.root.time < until.get(m.which, s - close)), look, state)
        self.zero_sides, self.starting = after, frozenset()
        state.taylor.next_limit = s * abs(look.scale)
        state.taylor.inspect = 1
        return EventResult()

    def _record(self, found: Iterable[EventZero], look: EventSeries, state: DriverState) -> None:
        """Record the events among some roots on the next step."""
        for meeting in found:
            place = meeting.which - self.surfaces
            if place >= 0 and self.impacts[place].counts(meeting.root.rising):
                t = float(state.t + state.taylor.low + meeting.root.time * look.scale)
                y = state_at(state.y, look.rows, meeting.root.time)
                self.occurrences[place].append(Occurrence(t, y, state.count(S.STEPS) + 1))

    def _finish(self, state: DriverState) -> EventResult:
        """Apply the pending zeros: cross surfaces, record events, reset the state or end the run."""
        found, self.pending = self.pending, []
        if self.change_counter.accumulates(state.t, (m.which for m in found)):
            return accumulating(self.names()[found[0].which])
        before = list(self.zero_sides)
        for m in found:
            self.zero_sides[m.which] = Side(m.root.rising or self.zero_sides[m.which].sign)
        self.starting = frozenset(m.which for m in found)
        crossed = [m for m in found if m.which < self.surfaces and m.root.rising]
        result = self._cross(crossed, state) if crossed else EventResult()
        zeros = [m for m in found if m.which >= self.surfaces]
        if crossed and result.status is None:
            zeros = self._on_surface(zeros, before, state)
        zeros = [m for m in zeros if self.impact_of(m).counts(m.root.rising)]
        roots_met = [m for m in zeros if self.impact_of(m).root]
        zeros = [m for m in zeros if not self.impact_of(m).root]
        for m in zeros:
            here = Occurrence(state.t, state.y.copy(), state.count(S.STEPS))
            self.occurrences[m.which - self.surfaces].append(here)
        ends = any(0 < self.impact_of(m).terminal <= len(self.occurrences[m.which - self.surfaces]) for m in zeros)
        resets = [m for m in zeros if self.impact_of(m).reset]
        if resets:
            return self._jump(resets, found, state, ends=ends)
        if ends:
            return EventResult(Status.EVENT)
        return rootless(self.names()[roots_met[0].which]) if roots_met and result.status is None else result

    def _on_surface(self, zeros: Sequence[EventZero], before: Sequence[Side], state: DriverState) -> list[EventZero]:
        """Return events at a surface with their direction after it: an event may turn back there, as abs(x) does."""
        found = []
        for m in zeros:
            g = self.ahead(state).near[:, m.which]
            if clear(g):  # The event jumps: it came to zero on one side of the surface, and is elsewhere on the other.
                self.zero_sides[m.which], self.starting = Side(int(np.sign(g[0]))), self.starting - {m.which}
                found += [m] * (not self.is_root(m.which))
                continue
            after = leaving(g)[0]
            if self.is_root(m.which) and g[0] > 0 and not g[1:].any():
                # The branch that contains the root ends here, and the motion continues in another branch.
                self.zero_sides[m.which] = Side(1)
                continue
            self.zero_sides[m.which] = Side(after)
            # The step may have ended after the zero, so its direction gives the side before.
            side = -m.root.rising or before[m.which].sign
            found.append(replace(m, root=Root(m.root.time, after if after != side else 0)))
        return found

    def _jump(
        self, zeros: Sequence[EventZero], found: Sequence[EventZero], state: DriverState, *, ends: bool
    ) -> EventResult:
        """Reset the state by the events `zeros` among those found, from the state before, and start a new motion."""
        before = self.ahead(state)
        resets = {self.impact_of(m): m.which for m in sorted(zeros, key=lambda m: m.which)}
        after, broken = reset_state(resets, self.names, state.t, state.y, self.parameters)
        if broken.status is not None:
            return broken
        state.y[:] = after
        self.jump()
        self.driver.restart(state)
        if ends:
            return EventResult(Status.EVENT, jumped=True)
        happened = {m.which: abs(float(before.watched[0, m.which])) for m in found}
        began = self.start(state, happened, before)
        if began.status is None:
            for m in zeros:
                sign, order = leaving(self.ahead(state).near[:, m.which])
                if m.which in self.starting and order > 1 and sign == m.root.rising:
                    return replace(at_rest(self.names()[m.which]), jumped=True)
            self.pending = self.impacts_at_once(state, happened)
        return replace(began, jumped=True)

    def _cross(self, crossed: Sequence[EventZero], state: DriverState) -> EventResult:
        """Continue with the other side of each crossed surface if the motion leaves to it.

        A motion that stayed on another surface by itself may leave it with the new equations.
        """
        choices = {m.which: (m.root.rising, -m.root.rising, 0) for m in crossed}
        choices |= {i: (0, 1, -1) for i in range(self.surfaces) if self.sides[i] == 0 and i not in choices}
        try:
            self.sides = settled_sides(self.at(state), self.sides, choices)
        except Sliding as found:
            return sliding(self.names()[found.surface], state.t)
        except SingularMassMatrix:
            return EventResult(Status.SINGULAR)
        for i in choices:
            self.zero_sides[i] = Side(int(self.sides[i]))
        self.starting |= choices.keys()
        self.go_on(state)
        return EventResult()
