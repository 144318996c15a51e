"""The plan of a linear system: blocks, one behind the other, and which pivots are below zero."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.compiler import machine
from lagrange.equations.solve_plan import SolvePlan, plan_of
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.program.lower import lower


def solved(plan: SolvePlan, matrix: list[list[float]], right: list[float], target: str) -> np.ndarray:
    """Return x by a program of the plan, its matrix and right-hand side read from the state."""
    graph, n = Graph(), len(right)
    nodes = [[graph.symbol(f"a{i} {j}", Binding.CONFIGURATION) for j in range(n)] for i in range(n)]
    nodes = [[node if matrix[i][j] else graph.zero for j, node in enumerate(row)] for i, row in enumerate(nodes)]
    b = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n)]
    given = [nodes[i][j] for i in range(n) for j in range(n) if matrix[i][j]]
    values = [matrix[i][j] for i in range(n) for j in range(n) if matrix[i][j]]
    program = lower("solve", {"x": plan.solved(nodes, b)}, {"a": given, "b": b}, graph.symbol("t", Binding.TIME), [])
    return machine(target).load(program)(0.0, np.array([*values, *right]), np.empty(0))


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_a_block_behind_another_reads_what_that_found(target: str) -> None:
    """As in a system of variations: [[M, 0], [N, M]] with M twice."""
    M, N = np.array([[2.0, 0.5], [0.5, 3.0]]), np.array([[0.3, -1.0], [0.7, 0.2]])
    whole = np.block([[M, np.zeros((2, 2))], [N, M]])
    right = [1.0, -2.0, 0.5, 4.0]
    plan = SolvePlan(((0, 1), (2, 3)), moving=True)
    assert solved(plan, whole.tolist(), right, target) == pytest.approx(np.linalg.solve(whole, right), rel=1e-13)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_multipliers_stand_behind_what_they_hold(target: str) -> None:
    whole = np.array([[2.0, 0.5, 1.0], [0.5, 3.0, -2.0], [1.0, -2.0, 0.0]])
    plan = SolvePlan(((0, 1, 2),), moving=True, multipliers=(2,))
    assert plan.negative(plan.blocks[0]) == (2,)
    right = [1.0, -2.0, 0.5]
    assert solved(plan, whole.tolist(), right, target) == pytest.approx(np.linalg.solve(whole, right), rel=1e-13)


def test_the_plan_of_a_matrix_and_its_factors() -> None:
    graph = Graph()
    a, b, c = (graph.symbol(name, Binding.CONFIGURATION) for name in "abc")
    p, zero = graph.symbol("p", Binding.PARAMETER), graph.zero
    plan = plan_of([[a, zero, b], [zero, p, zero], [b, zero, c]])
    assert plan == SolvePlan(((0, 2), (1,)), moving=True) and plan.inverted and not plan.diagonal and plan.size == 3
    assert plan.triangle == ((0, 0), (2, 0), (2, 2), (1, 1))
    assert plan_of([[p]]) == SolvePlan(((0,),), moving=False)
    matrix: list[list[Node]] = [[a, b], [b, c]]
    once = [*plan_of(matrix).solved(matrix, [a, p]), *plan_of(matrix).solved(matrix, [b, c])]
    assert len([node for node in reachable(once) if node.kind is Kind.FACTOR]) == 1


def test_many_right_hand_sides_read_the_matrix_once() -> None:
    """A Jacobian of 294 coordinates has 588, and its matrix 86,436 places."""

    class Row(list[Node]):
        reads = 0

        def __getitem__(self, place: Any) -> Any:
            Row.reads += 1
            return super().__getitem__(place)

    graph, n = Graph(), 12
    matrix = [Row(graph.constant(2) if i == j else graph.zero for j in range(n)) for i in range(n)]
    solve = SolvePlan(tuple((i,) for i in range(n)), moving=False).solver(matrix)
    before = Row.reads
    right = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n)]
    assert solve(right) == [node / 2 for node in right] and Row.reads == before
