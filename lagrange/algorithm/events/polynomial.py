"""Polynomials on [0, 1], as event functions have on a step: values, and zeros by Newton's method and bisection.

The variable is the fraction of the step, so a coefficient of power k includes the factor h**k.
"""

from __future__ import annotations

import math

from lagrange.algorithm.events.constants import (
    CONVERGED,
    EPSILON,
    LEAST_POWER,
    MODEST,
    MOST_COEFFICIENTS,
    POLYNOMIAL_NOISE,
    SMALLEST,
)
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    exponent,
    fma,
    mantissa,
    quotient,
    reals,
    two_to,
    unlikely,
    unrolled,
    wholes,
)

CHAINS = 4
"""Number of partial sums of a polynomial, each in powers of s**4, to hide the latency of additions."""

PADDED = (MOST_COEFFICIENTS + CHAINS - 1) // CHAINS * CHAINS
"""Length of the memory for a polynomial's coefficients: whole blocks of `CHAINS` numbers, the rest filled with zeros.
"""


@inline
def blocks(count: int) -> int:
    """Return the number of blocks, of `CHAINS` coefficients each, that hold `count` coefficients."""
    return quotient(count + (CHAINS - 1), CHAINS)


@inline
def pad(c: Out, start: int, count: int) -> None:
    """Write zeros to c from index `start` to the end of the blocks that hold `count` coefficients."""
    for k in range(start, blocks(count) * CHAINS):
        c[k] = 0.0


@inline
def evaluate(polynomials: tuple[Readable[float], ...], count: int, s: float) -> tuple[float, ...]:
    """Return the values of several polynomials at the point s.

    Each polynomial has `count` coefficients, the lowest power first, padded with zeros to whole blocks of `CHAINS`
    numbers.
    """
    square = s * s
    fourth = square * square
    last = (blocks(count) - 1) * CHAINS
    sums = tuple(c[last + i] for c in polynomials for i in unrolled(CHAINS))
    for j in range(1, blocks(count)):
        index = last - j * CHAINS
        terms = tuple(c[index + i] for c in polynomials for i in unrolled(CHAINS))
        sums = tuple(fma(total, fourth, term) for total, term in zip(sums, terms, strict=True))
    starts = unrolled(0, len(sums), CHAINS)
    return tuple(fma(square, fma(s, sums[i + 3], sums[i + 2]), fma(s, sums[i + 1], sums[i])) for i in starts)


@procedure(noinline=True)
def value(c: In, count: int, s: float) -> float:
    """Return the value at s of the polynomial with the `count` coefficients c, the lowest power first.

    The coefficients are padded with zeros to whole blocks of `CHAINS` numbers.
    """
    return evaluate((c,), count, s)[0]


@procedure(noinline=True)
def derivative(c: In, count: int, slopes: Out) -> None:
    """Write the coefficients of the derivative of a polynomial to `slopes`, padded with zeros to whole blocks.

    c has the `count` coefficients of the polynomial, the lowest power first. A block has `CHAINS` numbers.
    """
    for k in range(1, count):
        slopes[k - 1] = float(k) * c[k]
    pad(slopes, count - 1, count)


@procedure(noinline=True)
def crossing(c: In, slopes: In, count: int, begin: float, end: float, sign: int) -> float:
    """Return the zero of a polynomial between `begin` and `end` beyond which it has the sign `sign`, 1 or -1.

    If the polynomial already has that sign at `begin`, the result is `begin`. If it does not have the sign at
    `end`, the result is `end`. c has its coefficients, and `slopes` those of its derivative.
    """
    side = float(sign)
    below, rate = tuple(side * x for x in evaluate((c, slopes), count, begin))
    above, last_rate = tuple(side * x for x in evaluate((c, slopes), count, end))
    if below >= 0.0:
        return begin
    if above <= 0.0:
        return end
    start = inverse_cubic((begin, end), (below, above), (rate, last_rate))
    return approach(c, slopes, count, begin, end, start, sign)


Pair = tuple[float, float]


@inline
def inverse_cubic(points: Pair, values: Pair, slopes: Pair) -> float:
    """Return an approximate zero of a function, by the cubic that interpolates the inverse function.

    The function changes its sign between two `points`; `values` and `slopes` are its values and derivatives at
    these points. If a slope is not positive, or the cubic leads outside, the zero of the chord is returned.
    """
    begin, end = points
    below, above = values
    width, over = end - begin, 1.0 / (above - below)
    rate, last_rate = 1.0 / slopes[0], 1.0 / slopes[1]
    chord = width * over
    bend, last_bend = (chord - rate) * over, (last_rate - chord) * over
    twist = (last_bend - bend) * over
    point = begin - below * (rate - below * (bend - above * twist))
    is_rising = slopes[0] > 0.0 and slopes[1] > 0.0
    return point if is_rising and begin < point < end else begin - below * chord


@procedure(noinline=True)
def approach(c: In, slopes: In, count: int, begin: float, end: float, start: float, sign: int) -> float:
    """Return the zero of a polynomial between `begin` and `end`, by Newton's method from the point `start`.

    `sign`, 1 or -1, is its sign beyond the zero. c has its coefficients, and `slopes` those of its derivative.
    A step that leaves the bracket, or is longer than half of the previous step, is replaced by bisection.
    """
    side = float(sign)
    low, high, point = begin, end, start
    step, is_quick = end - begin, False
    while low < point < high:
        s = point
        size, slope = tuple(side * x for x in evaluate((c, slopes), count, s))
        if unlikely(size == 0.0):
            return s
        low, high = s if size < 0.0 else low, high if size < 0.0 else s
        change = size / slope
        ahead = s - change
        is_good = slope > 0.0 and 2.0 * abs(size) < abs(step) * slope and low <= ahead <= high
        # A branch, not a selection: processors predict it, so the next point does not wait for these comparisons.
        if unlikely(not is_good):
            change = s - (low + high) * 0.5
        if abs(change) <= EPSILON * s:
            return s - change
        # Newton's method squares its error: the size of the next step follows from these two.
        next_change = abs(change) * change * change
        if is_quick and is_good and next_change <= CONVERGED * s * (step * step):
            return s - change
        step, is_quick, point = change, is_good, s - change
    return point


@procedure(noinline=True)
def passage(c: In, count: int, low: float, high: float, sign: int) -> float:
    """Return the zero of a polynomial c between `low` and `high` beyond which it has the sign `sign`, 1 or -1.

    If the polynomial already has that sign at `low`, the result is `low`. If it does not have the sign at `high`,
    the result is `high`. c has `count` coefficients.
    """
    slopes = reals(PADDED)
    derivative(c, count, slopes)
    return crossing(c, slopes, count, low, high, sign)


@procedure(noinline=True)
def turn(c: In, count: int, low: float, point: float, high: float, depth: float, sign: int, noise: float) -> float:
    """Return the point near `point`, between `low` and `high`, at which a polynomial times `sign` is least.

    c has its `count` coefficients. `depth` is the polynomial times `sign` at `point`. The result is `point`
    itself if the value at the minimum exceeds `depth` by more than `noise`.
    """
    slopes, bends = reals(PADDED), reals(PADDED)
    derivative(c, count, slopes)
    derivative(slopes, count, bends)
    falls = float(sign) * value(slopes, count, point) < 0.0
    lowest = crossing(slopes, bends, count, point if falls else low, high if falls else point, sign)
    return lowest if float(sign) * value(c, count, lowest) <= depth + noise else point


@procedure(noinline=True)
def slope_at_end(c: In, count: int) -> float:
    """Return the derivative at 1 of a polynomial with `count` coefficients c."""
    total = 0.0
    for k in range(1, count):
        total += float(k) * c[k]
    return total


Sums = tuple[float, float, float, float]
"""Four numbers about the terms c[k] h**k of a polynomial on a step of length h. The first is the error of the
polynomial's values, infinite or NaN if an input is not finite. Then follow the sum of the magnitudes of all terms but
the first, the sum of the magnitudes of k times each term, and the value at the end of the step.
"""


@inline
def is_plain_step(h: float, count: int) -> bool:
    """Return True if the powers of a step length h below the power `count` are far from over- and underflow."""
    return abs(h) > 1e-6 and abs(h) < 1e6 and count <= MODEST


@inline
def is_plain(total: float, noise: float) -> bool:
    """Return True if terms with a sum of magnitudes `total`, and their noise, are far from overflow and underflow."""
    return total > 1e-100 and total < 1e100 and noise >= 0.0 and noise < 1e100


@inline
def write_terms(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k of a polynomial with `count` coefficients to c. Return `Sums`.

    These are: the error of the polynomial's values, which is `noise` plus rounding; the sum of magnitudes of
    all terms but the first; that of k times the terms; and the value at the end of a step of length h.
    """
    first = coefficients[0]
    c[0] = first
    others, rates, end, power = 0.0, 0.0, first, h
    for k in range(1, count):
        term = coefficients[k] * power
        c[k] = term
        size = abs(term)
        others += size
        rates += float(k) * size
        end += term
        power *= h
    return noise + POLYNOMIAL_NOISE * (abs(first) + others), others, rates, end


@procedure
def scaled(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k of a polynomial to c, padded with zeros. Return their `Sums`.

    These are: the error of the polynomial's values, which is `noise` plus rounding; the sum of magnitudes of
    all terms but the first; that of k times the terms; and the value at the end of a step of length h. If the
    terms may overflow or underflow, they and their noise are divided by a power of two.
    """
    total_noise, others, rates, end = write_terms(coefficients, count, h, noise, c)
    pad(c, count, count)
    if unlikely(not (is_plain_step(h, count) and is_plain(abs(c[0]) + others, noise))):
        return scaled_far(coefficients, count, h, noise, c)
    return total_noise, others, rates, end


@procedure(noinline=True)
def split(x: float) -> tuple[float, int]:
    """Return a number x as (significand, exponent): x = significand * 2**exponent, with 1 <= |significand| < 2.

    Significand and exponent of zero are 0.
    """
    is_tiny = abs(x) < SMALLEST
    y = x * 2.0**54 if is_tiny else x
    significand = math.copysign(mantissa(y), x)
    power = exponent(y) - (54 if is_tiny else 0)
    return 0.0 if x == 0.0 else significand, 0 if x == 0.0 else power


@procedure(noinline=True)
def scaled_far(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k, near overflow or underflow, to c, divided by a power of two.

    Return their `Sums`: the error of the polynomial's values, which is `noise` plus rounding; the sum of
    magnitudes of all terms but the first; that of k times the terms; and the value at the end of the step. All
    are divided by the same power. The error is infinite if an input is not finite.
    """
    is_finite = abs(h) < math.inf and abs(noise) < math.inf
    for k in range(count):
        size = abs(coefficients[k])
        is_finite = is_finite and size < math.inf
    if not is_finite:
        return math.inf, 0.0, 0.0, 0.0
    exponents = wholes(PADDED)
    unit, unit_exponent = split(h)
    noise_part, noise_exponent = split(noise)
    top = LEAST_POWER if noise_part == 0.0 else noise_exponent
    power = 1.0
    for k in range(count):
        fraction, exponent = split(coefficients[k])
        term, moved = fraction * power, exponent + k * unit_exponent
        c[k], exponents[k] = term, moved
        power *= unit
        top = top if term == 0.0 else max(top, moved)
    for k in range(count):
        c[k] = lowered(c[k], exponents[k] - top)
    return write_terms(c, count, 1.0, lowered(noise_part, noise_exponent - top), c)


@inline
def lowered(x: float, power: int) -> float:
    """Return x * 2**min(power, 0), or 0 for a power below -1000."""
    # A coefficient that is zero has no scale: its power may be above 0.
    return 0.0 if power < -1000 else x * two_to(min(max(power, -1000), 0))
