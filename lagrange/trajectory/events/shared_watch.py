"""State shared by a watch and the compiled loop over Taylor steps, which treats regular events by itself.

A watch plans a step: the zeros on it, and its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import Series, TaylorDriver
from lagrange.machine.event_memory import EventMemory, Reaction
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.event_log import ChangeCounter, EventLog
from lagrange.trajectory.events.zeros_on_step import EventZero, Root, Side
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True)
class PlannedStep:
    """The number of the next step of a run, with the sides and the occurrences before it, in case it is taken back."""

    steps: int = 0
    zero_sides: tuple[Side, ...] = ()
    starting: frozenset[int] = frozenset()
    counts: tuple[int, ...] = ()


class SharedWatch(EventLog):
    """Sides and pending events of surfaces and events, which the watch and the loop pass to each other as a whole.

    `memory` is that of a former run by the driver with the same parameters, or None. `zero_sides` are the sides before
    the next step, `starting` has the functions that are zero there, and `pending` the events at the present state.
    `planned` is the state of these before the step that the watch has planned.
    """

    def __init__(
        self,
        series: Series,
        driver: TaylorDriver,
        parameters: FloatArray,
        impacts: Sequence[Impact],
        memory: EventMemory | None,
        *,
        hides_growth: bool,
        steep: bool,
    ) -> None:
        super().__init__(len(impacts), series.program.states)
        self.series, self.driver = series, driver
        self.impacts, self.surfaces = tuple(impacts), series.program.sides
        self.zero_sides = [Side()] * (self.surfaces + len(self.impacts))
        self.starting: frozenset[int] = frozenset()
        self.pending: list[EventZero] = []
        self.planned = PlannedStep()
        self.change_counter = ChangeCounter()
        self.parameters, self.sides = parameters, np.zeros(self.surfaces)
        self.epochs: list[tuple[int, FloatArray]] = []
        self._values: dict[int, FloatArray] = {}
        if memory is None:
            memory = self._made(series, parameters)
            memory.record.hides_growth, memory.record.steep = int(hides_growth), int(steep)
            memory.record.checked = int(any(one.constrained for one in self.impacts))
            driver.watch(memory)
            memory.keep_start()
        else:
            memory.restart()
            if self.surfaces:
                driver.use(np.concatenate([parameters, np.full(self.surfaces, np.nan)]))
        self.memory = memory

    def _made(self, series: Series, parameters: FloatArray) -> EventMemory:
        """Return new memory for the loop."""
        reactions = [
            Reaction(one.direction, one.terminal, one.first, one.rows, one.root, one.smooth) for one in self.impacts
        ]
        resets = next((one.kernel for one in self.impacts if one.kernel is not None), None)
        return EventMemory(series.program.states, self.surfaces, reactions, series.values, resets, parameters)

    @property
    def values(self) -> FloatArray:
        """The parameters, then the sides."""
        return np.concatenate([self.parameters, self.sides])

    @property
    def jumps(self) -> int:
        """The number of jumps of the state."""
        return int(self.memory.record.jumps)

    def jump(self) -> None:
        """Count a jump of the state."""
        self.memory.record.jumps += 1

    def impact_of(self, zero: EventZero) -> Impact:
        """Return the event to which a zero belongs."""
        return self.impacts[zero.which - self.surfaces]

    def is_root(self, which: int) -> bool:
        """Return True if function `which` is a square root in the equations of motion."""
        return which >= self.surfaces and self.impacts[which - self.surfaces].root

    def remember(self, state: DriverState) -> None:
        """Save sides and counts before a step, since the driver may reject it."""
        counts = tuple(map(len, self.occurrences))
        self.planned = PlannedStep(state.count(DriverState.STEPS) + 1, tuple(self.zero_sides), self.starting, counts)

    def forget(self) -> None:
        """Restore sides and counts after the driver rejected the planned step."""
        self.pending, self.zero_sides, self.starting = [], list(self.planned.zero_sides), self.planned.starting
        for found, count in zip(self.occurrences, self.planned.counts, strict=True):
            found.cut(count)
        self.planned = PlannedStep()

    def read(self, state: DriverState) -> None:
        """Read events, sides and pending events from the loop."""
        self.read_events(state)
        self.read_sides(state)

    def read_events(self, state: DriverState) -> None:
        """Read the occurrences of events, and the crossings of surfaces, from the loop."""
        memory = self.memory
        if memory.record.done:
            # Ctrl-C may come anywhere here; the mark prevents that occurrences are added twice.
            steps, mark = state.count(DriverState.STEPS), memory.mark
            for found, (times, states) in zip(self.occurrences, memory.written()[self.surfaces :], strict=True):
                state.kept += times.nbytes + states.nbytes
                found.extend(times, states, steps, mark)
            memory.forget()
        if memory.record.switches:
            switched = memory.switched()
            for combination in dict.fromkeys(which for _, which in switched):
                if combination not in self._values:
                    self._values[combination] = np.concatenate([self.parameters, memory.sides_of(combination)])
            self.epochs += [(row, self._values[combination]) for row, combination in switched]
            self.sides = memory.sides_of(switched[-1][1])

    @property
    def is_pending(self) -> bool:
        """True if an event is pending at the present state."""
        return bool(self.pending) or self.memory.record.due != 0

    def read_sides(self, state: DriverState) -> None:
        """Read the sides and the pending event from the loop."""
        memory, record = self.memory, self.memory.record
        signs, nears = memory.signs.tolist(), memory.nears.tolist()
        self.zero_sides = [Side(sign, bool(near)) for sign, near in zip(signs, nears, strict=True)]
        self.starting = frozenset(np.flatnonzero(memory.starting).tolist())
        if record.due:
            self.pending = [EventZero(record.due - 1, Root(0.0, record.direction))]
            self.planned = PlannedStep(state.count(DriverState.STEPS))
            record.due = 0
        if record.changed != self.change_counter.last:
            self.change_counter.begin(record.changed, record.changed_at)

    def write(self, state: DriverState) -> None:
        """Write the sides for the loop, which is disabled while an event is pending."""
        memory, record, planned = self.memory, self.memory.record, self.planned
        record.unproven = int(planned.steps > state.count(DriverState.STEPS))
        if record.unproven:
            self._put(planned.zero_sides, planned.starting)
            memory.keep()
        self._put(self.zero_sides, self.starting)
        record.fresh = 0
        record.planned, record.changed = planned.steps, self.change_counter.last
        record.enabled = int(not self.pending)

    @property
    def unbegun(self) -> bool:
        """True if the loop has not yet found the sides at the start of the motion."""
        return bool(self.memory.record.fresh)

    def leave_start_to_the_loop(self, state: DriverState, *, first: bool) -> None:
        """Let the loop find the sides at the start of a motion; `first` is True at the start of the run."""
        if first:
            self.epochs.append((0, self.values))
        else:
            self.write(state)
        self.memory.record.enabled = self.memory.record.fresh = state.taylor.inspect = 1

    def leave_all_to_the_watch(self) -> None:
        """Disable the loop: it returns before each step on which a function may vanish."""
        self.memory.record.enabled = 0

    def _put(self, zero_sides: Sequence[Side], starting: frozenset[int]) -> None:
        memory = self.memory
        memory.signs[:] = [side.sign for side in zero_sides]
        memory.nears[:] = [side.near for side in zero_sides]
        memory.starting[:] = [place in starting for place in range(memory.count)]
        memory.counts[self.surfaces :] = [len(found) for found in self.occurrences]
