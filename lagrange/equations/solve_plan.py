"""How a linear system of the equations is solved, as one record that kernels, series and multiple precision read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from lagrange.graph.node import Binding, Node


@dataclass(frozen=True)
class SolvePlan:
    """How A x = b is solved: its unknowns in `blocks` that the symmetric matrix couples within, in order.

    What is solved for in one block may stand in the rows of later ones, which makes a system of variations. `moving`
    says that A changes along the motion; otherwise it is factored once per set of parameters. A is positive definite
    but for `multipliers`, unknowns with pivots below zero, which stand last in their block.
    """

    blocks: tuple[tuple[int, ...], ...]
    moving: bool
    multipliers: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return sum(map(len, self.blocks))

    @property
    def diagonal(self) -> bool:
        """Whether every unknown stands alone, so that a division finds it."""
        return len(self.blocks) == self.size

    @property
    def inverted(self) -> bool:
        """Whether a matrix is factored or inverted along the motion."""
        return self.moving and not self.diagonal

    @cached_property
    def triangle(self) -> tuple[tuple[int, int], ...]:
        """The places (i, j), i >= j, of the entries that are read: lower triangles by rows, block by block."""
        return tuple((block[a], block[b]) for block in self.blocks for a in range(len(block)) for b in range(a + 1))

    def negative(self, block: Sequence[int]) -> int:
        """Return how many of the last pivots of a block are below zero."""
        return sum(unknown in self.multipliers for unknown in block)

    def solved(self, matrix: Sequence[Sequence[Node]], right: Sequence[Node]) -> list[Node]:
        """Return x; the factors of one matrix are shared by all right-hand sides."""
        found: dict[int, Node] = {}
        for block in self.blocks:
            graph = right[block[0]].graph
            known = [j for j in found if any(matrix[i][j] is not graph.zero for i in block)]
            rest = [graph.sum([(1, right[i]), *((-1, matrix[i][j] * found[j]) for j in known)]) for i in block]
            square = [[matrix[i][j] for j in block] for i in block]
            found.update(zip(block, graph.solve(square, rest, self.negative(block)), strict=True))
        return [found[i] for i in range(len(right))]


def plan_of(matrix: Sequence[Sequence[Node]], multipliers: tuple[int, ...] = ()) -> SolvePlan:
    """Return the plan of a symmetric matrix of nodes."""
    moving = any(entry.binding > Binding.PARAMETER for row in matrix for entry in row)
    return SolvePlan(coupled(matrix), moving, multipliers)


def coupled(matrix: Sequence[Sequence[Node]]) -> tuple[tuple[int, ...], ...]:
    """Return the groups of indices that the non-zero entries of a symmetric matrix connect, each sorted."""
    n = len(matrix)
    label = list(range(n))
    for i in range(n):
        for j in range(i):
            if matrix[i][j] is not matrix[i][j].graph.zero and label[i] != label[j]:
                old, new = max(label[i], label[j]), min(label[i], label[j])
                label = [new if entry == old else entry for entry in label]
    return tuple(tuple(i for i in range(n) if label[i] == root) for root in dict.fromkeys(label))
