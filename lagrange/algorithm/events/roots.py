"""Isolate the zeros of an event function g, a polynomial on each step, in order; `polynomial.py` refines each zero.

The search passes the last sign of g from step to step. A sign counts once |g| exceeds the noise of g. A crossing is
reported by the step in which the opposite sign first counts. A touch is reported if g has been within its noise of zero
and then has the same sign again. So crossings alternate over a whole run. A root at a joint of two steps is reported
once, by the later step at time 0, whatever the rounding on both sides. If |g| stays above its noise, g has no root.
Roots between which g stays within its noise are merged: two into a touch, three into a crossing. The two steps at a
joint must agree on g there within their noise.

Measured on h = 1: two isolated roots merge when closer than 1e-7 to 2e-7, three at spacings below 2e-5 to 5e-5. If
roots are distributed over the whole step, coefficients in double precision separate up to 8 of them, 12 in six cases of
ten, and never 16. A simple root is refined to the rounding error of g divided by its slope.

Descartes' rule bounds the number of roots by the signs of the Bernstein coefficients. A part of the step that may have
more than one root is halved. Source: J. M. Lane, R. F. Riesenfeld, Bounds on a polynomial, BIT 21 (1981), 112-117.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.events.constants import (
    CROSSING,
    DEEPEST_HALVING,
    MOST_COEFFICIENTS,
    NARROWEST,
    SURELY,
    TOO_MANY,
    UNFIT,
)
from lagrange.algorithm.events.polynomial import PADDED, passage, scaled, slope_at_end, turn, value
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    WholesIn,
    WholesOut,
    Writable,
    likely,
    magnitude,
    quotient,
    reals,
    record,
    unlikely,
)

PASSES_AT_ONCE = 4
"""Number of passes of running sums that one loop does. Each number is then read and written once for all of these
passes.
"""


@inline
def sign_of(x: float, noise: float) -> int:
    """Return the sign of a number, 1 or -1, or 0 if its size is at most `noise`."""
    return 1 if x > noise else -1 if x < -noise else 0


@procedure(noinline=True)
def bernstein(c: In, count: int, b: Out) -> None:
    """Write the Bernstein coefficients on [0, 1] of a polynomial to b; c has its coefficients by powers.

    The coefficients are first divided by binomial coefficients, then summed in count - 1 passes. Pass i, from 0
    on, adds to each number from index i + 1 on the number before it.
    """
    weight = 1.0
    for k in range(count):
        b[k] = c[k] * weight
        weight *= float(k + 1) / float(count - 1 - k)
    remainder = count - 1 - quotient(count - 1, PASSES_AT_ONCE) * PASSES_AT_ONCE
    for first in range(remainder):
        before = b[first]
        for index in range(first + 1, count):
            value = b[index]
            b[index] = value + before
            before = value
    for first in range(remainder, count - 1, PASSES_AT_ONCE):
        add_four_times(b[first:], count - first)


@inline
def add_four_times(b: Out, count: int) -> None:
    """Make four passes of running sums over the `count` numbers in b, in place.

    Pass i = 0, 1, 2, 3 does b[j] = b[j] + b[j - 1] for j from i + 1 on. One loop does all four.
    """
    first1, first2, first3 = b[1] + b[0], b[2] + b[1], b[3] + b[2]
    second2, second3 = first2 + first1, first3 + first2
    w, x, y, z = b[3], first3, second3, second3 + second2
    b[1], b[2], b[3] = first1, second2, z
    for index in range(PASSES_AT_ONCE, count):
        number = b[index]
        once = number + w
        twice = once + x
        thrice = twice + y
        b[index] = thrice + z
        w, x, y, z = number, once, twice, thrice


@procedure
def signs(b: In, count: int, first: int, noise: float) -> tuple[bool, int, float]:
    """Return (True for at most one sign change, last sign, largest size) of Bernstein coefficients b.

    `first` is the sign of the first of the `count` coefficients, as decided for the previous interval: rounding
    must not decide it twice. A coefficient of size up to `noise` has no sign.
    """
    now, before, changes = first, first, 0
    size = abs(b[0])
    for j in range(1, count):
        x = b[j]
        sign = sign_of(x, noise)
        size = magnitude(size, x)
        if sign != now:
            changes += 1
            before = now
            now = sign
    # A change of sign through zero is one crossing. Values that reach zero and return may have no root or two.
    through = changes == 2 and before == 0 and now == -first
    return changes < 2 or through, now, size


@procedure(noinline=True)
def halve(b: Out, count: int, left: Out) -> None:
    """Replace Bernstein coefficients b of a polynomial by its coefficients on the right half of the interval.

    The coefficients on the left half are written to `left`. This is de Casteljau's algorithm.
    """
    for done in range(1, count):
        left[done - 1] = b[0]
        for j in range(count - done):
            b[j] = (b[j] + b[j + 1]) * 0.5
    left[count - 1] = b[0]


@record
class SignState:
    """State of the search for zeros at a point: the last sign, and the value nearest to zero since then."""

    count: int
    """Number of roots found, also of roots for which the arrays have no space."""

    sign: int
    """Last sign (1 or -1) of the function beyond its noise; 0 before the first such sign."""

    low: float
    """Point in [0, 1] at which the function had the last sign."""

    near: int
    """1 if the function has been within its noise of zero since it had the last sign, else 0."""

    near_at: float
    """Point after `low` at which the function was nearest to zero, or farthest beyond zero."""

    depth: float
    """Value of the function at `near_at`, times the last sign."""

    counted: int
    """1 while the function is at a root at the start of the step, which the previous step has reported; else 0."""


@dataclass(frozen=True)
class Search:
    """The search for the zeros of a polynomial on [0, 1], and the arrays for them.

    c has the `count` coefficients by powers, and `noise` is the error of the polynomial's values. `state` is
    the state of the search. `times` and `rising` take up to `room` zeros: the times, in a step of length h, and
    the directions.
    """

    c: Readable[float]
    count: int
    noise: float
    state: SignState
    h: float
    times: Writable[float]
    rising: Writable[int]
    room: int

    @inline
    def reach(self, point: float, sign: int) -> None:
        """Continue the search to a `point`, where the function has the given `sign`; 0 is within the noise."""
        if unlikely(sign == 0):
            self.come_near(point)
        else:
            self.count_sign(point, sign)

    @inline
    def come_near(self, point: float) -> None:
        """Continue the search to a `point` at which the function is within its noise of zero.

        Of all such points since the last sign, the search stores the one at which the last sign times the function is
        least.
        """
        state = self.state
        if state.counted == 0:
            depth = float(state.sign) * value(self.c, self.count, point)
            if state.near == 0 or depth < state.depth:
                state.depth = depth
                state.near_at = point
            state.near = 1

    @inline
    def count_sign(self, point: float, sign: int) -> None:
        """Continue the search to a `point` at which the function has a `sign` beyond the noise.

        Report a crossing if the last sign is opposite. Report a touch if the last sign is the same and the function has
        been within its noise of zero since then.
        """
        state = self.state
        before = state.sign
        if sign == -before:
            self.report(passage(self.c, self.count, state.low, point, sign), sign)
        if unlikely(sign == before and state.near != 0):
            self.report(self.touch(point), 0)
        state.sign = sign
        state.low = point
        state.near = 0
        state.counted = 0

    @inline
    def touch(self, high: float) -> float:
        """Return the point at which a function that touches zero is nearest to zero; it is before `high`."""
        state = self.state
        return turn(self.c, self.count, state.low, state.near_at, high, state.depth, state.sign, self.noise)

    @inline
    def report(self, point: float, rising: int) -> None:
        """Write the root `point` if the arrays have space, and count it in any case.

        `rising` is the direction of the root: 1, -1, or 0 for a touch.
        """
        slot = self.state.count
        if likely(slot < self.room):
            self.times[slot] = self.h * point
            self.rising[slot] = rising
        self.state.count = slot + 1


@procedure
def roots(
    coefficients: In,
    count: int,
    h: float,
    noise: float,
    sign: int,
    near: bool,
    last: bool,
    times: Out,
    rising: WholesOut,
    room: int,
) -> tuple[int, int, bool]:
    """Find the roots of the polynomial g = sum c[k] tau**k for tau from 0 to h; c are the `coefficients`.

    `sign` and `near` describe g before the step. `sign` is the last sign beyond the noise, 1 or -1. `sign` is 0
    without such a sign: g starts here, and a root at the start is not an event. `near` is true if g has been within
    its noise of zero since then. `noise`, in the units of g, is the error of g without the rounding of its
    coefficients. `last` is true if no step follows: then the slope decides a root at the end.

    `times` and `rising` take up to `room` roots: tau, and 1 where g rises along the integration, -1 where it
    falls, 0 where it touches zero. Return the number of roots, and `sign` and `near` at the end of the step.
    The number is -1 if a coefficient is not finite, -2 if there are more than `room`; then the other results
    are undefined.
    """
    c, state = reals(PADDED), SignState()
    total_noise, others, rates, end = scaled(coefficients, count, h, noise, c)
    if unlikely(not total_noise < math.inf):
        return UNFIT, sign, near
    search = Search(c, count, total_noise, state, h, times, rising, room)
    first = sign_of(c[0], total_noise)
    begin(search, first, sign, near)
    isolate(search, first, others, rates, end)
    is_near = state.near != 0 and state.sign != 0
    if unlikely(is_near and last):
        # At the end of a run it is a crossing if g is still approaching zero.
        if float(state.sign) * slope_at_end(c, count) < 0.0:
            search.report(1.0, -state.sign)
        else:
            search.report(search.touch(1.0), 0)
    return TOO_MANY if state.count > room else state.count, state.sign, is_near


@inline
def sort_zeros(count: int, times: Any, attached: tuple[Any, ...]) -> None:
    """Sort zeros by time, together with the `attached` arrays of the same length. The order of equal times is kept."""
    for i in range(1, count):
        j = i
        while j > 0 and times[j] < times[max(j - 1, 0)]:
            for array in (times, *attached):
                array[j - 1], array[j] = array[j], array[j - 1]
            j = j - 1


@inline
def is_counted(direction: int, expected: int) -> bool:
    """Return True if a zero with a `direction` is an event: 1 rising, -1 falling, 0 for a touch.

    `expected` is the direction that counts: 1 or -1, 0 for every zero, `CROSSING` for every zero but a touch.
    """
    return expected == 0 or expected == direction or (expected == CROSSING and direction != 0)


@inline
def first_change(
    count: int, functions: WholesIn, directions: WholesIn, expected: WholesIn, remaining: WholesOut
) -> int:
    """Return the index of the first of `count` zeros at which the motion changes, or -1 if none does.

    The zeros are in order of time. Each has the index of its function in `functions`, and a direction. For each
    function, `expected` has the direction that counts, and `remaining` the number of zeros that count until the
    motion changes: by a reset, a crossed surface or the end of the run. A number of 0 or less means never. Each
    zero that counts, up to the result, reduces this number by one.
    """
    change = -1
    for j in range(count):
        function = functions[j]
        if change < 0 and is_counted(directions[j], expected[function]):
            left = remaining[function]
            change = j if left == 1 else change
            remaining[function] = left - 1
    return change


@inline
def begin(search: Search, first: int, sign: int, near: bool) -> None:
    """Begin the search for zeros on a step, with `sign` and `near` at the end of the previous step.

    `sign` is the last sign beyond the noise; `near` is true if the function has been within its noise since
    then. `first` is the sign of the function at the start, 0 within its noise.
    """
    state, c = search.state, search.c
    is_leaving = float(sign) * c[1] >= 0.0
    # A start within the noise is a known root if the previous step counted it (not `near`) and g leaves zero. A start
    # beyond the noise is a touch at the joint if g was `near` and leaves zero; it is no root while g approaches.
    is_new = (near or not is_leaving) if first == 0 else (near and is_leaving)
    state.sign = sign
    state.near = int(is_new)
    state.depth = float(sign) * c[0]
    state.counted = int(first == 0 and not is_new)
    if first != 0:
        search.count_sign(0.0, first)


@inline
def isolate(search: Search, first: int, others: float, rates: float, end: float) -> None:
    """Search a whole step for zeros in order: halve each part that may have more than one zero.

    Zeros are reported to `search`. `first` is the sign of the function at the start, and `end` its value at the
    end. `others` is the sum of the magnitudes of all terms but the first, and `rates` that of the terms of the
    derivative.
    """
    c, count, noise = search.c, search.count, search.noise
    parts = reals((DEEPEST_HALVING + 1) * MOST_COEFFICIENTS)
    starts, widths = reals(DEEPEST_HALVING + 1), reals(DEEPEST_HALVING + 1)
    starts[0], widths[0] = 0.0, 1.0
    part, is_decided, end_sign, size = 0, True, sign_of(end, noise), 0.0
    # If the first coefficient exceeds the sum of all others, there is no root. If the slope keeps its sign, there is at
    # most one.
    is_clear = abs(c[0]) > SURELY * (others + noise)
    is_monotonic = 2.0 * abs(c[1]) > SURELY * rates
    if not (is_clear or is_monotonic):
        bernstein(c, count, parts)
        is_decided, end_sign, size = signs(parts, count, first, noise)
    reached = first
    while part >= 0:
        begin, width = starts[part], widths[part]
        half_width = width * 0.5
        # Near the noise, signs are random, and every interval would be halved: hence the factor 2.
        is_narrow = width <= NARROWEST or size <= 2.0 * noise
        if likely(is_decided or is_narrow):
            if unlikely(not is_decided):
                search.come_near(begin + half_width)
            reached = end_sign
            search.reach(begin + width, reached)
            part = part - 1
        else:
            right = parts[part * MOST_COEFFICIENTS :]
            halve(right, count, parts[(part + 1) * MOST_COEFFICIENTS :])
            starts[part], starts[part + 1] = begin + half_width, begin
            widths[part], widths[part + 1] = half_width, half_width
            part = part + 1
        if unlikely(part >= 0):
            is_decided, end_sign, size = signs(parts[part * MOST_COEFFICIENTS :], count, reached, noise)
