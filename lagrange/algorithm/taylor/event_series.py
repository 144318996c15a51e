"""Tests for zeros of event functions on a Taylor step, by their series: rounding noise, accurate range, sign.

A watched function is an event function or a switching surface. Three tests use its series. First, the coefficients may
show that the function keeps its sign. Second, the sums of its terms usually show that it has one zero or none. Third,
the sign at the end of a step must agree with the series. A function that saturates, such as erf(x), looks constant
where it is flat, and its series does not show a slope further ahead. The next series begins with the exact value, which
shows the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lagrange.algorithm.events.constants import JUMP, MOST_COEFFICIENTS, POLYNOMIAL_NOISE, SURELY
from lagrange.algorithm.events.polynomial import PADDED, approach, inverse_cubic, is_plain, is_plain_step, pad
from lagrange.algorithm.events.roots import sign_of
from lagrange.algorithm.step.memory import FUNCTION
from lagrange.algorithm.taylor.memory import EVENT_SLACK, RADIUS_FRACTION, ROW_DISTANCE, TaylorLayout, work_type
from lagrange.algorithm.taylor.watched_functions import COLUMN, TERM_SUMS, Watched, WatchedView, watched_type
from lagrange.procedure.form import PARTIAL
from lagrange.procedure.front.decorators import inline, procedure
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
)

EVENT_NOISE = 4 * 2.0**-52 / 2.0**-26
"""Noise of an event function, as a multiple of its change under a perturbation of the state. The noise is due to the
rounding of the state, in the function and at the end of the last step. The relative perturbation is 2**-26, half of the
digits.
"""

BALANCE = 256.0
"""Largest ratio of an event function's terms of power 2 or more to its other terms, on a step that the state's series
does not limit. With this ratio roots lose two digits, and runs take a few more steps.
"""

DOUBT = 64 * 2.0**-52
"""Largest coefficient of an event function that counts as zero, as a fraction of the sum of all coefficients."""


@procedure(noinline=True, function=lambda: FUNCTION, noise=work_type, moved=work_type)
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
    """Write the change of each watched function that rounding of the time and the state may cause to `noise`.

    `function` evaluates the functions at a time and a state from `numbers`; `values` are its results at time t
    and state y. The time and the `size` entries of the state are multiplied by `tilts`, which differ from 1 by
    about the square root of the rounding unit. With equal factors the difference of two equal entries would
    seem exact. `count` is the number of functions, and `moved` is memory for the perturbed state.
    """
    for i in range(size):
        moved[i] = y[i] * tilts[i]
    function(t * tilts[size], moved, numbers, noise)
    for i in range(count):
        change = abs(noise[i] - values[i]) * EVENT_NOISE
        noise[i] = change if change < math.inf else 0.0


@inline
def write_noise(view: WatchedView, numbers: In, t: float, state: In) -> None:
    """Write the change of each watched function that rounding of time and `state` may cause to scratch memory.

    The scratch memory must contain the values of the functions at the `state`. `numbers` are the parameters and
    all values that depend only on them.
    """
    sizes = view.layout.dimension, view.layout.watched
    event_noise(view.watched.values, numbers, view.tilts, t, *sizes, state, view.values, view.noise, view.moved)


@procedure(noinline=True)
def reach(c: In, count: int, s: float, tolerance: float, noise: float) -> float:
    """Return the length, up to s, on which the error of a series is below a relative `tolerance` or the `noise`.

    `c` has the `count` coefficients of the series of a function. The result is s if the series terminates. The
    truncation error of the series of an event function may exceed the error of the state's series, because the
    function may contain products.
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


@procedure(noinline=True)
def safe_step(c: In, count: int) -> float:
    """Return the longest safe step: a fraction of the radius of convergence that the last coefficients show.

    `c` has the `count` coefficients of the series.
    """
    radius = larger(shown_radius(c, count - 2), shown_radius(c, count - 1))
    return radius * math.pow(2.0, RADIUS_FRACTION)


@inline
def shown_radius(c: In, late: int) -> float:
    """Return the radius of convergence that two coefficients of a series show; infinity if one of them is 0.

    The coefficients are of order `late` and of the order `ROW_DISTANCE` below; `c` has all coefficients.
    """
    early = max(late - ROW_DISTANCE, 1)
    before, after = abs(c[early]), abs(c[late])
    shown = math.pow(before / after, 1.0 / float(late - early))
    return shown if before > 0.0 and after > 0.0 else math.inf


@procedure(noinline=True)
def is_balanced(c: In, count: int, s: float) -> bool:
    """Return True if no term of power 2 or more dominates the series of a watched function on a step.

    A term dominates if it is larger than `BALANCE` times the larger of the terms of power 0 and 1. The result is
    also True if both of these are zero. `c` has the `count` coefficients, and s is the length of the step.
    """
    low = larger(abs(c[0]), abs(c[1]) * s)
    high, power = 0.0, s * s
    for k in range(2, count):
        high = larger(high, abs(c[k]) * power)
        power *= s
    return not (low > 0.0 and high > BALANCE * low)


@procedure(noinline=True)
def keeps_sign(c: In, count: int, s: float, noise: float, sign: float) -> bool:
    """Return True if a series certainly keeps the `sign` on a step: its linear part exceeds all other terms.

    `c` has the `count` coefficients, `noise` is the error of the values, and s is the length of the step.
    """
    rest, power = 0.0, s * s
    for k in range(2, count):
        rest += abs(c[k]) * power
        power *= s
    sizes = abs(c[0]) + abs(c[1]) * s + rest
    return is_linear(sign * c[0], sign * fma(c[1], s, c[0]), sizes, rest, noise)


@inline
def is_linear(start: float, end: float, sizes: float, rest: float, noise: float) -> bool:
    """Return True if the linear part of a series on a step exceeds all other terms, so that it stays positive.

    `start` and `end` are the values of the linear part at the ends of the step. `rest` is the sum of magnitudes of
    the other terms, `sizes` the sum of magnitudes of all terms, and `noise` the error of the values.
    """
    least = fma(POLYNOMIAL_NOISE, sizes, rest + noise) * SURELY
    return start > least and end > least


@procedure(noinline=True)
def largest_term(c: In, count: int, s: float) -> float:
    """Return the largest magnitude of a term |c[k]| s**k of a series with the coefficients c[:count]."""
    most, power = 0.0, 1.0
    for k in range(count):
        most = larger(most, abs(c[k]) * power)
        power *= s
    return most


ZERO_ROUND_OFF = 64 * 2.0**-52
"""Largest value of a watched function that counts as zero at the zero of another one, as a fraction of the sum of the
magnitudes of its terms.
"""


@procedure(noinline=True)
def vanishes(c: In, count: int, s: float, noise: float) -> bool:
    """Return True if a series with the coefficients c[:count] is zero at time s, within noise and rounding."""
    total, sizes, power = 0.0, 0.0, 1.0
    for k in range(count):
        term = c[k] * power
        total, sizes = total + term, sizes + abs(term)
        power *= s
    return abs(total) <= fma(ZERO_ROUND_OFF, sizes, noise)


@procedure
def start_of_series(c: In, count: int, unit: float, tolerance: float, noise: float, margin: float) -> tuple[int, int]:
    """Return the sign of a watched function just after a start, and the order of the term that determines it.

    `c` has the `count` coefficients of its series, and `noise` is the error of its values. The order is 0 if
    the value at the start exceeds its `margin` plus the rounding of the terms. Terms are compared over the time
    on which the series is accurate to the `tolerance`, at most `unit`. The order is -1, with sign 0, if all
    terms are rounding.
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
    """Return the time over which terms of a watched function's series are compared, in units of the time scale.

    The result is one time scale, or |t| / 64 if that is shorter: the scale of a polynomial motion is arbitrary.
    Motions shorter than some spacings of floating-point times cannot be resolved in any case.
    """
    return 1.0 if t == 0.0 else larger(smaller(abs(t / scale) * (1.0 / 64), 1.0), 2.0**-40)


REST, RATES, END, SLOPE, LATE = range(len(TERM_SUMS))

LEAST_COUNT = 3
"""Least number of coefficients of the series of a watched function. A shorter series is padded with zeros."""


@record
class TermSums:
    """Sums over every second term x[k] s**k of a series. Sums for even and for odd k are computed in parallel.

    `rest` is the sum of the magnitudes of the terms, and `rates` the sum of k times these magnitudes. `end` and
    `slope` are the same sums with the signs of the terms.
    """

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
    """Return sums over every second term x[k] s**k of a series, before the term of order `number` is added.

    `power` is s**number. `end` and `slope` are the initial values of two sums. `end` is that of the sum of the terms.
    `slope` is that of the sum of the terms times their orders.
    """
    sums = TermSums()
    sums.number = number
    sums.power = power
    sums.end = end
    sums.slope = slope
    return sums


@inline
def add_term(sums: TermSums, coefficient: float, square: float) -> tuple[float, float]:
    """Add the next term to `sums`, given its `coefficient`. Return the term, and the term times its order.

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
    """Write the terms x[k] s**k of a watched function on a step of length s to `c`, and sums of them to `sums`.

    The terms times k are written to `slopes`. `sums` gets five numbers: the sum of |terms| with k > 1, the sum
    of k times these, the sum of all terms, the sum of k times all terms, and the larger of the last two
    |terms|. The coefficients x[k], for k from 0 to `order`, are read from `rows`, at indices that are multiples
    of `width`.
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
    """Return the sign to which a watched function changes once on a step; 0 if it keeps its sign, 2 if undecided.

    The result is undecided if the slope may change its sign, or if a value at an end is within its error, the
    `noise` plus rounding. `sign` is the sign at the start. `terms` and `sums` are those of `event_terms`, for a
    series of an `order` on a step of length s.
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
    """Return the only point between 0 and 1 at which a polynomial changes to the sign `sign`, 1 or -1.

    `terms` are its coefficients up to `order`, `slopes` those of its derivative, and `sums` their sums, as
    `event_terms` writes them.
    """
    count, side = used_count(terms, order), float(sign)
    values, rates = (side * terms[0], side * sums[END]), (side * slopes[0], side * sums[SLOPE])
    return approach(terms, slopes, count, 0.0, 1.0, inverse_cubic((0.0, 1.0), values, rates), sign)


@inline
def used_count(c: Readable[float], order: int) -> int:
    """Return the number of coefficients c up to the last nonzero one, at least `LEAST_COUNT`.

    The series has the coefficients of the orders 0 to `order`.
    """
    count = order + 1
    while count > LEAST_COUNT and c[count - 1] == 0.0:
        count -= 1
    return count


@procedure(noinline=True)
def read_column(rows: In, width: int, order: int, c: Out, counts: WholesOut) -> bool:
    """Copy the coefficients of a watched function from rows to `c`, unless that was done before.

    Return False if a coefficient is not finite. The coefficients are read from `rows` at indices that are multiples
    of `width`. `counts[0]` is 0 before the copy; then it is the number of coefficients up to the last nonzero one.
    """
    if counts[0] != 0:
        return True
    is_finite = copy_series(rows, width, order + 1, c)
    counts[0] = used_count(c, order)
    return is_finite


@inline
def column_of(view: WatchedView, i: int) -> tuple[bool, In]:
    """Return (True if finite, coefficients) for the series of watched function i.

    The coefficients are copied to adjacent memory if that was not done before.
    """
    c = view.columns[i * COLUMN :]
    is_finite = read_column(view.rows[i:], view.layout.width, view.order, c, view.coefficient_counts[i:])
    return is_finite, c


@inline
def terms_of(view: WatchedView, i: int) -> tuple[Out, Out, Out]:
    """Return three arrays in scratch memory for watched function i: its terms, slopes and sums on a step.

    These are the arrays that `event_terms` writes.
    """
    return view.terms[i * PADDED :], view.slopes[i * PADDED :], view.sums[i * len(TERM_SUMS) :]


@inline
def copy_series(rows: In, width: int, count: int, c: Out) -> bool:
    """Copy `count` coefficients of a watched function to `c`. Return True if all of them are finite.

    The coefficients are read from `rows` at indices that are multiples of `width`.
    """
    total = 0.0
    for k in range(count):
        c[k] = rows[k * width]
        total += c[k] * 0.0
    return total == 0.0


@procedure(doubtful=work_type, work=work_type)
def doubtful_events(s: float, everything: bool, doubtful: Out, work: Out, order: int, *, layout: TaylorLayout) -> bool:
    """Find the watched functions that may be zero on a step of length s. Return True if there are any.

    `doubtful` becomes 1.0 for each of them, else 0.0; with `everything` it is 1.0 for all. A function keeps its
    sign if the linear part of its series exceeds the rest at both ends of the step, and has one sign there. The
    series are in `work`.
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
    """Return the sum of |x[k]| s**k over k from 2 to `order`, for watched function i on a step of length s.

    The coefficients x[k] are read from `rows`, which are `width` doubles apart.
    """
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
    """Return True if the sign of a watched function at time t differs from the prediction of its last series.

    `length` is the length of the last step in units of the time scale, and `rtol` the relative tolerance. Functions
    that may jump are excluded: their sign may change without a zero.
    """
    view, is_doubted = WatchedView(watched, layout), False
    for i in range(layout.watched):
        is_other = changes_side(view, i, length)
        is_doubted = is_doubted or is_other
    if likely(not is_doubted):
        return False
    for i in range(layout.watched):
        view.values[i] = view.rows[i]
    write_noise(view, view.numbers, t, watched.work)
    # The error of the state exceeds its rounding by the ratio of the tolerance to the rounding unit.
    slack = EVENT_SLACK * fma(rtol, 2.0**50, 1.0)
    is_wrong = False
    for i in range(layout.watched):
        is_other = changes_side(view, i, length)
        is_far = abs(view.values[i]) > slack * view.noise[i]
        is_wrong = is_wrong or (is_other and is_far)
    return is_wrong


@inline
def changes_side(view: WatchedView, i: int, length: float) -> bool:
    """Return True if watched function i has another sign than the search for zeros found for it.

    Values that the slope explains over a small part of the last step do not count. `length` is the length of the
    last step in units of the time scale. Functions that may jump are excluded.
    """
    value, slope, sign = view.rows[i], view.rows[view.layout.width :][i], view.signs[i]
    is_settled: bool = view.near_flags[i] == 0 and view.smooth[i] != 0 and view.kept_starting[i] == 0
    return is_settled and float(sign) * value < 0.0 and abs(value) > JUMP * abs(slope) * length
