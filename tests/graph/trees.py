"""Random expressions in three forms (graph nodes, SymPy and mpmath), and a simple evaluator of nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import mpmath
import sympy as sp
from hypothesis import strategies as st

from lagrange.graph.node import Binding, Graph, Kind, Node, reachable

SYMBOLS = {name: sp.Symbol(name, real=True) for name in ("m", "x", "y", "u")}
BINDINGS = {"m": Binding.PARAMETER, "x": Binding.CONFIGURATION, "y": Binding.CONFIGURATION, "u": Binding.VELOCITY}


@dataclass(frozen=True)
class Forms:
    """One expression, as functions that build it as a node or in SymPy, or compute it."""

    node: Callable[[Graph, Mapping[str, Node]], Node]
    sympy: Callable[[], Any]
    value: Callable[[Mapping[str, Any]], Any]


@dataclass(frozen=True)
class Operation:
    """One operation on expressions, in the three forms."""

    arity: int
    node: Callable[..., Node]
    sympy: Callable[..., Any]
    value: Callable[..., Any]


def constant(value: Fraction) -> Forms:
    return Forms(
        lambda graph, leaves: graph.constant(value),
        lambda: sp.Rational(value.numerator, value.denominator),
        lambda at: mpmath.mpf(value.numerator) / value.denominator,
    )


def leaf(name: str) -> Forms:
    return Forms(lambda graph, leaves: leaves[name], lambda: SYMBOLS[name], lambda at: at[name])


def combined(operation: Operation, *args: Forms) -> Forms:
    return Forms(
        lambda graph, leaves: operation.node(*(arg.node(graph, leaves) for arg in args)),
        lambda: operation.sympy(*(arg.sympy() for arg in args)),
        lambda at: operation.value(*(arg.value(at) for arg in args)),
    )


def function(arity: int, name: str, build: Callable[..., Any], value: Callable[..., Any]) -> Operation:
    return Operation(arity, lambda *args: args[0].graph.call(name, *args), build, value)


def _power(exponent: Fraction) -> Operation:
    rational = sp.Rational(exponent.numerator, exponent.denominator)
    return Operation(
        1, lambda a: (1 + a * a) ** exponent, lambda a: (1 + a**2) ** rational, lambda a: (1 + a * a) ** _mp(exponent)
    )


def _choice(a: Node, b: Node) -> Node:
    return a.graph.piecewise([(a.graph.call("less", a, b), a * b)], a - b)


SMOOTH = (
    Operation(2, lambda a, b: a + b, lambda a, b: a + b, lambda a, b: a + b),
    Operation(2, lambda a, b: a - b, lambda a, b: a - b, lambda a, b: a - b),
    Operation(2, lambda a, b: a * b, lambda a, b: a * b, lambda a, b: a * b),
    Operation(2, lambda a, b: a / (2 + b * b), lambda a, b: a / (2 + b**2), lambda a, b: a / (2 + b * b)),
    Operation(1, lambda a: a**2, lambda a: a**2, lambda a: a**2),
    Operation(1, lambda a: a**3, lambda a: a**3, lambda a: a**3),
    Operation(1, lambda a: -a, lambda a: -a, lambda a: -a),
    *(_power(Fraction(*pair)) for pair in ((1, 2), (-1, 2), (3, 2), (-1, 1), (1, 3), (-5, 2))),
    function(1, "sin", sp.sin, mpmath.sin),
    function(1, "cos", sp.cos, mpmath.cos),
    function(1, "atan", sp.atan, mpmath.atan),
    function(1, "tanh", sp.tanh, mpmath.tanh),
    function(1, "asinh", sp.asinh, mpmath.asinh),
    function(1, "erf", sp.erf, mpmath.erf),
    Operation(
        1,
        lambda a: a.graph.call("atanh", a.graph.call("sin", a) / 2),
        lambda a: sp.atanh(sp.sin(a) / 2),
        lambda a: mpmath.atanh(mpmath.sin(a) / 2),
    ),
    Operation(
        1, lambda a: a.graph.call("acosh", 2 + a * a), lambda a: sp.acosh(2 + a**2), lambda a: mpmath.acosh(2 + a * a)
    ),
    Operation(
        1,
        lambda a: a.graph.call("exp", a.graph.call("sin", a)),
        lambda a: sp.exp(sp.sin(a)),
        lambda a: mpmath.exp(mpmath.sin(a)),
    ),
    Operation(1, lambda a: a.graph.call("log", 1 + a * a), lambda a: sp.log(1 + a**2), lambda a: mpmath.log(1 + a * a)),
    Operation(
        1,
        lambda a: a.graph.call("asin", a.graph.call("sin", a) / 2),
        lambda a: sp.asin(sp.sin(a) / 2),
        lambda a: mpmath.asin(mpmath.sin(a) / 2),
    ),
    Operation(
        1,
        lambda a: a.graph.call("acos", a.graph.call("tanh", a) / 2),
        lambda a: sp.acos(sp.tanh(a) / 2),
        lambda a: mpmath.acos(mpmath.tanh(a) / 2),
    ),
    Operation(
        2,
        lambda a, b: a.graph.call("atan2", a, 1 + b * b),
        lambda a, b: sp.atan2(a, 1 + b**2),
        lambda a, b: mpmath.atan2(a, 1 + b * b),
    ),
    Operation(
        2,
        lambda a, b: (1 + a * a) ** a.graph.call("sin", b),
        lambda a, b: (1 + a**2) ** sp.sin(b),
        lambda a, b: (1 + a * a) ** mpmath.sin(b),
    ),
)

KINKED = (
    function(1, "abs", sp.Abs, abs),
    function(2, "min", lambda a, b: sp.Min(a, b, evaluate=False), min),
    function(2, "max", lambda a, b: sp.Max(a, b, evaluate=False), max),
)

CHOICES = (
    Operation(
        2,
        _choice,
        lambda a, b: sp.Piecewise((a * b, sp.StrictLessThan(a, b, evaluate=False)), (a - b, True), evaluate=False),
        lambda a, b: a * b if a < b else a - b,
    ),
)
"""Apart, because SymPy's own Piecewise breaks on constants in a condition."""


def expressions(
    operations: tuple[Operation, ...] = SMOOTH + KINKED + CHOICES, size: int = 8
) -> st.SearchStrategy[Forms]:
    """Return random expressions of m (a parameter), x, y (coordinates) and u (a velocity)."""
    fractions = st.fractions(-3, 3, max_denominator=5)
    leaves = st.one_of(st.sampled_from(sorted(SYMBOLS)).map(leaf), fractions.map(constant))
    unary = [operation for operation in operations if operation.arity == 1]
    binary = [operation for operation in operations if operation.arity == 2]

    def grow(inner: st.SearchStrategy[Forms]) -> st.SearchStrategy[Forms]:
        return st.one_of(
            st.builds(combined, st.sampled_from(unary), inner),
            st.builds(combined, st.sampled_from(binary), inner, inner),
        )

    return st.recursive(leaves, grow, max_leaves=size)


def new_graph() -> tuple[Graph, dict[str, Node]]:
    graph = Graph()
    return graph, {name: graph.symbol(name, binding) for name, binding in BINDINGS.items()}


def evaluate(node: Node, at: Mapping[Node, Any]) -> Any:
    """Return the value of a node by mpmath from values of the symbols. Other branches are not evaluated."""
    table: dict[Node, Any] = dict(at)
    for step in reachable([node]):
        if step not in table:
            table[step] = _compute(step, [table[arg] for arg in step.args], table)
    return table[node]


def _compute(node: Node, args: list[Any], table: Mapping[Node, Any]) -> Any:
    if node.kind is Kind.CONSTANT:
        return mpmath.mpf(node.data.numerator) / node.data.denominator
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        terms = [_mp(c) * arg for c, arg in zip(coefficients, args, strict=True)]
        return mpmath.fsum([_mp(constant), *terms])
    if node.kind is Kind.PRODUCT:
        return mpmath.fprod(args)
    if node.kind is Kind.POWER:
        return _guarded(lambda: mpmath.power(args[0], _mp(node.data)))
    if node.kind is Kind.CALL:
        return _guarded(lambda: FUNCTIONS[node.data](*args))
    if node.kind is Kind.COMPONENT:
        factor = node.args[0].args[0]
        (n, *_), lower = factor.data, [table[arg] for arg in factor.args]
        matrix = mpmath.matrix(n, n)
        for i in range(n):
            for j in range(i + 1):
                matrix[i, j] = matrix[j, i] = lower[i * (i + 1) // 2 + j]
        return mpmath.lu_solve(matrix, mpmath.matrix([table[arg] for arg in node.args[0].args[1:]]))[node.data]
    return None


def _mp(value: int | Fraction) -> Any:
    return mpmath.mpf(value.numerator) / value.denominator


def _guarded(compute: Callable[[], Any]) -> Any:
    try:
        value = compute()
    except (ZeroDivisionError, ValueError):
        return mpmath.nan
    return value if not isinstance(value, mpmath.mpc) else mpmath.nan


def _piecewise(*args: Any) -> Any:
    for condition, value in zip(args[:-1:2], args[1::2], strict=True):
        if condition:
            return value
    return args[-1]


FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(mpmath, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log")},
    **{name: getattr(mpmath, name) for name in ("sinh", "cosh", "tanh", "sign", "asinh", "acosh", "atanh", "erf")},
    "abs": abs,
    "min": min,
    "max": max,
    "pow": mpmath.power,
    "pi": lambda: +mpmath.pi,
    "e": lambda: +mpmath.e,
    "nan": lambda: mpmath.nan,
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "equal": lambda a, b: a == b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "piecewise": _piecewise,
}
