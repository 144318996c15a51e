"""Symbolic elimination of a sparse symmetric matrix, A = L D L^T: nonzero entries of L, and limits for writing it out.

Pivots are taken in the order of the matrix. This is stable if A is positive definite. For [[M, G^T], [G, 0]] with a
definite M it is stable as long as no pivot is small compared with the terms of its sum. If a pivot is small, a solver
chooses pivots by size instead. Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, section 4.1; R.
J. Vanderbei, Symmetric quasidefinite matrices, SIAM J. Optimization 5, 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

from lagrange.equations.solve_plan import SolvePlan, band_order

LARGEST_IN_LINE = 6
"""Largest number of rows of a matrix without multipliers whose elimination is printed one operation at a time. For a
larger matrix a loop is as fast and compiles quickly.
"""

MOST_MULTIPLICATIONS = 30_000
"""Largest number of multiplications of an elimination with multipliers that is printed one by one."""


@dataclass(frozen=True)
class Elimination:
    """Structure of the factors A = L D L^T of a sparse symmetric matrix A of size `order`.

    `entries` are the index pairs (i, j), i >= j, of the nonzero entries of A. `negative` are the indices of the
    pivots in D that are negative.
    """

    order: int
    entries: frozenset[tuple[int, int]]
    negative: tuple[int, ...] = ()

    @cached_property
    def rows(self) -> tuple[tuple[int, ...], ...]:
        """Column indices k < i of the nonzero entries in each row i of the factor L, ascending."""
        columns: list[set[int]] = [set() for _ in range(self.order)]
        for i, j in self.entries:
            if i > j:
                columns[j].add(i)
        for column in columns:
            if column:
                first = min(column)
                columns[first].update(i for i in column if i > first)
        rows: list[list[int]] = [[] for _ in range(self.order)]
        for j, column in enumerate(columns):
            for i in sorted(column):
                rows[i].append(j)
        return tuple(map(tuple, rows))

    @cached_property
    def columns(self) -> tuple[tuple[int, ...], ...]:
        """Row indices i > j of the nonzero entries in each column j of the factor L, ascending."""
        columns: list[list[int]] = [[] for _ in range(self.order)]
        for i, row in enumerate(self.rows):
            for j in row:
                columns[j].append(i)
        return tuple(map(tuple, columns))

    @cached_property
    def places(self) -> tuple[tuple[int, int], ...]:
        """Index pairs of the nonzero entries of the factor L, row by row, with the diagonal."""
        return tuple((i, j) for i, row in enumerate(self.rows) for j in (*row, i))

    @cached_property
    def ranks(self) -> tuple[int, ...]:
        """Position of each unknown in the order of elimination with pivoting.

        A matrix with Lagrange multipliers is sparse: the order puts coupled unknowns close to each other, for a small
        bandwidth. Without multipliers the order is the original one.
        """
        if not self.negative:
            return tuple(range(self.order))
        neighbours: list[list[int]] = [[] for _ in range(self.order)]
        for i, j in sorted(self.entries):
            if i != j:
                neighbours[i].append(j)
                neighbours[j].append(i)
        ranks = {unknown: rank for rank, unknown in enumerate(band_order(neighbours))}
        return tuple(ranks[i] for i in range(self.order))

    @cached_property
    def band(self) -> int:
        """Half bandwidth of the matrix with unknowns in the order of `ranks`: the largest |i - j| of an entry."""
        return max((abs(self.ranks[i] - self.ranks[j]) for i, j in self.entries), default=0)

    @property
    def operations(self) -> int:
        """Approximate number of multiplications of the factorization."""
        return sum(len(column) * (len(column) + 3) // 2 for column in self.columns)

    @property
    def written_out(self) -> bool:
        """True if generated code factors the matrix by one statement for each operation, without loops."""
        return self.order <= LARGEST_IN_LINE or (bool(self.negative) and self.operations <= MOST_MULTIPLICATIONS)


@lru_cache(maxsize=256)
def elimination(order: int, entries: frozenset[tuple[int, int]], negative: tuple[int, ...] = ()) -> Elimination:
    """Return the `Elimination` of a symmetric matrix of size `order`; equal arguments give the same object.

    `entries` are the index pairs (i, j), i >= j, of its nonzero entries, and `negative` the indices of negative
    pivots.
    """
    return Elimination(order, entries, negative)


def block_eliminations(plan: SolvePlan) -> list[Elimination]:
    """Return the elimination of each diagonal block of the matrix of a linear system.

    `plan` describes the structure of the matrix.
    """
    eliminations = []
    for block in plan.blocks:
        index = {unknown: i for i, unknown in enumerate(block)}
        pattern = frozenset((index[i], index[j]) for i, j in plan.triangle if i in index)
        eliminations.append(elimination(len(block), pattern, plan.negative(block)))
    return eliminations


def is_factored(plan: SolvePlan) -> bool:
    """Return True if the matrix of a linear system is factored anew at each state.

    `plan` describes its structure. The result is False if the matrix is diagonal, constant in time, or inverted
    instead. Factors are used for matrices with multipliers, which are sparse.
    """
    blocks = [block for block in block_eliminations(plan) if block.order > 1]
    return plan.inverted and all(block.negative and block.written_out for block in blocks)
