"""Derivatives: reverse against forward against numerical differentiation, and nothing leaks from untaken branches."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import pytest
from hypothesis import given

from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.evaluate import values
from lagrange.graph.functions import CONDITIONS, FUNCTIONS
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from tests.graph.trees import SMOOTH, Forms, evaluate, expressions, new_graph

POINT = {"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"}


def two(graph: Graph) -> tuple[Node, Node]:
    return graph.symbol("x", Binding.CONFIGURATION), graph.symbol("y", Binding.CONFIGURATION)


def slope(f: Callable[..., Any], at: tuple[Any, ...], i: int) -> Any:
    """Return df/dx_i by central differences with two Richardson steps: error about 1e-36 at 60 digits."""

    def central(h: Any) -> Any:
        moved = [[*at[:i], at[i] + sign * h, *at[i + 1 :]] for sign in (1, -1)]
        return (f(*moved[0]) - f(*moved[1])) / (2 * h)

    h = mpmath.mpf(10) ** -7
    rows = [central(h / 2**k) for k in range(3)]
    finer = [(4 * rows[k + 1] - rows[k]) / 3 for k in range(2)]
    return (16 * finer[1] - finer[0]) / 15


@given(expressions(SMOOTH))
def test_gradient_and_tangents_agree_with_numerical_differentiation(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    names = sorted(symbols)
    reverse = gradient(node, [symbols[name] for name in names])
    with mpmath.workdps(60):
        at = tuple(mpmath.mpf(POINT[name]) for name in names)
        values = dict(zip((symbols[name] for name in names), at, strict=True))
        for i, name in enumerate(names):
            expected = slope(lambda *x: forms.value(dict(zip(names, x, strict=True))), at, i)
            forward = tangents([node], {symbols[name]: graph.one})(node)
            for found in (evaluate(reverse[i], values), evaluate(forward, values)):
                assert abs(found - expected) <= mpmath.mpf(10) ** -15 * (1 + abs(expected))


@given(expressions())
def test_reverse_equals_forward_with_kinks_and_choices_too(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    along = {"m": 3, "x": -2, "y": 5, "u": 7}
    with mpmath.workdps(50):
        values = {symbols[name]: mpmath.mpf(text) for name, text in POINT.items()}
        reverse = gradient(node, list(symbols.values()))
        weights = (along[name] for name in symbols)
        total = sum(weight * evaluate(part, values) for weight, part in zip(weights, reverse, strict=True))
        direction = {symbol: graph.constant(along[name]) for name, symbol in symbols.items()}
        forward = evaluate(tangents([node], direction)(node), values)
        assert abs(total - forward) <= mpmath.mpf(10) ** -25 * (1 + abs(forward))


ARGUMENTS: dict[str, tuple[str, ...]] = {
    "asin": ("0.4",),
    "acos": ("-0.3",),
    "acosh": ("1.7",),
    "log": ("2.3",),
    "atan2": ("-0.7", "-1.1"),
    "min": ("0.7", "1.9"),
    "max": ("0.7", "1.9"),
    "pow": ("1.3", "-0.6"),
}
CHOICES = ("min", "max", "piecewise")
ELEMENTARY = [name for name, function in FUNCTIONS.items() if function.partials or function.first]


@pytest.mark.parametrize("swapped", [False, True], ids=["", "swapped"])
@pytest.mark.parametrize("name", ELEMENTARY)
def test_every_rule_of_the_table(name: str, swapped: bool) -> None:
    graph = Graph()
    arity = FUNCTIONS[name].arity
    symbols = two(graph)[:arity]
    texts = ARGUMENTS.get(name, ("-0.8",))
    with mpmath.workdps(60):
        at = tuple(map(mpmath.mpf, texts[::-1] if swapped and name != "pow" else texts))
        node = graph.call(name, *symbols)
        values = dict(zip(symbols, at, strict=True))
        for i, symbol in enumerate(symbols):
            expected = slope(lambda *x: evaluate(node, dict(zip(symbols, x, strict=True))), at, i)
            assert abs(evaluate(gradient(node, [symbol])[0], values) - expected) < 1e-18
            assert abs(evaluate(tangents([node], {symbol: graph.one})(node), values) - expected) < 1e-18


def test_every_function_but_the_conditions_and_constants_has_a_rule_per_argument() -> None:
    for name, function in FUNCTIONS.items():
        if name in CONDITIONS or function.arity == 0 or name in CHOICES:  # choices go branch by branch, see below
            assert not function.partials
        else:
            assert len(function.partials) == function.arity


def derivatives(node: Node, symbol: Node, at: dict[Node, Any]) -> list[Any]:
    graph = node.graph
    outcome = (gradient(node, [symbol])[0], tangents([node], {symbol: graph.one})(node))
    return [evaluate(part, at) for part in outcome]


def test_derivatives_of_long_products_grow_with_their_length() -> None:
    sizes = []
    for length in (300, 600):
        graph = Graph()
        x, y = two(graph)
        factors = [graph.call("cos", graph.sum([(Fraction(1, k + 1), x)])) for k in range(length)]
        whole = graph.product([y, *factors])
        slopes = gradient(whole, (x, y))
        sizes.append(sum(len(node.args) for node in reachable(slopes)))
        point = {x: mpmath.mpf("0.02"), y: mpmath.mpf("1.5")}
        found = values([*slopes, whole], point, mpmath.mp)
        assert found is not None
        by_x, by_y, value = found[0]
        assert mpmath.almosteq(by_y * point[y], value, 1e-13)
        tangent = -sum(mpmath.tan(point[x] / (k + 1)) / (k + 1) for k in range(length))
        assert mpmath.almosteq(by_x, value * tangent, 1e-13)
    assert sizes[1] < 2.2 * sizes[0]


def test_nothing_leaks_from_the_branch_not_taken() -> None:
    graph = Graph()
    x, y = two(graph)
    at_zero = graph.call("equal", x, graph.zero)
    safe = graph.piecewise([(at_zero, y**2)], 1 / x + graph.call("log", x))
    assert derivatives(safe, x, {x: mpmath.mpf(0), y: mpmath.mpf(3)}) == [0, 0]
    assert derivatives(safe, y, {x: mpmath.mpf(0), y: mpmath.mpf(3)}) == [6, 6]
    assert derivatives(safe, x, {x: mpmath.mpf(2), y: mpmath.mpf(3)}) == [0.25, 0.25]
    deep = graph.call("exp", safe * graph.call("sin", safe)) * 3
    assert all(map(mpmath.isfinite, derivatives(deep, y, {x: mpmath.mpf(0), y: mpmath.mpf(3)})))


def test_nothing_leaks_through_choices_inside_choices() -> None:
    graph = Graph()
    x, y = two(graph)
    positive = graph.call("less", graph.zero, x)
    root = graph.piecewise([(positive, x ** Fraction(1, 2))], graph.zero)
    outer = graph.piecewise([(graph.call("less", y, graph.zero), 1 / y + root)], root * y)
    at = {x: mpmath.mpf(0), y: mpmath.mpf(0)}
    assert derivatives(outer, x, at) == [0, 0]
    assert derivatives(outer, y, at) == [0, 0]


@pytest.mark.parametrize("name", ["min", "max"])
def test_nothing_leaks_from_the_side_that_min_and_max_drop(name: str) -> None:
    graph = Graph()
    x, y = two(graph)
    sign = 1 if name == "min" else -1
    infinite = sign / x**2  # min(1/x^2, y) at x = 0 is y, max(-1/x^2, y) as well
    for node in (graph.call(name, infinite, y), graph.call(name, y, infinite)):
        # What a division by zero gives on a machine; the reference would stop at it.
        at = {x: mpmath.mpf(0), y: mpmath.mpf(3), infinite: sign * mpmath.inf}
        for part in (gradient(node, [x])[0], tangents([node], {x: graph.one})(node)):
            assert evaluate(part, at | {x**-3: mpmath.inf}) == 0
        assert derivatives(node, y, at) == [1, 1]


def test_the_derivative_is_undefined_where_the_expression_is() -> None:
    graph = Graph()
    x, _ = two(graph)
    bounded = graph.piecewise([(graph.call("less", x, graph.one), x**2)])
    assert derivatives(bounded, x, {x: mpmath.mpf("0.5")}) == [1, 1]
    assert all(mpmath.isnan(part) for part in derivatives(bounded, x, {x: mpmath.mpf(2)}))
    flat = graph.piecewise([(graph.call("less", x, graph.one), graph.constant(4))])
    assert all(mpmath.isnan(part) for part in derivatives(flat, x, {x: mpmath.mpf(2)}))


def test_a_coordinate_may_be_called_nan() -> None:
    graph = Graph()
    x, nan = graph.symbol("x", Binding.CONFIGURATION), graph.symbol("nan", Binding.CONFIGURATION)
    node = graph.piecewise([(graph.call("less", x, graph.zero), x)], nan)
    assert derivatives(node, nan, {x: mpmath.mpf(1), nan: mpmath.mpf(5)}) == [1, 1]


def test_what_does_not_depend_has_the_zero_node_as_its_derivative() -> None:
    graph = Graph()
    x, y = two(graph)
    assert gradient(graph.call("sin", x), [y]) == [graph.zero]
    assert tangents([x * 3], {y: graph.one})(x * 3) is graph.zero
    assert gradient(graph.one, [x]) == [graph.zero]
    assert gradient(graph.call("sign", x) + y, [x, y]) == [graph.zero, graph.one]


def test_derivatives_come_out_simple() -> None:
    graph = Graph()
    x, y = two(graph)
    assert gradient(x * y**2, [x, y]) == [y**2, 2 * (x * y)]
    assert gradient(x ** Fraction(1, 2), [x]) == [x ** Fraction(-1, 2) * Fraction(1, 2)]
    assert tangents([x * y], {x: y})(x * y) is y**2


def test_a_gradient_costs_a_small_multiple_of_its_function() -> None:
    graph = Graph()
    symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(60)]
    total = graph.zero
    for a, b in itertools.pairwise(symbols):
        total = total + graph.call("sin", a * b) * graph.call("exp", total / 100)
    size = len(reachable([total]))
    assert len(reachable(gradient(total, symbols))) < 5 * size


def test_the_tangent_of_a_solution_solves_again_with_the_same_factors() -> None:
    graph = Graph()
    x, y = two(graph)
    matrix = [[2 + x**2, x * y], [x * y, 3 + graph.call("cos", y)]]
    solution = graph.solve(matrix, [graph.call("sin", x), x + y**3])
    with mpmath.workdps(60):
        at = (mpmath.mpf("0.7"), mpmath.mpf("-1.3"))
        for i, symbol in enumerate((x, y)):
            along = tangents(solution, {symbol: graph.one})
            for unknown in solution:
                expected = slope(lambda *p, u=unknown: evaluate(u, {x: p[0], y: p[1]}), at, i)
                assert abs(evaluate(along(unknown), dict(zip((x, y), at, strict=True))) - expected) < 1e-18
            factors = [node for node in reachable([along(u) for u in solution]) if node.kind is Kind.FACTOR]
            assert len(factors) == 1
