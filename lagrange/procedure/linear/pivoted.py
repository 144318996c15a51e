"""Solve symmetric systems that are not definite: P A = L U with scaled partial pivoting, within a band.

Entries (i, j) with |i - j| above the `band` are zero. The lower triangle is given by columns: entry (i, j), i >= j, at
j*band + i, which for a band of n is a full matrix by columns. Exchanges of rows widen U to twice the band, and stay
within it, so that a long chain takes a time like n. The factors are those of the full matrix, rounding included.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sections 3.4 and 4.3.

Factors take `pivoted_size` reals: [row scales (n), the row exchanged with each (n), columns]. A column has those of its
rows that may be filled, from `_first_row` on.
"""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

PIVOT = 2.0**-46
"""A symmetric matrix is singular to round-off where elimination with pivoting, its rows scaled, meets a pivot of at
most this part of its row's largest entry: 64 rounding errors. The entries of its inverse, in units in which its
diagonal is one, then exceed 1 / PIVOT."""


def band_size(n: Any, band: Any) -> Any:
    """Return the number of reals of a lower triangle within a band less than n, of whole numbers or values."""
    return n * band + n


def pivoted_size(n: int, band: int) -> int:
    """Return the number of reals that the factors of a matrix of order n take."""
    return 2 * n + n * min(n, 3 * band + 1)


class _Columns:
    """The columns of L and U: entry (i, j) is `of(j)[i]`."""

    def __init__(self, p: Builder, n: Whole, band: Whole, memory: Memory) -> None:
        self.p, self.band, self.memory = p, band, memory
        self.height = p.smaller(n, 3 * band + 1).called("height")
        self.last_start = n - self.height

    def of(self, j: Whole) -> Memory:
        """Return a column, moved so that its index is the row."""
        first = self.p.smaller(self.p.larger(j - 2 * self.band, 0), self.last_start)
        return self.memory.at(j * self.height - first)


def _parts(p: Builder, n: Whole, band: Whole, factors: Memory) -> tuple[Memory, Memory, _Columns]:
    """Return row scales, exchanges and columns inside factors."""
    return factors.at(0), factors.at(n), _Columns(p, n, band, factors.at(2 * n))


def _end(p: Builder, n: Whole, last: Any) -> Any:
    """Return the end of a loop to a row or column, at most n."""
    return p.smaller(n, last + 1)


@shared
def factor_pivoted() -> Procedure:
    """Return P A = L U of a matrix, and whether it is singular."""
    p = Builder("factor_pivoted", "Factor P A = L U with scaled pivots, and say whether A is singular to round-off.")
    n, band = p.given("n", WHOLE), p.given("band", WHOLE)
    a, factors = p.array("a", read=True), p.array("factors")
    scales, exchanges, columns = _parts(p, n, band, factors)
    nothing = _scaled_rows(p, n, band, a, scales)
    with p.loop(0, n) as j:
        column, first = columns.of(j), p.larger(j - 2 * band, 0)
        with p.loop(first, _end(p, n, j + band)) as i:
            column[i] = 0.0
    with p.loop(0, n) as j:
        column, given = columns.of(j), a.at(j * band)
        with p.loop(j, _end(p, n, j + band)) as i:
            entry = given[i]
            column[i] = entry
            columns.of(i)[j] = entry
    singular = p.variable(p.false, "singular")
    with p.loop(0, n) as j:
        column, rows, reach = columns.of(j), _end(p, n, j + band), _end(p, n, j + 2 * band)
        best, row = p.variable(-1.0, "best"), p.variable(j, "row")
        with p.loop(j, rows) as i:
            size = abs(column[i]) * scales[i]
            with p.when(size > best.value):
                best.value = size
                row.value = i
        chosen = row.value
        exchanges[j] = p.real(chosen)
        scales[j], scales[chosen] = scales[chosen], scales[j]
        with p.loop(j, reach) as k:
            other = columns.of(k)
            other[j], other[chosen] = other[chosen], other[j]
        pivot = column[j].called("pivot")
        p.note("A row of zeros gives 0 * inf.")
        vanishes = (abs(pivot) * scales[j] <= PIVOT) | pivot.equals(0.0)
        singular.value = singular.value | vanishes
        reciprocal = 1.0 / pivot
        with p.loop(j + 1, rows) as i:
            column[i] = column[i] * reciprocal
        with p.loop(j + 1, reach) as k:
            target = columns.of(k)
            factor = -target[j]
            with p.when(~factor.equals(0.0)), p.loop(j + 1, rows) as i:
                target[i] = p.fma(factor, column[i], target[i])
    p.note("A matrix with an entry that is not finite is not singular: the entry passes to the solution.")
    p.leave(singular.value & nothing.equals(0.0))
    return p.finish(FLAG)


def _scaled_rows(p: Builder, n: Whole, band: Whole, a: Memory, scales: Memory) -> Any:
    """Write one over the largest entry of each row; return zero times all entries: NaN if one is not finite."""
    nothing = p.variable(0.0, "nothing")
    with p.loop(0, n) as i:
        scales[i] = 0.0
    with p.loop(0, n) as j:
        given = a.at(j * band)
        with p.loop(j, _end(p, n, j + band)) as i:
            size = abs(given[i])
            for row in (i, j):
                scales[row] = p.choose(size > scales[row], size, scales[row])
            p.note("Zero times a NaN or an infinity is NaN, and stays.")
            nothing.value = p.fma(size, 0.0, nothing.value)
    with p.loop(0, n) as i:
        scales[i] = 1.0 / scales[i]
    return nothing.value


@shared
def solve_pivoted() -> Procedure:
    """Return the solution of a system with the factors of `factor_pivoted`."""
    p = Builder("solve_pivoted", "Replace a right-hand side by the solution.")
    n, band = p.given("n", WHOLE), p.given("band", WHOLE)
    factors, b = p.array("factors", read=True), p.array("b")
    _, exchanges, columns = _parts(p, n, band, factors)
    with p.loop(0, n) as j:
        chosen = p.whole(exchanges[j])
        b[j], b[chosen] = b[chosen], b[j]
        factor, column = -b[j], columns.of(j)
        with p.loop(j + 1, _end(p, n, j + band)) as i:
            b[i] = p.fma(factor, column[i], b[i])
    with p.loop(0, n) as back:
        j = n - 1 - back
        column = columns.of(j)
        x = b[j] / column[j]
        b[j] = x
        with p.loop(p.larger(j - 2 * band, 0), j) as i:
            b[i] = p.fma(-x, column[i], b[i])
    return p.finish()
