"""Values of given functions: formulas, and tables over any argument."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, formula
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.expression import expression
from lagrange.statement.number import real_array

FEWEST_POINTS = 4
"""Points that a cubic needs."""

MOST_POINTS = 200
"""Each interval is a branch of a condition: a hundred compile in 2 s, and a run of `taylor` ends a step at each."""

OVERHANG = 1e-3
"""Part of the outer intervals by which the outer cubics go on: a point there is that of an end with other rounding, or
the end of a difference."""


@dataclass(frozen=True)
class Table:
    """Values at points that rise, joined by cubics whose first and second derivatives are continuous."""

    points: tuple[float, ...]
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"a table of {len(self.points)} times from {self.points[0]:g} to {self.points[-1]:g}"


def table(argument: Any, points: Any, values: Any) -> Any:
    """Return a force or energy that is measured at points, as a SymPy expression: a Piecewise of cubics.

    `argument` is an expression such as a coordinate, a velocity or a distance. `values` (K,) belong to `points` (K,),
    4 to 200 that rise. A cubic spline joins them: its first and second derivatives are continuous. Outside of the
    points there is no value, and a run that gets there stops with a message. Raises StatementError for points that do
    not rise, and for numbers that are not finite.
    """
    variable = expression(argument, "the argument of the table")
    if not variable.free_symbols:
        raise StatementError(
            f"the argument of the table is {float(variable):g}, a number: give an expression, such as a coordinate."
        )
    plain = {part: sympy.Symbol(name_of(part)) for part in variable.atoms(AppliedUndef)}
    plain |= {part: sympy.Symbol(f"{name_of(part.expr)}_dot") for part in variable.atoms(sympy.Derivative)}
    name = formula(variable.xreplace(plain), 40)
    return spline(checked_table(f"the table over {name}", (points, values), "points"), 0, variable)


def checked_table(what: str, columns: Sequence[Any] | Any, points: str) -> Table:
    """Return a table from two columns; `points` says in messages what the first has, such as times."""
    both = f"({points}, values), two lists of one length"
    if isinstance(columns, np.ndarray) and columns.ndim == 0:
        raise StatementError(f"{what} is an array without entries: give {both}.")
    if len(columns) != 2:
        raise StatementError(f"{what} has {len(columns)} columns: give {both}.")
    places, values = real_array(columns[0], f"the {points} of {what}"), real_array(columns[1], f"the values of {what}")
    if places.ndim != 1 or values.shape != places.shape or not np.isfinite([places, values]).all():
        raise StatementError(
            f"{what} has {points} of shape {places.shape} and values of shape {values.shape}: give two lists of finite "
            "numbers, of one length."
        )
    if not FEWEST_POINTS <= len(places) <= MOST_POINTS:
        raise StatementError(
            f"{what} has {len(places)} {points}: give {FEWEST_POINTS} to {MOST_POINTS}. Thin a longer table out, or "
            "fit an expression."
        )
    falls = np.flatnonzero(np.diff(places) <= 0)
    if len(falls):
        first, second = places[falls[0]], places[falls[0] + 1]
        raise StatementError(f"the {points} of {what} go from {first:g} to {second:g}: give {points} that rise.")
    return Table(tuple(map(float, places)), tuple(map(float, values)))


@lru_cache(maxsize=256)
def spline(table: Table, order: int, variable: Any) -> Any:
    """Return a derivative of the spline as a Piecewise in a variable, which has no value outside of the points.

    The spline is "not a knot": of the first two intervals, and of the last two, the cubics are the same.
    """
    from scipy.interpolate import CubicSpline  # takes 0.1 s to import

    rows = [np.polyder(np.poly1d(row), order).coeffs for row in CubicSpline(table.points, table.values).c.T]
    branches = []
    for row, start, end in zip(rows, table.points, table.points[1:], strict=False):
        value: Any = sympy.S.Zero
        for coefficient in row.tolist():  # Horner's rule
            value = value * (variable - sympy.Float(start)) + sympy.Float(coefficient)
        branches.append((value, variable < sympy.Float(end)))
    first, last = (OVERHANG * (table.points[i + 1] - table.points[i]) for i in (0, -2))
    low, high = sympy.Float(table.points[0] - first), sympy.Float(table.points[-1] + last)
    branches[-1] = (branches[-1][0], True)
    inside = sympy.And(variable > low, variable < high)
    return sympy.Piecewise((sympy.Piecewise(*branches, evaluate=False), inside), evaluate=False)


def ranges(expression: Any) -> Iterator[tuple[Any, float, float]]:
    """Yield the variable of each table in an expression, and the ends between which it has values."""
    for node in expression.atoms(sympy.Piecewise):
        conditions = node.args[0].cond.args if len(node.args) == 1 else ()
        ends = {type(part): part for part in conditions}
        if set(ends) == {sympy.StrictGreaterThan, sympy.StrictLessThan}:
            above, below = ends[sympy.StrictGreaterThan], ends[sympy.StrictLessThan]
            if above.lhs == below.lhs and above.rhs.is_Float and below.rhs.is_Float:
                yield above.lhs, float(above.rhs), float(below.rhs)


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
