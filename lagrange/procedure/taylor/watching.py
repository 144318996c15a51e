"""What a Taylor run watches: surfaces on which the equations switch, then event functions; and what happened at them.

The series of what is watched stand behind those of the state in each row. What is regular is dealt with here; the
driver comes back for the rest, with nothing changed.
"""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import MOST_COEFFICIENTS
from lagrange.procedure.events.polynomial import PADDED
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Record
from lagrange.procedure.taylor.memory import BLOCK, SIZES, RecordedLayout, TaylorLayout
from lagrange.procedure.values import Flag, Memory, Real, Whole

READ = Array(read=True)

FUNCTION = Callee((REAL, READ, READ, Array()), (FLAG,))
"""A function of a time, a state and numbers that the machine has prepared; it says whether it has no value."""

WATCH = Record.of(
    "Watch",
    enabled=WHOLE,
    fresh=WHOLE,
    hides_growth=WHOLE,
    steep=WHOLE,
    surfaces=WHOLE,
    changing=WHOLE,
    room=WHOLE,
    done=WHOLE,
    ahead=WHOLE,
    due=WHOLE,
    direction=WHOLE,
    jumps=WHOLE,
    checked=WHOLE,
    planned=WHOLE,
    unproven=WHOLE,
    combination=WHOLE,
    numbers=WHOLE,
    switches=WHOLE,
    changed=REAL,
    changed_at=WHOLE,
)
"""What a run knows of what it watches.

    enabled      1 where steps are inspected here, 0 where the driver is to come back for each
    hides_growth 1 where series hide what they grow to: every step is inspected, and no longer than they show to be safe
    steep        1 where powers above the order are watched: every step is inspected, and its series are compared with
                 what is watched at its end
    fresh        1 where a motion begins whose sides are not known
    surfaces     how many of what is watched are surfaces
    changing     1 where something that is watched may change the motion or end the run
    room         how many events there is room for
    done         how many events are written, and `ahead` with those on the step that is not proven yet
    due          what vanishes at the end of the last step and changes the motion there: its place and 1; 0 for nothing
    direction    the direction in which it passes through zero
    jumps        how often the state was reset
    checked      1 where the state behind a reset is to be checked, which is done elsewhere
    planned      the number of accepted steps behind which a step planned elsewhere is proven
    unproven     1 where the sides before the step that is not proven are kept: others are at its end
    combination  the sides that hold as a binary number, 1 for above: the first surface is the last digit; or -1
    numbers      where in the arrays of numbers those for these sides begin
    switches     how many changes of sides are written
    changed      when the motion changed last, and `changed_at` what vanished then, by its place
"""

SIGN, NEAR, STARTING, COUNT = range(4)
"""For each thing that is watched: the side before the present step (see `roots`), whether it starts at zero there, and
how often it counted. Behind them the same as before the step that is not proven."""

DIRECTION, TERMINAL, RESET_AT, RESET_SIZE, ROOT, SMOOTH = range(6)
"""For each thing that is watched: the direction that counts, after how many times the run ends, or 0; where among the
results of all resets its own begin, and how many there are; 1 for a square root; and 1 for an event that does not jump.
Behind them stand the entries of the state that are reset."""

SIDES, SETTINGS = 4, 6
"""How many blocks of these there are."""

COLUMN = MOST_COEFFICIENTS + 1
"""So many coefficients of each thing watched have room; a linear one that starts at zero has `LEAST_COUNT`."""

MOST_ZEROS = 64
"""So many zeros on one step are dealt with in the loop."""

TERM_SUMS = ("rest", "rates", "end", "slope", "late")
"""What is known of the terms x[k] s**k of something watched on a step.

    rest   the sum of their sizes over k > 1, and `rates` that of k times their sizes
    end    the sum of all terms: the value at the end of the step
    slope  the sum of k times each: the derivative there, in units of the step
    late   the largest size among the last two
"""

REALS = {
    "columns": COLUMN,
    "terms": PADDED,
    "slopes": PADDED,
    "sums": len(TERM_SUMS),
    "times": 2 * MOST_ZEROS,
    "values": 1,
    "noise": 1,
    "there": 1,
    "blur": 1,
}
WHOLES = {"zeros": 4 * MOST_ZEROS, "ends": 4, "sides": 2, "seen": 1, "counts": 1, "begun": 2}
"""What is kept of each thing watched on the way: how many numbers of each part.

Functions of what is watched write whole blocks: behind `noise` and `there` stands what is written later."""


def scratch_sizes(count: int, dimension: int) -> tuple[int, int]:
    """Return how many reals and how many whole numbers procedures need beside their arguments; see `Scratch`."""
    return count * (sum(REALS.values()) + dimension) + dimension + 4 * BLOCK, count * sum(WHOLES.values())


class Scratch:
    """Memory on the way, each part at its own place: it grows with what is watched, and stacks may be small."""

    def __init__(self, layout: Any, reals: Memory, wholes: Memory) -> None:
        self.layout, self._reals, self._wholes = layout, reals, wholes

    def reals(self, part: str, number: int = 0) -> Memory:
        """Return one of `REALS`, of which there may be more than one, behind so many of each thing watched."""
        return self._reals.at(self.layout.watched * (_begin(REALS, part) + number))

    def wholes(self, part: str, number: int = 0) -> Memory:
        """Return one of `WHOLES`."""
        return self._wholes.at(self.layout.watched * (_begin(WHOLES, part) + number))

    @property
    def moved(self) -> Memory:
        """Another state, in whole blocks."""
        return self._reals.at(self.layout.watched * sum(REALS.values()) + BLOCK)

    @property
    def new_entries(self) -> Memory:
        """The results of all resets, and the state at the end of a step."""
        return self.moved.at(self.layout.dimension + 2 * BLOCK)


def _begin(parts: dict[str, int], wanted: str) -> int:
    """Return how many numbers of each thing watched stand before a part."""
    names = list(parts)
    return sum(parts[name] for name in names[: names.index(wanted)])


class Watched:
    """What is watched, as arguments of a procedure: of one for a layout, or of one that serves every layout."""

    def __init__(self, p: Builder, layout: TaylorLayout | None = None) -> None:
        self.p = p
        self.record: Any = p.record("watch", WATCH)
        self.sizes: Any = p.record("sizes", SIZES)
        self.layout: Any = RecordedLayout(self.sizes) if layout is None else layout
        self.values, self.resets = p.function("values", FUNCTION), p.function("resets", FUNCTION)
        self.value_numbers, self.reset_numbers = (p.array(f"{name}_numbers", read=True) for name in ("value", "reset"))
        self.tilts = p.array("tilts", read=True)
        self.sides = p.array("sides", WHOLE)
        self.settings = p.array("settings", WHOLE, read=True)
        self.event_times, self.event_states = p.array("event_times"), p.array("event_states", room=BLOCK)
        self.event_places = p.array("event_places", WHOLE)
        self.combinations = p.array("combinations", WHOLE, read=True)
        self.switch_rows = p.array("switch_rows", WHOLE)
        self.switch_combinations = p.array("switch_combinations", WHOLE)
        self.scratch = p.array("scratch", room=BLOCK)
        self.whole_scratch = p.array("whole_scratch", WHOLE)

    @property
    def count(self) -> Any:
        """How many things are watched."""
        return self.layout.watched

    @property
    def kept(self) -> Scratch:
        """Memory on the way."""
        return Scratch(self.layout, self.scratch, self.whole_scratch)

    @property
    def own_numbers(self) -> Memory:
        """The numbers of what is watched with the sides that hold."""
        return self.value_numbers.at(self.record.numbers)

    @property
    def handed(self) -> tuple[Any, ...]:
        """The arguments for another procedure."""
        functions = self.values, self.resets, self.value_numbers, self.reset_numbers, self.tilts
        switches = self.combinations, self.switch_rows, self.switch_combinations
        scratch = self.scratch, self.whole_scratch
        return (self.record, self.sizes, *functions, self.sides, self.settings, *self.events, *switches, *scratch)

    @property
    def events(self) -> tuple[Memory, ...]:
        """Where events are written to."""
        return self.event_times, self.event_states, self.event_places

    def side(self, block: int) -> Memory:
        """Return one of `SIGN`, `NEAR`, `STARTING` and `COUNT` of all that is watched."""
        return self.sides.at(self.count * block)

    def setting(self, block: int, place: Whole) -> Whole:
        """Return one of the settings of one thing that is watched."""
        found: Whole = self.settings[place + self.count * block]
        return found

    def is_event(self, place: Whole) -> Flag:
        """Whether something that is watched is not a surface."""
        found: Flag = place >= self.record.surfaces
        return found

    def counts(self, place: Whole, direction: Whole) -> Flag:
        """Whether a zero of an event function in a direction is an event."""
        wanted = self.setting(DIRECTION, place)
        found: Flag = wanted.equals(0) | wanted.equals(direction)
        return found

    def is_last(self, place: Whole, count: Whole) -> Flag:
        """Whether the run ends when an event has counted so often."""
        terminal = self.setting(TERMINAL, place)
        found: Flag = (terminal > 0) & (terminal <= count)
        return found


def column(p: Builder, layout: Any, rows: Memory, place: Whole, count: Any, to: Memory) -> None:
    """Copy the series of something that is watched from the rows."""
    first, width = rows.at(place + layout.watched_at), layout.width
    with p.loop(0, count) as k:
        to[k] = first[k * width]


def restore_sides(watched: Watched) -> None:
    """Go back to what held before a step that is not proven; its events have not happened."""
    p, record, size = watched.p, watched.record, watched.count * SIDES
    with p.when(~record.unproven.equals(0)):
        with p.loop(0, size) as i:
            watched.sides[i] = watched.sides[i + size]
        record.ahead, record.due, record.unproven = record.done, 0, 0


def prove_sides(watched: Watched) -> None:
    """Let the events on the last step have happened."""
    watched.record.done, watched.record.unproven = watched.record.ahead, 0


def write_event(watched: Watched, slot: Whole, t: Real, place: Whole) -> Memory:
    """Write the time and the place of an event; return where its state belongs."""
    watched.event_times[slot] = t
    watched.event_places[slot] = place
    return watched.event_states.at(slot * watched.layout.dimension)
