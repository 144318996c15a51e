"""The largest value of an expression between three points of a step, by Brent's method without derivatives.

Source: R. P. Brent, Algorithms for Minimization without Derivatives, 1973, chapter 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.procedure.form import READ, REAL, WHOLE, Callee
from lagrange.procedure.front.plain import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In

VALUE = Callee((REAL, REAL, REAL, REAL, WHOLE, READ, READ, WHOLE), (REAL,))
"""A callback that returns the value of an expression at a fraction of a step.

Its arguments are the fraction and then the fields of `ExpressionOnStep`, without the callback itself."""

RESOLUTION = 2.0**-27
"""Resolution of points as a fraction of the step: the value at a maximum is then exact to round-off."""

MOST_EVALUATIONS = 60
"""Largest number of evaluations. Without a second derivative it takes 40, with a third derivative about 8."""

GOLDEN = 0.3819660112501051
"""The smaller part of the golden section, (3 - sqrt(5)) / 2."""


@dataclass(frozen=True)
class ExpressionOnStep:
    """An expression along a step that begins at time t and has the length h.

    The polynomial of the step has `coefficients` and a `degree`; `ratio` is the length of the step in its unit of time.
    `place` is the index of the expression, and `numbers` are the prepared numbers of the system.
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
        """Return the value at a fraction of the step."""
        step = self.t, self.h, self.ratio, self.place
        value: float = self.value(fraction, *step, self.coefficients, self.numbers, self.degree)
        return value


def expression_type() -> Bundle:
    """Return the type of an expression on a step among the arguments of a procedure."""
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
    """Return the largest value of `sign` times an expression between the fractions `low` and `high`, at least `best`.

    `low_value`, `middle_value` and `high_value` are values of the expression; `sign` times it is largest at `middle`.
    The next point is the vertex of the parabola through the three best points, or that of the golden section.
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
