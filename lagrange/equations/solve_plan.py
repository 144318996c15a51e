"""Solve the linear equations M a = h: in symbols by cofactors, and for compiled code by a plan of elimination.

Cofactors have the determinant as their only divisor, and det M is zero only where M is singular. Elimination divides by
pivots. A pivot is a function of the state. It can be zero at a state where M is regular, such as theta = pi/2 or
straight arms, and the formula is then wrong at this state. The sizes beyond which accelerations are not written out for
people are in `textbook_algebra`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mpmath
import sympy
from sympy import Add, Derivative, Integer, Mul, Rational, S
from sympy.core.function import AppliedUndef

from lagrange.equations.terms import ONE, Algebra, MonomialSum, TooLargeError, printable
from lagrange.graph.evaluate import generic_rank
from lagrange.graph.node import Binding, Node
from lagrange.statement.run_settings import check_time


def coupled_blocks(nonzero: Sequence[Sequence[bool]]) -> list[list[int]]:
    """Return the groups of indices that the nonzero entries of a symmetric matrix couple, as sorted lists.

    `nonzero` has True for each entry of the matrix that is not zero.
    """
    neighbours = [[j for j, present in enumerate(row) if present] for row in nonzero]
    return list(map(list, coupled(neighbours)))


LEAST_REFUSED_BLOCK = 12
"""Least size n of a block without zeros whose solution is not written as formulas. Its nested cofactors would have at
least n 2**(n - 1) operations, 24,000."""


def has_large_block(nonzero: Sequence[Sequence[bool]]) -> bool:
    """Return True if a symmetric matrix has a block without zeros that is too large to be solved by formulas.

    `nonzero` has True for each entry of the matrix that is not zero.
    """
    blocks = (block for block in coupled_blocks(nonzero) if len(block) >= LEAST_REFUSED_BLOCK)
    return any(all(nonzero[i][j] for i in block for j in block) for block in blocks)


def expanded_cofactors(
    algebra: Algebra, matrix: Sequence[Sequence[MonomialSum]], bias: Sequence[MonomialSum]
) -> tuple[list[MonomialSum], MonomialSum]:
    """Return the numerators of the solution x of matrix * x = bias, and their denominator, the determinant.

    Numerators and denominator are sums of monomials, multiplied out and merged.
    """
    n = len(matrix)
    others = [tuple(k for k in range(n) if k != i) for i in range(n)]
    cofactors = [[_minor(algebra, matrix, others[i], others[j], (-1) ** (i + j)) for j in range(n)] for i in range(n)]
    determinant = algebra.add({}, *(algebra.multiply(matrix[0][j], cofactors[0][j]) for j in range(n)))
    above = [algebra.add({}, *(algebra.multiply(bias[i], cofactors[i][j]) for i in range(n))) for j in range(n)]
    return [algebra.merge_angles(terms) for terms in above], algebra.merge_angles(determinant)


def _minor(
    algebra: Algebra,
    matrix: Sequence[Sequence[MonomialSum]],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
    sign: int,
) -> MonomialSum:
    if not rows:
        return {ONE: Integer(sign)}
    total: MonomialSum = {}
    for index, column in enumerate(columns):
        entry = matrix[rows[0]][column]
        if entry:
            rest = columns[:index] + columns[index + 1 :]
            total = algebra.add(
                total, algebra.multiply(entry, _minor(algebra, matrix, rows[1:], rest, sign * (-1) ** index))
            )
    return algebra.merge_angles(total)


def vanishes(matrix: Sequence[Sequence[Any]]) -> bool:
    """Return True if the determinant of a matrix of expressions is zero where its symbols have arbitrary values.

    It is computed in 40 digits and 10 more for each row, since the determinant of a chain of 24 links is 1e-30.
    """
    digits = 40 + 10 * len(matrix)
    point = distinct_values(sorted(sympy.Tuple(*(entry for row in matrix for entry in row)).free_symbols, key=str))
    rows = [[sympy.N(printable(entry.xreplace(point)), digits) for entry in row] for row in matrix]
    with mpmath.workdps(digits):
        numbers = mpmath.matrix([[mpmath.mpmathify(x) if x.is_finite else mpmath.mpf(1) for x in row] for row in rows])
        bound = mpmath.fprod(mpmath.norm(numbers[i, :]) for i in range(numbers.rows))
        return bool(abs(mpmath.det(numbers)) <= bound * mpmath.mpf(10) ** (20 - digits))


def value_somewhere(expression: Any) -> float:
    """Return the value of an expression for arbitrary, different values of its symbols, to tell whether it is zero."""
    leaves = sorted(expression.atoms(AppliedUndef, Derivative), key=str)
    plain = expression.xreplace({leaf: sympy.Dummy(str(leaf)) for leaf in leaves})
    return float(sympy.N(plain.xreplace(distinct_values(sorted(plain.free_symbols, key=str))), 30))


def distinct_values(symbols: Iterable[Any]) -> dict[Any, Any]:
    """Return {symbol: positive rational number of order one}, for tests whether an expression is zero.

    The numbers differ and have no simple relations.
    """
    ordered = dict.fromkeys(symbols)
    return {symbol: Rational(2 * i + 3, 2 * i + 7) + Rational(1, i + 11) for i, symbol in enumerate(ordered)}


MOST_MINORS = 30_000
"""Largest number of minors of one matrix, which takes about 2 s. A chain of 20 rods has more, but most of them are
zero, and all are short."""


class NestedCofactors:
    """Solution x of matrix * x = bias by cofactors that are not multiplied out. Each minor is one shared expression.

    `longest` is the largest number of operations of a printed formula. TooLargeError is raised for longer formulas, and
    for more than `MOST_MINORS` minors.
    """

    def __init__(self, matrix: Sequence[Sequence[Any]], bias: Sequence[Any], longest: int) -> None:
        self._matrix = matrix
        self._bias = bias
        self._longest = longest
        self._entry_sizes = [[entry.count_ops() + 1 for entry in row] for row in matrix]
        self._minors: dict[tuple[tuple[int, ...], tuple[int, ...]], tuple[Any, int]] = {}

    def solution(self) -> list[Any]:
        """Return the solution, n expressions with the determinant as denominator."""
        n = len(self._matrix)
        everything = tuple(range(n))
        others = [everything[:i] + everything[i + 1 :] for i in everything]
        determinant, below = self._minor(everything, everything)
        solution = []
        for j in range(n):
            parts, size = [], below
            for i in range(n):
                cofactor, length = self._minor(others[i], others[j])
                if cofactor != 0 and self._bias[i] != 0:
                    parts.append(Mul((-1) ** (i + j), cofactor, self._bias[i]))
                    size = self._bounded(size + length + self._bias[i].count_ops() + 1)
            solution.append(Add(*parts) / determinant)
        return solution

    def _minor(self, rows: tuple[int, ...], columns: tuple[int, ...]) -> tuple[Any, int]:
        if not rows:
            return S.One, 0
        key = (rows, columns)
        if key not in self._minors:
            parts, size = [], 0
            for index, column in enumerate(columns):
                entry = self._matrix[rows[0]][column]
                if entry != 0:
                    minor, length = self._minor(rows[1:], columns[:index] + columns[index + 1 :])
                    if minor != 0:
                        parts.append(Mul((-1) ** index, entry, minor))
                        size = self._bounded(size + length + self._entry_sizes[rows[0]][column])
            self._minors[key] = Add(*parts), size
            if len(self._minors) > MOST_MINORS:
                raise TooLargeError
        return self._minors[key]

    def _bounded(self, size: int) -> int:
        if size > self._longest:
            raise TooLargeError
        return size


Neighbours = Sequence[Collection[int]]
"""For each unknown, the unknowns with a nonzero entry in its row of the matrix."""


def band_order(neighbours: Neighbours) -> list[int]:
    """Return an order of the unknowns that makes the bandwidth of a symmetric matrix small (Cuthill, McKee).

    Unknowns are sorted by distance from one end of the graph. `neighbours` has the unknowns coupled to each unknown.
    """
    order: list[int] = []
    left = dict.fromkeys(range(len(neighbours)))

    def degree(i: int) -> int:
        return len(neighbours[i])

    while left:
        end, depth, levels = min(left, key=degree), 0, list[list[int]]()
        while not levels or len(levels) > depth:
            depth, levels = len(levels), _levels(end, neighbours)
            end = min(levels[-1], key=degree)
        for i in (i for level in levels for i in level):
            del left[i]
            order.append(i)
    return order


def _levels(root: int, neighbours: Neighbours) -> list[list[int]]:
    """Return the unknowns in groups by their distance from `root`. In a group those with few neighbours come first."""
    levels, seen = [[root]], {root}
    while True:
        level: list[int] = []
        for i in levels[-1]:
            fresh = sorted((j for j in neighbours[i] if j not in seen), key=lambda j: (len(neighbours[j]), j))
            seen.update(fresh)
            level += fresh
        if not level:
            return levels
        levels.append(level)


def elimination_order(block: Sequence[int], neighbours: Neighbours, multipliers: Collection[int]) -> tuple[int, ...]:
    """Return the unknowns of a block in order of elimination, those with the fewest neighbours first.

    `neighbours` has the unknowns coupled to each unknown. A multiplier, an unknown in `multipliers`, comes after all
    accelerations that are coupled to it.
    """
    ranks = {unknown: i for i, unknown in enumerate(block)}
    ends = band_order([[ranks[j] for j in neighbours[i]] for i in block])
    rank = {block[i]: k for k, i in enumerate(ends)}
    multiplier_set = frozenset(multipliers)
    beside = {i: {j for j in neighbours[i] if j != i} for i in block}
    waits = {i: sum(j not in multiplier_set for j in beside[i]) if i in multiplier_set else 0 for i in block}
    left, depth = dict.fromkeys(block), dict.fromkeys(block, 0)
    order: list[int] = []
    while left:
        chosen = min((i for i in left if not waits[i]), key=lambda i: (len(beside[i]), depth[i], rank[i]))
        del left[chosen]
        order.append(chosen)
        others = beside.pop(chosen)
        for i in others:
            depth[i] = max(depth[i], depth[chosen] + 1)
            beside[i].discard(chosen)
            beside[i].update(j for j in others if j != i)
            if chosen not in multiplier_set and i in multiplier_set and chosen in neighbours[i]:
                waits[i] -= 1
    return tuple(order)


@dataclass(frozen=True)
class SolvePlan:
    """Plan to solve A x = b block by block.

    `blocks` are groups of unknowns that the symmetric matrix couples, in the order of elimination. Rows of later blocks
    may contain unknowns of earlier blocks, as in variational equations. If `moving` is true, A changes along the
    motion; otherwise A is factored once for each set of parameters. A is positive definite except for `multipliers`,
    unknowns with negative pivots. `present` has the index pairs of entries that are not identically zero. None means
    all entries.
    """

    blocks: tuple[tuple[int, ...], ...]
    moving: bool
    multipliers: tuple[int, ...] = ()
    present: frozenset[tuple[int, int]] | None = None

    @property
    def size(self) -> int:
        """Number of unknowns of the linear system."""
        return sum(map(len, self.blocks))

    @property
    def diagonal(self) -> bool:
        """True if the matrix of the linear system is diagonal, so that a division gives each unknown."""
        return len(self.blocks) == self.size

    @property
    def inverted(self) -> bool:
        """True if the matrix has to be factored at each state: it changes along the motion and is not diagonal."""
        return self.moving and not self.diagonal

    @cached_property
    def triangle(self) -> tuple[tuple[int, int], ...]:
        """Index pairs (i, j) of the matrix entries that the solution uses: lower triangles by rows, block by block."""
        lower = ((block[a], block[b]) for block in self.blocks for a in range(len(block)) for b in range(a + 1))
        return tuple(entry for entry in lower if self.present is None or entry in self.present)

    def negative(self, block: Sequence[int]) -> tuple[int, ...]:
        """Return the positions within a block of the unknowns with negative pivots."""
        return tuple(index for index, unknown in enumerate(block) if unknown in self.multipliers)

    def solved(self, matrix: Sequence[Sequence[Node]], right: Sequence[Node]) -> list[Node]:
        """Return the solution x of matrix * x = right. A matrix is factored once for all right-hand sides."""
        return self.solver(matrix)(right)

    def solver(self, matrix: Sequence[Sequence[Node]]) -> Callable[[Sequence[Node]], list[Node]]:
        """Return a function from a right-hand side to the solution x. The structure of the matrix is analysed once."""
        graph = matrix[0][0].graph
        earlier: list[list[int]] = []
        before: list[int] = []
        for block in self.blocks:
            earlier.append([j for j in before if any(matrix[i][j] is not graph.zero for i in block)])
            before += block
        squares = [[[matrix[i][j] for j in block] for i in block] for block in self.blocks]

        def solve(right: Sequence[Node]) -> list[Node]:
            check_time()
            solution: dict[int, Node] = {}
            for block, square, known in zip(self.blocks, squares, earlier, strict=True):
                rest = [right[i] for i in block]
                if known:
                    moved = [[(-1, matrix[i][j] * solution[j]) for j in known] for i in block]
                    rest = [graph.sum([(1, entry), *terms]) for entry, terms in zip(rest, moved, strict=True)]
                solution.update(zip(block, graph.solve(square, rest, self.negative(block)), strict=True))
            return [solution[i] for i in range(len(right))]

        return solve


def plan_of(matrix: Sequence[Sequence[Node]], multipliers: tuple[int, ...] = ()) -> SolvePlan:
    """Return the plan to solve linear systems with a symmetric matrix of nodes.

    `multipliers` are the indices of unknowns with negative pivots.
    """
    n = len(matrix)
    moving = any(entry.binding > Binding.PARAMETER for row in matrix for entry in row)
    neighbours = [[j for j in range(n) if matrix[i][j] is not matrix[i][j].graph.zero] for i in range(n)]
    blocks = tuple(
        elimination_order(block, neighbours, multipliers) if any(i in multipliers for i in block) else block
        for block in coupled(neighbours)
    )
    dense = SolvePlan(blocks, moving, multipliers)
    present = frozenset((i, j) for i, row in enumerate(neighbours) for j in row)
    return dense if present.issuperset(dense.triangle) else replace(dense, present=present)


def coupled(neighbours: Sequence[Sequence[int]]) -> tuple[tuple[int, ...], ...]:
    """Return the connected components of a graph, each sorted. `neighbours` has the neighbours of each vertex."""
    seen: set[int] = set()
    groups = []
    for root in range(len(neighbours)):
        if root in seen:
            continue
        group, stack = {root}, [root]
        while stack:
            fresh = [j for j in neighbours[stack.pop()] if j not in group]
            group.update(fresh)
            stack += fresh
        seen |= group
        groups.append(tuple(sorted(group)))
    return tuple(groups)


def eliminated(matrix: Sequence[Sequence[Node]], right: Sequence[Node], order: Sequence[int]) -> list[Node]:
    """Return the solution x of matrix * x = right for a regular matrix. Unknowns are eliminated in the given `order`.

    Rows are exchanged if a pivot is zero. The result consists of sums and products. Unlike the solution by a
    `SolvePlan`, it needs no special rule in Taylor series.
    """
    graph, left = right[0].graph, list(order)
    rows = [[*row, entry] for row, entry in zip(matrix, right, strict=True)]
    pivots: list[list[Node]] = []
    for k in order:
        chosen = next(i for i in sorted(left, key=k.__ne__) if generic_rank([[rows[i][k]]]))
        left.remove(chosen)
        pivots.append([entry / rows[chosen][k] for entry in rows[chosen]])
        for i in left:
            if rows[i][k] is not graph.zero:
                rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], pivots[-1], strict=True)]
    solution: dict[int, Node] = {}
    for k, pivot in zip(reversed(order), reversed(pivots), strict=True):
        solution[k] = graph.sum([(1, pivot[-1]), *((-1, pivot[i] * x) for i, x in solution.items())])
    return [solution[k] for k in range(len(rows))]
