"""Very long and very deep expressions pass every walk: no recursion limit, no quadratic surprise."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import sympy as sp

from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.from_sympy import Translator
from lagrange.graph.node import Binding, Graph, Node, reachable
from lagrange.graph.share import share_sums
from lagrange.machine.llvm.kernel import scalar_module
from lagrange.machine.numpy import NumpyMachine
from lagrange.program.lower import lower
from lagrange.program.program import Program

TERMS = 100_000
DEPTH = 20_000


def program_of(outputs: list[Node], state: list[Node]) -> Program:
    graph = outputs[0].graph
    return lower("deep", outputs, (len(outputs),), state, graph.symbol("t", Binding.TIME), [])


@pytest.fixture
def shallow() -> int:
    """The limit must be far below what is walked, or this file tests nothing."""
    assert sys.getrecursionlimit() < DEPTH / 4
    return sys.getrecursionlimit()


def test_a_sum_of_many_terms_through_sympy(shallow: int) -> None:
    x, y = sp.symbols("x y")
    # Distinct terms that SymPy makes quickly: plain powers of two symbols.
    terms = [sp.Mul(sp.Integer(1), sp.Pow(x, i, evaluate=False), sp.Pow(y, j, evaluate=False), evaluate=False)
             for i in range(2, 402) for j in range(2, 252)]
    expression = sp.Add(*terms, evaluate=False)
    assert len(expression.args) == TERMS
    graph = Graph()
    a, b = graph.symbol("x", Binding.CONFIGURATION), graph.symbol("y", Binding.CONFIGURATION)
    (node,) = share_sums(graph, [Translator(graph, {x: a, y: b})(expression)])
    assert len(node.args) == TERMS
    slope_x, _ = gradient(node, [a, b])
    forward = tangents([node], {a: graph.one})(node)
    program = program_of([node, slope_x, forward], [a, b])
    with np.errstate(all="ignore"):
        total, *slopes = NumpyMachine().load(program)(0.0, np.array([0.5, 0.25]), np.empty(0))
    geometric = [lambda r: r**2 / (1 - r), lambda r: (2 * r - r**2) / (1 - r) ** 2]
    assert total == pytest.approx(geometric[0](0.5) * geometric[0](0.25), rel=1e-12)
    assert slopes == pytest.approx([geometric[1](0.5) * geometric[0](0.25)] * 2, rel=1e-12)


def nest(graph: Graph, x: Node, depth: int) -> Node:
    """Return sin(... sin(sin(x) + x) ... + x): one function inside the other."""
    node = x
    for _ in range(depth):
        node = graph.call("sin", node) + x
    return node


def test_a_deep_nesting_built_directly(shallow: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = nest(graph, x, DEPTH)
    assert share_sums(graph, [node]) == [node]
    (slope,) = gradient(node, [x])
    forward = tangents([node], {x: graph.one})(node)
    program = program_of([node, slope, forward], [x])
    found = NumpyMachine().load(program)(0.0, np.array([0.3]), np.empty(0))
    value, expected = 0.3, 1.0
    for _ in range(DEPTH):
        value, expected = np.sin(value) + 0.3, np.cos(value) * expected + 1
    assert found == pytest.approx([value, expected, expected], rel=1e-9)
    text = scalar_module(program)
    assert text.count("call void @sincos") == DEPTH


def test_a_long_nesting_runs_in_machine_code() -> None:
    from lagrange.machine.llvm.machine import LlvmMachine

    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    program = program_of([nest(graph, x, 1000)], [x])
    state = np.array([0.3])
    found = LlvmMachine().load(program)(0.0, state, np.empty(0))
    assert found == pytest.approx(NumpyMachine().load(program)(0.0, state, np.empty(0)), rel=1e-13)


def test_a_deep_choice_is_walked_too(shallow: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = x
    for k in range(300):
        node = graph.piecewise([(graph.call("less", x, graph.constant(k)), node * x)], node + 1)
    (slope,) = gradient(node, [x])
    forward = tangents([node], {x: graph.one})(node)
    found = NumpyMachine().load(program_of([slope, forward], [x]))(0.0, np.array([0.9]), np.empty(0))
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    assert len(reachable([slope])) < 10 * len(reachable([node]))
