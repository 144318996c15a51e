"""Derivatives by central differences, with Richardson extrapolation and an error estimate.

Functions map mpmath numbers (displacements from the point) to lists of mpmath numbers. Central differences have an
error series in even powers of the step [1], so two steps, h and h/2, remove its first term. The change that the
extrapolation makes estimates the error before it, and is a safe bound of the error after it.

[1] L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307-357.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

Numbers = list[Any]


class Estimate(NamedTuple):
    """Extrapolated values, a practical bound on the error of each, and the result of the longer step (`coarse`)."""

    value: Numbers
    error: Numbers
    coarse: Numbers


def central(function: Callable[[Any], Sequence[Any]], step: Any) -> Numbers:
    """Return df/dx at 0, from two evaluations."""
    ahead, behind = function(step), function(-step)
    return [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]


def central_mixed(function: Callable[[Any, Any], Sequence[Any]], step_x: Any, step_y: Any) -> Numbers:
    """Return d2f/dx dy at (0, 0), from four evaluations."""

    def slope(x: Any) -> Numbers:
        return central(lambda y: function(x, y), step_y)

    return central(slope, step_x)


def extrapolate(rule: Callable[[Any], Sequence[Any]], scale: Any = 1) -> Estimate:
    """Return the limit at 0 of a rule whose error is a series in even powers of its argument.

    The rule is called with `scale` and with half of it. The argument may scale several steps at once. Then nested
    differences, and results computed from them such as solutions of linear systems, extrapolate together.
    """
    coarse, fine = rule(scale), rule(scale / 2)
    value = [(4 * f - c) / 3 for f, c in zip(fine, coarse, strict=True)]
    return Estimate(value, [abs(x - f) for x, f in zip(value, fine, strict=True)], list(coarse))
