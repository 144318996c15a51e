"""Sides of all surfaces and events at the start of a motion by Taylor steps, and contacts that act there at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence

import numpy as np

from lagrange.machine.backend import Series, SingularMassMatrix, TaylorDriver
from lagrange.machine.event_memory import EventMemory
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.end_messages import EventResult, sliding, undefined
from lagrange.trajectory.events.planned_step import EventZero
from lagrange.trajectory.events.roots import Root, Side
from lagrange.trajectory.events.series_on_step import EventSeries, near, signed_scale, unit
from lagrange.trajectory.events.shared_watch import SharedWatch
from lagrange.trajectory.events.sides_behind import sides_behind
from lagrange.trajectory.events.surfaces import Sliding, is_zero, leaving, settled_sides, stated_sides
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState


class SeriesStart(SharedWatch):
    """Finds the sides of surfaces and events from their series of an `order` at a state (names from `names`)."""

    def __init__(
        self,
        series: Series,
        order: int,
        driver: TaylorDriver,
        parameters: FloatArray,
        impacts: Sequence[Impact],
        names: Callable[[], Sequence[str]],
        memory: EventMemory | None,
    ) -> None:
        self.steep, self.hides_growth = series.program.watched_degree > order, series.program.hides_growth
        super().__init__(series, driver, parameters, impacts, memory, hides_growth=self.hides_growth, steep=self.steep)
        self.order, self.names = order, names
        self._last: tuple[object, EventSeries] | None = None

    def start(self, state: DriverState, stayed: Mapping[int, float], before: EventSeries | None = None) -> EventResult:
        """Find the side of every surface and event at the state, or right after it.

        `stayed` are the events that occurred here, with a size up to which, times 4, they count as zero. `before` is
        the series before a reset, or None.
        """
        self.sides = stated_sides(self.series.program, state.t, state.y, self.parameters)
        try:
            look = self.ahead(state)
            noise = look.noise.copy()
            for which, size in stayed.items():
                noise[which] = max(noise[which], 4 * size)
            if self.surfaces:
                g = self.at(state)(self.sides)
                unsettled = {i: (0, 1, -1) for i in range(self.surfaces) if is_zero(g[:, i], float(noise[i]))}
                self.sides = settled_sides(self.at(state), self.sides, unsettled) if unsettled else self.sides
                look = self.ahead(state)
        except Sliding as found:
            return sliding(self.names()[found.surface], state.t)
        except SingularMassMatrix:
            return EventResult(Status.SINGULAR)
        if not np.isfinite(look.watched).all():
            self.zero_sides = [Side(int(sign)) for sign in np.sign(np.nan_to_num(look.watched[0]))]
            return undefined(self.names(), look.watched)
        self.go_on(state)
        known, columns = self._known(before, look, stayed), list(look.near.T)
        self.starting = frozenset(i for i, g in enumerate(columns) if i not in known and is_zero(g, float(noise[i])))
        for i, g in enumerate(columns):
            ahead = leaving(g)[0] if i in self.starting else int(np.sign(g[0]))
            self.zero_sides[i] = Side(int(self.sides[i])) if i < self.surfaces else known.get(i, Side(ahead))
        return EventResult()

    def _known(self, before: EventSeries | None, look: EventSeries, happened: Collection[int]) -> dict[int, Side]:
        """Return the sides that events keep over a reset; events in `happened` have an open side."""
        if before is None:
            return {}
        own = slice(self.surfaces, None)
        change, there = (before.watched[0, own], look.watched[0, own]), [i - self.surfaces for i in happened]
        kept = sides_behind(self.zero_sides[own], self.impacts, change, before.noise[own], there)
        return {i: side for i, side in enumerate(kept, self.surfaces) if side.sign}

    def at(self, state: DriverState) -> Callable[[FloatArray], FloatArray]:
        """Return the series of the surfaces at the state as a function of their sides."""
        size, scale = len(state.y), signed_scale(state)

        def surfaces(sides: FloatArray) -> FloatArray:
            values = np.concatenate([self.parameters, sides])
            rows = self.series.rows(self.order, state.t, state.y, scale, values)
            return near(rows[:, size : size + self.surfaces], unit(state.t, scale), float(state.reals[S.RTOL]))

        return surfaces

    def go_on(self, state: DriverState) -> None:
        """Pass the present sides to the driver, and request an inspection of its next step."""
        values = self.values
        if not self.epochs or self.epochs[-1][1].tobytes() != values.tobytes():
            self.driver.use(values)
            self.epochs.append((state.count(S.STEPS) + self.jumps, values))
        state.taylor.inspect = 1

    def impacts_at_once(self, state: DriverState, happened: Container[int]) -> list[EventZero]:
        """Return contacts that act at the start of the motion, without those in `happened`, by rules of `sides_behind`.

        An example is a ball that starts on the floor and falls: it has to bounce.
        """
        found = []
        for place, impact in enumerate(self.impacts):
            which = self.surfaces + place
            turns = impact.reset and impact.direction == self.zero_sides[which].sign != 0
            if which in self.starting and which not in happened and turns:
                y = state.y.copy()
                impact.apply(state.t, state.y, self.parameters, y)
                g = self.ahead(state, y).near[:, which]
                passes = is_zero(g) and leaving(g) == (impact.direction, 1)
                found += [] if passes else [EventZero(which, Root(0.0, impact.direction))]
        return found

    def ahead(self, state: DriverState, y: FloatArray | None = None) -> EventSeries:
        """Return the series at the state, or at y, with the present sides; the last result is cached."""
        values, scale = self.values, signed_scale(state)
        y = state.y if y is None else y
        key, rtol = (state.t, scale, y.tobytes(), values.tobytes()), float(state.reals[S.RTOL])
        if self._last is None or self._last[0] != key:
            self._last = key, EventSeries.at(self.series, self.order, state.t, y, scale, values, rtol)
        return self._last[1]
