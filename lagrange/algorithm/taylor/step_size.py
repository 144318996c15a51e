"""Size of a Taylor step by the last rows of its series, and defect test of the step: acceptance or rejection.

A row has the coefficients of one order. The truncation error of a series of order p, relative to its tolerance, is
about the size of its last two rows. The step keeps both below one. The growth of the rows gives the radius of
convergence. Source: A. Jorba, M. Zou, A software package for the numerical integration of ODEs by means of high-order
Taylor methods, Experimental Mathematics 14 (2005), 99-117.

At the end of a step the derivative of its series must agree with the equations. A step is recorded when the series of
the next step confirms it. Otherwise the run returns to the start of the step and tries a shorter one. Functions with
powers above the order of the series are also compared with their series.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from lagrange.algorithm.constants import LEAST_FLOOR
from lagrange.algorithm.step.memory import FUNCTION, Counts, Run
from lagrange.algorithm.taylor.event_series import event_noise
from lagrange.algorithm.taylor.memory import (
    EVENT_SLACK,
    JET,
    LOWEST_ORDER,
    PROBES,
    RADIUS_FRACTION,
    ROW_DISTANCE,
    Held,
    OutputCounts,
    Sizes,
    TaylorLayout,
    TaylorState,
    floors_type,
    layout_of,
    less,
    minus_one_over,
    ratio,
    row,
    rows_type,
    weights_type,
    work_type,
)
from lagrange.algorithm.taylor.sums import horner, state_on_step
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    each,
    exponent,
    fma,
    larger,
    magnitude,
    mantissa,
    nearest,
    quotient,
    reals,
    smaller,
    two_to,
    unlikely,
    unrolled,
)

START_ROWS = 4
"""Number of orders, from 1 on, whose Taylor coefficients give the size of an entry of the state that is zero at the
start of a run. The fourth derivative includes one coupling between coordinates. An entry has no estimate if all these
coefficients are zero.
"""

ROWS_USED = 6
GUARD = 0.25
"""`ROWS_USED`: number of last rows of a series that bound the step. `GUARD`: margin, in binary digits, by which a step
may exceed the bound by the earlier of these rows. The last two rows determine the step. The rows before them give a
second bound: from rest every other coefficient is zero, and the last nonzero one may be small by chance. Row k of a
series of radius r gives the step r tolerance**(1/k). The margin is needed because the rows of an entire function
decrease faster and faster.

Rows below half of the order are not used. If a velocity is zero, its tolerance is relative to its first coefficient,
and such a row gives the unit of time, which follows the step. At order 4 and a tolerance of 1e-12 no step would be long
enough. If the order p is low for the tolerance, the row before the last would give steps like tolerance**(1/(p - 1)).
These are 18 times as many as tolerance**(1/p) at order 4 and 1e-15. So the radius of that row is used at the last
order, less `GUARD`.
"""

ZERO, ZERO_BOUND = -900.0, -800.0
"""Binary logarithms of a coefficient's size divided by its tolerance. `ZERO` replaces the logarithm of zero, and a
coefficient below `ZERO_BOUND` counts as zero. In a suitable scale the last coefficients are within
2**(LARGEST_SCALE_RATIO * order) of the tolerance, 2**640 at order 64. So only zeros are below the bound.
"""

LARGEST_STEP_EXPONENT = 900.0
"""Binary logarithm of the longest step, in units of the time scale. If the series is a polynomial, it may allow a step
beyond the range of doubles.
"""

LOG2 = (-1.6531240060861732, 1.9941811995403236, -0.33474901889029146)
EXP2 = (1.0, 0.703601177393781, 0.24203533019053836)
"""Coefficients of two polynomials, lowest power first. `LOG2` approximates the binary logarithm on [1, 2], accurate to
0.007. `EXP2` approximates the power of two on [-1/2, 1/2], accurate to 0.002. A step size needs only two digits, and
the C library's functions would take a tenth of the time of a small step.
"""


@procedure
def logarithm(x: float) -> float:
    """Return the binary logarithm of a nonnegative number to two digits, at least `ZERO`.

    The result is 1024 for infinity, and NaN for NaN.
    """
    bounded = magnitude(x, 2.0**ZERO)
    result = float(exponent(bounded)) + polynomial(mantissa(bounded), LOG2)
    return result if x == x else x


@procedure
def power(x: float) -> tuple[float, float]:
    """Return 2**x to two digits, and x rounded to an integer, with at most `LARGEST_STEP_EXPONENT` in place of x."""
    rounded = nearest(x)
    fraction = polynomial(x - rounded, EXP2)
    bounded = smaller(rounded, LARGEST_STEP_EXPONENT)
    return fraction * two_to(int(bounded)), bounded


@inline
def polynomial(x: float, coefficients: Sequence[float]) -> float:
    """Return the value at x of a polynomial with these coefficients, lowest power first."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = fma(total, x, coefficient)
    return total


@procedure(floors=floors_type, work=work_type)
def raise_floors(share: float, floors: Out, work: Out, *, layout: TaylorLayout) -> None:
    """Raise the floor (absolute tolerance) of each entry of the state to at least `share` times its size.

    The state is at the beginning of `work`.
    """
    for i in each(layout.padded, **layout.loop):
        floors[i] = max(floors[i], share * abs(work[i]))


@procedure(noinline=True, floors=floors_type, work=work_type)
def first_floors(share: float, floors: Out, work: Out, order: int, *, layout: TaylorLayout) -> bool:
    """Set the floors (absolute tolerances) of zero entries to `share` times their size in the series.

    The size of an entry is the largest of its first few coefficients, which are in `work` in powers of the time
    scale. Return True if the series of some entry begins too late to show a size.
    """
    rows = [row(work, k, layout) for k in unrolled(1, START_ROWS + 1)]
    late = [row(work, less(order, 1), layout), row(work, order, layout)]
    blind = 0.0
    for i in each(layout.padded, **layout.loop):
        before, zero = floors[i], work[i] == 0.0
        reach = share * largest([coefficients[i] for coefficients in rows])
        reach = reach if reach > 0.0 else before
        reach = reach if reach < math.inf else before
        reach = LEAST_FLOOR if reach < LEAST_FLOOR else reach
        floor = reach if zero else before
        floors[i] = floor
        last = largest([coefficients[i] for coefficients in late])
        blind = magnitude(blind, last if zero and floor <= LEAST_FLOOR else 0.0)
    return blind != 0.0


@inline
def forget_first_floors(floors: Out, work: In, layout: TaylorLayout) -> None:
    """Set the floor (absolute tolerance) of each zero entry to `LEAST_FLOOR`. The state is in `work`."""
    for i in each(layout.padded, **layout.loop):
        before = floors[i]
        floors[i] = LEAST_FLOOR if work[i] == 0.0 else before


@inline
def largest(values: Sequence[float]) -> float:
    """Return the largest magnitude of the values."""
    result = values[0]
    for value in values[1:]:
        result = magnitude(result, value)
    return result


@procedure(floors=floors_type, weights=weights_type, work=work_type)
def weigh(rtol: float, floors: In, weights: Out, work: Out, *, layout: TaylorLayout) -> None:
    """Write 1 / tolerance of each entry of the state to `weights`. The tolerance is rtol * size + floor.

    The size is the larger of the entry and its Taylor coefficient of order 1, in magnitude; both are in `work`. The
    `floors` are absolute tolerances.
    """
    first = row(work, 1, layout)
    for i in each(layout.padded, **layout.loop):
        weights[i] = 1.0 / fma(rtol, magnitude(work[i], first[i]), floors[i])


@inline
def ends(order: int, step: float) -> bool:
    """Return True if the last coefficients of a series are zero: the series terminates, or they underflow.

    `step` is the binary logarithm of the step that the series of this `order` allows; it is then very large.
    """
    return step > ZERO_BOUND * minus_one_over(order)


@procedure(floors=floors_type, weights=weights_type, work=work_type)
def choose_exponent(
    rtol: float, digits: float, floors: In, weights: In, work: Out, order: int, *, layout: TaylorLayout
) -> float:
    """Return the binary logarithm of the step that a series allows, in units of the time scale.

    `digits` is minus the binary logarithm of the relative tolerance, and `weights` are 1 / tolerance of each
    entry of the state. The coefficients are in `work`.
    """
    # The earlier rows come first: they are computed long before the last row.
    backwards = [
        logarithm(ratio(row(work, less(order, k), layout), weights, layout))
        for k in reversed(unrolled(ROW_DISTANCE + 2))
    ]
    sizes = list(reversed(backwards))
    least = guarded(sizes, 2, digits, order)
    for k in unrolled(3, ROWS_USED):
        least = lesser(least, guarded(sizes, k, digits, order))
    if not layout.crossing:
        first, second = radius(sizes, 1, order), radius(sizes, 0, order)
        least = lesser(least, (first if first > second else second) + RADIUS_FRACTION)
    # The row before the last also bounds the step, as if it were the last row.
    before = fma(
        sizes[1],
        minus_one_over(less(order, 1)),
        larger(fma(digits, minus_one_over(order) - minus_one_over(less(order, 1)), -GUARD), 0.0),
    )
    result = lesser(smaller(before, sizes[0] * minus_one_over(order)), least)
    if unlikely(ends(order, result)):
        result = bound_by_earlier_rows(rtol, floors, result, work, order, layout=layout)
    return result


@inline
def lesser(a: float, b: float) -> float:
    """Return the smaller of two numbers, the first if the second is NaN."""
    return b if b < a else a


@inline
def guarded(sizes: Sequence[float], distance: int, digits: float, order: int) -> float:
    """Return the bound of the step that an earlier row of Taylor coefficients gives, as a binary logarithm.

    The size of the row shows a radius of convergence r. The bound is r tolerance**(1/order), times 2**`GUARD` as a
    margin. It is infinite for rows below half of the `order`. `sizes` are the binary logarithms of the last rows'
    sizes, by the distance in orders from the last row, and `distance` is that of the earlier row. `digits` is minus
    the binary logarithm of the relative tolerance.
    """
    share = minus_one_over(less(order, distance))
    bound = fma(digits, minus_one_over(order) - share, sizes[distance] * share) + GUARD
    if 2 * distance > LOWEST_ORDER:
        bound = math.inf if order < 2 * distance else bound
    return bound


@inline
def radius(sizes: Sequence[float], distance: int, order: int) -> float:
    """Return the binary logarithm of the radius of convergence that two rows of coefficients show.

    The two rows are `ROW_DISTANCE` orders apart. `sizes` are the binary logarithms of the last rows' sizes, by
    their distance from the last row; the later of the two has this `distance`. The result is infinity if one of the
    two rows is zero.
    """
    early, late = sizes[distance + ROW_DISTANCE], sizes[distance]
    span = less(order, distance) - less(order, distance + ROW_DISTANCE)
    result = (early - late) * (1.0 / float(span))
    return math.inf if (early if early < late else late) < ZERO_BOUND else result


@procedure(noinline=True, floors=floors_type, work=work_type)
def bound_by_earlier_rows(
    rtol: float, floors: In, before: float, work: Out, order: int, *, layout: TaylorLayout
) -> float:
    """Return the bound of the step for a series whose last two rows of coefficients are zero.

    The bound follows from the other rows in the upper half of the orders. The bound is a binary logarithm, at most
    `before`. The last rows are zero if the series terminates, or in the gaps of a series in the fourth power of
    time.
    """
    weights = reals(layout.padded, room=layout.block)
    weigh(rtol, floors, weights, work, layout=layout)
    result = before
    for k in range(quotient(order, 2) + 1, order - 1):
        result = smaller(result, logarithm(ratio(row(work, k, layout), weights, layout)) * minus_one_over(k))
    return result


DEFECT, DEFECT_NOISE = 4.0, 2.0**-40
"""Bound of the defect: the derivative of the series at the end of a step minus the right-hand side there. The bound is
`DEFECT` tolerances per order, divided by the step, plus `DEFECT_NOISE` times the largest derivative. The truncation
error at order p has a derivative of p tolerances over the step. The largest defect in ten scenes at five tolerances was
1.1 times this derivative.
"""

RETRY_FRACTION, MOST_FAILURES = 0.25, 24
"""A rejected step is repeated at the fraction `RETRY_FRACTION` of its length, up to `MOST_FAILURES` times. Then the
step is at rounding level.
"""


@procedure(weights=weights_type, work=work_type)
def defect_is_small(length: float, order: int, first: int, weights: In, work: Out, *, layout: TaylorLayout) -> bool:
    """Return True if the defect of a step is small: two derivatives at its end agree.

    The first is the derivative of the step's series, stored in the work array. The second is that of the new series
    at the end, whose coefficients of order 1 begin at index `first` of the work array. `length` is the length of
    the step in units of the time scale, and `weights` are 1 / tolerance of each entry of the state.
    """
    begin = layout.moving
    rows, slopes = work[first:][begin:], work[layout.slope + begin :]
    off, most = 0.0, 0.0
    for i in each(layout.padded - begin, **layout.loop):
        weight, new_slope = weights[begin:][i], rows[i]
        off = magnitude(off, (new_slope - slopes[i]) * weight)
        most = magnitude(most, new_slope * weight)
    allowed = DEFECT * float(order) / length
    return off <= fma(DEFECT_NOISE, most, allowed)


@inline
def retries_exhausted(taylor: TaylorState) -> bool:
    """Return True if the retry limit is reached: a shorter step would be lost in rounding."""
    return taylor.failures >= MOST_FAILURES


@procedure(noinline=True)
def retry_shorter(counts: Counts, taylor: TaylorState, h: float) -> None:
    """Count a rejection of a step of length h, and bound the steps that follow by a fraction of h.

    The next step will be searched for events, even if bounds of the event functions exclude zeros.
    """
    taylor.limit = RETRY_FRACTION * abs(h)
    taylor.next_limit = math.inf
    taylor.failures += 1
    counts.rejected += 1
    taylor.inspect, taylor.rescalings = 1, 0


@procedure(noinline=True, work=work_type)
def reject_step(run: Run, counts: Counts, taylor: TaylorState, held: Held, work: Out, *, layout: TaylorLayout) -> None:
    """Undo the last step, and bound the length with which it is repeated.

    The state at its start and the rounding errors are copied back inside `work`. Its time and its unit of time
    come from `held`.
    """
    kept, size = work[layout.held :], 2 * layout.padded
    for i in each(size, width=layout.block, spill=True, disjoint=True):
        work[i] = kept[i]
    run.t, taylor.low, taylor.scale = held.t, held.low, held.scale
    held.unproven = 0
    retry_shorter(counts, taylor, held.h)


@procedure(rows=rows_type, work=work_type)
def record_step(
    run: Run,
    counts: Counts,
    taylor: TaylorState,
    held: Held,
    outputs: OutputCounts,
    work: Out,
    times: Out,
    rows: Out,
    *,
    layout: TaylorLayout,
) -> None:
    """Count a step that passed the defect test, and write its end to `times` and `rows` if rows are recorded.

    After rejections the next step is at most twice as long.
    """
    length, limit, is_exhausted = abs(held.h), taylor.limit, retries_exhausted(taylor)
    limit = length if taylor.failures > 0 and not is_exhausted else limit
    taylor.limit = limit + limit
    taylor.failures = 0
    held.unproven = 0
    counts.steps += 1
    outputs.done = outputs.ahead
    if counts.record != 0:
        row = counts.rows
        times[row] = run.t
        target = rows[row * layout.dimension :]
        for i in each(layout.dimension, width=layout.block, unrolled=layout.chains):
            target[i] = work[i]
        counts.rows = row + 1


@procedure(noinline=True, jet=lambda: JET, floors=floors_type, work=work_type)
def defect_along_step(
    jet: Callable[..., Any],
    prepared: In,
    constants: In,
    rtol: float,
    floors: In,
    t: float,
    scale: float,
    s: float,
    work: Out,
    order: int,
    *,
    layout: TaylorLayout,
) -> bool:
    """Return True if a series satisfies the equations within tolerance at some points along a step.

    The step begins at time t, and has the length s in units of the time `scale`. The coefficients, up to
    `order`, are in the work array. `jet` is the function that computes a series at a state from the arrays
    `prepared` and `constants`. `floors` are the absolute tolerances of the entries of the state.
    """
    weights = reals(layout.padded, room=layout.block)
    weigh(rtol, floors, weights, work, layout=layout)
    begin = layout.ahead(order)
    probe, slopes = work[begin:], work[layout.slope :]
    for j in range(1, PROBES):
        part = s * (float(j) * (1.0 / PROBES))
        for i in each(layout.padded, **layout.loop):
            total, slope = horner(work, order, part, i, layout)
            probe[i] = work[i] + total
            slopes[i] = slope
        is_singular = jet(fma(part, scale, t), scale, probe, prepared, constants, probe[layout.rows :], order)
        first = begin + (layout.rows + layout.width)
        if is_singular or not defect_is_small(s, order, first, weights, work, layout=layout):
            return False
    return True


VERIFIED_HALVINGS = 60
"""Largest number of halvings of a step until the series of the watched functions agree with the functions."""


@procedure(
    noinline=True,
    function=lambda: FUNCTION,
    end_values=work_type,
    end_noise=work_type,
    state=work_type,
    moved=work_type,
    work=work_type,
)
def verified_step(
    function: Callable[..., bool],
    numbers: In,
    tilts: In,
    t: float,
    scale: float,
    rtol: float,
    s: float,
    noise: In,
    end_values: Out,
    end_noise: Out,
    state: Out,
    moved: Out,
    sizes: Sizes,
    work: Out,
    order: int,
) -> tuple[float, int]:
    """Halve a step of length s until the series of all watched functions agree with the functions at its end.

    `function` evaluates the watched functions from a time, a state and `numbers`. A series and its function agree
    if they differ by at most the tolerance `rtol`, relative to the largest term, or the rounding errors of the
    functions: `noise` at the start and `end_noise` at the end. `tilts` are factors near 1 that perturb the entries
    of a state. `end_values`, `end_noise`, `state` and `moved` are work memory. Return the new length, and the index
    of the first function that disagreed on the last step that was halved, or -1. Example: at x = 0 the series of
    x**40 is zero up to order 39, and does not show that the function rises.
    """
    layout = layout_of(sizes)
    again, halvings, limiting = True, 0, -1
    while again and halvings < VERIFIED_HALVINGS:
        end = t + s * scale
        state_on_step(s, state, sizes, work, order)
        if function(end, state, numbers, end_values):
            return s, limiting
        wrong = disagreeing(s, rtol, noise, None, end_values, work, order, layout)
        if wrong >= 0:
            # Rounding of the state at the end may cause the difference.
            event_noise(
                function, numbers, tilts, end, layout.dimension, layout.watched, state, end_values, end_noise, moved
            )
            wrong = disagreeing(s, rtol, noise, end_noise, end_values, work, order, layout)
        again = wrong >= 0
        limiting = wrong if again else limiting
        s = s * 0.5 if again else s
        halvings += 1
    return s, limiting


@inline
def disagreeing(
    s: float, rtol: float, noise: In, end_noise: In | None, end_values: In, work: Out, order: int, layout: Any
) -> int:
    """Return the index of the first watched function that its series does not reproduce at the end of a step.

    The result is -1 without such a function. `s` is the length of the step. `end_values` are the functions at its
    end. `noise` and `end_noise` are their rounding errors at the start and at the end; `end_noise` is None if
    unknown.
    """
    tolerance, wrong = larger(rtol, 2.0**-52), -1
    first = row(work, 0, layout)[layout.watched_at :]
    for i in range(layout.watched):
        total, most, power = 0.0, 0.0, 1.0
        for k in range(order + 1):
            term = first[i:][k * layout.width] * power
            total, most = total + term, magnitude(most, term)
            power *= s
        total_noise = noise[i] if end_noise is None else noise[i] + end_noise[i]
        allowed = EVENT_SLACK * fma(tolerance, most, total_noise)
        is_off = not abs(total - end_values[i]) <= allowed
        wrong = i if is_off and wrong < 0 else wrong
    return wrong
