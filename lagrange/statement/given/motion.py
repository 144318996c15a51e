"""Values of given functions: formulas in t, and tables of numbers over any argument, joined by cubic splines."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, counted, formula, shown
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.expression import expression, real_array

FEWEST_TABLE_POINTS = 4  # Least number of points of a table, which determine one cubic

MOST_TABLE_POINTS = 200
"""Largest number of points of a table. Each interval is a branch of a Piecewise: a hundred compile in 2 s, and the
method `taylor` ends a step at each of them."""

OVERHANG = 1e-3
"""Extension of the outer cubics beyond the ends of a table, as a fraction of the outer intervals. Rounding and finite
differences at an end lead to arguments just outside it."""


@dataclass(frozen=True)
class TabulatedFunction:
    """Numbers `values` at increasing `points`, joined by cubics with continuous first and second derivatives."""

    points: tuple[float, ...]
    values: tuple[float, ...]

    def __str__(self) -> str:
        return f"a table of {len(self.points)} times from {self.points[0]:g} to {self.points[-1]:g}"


def table(argument: Any, points: Any, values: Any) -> Any:
    """Return a function that is known from measurements, such as a force over a distance, as a SymPy expression.

    Use it in energies, forces and constraints: `lg.table(x, [0, 1, 2, 3], [0, 0.9, 2.1, 3.8])` is the value at the
    coordinate x. `argument` is any expression: a coordinate, a velocity, a distance. `values` (K,) belong to `points`
    (K,), 4 to 200 increasing numbers. A cubic spline ("not a knot") joins the values. Its first and second derivatives
    are continuous. The result is a Piecewise of cubics, which has no value outside of the points. A run that leaves the
    points stops with a message.

    Numbers have no unit. In a system with `dimensions`, divide the argument by a unit and multiply the table by a unit,
    as in `e*lg.table(x/a, points, values)`. A table over time is `lg.given(name, (times, values))`. Raises
    StatementError for points that do not increase, and for numbers that are not finite.
    """
    variable = expression(argument, "the argument of the table")
    if not variable.free_symbols:
        raise StatementError(
            f"the argument of the table is {shown(argument, 40)}, a number: give an expression, such as a coordinate."
        )
    if variable.is_extended_real is False:
        raise StatementError(
            f"the argument of the table is {formula(variable, 40)}, which is not real: give a real one."
        )
    plain = {part: sympy.Symbol(name_of(part)) for part in variable.atoms(AppliedUndef)}
    plain |= {part: sympy.Symbol(f"{name_of(part.expr)}_dot") for part in variable.atoms(sympy.Derivative)}
    name = formula(variable.xreplace(plain), 40)
    tabulated = checked_table(f"the table over {name}", (points, values), "points")
    if tabulated not in _LATEST:
        _LATEST.append(tabulated)
    return spline(tabulated, 0, variable)


_LATEST: deque[TabulatedFunction] = deque(maxlen=256)
"""Latest tables. `table_of` finds the numbers of a table here, since its spline does not contain them exactly."""


def table_of(node: Any) -> tuple[Any, TabulatedFunction] | None:
    """Return (argument, table) for the spline of one of the 256 tables that were created last, else None."""
    bounds = table_range(node)
    same = [table for table in tuple(_LATEST) if bounds and _ends(table) == bounds[1:]]
    return next(((bounds[0], table) for table in same if bounds and spline(table, 0, bounds[0]) == node), None)


def _ends(table: TabulatedFunction) -> tuple[float, float]:
    """Return the range (lower end, upper end) of a spline's argument, a little larger than the range of its points."""
    first, last = (OVERHANG * (table.points[i + 1] - table.points[i]) for i in (0, -2))
    return table.points[0] - first, table.points[-1] + last


def checked_table(title: str, columns: Sequence[Any] | Any, points: str) -> TabulatedFunction:
    """Return a table from `columns`, which are the points and the values: two lists of finite numbers of one length.

    In messages `title` is the name of the table, and `points` the word for its points. Raises StatementError for other
    lists.
    """
    both = f"({points}, values), two lists of one length"
    if isinstance(columns, np.ndarray) and columns.ndim == 0:
        raise StatementError(f"{title} is an array without entries: give {both}.")
    if len(columns) != 2:
        raise StatementError(f"{title} has {counted(len(columns), 'part')}: give {both}.")
    arguments, values = (
        real_array(columns[0], f"the {points} of {title}"),
        real_array(columns[1], f"the values of {title}"),
    )
    if arguments.ndim != 1 or values.shape != arguments.shape:
        raise StatementError(
            f"{title} has {points} of shape {arguments.shape} and values of shape {values.shape}: give two lists of "
            "finite numbers, of one length."
        )
    for what, numbers in ((points, arguments), ("values", values)):
        if len(places := np.flatnonzero(~np.isfinite(numbers))):
            place = int(places[0])
            raise StatementError(f"{title} has {numbers[place]} at index {place} of its {what}: give finite numbers.")
    if not FEWEST_TABLE_POINTS <= len(arguments) <= MOST_TABLE_POINTS:
        raise StatementError(
            f"{title} has {len(arguments)} {points}: give {FEWEST_TABLE_POINTS} to {MOST_TABLE_POINTS}. "
            "Thin a longer table out, or fit an expression."
        )
    falls = np.flatnonzero(np.diff(arguments) <= 0)
    if len(falls):
        first, second = arguments[falls[0]], arguments[falls[0] + 1]
        raise StatementError(f"the {points} of {title} go from {first:g} to {second:g}: give {points} that rise.")
    return TabulatedFunction(tuple(map(float, arguments)), tuple(map(float, values)))


@lru_cache(maxsize=256)
def spline(table: TabulatedFunction, order: int, variable: Any) -> Any:
    """Return the derivative of order `order` of a table's cubic spline, as a Piecewise in `variable`.

    It has no value outside the points. The spline is "not a knot": the first two intervals have the same cubic, and so
    have the last two.
    """
    from scipy.interpolate import CubicSpline  # takes 0.1 s to import

    rows = [np.polyder(np.poly1d(row), order).coeffs for row in CubicSpline(table.points, table.values).c.T]
    branches = []
    for row, start, end in zip(rows, table.points, table.points[1:], strict=False):
        value: Any = sympy.S.Zero
        for coefficient in row.tolist():  # Horner's rule
            value = value * (variable - sympy.Float(start)) + sympy.Float(coefficient)
        branches.append((value, variable < sympy.Float(end)))
    low, high = map(sympy.Float, _ends(table))
    branches[-1] = (branches[-1][0], True)
    inside = sympy.And(variable > low, variable < high)
    return sympy.Piecewise((sympy.Piecewise(*branches, evaluate=False), inside), evaluate=False)


def table_range(node: Any) -> tuple[Any, float, float] | None:
    """Return (argument, lower end, upper end) of the range in which a table's spline or its derivative is defined.

    Returns None if the expression `node` is not a spline or the derivative of one.
    """
    conditions = node.args[0].cond.args if isinstance(node, sympy.Piecewise) and len(node.args) == 1 else ()
    ends = {type(part): part for part in conditions}
    if set(ends) == {sympy.StrictGreaterThan, sympy.StrictLessThan}:
        above, below = ends[sympy.StrictGreaterThan], ends[sympy.StrictLessThan]
        if above.lhs == below.lhs and above.rhs.is_Float and below.rhs.is_Float:
            return above.lhs, float(above.rhs), float(below.rhs)
    return None


def ranges(expression: Any) -> Iterator[tuple[Any, float, float]]:
    """Yield (argument, lower end, upper end) of the range of each table in an expression."""
    yield from (bounds for node in expression.atoms(sympy.Piecewise) if (bounds := table_range(node)) is not None)


MARK = "motion"  # Attribute of given functions that holds their `Motion`; SymPy distinguishes functions by it


@dataclass(frozen=True)
class Motion:
    """Values of a given function: an expression in t and parameters, a TabulatedFunction, or None."""

    values: Any = None

    @property
    def expression(self) -> Any:
        """The given function as an expression in t and parameters. None for a table or a function without values."""
        return self.values if isinstance(self.values, sympy.Expr) else None

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which the given function has a value. Both are infinite unless it is a table."""
        table = self.values
        return (table.points[0], table.points[-1]) if isinstance(table, TabulatedFunction) else (-math.inf, math.inf)

    def derivative(self, order: int) -> Any:
        """Return the time derivative of order `order` of the given function, as an expression in t and parameters."""
        if isinstance(self.values, TabulatedFunction):
            return spline(self.values, order, t)
        time = sympy.Dummy(real=True)  # For real t SymPy's derivative at a corner is one-sided
        derivative = self.values.xreplace({t: time})
        for _ in range(order):
            derivative = derivative.diff(time).replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)
        return derivative.xreplace({time: t})


def motion_of(function: Any) -> Motion | None:
    """Return the `Motion` of a given function of time, or None for any other function."""
    motion = type(function).__dict__.get(MARK)
    return motion if isinstance(motion, Motion) else None
