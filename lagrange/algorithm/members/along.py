"""Expressions along the run of a member: largest and least values, and means over time.

On each step an expression is evaluated at nine points of the dense output, including both ends. Its integral is that of
Gauss-Lobatto's rule, which is exact for polynomials of degree 15. A maximum between points that may exceed all earlier
values is searched for. So extrema are found if nine points of a step show them.

The step of a Taylor series is sampled while its series is in memory, and counts when it is accepted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray

from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.members.extremum import ExpressionOnStep, expression_type, largest_between
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, fma, generated, larger, magnitude, reals, unlikely, unrolled
from lagrange.procedure.rewrite import bound
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Real, Whole

SAMPLE_POINTS = 9
"""Number of sample points on a step.

The radius of a Taylor series is e**2 times its step: the rule then has an error of 1e-22 of the expression's variation,
and of 1e-11 if the radius is only twice the step.
"""

RISE = 2.0**-50
"""A maximum is searched for if it may exceed the largest value so far by more than this fraction (round-off)."""

END_SLOPE_AT = 2.0**-20
"""Fraction of the step at which the slope of an expression at an end of the step is tested."""

SIGNS = {"max": 1.0, "min": -1.0}
"""Factors that turn a search for the least value into one for the largest."""


@shared
def lobatto() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points of Gauss-Lobatto's rule on [0, 1] and their weights, symmetric to the last bit."""
    highest = Legendre.basis(SAMPLE_POINTS - 1)
    slope = highest.deriv()
    x = np.sort(slope.roots().real)
    x = x - slope(x) / slope.deriv()(x)
    x = np.concatenate([[-1.0], (x - x[::-1]) / 2.0, [1.0]])
    weights = 2.0 / (SAMPLE_POINTS * (SAMPLE_POINTS - 1) * highest(x) ** 2)
    return (1.0 + x) / 2.0, (weights + weights[::-1]) / 4.0


@shared
def table_of_points() -> NDArray[np.float64]:
    """Return the points and the weights, (2 * SAMPLE_POINTS,)."""
    return np.concatenate(lobatto())


@dataclass(frozen=True)
class Sampled:
    """Expressions along a run and their reductions.

    `size` expressions depend on some `entries` of the state. `kernel` is a procedure of time, state, numbers and
    results. `reductions` are pairs of "max", "min" or "mean" and the index of an expression.
    """

    kernel: Procedure
    size: int
    entries: tuple[int, ...]
    reductions: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class SampledStep:
    """A step of a member: its begin, end and length, and its length in the unit of its polynomial.

    `memory` has the coefficients of the polynomial, and `degree` its degree; `y` is the state at the end.
    """

    t: Real
    end: Real
    h: Real
    ratio: Real
    memory: Memory
    y: Memory
    degree: Whole


class Along:
    """The reductions of a member's expressions, in memory of a procedure."""

    def __init__(
        self, p: Builder, sampled: Sampled, path: Procedure, points: Memory, numbers: Memory, dimension: int
    ) -> None:
        self.p, self.sampled, self.points, self.numbers = p, sampled, points, numbers
        self.procedure = follow_step.form(sampled=sampled, path=path, dimension=dimension)
        count, size = len(sampled.reductions), sampled.size
        self.now, self.ahead = p.reserve(size, name="now"), p.reserve(size, name="ahead")
        self.found, self.tried, self.lost = (p.reserve(count, name=name) for name in ("found", "tried", "lost"))
        self.start = p.variable(0.0, "start")

    def begin(self, t: Real, y: Memory) -> None:
        """Initialize with the values at the start of a member."""
        p = self.p
        singular = p.call(self.sampled.kernel, t, y, self.numbers, self.now)
        self.start.value = t
        for place in range(self.sampled.size):
            self.now[place] = p.choose(singular, math.nan, self.now[place])
        for k, (how, place) in enumerate(self.sampled.reductions):
            value = self.now[place]
            signed = value * SIGNS.get(how, 1.0)
            self.found[k] = 0.0 if how == "mean" else p.choose(value.equals(value), signed, -math.inf)
            self.lost[k] = 0.0

    def follow(self, step: SampledStep) -> None:
        """Sample the expressions on a step, which counts only when it is accepted."""
        p = self.p
        given: dict[str, Any] = {
            "t": step.t,
            "end": step.end,
            "h": step.h,
            "ratio": step.ratio,
            "coefficients": step.memory,
        }
        given |= {"numbers": self.numbers, "points": self.points, "y": step.y, "now": self.now, "found": self.found}
        given |= {"degree": step.degree, "ahead": self.ahead, "tried": self.tried}
        p.call(self.procedure, *(given[one.name] for one in self.procedure.parameters))

    def accept(self) -> None:
        """Commit the values of the sampled step."""
        for place in range(self.sampled.size):
            self.now[place] = self.ahead[place]
        for k, (how, _) in enumerate(self.sampled.reductions):
            if how == "mean":
                self.found[k], self.lost[k] = compensated(self.found[k], self.tried[k] + self.lost[k])
            else:
                self.found[k] = self.tried[k]

    def write(self, end: Real, to: Memory) -> None:
        """Write the reductions of a member that ends at a time."""
        p, duration = self.p, end - self.start.value
        for k, (how, place) in enumerate(self.sampled.reductions):
            if how == "mean":
                mean = self.found[k] / p.choose(duration.equals(0.0), 1.0, duration)
                to[k] = p.choose(duration.equals(0.0), self.now[place], mean)
            else:
                none = self.found[k].equals(-math.inf)
                to[k] = p.choose(none, math.nan, self.found[k] * SIGNS[how])


@procedure
def follow_step(
    t: float,
    end: float,
    h: float,
    ratio: float,
    coefficients: In,
    numbers: In,
    points: In,
    y: In,
    now: In,
    found: In,
    degree: int,
    ahead: Out,
    tried: Out,
    *,
    sampled: Sampled,
    path: Procedure,
    dimension: int,
) -> None:
    """Sample expressions on a step from t to `end`, at whose end the state is `y`.

    Write their values at the end, `ahead`, and for each reduction `tried`: the integral over the step, or the largest
    value so far. `now` are the values at the beginning, and `found` the largest values of the steps before. `points`
    are those of Lobatto's rule and then its weights.
    """
    size = sampled.size
    samples, state, there = reals(SAMPLE_POINTS * size), reals(dimension), reals(size)
    for j in range(1, SAMPLE_POINTS - 1):
        generated(path, points[j], ratio, coefficients, state, degree)
        is_singular = generated(sampled.kernel, fma(h, points[j], t), state, numbers, there)
        for place in unrolled(size):
            samples[j + place * SAMPLE_POINTS] = math.nan if is_singular else there[place]
    ends_singular = generated(sampled.kernel, end, y, numbers, there)
    for place in unrolled(size):
        ahead[place] = math.nan if ends_singular else there[place]
        samples[place * SAMPLE_POINTS] = now[place]
        samples[place * SAMPLE_POINTS + SAMPLE_POINTS - 1] = ahead[place]
    for k, (how, place) in enumerate(sampled.reductions):
        own = samples[place * SAMPLE_POINTS :]
        if how == "mean":
            tried[k] = h * integral(own, points[SAMPLE_POINTS:])
        else:
            search, step = search_on_step(sampled, path, dimension), (t, h, ratio, place, coefficients, numbers, degree)
            tried[k] = generated(search, *step, SIGNS[how], found[k], own, points)


@inline
def integral(samples: In, weights: In) -> float:
    """Return the integral of values at the points, divided by the length of the step."""
    total = samples[0] * weights[0]
    for j in unrolled(SAMPLE_POINTS - 1):
        total = fma(samples[j + 1], weights[j + 1], total)
    return total


@cache
def search_on_step(sampled: Sampled, path: Procedure, dimension: int) -> Procedure:
    """Return the procedure `raised` for the expressions of a system."""
    value = value_on_step.form(sampled=sampled, path=path, dimension=dimension)
    return bound(raised.form(), {"value": value}, prefix="step_")


@procedure
def value_on_step(
    fraction: float,
    t: float,
    h: float,
    ratio: float,
    place: int,
    coefficients: In,
    numbers: In,
    degree: int,
    *,
    sampled: Sampled,
    path: Procedure,
    dimension: int,
) -> float:
    """Return the value of an expression at a fraction of a step; see `VALUE`."""
    state, there = reals(dimension), reals(sampled.size)
    generated(path, fraction, ratio, coefficients, state, degree)
    is_singular = generated(sampled.kernel, fma(h, fraction, t), state, numbers, there)
    return math.nan if is_singular else there[place]


@procedure(step=expression_type)
def raised(step: ExpressionOnStep, sign: float, before: float, samples: In, points: In) -> float:
    """Return the largest value of `sign` times an expression on a step, or `before` if that is larger.

    `samples` are its values at the `points`. A maximum is near a point that is not less than its neighbours. It is
    between an end of the step and the next point if the expression rises from the end, but the next point is not
    larger. That takes one more value.
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
        # The slope of an expression is taken to be at most twice that from point to point. This holds for a parabola
        # and for |x|.
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
