"""Loop over steps with events: take steps, search them for events, go back to an event that changes the motion.

The search is called review. A change of the motion is a reset of the state, other equations of motion, or the end of
the run. A reset after which the event function leaves zero is applied here. Events whose zeros cannot be resolved are
left to the caller, together with the steps that are not reviewed yet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from lagrange.algorithm.constants import EARLIEST, WIDEST_VECTOR, Outcome
from lagrange.algorithm.events.constants import (
    ALONG,
    CLEARLY,
    CLOSEST,
    MOST_BETWEEN_REVIEWS,
    NOISE_HALVES,
    RESTART_FACTOR,
    SHORTEST_RESTART,
)
from lagrange.algorithm.events.samples import Samples, edge_noise, samples_type
from lagrange.algorithm.events.search import CHANGED, CROWDED, ENDED, IGNORED, UNKNOWN, ReviewedEvents, review
from lagrange.algorithm.step.memory import COUNTS, FUNCTION, RUN
from lagrange.procedure.form import WHOLE, Array, Callee
from lagrange.procedure.front.decorators import Bundle, Stated, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    WholesOut,
    fma,
    form_of,
    larger,
    quotient,
    record,
    smaller,
    unlikely,
)

TAKE_STEPS = Callee((Array(WHOLE), Array(), Array(WHOLE), Array(), WHOLE, Array(), Array()), (WHOLE,))
"""Type of a function that takes steps and returns an `Outcome`. Arguments: data that the machine needs for its
functions, the reals and counts of the run, work memory, the number of trial steps, and the arrays for times and states.
"""

MOST_WAITING = 1024
"""Largest number of steps between two searches for events. Their times and states are stored until the search."""

NEEDS_REVIEW, READ_EVENTS = 16, 17
"""Codes in addition to those of `Outcome`. NEEDS_REVIEW: the loop cannot resolve the zeros on a step, and the caller
must search it. READ_EVENTS: the array of events or of changes of the motion is full.
"""

RESET_AT, RESET_SIZE, UNTIL_END, SETTINGS = range(4)
"""Indices of the blocks of `settings`, each with one entry for each event. RESET_AT: index of the event's first result
among the results of all resets. RESET_SIZE: number of its results among these. UNTIL_END: number of occurrences after
which it ends the run, 0 for never. SETTINGS: number of these blocks; after them come the indices of the entries of the
state that are reset.
"""

NUMBERS, COUNTED = len(RUN.fields), len(COUNTS.fields)
"""Number of reals and number of counts of a run. In the array of reals the absolute tolerances (floors) of the state's
entries follow.
"""

T, END, H, SHARE, PREVIOUS, START, STEP = (
    RUN.places[name] for name in ("t", "end", "h", "share", "previous", "start", "step")
)
"""Indices of reals of a run, as fields of `Run`."""

ACCEPTED, ROWS, SLOPE_KNOWN, AFTER_REJECT, KEPT = (
    COUNTS.places[name] for name in ("steps", "rows", "slope_known", "after_reject", "kept")
)
"""Indices of counts of a run, as fields of `Counts`."""


@record
class EventRun:
    """Record of a run with events: the steps not yet searched for events, and the last change of the motion."""

    count: int
    """Number of steps to be searched for events. Step i leads from row i to the next row."""

    begin: int
    """Number of the first step to search for events, from 1 on."""

    before: int
    """1 if row 0 is the state before row 1, without a reset or another change of the motion between them."""

    outcome: int
    """`Outcome` with which the driver returned after the steps that are not yet searched for events."""

    rows: int
    """Number of rows of times and states that were written before the steps not yet searched for events."""

    proven: int
    """Number of zeros that were written on steps before those that are not yet searched."""

    budget: int
    """Number of steps that the caller allows in this call."""

    left: int
    """Number of steps that are left of `budget`."""

    longest: int
    """Largest number of steps between two searches for events."""

    ahead: int
    """Number of steps to take before the next search for events."""

    since: int
    """Number of steps since the start of the run or the last change of the motion, such as a reset."""

    fixed: int
    """1 if all steps have equal length, 0 with error control."""

    both: int
    """1 if the dense output of a step needs the next step. Then the first step after a start or reset waits for the
    second.
    """

    resets: int
    """1 if the state may be reset in the loop."""

    starts: int
    """1 if row 1 is the start of the run, or the state after a reset or another change of the motion."""

    jumps: int
    """Number of resets of the state so far."""

    changed_at: int
    """Number of steps that the run had taken at its last change of the motion, such as a reset; 0 before the first."""

    breaks: int
    """Number of changes of the motion, such as resets, that are written to the arrays of breaks."""

    break_room: int
    """Number of changes of the motion, such as resets, that fit in the arrays of breaks."""

    due: int
    """1 + the index of the event that resets the state or ends the run at the present state; 0 without such an event.
    """

    way: int
    """Direction of the zero of the event in `due`: 1 rising, -1 falling, or 0 for a touch."""

    changed: float
    """Time of the last change of the motion, such as a reset; at first the time of the start."""

    interval: float
    """Time between the last two resets."""

    final: float
    """End time of the run. At this time, a function within its noise of zero counts as zero."""


EVENT_RUN = form_of(EventRun)
"""Record type of `EventRun`, by which machine code lays it out in memory."""


GO_ON = -1
"""Return code of a part of the loop after which the loop continues."""


@dataclass(frozen=True)
class PendingSteps:
    """Steps that are not searched for events yet, the driver that takes steps, and arrays for accepted steps.

    The steps are rows of `times` and `states`, from row 0 on, for states of a `dimension`. The callback `drive`
    takes steps; its first argument `words` is data of the machine. `reals` are the real numbers in the state of
    the run, followed by the floors (absolute tolerances) of the entries. `counts` are its counts and flags.
    `kept_reals` and `kept_counts` are their values before these steps. y is the present state; its entries have
    the indices `entries` in `driver_work`. Accepted steps are written to `row_times` and `row_states`.
    """

    event_run: EventRun
    dimension: int
    times: Out
    states: Out
    drive: Callable[..., Any]
    words: WholesOut
    reals: Out
    counts: WholesOut
    kept_reals: Out
    kept_counts: WholesOut
    driver_work: Out
    entries: WholesIn
    y: Out
    row_times: Out
    row_states: Out

    @inline
    def row(self, number: int) -> Out:
        """Return the array that begins with the state in row `number` of the pending steps."""
        return self.states[number * self.dimension :]

    @inline
    def take(self) -> int:
        """Let the driver take the next steps, for a search. Return `GO_ON`, or the code that ends the loop.

        The code is an `Outcome`, such as DONE at the end of the run, or `READ_EVENTS` if the array for changes
        of the motion is full.
        """
        run, n, reals, counts = self.event_run, self.dimension, self.reals, self.counts
        t, end = reals[T], reals[END]
        is_first = run.both != 0 and run.before == 0
        if t == end:
            return Outcome.DONE
        if run.left <= 0 or (is_first and run.left < 2 and run.left < run.budget):
            return Outcome.PAUSED
        if run.breaks >= run.break_room:
            return READ_EVENTS
        self.kept_reals[: n + NUMBERS] = reals[: n + NUMBERS]
        self.kept_counts[:COUNTED] = counts[:COUNTED]
        self.times[1] = t
        self.row(1)[:n] = self.y[:n]
        for i in range(n):
            self.driver_work[self.entries[i]] = self.y[i]
        run.rows = counts[ROWS]
        counts[ROWS] = 0
        tries = min(run.ahead, run.left, MOST_WAITING)
        outcome = self.try_steps(max(tries, min(2, run.left)) if is_first else tries)
        while is_first and run.left < run.budget - 1 and outcome == Outcome.PAUSED and counts[ROWS] < 2:
            outcome = self.try_steps(1)
        for i in range(n):
            self.y[i] = self.driver_work[self.entries[i]]
        run.count = counts[ROWS]
        run.begin, run.outcome = 1, outcome
        counts[ROWS] = run.rows
        if run.count > 0:
            return GO_ON
        run.ahead = min(run.ahead * 2, run.longest)
        return GO_ON if outcome == Outcome.PAUSED else outcome

    @inline
    def try_steps(self, tries: int) -> int:
        """Take `tries` trial steps by the driver, and return the `Outcome` with which it stops."""
        self.event_run.left -= tries
        arrays = self.words, self.reals, self.counts, self.driver_work
        outcome: int = self.drive(*arrays, tries, self.times[2:], self.row(2))
        return outcome

    @inline
    def accept(self) -> int:
        """Append the searched steps, on which the motion does not change, to the rows of the run.

        Return `GO_ON`, or the driver's `Outcome` if that ends the loop.
        """
        run, n, times = self.event_run, self.dimension, self.times
        self.write_rows(run.count)
        run.since, run.ahead = run.since + run.count, min(run.ahead * 2, run.longest)
        times[0] = times[run.count]
        self.row(0)[:n] = self.row(run.count)[:n]
        run.before, run.begin, run.count = 1, 1, 0
        return GO_ON if run.outcome == Outcome.PAUSED else run.outcome

    @inline
    def write_rows(self, kept: int) -> None:
        """Append the times and states at the ends of the first `kept` steps to the rows of the run."""
        rows, n = self.event_run.rows, self.dimension
        self.row_times[rows : rows + kept] = self.times[2 : kept + 2]
        size = kept * n
        self.row_states[rows * n :][:size] = self.row(2)[:size]
        self.counts[ROWS] = rows + kept

    @inline
    def go_back(self, kept: int, t: float, state: In, length: float) -> None:
        """Keep the first `kept` steps. Start a new smooth piece of the run on the next step, at time t with a `state`.

        All later steps are dropped. `length` is the length of the step that contains t. It bounds the next step of a
        run with error control.
        """
        run, reals, counts, n = self.event_run, self.reals, self.counts, self.dimension
        self.times[kept + 1] = t
        self.row(kept + 1)[:n] = state[:n]
        self.y[:n] = state[:n]
        self.write_rows(kept)
        steps = self.kept_counts[ACCEPTED] + kept
        counts[ACCEPTED] = steps
        for index in (SLOPE_KNOWN, AFTER_REJECT, KEPT):
            counts[index] = 0
        reals[T], reals[PREVIOUS] = t, 1.0
        if run.fixed != 0:
            reals[START] = t - float(steps) * reals[STEP]
        else:
            interval = larger(RESTART_FACTOR * abs(t - run.changed), SHORTEST_RESTART * abs(t))
            reals[H] = math.copysign(smaller(abs(length), interval), length)
        run.ahead = max(1, min(run.since + kept, MOST_BETWEEN_REVIEWS))
        run.since, run.count, run.begin, run.before = 0, 0, 1, 0

    @inline
    def lower_floors(self, kept: int) -> None:
        """Set the floors (absolute tolerances of the state's entries) to their values after the first `kept` steps.

        The floor of an entry is its floor before these steps. A fraction of the entry's largest magnitude at the ends
        of these steps replaces it if that is larger.
        """
        share, floors, rows = self.reals[SHARE], self.reals[NUMBERS:], self.row(2)
        for j in range(self.dimension):
            size = 0.0
            for i in range(kept):
                size = larger(size, abs(rows[i * self.dimension + j]))
            floors[j] = larger(self.kept_reals[NUMBERS + j], share * size)


@dataclass(frozen=True)
class EventLoop:
    """The arguments of the loop over steps with events.

    The callback `values` computes the event functions from a time and a state, and `resets` the new values of all
    entries that are reset. Their parameters are `value_numbers` and `reset_numbers`. `settings` says for each event
    what it does, by the blocks `RESET_AT` to `SETTINGS`. `break_times` and `break_states` are the ends of the steps
    that were shortened at changes of the motion, NaN if no step was.
    """

    samples: Samples
    watch: ReviewedEvents
    pending: PendingSteps
    values: Callable[..., Any]
    value_numbers: In
    resets: Callable[..., Any]
    reset_numbers: In
    settings: WholesOut
    scratch: Out
    break_rows: WholesOut
    break_times: Out
    break_states: Out

    @inline
    def path(self, first: int, steps: int) -> Samples:
        """Return the steps that are not yet searched for events as `Samples`, beginning with row `first`.

        `steps` is their number.
        """
        pending = self.pending
        run = pending.times[first:], pending.row(first)
        return replace(self.samples, dimension=pending.dimension, times=run[0], states=run[1], steps=steps)

    @inline
    def setting(self, block: int, event: int) -> WholesOut:
        """Return an array that begins with one setting of an event, to be read or written.

        `block` is the index of the setting, for example `RESET_SIZE`; `event` is the index of the event.
        """
        return self.settings[event + self.samples.events * block :]


def loop_type() -> Bundle:
    """Return the type of a procedure's parameter of class `EventLoop`: its callbacks and arrays."""
    pending = Bundle(PendingSteps, {"drive": TAKE_STEPS, "row_states": Array(room=WIDEST_VECTOR)})
    types: dict[str, Stated] = {"samples": samples_type("dimension", "times", "states", "steps")}
    types |= {"watch": Bundle(ReviewedEvents, {}), "pending": pending, "values": FUNCTION, "resets": FUNCTION}
    return Bundle(EventLoop, types)


@procedure(loop=loop_type)
def event_steps(loop: EventLoop) -> int:
    """Take steps of a run and search them for events, until the run ends or the caller must handle an event.

    Return an `Outcome`; or `NEEDS_REVIEW` if zeros on the steps cannot be resolved, so that the caller must search
    them; or `READ_EVENTS` if an array is full. `Outcome.WATCHED` means that the caller must change the
    motion at the present state. A further call with the same `loop` continues from there. Steps that the caller has
    searched in the meantime are not searched again.
    """
    run, search, pending = loop.pending.event_run, loop.watch.review, loop.pending
    code = GO_ON
    while code == GO_ON:
        if run.begin > run.count:
            run.proven = search.written
            code = pending.take()
        if code == GO_ON and run.begin <= run.count:
            why = review_steps(loop)
            if why == ENDED:
                code = pending.accept()
            elif why == CHANGED:
                go_back(loop)
                code = GO_ON if reset(loop) else Outcome.WATCHED
            else:
                code = READ_EVENTS if why == CROWDED and search.written > 0 else NEEDS_REVIEW
    return code


@inline
def review_steps(loop: EventLoop) -> int:
    """Search the pending steps for events. Return the code of `search` for the end of the search.

    The code is `ENDED` if all steps were searched, `CHANGED` if the motion changes on a step, `CROWDED` if the arrays
    have no space for more events, and `IRREGULAR` if the zeros on a step cannot be resolved. `event_run.begin` is the
    number of the first step to search. It becomes the number of the step at which the search ended.
    """
    pending, search = loop.pending, loop.watch.review
    run, shift = pending.event_run, 1 - pending.event_run.before
    steps = run.count + 1 - shift
    search.begin, search.end = run.begin - shift, steps
    search.starts = run.starts if run.begin == 1 else 0
    search.last = steps - 1 if pending.times[run.count + 1] == run.final else -1
    search.rounded = float(pending.kept_counts[ACCEPTED] + run.count - 1) * (1.0 / NOISE_HALVES)
    why = review(loop.path(shift, steps), loop.watch)
    run.begin = search.step + shift
    run.starts = 0 if run.begin > 1 else run.starts
    return why


@inline
def go_back(loop: EventLoop) -> None:
    """Set the run back to the event at which the motion changes, on the step at which the search ended.

    The end of this step is written to the arrays of breaks. If the event is at an end of the step, the state is
    the accepted one. Otherwise it is interpolated.
    """
    pending, watch, times = loop.pending, loop.watch, loop.pending.times
    run, n, s, slot = pending.event_run, pending.dimension, watch.review.fraction, watch.review.written
    step = run.begin
    state, end = watch.there[slot * n :], times[step + 1]
    is_within, kept = s > 0.0 and s < 1.0, step - int(s == 0.0)
    loop.break_times[run.breaks] = end if is_within else math.nan
    loop.break_states[run.breaks * n :][:n] = pending.row(step + 1)[:n]
    if unlikely(not is_within):
        at = step + 1 if s > 0.0 else step
        watch.when[slot] = times[at]
        state[:n] = pending.row(at)[:n]
    pending.go_back(kept, watch.when[slot], state, end - times[step])
    pending.lower_floors(kept)
    loop.break_rows[run.breaks] = pending.counts[ACCEPTED] + run.jumps
    run.due, run.way = watch.review.event + 1, watch.review.way


@procedure(noinline=True, loop=loop_type)
def reset(loop: EventLoop) -> bool:
    """Apply the reset of the event that changes the motion at the present state, and return True.

    Return False, with nothing changed, if the caller must handle the event: it has no allowed reset, ends
    the run, or follows another change of the motion at once. The caller must also handle it if the event
    function does not pass zero, a value is not finite, or the mass matrix is singular. `loop.scratch` has space
    for the new state, the event functions before and after the reset, and the results of all resets.
    """
    pending, n, events = loop.pending, loop.pending.dimension, loop.samples.events
    run, event, t, y = pending.event_run, pending.event_run.due - 1, pending.reals[T], pending.y
    after, before_values = loop.scratch, loop.scratch[n:]
    values, results = before_values[events:], before_values[2 * events :]
    size, until_end = loop.setting(RESET_SIZE, event)[0], loop.setting(UNTIL_END, event)[0]
    if unlikely(size == 0 or run.resets == 0 or until_end == 1):
        return False
    if unlikely(run.jumps > 0 and not abs(t - run.changed) > CLOSEST * larger(abs(t), EARLIEST)):
        return False
    after[:n] = y[:n]
    if unlikely(loop.resets(t, y, loop.reset_numbers, results)):
        return False
    first, entries = loop.setting(RESET_AT, event)[0], loop.settings[events * SETTINGS :]
    for j in range(first, first + size):
        after[entries[j]] = results[j]
        if unlikely(not abs(results[j]) < math.inf):
            return False
    if unlikely(loop.values(t, y, loop.value_numbers, before_values)):
        return False
    if unlikely(loop.values(t, after, loop.value_numbers, values)):
        return False
    total = 0.0
    for e in range(events):
        total = fma(0.0, values[e], total)
    if unlikely(total != 0.0):
        return False
    if unlikely(not passes_zero(loop, t, event, after, before_values[event])):
        return False
    commit(loop, t, event, after, before_values, values)
    return True


@inline
def passes_zero(loop: EventLoop, t: float, event: int, after: In, before: float) -> bool:
    """Return True if an event function passes zero at time t, and the mass matrix is regular at this time.

    Otherwise the caller must handle its reset: on a long step the dense output may reach zero although the velocity
    there leads away from zero. So the function is compared at two states, a little before and after the present
    state of the run along its derivative. `event` is its index, and `before` its value at the present state. The mass
    matrix is tested at the present state and at the state `after` the reset.
    """
    pending, samples, n = loop.pending, loop.path(0, 0), loop.pending.dimension
    run, y = pending.event_run, pending.y
    lines, line, half = samples.lines(), samples.block().y, quotient(n, 2) * WIDEST_VECTOR
    time, slopes, missed = lines.time, lines.state, lines.missed
    for b in range(WIDEST_VECTOR):
        time[b] = t
        for j in range(n):
            new, old = after[j], y[j]
            line[j * WIDEST_VECTOR + b] = new if b == 1 else old
    if samples.law(WIDEST_VECTOR, time, line, line[half:], samples.law_parameters, slopes) >= 0:
        return False
    step, fixed_step = pending.reals[H], pending.reals[STEP]
    h, factor_of_time = (fixed_step if run.fixed != 0 else step) * ALONG, samples.factors[n]
    for b in range(WIDEST_VECTOR):
        # Evaluate before and after the state along its slope, and at the state perturbed by rounding.
        along = -h if b == 0 else h if b == 1 else 0.0
        time[b] = t * factor_of_time if b == 2 else t + along
        for j in range(n):
            value, slope, factor = y[j], slopes[j * WIDEST_VECTOR], samples.factors[j]
            line[j * WIDEST_VECTOR + b] = value * factor if b == 2 else value + along * slope
    if samples.kernel(WIDEST_VECTOR, time, line, line[half:], samples.parameters, missed) >= 0:
        return False
    moved = missed[event * WIDEST_VECTOR :]
    rise = (moved[1] - moved[0]) * float(run.way)
    return run.way == 0 or rise > CLEARLY * edge_noise(before, moved[2])


@inline
def commit(loop: EventLoop, t: float, event: int, after: In, before_values: In, values: In) -> None:
    """Record an event with a reset, and start the next smooth piece of the run at the state `after` it.

    `event` is the index of the event, and t its time. `before_values` and `values` are all event functions before
    and after the reset.
    """
    pending, watch, n = loop.pending, loop.watch, loop.pending.dimension
    run, counts = pending.event_run, pending.counts
    watch.which[watch.review.written] = event
    watch.review.written += 1
    loop.setting(UNTIL_END, event)[0] -= 1
    row = counts[ROWS]
    pending.row_times[row] = t
    pending.row_states[row * n :][:n] = after[:n]
    pending.y[:n] = after[:n]
    counts[ROWS] = row + 1
    run.interval = abs(t - run.changed)
    run.changed, run.changed_at = t, counts[ACCEPTED]
    run.jumps, run.breaks, run.left = run.jumps + 1, run.breaks + 1, run.left - 1
    missed = loop.path(0, 0).lines().missed
    for e in range(loop.samples.events):
        is_due, has_reset, before, value = e == event, loop.setting(RESET_SIZE, e)[0] != 0, before_values[e], values[e]
        noise = edge_noise(before, missed[e * WIDEST_VECTOR + 2])
        begin_side(watch.sign[e:], watch.near[e:], (before, value), noise, is_due=is_due, has_reset=has_reset)
        watch.zero_sizes[e] = abs(before) if is_due else 0.0
        other_direction = UNKNOWN if has_reset else IGNORED
        watch.arrivals[e] = run.way + 2 if is_due else other_direction
    run.starts, run.due = 1, 0


@inline
def begin_side(
    sign: WholesOut, near: WholesOut, values: tuple[float, float], noise: float, *, is_due: bool, has_reset: bool
) -> None:
    """Set the known sign of one event function after a reset, and the flag for a value near zero since then.

    They are the first entries of `sign` (1, -1, or 0 for unknown) and `near` (1 if the function has been within its
    noise of zero since it had that sign). Both are kept if the reset does not change the function. `values` are the
    function before and after the reset, and `noise` is its rounding error. `is_due` is true for the event that
    caused the reset, `has_reset` for an event with a reset.
    """
    (before, after), side, was_near = values, sign[0], near[0]
    stays = not is_due and abs(after - before) <= noise
    is_near = 0 if has_reset else was_near
    is_near = 1 if float(side) * after < 0.0 else is_near
    sign[0], near[0] = side if stays else 0, is_near if stays else 0
