"""Translation of nodes into SymPy expressions, for display and for tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import sympy

from lagrange.errors import StatementError
from lagrange.graph.node import Kind, Node, reachable
from lagrange.statement.vocabulary.elementary import ELEMENTARY


def to_sympy(node: Node, symbols: Mapping[Node, Any]) -> Any:
    """Return the node as a SymPy expression; `symbols` maps symbol nodes to SymPy symbols."""
    table: dict[Node, Any] = dict(symbols)
    for step in reachable([node]):
        if step not in table and step.kind not in (Kind.FACTOR, Kind.SOLVE):
            table[step] = _express(step, table)
    return table[node]


def _express(node: Node, table: Mapping[Node, Any]) -> Any:
    if node.kind is Kind.CONSTANT:
        return _rational(node.data)
    if node.kind is Kind.SYMBOL:
        return sympy.Symbol(node.data, real=True)
    if node.kind is Kind.COMPONENT:
        return _solution(node, table)
    args = [table[arg] for arg in node.args]
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        terms = (_rational(c) * arg for c, arg in zip(coefficients, args, strict=True))
        return sympy.Add(_rational(constant), *terms)
    if node.kind is Kind.PRODUCT:
        return sympy.Mul(*args)
    if node.kind is Kind.POWER:
        return args[0] ** _rational(node.data)
    return _SPELLING[node.data](*args)


def _rational(value: int | Fraction) -> Any:
    return sympy.Rational(value.numerator, value.denominator)


def _solution(node: Node, table: Mapping[Node, Any]) -> Any:
    factor, right = node.args[0].args[0], node.args[0].args[1:]
    n = len(right)
    if n > 4:
        raise StatementError(f"the solution of {n} coupled equations is too large to write out.")
    matrix = sympy.Matrix(n, n, lambda i, j: table[factor.args[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)]])
    column = sympy.Matrix([table[entry] for entry in right])
    return (matrix.adjugate() * column)[node.data] / matrix.det(method="berkowitz")


def _piecewise(*args: Any) -> Any:
    """Return a SymPy Piecewise of arguments (condition, value, ..., last value). A last value of nan is left out."""
    pairs = [(value, condition) for condition, value in zip(args[:-1:2], args[1::2], strict=True)]
    return sympy.Piecewise(*pairs, *([] if args[-1] is sympy.nan else [(args[-1], True)]))


_SPELLING: dict[str, Callable[..., Any]] = {
    **{elementary.name: elementary.symbolic for elementary in ELEMENTARY.values()},
    "atan2": sympy.atan2,
    "abs": sympy.Abs,
    "sign": sympy.sign,
    "min": sympy.Min,
    "max": sympy.Max,
    "pow": sympy.Pow,
    "pi": lambda: sympy.pi,
    "e": lambda: sympy.E,
    "nan": lambda: sympy.nan,
    "less": sympy.StrictLessThan,
    "less_equal": sympy.LessThan,
    "equal": sympy.Eq,
    "and": sympy.And,
    "or": sympy.Or,
    "not": sympy.Not,
    "piecewise": _piecewise,
}
