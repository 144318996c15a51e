"""Random expressions in three forms (graph nodes, SymPy and mpmath), and a simple evaluator of nodes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import mpmath
import sympy as sp
from hypothesis import strategies as st

from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from tests.operations import operations

SYMBOLS = {name: sp.Symbol(name, real=True) for name in ("m", "x", "y", "u")}
BINDINGS = {"m": Binding.PARAMETER, "x": Binding.CONFIGURATION, "y": Binding.CONFIGURATION, "u": Binding.VELOCITY}


@dataclass(frozen=True)
class Library:
    """One form of expressions: its numbers, and its functions by name, such as `library.sin(x)`."""

    number: Callable[[Fraction], Any]
    call: Callable[..., Any]

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(self.call, name)


@dataclass(frozen=True)
class Forms:
    """One expression, which a library builds from its leaves."""

    build: Callable[[Library, Mapping[str, Any]], Any]

    def node(self, graph: Graph, leaves: Mapping[str, Node]) -> Node:
        def call(name: str, *args: Node) -> Node:
            return graph.piecewise([(args[0], args[1])], args[2]) if name == "piecewise" else graph.call(name, *args)

        node: Node = self.build(Library(graph.constant, call), leaves)
        return node

    def sympy(self) -> Any:
        return self.build(SYMPY, SYMBOLS)

    def value(self, at: Mapping[str, Any]) -> Any:
        return self.build(MPMATH, at)


@dataclass(frozen=True)
class Operation:
    """One operation on expressions: (library, *arguments) -> expression."""

    arity: int
    build: Callable[..., Any]


def constant(value: Fraction) -> Forms:
    return Forms(lambda library, leaves: library.number(value))


def leaf(name: str) -> Forms:
    return Forms(lambda library, leaves: leaves[name])


def combined(operation: Operation, *args: Forms) -> Forms:
    return Forms(lambda library, leaves: operation.build(library, *(arg.build(library, leaves) for arg in args)))


SMOOTH = (
    Operation(2, lambda f, a, b: a + b),
    Operation(2, lambda f, a, b: a - b),
    Operation(2, lambda f, a, b: a * b),
    Operation(2, lambda f, a, b: a / (2 + b * b)),
    Operation(1, lambda f, a: a**2),
    Operation(1, lambda f, a: a**3),
    Operation(1, lambda f, a: -a),
    *(
        Operation(1, lambda f, a, e=Fraction(*pair): (1 + a * a) ** f.number(e))
        for pair in ((1, 2), (-1, 2), (3, 2), (-1, 1), (1, 3), (-5, 2))
    ),
    *(Operation(1, lambda f, a, name=name: f.call(name, a)) for name in ("sin", "cos", "atan", "tanh", "asinh", "erf")),
    Operation(1, lambda f, a: f.atanh(f.sin(a) / 2)),
    Operation(1, lambda f, a: f.acosh(2 + a * a)),
    Operation(1, lambda f, a: f.exp(f.sin(a))),
    Operation(1, lambda f, a: f.log(1 + a * a)),
    Operation(1, lambda f, a: f.asin(f.sin(a) / 2)),
    Operation(1, lambda f, a: f.acos(f.tanh(a) / 2)),
    Operation(2, lambda f, a, b: f.atan2(a, 1 + b * b)),
    Operation(2, lambda f, a, b: (1 + a * a) ** f.sin(b)),
)

KINKED = (
    Operation(1, lambda f, a: f.abs(a)),
    Operation(2, lambda f, a, b: f.min(a, b)),
    Operation(2, lambda f, a, b: f.max(a, b)),
)

CHOICES = (Operation(2, lambda f, a, b: f.piecewise(f.less(a, b), a * b, a - b)),)
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


FUNCTIONS: dict[str, Callable[..., Any]] = operations(mpmath) | {
    "pow": mpmath.power,
    "pi": lambda: +mpmath.pi,
    "e": lambda: +mpmath.e,
    "nan": lambda: mpmath.nan,
    "piecewise": _piecewise,
}
KEPT = {name: partial(build, evaluate=False) for name, build in (("min", sp.Min), ("max", sp.Max), ("less", sp.Lt))}
SPELLED = {"abs": sp.Abs, "piecewise": lambda c, a, b: sp.Piecewise((a, c), (b, True), evaluate=False)} | KEPT

MPMATH = Library(_mp, lambda name, *args: FUNCTIONS[name](*args))
SYMPY = Library(
    lambda x: sp.Rational(x.numerator, x.denominator),
    lambda name, *args: (SPELLED.get(name) or getattr(sp, name))(*args),
)
