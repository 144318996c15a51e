"""Expressions along the run of a member: largest and least values, and means over time.

On each step an expression is evaluated at nine points of the dense output, including both ends. Its integral is that of
Gauss-Lobatto's rule, which is exact for polynomials of degree 15. A maximum between points that may exceed all earlier
values is searched for. So extrema are found if nine points of a step show them.

The step of a Taylor series is sampled while its series is in memory, and counts when it is accepted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray

from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.members.extremum import ALONG, largest_between
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.rewrite import bound
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole

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
        self.procedure = follow_step(sampled, path, dimension)
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
        given: dict[str, Any] = {"t": step.t, "end": step.end, "h": step.h, "ratio": step.ratio, "memory": step.memory}
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


def follow_step(sampled: Sampled, path: Procedure, dimension: int) -> Procedure:
    """Return the procedure that samples expressions on a step.

    It writes their values at the end of the step, `ahead`, and `tried`: the integral over the step, or the largest
    value so far. `now` has the values at the beginning.
    """
    p = Builder("follow_step", "Look at expressions along a step.")
    t, end, h, ratio = (p.given(name, REAL) for name in ("t", "end", "h", "ratio"))
    memory, numbers, points = (p.array(name, read=True) for name in ("memory", "numbers", "points"))
    y, now, found = (p.array(name, read=True) for name in ("y", "now", "found"))
    degree, ahead, tried = p.given("degree", WHOLE), p.array("ahead"), p.array("tried")
    size = sampled.size
    samples, state = p.reserve(SAMPLE_POINTS * size, name="samples"), p.reserve(dimension, name="state")
    there = p.reserve(size, name="there")
    with p.loop(1, SAMPLE_POINTS - 1) as j:
        p.call(path, points[j], ratio, memory, state, degree)
        singular = p.call(sampled.kernel, p.fma(h, points[j], t), state, numbers, there)
        for place in range(size):
            samples[j + place * SAMPLE_POINTS] = p.choose(singular, math.nan, there[place])
    singular = p.call(sampled.kernel, end, y, numbers, there)
    for place in range(size):
        ahead[place] = p.choose(singular, math.nan, there[place])
        samples[place * SAMPLE_POINTS], samples[place * SAMPLE_POINTS + SAMPLE_POINTS - 1] = now[place], ahead[place]
    if any(how in SIGNS for how, _ in sampled.reductions):
        search = raised(sampled, path, dimension)
    for k, (how, place) in enumerate(sampled.reductions):
        own = samples.at(place * SAMPLE_POINTS)
        if how == "mean":
            tried[k] = h * _integral(p, own, points.at(SAMPLE_POINTS))
        else:
            tried[k] = p.call(search, SIGNS[how], found[k], own, points, t, h, ratio, place, memory, numbers, degree)
    return p.finish()


def _integral(p: Builder, samples: Memory, weights: Memory) -> Real:
    """Return the integral of values at the points, divided by the length of the step."""
    total = samples[0] * weights[0]
    for j in range(1, SAMPLE_POINTS):
        total = p.fma(samples[j], weights[j], total)
    return p.real(total)


def raised(sampled: Sampled, path: Procedure, dimension: int) -> Procedure:
    """Return the procedure that raises a number to the largest value of an expression on a step."""
    return _Raised(value_on_step(sampled, path, dimension)).build()


class _Raised:
    """Builds the procedure.

    A maximum is near a point that is not less than its neighbours. It is between an end of the step and the next point
    if the expression rises from the end, but the next point is not larger. That takes one more value.
    """

    def __init__(self, value: Procedure) -> None:
        self.p = p = Builder("raised", "Return the largest value on a step, or a larger one from before.")
        self.value = value
        self.search = bound(largest_between(1), {"value": value}, prefix="step_")
        self.sign, before = p.given("sign", REAL), p.given("before", REAL)
        self.samples, self.points = p.array("samples", read=True), p.array("points", read=True)
        self.along = [p.given(f"along{k}", kind) for k, kind in enumerate(ALONG)]
        self.best = p.variable(before, "best")
        self.places = [p.reserve(1, name=name) for name in ("low", "middle", "high")]
        self.values = [p.reserve(1, name=f"{name}_value") for name in ("low", "middle", "high")]
        self.target = p.reserve(1, name="target")

    def build(self) -> Procedure:
        p, sign, best = self.p, self.sign, self.best
        with p.loop(0, SAMPLE_POINTS) as j:
            found = self.samples[j] * sign
            best.value = p.choose(found > best.value, found, best.value)
        with p.loop(1, SAMPLE_POINTS - 1) as j:
            a, b, c = (self.samples[j + k] * sign for k in (-1, 0, 1))
            inner = (b >= a) & (b >= c)
            first, last = j.equals(1) & (a > b), j.equals(SAMPLE_POINTS - 2) & (c > b)
            bound_ = self.bound(j, a, b, c)
            with p.when((inner | first | last) & (bound_ - best.value > RISE * abs(best.value)), likely=False):
                self.bracket(j, inner, first)
        p.leave(best.value)
        return p.finish(REAL)

    def bound(self, j: Whole, a: Real, b: Real, c: Real) -> Real:
        """Return a bound of an expression between points: its slope is at most twice the slope from point to point.

        This holds for a parabola, and for |x|.
        """
        p = self.p
        left, right = self.points[j] - self.points[j - 1], self.points[j + 1] - self.points[j]
        steep = p.magnitude((b - a) / left, (c - b) / right) * 2.0
        found: Real = p.larger(a + b + steep * left, b + c + steep * right) * 0.5
        return found

    def bracket(self, j: Whole, inner: Flag, first: Flag) -> None:
        """Write the bracket of three points around a maximum, and search in it."""
        p, sign = self.p, self.sign
        begin = p.choose(inner | first, j - 1, j)
        end = p.choose(inner, j + 1, begin + 1)
        for k, place in enumerate((begin, j, end)):
            self.places[k][0], self.values[k][0] = self.points[place], self.samples[place]
        with p.when(~inner):
            self.places[1][0] = p.choose(first, END_SLOPE_AT, p.constant(1.0 - END_SLOPE_AT, REAL))
            p.call(self.value, 1, self.places[1], self.values[1], *self.along)
        middle = self.values[1][0] * sign
        with p.when((middle >= self.values[0][0] * sign) & (middle >= self.values[2][0] * sign)):
            self.target[0] = self.best.value
            p.call(self.search, sign, *self.places, *self.values, self.target, *self.along)
            self.best.value = self.target[0]


def value_on_step(sampled: Sampled, path: Procedure, dimension: int) -> Procedure:
    """Return the value of an expression at a fraction of a step; see `FRACTIONS`."""
    p = Builder("value_on_step", "Write the value of an expression at a fraction of a step.")
    p.given("columns", WHOLE)
    theta, out = p.array("theta", read=True), p.array("out")
    t, h, ratio, place = p.given("t", REAL), p.given("h", REAL), p.given("ratio", REAL), p.given("place", WHOLE)
    memory, numbers, degree = p.array("memory", read=True), p.array("numbers", read=True), p.given("degree", WHOLE)
    state, there = p.reserve(dimension, name="state"), p.reserve(sampled.size, name="there")
    p.call(path, theta[0], ratio, memory, state, degree)
    singular = p.call(sampled.kernel, p.fma(h, theta[0], t), state, numbers, there)
    out[0] = p.choose(singular, math.nan, there[place])
    return p.finish()
