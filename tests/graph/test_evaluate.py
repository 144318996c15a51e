"""Values of nodes in many digits: every function of the graph has one, and what has none is told apart."""

from __future__ import annotations

import math

import pytest

from lagrange.graph.evaluate import FUNCTIONS as VALUED
from lagrange.graph.evaluate import precise, values
from lagrange.graph.functions import FUNCTIONS
from lagrange.graph.node import Binding, Graph

CONTEXT = precise(40)


def test_every_function_has_a_value() -> None:
    assert set(FUNCTIONS) - {"piecewise"} <= set(VALUED)


def test_values_and_the_largest_number() -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    wave = graph.call("sin", x) ** 2 * 3 - graph.call("exp", x) / 7
    branch = graph.piecewise([(graph.call("less", x, graph.constant(2)), wave)], x)
    found = values([wave, branch, x**-1], {x: CONTEXT.mpf("1.5")}, CONTEXT)
    assert found is not None
    expected = 3 * math.sin(1.5) ** 2 - math.exp(1.5) / 7
    assert [float(value) for value in found[0]] == pytest.approx([expected, expected, 1 / 1.5], rel=1e-14)
    assert float(found[1]) >= math.exp(1.5)


@pytest.mark.parametrize("value", [0, -2])
def test_what_has_no_value(value: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    assert values([graph.call("log", x)], {x: CONTEXT.mpf(value)}, CONTEXT) is None
