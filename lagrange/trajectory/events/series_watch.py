"""Handle the events and crossed surfaces of a Taylor run that the compiled loop over steps leaves to Python.

The loop finds the zeros of event functions and switching surfaces. It ends a step at the first zero that changes the
motion. In simple cases the loop itself resets the state or crosses the surface. In other cases it returns, and this
module ends the run, resets the state, or continues with the equations after the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lagrange.algorithm.taylor.event_series import comparable_unit
from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.machine.drivers import EventMemory, SeriesDriver
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.array_search import EventZero, Root, Side
from lagrange.trajectory.events.end_messages import (
    EventResult,
    accumulating,
    at_rest,
    sliding,
    undefined,
    without_value,
    zero_root,
)
from lagrange.trajectory.events.event_log import ChangeCounter, EventLog
from lagrange.trajectory.events.model_events import ModelEvent, reset_state
from lagrange.trajectory.events.motion_start import sides_after_events
from lagrange.trajectory.events.series_at_state import EventSeries, leaving, near, signed_scale
from lagrange.trajectory.events.surfaces import (
    LEAP_SHARE,
    Continuations,
    Sliding,
    clear,
    settled_sides,
    stated_sides,
)
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState


class SeriesWatch(EventLog):
    """Finds zeros of surfaces and events along a run by Taylor steps. Indices count surfaces first, then events.

    `series` computes Taylor coefficients up to `order`. `names` returns the texts of the functions. `events` are all
    events of the run. `memory` is shared with the compiled loop over steps; it comes from a former run by the driver,
    or is None. `zero_sides` are the known signs of the functions before the next step. `starting` has the indices of
    the functions that are zero at the start of this step. `pending` are the zeros at the present state that are still
    to be processed.
    """

    def __init__(
        self,
        series: Series,
        order: int,
        driver: SeriesDriver,
        parameters: FloatArray,
        events: Sequence[ModelEvent],
        names: Callable[[], Sequence[str]],
        continuations: Continuations,
        memory: EventMemory | None = None,
    ) -> None:
        super().__init__(len(events), series.program.states)
        self.steep, self.hides_growth = series.program.watched_degree > order, series.program.hides_growth
        self.series, self.order, self.driver = series, order, driver
        self.names, self.continuations = names, continuations
        self.events, self.surfaces = tuple(events), series.program.sides
        self.zero_sides = [Side()] * (self.surfaces + len(self.events))
        self.starting: frozenset[int] = frozenset()
        self.pending: list[EventZero] = []
        self.change_counter = ChangeCounter()
        self.parameters, self.sides = parameters, np.zeros(self.surfaces)
        self.epochs: list[tuple[int, FloatArray]] = []
        self._values: dict[int, FloatArray] = {}
        self._last: tuple[object, EventSeries] | None = None
        if memory is None:
            resets = next((event.kernel for event in self.events if event.kernel is not None), None)
            reactions = [event.reaction for event in self.events]
            states = series.program.states
            memory = EventMemory(states, self.surfaces, reactions, series.values, resets, parameters)
            memory.record.hides_growth, memory.record.steep = int(self.hides_growth), int(self.steep)
            memory.record.checked = int(any(event.constrained for event in self.events))
            driver.watch(memory)
            memory.keep_start()
        else:
            memory.restart()
            if self.surfaces:
                driver.use(np.concatenate([parameters, np.full(self.surfaces, np.nan)]))
        self.memory = memory

    def begin(self, state: DriverState) -> EventResult:
        """Determine the signs of the watched functions at the start of a run, or of a new smooth piece of it.

        Return an empty result, or the reason why the run ends here: for example, a watched function has no finite
        value. A sign is 1 or -1, or 0 if it is undecided. Without switching surfaces, the compiled loop determines the
        signs later, and the result is empty.
        """
        first, self.state = self.state is None, state
        if self.surfaces:
            return self._begin(state)
        if first:
            self.epochs.append((0, self.values))
        else:
            self.write()
        self.memory.record.enabled = self.memory.record.fresh = state.taylor.inspect = 1
        return EventResult()

    def _begin(self, state: DriverState) -> EventResult:
        """Determine the signs of surfaces and events at the start of a smooth piece of motion, in Python.

        Return an empty result, or the reason why the run ends here.
        """
        result = self.start(state, {})
        if result.status is None:
            self.pending = self.events_at_once(state, ())
        self.write()
        return result

    def process(self, state: DriverState) -> EventResult:
        """Process the event at the state where the loop over steps stopped, and return the result.

        The state is reset, a surface is crossed, or the run ends. If there is no event, the result says why no step is
        possible from this state.
        """
        self.read(state)
        try:
            if self.lacks_sides:
                return self._begin(state)
            return self._finish(state) if self.pending else self._step_refused(state)
        finally:
            self.write()

    def _step_refused(self, state: DriverState) -> EventResult:
        """Return the end of the run at a state from which the series of a watched function is not valid."""
        ahead = self.ahead(state)
        if not np.isfinite(ahead.watched).all():
            result = undefined(self.names(), ahead.watched)
            # On a surface, rounding may put the state where a branch that begins there has no value.
            return replace(result, smooth=result.smooth or self._switches(ahead, 0.0))
        limiting = int(self.memory.record.limiting)
        name, value = self.names()[limiting], float(ahead.watched[0, limiting])
        smooth = limiting < self.surfaces
        lack = "it has no Taylor series"
        return zero_root(name) if self.is_root(limiting) else without_value(name, value, lack, smooth=smooth)

    def end(self, state: DriverState) -> EventResult:
        """Apply the pending events at the end of the run, and return the result: how the run ends."""
        self.read_events(state)
        if not self.pending and self.memory.record.due == 0:
            return EventResult(Status.SUCCESS)
        self.read_sides()
        result = self._finish(state)
        ended = result.status in (Status.EVENT, Status.NON_FINITE, Status.DIVERGED) and not result.smooth
        return result if ended else EventResult(Status.SUCCESS, jumped=result.jumped)

    def is_due(self, state: DriverState) -> bool:
        """Return True if an event is pending at the state. The motion may have no Taylor series from there."""
        self.read(state)
        return bool(self.pending)

    def continue_past(self, state: DriverState) -> EventResult | None:
        """Pass over the driver's state, where the motion has no Taylor series, by a short step of another method.

        Return the result after the step, or the end of the run if a square root becomes zero at the state. Return None
        if the point cannot be passed.
        """
        self.read(state)
        if self.lacks_sides and (begun := self._begin(state)).status is not None:
            return begun
        events = [self.surfaces + i for i, event in enumerate(self.events) if not event.root]
        for end in self.continuations.ahead(state):
            y = self.continuations.landing(state, end, switched=lambda soon: self._switches(self.ahead(state), soon))
            if y is None:
                continue
            sides = [self.zero_sides[i].sign for i in events]
            values = np.concatenate([self.parameters, stated_sides(self.series.program, end, y, self.parameters)])
            ends = np.sign(self.series.rows(self.order, end, y, signed_scale(state), values)[0, len(y) :][events])
            # No event may be passed: signs stay, or become 0. From 0 any sign is right unless the event has a reset.
            if all(
                b in (0, a) or (a == 0 and not self.events[i - self.surfaces].reset)
                for i, a, b in zip(events, sides, ends, strict=True)
            ):
                self.continuations.land(state, end, y, state.count(S.STEPS) + self.jumps)
                self.jump()
                self.driver.restart(state)
                done = end == state.reals[S.END]
                return replace(EventResult(Status.SUCCESS) if done else self.begin(state), jumped=True)
        return self._rootless(state)

    def _switches(self, ahead: EventSeries, soon: float) -> bool:
        """Return True if the state is on a switching surface, or reaches one within the time `soon`.

        `ahead` has the series of the surfaces.
        """
        return any(which in self.starting or ahead.falls(which, soon) for which in range(self.surfaces))

    def _rootless(self, state: DriverState) -> EventResult | None:
        """Return the end of the run if a square root of the equations becomes zero at the state, else None."""
        ahead, soon = self.ahead(state), LEAP_SHARE * abs(float(state.reals[S.END] - state.reals[S.START]))
        for which in filter(self.is_root, range(len(self.zero_sides))):
            # The radicand is the square of the root, and decreases twice as fast.
            if ahead.watched[0, which] == 0 or ahead.falls(which, 2 * soon):
                return replace(zero_root(self.names()[which]), smooth=False)
        return None

    def _finish(self, state: DriverState) -> EventResult:
        """Apply the pending zeros at a state: cross surfaces, record events, reset the state, or end the run."""
        pending, self.pending = self.pending, []
        if self.change_counter.accumulates(state.t, (zero.which for zero in pending)):
            return accumulating(self.names()[pending[0].which])
        before = list(self.zero_sides)
        for zero in pending:
            self.zero_sides[zero.which] = Side(zero.root.rising or self.zero_sides[zero.which].sign)
        self.starting = frozenset(zero.which for zero in pending)
        crossed = [zero for zero in pending if zero.which < self.surfaces and zero.root.rising]
        result = self._cross(crossed, state) if crossed else EventResult()
        zeros = [zero for zero in pending if zero.which >= self.surfaces]
        if crossed and result.status is None:
            zeros = self._on_surface(zeros, before, state)
        zeros = [zero for zero in zeros if self.event_of(zero).counts(zero.root.rising)]
        roots_met = [zero for zero in zeros if self.event_of(zero).root]
        zeros = [zero for zero in zeros if not self.event_of(zero).root]
        ends = self.occur([zero.which - self.surfaces for zero in zeros], self.events, state)
        resets = [zero for zero in zeros if self.event_of(zero).reset]
        if resets:
            return self._jump(resets, pending, state, ends=ends)
        if ends:
            return EventResult(Status.EVENT)
        return zero_root(self.names()[roots_met[0].which]) if roots_met and result.status is None else result

    def _on_surface(self, zeros: Sequence[EventZero], before: Sequence[Side], state: DriverState) -> list[EventZero]:
        """Return the events among `zeros`, with their directions after the crossing of a switching surface.

        All `zeros` are zeros of event functions at the state, on a surface that has just been crossed. The crossing may
        change a direction: abs(x) turns back at x = 0, so its zero is a touch. `before` are the signs of all watched
        functions before the crossing.
        """
        events = []
        for zero in zeros:
            g = self.ahead(state).near(zero.which)
            if clear(g):  # a jump: zero on one side of the surface, another value on the other
                self.zero_sides[zero.which], self.starting = Side(int(np.sign(g[0]))), self.starting - {zero.which}
                events += [zero] * (not self.is_root(zero.which))
                continue
            after = leaving(g)[0]
            if self.is_root(zero.which) and g[0] > 0 and not g[1:].any():
                # The branch that contains the root ends here, and the motion continues in another branch.
                self.zero_sides[zero.which] = Side(1)
                continue
            self.zero_sides[zero.which] = Side(after)
            # If the step ended after the zero, the direction of the zero determines the side before it.
            side = -zero.root.rising or before[zero.which].sign
            events.append(replace(zero, root=Root(zero.root.time, after if after != side else 0)))
        return events

    def _jump(
        self, zeros: Sequence[EventZero], all_zeros: Sequence[EventZero], state: DriverState, *, ends: bool
    ) -> EventResult:
        """Reset the state by the events in `zeros`, and start a new smooth piece of motion.

        If one of the events `ends` the run, no new piece is started. `all_zeros` has the zeros of all watched functions
        at this time, also of events without a reset.
        """
        before = self.ahead(state)
        resets = {self.event_of(zero): zero.which for zero in sorted(zeros, key=lambda zero: zero.which)}
        after, broken = reset_state(resets, self.names, state.t, state.y, self.parameters)
        if broken.status is not None:
            return broken
        state.y[:] = after
        self.jump()
        self.driver.restart(state)
        if ends:
            return EventResult(Status.EVENT, jumped=True)
        occurred_now = {zero.which: abs(float(before.watched[0, zero.which])) for zero in all_zeros}
        began = self.start(state, occurred_now, before)
        if began.status is None:
            for zero in zeros:
                sign, order = self.ahead(state).leaving(zero.which)
                if zero.which in self.starting and order > 1 and sign == zero.root.rising:
                    return replace(at_rest(self.names()[zero.which]), jumped=True)
            self.pending = self.events_at_once(state, occurred_now)
        return replace(began, jumped=True)

    def _cross(self, crossed: Sequence[EventZero], state: DriverState) -> EventResult:
        """Choose the sign with which the motion leaves each of the surfaces `crossed`, and continue with these signs.

        A motion that stayed on another surface may leave it with the new equations. The run ends if no sign is
        consistent.
        """
        choices = {zero.which: (zero.root.rising, -zero.root.rising, 0) for zero in crossed}
        choices |= {i: (0, 1, -1) for i in range(self.surfaces) if self.sides[i] == 0 and i not in choices}
        try:
            self.sides = settled_sides(self.at(state), self.sides, choices)
        except Sliding as error:
            return sliding(self.names()[error.surface], state.t)
        except SingularMassMatrix:
            return EventResult(Status.SINGULAR)
        for i in choices:
            self.zero_sides[i] = Side(int(self.sides[i]))
        self.starting |= choices.keys()
        self.go_on(state)
        return EventResult()

    def start(
        self, state: DriverState, zero_sizes: Mapping[int, float], before: EventSeries | None = None
    ) -> EventResult:
        """Determine the sign of every surface and event function at the driver's state, or just after it.

        `zero_sizes` maps the index of each event that occurred here to the size of its function. Four times this size
        counts as zero. `before` has the series before a reset, or is None.
        """
        self.sides = stated_sides(self.series.program, state.t, state.y, self.parameters)
        try:
            ahead = self.ahead(state)
            noise = ahead.noise.copy()
            for which, size in zero_sizes.items():
                noise[which] = max(noise[which], 4 * size)
            if self.surfaces:
                g = self.at(state)(self.sides)
                unsettled = {i: (0, 1, -1) for i in range(self.surfaces) if leaving(g[:, i], float(noise[i]))[1] != 0}
                self.sides = settled_sides(self.at(state), self.sides, unsettled) if unsettled else self.sides
                ahead = self.ahead(state)
        except Sliding as error:
            return sliding(self.names()[error.surface], state.t)
        except SingularMassMatrix:
            return EventResult(Status.SINGULAR)
        if not np.isfinite(ahead.watched).all():
            self.zero_sides = [Side(int(sign)) for sign in np.sign(np.nan_to_num(ahead.watched[0]))]
            return undefined(self.names(), ahead.watched)
        self.go_on(state)
        sides = self._known(before, ahead, zero_sizes)
        starts = [ahead.leaving(i, margin) for i, margin in enumerate(noise.tolist())]
        self.starting = frozenset(i for i, (_, order) in enumerate(starts) if i not in sides and order != 0)
        for i, (sign, _) in enumerate(starts):
            self.zero_sides[i] = Side(int(self.sides[i])) if i < self.surfaces else sides.get(i, Side(sign))
        return EventResult()

    def _known(self, before: EventSeries | None, ahead: EventSeries, occurred_now: Collection[int]) -> dict[int, Side]:
        """Return the sides (known signs) that event functions keep over a reset, by the index of the event.

        `before` and `ahead` are the series before and after the reset. Events in `occurred_now` keep no side.
        """
        if before is None:
            return {}
        events = slice(self.surfaces, None)
        change = before.watched[0, events], ahead.watched[0, events]
        occurred = [i - self.surfaces for i in occurred_now]
        sides = sides_after_events(self.zero_sides[events], self.events, change, before.noise[events], occurred)
        return {i: side for i, side in enumerate(sides, self.surfaces) if side.sign}

    def at(self, state: DriverState) -> Callable[[FloatArray], FloatArray]:
        """Return a function that evaluates the series of the switching surfaces at the driver's state.

        It maps the signs of the surfaces (1, -1 or 0) to their series (order + 1, surfaces), in units of time that make
        the terms comparable. The signs matter because the forces depend on them.
        """
        size, scale = len(state.y), signed_scale(state)

        def surfaces(sides: FloatArray) -> FloatArray:
            values = np.concatenate([self.parameters, sides])
            rows = self.series.rows(self.order, state.t, state.y, scale, values)
            g, unit = rows[:, size : size + self.surfaces], comparable_unit(state.t, scale)
            return near(g, unit, float(state.reals[S.RTOL]), np.zeros(self.surfaces))

        return surfaces

    def go_on(self, state: DriverState) -> None:
        """Pass the present signs of the switching surfaces to the driver, since the forces depend on them.

        At its next step the driver returns, so that this object inspects the state there.
        """
        values = self.values
        if not self.epochs or self.epochs[-1][1].tobytes() != values.tobytes():
            self.driver.use(values)
            self.epochs.append((state.count(S.STEPS) + self.jumps, values))
        state.taylor.inspect = 1

    def events_at_once(self, state: DriverState, occurred_now: Container[int]) -> list[EventZero]:
        """Return the zeros of contacts that act at the start of the motion, by the rules of `motion_start`.

        Contacts in `occurred_now` (indices) have just acted and are left out. Example: a ball that starts on the floor
        and falls has to bounce.
        """
        zeros = []
        for index, event in enumerate(self.events):
            which = self.surfaces + index
            turns = event.reset and event.direction == self.zero_sides[which].sign != 0
            if which in self.starting and which not in occurred_now and turns:
                y = state.y.copy()
                event.apply(state.t, state.y, self.parameters, y)
                passes = self.ahead(state, y).leaving(which, 0.0) == (event.direction, 1)
                zeros += [] if passes else [EventZero(which, Root(0.0, event.direction))]
        return zeros

    def ahead(self, state: DriverState, y: FloatArray | None = None) -> EventSeries:
        """Return the series at the driver's state, or at y (2n,), for the present signs of surfaces. It is cached."""
        values, scale = self.values, signed_scale(state)
        y = state.y if y is None else y
        key, rtol = (state.t, scale, y.tobytes(), values.tobytes()), float(state.reals[S.RTOL])
        if self._last is None or self._last[0] != key:
            self._last = key, EventSeries.at(self.series, self.order, state.t, y, scale, values, rtol)
        return self._last[1]

    @property
    def values(self) -> FloatArray:
        """The arguments of the series after time and state: the parameters, then the signs of switching surfaces."""
        return np.concatenate([self.parameters, self.sides])

    @property
    def jumps(self) -> int:
        """The number of resets of the state, and of short steps without a Taylor series, so far in the run."""
        return int(self.memory.record.jumps)

    def jump(self) -> None:
        """Count a jump of the state by a reset, or a short step without a Taylor series, in the memory of the loop."""
        self.memory.record.jumps += 1

    def event_of(self, zero: EventZero) -> ModelEvent:
        """Return the event to which a zero belongs."""
        return self.events[zero.which - self.surfaces]

    def is_root(self, which: int) -> bool:
        """Return True if function `which` is a square root in the equations of motion."""
        return which >= self.surfaces and self.events[which - self.surfaces].root

    def read(self, state: DriverState) -> None:
        """Read events, signs of the watched functions and pending events from the memory of the compiled loop."""
        self.read_events(state)
        self.read_sides()

    def read_events(self, state: DriverState) -> None:
        """Read the occurrences of events, and the crossings of surfaces, from the memory of the compiled loop."""
        memory = self.memory
        if memory.record.done:
            # Ctrl-C may interrupt the next lines. The mark prevents adding occurrences twice.
            steps, mark = state.count(DriverState.STEPS), memory.mark
            for occurrences, (times, states) in zip(self.occurrences, memory.written()[self.surfaces :], strict=True):
                state.kept += times.nbytes + states.nbytes
                occurrences.extend(times, states, steps, mark)
            memory.forget()
        if memory.record.switches:
            switched = memory.switched()
            for combination in dict.fromkeys(which for _, which in switched):
                if combination not in self._values:
                    self._values[combination] = np.concatenate([self.parameters, memory.sides_of(combination)])
            self.epochs += [(row, self._values[combination]) for row, combination in switched]
            self.sides = memory.sides_of(switched[-1][1])

    def read_sides(self) -> None:
        """Read the signs of the watched functions and the pending events from the memory of the compiled loop."""
        memory, record = self.memory, self.memory.record
        signs, near_flags = memory.signs.tolist(), memory.near_flags.tolist()
        self.zero_sides = [Side(sign, bool(near)) for sign, near in zip(signs, near_flags, strict=True)]
        self.starting = frozenset(np.flatnonzero(memory.starting).tolist())
        if record.due:
            self.pending = [EventZero(which, Root(0.0, direction)) for which, direction in memory.zeros_now()]
            record.due = 0
        if record.changed != self.change_counter.last:
            self.change_counter.begin(record.changed, record.changed_at)

    def write(self) -> None:
        """Write the signs of the watched functions, and the counts of events, to the memory of the compiled loop.

        While an event is pending, the loop takes no steps.
        """
        memory, record = self.memory, self.memory.record
        memory.signs[:] = [side.sign for side in self.zero_sides]
        memory.near_flags[:] = [side.near for side in self.zero_sides]
        memory.starting[:] = [index in self.starting for index in range(memory.count)]
        memory.event_counts[self.surfaces :] = [len(occurrences) for occurrences in self.occurrences]
        record.fresh, record.changed, record.enabled = 0, self.change_counter.last, int(not self.pending)

    @property
    def lacks_sides(self) -> bool:
        """True until the loop has determined the signs of functions at the start of a smooth piece of motion."""
        return bool(self.memory.record.fresh)
