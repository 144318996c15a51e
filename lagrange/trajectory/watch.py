"""What is watched along a run: events, and the surfaces on which the equations of motion switch.

The driver comes back before a step on which something watched may vanish. The roots of its polynomial on the step are
isolated here; the step is then taken whole, or up to the first root that changes the motion, and what happens there
is done: the run ends, the state is reset, or the equations go on with the other side of a surface.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import Series, TaylorDriver
from lagrange.machine.driver import DriverState
from lagrange.trajectory.impact import Impact
from lagrange.trajectory.roots import Root, Side, roots
from lagrange.trajectory.sides import Sliding, is_zero, leaving, settle, settled_side, signed_scale
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState

TOGETHER = 4 * 2.0**-52
"""Roots closer than this part of the time happen at once."""

CLOSEST = 16 * 2.0**-52
"""Events that change the motion closer than this part of the time cannot be told apart: they accumulate."""


@dataclass(frozen=True)
class Verdict:
    """What came of a look: a status if the run ends, with a sentence, and whether the state has jumped."""

    status: Status | None = None
    detail: str = ""
    jumped: bool = False


@dataclass(frozen=True)
class _Meeting:
    """A root of something that is watched: its place among the watched, and when, in units of the scale."""

    which: int
    root: Root


class Watch:
    """Watches the surfaces, then the events; `occurrences` has (t, y) of each event so far."""

    def __init__(
        self,
        series: Series,
        order: int,
        driver: TaylorDriver,
        parameters: FloatArray,
        impacts: Sequence[Impact],
        names: Sequence[str],
    ) -> None:
        self.series, self.order, self.driver, self.parameters = series, order, driver, parameters
        self.impacts, self.names = tuple(impacts), tuple(names)
        self.surfaces = series.program.sides
        self.sides = np.zeros(self.surfaces)
        self.relay = [Side()] * (self.surfaces + len(self.impacts))
        self.occurrences: list[list[tuple[float, FloatArray]]] = [[] for _ in self.impacts]
        self.epochs: list[tuple[int, FloatArray]] = []
        self.pending: list[_Meeting] = []
        self.starting: frozenset[int] = frozenset()
        self.jumps = 0
        self.last_change = -math.inf
        self.changes = 0

    @property
    def values(self) -> FloatArray:
        """The parameters, then the sides."""
        return np.concatenate([self.parameters, self.sides])

    def begin(self, state: DriverState) -> Verdict:
        """Find the side of every surface at the state, and start the motion from there."""
        try:
            self.sides = settle(self.series, self.order, self.parameters, state)
        except Sliding as sliding:
            return self._slides(sliding.surface, state)
        self._go_on(state)
        self._start(state)
        return Verdict()

    def _start(self, state: DriverState) -> None:
        """Note on which side of zero everything watched is, or is about to be if it is zero now."""
        watched = self._watched(state)
        doubtful = [which for which in range(len(self.relay)) if is_zero(watched[:, which])]
        self.starting = frozenset(doubtful)
        for which in range(len(self.relay)):
            g = watched[:, which]
            self.relay[which] = Side(leaving(g)[0] if which in self.starting else int(np.sign(g[0])))

    def _watched(self, state: DriverState) -> FloatArray:
        """Return the series of all that is watched at the state, (order + 1, watched), in the direction of the run."""
        rows = self.series.rows(self.order, state.t, state.y, signed_scale(state), self.values)
        return rows[:, len(state.y) :]

    def _go_on(self, state: DriverState) -> None:
        """Let the driver run with the sides as they are, and look at its next step."""
        self.driver.use(self.values)
        if not self.epochs or self.epochs[-1][1].tobytes() != self.values.tobytes():
            self.epochs.append((state.count(S.STEPS) + self.jumps, self.values))
        state.counts[S.LOOK] = 1

    def meet(self, state: DriverState) -> Verdict:
        """Decide on the step that the driver proposes: set its length, or do what happens at its start."""
        if self.pending:
            return self.finish(state)
        scale, h = float(state.reals[S.SCALE]), float(state.reals[S.H])
        rows = self.series.rows(self.order, state.t, state.y, scale, self.values)
        watched = rows[:, len(state.y) :]
        if not np.isfinite(watched).all():
            return Verdict(Status.NON_FINITE, self._undefined(watched))
        left = state.reals[S.END] - state.t - state.reals[S.LOW]
        found, after = self._roots(watched, h / scale, last=h == left)
        cut = self._first_change(found)
        if cut is None:
            self._record(found, state, rows)
            return self._pass(state, abs(h), after)
        s = cut.root.time
        together = TOGETHER * max(abs(state.t), abs(h)) / abs(scale)
        self._record([m for m in found if m.root.time < s - together], state, rows)
        self.pending = [m for m in found if abs(m.root.time - s) <= together]
        if s <= together:
            return self.finish(state)
        # The step ends at the root; the driver comes back at its end, and what is pending happens there.
        self.relay = self._roots(watched, s, last=False)[1]
        self.starting = frozenset()
        state.reals[S.ONCE] = s * abs(scale)
        state.counts[S.LOOK] = 1
        return Verdict()

    def end(self, state: DriverState) -> Verdict:
        """Do what is pending at the end of the run."""
        if self.pending:
            verdict = self.finish(state)
            if verdict.status is not None:
                return verdict
            return Verdict(Status.SUCCESS, jumped=verdict.jumped)
        return Verdict(Status.SUCCESS)

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,)."""
        return tuple(np.array([t for t, _ in found]) for found in self.occurrences)

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n)."""
        size = 2 * self.series.program.dimension
        return tuple(np.array([y for _, y in found]).reshape(-1, size) for found in self.occurrences)

    def _roots(self, watched: FloatArray, s: float, *, last: bool) -> tuple[list[_Meeting], list[Side]]:
        """Return the roots of all that is watched on a step, in order, and the sides at its end."""
        found: list[_Meeting] = []
        after = []
        for which, before in enumerate(self.relay):
            # What starts at zero is divided by time: its root there is known, and the next may be close.
            g = watched[1:, which] if which in self.starting else watched[:, which]
            met, side = roots(g, s, before, last=last)
            found += [_Meeting(which, root) for root in met]
            after.append(side)
        return sorted(found, key=lambda m: m.root.time), after

    def _first_change(self, found: Sequence[_Meeting]) -> _Meeting | None:
        """Return the first root that changes the motion: a surface is crossed, an event ends the run or has a reset."""
        seen = [len(times) for times in self.occurrences]
        for meeting in found:
            place = meeting.which - self.surfaces
            if place < 0:
                if meeting.root.rising:
                    return meeting
            elif self.impacts[place].counts(meeting.root.rising):
                seen[place] += 1
                if self.impacts[place].reset or 0 < self.impacts[place].terminal <= seen[place]:
                    return meeting
        return None

    def _record(self, found: Sequence[_Meeting], state: DriverState, rows: FloatArray) -> None:
        """Keep the events among some roots."""
        for meeting in found:
            place = meeting.which - self.surfaces
            if place >= 0 and self.impacts[place].counts(meeting.root.rising):
                t = state.t + state.reals[S.LOW] + meeting.root.time * state.reals[S.SCALE]
                self.occurrences[place].append((float(t), _at(state.y, rows, meeting.root.time)))

    def _pass(self, state: DriverState, length: float, after: list[Side]) -> Verdict:
        """Take the whole step."""
        state.reals[S.ONCE] = length
        self.relay, self.starting = after, frozenset()
        state.counts[S.LOOK] = int(not all(side.settled for side in after))
        return Verdict()

    def finish(self, state: DriverState) -> Verdict:
        """Do what is pending at the state: surfaces are crossed, events kept, the state is reset or the run ended."""
        found, self.pending = self.pending, []
        met = [(self.impacts[m.which - self.surfaces], m) for m in found if m.which >= self.surfaces]
        met = [(impact, m) for impact, m in met if impact.counts(m.root.rising)]
        for _, m in met:
            self.occurrences[m.which - self.surfaces].append((state.t, state.y.copy()))
        if self._accumulates(state):
            return Verdict(Status.STEP_TOO_SMALL, self._too_often(found))
        for m in found:
            self.relay[m.which] = Side(m.root.rising or self.relay[m.which].sign)
        self.starting = frozenset(m.which for m in found)
        resets = [impact for impact, _ in met if impact.reset]
        if resets and not self._reset(resets, state):
            return Verdict(Status.NON_FINITE, "The reset of an event gives no finite state.")
        if any(0 < impact.terminal <= len(self.occurrences[m.which - self.surfaces]) for impact, m in met):
            return Verdict(Status.EVENT, jumped=bool(resets))
        if resets:
            began = self.begin(state)
            resting = next((m for impact, m in met if impact.reset and self._rests(m, state)), None)
            if began.status is None and resting is not None:
                return Verdict(Status.STEP_TOO_SMALL, self._comes_to_rest(resting), jumped=True)
            return Verdict(began.status, began.detail, jumped=True)
        return self._cross([m for m in found if m.which < self.surfaces and m.root.rising], state)

    def _reset(self, resets: Sequence[Impact], state: DriverState) -> bool:
        """Let the state jump; return whether it is finite, else it stays."""
        before, after = state.y.copy(), state.y.copy()
        for impact in resets:
            impact.apply(state.t, before, after)
        if not np.isfinite(after).all():
            return False
        state.y[:] = after
        self.jumps += 1
        self.driver.restart(state)
        return True

    def _cross(self, crossed: Sequence[_Meeting], state: DriverState) -> Verdict:
        """Go on with the other side of each surface that is crossed, if the motion leaves to it."""
        try:
            for m in crossed:
                side = settled_side(self.series, self.order, self.values, state, m.which, m.root.rising)
                self.sides[m.which] = side
                self.relay[m.which] = Side(int(side))
        except Sliding as sliding:
            return self._slides(sliding.surface, state)
        self._go_on(state)
        return Verdict()

    def _rests(self, meeting: _Meeting, state: DriverState) -> bool:
        """Whether after its reset an event is about to happen at once, with no velocity that could be turned back."""
        sign, order = leaving(self._watched(state)[:, meeting.which])
        return meeting.which in self.starting and order > 1 and sign == meeting.root.rising

    def _comes_to_rest(self, meeting: _Meeting) -> str:
        return (
            f"After the reset {self.names[meeting.which]} is zero without a velocity of its own and goes on to the "
            "same side: the motion comes to rest there, as a ball does after infinitely many bounces, and the reset "
            "does not say how it stays. End the run with a terminal event, or state the contact as a stiff spring."
        )

    def _accumulates(self, state: DriverState) -> bool:
        """Whether changes of the motion follow one another so closely that time stands still."""
        near = abs(state.t - self.last_change) <= CLOSEST * max(abs(state.t), 1e-290)
        self.changes = self.changes + 1 if near else 0
        self.last_change = state.t
        return self.changes >= 2 + 2 * len(self.relay)

    def _too_often(self, found: Sequence[_Meeting]) -> str:
        return (
            f"Events accumulate: {self.names[found[0].which]} is zero again and again within the spacing of "
            "floating-point times, as a ball that bounces lower and lower comes to rest after infinitely many impacts. "
            "End the run before it, or state what rest is with a terminal event."
        )

    def _slides(self, surface: int, state: DriverState) -> Verdict:
        return Verdict(
            Status.STEP_TOO_SMALL,
            f"The equations of motion switch where {self.names[surface]} is zero, and at t = {state.t:.6g} both sides "
            "lead back there: the motion sticks to the surface, where the equations do not say what it does. Smooth "
            "the switch, such as sign(v) by tanh(v/0.001), or end the run there with a terminal event.",
        )

    def _undefined(self, watched: FloatArray) -> str:
        bad = int(np.argmax(~np.isfinite(watched).all(axis=0)))
        return f"{self.names[bad]} is {watched[0, bad]} there, or its derivatives are not finite."


def _at(y: FloatArray, rows: FloatArray, s: float) -> FloatArray:
    """Return the state (2n,) at a time on the step, in units of the scale."""
    total = np.zeros(len(y))
    for row in rows[:0:-1, : len(y)]:
        total = (total + row) * s
    return y + total
