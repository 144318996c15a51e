"""Nodes: interning, simplification by constructors, exact constants, binding times, refusals."""

import math
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient
from lagrange.graph.evaluate import FUNCTIONS as VALUED
from lagrange.graph.evaluate import generic_rank, precise, term_sizes, values
from lagrange.graph.node import Binding, Graph, Kind, Node, exact, reachable, share_sums
from lagrange.graph.sympy_nodes import Translator
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.program.lower import lower
from lagrange.statement.vocabulary.functions import FUNCTIONS
from tests.graph.trees import BINDINGS, Forms, evaluate, expressions, new_graph

POINTS = ({"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"}, {"m": "0.4", "x": "-1.9", "y": "0.57", "u": "-0.26"})


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
            result = evaluate(node, {symbols[name]: value for name, value in at.items()})
            assert abs(result - expected) <= mpmath.mpf(10) ** -22 * (1 + abs(expected))


@given(expressions())
def test_the_same_expression_is_the_same_node(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    count = len(graph.nodes)
    assert forms.node(graph, symbols) is node
    assert len(graph.nodes) == count


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


@pytest.mark.parametrize(
    ("build", "message"),
    [
        *((lambda g, x, c=c: g.constant(c), f"contains {c}, which is not a finite") for c in (math.nan, -math.inf)),
        (lambda g, x: x / 0, "divides by zero"),
        (lambda g, x: g.constant(2) ** 999999999, r"2\*\*999999999 is out of range"),
        (lambda g, x: g.call("atan2", x), "atan2 takes 2 arguments, not 1"),
    ],
)
def test_what_is_no_node_is_refused(g: Graph, build: Callable[[Graph, Node], Node], message: str) -> None:
    with pytest.raises(StatementError, match=message):
        build(g, *leaves(g, "x"))


def test_powers_of_minus_one_and_choices_between_equals_are_simple(g: Graph) -> None:
    x, y = leaves(g, "x y")
    assert g.constant(-1) ** 999999999 is g.constant(-1)
    assert g.piecewise([(g.call("less", x, y), x)], x) is x
    assert g.piecewise([(g.call("less", x, y), x)]).args[-1].data == "nan"


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
    held = reachable([outer], excluded=[inner])
    assert inner not in held and x not in held and z in held
    order = [node.id for node in reachable([outer])]
    assert order == sorted(order)


def test_threads_that_build_at_once_share_nodes() -> None:
    """Members of an ensemble run on threads, which add nodes to the graph of one model."""
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


# --- generic --------------------------------------------------------------------------------------------------
# The rank of matrices of nodes at almost every point.


@pytest.mark.parametrize("seed", range(30))
def test_a_product_has_the_rank_of_its_thinner_factor(seed: int) -> None:
    """The product A B of n x r and r x m matrices of random polynomials has the rank min(n, m, r)."""
    rng, graph = np.random.default_rng(seed), Graph()
    n, m, r = (int(count) for count in rng.integers(1, 6, 3))
    symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(40)]

    def entry() -> Node:
        a, b, c = (symbols[k] for k in rng.choice(40, 3, replace=False))
        return graph.sum([(int(rng.integers(1, 9)), a * b), (Fraction(int(rng.integers(1, 9)), 7), 1 / c)])

    left = [[entry() for _ in range(r)] for _ in range(n)]
    right = [[entry() for _ in range(m)] for _ in range(r)]
    whole = [[graph.sum([(1, left[i][k] * right[k][j]) for k in range(r)]) for j in range(m)] for i in range(n)]
    assert generic_rank(whole) == min(n, m, r)


def test_sine_and_cosine_of_an_angle_are_on_a_circle_and_other_functions_are_free() -> None:
    graph = Graph()
    a, b = (graph.symbol(name, Binding.CONFIGURATION) for name in "ab")
    c, s = graph.call("cos", a), graph.call("sin", a)
    assert generic_rank([[c * c, c * s], [c * s, s * s]]) == 1
    assert generic_rank([[c, s], [-s, c]]) == 2
    # 1 - s**2 - c**2 with the sum kept apart by a square root that is not a polynomial.
    root = graph.power(1 - s * s, Fraction(1, 2))
    assert generic_rank([[root, c], [c, root]]) == 2
    assert generic_rank([[c, graph.call("cos", b)], [2 * c, 2 * graph.call("cos", b)]]) == 1
    assert generic_rank([[graph.zero, graph.zero], [graph.zero, graph.zero]]) == 0
    assert generic_rank([[1 / a, 1 / b], [b, a]]) == 1


# --- term size ------------------------------------------------------------------------------------------------
# The sizes of the terms of an expression.

x, y, l = sp.symbols("x y l", real=True)
AT = {x: -0.3, y: 1.7, l: 2.0}


def values_of(*expressions: sp.Expr) -> list[float]:
    """Return the sizes and the values of expressions at the state above."""
    graph = Graph()
    leaves = {name: graph.symbol(str(name), Binding.CONFIGURATION) for name in AT}
    nodes: list[Node] = [Translator(graph, leaves)(item) for item in expressions]
    time = graph.symbol("t", Binding.TIME)
    program = lower("sizes", {"all": [*term_sizes(nodes), *nodes]}, {"q": list(leaves.values())}, time, ())
    result = FLOATS.evaluate(program, 0.0, list(AT.values()), [])
    return list(map(float, result))


@pytest.mark.parametrize(
    ("stated", "size"),
    [
        (x**2 + y**2 - l**2, 0.09 + 2.89 + 4.0),
        (3 * (x - y), 3 * 2.0),
        ((x - y) * (x + l), 2.0 * 2.3),
        ((x - y) ** 3, 8.0),
        (sp.sqrt(x**2 + y**2) - l, np.sqrt(0.09 + 2.89) + 2.0),
        (l * sp.sin(x) - y * sp.cos(x - y), 2.0 + 1.7),
        (sp.Abs(x - y), 2.0),
        (1 / x, 1 / 0.3),
        (sp.exp(x) - 1, np.exp(-0.3) + 1),
        (sp.atan2(y, x) - l, np.arctan2(1.7, -0.3) + 1 + 2.0),
        (sp.Max(x - y, l), 2.0),
        (sp.Piecewise((x - y, x < 0), (l, True)), 2.0),
    ],
)
def test_sizes_add_where_terms_add_and_multiply_where_factors_do(stated: sp.Expr, size: float) -> None:
    result, value = values_of(stated)
    assert result == pytest.approx(size, rel=1e-14)
    assert abs(value) <= result * (1 + 1e-15)


def test_a_term_with_a_sine_counts_at_every_angle() -> None:
    """A term with a sine counts also at angles where the sine is zero."""
    (result, *_) = values_of(l * sp.sin(x - sp.Rational(-3, 10)))
    assert result == 2.0


# --- evaluate -------------------------------------------------------------------------------------------------
# Values of nodes in many digits: every function of the graph has one, and what has none is told apart.

CONTEXT = precise(40)


def test_every_function_has_a_value() -> None:
    assert set(FUNCTIONS) - {"piecewise"} <= set(VALUED)


def test_values_and_the_largest_number() -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    wave = graph.call("sin", x) ** 2 * 3 - graph.call("exp", x) / 7
    branch = graph.piecewise([(graph.call("less", x, graph.constant(2)), wave)], x)
    result = values([wave, branch, x**-1], {x: CONTEXT.mpf("1.5")}, CONTEXT)
    assert result is not None
    expected = 3 * math.sin(1.5) ** 2 - math.exp(1.5) / 7
    assert [float(value) for value in result[0]] == pytest.approx([expected, expected, 1 / 1.5], rel=1e-14)
    assert float(result[1]) >= math.exp(1.5)


@pytest.mark.parametrize("value", [0, -2])
def test_what_has_no_value(value: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    assert values([graph.call("log", x)], {x: CONTEXT.mpf(value)}, CONTEXT) is None


# --- share ----------------------------------------------------------------------------------------------------
# Sums in terms of the sums they contain: the same values, and a chain of links becomes linear in its length.


@given(
    st.lists(st.dictionaries(st.integers(0, 6), st.integers(-4, 4).filter(bool), min_size=2), min_size=2, max_size=7)
)
def test_overlapping_sums_with_coefficients_keep_their_values(sums: list[dict[int, int]]) -> None:
    graph = Graph()
    symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(7)]
    nodes = [graph.sum([(c, symbols[i]) for i, c in terms.items()], k) for k, terms in enumerate(sums)]
    product = graph.product([graph.call("sin", node) for node in nodes])
    at = {symbol: mpmath.mpf(i * i + 1) for i, symbol in enumerate(symbols)}
    outputs = share_sums(graph, [*nodes, product])
    for new, terms, k in zip(outputs, sums, range(len(sums)), strict=False):
        assert evaluate(new, at) == k + sum(c * (i * i + 1) for i, c in terms.items())
    assert abs(evaluate(outputs[-1], at) - evaluate(product, at)) < 1e-12


def chain(n: int) -> tuple[Graph, list[Node], Node]:
    """Return L of n links, stated as SymPy flattens it: the k-th position is a sum of k terms."""
    graph = Graph()
    angles, rates = sp.symbols(f"a:{n}"), sp.symbols(f"w:{n}")
    leaves = {a: graph.symbol(a.name, Binding.CONFIGURATION) for a in angles}
    leaves |= {w: graph.symbol(w.name, Binding.VELOCITY) for w in rates}
    total = []
    for k in range(1, n + 1):
        vx = sp.Add(*(sp.cos(a) * w for a, w in zip(angles[:k], rates, strict=False)))
        vy = sp.Add(*(sp.sin(a) * w for a, w in zip(angles[:k], rates, strict=False)))
        total += [vx**2 / 2, vy**2 / 2, sp.Add(*map(sp.cos, angles[:k]))]
    return graph, list(leaves.values()), Translator(graph, leaves)(sp.Add(*total))


def work(nodes: Sequence[Node]) -> int:
    return sum(len(node.args) for node in reachable(nodes))


def test_a_chain_becomes_linear_in_its_length_with_its_gradient() -> None:
    sizes = {}
    for n in (10, 20, 40):
        graph, symbols, node = chain(n)
        (shared,) = share_sums(graph, [node])
        sizes[n] = (work([shared]), work(gradient(shared, symbols)))
    for first, second, third in zip(*sizes.values(), strict=True):
        assert third - second < 2.2 * (second - first)  # linear: equal growth for the doubled length would be 2
    unshared = chain(40)[2]
    assert work([unshared]) > 3 * sizes[40][0]


def test_the_longest_contained_sum_is_taken_and_signs_count() -> None:
    graph = Graph()
    a, b, c, d = (graph.symbol(name, Binding.CONFIGURATION) for name in "abcd")
    short, long = a + b, graph.sum([(1, a), (1, b), (1, c)])
    whole = graph.sum([(2, a), (2, b), (2, c), (5, d)])
    opposite = graph.sum([(1, a), (-1, b), (1, d)])
    outputs = share_sums(graph, [short, long, whole, opposite])
    assert outputs[1].args == tuple(sorted((short, c), key=lambda node: node.id))
    assert outputs[2] is graph.sum([(2, outputs[1]), (5, d)])
    assert outputs[3] is opposite  # a - b is not a + b


def test_what_shares_nothing_comes_back_untouched() -> None:
    graph = Graph()
    a, b, c = (graph.symbol(name, Binding.CONFIGURATION) for name in "abc")
    nodes = [graph.call("sin", a * b), a + b, b * c + 1]
    assert all(new is old for new, old in zip(share_sums(graph, nodes), nodes, strict=True))


def test_sharing_reaches_into_choices_and_functions() -> None:
    graph = Graph()
    a, b, c = (graph.symbol(name, Binding.CONFIGURATION) for name in "abc")
    short, long = a + b, graph.sum([(1, a), (1, b), (1, c)])
    inside = graph.piecewise([(graph.call("less", long, short), graph.call("exp", long))], long**2)
    _, rebuilt = share_sums(graph, [short, inside])
    sums = [node for node in reachable([rebuilt]) if node.kind is Kind.SUM]
    assert all(len(node.args) <= 2 for node in sums)
