"""What is watched along a run: events, and the surfaces on which the equations of motion switch.

The driver comes back before a step on which something watched may vanish. The roots of its polynomial on the step are
isolated here; the step is then taken whole, or up to the first root that changes the motion, and what happens there
is done: the run ends, the state is reset, or the equations go on with the other side of a surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagrange.machine.backend import Series, SingularMassMatrix, TaylorDriver
from lagrange.machine.driver import DriverState
from lagrange.trajectory.impact import Impact
from lagrange.trajectory.look import Look, signed_scale, state_at
from lagrange.trajectory.roots import Root, Side, roots
from lagrange.trajectory.sides import Sliding, apparent_sides, is_zero, leaving, settled_sides
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


@dataclass(frozen=True)
class _Occurrence:
    """An event: when, the state there (2n,), and the accepted steps without which it has not happened."""

    t: float
    y: FloatArray
    steps: int


class Watch:
    """Watches the surfaces, then the events, along the run of one state."""

    def __init__(
        self,
        series: Series,
        order: int,
        driver: TaylorDriver,
        parameters: FloatArray,
        impacts: Sequence[Impact],
        names: Callable[[], Sequence[str]],
    ) -> None:
        self.series, self.order, self.driver, self.parameters = series, order, driver, parameters
        self.impacts, self.names = tuple(impacts), names
        self.surfaces = series.program.sides
        self.sides = np.zeros(self.surfaces)
        self.relay = [Side()] * (self.surfaces + len(self.impacts))
        self.occurrences: list[list[_Occurrence]] = [[] for _ in self.impacts]
        self.epochs: list[tuple[int, FloatArray]] = []
        self.pending: list[_Meeting] = []
        self.starting: frozenset[int] = frozenset()
        self.state: DriverState | None = None
        self._last: tuple[object, Look] | None = None
        self.jumps = 0
        self.last_change = -math.inf
        self.changes = 0

    @property
    def values(self) -> FloatArray:
        """The parameters, then the sides."""
        return np.concatenate([self.parameters, self.sides])

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,)."""
        return tuple(np.array([one.t for one in found]) for found in self._happened())

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n)."""
        size = 2 * self.series.program.dimension
        return tuple(np.array([one.y for one in found]).reshape(-1, size) for found in self._happened())

    def _happened(self) -> list[list[_Occurrence]]:
        """Return the events up to the last accepted step: a run may end before the step that was looked at."""
        reached = 0 if self.state is None else self.state.count(S.STEPS)
        return [[one for one in found if one.steps <= reached] for found in self.occurrences]

    def begin(self, state: DriverState) -> Verdict:
        """Find the side of every surface at the start of the run."""
        self.state = state
        verdict = self._start(state, {})
        if verdict.status is None:
            self.pending = self._impacts_at_once(state)
        return verdict

    def meet(self, state: DriverState) -> Verdict:
        """Decide on the step that the driver proposes: set its length, or do what happens at its start."""
        if self.pending:
            return self._finish(state)
        look = self._look(state)
        if not np.isfinite(look.watched).all():
            return self._undefined(look)
        h, left = float(state.reals[S.H]), float(state.reals[S.END] - state.t - state.reals[S.LOW])
        s, limiting = look.trusted(h / look.scale, float(state.reals[S.RTOL]))
        whole = s == h / look.scale
        if not whole and abs(s * look.scale) < TOGETHER * abs(state.t) + 2.0**-70 * abs(left):
            return self._without_series(look, limiting)
        found, after = self._roots(look, s, last=whole and h == left)
        cut = self._first_change(found)
        if cut is not None:
            return self._shorten(cut.root.time, found, look, state)
        self._record(found, look, state)
        self.relay, self.starting = after, frozenset()
        state.reals[S.ONCE] = abs(h if whole else s * look.scale)
        state.counts[S.LOOK] = int(not all(side.settled for side in after))
        return Verdict()

    def end(self, state: DriverState) -> Verdict:
        """Do what is pending at the end of the run; how the motion would go on from there is no matter."""
        verdict = self._finish(state) if self.pending else Verdict()
        ended = verdict.status in (Status.EVENT, Status.NON_FINITE)
        return verdict if ended else Verdict(Status.SUCCESS, jumped=verdict.jumped)

    def _start(self, state: DriverState, stayed: Mapping[int, float]) -> Verdict:
        """Find the side of every surface, and on which side of zero everything watched is or is about to be.

        `stayed` has what is known to be zero at the state, unless it is much larger than the value given there.
        """
        try:
            look = self._look(state)
            noise = look.noise.copy()
            for which, size in stayed.items():
                noise[which] = max(noise[which], 4 * size)
            if self.surfaces:
                self.sides = apparent_sides(self._at(state), self.surfaces, noise)
                unsettled = {i: (0, 1, -1) for i in range(self.surfaces) if self.sides[i] == 0}
                self.sides = settled_sides(self._at(state), self.sides, unsettled) if unsettled else self.sides
                look = self._look(state)
        except Sliding as found:
            return self._slides(found.surface, state)
        except SingularMassMatrix:
            return Verdict(Status.SINGULAR)
        if not np.isfinite(look.watched).all():
            return self._undefined(look)
        self._go_on(state)
        columns = list(look.watched.T)
        self.starting = frozenset(i for i, g in enumerate(columns) if is_zero(g, float(noise[i])))
        for i, g in enumerate(columns):
            ahead = leaving(g)[0] if i in self.starting else int(np.sign(g[0]))
            self.relay[i] = Side(int(self.sides[i]) if i < self.surfaces else ahead)
        return Verdict()

    def _at(self, state: DriverState) -> Callable[[FloatArray], FloatArray]:
        """Return the series of the surfaces at the state as a function of their sides."""
        size, scale = len(state.y), signed_scale(state)

        def surfaces(sides: FloatArray) -> FloatArray:
            values = np.concatenate([self.parameters, sides])
            return self.series.rows(self.order, state.t, state.y, scale, values)[:, size : size + self.surfaces]

        return surfaces

    def _go_on(self, state: DriverState) -> None:
        """Let the driver run with the sides as they are, and look at its next step."""
        values = self.values
        if not self.epochs or self.epochs[-1][1].tobytes() != values.tobytes():
            self.driver.use(values)
            self.epochs.append((state.count(S.STEPS) + self.jumps, values))
        state.counts[S.LOOK] = 1

    def _impacts_at_once(self, state: DriverState) -> list[_Meeting]:
        """Return the events that happen at the very start: those that would turn the motion back where it starts.

        A zero at the start is no event otherwise. But a ball that starts on the floor and falls is to bounce.
        """
        found = []
        for place, impact in enumerate(self.impacts):
            which = self.surfaces + place
            if which in self.starting and impact.reset and impact.direction == self.relay[which].sign != 0:
                y = state.y.copy()
                impact.apply(state.t, state.y, y)
                rows = self.series.rows(self.order, state.t, y, signed_scale(state), self.values)
                g = rows[:, len(y) + which]
                passes = is_zero(g) and leaving(g) == (impact.direction, 1)
                found += [] if passes else [_Meeting(which, Root(0.0, impact.direction))]
        return found

    def _look(self, state: DriverState) -> Look:
        """Look ahead from the state with the sides as they are; looking again costs nothing."""
        values, scale = self.values, signed_scale(state)
        key = (state.t, scale, state.y.tobytes(), values.tobytes())
        if self._last is None or self._last[0] != key:
            self._last = key, Look.at(self.series, self.order, state.t, state.y, scale, values)
        return self._last[1]

    def _roots(self, look: Look, s: float, *, last: bool) -> tuple[list[_Meeting], list[Side]]:
        """Return the roots of all that is watched on a step, in order, and the sides at its end."""
        found: list[_Meeting] = []
        after = []
        for which, before in enumerate(self.relay):
            g, noise = look.watched[:, which], float(look.noise[which])
            if which in self.starting:
                # What starts at zero is divided by time: its root there is known, and the next may be close.
                g, noise = g[1:], 0.0
            met, side = roots(g, s, before, noise=noise, last=last)
            found += [_Meeting(which, root) for root in met]
            after.append(side)
        return sorted(found, key=lambda m: m.root.time), after

    def _first_change(self, found: Iterable[_Meeting]) -> _Meeting | None:
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

    def _shorten(self, s: float, found: list[_Meeting], look: Look, state: DriverState) -> Verdict:
        """End the step at the root at s; what happens there is pending until the driver comes back at its end."""
        while True:
            near = TOGETHER * max(abs(state.t / look.scale), s)
            pending = [m for m in found if abs(m.root.time - s) <= near]
            if s == 0:
                self.pending = pending
                return self._finish(state)
            # The shorter step tells more apart: what it has is what is kept, and a change may come out before s.
            found, after = self._roots(look, s, last=False)
            first = self._first_change(m for m in found if m.root.time < s - near)
            if first is None:
                break
            s = first.root.time
        waiting = {m.which for m in pending}
        late = [m for m in found if m.root.time >= s - near]
        self.pending = pending + [m for m in late if m.which not in waiting]
        self._record([m for m in found if m.root.time < s - near], look, state)
        self.relay, self.starting = after, frozenset()
        state.reals[S.ONCE] = s * abs(look.scale)
        state.counts[S.LOOK] = 1
        return Verdict()

    def _record(self, found: Iterable[_Meeting], look: Look, state: DriverState) -> None:
        """Keep the events among some roots on the next step."""
        for meeting in found:
            place = meeting.which - self.surfaces
            if place >= 0 and self.impacts[place].counts(meeting.root.rising):
                t = float(state.t + state.reals[S.LOW] + meeting.root.time * look.scale)
                y = state_at(state.y, look.rows, meeting.root.time)
                self.occurrences[place].append(_Occurrence(t, y, state.count(S.STEPS) + 1))

    def _finish(self, state: DriverState) -> Verdict:
        """Do what is pending at the state: surfaces are crossed, events kept, the state is reset or the run ended."""
        found, self.pending = self.pending, []
        met = [m for m in found if m.which >= self.surfaces and self._impact(m).counts(m.root.rising)]
        for m in met:
            here = _Occurrence(state.t, state.y.copy(), state.count(S.STEPS))
            self.occurrences[m.which - self.surfaces].append(here)
        if self._accumulates(state):
            return Verdict(Status.STEP_TOO_SMALL, self._too_often(found))
        for m in found:
            self.relay[m.which] = Side(m.root.rising or self.relay[m.which].sign)
        self.starting = frozenset(m.which for m in found)
        ends = any(0 < self._impact(m).terminal <= len(self.occurrences[m.which - self.surfaces]) for m in met)
        if any(self._impact(m).reset for m in met):
            return self._jump([m for m in met if self._impact(m).reset], state, ends=ends)
        if ends:
            return Verdict(Status.EVENT)
        return self._cross([m for m in found if m.which < self.surfaces and m.root.rising], state)

    def _impact(self, meeting: _Meeting) -> Impact:
        return self.impacts[meeting.which - self.surfaces]

    def _jump(self, met: Sequence[_Meeting], state: DriverState, *, ends: bool) -> Verdict:
        """Reset the state, every event from the state before, and start the motion anew."""
        before, after = state.y.copy(), state.y.copy()
        at_zero = np.abs(self._look(state).watched[0])
        for impact in dict.fromkeys(self.impacts[m.which - self.surfaces] for m in sorted(met, key=lambda m: m.which)):
            impact.apply(state.t, before, after)
        if not np.isfinite(after).all():
            return Verdict(Status.NON_FINITE, "The reset of an event gives no finite state.")
        state.y[:] = after
        self.jumps += 1
        self.driver.restart(state)
        if ends:
            return Verdict(Status.EVENT, jumped=True)
        began = self._start(state, {m.which: float(at_zero[m.which]) for m in met})
        if began.status is None:
            for m in met:
                sign, order = leaving(self._look(state).watched[:, m.which])
                if m.which in self.starting and order > 1 and sign == m.root.rising:
                    return Verdict(Status.STEP_TOO_SMALL, self._comes_to_rest(m), jumped=True)
        return replace(began, jumped=True)

    def _cross(self, crossed: Sequence[_Meeting], state: DriverState) -> Verdict:
        """Go on with the other side of each surface that is crossed, if the motion leaves to it.

        What stayed on a surface by itself may not do so with the new equations.
        """
        choices = {m.which: (m.root.rising, -m.root.rising, 0) for m in crossed}
        choices |= {i: (0, 1, -1) for i in range(self.surfaces) if self.sides[i] == 0 and i not in choices}
        try:
            self.sides = settled_sides(self._at(state), self.sides, choices)
        except Sliding as found:
            return self._slides(found.surface, state)
        except SingularMassMatrix:
            return Verdict(Status.SINGULAR)
        for i in choices:
            self.relay[i] = Side(int(self.sides[i]))
        self.starting |= choices.keys()
        self._go_on(state)
        return Verdict()

    def _accumulates(self, state: DriverState) -> bool:
        """Whether changes of the motion follow one another so closely that time stands still."""
        near = abs(state.t - self.last_change) <= CLOSEST * max(abs(state.t), 1e-290)
        self.changes = self.changes + 1 if near else 0
        self.last_change = state.t
        return self.changes >= 2 + 2 * len(self.relay)

    def _comes_to_rest(self, meeting: _Meeting) -> str:
        return (
            f"After the reset {self.names()[meeting.which]} is zero without a velocity of its own and goes on to the "
            "same side: the motion comes to rest there, as a ball does after infinitely many bounces, and the reset "
            "does not say how it stays. End the run with a terminal event, or state the contact as a stiff spring."
        )

    def _too_often(self, found: Sequence[_Meeting]) -> str:
        return (
            f"Events accumulate: {self.names()[found[0].which]} is zero again and again within the spacing of "
            "floating-point times, as a ball that bounces lower and lower comes to rest after infinitely many impacts. "
            "End the run before it, or state what rest is with a terminal event."
        )

    def _slides(self, surface: int, state: DriverState) -> Verdict:
        return Verdict(
            Status.STEP_TOO_SMALL,
            f"The equations of motion switch where {self.names()[surface]} is zero, and at t = {state.t:.6g} both "
            "sides lead back there: the motion sticks to the surface, where the equations do not say what it does. "
            "Smooth the switch, such as sign(v) by tanh(v/0.001), or end the run there with a terminal event.",
        )

    def _undefined(self, look: Look) -> Verdict:
        bad = int(np.argmax(~np.isfinite(look.watched).all(axis=0)))
        value = look.watched[0, bad]
        return Verdict(
            Status.NON_FINITE, f"{self.names()[bad]} is {value} there, or its derivatives are not finite numbers."
        )

    def _without_series(self, look: Look, bad: int) -> Verdict:
        return Verdict(
            Status.NON_FINITE,
            f"{self.names()[bad]}, which is watched, has a pole there or leaves its domain: its value is "
            f"{look.watched[0, bad]:.4g} and no series of it leads on. End the run before it, or watch an expression "
            "without the division, root or logarithm.",
        )
