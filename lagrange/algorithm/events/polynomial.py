"""A polynomial on [0, 1] from its coefficients: its values and slopes, and the place where it changes its sign."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.algorithm.events.constants import CONVERGED, EPSILON, MOST_COEFFICIENTS
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Real, Variable, Whole

CHAINS = 4
"""The sums that a polynomial is evaluated in, each in s**4: one alone would wait for itself."""

PADDED = (MOST_COEFFICIENTS + CHAINS - 1) // CHAINS * CHAINS
"""Memory for the coefficients of a polynomial, with zeros up to whole blocks of `CHAINS`."""


def blocks(count: Whole) -> Whole:
    """Return the number of blocks of `count` coefficients."""
    found: Whole = (count + (CHAINS - 1)) // CHAINS
    return found


def pad(p: Builder, c: Memory, start: Whole, count: Whole) -> None:
    """Write zeros from a place up to the end of the blocks of some coefficients."""
    with p.loop(start, blocks(count) * CHAINS) as k:
        c[k] = 0.0


@shared
def value() -> Procedure:
    """Return the procedure that evaluates a polynomial."""
    p = Builder("value", "Return a polynomial's value at a place.", apart=True)
    c, count, s = p.array("c", read=True), p.given("count", WHOLE), p.given("s", REAL)
    (found,) = _evaluated(p, [c], blocks(count), s)
    p.leave(found)
    return p.finish(REAL)


def _evaluated(p: Builder, polynomials: Sequence[Memory], count: Whole, s: Real) -> list[Real]:
    """Return the values at s of polynomials with `count` blocks of coefficients."""
    square = s * s
    fourth = square * square
    last = (count - 1) * CHAINS
    chains = [[p.variable(c[last + i]) for i in range(CHAINS)] for c in polynomials]
    with p.loop(1, count) as j:
        place = (count - 1 - j) * CHAINS
        for c, sums in zip(polynomials, chains, strict=True):
            for i, total in enumerate(sums):
                total.value = p.fma(total.value, fourth, c[place + i])
    return [_joined(p, sums, s, square) for sums in chains]


def _joined(p: Builder, sums: Sequence[Variable], s: Real, square: Real) -> Real:
    low, high = (p.fma(s, sums[i + 1].value, sums[i].value) for i in (0, 2))
    found: Real = p.fma(square, high, low)
    return found


@shared
def derivative() -> Procedure:
    """Return the procedure that writes the coefficients of a derivative, padded like those of the polynomial."""
    p = Builder("derivative", "Write the coefficients of a polynomial's derivative.", apart=True)
    c, count, slopes = p.array("c", read=True), p.given("count", WHOLE), p.array("slopes")
    with p.loop(1, count) as k:
        slopes[k - 1] = p.real(k) * c[k]
    pad(p, slopes, count - 1, count)
    p.leave()
    return p.finish()


@shared
def crossing() -> Procedure:
    """Return the procedure that finds where a polynomial takes a sign between two points, or the end closest to it."""
    p = Builder("crossing", "Return where a polynomial takes on a sign between two places.", apart=True)
    c, slopes, count = p.array("c", read=True), p.array("slopes", read=True), p.given("count", WHOLE)
    begin, end, sign = p.given("begin", REAL), p.given("end", REAL), p.given("sign", WHOLE)
    number, side = blocks(count), p.real(sign)
    (below, rate), (above, last_rate) = (
        [side * found for found in _evaluated(p, [c, slopes], number, place)] for place in (begin, end)
    )
    with p.when(below >= 0.0):
        p.leave(begin)
    with p.when(above <= 0.0):
        p.leave(end)
    start = inverse_cubic(p, (begin, end), (below, above), (rate, last_rate))
    p.leave(p.call(approach(), c, slopes, count, begin, end, start, sign))
    return p.finish(REAL)


Pair = tuple[Real, Real]


def inverse_cubic(p: Builder, places: Pair, values: Pair, slopes: Pair) -> Real:
    """Return where a function is zero between two places whose inverse is a cubic polynomial, by values and slopes.

    These are the divided differences of the inverse for the two values, each of them twice. Where a slope does not
    rise, or the result is not between the places, it is where the chord is zero.
    """
    (begin, end), (below, above) = places, values
    width, over = end - begin, 1.0 / (above - below)
    rate, last_rate = 1.0 / slopes[0], 1.0 / slopes[1]
    chord = width * over
    bend, last_bend = (chord - rate) * over, (last_rate - chord) * over
    twist = (last_bend - bend) * over
    place = begin - below * (rate - below * (bend - above * twist))
    rising = (slopes[0] > 0.0) & (slopes[1] > 0.0)
    found: Real = p.choose(rising & (begin < place) & (place < end), place, begin - below * chord)
    return found


@shared
def approach() -> Procedure:
    """Return the procedure that finds where a polynomial takes a sign between two points, from a point near it.

    Newton's method, and bisection where it would leave the bracket or does not halve its steps.
    """
    p = Builder("approach", "Return where a polynomial takes on a sign, from a place near it.", apart=True)
    c, slopes, count = p.array("c", read=True), p.array("slopes", read=True), p.given("count", WHOLE)
    begin, end, start, sign = (*(p.given(name, REAL) for name in ("begin", "end", "start")), p.given("sign", WHOLE))
    low, high, place = p.variable(begin, "low"), p.variable(end, "high"), p.variable(start, "place")
    step, quick = p.variable(end - begin, "step"), p.variable(p.false, "quick")
    number, side = blocks(count), p.real(sign)
    with p.repeat(lambda: (low.value < place.value) & (place.value < high.value)):
        s = place.value
        size, slope = (side * found for found in _evaluated(p, [c, slopes], number, s))
        with p.when(size.equals(0.0), likely=False):
            p.leave(s)
        low.value, high.value = p.choose(size < 0.0, s, low.value), p.choose(size < 0.0, high.value, s)
        newton = size / slope
        there, before, change = s - newton, step.value, p.variable(newton, "change")
        inside = (low.value <= there) & (there <= high.value)
        good = (slope > 0.0) & (2.0 * abs(size) < abs(before) * slope) & inside
        # A branch, which processors foresee: the next place does not wait for these comparisons.
        with p.when(~good, likely=False):
            change.value = s - (low.value + high.value) * 0.5
        with p.when(abs(change.value) <= EPSILON * s):
            p.leave(s - change.value)
        # Newton's method squares its error: what the next step would be follows from these two.
        ahead = abs(change.value) * change.value * change.value
        with p.when(quick.value & good & (ahead <= CONVERGED * s * (before * before))):
            p.leave(s - change.value)
        step.value, quick.value, place.value = change.value, good, s - change.value
    p.leave(place.value)
    return p.finish(REAL)


@shared
def passage() -> Procedure:
    """Return the procedure that does the same as `crossing`, from the coefficients of the polynomial alone."""
    p = Builder("passage", "Return where a polynomial takes on a sign between two places.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    low, high, sign = p.given("low", REAL), p.given("high", REAL), p.given("sign", WHOLE)
    slopes = p.reserve(PADDED, name="slopes")
    p.call(derivative(), c, count, slopes)
    p.leave(p.call(crossing(), c, slopes, count, low, high, sign))
    return p.finish(REAL)


@shared
def turn() -> Procedure:
    """Return the procedure that finds the minimum of sign times a polynomial near a point with value `depth`."""
    p = Builder("turn", "Return where a polynomial turns back next to a place.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    low, place, high = p.given("low", REAL), p.given("place", REAL), p.given("high", REAL)
    depth, sign, doubt = p.given("depth", REAL), p.given("sign", WHOLE), p.given("doubt", REAL)
    slopes, bends = p.reserve(PADDED, name="slopes"), p.reserve(PADDED, name="bends")
    p.call(derivative(), c, count, slopes)
    p.call(derivative(), slopes, count, bends)
    falls = p.real(sign) * p.call(value(), slopes, count, place) < 0.0
    begin, end = p.choose(falls, place, low), p.choose(falls, high, place)
    found = p.call(crossing(), slopes, bends, count, begin, end, sign).called("found")
    lower = p.real(sign) * p.call(value(), c, count, found) <= depth + doubt
    p.leave(p.choose(lower, found, place))
    return p.finish(REAL)


@shared
def slope_at_end() -> Procedure:
    """Return the procedure that evaluates a polynomial's derivative at 1."""
    p = Builder("slope_at_end", "Return a polynomial's slope at 1.", apart=True)
    c, count = p.array("c", read=True), p.given("count", WHOLE)
    total = p.variable(0.0)
    with p.loop(1, count) as k:
        total.value = total.value + p.real(k) * c[k]
    p.leave(total.value)
    return p.finish(REAL)
