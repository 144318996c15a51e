"""The sizes of the terms of an expression."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from lagrange.graph.from_sympy import Translator
from lagrange.graph.node import Binding, Graph, Node
from lagrange.graph.term_size import term_sizes
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.program.lower import lower

x, y, l = sp.symbols("x y l", real=True)
AT = {x: -0.3, y: 1.7, l: 2.0}


def values_of(*expressions: sp.Expr) -> list[float]:
    """Return the size of each expression, then its value, at the state above."""
    graph = Graph()
    leaves = {name: graph.symbol(str(name), Binding.CONFIGURATION) for name in AT}
    nodes: list[Node] = [Translator(graph, leaves)(one) for one in expressions]
    time = graph.symbol("t", Binding.TIME)
    program = lower("sizes", {"all": [*term_sizes(nodes), *nodes]}, {"q": list(leaves.values())}, time, ())
    found = FLOATS.evaluate(program, 0.0, list(AT.values()), [])
    return list(map(float, found))


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
    found, value = values_of(stated)
    assert found == pytest.approx(size, rel=1e-14)
    assert abs(value) <= found * (1 + 1e-15)


def test_a_term_with_a_sine_counts_at_every_angle() -> None:
    """Where the sine is zero as well: the size of a linkage is that of its links."""
    (found, *_) = values_of(l * sp.sin(x - sp.Rational(-3, 10)))
    assert found == 2.0
