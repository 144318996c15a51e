"""Translate SymPy expressions into graph nodes and back, without recursion.

Each distinct subexpression is translated once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import reduce
from math import factorial
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, formula
from lagrange.graph.node import Graph, Kind, Node, reachable
from lagrange.statement.expression import parts_first
from lagrange.statement.vocabulary.functions import ELEMENTARY

SINC_RADIUS = Fraction(1, 2)  # Largest |a| at which sinc(a) is computed by its series
SINC_TERMS = 12
"""Number of terms of the series of sinc. At |a| = `SINC_RADIUS` the first omitted term, a**24/25!, is 4e-33, and its
fourth derivative 1e-26."""


class Translator:
    """Callable that translates SymPy expressions into nodes of a graph. `leaves` maps symbols, q and v to nodes."""

    def __init__(self, graph: Graph, leaves: Mapping[Any, Node]) -> None:
        self.graph = graph
        self._done: dict[Any, Node] = dict(leaves)

    def __call__(self, expression: Any) -> Node:
        """Return the node of a SymPy expression. Raises StatementError for unsupported parts."""
        done = self._done
        for part in parts_first(expression, done, _operands):
            if isinstance(part, sympy.Number):
                done[part] = self.graph.constant(_number(part))
                continue
            build = _BUILD.get(type(part)) or _BUILD.get(part.func)
            if build is None:
                raise StatementError(
                    f"{type(part).__name__} in {formula(part, 80)!r} is not supported: write it without this part."
                )
            done[part] = build(self.graph, *(done[arg] for arg in _operands(part)))
        return done[expression]


def _operands(expression: Any) -> tuple[Any, ...]:
    if isinstance(expression, (AppliedUndef, sympy.Derivative)):
        raise StatementError(
            f"{expression} is not declared in this system: declare it, or write the expression without it."
        )
    if isinstance(expression, sympy.Piecewise):
        return tuple(part for pair in expression.args for part in pair.args)
    if isinstance(expression, (sympy.And, sympy.Or)):
        return tuple(sorted(expression.args, key=sympy.default_sort_key))
    return tuple(expression.args)


def _number(number: Any) -> int | Fraction:
    if isinstance(number, sympy.Rational):
        return Fraction(int(number.p), int(number.q))
    if not number.is_finite:
        raise StatementError(
            f"an expression contains {number}, which is not a finite number: look for a division by zero, or for the "
            "logarithm of zero."
        )
    negative, mantissa, exponent, _ = number._mpf_
    value = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return -value if negative else value


def _piecewise(graph: Graph, *args: Node) -> Node:
    branches: list[tuple[Node, Node]] = []
    for value, condition in zip(args[::2], args[1::2], strict=True):
        if condition is graph.one:
            return graph.piecewise(branches, value)
        if condition is not graph.zero:
            branches.append((condition, value))
    return graph.piecewise(branches)


def _sinc(graph: Graph, a: Node) -> Node:
    """Return the node of sin(a)/a. Near 0 it is a series, since the quotient and its derivatives lose digits there."""
    terms = [Fraction((-1) ** k, factorial(2 * k + 1)) for k in range(SINC_TERMS)]
    square, series = a**2, graph.zero
    for term in reversed(terms):
        series = series * square + term
    return graph.piecewise(
        [(graph.call("less", square, graph.constant(SINC_RADIUS**2)), series)], graph.call("sin", a) / a
    )


def _heaviside(graph: Graph, a: Node, middle: Node) -> Node:
    """Return the node of the Heaviside function: 0 for a < 0, `middle` for a = 0, 1 for a > 0."""
    if middle.kind is Kind.CONSTANT and middle.data == Fraction(1, 2):
        return (1 + graph.call("sign", a)) / 2
    below, at = graph.call("less", a, graph.zero), graph.call("equal", a, graph.zero)
    return graph.piecewise([(below, graph.zero), (at, middle)], graph.one)


def _either(graph: Graph, condition: Node, then: Node, otherwise: Node) -> Node:
    """Return the condition `then` if `condition` holds, else the condition `otherwise`, as a node (SymPy's ITE)."""
    ways = [(condition, then), (graph.call("not", condition), otherwise)]
    both = [a if b is graph.one else graph.call("and", a, b) for a, b in ways if b is not graph.zero]
    return _fold("or")(graph, *both) if both else graph.zero


def _call(name: str) -> Callable[..., Node]:
    return lambda graph, *args: graph.call(name, *args)


def _fold(name: str) -> Callable[..., Node]:
    return lambda graph, *args: reduce(lambda a, b: graph.call(name, a, b), args)


_BUILD: dict[Any, Callable[..., Node]] = {
    sympy.Add: lambda graph, *args: graph.sum([(1, arg) for arg in args]),
    sympy.Mul: lambda graph, *args: graph.product(args),
    sympy.Pow: _call("pow"),
    sympy.Piecewise: _piecewise,
    **{elementary.symbolic: _call(elementary.name) for elementary in ELEMENTARY.values()},
    sympy.cot: lambda graph, a: graph.call("cos", a) / graph.call("sin", a),
    sympy.sec: lambda graph, a: 1 / graph.call("cos", a),
    sympy.csc: lambda graph, a: 1 / graph.call("sin", a),
    sympy.atan2: _call("atan2"),
    sympy.sinc: _sinc,
    sympy.Heaviside: _heaviside,
    sympy.Abs: _call("abs"),
    sympy.sign: _call("sign"),
    sympy.Min: _fold("min"),
    sympy.Max: _fold("max"),
    sympy.StrictLessThan: _call("less"),
    sympy.LessThan: _call("less_equal"),
    sympy.StrictGreaterThan: lambda graph, a, b: graph.call("less", b, a),
    sympy.GreaterThan: lambda graph, a, b: graph.call("less_equal", b, a),
    sympy.Equality: _call("equal"),
    sympy.Unequality: lambda graph, a, b: graph.call("not", graph.call("equal", a, b)),
    sympy.And: _fold("and"),
    sympy.Or: _fold("or"),
    sympy.Not: _call("not"),
    sympy.ITE: _either,
    type(sympy.true): lambda graph: graph.one,
    type(sympy.false): lambda graph: graph.zero,
    type(sympy.pi): _call("pi"),
    type(sympy.E): _call("e"),
}


def to_sympy(node: Node, symbols: Mapping[Node, Any]) -> Any:
    """Return the node as a SymPy expression. `symbols` maps symbol nodes to SymPy symbols."""
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
    return SPELLING[node.data](*args)


def _rational(value: int | Fraction) -> Any:
    return sympy.Rational(value.numerator, value.denominator)


def _solution(node: Node, table: Mapping[Node, Any]) -> Any:
    factor, right = node.args[0].args[0], node.args[0].args[1:]
    n = len(right)
    if n > 4:
        raise StatementError(
            f"the solution of {n} coupled equations is too large to write out in symbols: at most 4 are solved."
        )
    matrix = sympy.Matrix(n, n, lambda i, j: table[factor.args[max(i, j) * (max(i, j) + 1) // 2 + min(i, j)]])
    column = sympy.Matrix([table[entry] for entry in right])
    return (matrix.adjugate() * column)[node.data] / matrix.det(method="berkowitz")


def _piecewise_of(*args: Any) -> Any:
    """Return a SymPy Piecewise of arguments (condition, value, ..., last value). A last value of nan is left out."""
    pairs = [(value, condition) for condition, value in zip(args[:-1:2], args[1::2], strict=True)]
    return sympy.Piecewise(*pairs, *([] if args[-1] is sympy.nan else [(args[-1], True)]))


SPELLING: dict[str, Callable[..., Any]] = {
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
    "piecewise": _piecewise_of,
}
"""SymPy function or class for each function that nodes call, by its name in the graph."""
