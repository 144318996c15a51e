"""The size of a Taylor step from its last rows.

The truncation error of a series of order p, relative to its tolerance, is about the size of its last rows: the step
keeps both below one. The growth of the rows gives the radius of convergence.
Source: A. Jorba, M. Zou, A software package for the numerical integration of ODEs by means of high-order Taylor
methods, Experimental Mathematics 14 (2005), 99-117.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import Any

from lagrange.algorithm.step.constants import LEAST_FLOOR
from lagrange.algorithm.step.error_norm import higher
from lagrange.algorithm.taylor.constants import (
    GUARD,
    LARGEST_STEP_EXPONENT,
    LOWEST_ORDER,
    RADIUS_FRACTION,
    ROW_DISTANCE,
    ROWS_USED,
    START_ROWS,
    ZERO,
    ZERO_BOUND,
)
from lagrange.algorithm.taylor.memory import (
    SeriesMemory,
    TaylorLayout,
    entries,
    floors_array,
    weights_array,
    work_array,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Real

LOG2 = (-1.6531240060861732, 1.9941811995403236, -0.33474901889029146)
EXP2 = (1.0, 0.703601177393781, 0.24203533019053836)
"""Polynomials for the binary logarithm on [1, 2], good to 0.007, and the power of two on [-1/2, 1/2], good to 0.002. A
step size needs only two digits, and the C library's functions would take a tenth of a small step."""


@shared
def logarithm() -> Procedure:
    """Return the binary logarithm of a nonnegative number, at least `ZERO`; that of infinity is 1024."""
    p = Builder("logarithm", "Return the binary logarithm, to two digits; NaN for NaN.")
    x: Real = p.given("x", REAL)
    bounded = p.magnitude(x, 2.0**ZERO)
    exponent = p.real(p.operation("exponent", bounded))
    found = exponent + _polynomial(p, p.operation("mantissa", bounded), LOG2)
    p.leave(p.choose(x.equals(x), found, x))
    return p.finish(REAL)


@shared
def power() -> Procedure:
    """Return a power of two, and its exponent rounded to a whole number, both at most 2**`LARGEST_STEP_EXPONENT`."""
    p = Builder("power", "Return 2**x to two digits, and the whole number next to x, bounded above.")
    x: Real = p.given("x", REAL)
    whole = p.operation("round", x)
    fraction = _polynomial(p, x - whole, EXP2)
    bounded = p.smaller(whole, LARGEST_STEP_EXPONENT)
    p.leave(fraction * p.operation("two_to", p.whole(bounded)), bounded)
    return p.finish(REAL, REAL)


def _polynomial(p: Builder, x: Real, coefficients: Sequence[float]) -> Real:
    """Return a polynomial's value, by Horner's rule."""
    total = p.real(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = p.fma(total, x, coefficient)
    return total


@shared
def raise_floors(layout: TaylorLayout) -> Procedure:
    """Return the procedure that raises the floors to their share of the state."""
    p = Builder("raise_floors", "Raise the floor of each entry to a share of its size.")
    share, floors, work = p.given("share", REAL), floors_array(p, layout, read=False), work_array(p)
    with entries(p, layout) as i:
        floors[i] = higher(p, share * abs(work[i]), floors[i])
    return p.finish()


@shared
def first_floors(layout: TaylorLayout) -> Procedure:
    """Return the procedure that sets the floors of entries that are zero, to the sum of their series over the scale.

    It returns whether the series of some entry begins too late to show a size.
    """
    p = Builder("first_floors", "Begin floors of entries that are zero; return if some begin too late.", apart=True)
    share, floors = p.given("share", REAL), floors_array(p, layout, read=False)
    run = SeriesMemory(p, layout, work_array(p))
    rows = [run.row(k) for k in range(1, START_ROWS + 1)]
    late = [run.row(run.less(less)) for less in (1, 0)]

    def largest(values: list[Any]) -> Any:
        return reduce(p.magnitude, values)

    with entries(p, layout) as i:
        before, zero = floors[i], run.work[i].equals(0.0)
        reach = share * largest([row[i] for row in rows])
        reach = p.choose(reach > 0.0, reach, before)
        reach = p.choose(reach < math.inf, reach, before)
        reach = p.choose(reach < LEAST_FLOOR, LEAST_FLOOR, reach)
        floor = p.choose(zero, reach, before)
        floors[i] = floor
        last = p.choose(floor <= LEAST_FLOOR, largest([row[i] for row in late]), 0.0)
        blind = p.largest_magnitude(p.choose(zero, last, 0.0))
    p.leave(~blind.value.equals(0.0))
    return p.finish(FLAG)


@shared
def weigh(layout: TaylorLayout) -> Procedure:
    """Return the procedure that writes the weights, the reciprocals of the tolerances."""
    p = Builder("weigh", "Write one over the tolerance of each entry: of its size in the step, and its floor.")
    rtol, floors = p.given("rtol", REAL), floors_array(p, layout, read=True)
    weights, work = weights_array(p, layout, read=False), work_array(p)
    first = work.at(layout.rows + layout.width)
    with entries(p, layout) as i:
        weights[i] = 1.0 / p.fma(rtol, p.magnitude(work[i], first[i]), floors[i])
    return p.finish()


def ends(run: SeriesMemory, exponent: Real) -> Flag:
    """Return whether the last coefficients of a series are zero: it terminates, or they underflow."""
    found: Flag = exponent > ZERO_BOUND * run.minus_one_over(run.order)
    return found


@shared
def choose_exponent(layout: TaylorLayout) -> Procedure:
    """Return the procedure for the binary logarithm of the step in units of the scale."""
    return _Exponent(layout).build()


class _Exponent:
    """Builds the procedure; `sizes` are the binary logarithms of the last rows, by their distance from the last."""

    def __init__(self, layout: TaylorLayout) -> None:
        self.p = p = Builder("choose_exponent", "Return the binary logarithm of the step in units of the scale.")
        self.layout = layout
        self.rtol, self.digits = p.given("rtol", REAL), p.given("digits", REAL)
        self.floors = floors_array(p, layout)
        self.weights = weights_array(p, layout)
        self.run = SeriesMemory(p, layout, work_array(p))
        self.sizes: dict[int, Real] = {}

    def build(self) -> Procedure:
        p, run = self.p, self.run
        # The earlier rows come first: they are computed long before the last.
        for less in range(ROW_DISTANCE + 1, -1, -1):
            size = p.call(logarithm(), run.ratio(run.less(less), self.weights))
            self.sizes[less] = size.called(f"size_{less}")
        least = reduce(self.lesser, [self.guarded(less) for less in range(2, ROWS_USED)])
        if not self.layout.crossing:
            one, other = (self.radius(less) for less in (1, 0))
            least = self.lesser(least, p.choose(one > other, one, other) + RADIUS_FRACTION)
        before = p.fma(self.sizes[1], run.minus_one_over(run.less(1)), self.leeway())
        bound = p.smaller(before, self.sizes[0] * run.minus_one_over(run.order))
        found = p.variable(self.lesser(bound, least), "found")
        with p.when(ends(run, found.value), likely=False):
            given = self.rtol, self.floors, found.value
            found.value = p.call(bound_by_earlier_rows(self.layout), *given, *run.handed)
        p.leave(found.value)
        return p.finish(REAL)

    def lesser(self, a: Real, b: Real) -> Any:
        """Return the lesser of two, the first if the second is NaN."""
        return self.p.choose(b < a, b, a)

    def leeway(self) -> Real:
        """Return the allowed excess of the row before the last over its bound, up to its radius at the last order.

        It is reduced by GUARD, and zero if the order suits the tolerance.
        """
        run, p = self.run, self.p
        apart = run.minus_one_over(run.order) - run.minus_one_over(run.less(1))
        found: Real = p.larger(p.fma(self.digits, apart, -GUARD), 0.0)
        return found

    def guarded(self, less: int) -> Real:
        """Return the bound of the step from an earlier row: its radius, at the last order; see `GUARD`.

        It is infinite for rows below half of the order.
        """
        run, p = self.run, self.p
        share = run.minus_one_over(run.less(less))
        apart = run.minus_one_over(run.order) - share
        bound = p.fma(self.digits, apart, self.sizes[less] * share) + GUARD
        found: Real = p.choose(run.order < 2 * less, math.inf, bound) if 2 * less > LOWEST_ORDER else bound
        return found

    def radius(self, less: int) -> Real:
        """Return the binary logarithm of the radius of convergence from two rows; infinity if one is zero."""
        p, run = self.p, self.run
        early, late = self.sizes[less + ROW_DISTANCE], self.sizes[less]
        span = run.less(less) - run.less(less + ROW_DISTANCE)
        share = 1.0 / p.real(span)
        none = p.choose(early < late, early, late) < ZERO_BOUND
        found: Real = p.choose(none, math.inf, (early - late) * share)
        return found


@shared
def bound_by_earlier_rows(layout: TaylorLayout) -> Procedure:
    """Return the bound of the step by the upper half of the other rows, if the last two rows are zero.

    They are zero if the series terminates, or in the gaps of a series in the fourth power of time.
    """
    p = Builder(
        "bound_by_earlier_rows", "Return the step that the upper half of all rows but the last allow.", apart=True
    )
    rtol, floors, before = p.given("rtol", REAL), floors_array(p, layout), p.given("before", REAL)
    run = SeriesMemory(p, layout, work_array(p))
    weights = p.reserve(layout.padded, room=layout.block, name="weights")
    p.call(weigh(layout), rtol, floors, weights, run.work)
    found = p.variable(before, "found")
    with p.loop(run.order // 2 + 1, run.order - 1) as k:
        bound = p.call(logarithm(), run.ratio(k, weights)) * run.minus_one_over(k)
        found.value = p.smaller(found.value, bound)
    p.leave(found.value)
    return p.finish(REAL)
