"""The series of a watched function on a Taylor step: its rounding noise, the range in which it is accurate, its sign.

Three tests use the series. First, the coefficients may show that the function keeps its sign; then it is excluded.
Second, the sums of its terms usually decide that it has one zero, or none. Third, the sign at the end of a step must
agree with the series. A function that saturates, such as erf(x), looks constant where it is flat, and its series does
not show a slope further ahead. The next series begins with the exact value, which reveals the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.events.constants import JUMP, MOST_COEFFICIENTS, POLYNOMIAL_NOISE, SURELY
from lagrange.algorithm.events.halving import sign_of
from lagrange.algorithm.events.polynomial import approach, inverse_cubic, pad
from lagrange.algorithm.events.scaling import is_plain, is_plain_step
from lagrange.algorithm.step.run import FUNCTION
from lagrange.algorithm.taylor.constants import EVENT_SLACK, RADIUS_FRACTION, ROW_DISTANCE
from lagrange.algorithm.taylor.memory import TaylorLayout, row, work_type
from lagrange.algorithm.taylor.watching import (
    NEAR,
    SIDES,
    SIGN,
    SMOOTH,
    STARTING,
    TERM_SUMS,
    Watched,
    moved_state,
    own_numbers,
    real_part,
    setting,
    side,
    watched_type,
)
from lagrange.procedure.form import PARTIAL, Array
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    WholesOut,
    each,
    fma,
    larger,
    likely,
    magnitude,
    quotient,
    reals,
    record,
    smaller,
    unrolled,
)

EVENT_NOISE = 4 * 2.0**-52 / 2.0**-26
"""Noise of an event function, as a multiple of its change under a perturbation of the state. It is the rounding of the
state, here and at the end of the last step, divided by the relative perturbation (half of the digits).
"""

BALANCE = 256.0
"""Bound for an event function on a step that the series does not limit: the largest ratio of its higher terms, which
grow with the square of time or faster, to its lower terms. It costs two digits of the roots; runs then take a few more
steps.
"""

DOUBT = 64 * 2.0**-52
"""A coefficient of an event function is zero if it is below this fraction of the sum of all coefficients."""


@procedure(
    apart=True,
    function=lambda: FUNCTION,
    noise=lambda: Array(room=WIDEST_VECTOR),
    moved=lambda: Array(room=WIDEST_VECTOR),
)
def event_noise(
    function: Callable[..., bool],
    numbers: In,
    tilts: In,
    t: float,
    size: int,
    count: int,
    y: In,
    values: In,
    noise: Out,
    moved: Out,
) -> None:
    """Write the noise of watched functions, with these `values`, due to rounding of the state.

    The state here and at the end of the last step may be rounded. The time and the `size` entries of the state are
    multiplied by `tilts`, which differ from 1 by about the square root of the rounding unit. With equal factors the
    difference of two equal entries would seem exact. `moved` is memory for the perturbed state.
    """
    for i in range(size):
        moved[i] = y[i] * tilts[i]
    function(t * tilts[size], moved, numbers, noise)
    for i in range(count):
        change = abs(noise[i] - values[i]) * EVENT_NOISE
        noise[i] = change if change < math.inf else 0.0


@inline
def write_noise(watched: Watched, numbers: In, t: float, state: In, layout: Any) -> None:
    """Write the noise of the watched functions to the scratch memory: their errors due to rounding of the `state`.

    The scratch memory must contain their values at the `state`.
    """
    values, noise = real_part(watched, "values", layout), real_part(watched, "noise", layout)
    sizes, moved = (layout.dimension, layout.watched), moved_state(watched, layout)
    event_noise(watched.values, numbers, watched.tilts, t, *sizes, state, values, noise, moved)


@procedure(apart=True)
def reach(c: In, count: int, s: float, tolerance: float, noise: float) -> float:
    """Return the length, up to s, of the part of a step on which a series is accurate or its error is below noise.

    It is s if the series terminates. The truncation error of the series of an expression may exceed that of the state:
    it is a sum of products.
    """
    far, ratio, tries = s, math.inf, 0
    share, middle = -1.0 / float(count - 1), quotient(count - 1, 2)
    if c[count - 1] == 0.0 and c[count - 2] == 0.0:
        return s
    while ratio > 1.0 and tries < 60:
        tries += 1
        early, late, power = 0.0, 0.0, 1.0
        for k in range(count):
            term = abs(c[k]) * power
            early = larger(early, term) if k <= middle else early
            late = larger(late, term) if k >= count - 2 else late
            power *= far
        excess = late / fma(tolerance, early, noise)
        ratio = excess if excess >= 0.0 else math.inf
        if ratio > 1.0:
            far *= smaller(larger(math.pow(ratio, share), 0.05), 0.9)
    return far


@procedure(apart=True)
def safe_step(c: In, count: int) -> float:
    """Return the longest safe step: within the radius of convergence, as the last coefficients of a series show it."""
    radius = larger(shown_radius(c, count - 2), shown_radius(c, count - 1))
    return radius * math.pow(2.0, RADIUS_FRACTION)


@inline
def shown_radius(c: In, late: int) -> float:
    """Return the radius of convergence from the coefficients of order `late` and an earlier one; inf if one is 0."""
    early = max(late - ROW_DISTANCE, 1)
    before, after = abs(c[early]), abs(c[late])
    shown = math.pow(before / after, 1.0 / float(late - early))
    return shown if before > 0.0 and after > 0.0 else math.inf


@procedure(apart=True)
def is_balanced(c: In, count: int, s: float) -> bool:
    """Return True if the high powers of a series on a step are at most `BALANCE` times the low ones."""
    low = larger(abs(c[0]), abs(c[1]) * s)
    high, power = 0.0, s * s
    for k in range(2, count):
        high = larger(high, abs(c[k]) * power)
        power *= s
    return not (low > 0.0 and high > BALANCE * low)


@procedure(apart=True)
def keeps_sign(c: In, count: int, s: float, noise: float, sign: float) -> bool:
    """Return True if a series certainly keeps its sign on a step: its linear part exceeds the rest at both ends."""
    rest, power = 0.0, s * s
    for k in range(2, count):
        rest += abs(c[k]) * power
        power *= s
    sizes = abs(c[0]) + abs(c[1]) * s + rest
    return is_linear(sign * c[0], sign * fma(c[1], s, c[0]), sizes, rest, noise)


@inline
def is_linear(start: float, end: float, sizes: float, rest: float, noise: float) -> bool:
    """Return True if the linear part of a series exceeds the `rest` of the series, hence keeps its sign.

    `start` and `end` are the values of the linear part at the ends of a step; between the ends it is between them.
    `sizes` is the sum of magnitudes of all terms of the series.
    """
    least = fma(POLYNOMIAL_NOISE, sizes, rest + noise) * SURELY
    return start > least and end > least


@procedure(apart=True)
def largest_term(c: In, count: int, s: float) -> float:
    """Return the largest |c[k]| s**k of a series."""
    most, power = 0.0, 1.0
    for k in range(count):
        most = larger(most, abs(c[k]) * power)
        power *= s
    return most


ZERO_ROUND_OFF = 64 * 2.0**-52
"""Largest value of a function, relative to the sum of its terms, that counts as zero at the zero of another function.
"""


@procedure(apart=True)
def vanishes(c: In, count: int, s: float, noise: float) -> bool:
    """Return True if a series is zero at time s, within its noise and the rounding of its terms."""
    total, sizes, power = 0.0, 0.0, 1.0
    for k in range(count):
        term = c[k] * power
        total, sizes = total + term, sizes + abs(term)
        power *= s
    return abs(total) <= fma(ZERO_ROUND_OFF, sizes, noise)


@procedure
def start_of_series(c: In, count: int, unit: float, tolerance: float, noise: float, margin: float) -> tuple[int, int]:
    """Return the sign with which a watched function leaves zero at a start, and the order of the term with that sign.

    The order is 0 if the function is not zero at the start: beyond its `margin` and the rounding of its terms over the
    time `unit`. It is -1, with sign 0, if all terms are rounding.
    """
    far = reach(c, count, unit, tolerance, noise)
    near = reals(MOST_COEFFICIENTS)
    total, power = 0.0, 1.0
    for k in range(count):
        term = c[k] * power
        near[k] = term
        total = total + (0.0 if k == 0 else abs(term))
        power *= far
    rounding = DOUBT * total if total < math.inf else 0.0
    if not abs(near[0]) <= margin + rounding:
        return sign_of(near[0], 0.0), 0
    for k in range(1, count):
        if abs(near[k]) > DOUBT * total:
            return sign_of(near[k], 0.0), k
    return 0, -1


@inline
def comparable_unit(t: float, scale: float) -> float:
    """Return the time, in units of the scale, at which a velocity is compared with an acceleration.

    The scale of a polynomial motion is arbitrary. Motions shorter than some spacings of floating-point times cannot be
    resolved in any case.
    """
    return 1.0 if t == 0.0 else larger(smaller(abs(t / scale) * (1.0 / 64), 1.0), 2.0**-40)


REST, RATES, END, SLOPE, LATE = range(len(TERM_SUMS))

LEAST_COUNT = 3
"""Least number of coefficients of a series; shorter ones are padded with zeros."""


@record
class TermSums:
    """Two sums of alternate terms of a series, to hide the latency of additions. `TERM_SUMS` is the record."""

    number: float
    """Order of the next term."""

    power: float
    """Power of the step length in the next term."""

    rest: float
    rates: float
    end: float
    slope: float


@inline
def begin_sums(number: float, power: float, end: float, slope: float) -> TermSums:
    """Return sums whose next term has the order `number` and is multiplied by `power`, the step to that order.

    `end` and `slope` are the values with which the sums of terms, and of terms times their orders, begin.
    """
    sums = TermSums()
    sums.number = number
    sums.power = power
    sums.end = end
    sums.slope = slope
    return sums


@inline
def add_term(sums: TermSums, coefficient: float, square: float) -> tuple[float, float]:
    """Add the next term, which has a `coefficient`. Return the term, and the term times its order.

    `square` is the square of the length of the step.
    """
    term = coefficient * sums.power
    rate = sums.number * term
    sums.rest += abs(term)
    sums.rates += abs(rate)
    sums.end += term
    sums.slope += rate
    sums.power *= square
    sums.number += 2.0
    return term, rate


@procedure
def event_terms(rows: In, width: int, order: int, s: float, c: Out, slopes: Out, sums: Out) -> None:
    """Write the terms x[k] s**k of a watched function, also multiplied by k, and their `TERM_SUMS`.

    The terms are written to `c`, the terms times k to `slopes`, and the sums to `sums`. The coefficients x[k] are read
    from rows that are `width` doubles apart.
    """
    start, slope, square, pairs = rows[0], rows[width] * s, s * s, quotient(order - 1, 2)
    c[0], c[1], slopes[0] = start, slope, slope
    even, odd = begin_sums(2.0, square, start, 0.0), begin_sums(3.0, square * s, slope, slope)
    for j in range(pairs):
        k = j * 2 + 2
        c[k], slopes[k - 1] = add_term(even, rows[k * width], square)
        c[k + 1], slopes[k] = add_term(odd, rows[(k + 1) * width], square)
    for k in range(pairs * 2 + 2, order + 1):
        c[k], slopes[k - 1] = add_term(even, rows[k * width], square)
    pad(c, order + 1, order + 1)
    pad(slopes, order, order + 1)
    sums[REST], sums[RATES] = even.rest + odd.rest, even.rates + odd.rates
    sums[END], sums[SLOPE] = even.end + odd.end, even.slope + odd.slope
    sums[LATE] = magnitude(c[order - 1], c[order])


@procedure
def only_zero(s: float, order: int, sign: int, noise: float, terms: In, sums: In) -> int:
    """Return the sign to which a watched function changes on a step, once; 0 if it keeps its sign, 2 if undecided.

    It is undecided by the sums of terms if the slope may change its sign, or if a value at an end is within its noise.
    """
    start, slope, rest, rates, end = terms[0], terms[1], sums[REST], sums[RATES], sums[END]
    rate, side = abs(slope), float(sign)
    total = abs(start) + rate + rest
    if is_linear(side * start, side * (start + slope), total, rest, noise):
        return 0
    error = noise + POLYNOMIAL_NOISE * total
    is_monotonic = 2.0 * rate > SURELY * (rate + rates)
    is_usual = is_plain_step(s, order + 1) and is_plain(total, noise)
    end_sign = sign_of(end, error)
    is_decided = is_usual and is_monotonic and sign != 0 and sign_of(start, error) == sign and end_sign != 0
    return (0 if end_sign == sign else end_sign) if is_decided else 2


@procedure
def only_passage(terms: In, slopes: In, sums: In, order: int, sign: int) -> float:
    """Return the only point between 0 and 1 at which the polynomial with coefficients `terms` reaches `sign`.

    `slopes` are the coefficients of its derivative, and `sums` are its `TERM_SUMS`.
    """
    count, side = used_count(terms, order), float(sign)
    values, rates = (side * terms[0], side * sums[END]), (side * slopes[0], side * sums[SLOPE])
    return approach(terms, slopes, count, 0.0, 1.0, inverse_cubic((0.0, 1.0), values, rates), sign)


@inline
def used_count(c: Readable[float], order: int) -> int:
    """Return the number of coefficients up to the last nonzero one, at least `LEAST_COUNT`."""
    count = order + 1
    while count > LEAST_COUNT and c[count - 1] == 0.0:
        count -= 1
    return count


@procedure(apart=True)
def read_column(rows: In, width: int, order: int, c: Out, counts: WholesOut) -> bool:
    """Copy the series of a watched function from rows, `width` apart, on first use. Return True if it is finite.

    `counts` has the number of its coefficients up to the last nonzero one, or 0 before the copy.
    """
    if counts[0] != 0:
        return True
    is_finite = copy_series(rows, width, order + 1, c)
    counts[0] = used_count(c, order)
    return is_finite


@inline
def copy_series(rows: In, width: int, count: int, c: Out) -> bool:
    """Copy the series of a watched function from rows, `width` apart. Return True if it is finite."""
    total = 0.0
    for k in range(count):
        c[k] = rows[k * width]
        total += c[k] * 0.0
    return total == 0.0


@procedure(doubtful=work_type, work=work_type)
def doubtful_events(s: float, everything: bool, doubtful: Out, work: Out, order: int, *, layout: TaylorLayout) -> bool:
    """Write 1 for each watched function that may be zero on a step of length s, else 0. Return True if any may.

    With `everything`, 1 is written for all. A function keeps its sign if its linear part exceeds the rest at both ends
    of the step, and has one sign there.
    """
    rows, width = work[layout.rows + layout.watched_at :], layout.width
    number = 0.0
    for i in each(layout.watched, width=1 if layout.watched == 1 else PARTIAL, unrolled=True):
        start = rows[i]
        end = fma(rows[width:][i], s, start)
        outweighs = smaller(abs(start), abs(end)) > sum_beyond_linear(rows, width, order, s, i)
        flag = 0.0 if outweighs and start * end > 0.0 else 1.0
        flag = 1.0 if everything else flag
        doubtful[i] = flag
        number += flag
    return number > 0.0


CHAINS = 4
"""Number of independent partial sums of coefficients, to hide the latency of additions."""


@inline
def sum_beyond_linear(rows: Readable[float], width: int, order: int, s: float, i: int) -> float:
    """Return the sum of |x[k]| s**k over k >= 2, for watched function i."""
    blocks = quotient(order - 1, CHAINS)
    square = s * s
    fourth = square * square
    c0, c1, c2, c3 = 0.0, 0.0, 0.0, 0.0
    for j in range(order - 1 - blocks * CHAINS):
        c0 = fma(c0, s, abs(rows[(order - j) * width :][i]))
    for j in range(blocks):
        first = rows[((blocks - 1 - j) * CHAINS + 2) * width :]
        c0, c1 = fma(c0, fourth, abs(first[i])), fma(c1, fourth, abs(first[width:][i]))
        c2, c3 = fma(c2, fourth, abs(first[2 * width :][i])), fma(c3, fourth, abs(first[3 * width :][i]))
    return square * fma(square, fma(s, c3, c2), fma(s, c1, c0))


@procedure(watched=watched_type)
def contradicts(t: float, rtol: float, length: float, watched: Watched, *, layout: TaylorLayout) -> bool:
    """Return True if the sign of a function contradicts the series of the last step, of this `length`.

    Functions that may jump are excluded: their sign may change without a zero.
    """
    is_doubted = False
    for i in range(layout.watched):
        is_other = changes_side(watched, i, length, layout)
        is_doubted = is_doubted or is_other
    if likely(not is_doubted):
        return False
    values, noise = real_part(watched, "values", layout), real_part(watched, "noise", layout)
    first = row(watched.work, 0, layout)[layout.watched_at :]
    for i in range(layout.watched):
        values[i] = first[i]
    write_noise(watched, own_numbers(watched), t, watched.work, layout)
    # The error of the state is its rounding times the ratio of tolerance to rounding.
    slack = EVENT_SLACK * fma(rtol, 2.0**50, 1.0)
    is_wrong = False
    for i in range(layout.watched):
        is_other = changes_side(watched, i, length, layout)
        is_far = abs(values[i]) > slack * noise[i]
        is_wrong = is_wrong or (is_other and is_far)
    return is_wrong


@inline
def changes_side(watched: Watched, i: int, length: float, layout: TaylorLayout) -> bool:
    """Return True if function i, which cannot jump, has changed its sign by more than its slope explains.

    `length` is the length of the last step in units of the scale.
    """
    value, slope = [row(watched.work, k, layout)[layout.watched_at :][i] for k in unrolled(2)]
    started, near = watched.sides[layout.watched * (SIDES + STARTING) :][i], side(watched, NEAR, layout)[i]
    sign, smooth = side(watched, SIGN, layout)[i], setting(watched, SMOOTH, i, layout)
    is_settled = near == 0 and smooth != 0 and started == 0
    return is_settled and float(sign) * value < 0.0 and abs(value) > JUMP * abs(slope) * length
