"""Expressions of a statement with their required quantities, the parts of functions, and bare numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.statement.coordinate import t
from lagrange.statement.given.motion import table_range
from lagrange.statement.units.dimension import DIMENSIONLESS, Dimension, named

SAME_DIMENSION = (sympy.Abs, sympy.Min, sympy.Max)
"""Functions whose value has the dimension of their arguments."""


@dataclass(frozen=True)
class CheckedPart:
    """An expression of a statement, its name in messages, `what`, and its required quantity.

    `like` is the name of a quantity, such as "energy", or a symbol with the required dimension and unit, or None for
    any. With a symbol `per` the requirement is on the expression times this symbol.
    """

    what: str
    expression: Any
    like: Any
    per: Any = None

    def wanted(self, known: Mapping[Any, Dimension]) -> Dimension | None:
        """Return the required dimension of the expression: None for any, and if it is not known yet."""
        whole = named(self.like) if isinstance(self.like, str) else known.get(self.like)
        if whole is None or self.per is None:
            return whole
        return whole * known[self.per] ** Fraction(-1) if self.per in known else None


def in_short(term: Any, plain: Mapping[Any, Any]) -> str:
    """Return a term in the plain symbols of messages, with tables by name, cut to 80 characters."""
    named_tables = term.replace(
        lambda node: table_range(node) is not None, lambda node: sympy.Function("table")(node.args[0].cond.args[0].lhs)
    )
    return str(named_tables.xreplace(plain))[:80]


def number_of(exponent: Any) -> Fraction | None:
    """Return an exponent as a fraction, None if it is not a number."""
    if exponent.is_Rational:
        return Fraction(int(exponent.p), int(exponent.q))
    return Fraction(float(exponent)).limit_denominator(1000) if exponent.is_Float else None


def inner_parts(expression: Any, dimension: Dimension | None) -> Iterator[tuple[Any, Dimension | None]]:
    """Yield arguments of a function, or branches of a Piecewise, with their required dimensions; None for any.

    The argument of a table is a number, and so is its value. Quantities that are compared, such as both sides of a
    condition, are yielded as their difference.
    """
    if (table := table_range(expression)) is not None:
        yield table[0], DIMENSIONLESS
    elif isinstance(expression, sympy.Piecewise):
        for pair in expression.args:
            yield pair.expr, dimension
            for condition in pair.cond.atoms(sympy.core.relational.Relational):
                yield condition.lhs - condition.rhs, None
    elif isinstance(expression, sympy.atan2):
        above, below = expression.args
        yield above - below, None
    elif isinstance(expression, (sympy.sign, sympy.Heaviside)):
        yield expression.args[0], None
    elif not isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Derivative, sympy.Subs)):
        for argument in expression.args:
            yield argument, DIMENSIONLESS


def without_own_numbers(expression: Any, is_time: Callable[[Any], bool], is_ratio: Callable[[Any], bool]) -> Any:
    """Return an expression without its parts made of numbers and time alone: the units of such numbers are not stated.

    Such terms are left out, such factors are replaced by 1: `a*sin(2*t) + 0.1` becomes a, an event `x - 3` is x.
    Numbers without units stay: multiples of t beside terms that are times, as in `t - a`, and numbers beside ratios of
    quantities, as in `x/a - 1`.
    """

    def without(node: Any) -> Any:
        if not node.is_Add:
            return sympy.S.One
        left = [term for term in node.args if not _own(term)]
        if any(map(is_time, left)):
            left += [term for term in node.args if is_multiple_of_time(term)]
        elif any(map(is_ratio, left)):
            left += [term for term in node.args if term.is_number]
        return sympy.Add(*left) if left else sympy.S.One

    return sympy.S.Zero if _own(expression) else expression.replace(_replaced, without)


def is_multiple_of_time(term: Any) -> bool:
    """Return True for a number times t."""
    return bool((term / t).is_number)


def _own(node: Any) -> bool:
    """Return True if a node contains only numbers and time."""
    return node.free_symbols <= {t} and not node.has(AppliedUndef)


def _replaced(node: Any) -> bool:
    return node.is_Add or (isinstance(node, (sympy.Function, sympy.Piecewise)) and _own(node))
