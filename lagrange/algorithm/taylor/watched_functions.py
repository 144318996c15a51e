"""Memory of event functions and switching surfaces in a Taylor run, and all arguments of the loop over Taylor steps.

Both kinds are called watched functions. In each row of the series, their coefficients follow those of the state. The
loop handles zeros that it can resolve. For all other zeros it returns to its caller, with nothing changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.events.constants import MOST_COEFFICIENTS
from lagrange.algorithm.events.polynomial import PADDED
from lagrange.algorithm.projection import CORRECTIONS
from lagrange.algorithm.step.memory import FUNCTION, Counts, Run
from lagrange.algorithm.taylor.memory import (
    JET,
    Held,
    OutputCounts,
    Sizes,
    TaylorLayout,
    TaylorState,
    floors_type,
    layout_of,
    rows_type,
    work_type,
)
from lagrange.procedure.form import READ, WHOLE, Array
from lagrange.procedure.front.decorators import Bundle, Stated, inline
from lagrange.procedure.front.vocabulary import In, Out, WholesIn, WholesOut, form_of, record


@record
class Watch:
    """State of the search for zeros. Each index is that of a watched function.

    enabled       1 if steps are taken, 0 if the driver must return because the caller still has to change the motion.
    fresh         1 at the start of a motion whose sides are not determined yet.
    hides_growth  1 if a series has exp, sinh, cosh or tanh, whose terms may grow late: every step is inspected, and is
                  only as long as the series prove to be accurate.
    steep         1 if powers above the order are watched: at the end of every step their series are compared with the
                  functions.
    surfaces      Number of switching surfaces.
    changing      1 if some watched function may change the motion or end the run.
    room          Largest number of events that the arrays can hold.
    done          Number of written events.
    ahead         Number of written events, including those on the step that is not proven yet.
    due           Number of functions that are zero at the end of the last step, if one of them changes the motion; else
                  0.
    limiting      Index of the function whose series limits a step that is left to the caller.
    jumps         Number of resets of the state.
    checked       1 if the caller must check the state after a reset.
    unproven      1 if the sides before the unproven step are saved; then the present sides are those at its end.
    combination   The present sides as a binary number: 1 for above, the first surface in the lowest digit; or -1.
    numbers       Index at which the values that depend on parameters and on the present sides begin.
    switches      Number of written changes of sides.
    changed       Time of the last change of the motion.
    changed_at    Index of the function that was zero then.
    """

    enabled: int
    fresh: int
    hides_growth: int
    steep: int
    surfaces: int
    changing: int
    room: int
    done: int
    ahead: int
    due: int
    limiting: int
    jumps: int
    checked: int
    unproven: int
    combination: int
    numbers: int
    switches: int
    changed: float
    changed_at: int


WATCH = form_of(Watch)

COLUMN = MOST_COEFFICIENTS + 1
"""Number of stored coefficients of each watched function. A linear function that starts at zero has `LEAST_COUNT`
coefficients.
"""

MOST_ZEROS = 64
"""Largest number of zeros on one step that the loop can handle."""

TERM_SUMS = ("rest", "rates", "end", "slope", "late")
"""Sums of the terms x[k] s**k of a watched function on a step.

    rest   sum of the magnitudes of terms with k > 1
    rates  sum of k times these magnitudes
    end    sum of all terms: the value at the end of the step
    slope  sum of k times each term: the derivative at the end of the step, in units of the step
    late   the larger magnitude of the last two terms
"""

SIDES = {"signs": 1, "near_flags": 1, "starting": 1, "event_counts": 1}
"""Parts of the array `sides`, with the number of entries for each watched function.

signs         Last sign of the function beyond its noise, before the present step: 1, -1, or 0 for unknown.
near_flags    1 if the function has been near zero since it had this sign.
starting      Nonzero if the function starts at zero.
event_counts  Number of its events so far.

The same parts before the unproven step follow, named `kept_signs` and so on.
"""

SETTINGS = {"directions": 1, "terminals": 1, "resets_at": 1, "reset_sizes": 1, "roots": 1, "smooth": 1}
"""Parts of the array `settings`, with the number of entries for each watched function.

directions   Direction of the zeros that count.
terminals    Number of events after which the run ends; 0 for never.
resets_at    Index of the function's first result among the results of all resets.
reset_sizes  Number of the function's results among these; 0 without a reset.
roots        1 for a square root.
smooth       1 for an event function without jumps.

The part `reset_entries` follows: the index of the state's entry that each result of a reset replaces.
"""

REALS = {
    "columns": COLUMN,
    "terms": PADDED,
    "slopes": PADDED,
    "sums": len(TERM_SUMS),
    "times": 2 * MOST_ZEROS,
    "values": 1,
    "noise": 1,
    "end_values": 1,
    "end_noise": 1,
}
"""Parts of the scratch memory of reals, with the number of entries for each watched function.

columns               Coefficients of the function's series.
terms, slopes, sums   Terms of the series on a step and their sums, as `event_terms` writes them.
times                 Times of zeros, for two lists of zeros.
values, noise         Value of the function at the start of a step, and its rounding error.
end_values, end_noise The same at the end of the step.
"""

WHOLES = {
    "zeros": 4 * MOST_ZEROS,
    "ends": 4,
    "start_signs": 1,
    "start_near_flags": 1,
    "remaining": 1,
    "coefficient_counts": 1,
    "begun_signs": 1,
    "begun_orders": 1,
    "due": 1,
    "due_directions": 1,
}
"""Parts of the scratch memory of whole numbers, with the number of entries for each watched function.

zeros              Functions and directions of zeros, for two lists of zeros.
ends               Sign of the function at the end of a step and its flag for near zero, for each of the two lists.
start_signs        Sign at the start of a step.
start_near_flags   1 if the function has been near zero since it had this sign.
remaining          Number of zeros until the motion changes.
coefficient_counts Number of the function's coefficients in `columns`; 0 before they are copied.
begun_signs        Sign just after a start or a reset.
begun_orders       Order of the term that determines this sign; 0 if the function does not start at zero.
due                Indices of the functions that are zero at the end of the last step.
due_directions     Directions of these zeros.
"""


def _begins(array: str, sizes: Mapping[str, int], end: str = "") -> dict[str, tuple[str, int]]:
    """Return the begin of each part of an array for one watched function: {part: (name of the array, begin)}.

    `array` is the name of the array. `sizes` has the number of entries of each part for one function. The begin of
    a part is the sum of the sizes of all parts before it. `end` is a name for the part after the last one.
    """
    names = (*sizes, end or f"end of {array}")
    return {name: (array, begin) for name, begin in zip(names, accumulate(sizes.values(), initial=0), strict=True)}


PARTS = {
    **_begins("sides", {**SIDES, **{f"kept_{name}": size for name, size in SIDES.items()}}),
    **_begins("settings", SETTINGS, "reset_entries"),
    **_begins("scratch", REALS),
    **_begins("whole_scratch", WHOLES),
}
"""Array and begin of each named part of the arrays of `Watched`. The begin is the number of entries of all parts before
it, for one watched function.
"""


def scratch_sizes(count: int, dimension: int) -> tuple[int, int]:
    """Return the lengths of two scratch arrays, of reals and of whole numbers, for `count` watched functions.

    `dimension` is the length of the state.
    """
    return count * (sum(REALS.values()) + dimension) + dimension + 4 * WIDEST_VECTOR, count * sum(WHOLES.values())


@dataclass(frozen=True)
class Watched:
    """The watched functions (switching surfaces, then event functions) as arguments of a procedure.

    `watch` is the state of the search for zeros. `values` evaluates the functions, and `resets` the new entries
    of all resets; `value_numbers` and `reset_numbers` have their parameters, with all values that depend on
    these alone. `tilts` are factors near 1 that multiply the entries of a state to estimate rounding errors.
    `sides` has the present signs of the functions, and `settings` what their zeros do. Events are written to
    `event_times`, `event_states` and `event_places` (the indices of the functions).
    """

    watch: Watch
    sizes: Sizes
    values: Callable[..., Any]
    resets: Callable[..., Any]
    value_numbers: In
    reset_numbers: In
    tilts: In
    sides: WholesOut
    settings: WholesIn
    event_times: Out
    event_states: Out
    event_places: WholesOut
    combinations: WholesIn
    switch_rows: WholesOut
    switch_combinations: WholesOut
    scratch: Out
    """Scratch memory of reals, with the parts `REALS`. It grows with the watched functions, so it is not on the stack.
    """

    whole_scratch: WholesOut
    """Scratch memory of whole numbers, with the parts `WHOLES`."""

    work: Any
    """The work array with the series. It is None in the arguments of a step, which have the array themselves."""

    order: Any
    """The order of the series; None in the arguments of a step."""


def watched_type() -> Bundle:
    """Return the type of a procedure's parameter of class `Watched`, with the series of the functions."""
    return Bundle(Watched, {**watched_types(), "work": work_type(), "order": WHOLE})


def watched_types() -> dict[str, Stated]:
    """Return the types of those fields of `Watched` that annotations do not state, without `work` and `order`."""
    blocks = Array(room=WIDEST_VECTOR)
    return {"values": FUNCTION, "resets": FUNCTION, "event_states": blocks, "scratch": blocks}


@dataclass(frozen=True)
class WatchedView:
    """The watched functions with the parts of their arrays as attributes, such as signs and `noise`.

    In a part each watched function has one entry, or several. Other attributes are those of `Watched`, except
    `values`: here it is the part with the values of the functions.
    """

    watched: Watched
    layout: Any

    def __getattr__(self, name: str) -> Any:
        if name not in PARTS:
            return getattr(self.watched, name)
        name, begin = PARTS[name]
        array = getattr(self.watched, name)
        return array[self.layout.watched * begin :] if begin else array

    @property
    def rows(self) -> Any:
        """The coefficients of the watched functions in the rows of the series, from order 0 on."""
        return self.watched.work[self.layout.rows + self.layout.watched_at :]

    @property
    def moved(self) -> Any:
        """Memory for a perturbed state, in whole blocks."""
        return self.watched.scratch[self.layout.watched * sum(REALS.values()) + WIDEST_VECTOR :]

    @property
    def new_entries(self) -> Any:
        """Memory for the results of all resets, or for the state at the end of a step in `verified_length`."""
        return self.moved[self.layout.dimension + 2 * WIDEST_VECTOR :]

    @property
    def numbers(self) -> Any:
        """The parameters of watched functions, and the values that depend on them and the present sides (signs)."""
        return self.watched.value_numbers[self.watched.watch.numbers :]

    @inline
    def is_event(self, index: int) -> bool:
        """Return True if watched function number `index` is an event function, not a surface."""
        return index >= self.watched.watch.surfaces

    @inline
    def moves(self, index: int) -> bool:
        """Return True if zeros of function number `index` change the motion: it is a surface, or an event with a reset.

        Only zeros in the direction of the event count.
        """
        return self.reset_sizes[index] > 0 or not self.is_event(index)

    @inline
    def is_last(self, index: int, count: int) -> Any:
        """Return True if the run ends with event number `count` of event function number `index`."""
        terminal = self.terminals[index]
        return terminal > 0 and terminal <= count

    @inline
    def write_event(self, slot: int, t: float, index: int) -> Any:
        """Write the time t and the function `index` of event number `slot`. Return the array for its state.

        The caller writes the state to this array.
        """
        self.watched.event_times[slot] = t
        self.watched.event_places[slot] = index
        return self.watched.event_states[slot * self.layout.dimension :]


@inline
def view_of(watched: Watched) -> WatchedView:
    """Return the watched functions with each part of their arrays as an attribute."""
    return WatchedView(watched, layout_of(watched.sizes))


@inline
def restore_sides(watched: Watched, layout: Any) -> None:
    """Restore the signs that the watched functions had before the last step, and drop the events on it.

    Nothing changes if the defect test has confirmed the step.
    """
    watch, size = watched.watch, layout.watched * len(SIDES)
    if watch.unproven != 0:
        for i in range(size):
            watched.sides[i] = watched.sides[i + size]
        watch.ahead, watch.due, watch.unproven = watch.done, 0, 0


@dataclass(frozen=True)
class Arguments:
    """The arguments of the loop over Taylor steps and of its parts.

    `jet` computes the series from the arrays `prepared` and `constants`. The progress of the run is in five records:
    `run` (times and step lengths), `counts`, `taylor` (what only Taylor runs need), `held` (the start of the last
    step) and `outputs` (the output times done so far). `floors` are the absolute tolerances of the state's entries.
    Accepted times and states are written to `times` and `rows`, the states at the `output_times` to `output_states`.
    """

    jet: Callable[..., Any]
    prepared: In
    constants: In
    run: Run
    counts: Counts
    taylor: TaylorState
    floors: Out
    held: Held
    outputs: OutputCounts
    output_times: In
    output_states: Out
    times: Out
    rows: Out
    watched: Any
    """The `Watched` functions, or None."""

    projection: Any
    """Function that computes a correction of a state onto the constraints (`CORRECTIONS`); None without constraints."""

    projection_numbers: Any
    work: Out
    order: int
    """The order of the series, at least 4."""


def arguments(layout: TaylorLayout) -> Bundle:
    """Return the type of a procedure's parameter of class `Arguments`, for a layout."""
    types: dict[str, Stated] = {
        "jet": JET,
        "floors": floors_type(layout),
        "output_states": rows_type(layout),
        "rows": rows_type(layout),
        "watched": Bundle(Watched, {**watched_types(), "work": None, "order": None}) if layout.watched else None,
        "projection": CORRECTIONS if layout.projected else None,
        "projection_numbers": READ if layout.projected else None,
        "work": work_type(),
    }
    return Bundle(Arguments, types)


@inline
def watched_of(arguments: Arguments) -> Any:
    """Return the `Watched` functions with the memory and order of the series, or None without such functions."""
    watched, work, order = arguments.watched, arguments.work, arguments.order
    return None if watched is None else replace(watched, work=work, order=order)


@inline
def numbers_of(arguments: Arguments, layout: TaylorLayout) -> tuple[Any, Any]:
    """Return the numbers that a series reads: the parameters with all values that depend only on them, and constants.

    Both are arrays. A series with switching functions has such numbers for each combination of their signs; the arrays
    then begin at those for the present signs.
    """
    if arguments.watched is None or layout.observes:
        return arguments.prepared, arguments.constants
    begin = arguments.watched.watch.numbers
    return arguments.prepared[begin:], arguments.constants[begin:]
