"""Reductions along the run of a member: extremes and means of expressions over time, and states at output times.

On each step an expression is evaluated at nine points of the dense output, including both ends. Its integral is
computed by Gauss-Lobatto's rule, which is exact for polynomials of degree 15. A maximum between points that may exceed
all earlier values is searched for, by Brent's method without derivatives. So extrema are found if nine points of a step
show them.

The step of a Taylor series is sampled while its series is in memory, and counts when the step is accepted.

In this module `numbers` are the parameters and all values that depend only on them.

Source: R. P. Brent, Algorithms for Minimization without Derivatives, 1973, chapter 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.dense.block import BlockSteps, StepPolynomial, block_size, steps_in
from lagrange.algorithm.projection import compensated
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.sums import outstanding, powers_of, series_sum
from lagrange.procedure.form import READ, REAL, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, fma, generated, larger, magnitude, reals, unlikely, unrolled
from lagrange.procedure.rewrite import bound

PATH = Callee((REAL, REAL, READ, Array(), WHOLE), ())
"""Type of a callback that writes the state at a fraction of a step, or some entries of the state. Arguments: the
fraction, the length of the step in the unit of the polynomial, the coefficients, the state, and the degree.
"""


@procedure
def polynomial_path(
    fraction: float, ratio: float, c: In, out: Out, degree: int, *, entries: tuple[int, ...], dimension: int
) -> None:
    """Write the state at a fraction of a step to `out`, computed by polynomials in time.

    Only the entries with the indices `entries` are written. `ratio` is the length of the step in the unit of
    the polynomials. The coefficient of power k and entry j is at index k * dimension + j of c. The type of the
    procedure is `PATH`.
    """
    theta = fraction * ratio
    totals = tuple(c[degree * dimension + j] for j in entries)
    for k in range(degree):
        line = c[(degree - 1 - k) * dimension :]
        totals = tuple(fma(total, theta, line[j]) for total, j in zip(totals, entries, strict=True))
    for total, j in zip(totals, entries, strict=True):
        out[j] = total


@procedure
def series_path(
    fraction: float, ratio: float, work: In, out: Out, order: int, *, layout: TaylorLayout, entries: tuple[int, ...]
) -> None:
    """Write the state at a fraction of the last step to `out`, computed by the Taylor series of this step.

    Only the entries with the indices `entries` are written. `ratio` is the length of the step in units of the
    time scale. The work array has the state before the step and the rows of the series, in a `layout`. The type
    of the procedure is `PATH`.
    """
    before, lost = work[layout.held :], work[layout.held + layout.padded :]
    powers = powers_of(fraction * ratio)
    for j in entries:
        out[j] = before[j] + (series_sum(work, order, powers, j, layout) + lost[j])


@procedure(path=lambda: PATH)
def states_on_step(
    path: Callable[..., None],
    t: float,
    end: float,
    sign: float,
    times: In,
    memory: In,
    states: Out,
    dimension: int,
    degree: int,
    done: int,
) -> int:
    """Write the states at the output times on a step from t to `end`. Return the number of times done so far.

    `times` are all output times, of which `done` were done before the step, and row i of `states` is the state
    at time i. `path` writes the state at a fraction of the step, from the coefficients in `memory` and the
    `degree`. `sign` is the direction of the run, 1.0 or -1.0. A time at the end belongs to the next step.
    """
    h, index = end - t, done
    while outstanding(times, index, end, sign):
        path((times[index] - t) / h, 1.0, memory, states[index * dimension :], degree)
        index += 1
    return index


@dataclass(frozen=True)
class MemberDenseOutput:
    """Dense output of members' steps: the kind of polynomial, and the right-hand side as a procedure."""

    kind: StepPolynomial
    law: Procedure

    @cached_property
    def column(self) -> Procedure:
        """The right-hand side as a procedure that evaluates it for one column, that is for one state."""
        return law_of_column.form(law=self.law)


@dataclass(frozen=True)
class PathMemory:
    """Memory of the polynomial of a step: the step, work memory, and the coefficients `c`."""

    step: BlockSteps
    work: Out
    c: Out


@dataclass(frozen=True, eq=False)
class MemberStepPath:
    """Dense output on one step of a member: the kind of polynomial, and the procedure that writes its coefficients.

    The right-hand side is built into the procedure. `dimension` is the length of a state.
    """

    kind: StepPolynomial
    procedure: Procedure
    dimension: int

    @classmethod
    def of(cls, kind: StepPolynomial, law: Procedure, dimension: int, prefix: str) -> MemberStepPath:
        """Return the dense output for the right-hand side `law`; `prefix` is part of its procedures' names."""
        return cls(kind, bound(kind.procedure, {"law": law}, prefix=prefix), dimension)

    @property
    def size(self) -> int:
        """Number of doubles of work memory for the polynomial of a step."""
        return self.kind.size(self.dimension, 1)

    @inline
    def write(self, tables: tuple[In, In], columns: int, step_data: In, neighbours: In, work: Out, out: Out) -> None:
        """Write the coefficients of the polynomials of a block of steps to `out`, by powers.

        `tables` are two arrays: the parameters with all values that depend only on them, and the coefficients of the
        method. `step_data` and `neighbours` have the data of the steps and of their neighbours, by `columns` as in
        `BlockSteps`.
        """
        numbers, table = tables
        settings = "parameters", "table", "stages", "degree", "dimension", "columns"
        names = (*settings, "step_data", "neighbours", "work", "out")
        layout = self.kind.stages, self.kind.degree, self.dimension, columns
        arguments = dict(zip(names, (numbers, table, *layout, step_data, neighbours, work, out), strict=True))
        generated(self.procedure, *[arguments[parameter.name] for parameter in self.procedure.parameters])

    @inline
    def memory(self) -> PathMemory:
        """Return memory for the polynomial of a step."""
        step_memory = reals(block_size(self.dimension, 1), room=WIDEST_VECTOR)
        work = reals(self.size, room=WIDEST_VECTOR)
        c = reals((self.kind.degree + 1) * self.dimension, room=WIDEST_VECTOR)
        return PathMemory(steps_in(step_memory, self.dimension, 1), work, c)

    @inline
    def find(self, memory: PathMemory, table: In, numbers: In) -> None:
        """Write the coefficients of the polynomial of the step `memory.step` to `memory.c`.

        `table` has the coefficients of the method.
        """
        step_memory = memory.step.memory
        self.write((numbers, table), 1, step_memory, step_memory, memory.work, memory.c)


@procedure
def law_of_column(_columns: int, t: In, q: In, _v: In, numbers: In, out: Out, *, law: Procedure) -> int:
    """Write the right-hand side `law` at one state to `out`. Return 0 if a matrix is singular, else -1.

    The arguments are those of a function of several columns, for one column. t has the time, and q the whole state
    [q, v]. `_v` is not used.
    """
    return int(generated(law, t[0], q, numbers, out)) - 1


VALUE = Callee((REAL, REAL, REAL, REAL, WHOLE, READ, READ, WHOLE), (REAL,))
"""Type of a callback that returns the value of an expression at a fraction of a step. Arguments: the fraction, then the
fields of `ExpressionOnStep`, without the callback itself.
"""

RESOLUTION = 2.0**-27
"""Least distance of two points in the search for a maximum, as a fraction of the step. The value at the maximum is then
exact to round-off.
"""

MOST_EVALUATIONS = 60
"""Largest number of evaluations in a search for a maximum. About 8 suffice if the expression has a third derivative,
and 40 if it has no second derivative.
"""

GOLDEN = 0.3819660112501051
"""The smaller part of the golden section, (3 - sqrt(5)) / 2."""


@dataclass(frozen=True)
class ExpressionOnStep:
    """An expression along a step that begins at time t and has the length h.

    The polynomial of the step has `coefficients` and a `degree`; `ratio` is the length of the step in the unit of
    time of the polynomial. `place` is the index of the expression, and `value` the callback that computes it from
    `numbers`.
    """

    value: Callable[..., Any]
    t: float
    h: float
    ratio: float
    place: int
    coefficients: In
    numbers: In
    degree: int

    @inline
    def at(self, fraction: float) -> float:
        """Return the value of the expression at a fraction of the step."""
        step = self.t, self.h, self.ratio, self.place
        value: float = self.value(fraction, *step, self.coefficients, self.numbers, self.degree)
        return value


def expression_type() -> Bundle:
    """Return the type of a procedure's parameter of the class `ExpressionOnStep`."""
    return Bundle(ExpressionOnStep, {"value": VALUE})


@procedure(step=expression_type)
def largest_between(
    step: ExpressionOnStep,
    sign: float,
    low: float,
    middle: float,
    high: float,
    low_value: float,
    middle_value: float,
    high_value: float,
    best: float,
) -> float:
    """Return the largest value of `sign` times an expression between two fractions of a step, or `best`.

    `best` is returned if it is larger. The search is Brent's method without derivatives, between the fractions
    `low` and `high`. `low_value`, `middle_value` and `high_value` are values of the expression. `sign` times the
    expression is largest at `middle`. The next point is the vertex of the parabola through the three best points,
    or the point of the golden section.
    """
    low_is_better = low_value * sign > high_value * sign
    x, fx = middle, middle_value * sign
    w, fw = low if low_is_better else high, (low_value if low_is_better else high_value) * sign
    v, fv = high if low_is_better else low, (high_value if low_is_better else low_value) * sign
    before = moved = high - low
    tried = 0
    while tried < MOST_EVALUATIONS and abs(x - (low + high) * 0.5) > 2.0 * RESOLUTION - (high - low) * 0.5:
        r, q = (x - w) * (fv - fx), (x - v) * (fw - fx)
        upper, lower = (x - v) * q - (x - w) * r, 2.0 * (q - r)
        top, below = -upper if lower > 0.0 else upper, abs(lower)
        is_left = x < (low + high) * 0.5
        rest = high - x if is_left else low - x
        fits = abs(top) < abs(below * before * 0.5) and abs(before) > RESOLUTION
        fits = fits and top > below * (low - x) and top < below * (high - x)
        shift = top / below if fits else rest * GOLDEN
        is_close = x + shift - low < 2.0 * RESOLUTION or high - (x + shift) < 2.0 * RESOLUTION
        towards = RESOLUTION if is_left else -RESOLUTION
        shift = towards if fits and is_close else shift
        before, moved = moved if fits else rest, shift
        least = RESOLUTION if shift > 0.0 else -RESOLUTION
        u = x + (least if abs(shift) < RESOLUTION else shift)
        fu = step.at(u) * sign
        if fu >= fx:
            low, high = x if x < u else low, high if x < u else x
            v, fv, w, fw, x, fx = w, fw, x, fx, u, fu
        else:
            low, high = u if u < x else low, high if u < x else u
            if fu >= fw or w == x:
                v, fv, w, fw = w, fw, u, fu
            elif fu >= fv or v in (x, w):
                v, fv = u, fu
        tried += 1
    return fx if fx > best else best


SAMPLE_POINTS = 9
"""Number of sample points on a step. The radius of convergence of a Taylor series is e**2 times its step. The
quadrature rule then has an error of 1e-22 of the expression's variation, and of 1e-11 if the radius is only twice the
step.
"""

RISE = 2.0**-50
"""Round-off of an expression's values, as a fraction of the largest value so far. A maximum is searched for if it may
exceed that value by more.
"""

END_SLOPE_AT = 2.0**-20
"""Fraction of the step at which the slope of an expression at an end of the step is tested."""

SIGNS = {"max": 1.0, "min": -1.0}
"""Factors by which an expression is multiplied, so that its largest value is searched for: -1 turns the least value
into the largest.
"""


@cache
def lobatto() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points of Gauss-Lobatto's rule on [0, 1] and their weights, symmetric to the last bit."""
    highest = Legendre.basis(SAMPLE_POINTS - 1)
    slope = highest.deriv()
    x = np.sort(slope.roots().real)
    x = x - slope(x) / slope.deriv()(x)
    x = np.concatenate([[-1.0], (x - x[::-1]) / 2.0, [1.0]])
    weights = 2.0 / (SAMPLE_POINTS * (SAMPLE_POINTS - 1) * highest(x) ** 2)
    return (1.0 + x) / 2.0, (weights + weights[::-1]) / 4.0


@dataclass(frozen=True)
class Sampled:
    """Expressions that are followed along a run, and their reductions: largest or least values, or means.

    There are `size` expressions, which read only the `entries` (indices) of the state. The procedure `kernel`
    evaluates them from time, state, and the parameters with all values that depend only on them. `reductions`
    are pairs of "max", "min" or "mean" and the index of an expression.
    """

    kernel: Procedure
    size: int
    entries: tuple[int, ...]
    reductions: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class SampledStep:
    """A step of a member: its start and end times and length, and its length in the unit of its polynomial.

    `memory` has the coefficients of the polynomial, and `degree` its degree; `y` is the state at the end.
    """

    t: float
    end: float
    h: float
    ratio: float
    memory: In
    y: In
    degree: int


@dataclass(frozen=True)
class Reduced:
    """Memory for the reductions of a member's expressions along its run: extreme values and means.

    `now` and `ahead` are the values of the expressions at the start and end of the step. For each reduction
    there is the result so far in `best`: an integral for a mean, and a least value times -1. `tried` is the
    extreme value with this step, or the integral over this step. `lost` is the rounding error of an integral's
    sum.
    """

    now: Out
    ahead: Out
    best: Out
    tried: Out
    lost: Out


@dataclass(frozen=True, eq=False)
class RunReductions:
    """The reductions of a member's expressions along its run: largest and least values, and means.

    The procedure `path`, of type `PATH`, is the dense output of its steps.
    """

    sampled: Sampled
    path: Procedure
    dimension: int

    @property
    def count(self) -> int:
        """Number of reductions, which are largest and least values and means."""
        return len(self.sampled.reductions)

    @inline
    def memory(self) -> Reduced:
        """Return memory for the values of the expressions and of their reductions."""
        size, count = self.sampled.size, len(self.sampled.reductions)
        return Reduced(reals(size), reals(size), reals(count), reals(count), reals(count))

    @inline
    def begin(self, reduced: Reduced, t: float, y: In, numbers: In) -> None:
        """Initialize the reductions at the start of a run, at time t and state y."""
        is_singular = generated(self.sampled.kernel, t, y, numbers, reduced.now)
        for index in unrolled(self.sampled.size):
            value = reduced.now[index]
            reduced.now[index] = math.nan if is_singular else value
        for k, (how, index) in enumerate(self.sampled.reductions):
            value = reduced.now[index]
            signed = value * SIGNS.get(how, 1.0)
            reduced.best[k] = 0.0 if how == "mean" else signed if value == value else -math.inf
            reduced.lost[k] = 0.0

    @inline
    def follow(self, reduced: Reduced, step: SampledStep, numbers: In, points: In) -> None:
        """Write the reductions with a sampled `step` to `reduced.tried`. They count once `accept` is called.

        `points` are the sample points on a step, as fractions, followed by their weights.
        """
        follow_step(step, numbers, points, reduced, sampled=self.sampled, path=self.path, dimension=self.dimension)

    @inline
    def accept(self, reduced: Reduced) -> None:
        """Include the results of an accepted step, in `reduced.tried`, in the reductions of the run so far."""
        for index in unrolled(self.sampled.size):
            reduced.now[index] = reduced.ahead[index]
        for k, (how, _) in enumerate(self.sampled.reductions):
            if how == "mean":
                reduced.best[k], reduced.lost[k] = compensated(reduced.best[k], reduced.tried[k] + reduced.lost[k])
            else:
                reduced.best[k] = reduced.tried[k]

    @inline
    def write(self, reduced: Reduced, duration: float, to: Out) -> None:
        """Write the results of all reductions of a run to `to`. Integrals are divided by the `duration`."""
        for k, (how, index) in enumerate(self.sampled.reductions):
            value = reduced.best[k]
            if how == "mean":
                now = reduced.now[index]
                to[k] = now if duration == 0.0 else value / (1.0 if duration == 0.0 else duration)
            else:
                to[k] = math.nan if value == -math.inf else value * SIGNS[how]


@procedure
def follow_step(
    step: SampledStep, numbers: In, points: In, reduced: Reduced, *, sampled: Sampled, path: Procedure, dimension: int
) -> None:
    """Sample expressions on a `step`, and write the results of their reductions with this step to `reduced`.

    `reduced.tried` gets the integral over the step, or the extreme value so far; `reduced.ahead` gets the expressions
    at the end of the step. `points` has the points of Gauss-Lobatto's rule, followed by the weights.
    """
    t, h, degree, size = step.t, step.h, step.degree, sampled.size
    samples, state, results = reals(SAMPLE_POINTS * size), reals(dimension), reals(size)
    for j in range(1, SAMPLE_POINTS - 1):
        generated(path, points[j], step.ratio, step.memory, state, degree)
        is_singular = generated(sampled.kernel, fma(h, points[j], t), state, numbers, results)
        for index in unrolled(size):
            samples[j + index * SAMPLE_POINTS] = math.nan if is_singular else results[index]
    ends_singular = generated(sampled.kernel, step.end, step.y, numbers, results)
    for index in unrolled(size):
        reduced.ahead[index] = math.nan if ends_singular else results[index]
        samples[index * SAMPLE_POINTS] = reduced.now[index]
        samples[index * SAMPLE_POINTS + SAMPLE_POINTS - 1] = reduced.ahead[index]
    for k, (how, index) in enumerate(sampled.reductions):
        values = samples[index * SAMPLE_POINTS :]
        if how == "mean":
            reduced.tried[k] = h * integral(values, points[SAMPLE_POINTS:])
        else:
            search = search_on_step(sampled, path, dimension)
            along = t, h, step.ratio, index, step.memory, numbers, degree
            reduced.tried[k] = generated(search, *along, SIGNS[how], reduced.best[k], values, points)


@inline
def integral(samples: In, weights: In) -> float:
    """Return the mean of an expression over a step, by a quadrature rule on [0, 1].

    `samples` are values of the expression at the points of the rule, and `weights` are the weights.
    """
    total = samples[0] * weights[0]
    for j in unrolled(SAMPLE_POINTS - 1):
        total = fma(samples[j + 1], weights[j + 1], total)
    return total


@cache
def search_on_step(sampled: Sampled, path: Procedure, dimension: int) -> Procedure:
    """Return the procedure `raised`, which finds an extreme value on a step, for the `sampled` expressions.

    `path` is the dense output of the step.
    """
    value = value_on_step.form(sampled=sampled, path=path, dimension=dimension)
    return bound(raised.form(), {"value": value}, prefix="step_")


@procedure
def value_on_step(
    fraction: float,
    t: float,
    h: float,
    ratio: float,
    index: int,
    coefficients: In,
    numbers: In,
    degree: int,
    *,
    sampled: Sampled,
    path: Procedure,
    dimension: int,
) -> float:
    """Return the value of one of the `sampled` expressions at a fraction of a step.

    `index` is the index of the expression. The step begins at t and has the length h, and the length `ratio` in the
    unit of its polynomial, which has `coefficients` and a `degree`. The type of the procedure is `VALUE`.
    """
    state, results = reals(dimension), reals(sampled.size)
    generated(path, fraction, ratio, coefficients, state, degree)
    is_singular = generated(sampled.kernel, fma(h, fraction, t), state, numbers, results)
    return math.nan if is_singular else results[index]


@procedure(step=expression_type)
def raised(step: ExpressionOnStep, sign: float, before: float, samples: In, points: In) -> float:
    """Return the largest value of `sign` times an expression on a step, or `before` if `before` is larger.

    `samples` are values of the expression at the `points`. A maximum is searched for near each point whose value is
    not less than at its neighbours. It is also searched for between an end of the step and the next point, if the
    expression rises from the end but is not larger at the next point. This test takes one more value.
    """
    best = before
    for j in range(SAMPLE_POINTS):
        sample = samples[j] * sign
        best = sample if sample > best else best
    for j in range(1, SAMPLE_POINTS - 1):
        a, b, c = samples[j - 1] * sign, samples[j] * sign, samples[j + 1] * sign
        is_inner = b >= a and b >= c
        is_first, is_last = j == 1 and a > b, j == SAMPLE_POINTS - 2 and c > b
        left, right = points[j] - points[j - 1], points[j + 1] - points[j]
        # Assume that the slope of an expression is at most twice the slope between neighbouring points. A parabola
        # and |x| satisfy this.
        steep = magnitude((b - a) / left, (c - b) / right) * 2.0
        highest = larger(a + b + steep * left, b + c + steep * right) * 0.5
        if unlikely((is_inner or is_first or is_last) and highest - best > RISE * abs(best)):
            begin = j - 1 if is_inner or is_first else j
            end = j + 1 if is_inner else begin + 1
            middle, value = points[j], samples[j]
            if not is_inner:
                middle = END_SLOPE_AT if is_first else 1.0 - END_SLOPE_AT
                value = step.at(middle)
            low, high = samples[begin], samples[end]
            if value * sign >= low * sign and value * sign >= high * sign:
                best = largest_between(step, sign, points[begin], middle, points[end], low, value, high, best)
    return best
