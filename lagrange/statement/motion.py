"""What is known of a given function of time: nothing yet, an expression in t, or a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.statement.coordinate import t
from lagrange.statement.table import Table, spline

MARK = "motion"
"""The attribute by which SymPy tells given functions from coordinates, and from one another."""


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
        return (table.points[0], table.points[-1]) if isinstance(table, Table) else (-math.inf, math.inf)

    def derivative(self, order: int) -> Any:
        """Return the derivative of that order as an expression in t and parameters."""
        return spline(self.values, order, t) if isinstance(self.values, Table) else _slope(self.values, order)


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
