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
from lagrange.algorithm.taylor.memory import SIZES, TaylorLayout
from lagrange.algorithm.taylor.watching import MOST_ZEROS, SIDES, WATCH, due_part, scratch_sizes
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.values import Flag, Memory, Real, Whole

ENDED_BY_EVENT = len(Outcome)
"""Code in addition to the outcomes: an event ended the member."""

MEMBER_EVENT_ROOM = 2 * MOST_ZEROS
"""Number of events that can be stored until they are copied, which is done after each step."""


@dataclass(frozen=True)
class Events:
    """The watched functions of members: `count` of them, and the first `events` are the user's events.

    `values` evaluates all from a time, a state and the numbers of the system. See `WATCH` for the flags.
    """

    values: Procedure
    count: int
    events: int
    changing: bool
    hides_growth: bool
    steep: bool


class FirstOccurrences:
    """The first occurrences of `kept` events of each member, at most `most` of each; adds the result arrays."""

    def __init__(self, p: Builder, kept: int, dimension: int) -> None:
        self.p, self.kept, self.dimension = p, kept, dimension
        self.most: Whole = p.given("most", WHOLE)
        self.all_times, self.all_states = p.array("occurrence_times"), p.array("occurrence_states")

    def reserve_counts(self) -> None:
        """Reserve memory, after all parameters have been added."""
        self.seen = self.p.reserve(max(self.kept, 1), WHOLE, name="seen")

    def forget(self) -> None:
        """Reset the counts at the start of a member."""
        for place in range(self.kept):
            self.seen[place] = 0

    def keep(self, member: Whole, place: Whole, t: Real, state: Memory) -> None:
        """Store an occurrence of an event, if it is among the first `most`."""
        p, n = self.p, self.dimension
        number = self.seen[p.smaller(place, max(self.kept - 1, 0))]
        with p.when((place < self.kept) & (number < self.most)):
            slot = (member * self.kept + place) * self.most + number
            self.all_times[slot] = t
            target = self.all_states.at(slot * n)
            with p.each(n, width=1) as i:
                target[i] = state[i]
            self.seen[place] = number + 1


class MemberOccurrences(FirstOccurrences):
    """Search for the events of a member, in memory of a procedure, to which it adds its parameters."""

    def __init__(self, p: Builder, events: Events, dimension: int) -> None:
        super().__init__(p, events.events, dimension)
        self.events = events
        self.sizes = p.record("sizes", SIZES)
        self.settings, self.tilts = p.array("settings", WHOLE, read=True), p.array("tilts", read=True)

    def reserve(self, layout: TaylorLayout) -> None:
        """Reserve memory, after all parameters have been added."""
        p, count, n = self.p, self.events.count, self.dimension
        reals, wholes = scratch_sizes(count, n)
        self.record: Any = p.reserve_record(WATCH)
        self.sides = p.reserve(2 * SIDES * count, WHOLE, name="sides")
        self.times, self.states = (
            p.reserve(MEMBER_EVENT_ROOM, name="event_times"),
            p.reserve(MEMBER_EVENT_ROOM * n, room=WIDEST_VECTOR, name="event_states"),
        )
        self.places = p.reserve(MEMBER_EVENT_ROOM, WHOLE, name="event_places")
        self.unused = p.reserve(1, WHOLE, name="unused")
        self.scratch = p.reserve(reals, room=WIDEST_VECTOR, name="scratch")
        self.whole_scratch = p.reserve(wholes, WHOLE, name="whole_scratch")
        self.reserve_counts()
        self.taken = p.variable(0, "taken")

    def handed(self, numbers: Memory) -> dict[str, Any]:
        """Return the arguments of the loop over steps, by name."""
        given = {"watch": self.record, "sizes": self.sizes, "value_numbers": numbers, "reset_numbers": numbers}
        given |= {"tilts": self.tilts, "sides": self.sides, "settings": self.settings}
        given |= {"event_times": self.times, "event_states": self.states, "event_places": self.places}
        given |= {"combinations": self.unused, "switch_rows": self.unused, "switch_combinations": self.unused}
        return given | {"scratch": self.scratch, "whole_scratch": self.whole_scratch}

    def begin(self, taylor: Any) -> None:
        """Reset the search at the start of a member: no events, and unknown sides."""
        p, record, events = self.p, self.record, self.events
        for name, kind in WATCH.fields:
            setattr(record, name, 0.0 if kind is REAL else 0)
        record.enabled = record.fresh = taylor.inspect = 1
        record.changing, record.room = int(events.changing), MEMBER_EVENT_ROOM
        record.hides_growth, record.steep = int(events.hides_growth), int(events.steep)
        record.changed = -math.inf
        with p.each(2 * SIDES * events.count, width=1) as i:
            self.sides[i] = 0
        self.forget()
        self.taken.value = 0

    def take(self, member: Whole) -> None:
        """Copy the events on proven steps to the results."""
        p, record = self.p, self.record
        with p.when(record.done > self.taken.value, likely=False):
            with p.repeat(lambda: self.taken.value < record.done):
                slot = self.taken.value
                self.keep(member, self.places[slot], self.times[slot], self.states.at(slot * self.dimension))
                self.taken.value = slot + 1
            with p.when(record.ahead.equals(record.done)):
                record.done = record.ahead = self.taken.value = 0

    @property
    def due(self) -> Whole:
        """The index of the first function that vanishes at the end of the last step."""
        place: Whole = self.whole_scratch[self.events.count * due_part(0)]
        return place

    def ended(self, outcome: Whole, unproven: Whole, last: Flag) -> Flag:
        """Return whether an event, and nothing else, ends the run at the present state."""
        due = self.record.due.equals(1) & (self.due < self.events.events) & unproven.equals(0)
        stopped = outcome.equals(Outcome.DONE) | outcome.equals(Outcome.WATCHED)
        found: Flag = due & (stopped | (outcome.equals(Outcome.PAUSED) & last))
        return found
