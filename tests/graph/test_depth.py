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
from lagrange.machine.kernel.llvm_module import KernelCode
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.program.lower import lower
from lagrange.program.program import Program

TERMS = [(20_000, 201), pytest.param(100_000, 448, marks=pytest.mark.slow)]
"""How many products of so many factors, which have some more."""
DEPTHS = [5_000, pytest.param(20_000, marks=pytest.mark.slow)]


def program_of(outputs: list[Node], state: list[Node]) -> Program:
    graph = outputs[0].graph
    return lower("deep", {"out": outputs}, {"y": state}, graph.symbol("t", Binding.TIME), [])


@pytest.fixture(autouse=True)
def shallow() -> None:
    """The limit must be far below what is walked, or this file tests nothing."""
    assert sys.getrecursionlimit() < 5_000 / 4


@pytest.mark.parametrize(("terms", "factors"), TERMS)
def test_a_sum_of_many_terms_through_sympy(terms: int, factors: int) -> None:
    names = [f"x{i}" for i in range(factors)]
    symbols = sp.symbols(names)
    pairs = [sp.Mul(a, b, evaluate=False) for i, a in enumerate(symbols) for b in symbols[:i]][:terms]
    expression = sp.Add(*pairs, evaluate=False)
    assert len(expression.args) == terms
    graph = Graph()
    leaves = [graph.symbol(name, Binding.CONFIGURATION) for name in names]
    (node,) = share_sums(graph, [Translator(graph, dict(zip(symbols, leaves, strict=True)))(expression)])
    assert len(node.args) == terms
    slopes = gradient(node, leaves)
    direction = dict.fromkeys(leaves[:3], graph.one)
    program = program_of([node, *slopes[:3], tangents([node], direction)(node)], leaves)
    x = np.sqrt(np.arange(float(factors)) + 1)
    found = NumpyMachine().load(program)(0.0, x, np.empty(0))
    rows = np.cumsum(x) - x  # row i of the triangle has the terms x_i x_j, j < i
    cut = terms - (factors - 1) * (factors - 2) // 2
    total = (x * rows)[:-1].sum() + x[-1] * x[:cut].sum()
    partial = [x.sum() - x[k] for k in range(3)]
    assert found == pytest.approx([total, *partial, sum(partial)], rel=1e-12)
    assert KernelCode(program).scalar_module().count("fma") > terms


def nest(graph: Graph, x: Node, depth: int) -> Node:
    """Return sin(... sin(sin(x) + x) ... + x): one function inside the other."""
    node = x
    for _ in range(depth):
        node = graph.call("sin", node) + x
    return node


@pytest.mark.parametrize("depth", DEPTHS)
def test_a_deep_nesting_built_directly(depth: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = nest(graph, x, depth)
    assert share_sums(graph, [node]) == [node]
    (slope,) = gradient(node, [x])
    program = program_of([node, slope], [x])
    found = NumpyMachine().load(program)(0.0, np.array([0.3]), np.empty(0))
    value, expected = 0.3, 1.0
    for _ in range(depth):
        value, expected = np.sin(value) + 0.3, np.cos(value) * expected + 1
    assert found == pytest.approx([value, expected], rel=1e-9)
    text = KernelCode(program).scalar_module()
    assert text.count("@sin") > depth


@pytest.mark.parametrize("depth", DEPTHS)
def test_the_forward_derivative_of_a_deep_nesting(depth: int) -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = nest(graph, x, depth)
    forward = tangents([node], {x: graph.one})(node)
    assert depth < len(reachable([forward])) < 5 * depth


def test_the_adjoints_of_a_nesting_grow_linearly() -> None:
    sizes = []
    for depth in (500, 1000, 2000):
        graph = Graph()
        x = graph.symbol("x", Binding.CONFIGURATION)
        sizes.append(sum(len(node.args) for node in reachable(gradient(nest(graph, x, depth), [x]))))
    assert sizes[2] - sizes[1] < 2.1 * (sizes[1] - sizes[0])


def test_a_long_nesting_runs_in_machine_code() -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = nest(graph, x, 1000)
    program = program_of([node, *gradient(node, [x])], [x])
    state = np.array([0.3])
    found = LlvmMachine().load(program)(0.0, state, np.empty(0))
    assert found == pytest.approx(NumpyMachine().load(program)(0.0, state, np.empty(0)), rel=1e-13)


def test_a_deep_choice_is_walked_too() -> None:
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
