"""What is known of a given function of time: nothing yet, an expression in t, or a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from lagrange.statement.coordinate import t

OVERHANG = 1e-3
"""Part of the outer intervals by which the outer cubics go on: a time there is that of an end with other rounding, or
the end of a difference."""

MARK = "motion"
"""The attribute by which SymPy tells given functions from coordinates, and from one another."""


@dataclass(frozen=True)
class Table:
    """Values at times that rise, joined by cubics whose first and second derivatives are continuous."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"a table of {len(self.times)} times from {self.times[0]:g} to {self.times[-1]:g}"


@dataclass(frozen=True)
class Motion:
    """What is known of a given function; `values` is an expression in t and parameters, a Table, or None."""

    values: Any = None

    @property
    def expression(self) -> Any:
        """The expression, or None for a table and for nothing."""
        return self.values if isinstance(self.values, sympy.Expr) else None

    @property
    def span(self) -> tuple[float, float]:
        """The times at which there are values."""
        table = self.values
        return (table.times[0], table.times[-1]) if isinstance(table, Table) else (-math.inf, math.inf)

    def derivative(self, order: int) -> Any:
        """Return the derivative of that order as an expression in t and parameters."""
        return _pieces(self.values, order) if isinstance(self.values, Table) else _slope(self.values, order)


def motion_of(function: Any) -> Motion | None:
    """Return what is known of a given function of time, or None for any other function."""
    found = type(function).__dict__.get(MARK)
    return found if isinstance(found, Motion) else None


def _slope(expression: Any, order: int) -> Any:
    """Return a derivative in t, which is real; at a corner or a jump it is that of one side."""
    time = sympy.Dummy(real=True)
    found = expression.xreplace({t: time})
    for _ in range(order):
        found = found.diff(time).replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)
    return found.xreplace({time: t})


@lru_cache(maxsize=256)
def _pieces(table: Table, order: int) -> Any:
    """Return a derivative of the spline as a Piecewise, which has no value outside the times.

    The spline is "not a knot": of the first two intervals, and of the last two, the cubics are the same.
    """
    from scipy.interpolate import CubicSpline  # takes 0.1 s to import

    rows = [np.polyder(np.poly1d(row), order).coeffs for row in CubicSpline(table.times, table.values).c.T]
    branches = []
    for row, start, end in zip(rows, table.times, table.times[1:], strict=False):
        value: Any = sympy.S.Zero
        for coefficient in row.tolist():  # Horner's rule
            value = value * (t - sympy.Float(start)) + sympy.Float(coefficient)
        branches.append((value, t < sympy.Float(end)))
    first, last = (OVERHANG * (table.times[i + 1] - table.times[i]) for i in (0, -2))
    inside = sympy.And(t > sympy.Float(table.times[0] - first), t < sympy.Float(table.times[-1] + last))
    branches[-1] = (branches[-1][0], True)
    return sympy.Piecewise((sympy.Piecewise(*branches, evaluate=False), inside), evaluate=False)
