"""Sums in terms of the sums they contain: the same values, and a chain of links becomes linear in its length."""

from __future__ import annotations

from collections.abc import Sequence

import mpmath
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from lagrange.graph.differentiate import gradient
from lagrange.graph.from_sympy import Translator
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.graph.share import share_sums
from tests.graph.trees import Forms, evaluate, expressions, new_graph

POINT = {"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"}


@given(st.lists(expressions(), min_size=1, max_size=3))
def test_values_are_kept(forms: list[Forms]) -> None:
    graph, symbols = new_graph()
    nodes = [form.node(graph, symbols) for form in forms]
    with mpmath.workdps(50):
        at = {symbols[name]: mpmath.mpf(text) for name, text in POINT.items()}
        for new, old in zip(share_sums(graph, nodes), nodes, strict=True):
            expected = evaluate(old, at)
            assert abs(evaluate(new, at) - expected) <= mpmath.mpf(10) ** -25 * (1 + abs(expected))


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
