"""The rank of matrices of nodes at almost every point."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from lagrange.graph.generic import generic_rank
from lagrange.graph.node import Binding, Graph, Node


@pytest.mark.parametrize("seed", range(30))
def test_a_product_has_the_rank_of_its_thinner_factor(seed: int) -> None:
    """A B of n x r and r x m random polynomials has the rank min(n, m, r)."""
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
