"""Linear systems of a Taylor series: each matrix is inverted or factored at order 0, and used at every order.

A small matrix is inverted, so that a solution is a product. Pivoting is used if a pivot is too small. Sparse matrices
of systems with Lagrange multipliers are factored instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from lagrange.algorithm.kernel.elimination import factored, solved, write_band
from lagrange.algorithm.linear import symmetric
from lagrange.algorithm.series.rules import Term, entries, fma, joined, plus, put, wide
from lagrange.equations.solve_plan import SolvePlan
from lagrange.procedure.builder import Builder
from lagrange.procedure.values import Flag, Memory, Real
from lagrange.program.elimination import LARGEST_IN_LINE, Elimination, block_eliminations, elimination, is_factored

Triangle = dict[tuple[int, int], Real]


Rows = Sequence[Sequence[int]]
"""For each vector of unknowns, the indices of its unknowns in the system, by lane. The last index may be repeated."""


class LinearSystem(Protocol):
    """A linear system whose matrix is inverted or factored already; a solve takes one right-hand side."""

    def solve(self, rows: Rows, right: Sequence[Term]) -> list[Term]:
        """Return the solution of the system for the right-hand side `right`, both as lists of vectors.

        `rows` has for each vector the indices of its unknowns, by lane.
        """


MOST_INVERSE_COLUMNS = 32
"""Largest size of an inverse in memory whose product with a vector is written out."""

ALL = 1_000_000
"""Value of the parameter `largest` that exceeds every matrix: all inverses are written out, also of sparse matrices."""


def system_size(plan: SolvePlan, largest: int = LARGEST_IN_LINE) -> int:
    """Return the number of doubles of memory for the inverse or the factors of a matrix that depends on the state.

    Inverses up to the size `largest` are written out, and need no memory.
    """
    if not plan.inverted or largest == ALL:
        return 0
    if is_factored(plan):
        return sum(_factored_size(block) for block in block_eliminations(plan))
    n = plan.size
    return 0 if _is_small(plan, largest) else symmetric.padded(n) ** 2 + n * n + symmetric.work_size(n)


def moving_system(
    p: Builder, plan: SolvePlan, entries: Iterator[Real], memory: Memory, largest: int = LARGEST_IN_LINE
) -> tuple[LinearSystem, list[Flag]]:
    """Return the solver of a linear system whose matrix depends on the state, and flags for singular blocks.

    `plan` describes the structure of the matrix, and `entries` are the values of its lower triangle. Inverses up to
    the size `largest` are values of the procedure; larger inverses are in `memory`.
    """
    blocks = _triangles(plan, entries)
    if plan.diagonal:
        pairs = [(block[0], lower[0, 0]) for block, lower in blocks]
        return Diagonal(p, {i: 1.0 / entry for i, entry in pairs}), [entry.equals(0.0) for _, entry in pairs]
    if is_factored(plan) and largest < ALL:
        return _factored(p, plan, blocks, memory)
    if _is_small(plan, largest):
        inverses: Triangle = {}
        flags = []
        for block, lower in blocks:
            inverse, singular = _inverse(p, len(block), lower, plan.negative(block))
            flags.append(singular)
            inverses |= {(block[i], block[j]): value for (i, j), value in inverse.items()}
        return Inverse(p, plan.size, inverses), flags
    n = plan.size
    matrix, work = memory.at(symmetric.padded(n) ** 2), memory.at(symmetric.padded(n) ** 2 + n * n)
    singular = _inverted(p, plan, blocks, matrix, memory, work)
    return InverseInMemory(p, n, memory, symmetric.padded(n)), [singular]


def constant_size(plan: SolvePlan) -> int:
    """Return the number of doubles in memory for the inverse of a constant matrix; for a diagonal matrix, its size."""
    return plan.size if plan.diagonal else plan.size**2


def constant_inverse(p: Builder, plan: SolvePlan, entries: Iterator[Real], to: Memory) -> list[Flag]:
    """Write the inverse of a constant matrix to memory by columns, or the reciprocals of a diagonal matrix.

    `entries` are the entries of the matrix's lower triangle. Return flags that are true if the matrix is singular.
    """
    blocks, n = _triangles(plan, entries), plan.size
    if plan.diagonal:
        for block, lower in blocks:
            to[block[0]] = 1.0 / lower[0, 0]
        return [lower[0, 0].equals(0.0) for _, lower in blocks]
    matrix, inverse = p.reserve(n * n, name="matrix"), p.reserve(symmetric.padded(n) ** 2, room=8, name="inverse")
    singular = _inverted(p, plan, blocks, matrix, inverse, p.reserve(symmetric.work_size(n), room=8, name="work"))
    with p.loop(0, n) as j, p.loop(0, n) as i:
        to[j * n + i] = inverse[j * symmetric.padded(n) + i]
    return [singular]


def constant_system(p: Builder, plan: SolvePlan, memory: Memory) -> LinearSystem:
    """Return the solver of a linear system with a constant matrix, whose inverse is in `memory`."""
    n = plan.size
    if plan.diagonal:
        return Diagonal(p, {i: memory[i] for i in range(n)})
    if max(map(len, plan.blocks)) > LARGEST_IN_LINE:
        return InverseInMemory(p, n, memory, n)
    return Inverse(p, n, {(i, j): memory[j * n + i] for block in plan.blocks for i in block for j in block})


def _apart(p: Builder, rows: Rows, right: Sequence[Term]) -> list[Term]:
    """Return the entries of the vectors `right` as single values, one for each unknown in order.

    `rows` has for each vector the indices of its unknowns, by lane.
    """
    values = {}
    for chunk, x in zip(rows, right, strict=True):
        for lane, row in enumerate(chunk):
            if row not in values:
                values[row] = joined(p, [(x, lane)])
    return [values[row] for row in sorted(values)]


class Diagonal:
    """A linear system with a diagonal matrix, solved by the reciprocals of its diagonal entries."""

    def __init__(self, p: Builder, reciprocals: Mapping[int, Real]) -> None:
        self.p, self.reciprocals = p, reciprocals
        self.vectors: dict[Sequence[int], Term] = {}

    def read(self, rows: Rows) -> None:
        """Gather the reciprocals of the diagonal entries to vectors, one for each vector of unknowns.

        `rows` has for each vector the indices of its unknowns, by lane.
        """
        for chunk in rows:
            if chunk not in self.vectors:
                self.vectors[chunk] = joined(self.p, [(self.reciprocals[row], 0) for row in chunk])

    def solve(self, rows: Rows, right: Sequence[Term]) -> list[Term]:
        """Return the solution for the right-hand side `right`: the product with the reciprocals."""
        self.read(rows)
        return [None if x is None else x * self.vectors[chunk] for chunk, x in zip(rows, right, strict=True)]


class Inverse:
    """A linear system solved by the inverse of its matrix. Each entry of the inverse is a value of the procedure."""

    def __init__(self, p: Builder, size: int, entries: Triangle) -> None:
        self.p, self.size, self.entries = p, size, entries
        self.columns: dict[tuple[Sequence[int], int], Term] = {}
        """Vectors gathered from the inverse so far, by (row indices of the vector's entries, column)."""

    def solve(self, rows: Rows, right: Sequence[Term]) -> list[Term]:
        """Return the solution for the right-hand side `right`: its product with the inverse."""
        self.read(rows)
        solution: list[Term] = [None] * len(rows)
        for j, x in enumerate(_apart(self.p, rows, right)):
            for i, chunk in enumerate(rows):
                solution[i] = fma(self.p, self.columns[chunk, j], x, solution[i])
        return solution

    def read(self, rows: Rows) -> None:
        """Gather the entries of each column of the inverse to vectors, one for each vector of unknowns.

        `rows` has for each vector the indices of its unknowns, by lane.
        """
        for chunk in rows:
            for j in range(self.size):
                if (chunk, j) not in self.columns:
                    self.columns[chunk, j] = joined(self.p, [(self.entries.get((i, j)), 0) for i in chunk])


class InverseInMemory:
    """A linear system solved by the inverse of its matrix in memory, with columns `stride` doubles apart."""

    def __init__(self, p: Builder, size: int, memory: Memory, stride: int) -> None:
        self.p, self.size, self.memory, self.stride = p, size, memory, stride

    def solve(self, rows: Rows, right: Sequence[Term]) -> list[Term]:
        """Return the solution for the right-hand side `right`: its product with the inverse."""
        p, n = self.p, self.size
        right_side = p.reserve(n, name="right")
        if all(len(chunk) == 1 for chunk in rows):
            solution = p.reserve(n, name="solution")
            for i, x in enumerate(_apart(p, rows, right)):
                right_side[i] = 0.0 if x is None else x
            self.multiply(right_side, solution)
            return [solution[i] for i in range(n)]
        for chunk, x in zip(rows, right, strict=True):
            put(p, right_side, chunk[0], x, len(chunk), len(dict.fromkeys(chunk)))
        products = self.in_loop(rows, right_side) if n > MOST_INVERSE_COLUMNS else self.in_line(rows, right_side)
        for k, chunk in enumerate(rows):
            # The last distinct entry is repeated in the lanes that repeat an unknown.
            last = len(dict.fromkeys(chunk)) - 1
            if last < len(chunk) - 1:
                products[k] = p.permuted([products[k]], [min(lane, last) for lane in range(len(chunk))])
        return products

    def in_line(self, rows: Rows, right: Memory) -> list[Term]:
        """Return the product of inverse and right-hand side without a loop, in two partial sums."""
        sums: list[list[Term]] = [[None, None] for _ in rows]
        for j in range(self.size):
            x = right[j]
            for chunk, two in zip(rows, sums, strict=True):
                two[j % 2] = fma(self.p, entries(self.memory, j * self.stride + chunk[0], len(chunk)), x, two[j % 2])
        return [plus(*two) for two in sums]

    def in_loop(self, rows: Rows, right: Memory) -> list[Term]:
        """Return the product of inverse and right-hand side, computed in a loop over columns."""
        p = self.p
        sums = [p.variable(wide(p, None, len(chunk))) for chunk in rows]
        with p.loop(0, self.size) as j:
            column, x = self.memory.at(j * self.stride), right[j]
            for chunk, total in zip(rows, sums, strict=True):
                total.value = fma(p, entries(column, chunk[0], len(chunk)), x, total.value)
        return [total.value for total in sums]

    def multiply(self, right: Memory, solution: Memory) -> None:
        """Write the product of the inverse and a right-hand side, both in memory, to `solution`."""
        p, n = self.p, self.size
        with p.each(n, width=1) as i:
            solution[i] = 0.0
        with p.loop(0, n) as j:
            column, x = self.memory.at(j * self.stride), right[j]
            with p.each(n, width=1) as i:
                solution[i] = p.fma(column[i], x, solution[i])


class FactoredSystem:
    """A linear system solved by the factors of each block of its matrix.

    A block with a pivot that is too small is factored with pivoting.
    """

    def __init__(self, p: Builder, blocks: Sequence[_FactoredBlock], size: int) -> None:
        self.p, self.blocks, self.size = p, blocks, size

    def solve(self, rows: Rows, right: Sequence[Term]) -> list[Term]:
        """Return the solution for the right-hand side `right`, by substitution in each block."""
        single, product = _apart(self.p, rows, right), [None] * self.size
        for block in self.blocks:
            solution = block.solve([single[i] for i in block.unknowns])
            for i, x in zip(block.unknowns, solution, strict=True):
                product[i] = x
        return [joined(self.p, [(product[row], 0) for row in chunk]) for chunk in rows]


def _is_small(plan: SolvePlan, largest: int) -> bool:
    """Return True if the inverses of all blocks are written out, because none is larger than `largest`."""
    return max(map(len, plan.blocks)) <= largest and plan.size <= 2 * largest


def _triangles(plan: SolvePlan, entries: Iterator[Real]) -> list[tuple[tuple[int, ...], Triangle]]:
    """Divide a matrix into its blocks. Return for each block the indices of its unknowns and its lower triangle.

    The triangle has values by index pair. `entries` are the values of the lower triangle of the whole matrix, in
    the order of the plan.
    """
    position = {unknown: (number, i) for number, block in enumerate(plan.blocks) for i, unknown in enumerate(block)}
    triangles: list[Triangle] = [{} for _ in plan.blocks]
    for row, column in plan.triangle:
        number, i = position[row]
        triangles[number][i, position[column][1]] = next(entries)
    return list(zip(plan.blocks, triangles, strict=True))


def _write_triangle(p: Builder, n: int, lower: Mapping[tuple[int, int], Real], to: Memory) -> None:
    """Write the lower triangle of an n-by-n matrix to memory by columns; `lower` has the nonzero entries."""
    if len(lower) < n * (n + 1) // 2:
        with p.each(n * n, width=1) as k:
            to[k] = 0.0
    for (i, j), value in lower.items():
        to[j * n + i] = value


def _inverse(p: Builder, n: int, lower: Triangle, negative: tuple[int, ...]) -> tuple[Triangle, Flag]:
    """Return the inverse of a small symmetric n-by-n matrix, by index pair, and a flag: true if it is singular.

    `lower` has the values of the matrix's lower triangle by index pair. `negative` are the indices of the pivots that
    are negative in every state, those of multipliers. p builds the procedure.
    """
    plan = elimination(n, frozenset(lower), negative)
    factors, trusted = factored(p, plan, lower)
    columns = [solved(p, plan, factors, [p.real(float(i == j)) for i in range(n)]) for j in range(n)]
    variables = {(i, j): p.variable(columns[j][i]) for j in range(n) for i in range(j, n)}
    singular = p.variable(p.false)
    with p.when(~trusted, likely=False):
        matrix, inverse = p.reserve(n * n, name="matrix"), p.reserve(n * n, name="inverse")
        _write_triangle(p, n, lower, matrix)
        singular.value = p.call(
            symmetric.invert_dense.form(), n, matrix, inverse, p.reserve(symmetric.factor_size(n), name="work")
        )
        for (i, j), variable in variables.items():
            variable.value = inverse[j * n + i]
    entries = {entry: variable.value for entry, variable in variables.items()}
    return entries | {(j, i): value for (i, j), value in entries.items()}, Flag.of(singular.value)


def _inverted(
    p: Builder,
    plan: SolvePlan,
    blocks: Sequence[tuple[tuple[int, ...], Triangle]],
    matrix: Memory,
    inverse: Memory,
    work: Memory,
) -> Flag:
    """Write the inverse of a symmetric matrix to `inverse`, by columns. Return a flag: true if it is singular.

    `blocks` has for each block the indices of its unknowns and its lower triangle. `matrix` is memory for the whole
    matrix, and `work` is work memory.
    """
    n, placed = plan.size, {}
    for block, lower in blocks:
        for (i, j), value in lower.items():
            second, first = sorted((block[i], block[j]))
            placed[first, second] = value
    _write_triangle(p, n, placed, matrix)
    is_singular = p.call(symmetric.invert.form(), n, symmetric.padded(n), matrix, inverse, work)
    assert isinstance(is_singular, Flag)
    return is_singular


def _factored_size(block: Elimination) -> int:
    n, band = block.order, block.band
    return len(block.places) + symmetric.pivoted_size(n, band) + int(symmetric.band_size(n, band)) + n


def _factored(
    p: Builder, plan: SolvePlan, blocks: Sequence[tuple[tuple[int, ...], Triangle]], memory: Memory
) -> tuple[LinearSystem, list[Flag]]:
    made, begin = [], 0
    for (block, lower), how in zip(blocks, block_eliminations(plan), strict=True):
        made.append(_FactoredBlock(p, block, how, lower, memory.at(begin)))
        begin += _factored_size(how)
    return FactoredSystem(p, made, plan.size), [block.singular for block in made]


class _FactoredBlock:
    """The factors of one block of a matrix in memory: the entries of L, then factors with pivoting.

    The factors with pivoting are computed if a pivot is too small without pivoting.
    """

    def __init__(
        self, p: Builder, unknowns: tuple[int, ...], how: Elimination, lower: Triangle, memory: Memory
    ) -> None:
        self.p, self.unknowns, self.how, self.memory = p, unknowns, how, memory
        n, band = how.order, how.band
        self.places = {entry: k for k, entry in enumerate(how.places)}
        self.factors = memory.at(len(how.places))
        matrix = memory.at(len(how.places) + symmetric.pivoted_size(n, band))
        self.right = memory.at(len(how.places) + symmetric.pivoted_size(n, band) + symmetric.band_size(n, band))
        factors, trusted = factored(p, how, lower)
        zero = p.real(0.0)
        for entry, k in self.places.items():
            memory[k] = factors.get(entry, zero)
        singular = p.variable(p.false)
        self.trusted = trusted
        with p.when(~trusted, likely=False):
            write_band(p, how, lower, matrix)
            singular.value = p.call(symmetric.factor_pivoted.form(), n, band, matrix, self.factors)
        self.singular = Flag.of(singular.value)

    def solve(self, right: Sequence[Term]) -> list[Term]:
        """Return the solution for a right-hand side of the block, without pivoting if that is accurate."""
        p, n, zero = self.p, self.how.order, self.p.real(0.0)
        right_side: list[Any] = [zero if x is None else x for x in right]
        variables = [p.variable(zero) for _ in range(n)]
        with p.when(self.trusted, likely=True) as ways:
            entries = {entry: self.memory[k] for entry, k in self.places.items()}
            solution = solved(p, self.how, entries, right_side)
            for variable, x in zip(variables, solution, strict=True):
                variable.value = x
        with ways.otherwise():
            for rank, x in zip(self.how.ranks, right_side, strict=True):
                self.right[rank] = x
            p.call(symmetric.solve_pivoted.form(), n, self.how.band, self.factors, self.right)
            for rank, variable in zip(self.how.ranks, variables, strict=True):
                variable.value = self.right[rank]
        return [variable.value for variable in variables]
