"""Nodes: interning, what is simplified on the spot and what is not, exact constants, binding times, refusals."""

from __future__ import annotations

import math
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import mpmath
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Graph, Kind, Node, exact, reachable
from tests.graph.trees import BINDINGS, Forms, evaluate, expressions, new_graph

POINTS = (
    {"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"},
    {"m": "0.4", "x": "-1.9", "y": "0.57", "u": "-0.26"},
)


@pytest.fixture
def g() -> Graph:
    return Graph()


def leaves(graph: Graph, names: str) -> list[Node]:
    return [graph.symbol(name, Binding.CONFIGURATION) for name in names.split()]


@given(expressions())
def test_a_node_has_the_value_of_what_it_was_built_from(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    with mpmath.workdps(60):
        for point in POINTS:
            at = {name: mpmath.mpf(text) for name, text in point.items()}
            expected = forms.value(at)
            found = evaluate(node, {symbols[name]: value for name, value in at.items()})
            assert abs(found - expected) <= mpmath.mpf(10) ** -22 * (1 + abs(expected))


@given(expressions())
def test_the_same_expression_is_the_same_node(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    count = len(graph.nodes)
    assert forms.node(graph, symbols) is node
    assert len(graph.nodes) == count


@given(expressions())
def test_arguments_are_older_and_ids_are_positions(forms: Forms) -> None:
    graph, symbols = new_graph()
    forms.node(graph, symbols)
    assert [node.id for node in graph.nodes] == list(range(len(graph.nodes)))
    assert all(arg.id < node.id for node in graph.nodes for arg in node.args)


@given(expressions())
def test_binding_and_dependence_are_those_of_the_symbols_below(forms: Forms) -> None:
    graph, symbols = new_graph()
    forms.node(graph, symbols)
    for node in graph.nodes:
        below = [step for step in reachable([node]) if step.kind is Kind.SYMBOL]
        assert node.binding == max((BINDINGS[step.data] for step in below), default=Binding.CONSTANT)
        assert node.depends == sum(step.depends for step in below)


@given(expressions())
def test_no_node_has_a_shape_that_the_constructors_take_apart(forms: Forms) -> None:
    graph, symbols = new_graph()
    forms.node(graph, symbols)
    for node in graph.nodes:
        if node.kind is Kind.SUM:
            constant, coefficients = node.data
            assert all(coefficients) and len(set(node.args)) == len(node.args)
            assert (constant or len(node.args) > 1 or coefficients != (1,)) and node.args
            assert not any(arg.kind is Kind.CONSTANT for arg in node.args)
        if node.kind is Kind.PRODUCT:
            assert len(node.args) > 1
            assert not any(arg.kind in (Kind.CONSTANT, Kind.PRODUCT) for arg in node.args)
            assert [arg.binding for arg in node.args] == sorted(arg.binding for arg in node.args)
        if node.kind is Kind.POWER:
            assert node.data not in (0, 1)


def test_terms_and_factors_merge_in_any_order(g: Graph) -> None:
    x, y, z = leaves(g, "x y z")
    assert x + y + z is z + (y + x) or (x + y + z).kind is Kind.SUM  # nested sums keep their sharing
    assert g.sum([(1, x), (2, y), (3, z)]) is g.sum([(3, z), (1, x), (2, y)])
    assert (x * y) * z is z * (y * x) is y * (z * x)
    assert x + x is 2 * x
    assert x * x * x is x**3
    assert x * x ** Fraction(1, 2) is x ** Fraction(3, 2)
    assert x - x is g.zero
    assert x / x is g.one
    assert 2 * (3 * x) is 6 * x
    assert (2 * x) * (3 * y) is 6 * (x * y)
    mirrored = -x
    assert -mirrored is x
    assert x - y is -(y - x)
    assert (x * y) ** 2 is x**2 * y**2
    assert (x**2) ** 3 is x**6
    assert (2 * x) ** 3 is 8 * x**3
    assert 0 * x is g.zero and 1 * x is x and x + 0 is x and x**1 is x and x**0 is g.one


def test_common_factors_and_scales_come_out_of_a_sum(g: Graph) -> None:
    x, y, z = leaves(g, "x y z")
    assert x * y + x * z is x * (y + z)
    assert 3 * x + 3 * y is 3 * (x + y)
    assert 2 * (x * z) - 2 * (y * z) is 2 * (z * (x - y))
    assert (x * y + x * z).kind is Kind.PRODUCT


def test_squares_of_sine_and_cosine_join(g: Graph) -> None:
    x, y = leaves(g, "x y")
    s, c = g.call("sin", x), g.call("cos", x)
    assert s**2 + c**2 is g.one
    assert 3 * s**2 * y + 3 * c**2 * y is 3 * y
    assert g.sum([(2, s**2), (2, c**2), (1, y)], 5) is y + 7
    assert g.sum([(1, s**2 * y), (1, c**2 * y), (-1, y)]) is g.zero
    assert s**2 + g.call("cos", y) ** 2 is not g.one


whole = st.integers(-3, 3)


@given(st.lists(st.tuples(whole, st.integers(0, 3), st.integers(0, 3), st.integers(0, 2)), max_size=7), whole)
def test_sums_of_powers_of_sine_and_cosine_keep_their_value(
    terms: list[tuple[int, int, int, int]], constant: int
) -> None:
    graph = Graph()
    x, y = leaves(graph, "x y")
    s, c = graph.call("sin", x), graph.call("cos", x)
    node = graph.sum([(k, s**i * c**j * y**n) for k, i, j, n in terms], constant)
    a, b = mpmath.mpf("0.7"), mpmath.mpf("1.3")
    expected = constant + sum(k * mpmath.sin(a) ** i * mpmath.cos(a) ** j * b**n for k, i, j, n in terms)
    assert abs(evaluate(node, {x: a, y: b}) - expected) < 1e-12


def test_a_square_root_of_a_square_is_the_absolute_value(g: Graph) -> None:
    (x,) = leaves(g, "x")
    m = g.symbol("m", Binding.PARAMETER)
    size = g.call("abs", x)
    assert (x**2) ** Fraction(1, 2) is size and evaluate(size, {x: mpmath.mpf(-3)}) == 3
    assert (x**2) ** Fraction(3, 2) is size**3 and (x**6) ** Fraction(1, 4) is size ** Fraction(3, 2)
    assert (x**-2) ** Fraction(1, 2) is 1 / size and size**2 is x**2 and size**-4 is x**-4
    assert (4 * m * x**2) ** Fraction(1, 2) is g.constant(4) ** Fraction(1, 2) * m ** Fraction(1, 2) * size
    for other in (x**3, -(x**2), x**2 + 1, x * x**2):
        root = other ** Fraction(1, 2)
        assert root.kind is Kind.POWER and root.args == (other,)


def test_even_and_odd_functions_share_the_node_of_the_opposite_argument(g: Graph) -> None:
    (x,) = leaves(g, "x")
    for even in ("cos", "cosh", "abs"):
        assert g.call(even, -2 * x) is g.call(even, 2 * x)
    for odd in ("sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "erf", "sign"):
        assert g.call(odd, -2 * x) is -g.call(odd, 2 * x)
    for neither in ("exp", "acos"):
        assert g.call(neither, -x) is not g.call(neither, x)


def test_constants_are_exact(g: Graph) -> None:
    tenth = g.constant(Fraction(1, 10))
    assert g.sum([(1, tenth)] * 10) is g.one
    assert g.constant(0.1).data == Fraction(0.1) != Fraction(1, 10)
    assert g.constant(2.0) is g.constant(2)
    assert g.constant(Fraction(1, 3)) * 3 is g.one
    assert (g.constant(3) ** -2).data == Fraction(1, 9)
    assert exact(Fraction(4, 2)) == 2 and isinstance(exact(Fraction(4, 2)), int)
    assert g.call("abs", g.constant(Fraction(-1, 3))).data == Fraction(1, 3)
    assert g.call("max", g.constant(2), g.constant(Fraction(5, 2))).data == Fraction(5, 2)
    assert g.call("sign", g.constant(-7)).data == -1
    assert g.call("cos", g.zero) is g.one and g.call("log", g.one) is g.zero
    assert g.call("sin", g.one).kind is Kind.CALL  # not a double in disguise


@given(st.fractions(max_denominator=50), st.integers(-6, 6))
def test_powers_of_constants_are_exact(base: Fraction, exponent: int) -> None:
    graph = Graph()
    if base == 0 and exponent < 0:
        with pytest.raises(StatementError, match="divides by zero"):
            graph.constant(base) ** exponent
    else:
        assert (graph.constant(base) ** exponent).data == base**exponent


def test_symbols_are_known_by_name_and_bind_when_they_say(g: Graph) -> None:
    m = g.symbol("m", Binding.PARAMETER)
    time = g.symbol("t", Binding.TIME)
    (x,) = leaves(g, "x")
    assert g.symbol("m", Binding.PARAMETER) is m
    assert (m * 3 + 1).binding is Binding.PARAMETER
    assert (m * time).binding is Binding.TIME
    assert (m * time * x).binding is Binding.CONFIGURATION
    assert (m * x).depends == m.depends | x.depends and not m.depends & x.depends


def test_products_put_what_is_known_early_in_front(g: Graph) -> None:
    v, x, m = g.symbol("v", Binding.VELOCITY), *leaves(g, "x"), g.symbol("m", Binding.PARAMETER)
    assert (v * x * m).args == (m, x, v)


def test_a_choice_between_equals_is_no_choice(g: Graph) -> None:
    x, y = leaves(g, "x y")
    assert g.piecewise([(g.call("less", x, y), x)], x) is x
    assert g.piecewise([(g.call("less", x, y), x)]).args[-1].data == "nan"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_constant_is_finite(g: Graph, value: float) -> None:
    with pytest.raises(StatementError, match=rf"contains {value}, which is not a finite number"):
        g.constant(value)


def test_division_by_the_constant_zero_is_refused(g: Graph) -> None:
    (x,) = leaves(g, "x")
    with pytest.raises(StatementError, match="divides by zero"):
        x / 0


def test_powers_out_of_range_are_refused_and_not_computed(g: Graph) -> None:
    with pytest.raises(StatementError, match=r"2\*\*999999999 is out of range"):
        g.constant(2) ** 999999999
    assert g.constant(-1) ** 999999999 is g.constant(-1)


def test_a_function_gets_its_number_of_arguments(g: Graph) -> None:
    (x,) = leaves(g, "x")
    with pytest.raises(StatementError, match="atan2 takes 2 arguments, not 1"):
        g.call("atan2", x)


def test_solving_with_one_unknown_is_a_division_and_with_more_a_factorization(g: Graph) -> None:
    a, b, c, x, y = leaves(g, "a b c x y")
    assert g.solve([[a]], [x]) == [x / a]
    first = g.solve([[a, b], [b, c]], [x, y])
    again = g.solve([[a, b], [b, c]], [y, x])
    assert [node.kind for node in first] == [Kind.COMPONENT, Kind.COMPONENT]
    assert first[0].args[0].args[0] is again[0].args[0].args[0]  # one factorization for both
    assert g.solve([[a, b], [b, c]], [g.zero, g.zero]) == [g.zero, g.zero]
    at = dict(zip((a, b, c, x, y), map(mpmath.mpf, (2, 1, 3, 5, 10)), strict=True))
    assert abs(evaluate(first[0], at) - 1) < 1e-12 and abs(evaluate(first[1], at) - 3) < 1e-12


def test_reachable_keeps_to_a_mask_and_stops_at_what_is_held(g: Graph) -> None:
    x, y, z = leaves(g, "x y z")
    inner = g.call("sin", x * y)
    outer = g.call("exp", inner + z)
    assert reachable([outer], z.depends)[0] is z
    assert inner not in reachable([outer], z.depends)
    held = reachable([outer], held=[inner])
    assert inner not in held and x not in held and z in held
    order = [node.id for node in reachable([outer])]
    assert order == sorted(order)


def test_threads_that_build_at_once_share_nodes() -> None:
    """Members of an ensemble run on threads, which build what a method needs from the graph of one model."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(20):
            graph, gate = Graph(), threading.Barrier(4)

            def build(graph: Graph = graph, gate: threading.Barrier = gate) -> list[Node]:
                gate.wait()
                symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(20)]
                return [*symbols, *(a * b + 1 for a in symbols for b in symbols[:4])]

            with ThreadPoolExecutor(4) as pool:
                first, *others = [future.result() for future in [pool.submit(build) for _ in range(4)]]
            assert all(a is b for other in others for a, b in zip(first, other, strict=True))
            assert [node.id for node in graph.nodes] == list(range(len(graph.nodes)))
            assert len({node.depends for node in first[:20]}) == 20
    finally:
        sys.setswitchinterval(interval)
