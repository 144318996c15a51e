"""The watched functions of a Taylor run, switching surfaces first and then event functions, and their zeros.

Their series follow those of the state in each row. Regular zeros are handled here. For all others the driver returns,
with nothing changed. The record of arguments that the loop over steps passes to its parts is here too.
"""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.events.constants import MOST_COEFFICIENTS
from lagrange.algorithm.events.polynomial import PADDED
from lagrange.algorithm.projection import CORRECTIONS
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.algorithm.taylor.memory import (
    BLOCK,
    HELD,
    JET,
    OUTPUTS,
    SIZES,
    TAYLOR,
    RecordedLayout,
    SeriesMemory,
    TaylorLayout,
    floors_array,
    work_array,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Kind, Record
from lagrange.procedure.values import Flag, Memory, Real, Whole

READ = Array(read=True)

FUNCTION = Callee((REAL, READ, READ, Array()), (FLAG,))
"""A function of a time, a state and prepared numbers; it returns whether its value is undefined."""

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
"""State of the search for zeros. An index is that of a watched function.

    enabled      1 if steps are inspected here, 0 if the driver must return for each
    hides_growth 1 if series may hide a growth: every step is inspected, and only as long as the series prove to be safe
    steep        1 if powers above the order are watched: every step is inspected, and the series are compared with the
                 functions at its end
    fresh        1 at the start of a motion whose sides are not known
    surfaces     number of switching surfaces
    changing     1 if some watched function may change the motion or end the run
    room         largest number of events that can be written
    done         number of written events, and `ahead` including those on the step that is not proven yet
    due          1 + the index of the function that vanishes at the end of the last step and changes the motion, or 0
    direction    the direction in which it passes through zero
    jumps        number of resets of the state
    checked      1 if the state after a reset must be checked, which the caller does
    planned      number of accepted steps after which a step planned by the caller is proven
    unproven     1 if the sides before the step that is not proven are saved: the present ones are at its end
    combination  the present sides as a binary number, 1 for above, the first surface in the last digit; or -1
    numbers      index at which the prepared numbers for these sides begin
    switches     number of written changes of sides
    changed      time of the last change of the motion, and `changed_at` the index of the function that vanished
"""

SIGN, NEAR, STARTING, COUNT = range(4)
"""Blocks of `sides`, one entry for each watched function: the side before the present step (see `roots`), whether it
came near zero, whether it starts at zero there, and the number of its events. The blocks are followed by the same
blocks before the step that is not proven."""

DIRECTION, TERMINAL, RESET_AT, RESET_SIZE, ROOT, SMOOTH = range(6)
"""Blocks of `settings`, one entry for each watched function: the direction that counts; the number of events that ends
the run, or 0; the first of its results among those of all resets, and their number; 1 for a square root; and 1 for an
event function that does not jump. The blocks are followed by the entries of the state that are reset."""

SIDES, SETTINGS = 4, 6
"""Number of blocks of sides, and of settings."""

COLUMN = MOST_COEFFICIENTS + 1
"""Coefficients that are stored for each watched function; a linear one that starts at zero has `LEAST_COUNT`."""

MOST_ZEROS = 64
"""Largest number of zeros on one step that the loop handles."""

TERM_SUMS = ("rest", "rates", "end", "slope", "late")
"""Sums of the terms x[k] s**k of a watched function on a step.

    rest   sum of the sizes of terms with k > 1, and `rates` that of k times their sizes
    end    sum of all terms: the value at the end of the step
    slope  sum of k times each term: the derivative there, in units of the step
    late   larger size of the last two terms
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
"""Scratch memory for each watched function: the number of entries of each part.

Watched functions are written in whole blocks: the parts after `noise` and `there` are written later."""


def scratch_sizes(count: int, dimension: int) -> tuple[int, int]:
    """Return the numbers of reals and of wholes in the scratch memory of procedures; see `Scratch`."""
    return count * (sum(REALS.values()) + dimension) + dimension + 4 * BLOCK, count * sum(WHOLES.values())


class Scratch:
    """Scratch memory, each part at its own offset. It grows with the watched functions, so it is not on the stack."""

    def __init__(self, layout: Any, reals: Memory, wholes: Memory) -> None:
        self.layout, self._reals, self._wholes = layout, reals, wholes

    def reals(self, part: str, number: int = 0) -> Memory:
        """Return part `part` of `REALS`. If it has several entries for each watched function, `number` selects one."""
        return self._reals.at(self.layout.watched * (_begin(REALS, part) + number))

    def wholes(self, part: str, number: int = 0) -> Memory:
        """Return part `part` of `WHOLES`; see `reals`."""
        return self._wholes.at(self.layout.watched * (_begin(WHOLES, part) + number))

    @property
    def moved(self) -> Memory:
        """Memory for a perturbed state, in whole blocks."""
        return self._reals.at(self.layout.watched * sum(REALS.values()) + BLOCK)

    @property
    def new_entries(self) -> Memory:
        """Memory for the results of all resets, or the state at the end of a step."""
        return self.moved.at(self.layout.dimension + 2 * BLOCK)


def _begin(parts: dict[str, int], wanted: str) -> int:
    """Return the number of entries for each watched function before a part."""
    names = list(parts)
    return sum(parts[name] for name in names[: names.index(wanted)])


class Watched:
    """The watched functions as arguments of a procedure, for one layout or for every layout."""

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
        """Number of watched functions."""
        return self.layout.watched

    @property
    def kept(self) -> Scratch:
        """The scratch memory."""
        return Scratch(self.layout, self.scratch, self.whole_scratch)

    @property
    def own_numbers(self) -> Memory:
        """The prepared numbers of the watched functions for the present sides."""
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
        """The arrays that events are written to: times, states and indices."""
        return self.event_times, self.event_states, self.event_places

    def side(self, block: int) -> Memory:
        """Return one of the blocks `SIGN`, `NEAR`, `STARTING` and `COUNT`, with an entry for each watched function."""
        return self.sides.at(self.count * block)

    def setting(self, block: int, place: Whole) -> Whole:
        """Return one of the settings of a watched function."""
        found: Whole = self.settings[place + self.count * block]
        return found

    def is_event(self, place: Whole) -> Flag:
        """Return whether a watched function is an event function, not a surface."""
        found: Flag = place >= self.record.surfaces
        return found

    def counts(self, place: Whole, direction: Whole) -> Flag:
        """Return whether a zero of an event function in a direction counts as an event."""
        wanted = self.setting(DIRECTION, place)
        found: Flag = wanted.equals(0) | wanted.equals(direction)
        return found

    def is_last(self, place: Whole, count: Whole) -> Flag:
        """Return whether the run ends when an event function has this number of events."""
        terminal = self.setting(TERMINAL, place)
        found: Flag = (terminal > 0) & (terminal <= count)
        return found


def column(p: Builder, layout: Any, rows: Memory, place: Whole, count: Any, to: Memory) -> None:
    """Copy the series of a watched function from the rows."""
    first, width = rows.at(place + layout.watched_at), layout.width
    with p.loop(0, count) as k:
        to[k] = first[k * width]


def restore_sides(watched: Watched) -> None:
    """Restore the sides before a step that is not proven, and drop its events."""
    p, record, size = watched.p, watched.record, watched.count * SIDES
    with p.when(~record.unproven.equals(0)):
        with p.loop(0, size) as i:
            watched.sides[i] = watched.sides[i + size]
        record.ahead, record.due, record.unproven = record.done, 0, 0


def prove_sides(watched: Watched) -> None:
    """Commit the events on the last step."""
    watched.record.done, watched.record.unproven = watched.record.ahead, 0


def write_event(watched: Watched, slot: Whole, t: Real, place: Whole) -> Memory:
    """Write the time and the index of an event; return the memory for its state."""
    watched.event_times[slot] = t
    watched.event_places[slot] = place
    return watched.event_states.at(slot * watched.layout.dimension)


class Arguments:
    """The arguments of the loop, of its iterations and of a step: the common ones, and a procedure's `own`."""

    def __init__(self, p: Builder, layout: TaylorLayout, **own: Kind | Array) -> None:
        self.p, self.layout = p, layout
        self.jet = p.function("jet", JET)
        self.prepared, self.constants = p.array("prepared", read=True), p.array("constants", read=True)
        self.run: Any = p.record("run", RUN)
        self.counts: Any = p.record("counts", COUNTS)
        self.taylor: Any = p.record("taylor", TAYLOR)
        self.floors = floors_array(p, layout, read=False)
        self.held: Any = p.record("held", HELD)
        self.outputs: Any = p.record("outputs", OUTPUTS)
        self.output_times, self.output_states = (
            p.array("output_times", read=True),
            p.array("output_states", room=layout.block),
        )
        self.times, self.rows = p.array("times"), p.array("rows", room=layout.block)
        self.watched = Watched(p, layout) if layout.watched else None
        self.projection: tuple[Any, ...] = ()
        """The function of the corrections onto the constraints, and its numbers; empty without constraints."""
        if layout.projected:
            self.projection = p.function("projection", CORRECTIONS), p.array("projection_numbers", read=True)
        self.own = [p.given(name, kind) for name, kind in own.items()]
        self.series = SeriesMemory(p, layout, work_array(p))

    def handed(self, *own: Any) -> tuple[Any, ...]:
        """Return the arguments for another procedure, followed by its own."""
        records = self.run, self.counts, self.taylor, self.floors, self.held
        watched = self.watched.handed if self.watched else ()
        written = *self.output, self.times, self.rows, *watched
        fixed = self.jet, self.prepared, self.constants
        return (*fixed, *records, *written, *self.projection, *own, *self.series.handed)

    @property
    def numbers(self) -> tuple[Any, ...]:
        """The prepared numbers of the series: with switching surfaces, those for the present sides."""
        if self.watched is None or self.layout.observes:
            return self.prepared, self.constants
        place = self.watched.record.numbers
        return self.prepared.at(place), self.constants.at(place)

    @property
    def output(self) -> tuple[Any, ...]:
        """The arguments of a procedure that writes states at output times."""
        return self.outputs, self.output_times, self.output_states
