"""Zeros of event functions on one step, in order, up to the first that changes the motion.

The zero that changes the motion must not be simultaneous with another zero. If a function is zero at the start of the
motion, its value there is subtracted on the whole step, and the result is divided by time. This removes the known zero,
so that the next zero may be close to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.events.constants import (
    CLEAR_FACTOR,
    DEEPEST_HALVING,
    JUMP,
    MOST_ROOTS,
    NARROWEST,
    STEP_HALVINGS,
    TOGETHER,
)
from lagrange.algorithm.events.roots import first_change, is_counted, roots, sort_zeros
from lagrange.algorithm.events.samples import (
    COARSE,
    DEGREE,
    Lines,
    Samples,
    Widths,
    chebyshev,
    edge_noise,
    local_polynomial,
    samples_type,
)
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import (
    Out,
    WholesIn,
    WholesOut,
    fma,
    form_of,
    larger,
    likely,
    reals,
    record,
    smaller,
    unlikely,
    unrolled,
    wholes,
)

ENDED, IRREGULAR, CHANGED, CROWDED = range(4)
"""Reasons for the end of a review, the search for events on accepted steps. ENDED: the last step is searched.
IRREGULAR: the zeros on the next step cannot be resolved, so that the caller must search it. CHANGED: an event changes
the motion on the next step. CROWDED: the zeros on the next step may not fit into the arrays.
"""

UNKNOWN, IGNORED = 0, 5
"""Codes in place of a direction for an event that starts at zero. UNKNOWN: the caller decides. IGNORED: the zero is
ignored.
"""

MOST_ZEROS = 128
"""Largest number of zeros on one step that the search for events handles."""


Part = tuple[float, float, int, float, float]
"""A part of a step, for the search for zeros of an event function. The entries are the start and the width of the part,
as fractions of the step; the number of coefficients of the function's polynomial; the error of the polynomial's values;
and the size of the function.
"""


@record
class Review:
    """Record of a search of steps for events: the steps to visit, and the step and zero at which it ended."""

    begin: int
    """Number of the first step that the review visits."""

    end: int
    """Number of the step before which the review must end."""

    starts: int
    """1 if the first step begins the run, or follows a reset or another change of the motion."""

    last: int
    """Number of the step at whose end the run ends; -1 if the steps to visit do not reach the end of the run."""

    rounded: float
    """Change of an event function by the rounding of all steps so far, in units of its noise."""

    room: int
    """Number of zeros for which the arrays have space."""

    written: int
    """Number of zeros in the arrays, including those of earlier searches."""

    step: int
    """Number of the first step that the review did not accept; the review ended before it."""

    event: int
    """Index of the event that changes the motion on step `step`."""

    way: int
    """Direction of the zero of `event`: 1 rising, -1 falling, 0 for a touch."""

    fraction: float
    """Time of the zero of `event`, as a fraction of the step."""


REVIEW = form_of(Review)
"""Record type of `Review`, by which machine code lays it out in memory."""


@dataclass(frozen=True)
class ReviewedEvents:
    """The event functions of a run, with one entry for each in most arrays, and the zeros that were found.

    `review` has the steps to search and the results of the search. `sign` is the last sign of a function beyond its
    noise, 1 or -1, or 0 for unknown. `near` is 1 if the function has been within its noise of zero since it had
    this sign. `direction` is the direction of the zeros that count, 0 for both. `remaining` is the number of zeros
    after which the event resets the state or ends the run; 0 or less means never.

    A motion may start at a zero of a function, as after an impact. At the start the function counts as zero if it
    is below `zero_sizes`. `arrivals` is 2 plus the direction in which it reached this zero; `UNKNOWN` leaves the
    decision to the caller, and `IGNORED` ignores the zero. `levels` are the values of functions that start at zero.

    Zeros are written to `which` (events), `when` (times) and `there` (states). `step_sides` is work memory of four
    blocks: signs, `near` and remaining counts after the step, and 1 for each function that starts at zero.
    """

    review: Review
    sign: WholesOut
    near: WholesOut
    direction: WholesIn
    remaining: WholesOut
    zero_sizes: Out
    arrivals: WholesOut
    which: WholesOut
    when: Out
    there: Out
    step_sides: WholesOut
    levels: Out


@dataclass(frozen=True)
class ZeroSearch:
    """The search for zeros of event functions on one step of a block, with its memory.

    For each event, `signs` is the sign of its function after the step, `near_flags` is 1 if the function has been
    within its noise of zero since it had that sign, and `zeros_left` is the number of zeros that remain until the
    event changes the motion, 0 or less for never. `starting` is 1 if the function starts at zero.
    """

    samples: Samples
    lines: Lines
    watch: ReviewedEvents
    signs: WholesOut
    near_flags: WholesOut
    zeros_left: WholesOut
    starting: WholesOut
    starts: Out
    widths: Out
    tails: Out
    coefficients: Out
    powers: Out
    roots: Out
    ways: WholesOut
    times: Out
    events: WholesOut
    directions: WholesOut

    @inline
    def begin_at_zero(self, step: int) -> bool:
        """Record which event functions are zero at the start or just after a reset.

        Return True if the caller must decide what such a zero means. This is the case for an event with a reset, unless
        that reset led to the zero. `step` is the number of the step; only the first step after a start or a reset has
        such functions. A function with a known sign is not recorded: its search continues with this sign, as from one
        step to the next.
        """
        watch, lines, columns = self.watch, self.lines, self.samples.columns
        starts = watch.review.starts != 0 and step == watch.review.begin
        is_irregular = False
        for e in range(self.samples.events):
            self.starting[e], watch.levels[e] = 0, 0.0
            if unlikely(starts):
                values, noise = lines.coarse[e * Widths.of(columns).wide :], lines.noise[e * columns]
                start, sign, is_unknown = values[0], watch.sign[e], watch.arrivals[e] == UNKNOWN
                size = larger(edge_noise(start, values[(COARSE + 1) * columns]), 4.0 * watch.zero_sizes[e])
                size = larger(size, noise) if is_unknown else size
                if not abs(start) > size and sign == 0:
                    is_irregular = is_irregular or is_unknown
                    self.starting[e], watch.levels[e] = 1, start
        return is_irregular

    @inline
    def may_vanish(self, b: int, e: int) -> bool:
        """Return True if event function `e` may be zero on the step in column `b`, or has no known sign."""
        doubtful = self.lines.doubtful[e * self.samples.columns + b]
        sign, near = self.watch.sign[e], self.watch.near[e]
        return doubtful != 0.0 or sign == 0 or near != 0

    @inline
    def some_may_vanish(self, b: int) -> bool:
        """Return True if an event function may be zero on the step in column `b`, or has no known sign."""
        is_watched = False
        for e in range(self.samples.events):
            is_watched = self.may_vanish(b, e) or is_watched
        return is_watched

    @inline
    def visit(self, step: int, b: int, is_bad: bool) -> int:
        """Find the zeros of all event functions on a step. Return `ENDED`, or a code if the search must end here.

        The code is `CHANGED` if an event changes the motion on the step, `CROWDED` if the arrays for zeros are full,
        and `IRREGULAR` if the zeros cannot be resolved. After the last two codes all records are as before the step.
        `step` is the number of the step in the run, and `b` its column in the block. `is_bad` is true if an event
        function has no value on the block.
        """
        watch, review = self.watch, self.watch.review
        if unlikely(review.written + MOST_ZEROS >= review.room):
            return CROWDED
        count, kept, change, limit, besides = 0, 0, -1, 1.0, -1
        is_searching, is_irregular = True, False
        while is_searching:
            is_searching = False
            for e in range(self.samples.events):
                self.signs[e], self.near_flags[e], self.zeros_left[e] = watch.sign[e], watch.near[e], watch.remaining[e]
                if e != besides and not is_irregular and self.may_vanish(b, e):
                    is_irregular, count = self.isolate(step, b, e, is_bad, limit, besides >= 0, count)
            if besides < 0 and not is_irregular:
                sort_zeros(count, self.times, (self.events, self.directions))
                kept = count
                change = first_change(count, self.events, self.directions, watch.direction, self.zeros_left)
                if unlikely(change >= 0):
                    # Repeat up to the change: an event may be zero there within its noise.
                    limit, besides, is_searching = self.times[change], self.events[change], True
        if unlikely(is_irregular):
            return IRREGULAR
        if unlikely(change >= 0):
            return self.change(b, change, kept, count)
        if not self.stays_clear(b):
            return IRREGULAR
        self.write(b, kept, math.inf)
        for e in range(self.samples.events):
            self.starting[e], watch.levels[e] = 0, 0.0
            watch.sign[e], watch.near[e], watch.remaining[e] = self.signs[e], self.near_flags[e], self.zeros_left[e]
        return ENDED

    @inline
    def isolate(
        self, step: int, b: int, e: int, is_bad: bool, limit: float, is_cut: bool, count: int
    ) -> tuple[bool, int]:
        """Find the zeros of event function `e` on a step, halved until a polynomial resolves it on each part.

        `step` is the number of the step in the run, and `b` its column in the block. `is_bad` is true if an event
        function has no value on the block. `limit` is the fraction of the step at which the search ends; `is_cut` is
        true if the motion changes there. `count` is the number of zeros already found on the step. The first result is
        True if the zeros cannot be resolved: no polynomial resolves the function on a part of the step, or its zeros
        cannot be separated, as at a jump. The second result is the new number of zeros.
        """
        lines, index = self.lines, e * self.samples.columns + b
        is_last, noise = step == self.watch.review.last, lines.noise[index]
        if unlikely(is_last):
            noise = larger(noise, lines.edge_end[index] * self.watch.review.rounded)
        self.starts[0], self.widths[0], self.tails[0] = 0.0, 1.0, math.inf
        top, halvings, is_irregular, at_zero = 0, 0, False, self.starting[e] != 0
        while top >= 0 and not is_irregular:
            start, width = self.starts[top], self.widths[top]
            has_no_value, size = self.sample(b, e, start, width)
            begins = at_zero and start == 0.0
            least = noise if begins else 0.0
            sizes = size, noise, self.tails[top], least
            known, error, tail = local_polynomial(self.coefficients, *sizes, self.powers)
            if unlikely(known == 0):
                is_hopeless = width <= NARROWEST or halvings >= STEP_HALVINGS or not size < math.inf
                is_irregular = is_hopeless or is_bad or has_no_value
                half_width = width * 0.5
                self.starts[top + 1], self.widths[top + 1], self.tails[top + 1] = start, half_width, tail
                self.starts[top], self.widths[top], self.tails[top] = start + half_width, half_width, tail
                top, halvings = top + 1, halvings + 1
            else:
                is_end = (is_last and start + width == 1.0) or (is_cut and limit <= start + width)
                length, part = smaller((limit - start) / width, 1.0), (start, width, known, error, size)
                is_irregular, count = self.keep_roots(e, begins, part, length, is_end, count)
                top = top - 1
        return is_irregular, count

    @inline
    def sample(self, b: int, e: int, start: float, width: float) -> tuple[bool, float]:
        """Write the Chebyshev coefficients of event function `e` on a part of a step to `coefficients`.

        If the function starts at zero, its value at the start, the level, is subtracted. The part has a `start`
        and a `width`, as fractions of the step in column `b`. Returns True if an event function has no value
        there, and the largest magnitude of the samples.
        """
        lines, columns, has_no_value = self.lines, self.samples.columns, False
        size = lines.size[e * columns + b]
        widths = Widths.of(columns)
        if likely(width == 1.0):
            known = lines.chebyshev[e * widths.full + b :]
            for k in range(DEGREE + 1):
                self.coefficients[k] = known[k * columns]
        else:
            has_no_value = self.samples.sample_part(lines, b, start, width)
            size = chebyshev(lines.part[e * widths.part :], self.coefficients)
        self.coefficients[0] = self.coefficients[0] - self.watch.levels[e]
        return has_no_value, size

    @inline
    def keep_roots(self, e: int, begins: bool, part: Part, length: float, is_end: bool, count: int) -> tuple[bool, int]:
        """Find the zeros of event function `e` on a part of a step; append them to the step's `count` zeros.

        `part` has the start and width of the part, and the polynomial's number of coefficients, error and size.
        The search ends at the fraction `length` of the part. `begins` is true if the function starts at zero at
        the start of the part; `is_end` if the motion ends or changes at the end of the search. The first result is
        True if the zeros cannot be resolved, as at a jump over zero. The second is the new number of zeros.
        """
        start, width, known, error, size = part
        first, is_irregular, noise = int(begins), False, error
        if unlikely(begins):
            is_irregular, noise = self.leave_zero(e, known, error)
        more = 0
        if length > 0.0:
            polynomial = self.powers[first:], known - first, length, noise
            side = self.signs[e], self.near_flags[e] != 0, is_end
            met, sign, near = roots(*polynomial, *side, self.roots, self.ways, MOST_ROOTS)
            is_far = met > 0 and self.roots[0] == 0.0 and abs(self.powers[0]) > JUMP * size and not begins
            is_irregular = is_irregular or met < 0 or count + met > MOST_ZEROS or is_far
            self.signs[e], self.near_flags[e] = sign, int(near)
            more = 0 if is_irregular else met
            for r in range(more):
                self.times[count + r], self.events[count + r] = start + width * self.roots[r], e
                self.directions[count + r] = self.ways[r]
        return is_irregular, count + more

    @inline
    def leave_zero(self, e: int, known: int, error: float) -> tuple[bool, float]:
        """Find the sign of event function `e` just after a start at zero, by its slope.

        The sign is written to `signs`. The first result is True if the caller must handle the event: the function
        leaves zero in the direction in which it reached zero, or its slope is zero within its error. The second result
        is the error of the slope. `known` is the number of coefficients of its polynomial, and `error` the error of its
        values. The error of the slope follows from the slope 2 k**2 of Chebyshev's polynomial of degree k at the ends
        of [0, 1].
        """
        rank, linear = float(max(known - 1, 1)), self.powers[1]
        noise, slope = 2.0 * rank * rank * error, linear if known > 1 else 0.0
        side = 1 if slope > 0.0 else -1
        self.signs[e], self.near_flags[e] = side, 0
        return not abs(slope) > noise or side == self.watch.arrivals[e] - 2, noise

    @inline
    def change(self, b: int, change: int, kept: int, count: int) -> int:
        """End the search at a zero that changes the motion, number `change` of the step in column `b`.

        Return `CHANGED`, or `IRREGULAR` if another zero is simultaneous with the change. `kept` is the number
        of zeros before the search was cut at that zero, and `count` the number of all zeros. The zeros before
        the change are recorded.
        """
        watch, review = self.watch, self.watch.review
        s, event, t = self.times[change], self.events[change], self.samples.block().t[b]
        early = s - TOGETHER * larger(abs(t / (self.lines.t_end[b] - t)), s)
        late, is_irregular = 2.0 * s - early, False
        for j in range(count):
            time = self.times[j]
            is_other = j >= kept or (time <= late and j != change)
            is_irregular = is_irregular or (time >= early and is_other)
        if unlikely(is_irregular):
            return IRREGULAR
        review.event, review.way, review.fraction = event, self.directions[change], s
        before = review.written
        self.write(b, kept, early)
        self.write_zero(b, event, s)
        for j in range(before, review.written):
            e = watch.which[j]
            left = watch.remaining[e]
            watch.remaining[e] = left - 1 if left > 0 else left
        for e in range(self.samples.events):
            watch.sign[e], watch.near[e] = self.signs[e], self.near_flags[e]
        return CHANGED

    @inline
    def stays_clear(self, b: int) -> bool:
        """Return True if events that started at zero have clearly left it at the end of the step in column `b`."""
        is_clear, columns = True, self.samples.columns
        for e in range(self.samples.events):
            if unlikely(self.starting[e] != 0):
                end = self.lines.coarse[e * Widths.of(columns).wide + COARSE * columns + b]
                level, side = self.watch.levels[e], float(self.signs[e])
                is_clear = is_clear and abs(end) > CLEAR_FACTOR * abs(level) and end * side > 0.0
        return is_clear

    @inline
    def write(self, b: int, count: int, before: float) -> None:
        """Append the zeros of the step in column `b` whose direction counts to the events of the run.

        Of the first `count` zeros of the step, those before the fraction `before` of the step are appended.
        """
        for j in range(count):
            time = self.times[j]
            event = self.events[j]
            if time < before and is_counted(self.directions[j], self.watch.direction[event]):
                self.write_zero(b, event, time)
                self.watch.review.written += 1

    @inline
    def write_zero(self, b: int, e: int, s: float) -> None:
        """Write a zero of event `e` after the events of the run: its index, time and state.

        s is the time of the zero, as a fraction of the step in column `b`.
        """
        samples, slot = self.samples, self.watch.review.written
        t, total = samples.block().t[b], samples.dimension * samples.columns
        self.watch.which[slot] = e
        self.watch.when[slot] = t + s * (self.lines.t_end[b] - t)
        state = self.watch.there[slot * samples.dimension :]
        for j in range(samples.dimension):
            c = samples.c[j * samples.columns + b :]
            value = c[samples.degree * total]
            for k in range(samples.degree):
                value = fma(value, s, c[(samples.degree - 1 - k) * total])
            state[j] = value


@inline
def step_zeros(samples: Samples, lines: Lines, watch: ReviewedEvents) -> ZeroSearch:
    """Return a `ZeroSearch`, the search for zeros on one step, with new memory."""
    memory: tuple[Any, ...] = tuple(watch.step_sides[samples.events * k :] for k in unrolled(4))
    memory = (*memory, *(reals(DEEPEST_HALVING + 2) for _ in unrolled(3)), reals(DEGREE + 2), reals(DEGREE + 2))
    memory = (*memory, reals(MOST_ROOTS), wholes(MOST_ROOTS), reals(MOST_ZEROS), wholes(MOST_ZEROS), wholes(MOST_ZEROS))
    return ZeroSearch(samples, lines, watch, *memory)


QUEUE = 256
"""Number of steps that a quick test screens at once. Steps that may contain zeros are examined after it."""


@procedure(samples=samples_type, watch=lambda: Bundle(ReviewedEvents, {}))
def review(samples: Samples, watch: ReviewedEvents) -> int:
    """Search the steps of a run for events. Return `ENDED` after all steps, or the code of an earlier end.

    The codes are `CHANGED` if the motion changes on a step, `IRREGULAR` if zeros cannot be resolved, and `CROWDED` if
    the arrays for zeros are full. The run has times (S+1,) and states (S+1, 2n) in `samples`. The event, the time and
    the state of each zero that counts are written to `watch`. If a zero that changes the motion ended the search, it is
    written after them and not counted.
    """
    lines, end, reached = samples.lines(), watch.review.end, watch.review.begin
    queue, step_numbers = wholes(QUEUE), wholes(WIDEST_VECTOR)
    zeros = step_zeros(samples, lines, watch)
    while reached < end:
        filled = 0
        while reached < end and filled <= QUEUE - WIDEST_VECTOR:
            filled = queue_block(samples, lines, watch, step_numbers, reached, queue, filled)
            reached += WIDEST_VECTOR
        for first in range(0, filled, WIDEST_VECTOR):
            for b in range(WIDEST_VECTOR):
                step_numbers[b] = queue[min(first + b, filled - 1)]
            is_bad, is_resolved = samples.follow(lines, step_numbers), False
            if unlikely(is_bad or zeros.begin_at_zero(step_numbers[0])):
                watch.review.step = step_numbers[0]
                return IRREGULAR
            for b in range(min(filled - first, WIDEST_VECTOR)):
                if zeros.some_may_vanish(b):
                    if not is_resolved:
                        is_bad, is_resolved = samples.sample_fully(lines), True
                    why = zeros.visit(step_numbers[b], b, is_bad)
                    if unlikely(why != ENDED):
                        watch.review.step = step_numbers[b]
                        return why
    watch.review.step = end
    return ENDED


@inline
def queue_block(
    samples: Samples,
    lines: Lines,
    watch: ReviewedEvents,
    step_numbers: WholesOut,
    first: int,
    queue: WholesOut,
    filled: int,
) -> int:
    """Append the steps of a block on which an event function may be zero to `queue`. Return its new length.

    The first step of the whole search is always appended. `first` is the number of the first step of the block,
    and `step_numbers` is memory for the numbers of its steps. `filled` is the length of the queue before.
    """
    end, is_bad = watch.review.end, False
    for b in range(WIDEST_VECTOR):
        step_numbers[b] = min(first + b, end - 1)
    if samples.screens:
        is_bad = samples.sift(lines, step_numbers)
    for b in range(min(end - first, WIDEST_VECTOR)):
        is_close = is_bad or first + b == watch.review.begin or not samples.screens
        if is_close or samples.some_doubtful(lines, b):
            queue[filled] = first + b
            filled += 1
    return filled
