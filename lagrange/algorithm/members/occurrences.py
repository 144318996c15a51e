"""Events of members: the first occurrences of each event, and the search for events on Taylor steps.

The loop over steps finds events as in single runs. An irregular case, such as a double zero or none within rounding,
ends the member here, and the member is run again alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.taylor.memory import Sizes, TaylorLayout, TaylorState
from lagrange.algorithm.taylor.watching import MOST_ZEROS, PARTS, SIDES, Watch, Watched, scratch_sizes
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    WholesOut,
    clear,
    each,
    reals,
    unlikely,
    unrolled,
    wholes,
)

ENDED_BY_EVENT = len(Outcome)
"""Code in addition to the outcomes: an event ended the member."""

MEMBER_EVENT_ROOM = 2 * MOST_ZEROS
"""Number of events that can be stored until they are copied, which is done after each step."""


@dataclass(frozen=True)
class TaylorEvents:
    """The watched functions of members: `count` of them, and the first `events` are the user's events.

    `values` evaluates all of them from a time, a state and the prepared numbers. `changing` is true if one of
    them may end the run. `hides_growth` is true if a series may hide growth, so that every step is inspected.
    `steep` is true if series are compared with the functions at the end of every step, because of powers above
    the order.
    """

    values: Procedure
    count: int
    events: int
    changing: bool
    hides_growth: bool
    steep: bool


@dataclass(frozen=True)
class OccurrenceArrays:
    """Results of the search for events: the times and states of the first `most` occurrences of each event."""

    most: int
    occurrence_times: Out
    occurrence_states: Out


@dataclass(frozen=True)
class FirstOccurrences:
    """The first occurrences of `kept` events of each member, for states of a `dimension`."""

    kept: int
    dimension: int

    @inline
    def memory(self) -> WholesOut:
        """Return memory for the number of occurrences of each event."""
        return wholes(max(self.kept, 1))

    @inline
    def begin(self, seen: WholesOut) -> None:
        """Reset the counts `seen` of occurrences at the start of a member's run."""
        for event in unrolled(self.kept):
            seen[event] = 0

    @inline
    def keep(self, arrays: Any, seen: WholesOut, index: int, event: int, t: float, state: In) -> None:
        """Store the time and state of an event of member `index` in `arrays`, if it is among the first.

        `event` is the index of the event, and `seen` has the number of stored occurrences of each event.
        """
        number = seen[min(event, max(self.kept - 1, 0))]
        if event < self.kept and number < arrays.most:
            slot = (index * self.kept + event) * arrays.most + number
            arrays.occurrence_times[slot] = t
            target = arrays.occurrence_states[slot * self.dimension :]
            for i in each(self.dimension, width=1):
                target[i] = state[i]
            seen[event] = number + 1


@dataclass(frozen=True)
class SearchArguments(OccurrenceArrays):
    """Arguments of the search for events on Taylor steps, and the arrays for the results.

    `sizes` and `settings` describe the watched functions, and `tilts` are the factors of a perturbed state.
    """

    sizes: Sizes
    settings: WholesIn
    tilts: In


@dataclass(frozen=True)
class SearchMemory:
    """Memory of the search for events on the steps of a member: its state, scratch memory, and new events.

    `watch` and `sides` are the state of the search: `sides` has the signs of the watched functions. The
    `times`, `states` and `places` (functions) are those of the found events. `seen` is the number of
    occurrences of each event so far.
    """

    watch: Watch
    sides: WholesOut
    times: Out
    states: Out
    places: WholesOut
    unused: WholesOut
    scratch: Out
    whole_scratch: WholesOut
    seen: WholesOut
    taken: WholesOut
    """Number of events that are copied to the results, one entry."""


class EventSearch:
    """The search for the events of members on Taylor steps."""

    def __init__(self, events: TaylorEvents, layout: TaylorLayout) -> None:
        self.events, self.dimension = events, layout.dimension
        self.occurrences = FirstOccurrences(events.events, layout.dimension)

    @inline
    def memory(self) -> SearchMemory:
        """Return memory for the search for events on the steps of one member."""
        count, n = self.events.count, self.dimension
        real_count, whole_count = scratch_sizes(count, n)
        states = reals(MEMBER_EVENT_ROOM * n, room=WIDEST_VECTOR)
        events = reals(MEMBER_EVENT_ROOM), states, wholes(MEMBER_EVENT_ROOM), wholes(1)
        scratch = reals(real_count, room=WIDEST_VECTOR), wholes(whole_count)
        seen = self.occurrences.memory()
        return SearchMemory(Watch(), wholes(2 * len(SIDES) * count), *events, *scratch, seen, wholes(1))

    @inline
    def arguments(self, memory: SearchMemory, job: Any, numbers: In) -> Watched:
        """Return a member's watched functions and its prepared numbers as arguments of the loop over steps."""
        watched = job.watched
        unused = memory.unused, memory.unused, memory.unused, memory.scratch, memory.whole_scratch
        arrays = watched.tilts, memory.sides, watched.settings, memory.times, memory.states, memory.places, *unused
        arguments: Any = watched.sizes, job.values, job.values, numbers, numbers, *arrays, None, None
        return Watched(memory.watch, *arguments)

    @inline
    def begin(self, memory: SearchMemory, taylor: TaylorState) -> None:
        """Reset the search at the start of a member's run: no events, and unknown signs of the functions."""
        watch, events = memory.watch, self.events
        clear(watch)
        watch.enabled, watch.fresh, taylor.inspect = 1, 1, 1
        watch.changing, watch.room = int(events.changing), MEMBER_EVENT_ROOM
        watch.hides_growth, watch.steep = int(events.hides_growth), int(events.steep)
        watch.changed = -math.inf
        for i in each(2 * len(SIDES) * events.count, width=1):
            memory.sides[i] = 0
        self.occurrences.begin(memory.seen)
        memory.taken[0] = 0

    @inline
    def take(self, memory: SearchMemory, job: Any, index: int) -> None:
        """Copy new events, on steps that the defect test has confirmed, to the results of member `index`."""
        watch, slot = memory.watch, memory.taken[0]
        if unlikely(watch.done > slot):
            while slot < watch.done:
                t, state = memory.times[slot], memory.states[slot * self.dimension :]
                self.occurrences.keep(job.watched, memory.seen, index, memory.places[slot], t, state)
                slot += 1
            memory.taken[0] = slot
            if watch.ahead == watch.done:
                watch.done, watch.ahead, memory.taken[0] = 0, 0, 0

    @inline
    def due(self, memory: SearchMemory) -> int:
        """Return the index of the watched function listed first among those that are zero at the end of the step."""
        return memory.whole_scratch[self.events.count * PARTS["due"][1]]

    @inline
    def is_ended(self, memory: SearchMemory, outcome: int, unproven: int, last: bool) -> bool:
        """Return True if an event, and nothing else, ends the run at the present state.

        `outcome` is that of the loop over steps. `unproven` is 1 if the defect test has not confirmed the last
        step yet. `last` is true if the budget allows no more steps.
        """
        is_due = memory.watch.due == 1 and self.due(memory) < self.events.events and unproven == 0
        is_stopped = outcome == Outcome.DONE or outcome == Outcome.WATCHED
        return is_due and (is_stopped or (outcome == Outcome.PAUSED and last))
