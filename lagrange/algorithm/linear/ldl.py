"""Solve symmetric systems of any order: L D L^T for definite matrices, elimination with pivoting for others.

A matrix is given as its lower triangle by columns: entry (i, j), i >= j, at j*n + i. It is factored as L D L^T without
pivoting, which is stable for a positive definite mass matrix. If a pivot vanishes against its diagonal entry, at
`PIVOT`, the matrix is factored again with pivoting (see `lagrange.algorithm.linear.pivoted`), which works for every
regular matrix. The matrix counts as singular only if a pivot vanishes with pivoting too. A zero factor subtracts
nothing and its column is skipped, so that the time for a sparse matrix in a good order is proportional to n^2.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, section 4.1.

Factors are kept in an array of `factor_size(n)` reals: [kind, rest]. The rest is [1/d (n), n unused, columns (n*n)] of
L D L^T for kind 0, with L below the diagonal, and the factors of `factor_pivoted` for kind 1.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.linear.pivoted import PIVOT, factor_pivoted, pivoted_size, solve_pivoted
from lagrange.procedure.form import Array
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma

PIVOT_BESIDE_MULTIPLIERS = 2.0**-10
"""Least pivot, relative to its terms, that elimination in a given order accepts in systems with multipliers. Then at
most three digits are lost. For definite matrices no digits are lost with any pivot.
"""


RESIDUAL = 2.0**-40
"""Largest residual of a multiplier's row, relative to its terms, at which a solution without pivoting is accepted."""


def least_pivot(negative: Sequence[int]) -> float:
    """Return the least accepted pivot, relative to the terms of which it is the sum.

    `negative` are the indices of negative pivots, those of multipliers.
    """
    return PIVOT_BESIDE_MULTIPLIERS if negative else PIVOT


def factor_size(n: int) -> int:
    """Return the number of reals that the factors of a matrix of size n occupy."""
    return 1 + pivoted_size(n, n)


@inline
def is_trusted(pivot: float, diagonal: float) -> bool:
    """Return True if a pivot of L D L^T is above the rounding error of its diagonal entry in A."""
    return pivot > abs(diagonal) * PIVOT


@procedure
def factor_symmetric(n: int, a: In, factors: Out) -> bool:
    """Factor a symmetric matrix as L D L^T without pivoting. Return True if every pivot is large enough.

    a is its lower triangle by columns, entry (i, j) at j*n + i. `factors` receives 1/d from index 1 on, and the
    columns of L from index 2n + 1 on.
    """
    reciprocals, columns = factors[1:], factors[2 * n + 1 :]
    for j in range(n):
        for i in range(j, n):
            columns[j * n + i] = a[j * n + i]
    trusted = True
    for j in range(n):
        column = columns[j * n :]
        d = column[j]
        large = is_trusted(d, a[j * n + j])
        trusted = trusted and large
        reciprocal = 1.0 / d
        reciprocals[j] = reciprocal
        # The finished column is subtracted from the later columns.
        for k in range(j + 1, n):
            factor = -(column[k] * reciprocal)
            target = columns[k * n :]
            if factor != 0.0:
                for i in range(k, n):
                    target[i] = fma(factor, column[i], target[i])
        for i in range(j + 1, n):
            column[i] *= reciprocal
    return trusted


@procedure
def factor_dense(n: int, a: In, factors: Out) -> bool:
    """Factor a symmetric matrix, with pivoting if a pivot of L D L^T is small. Return True if it is singular.

    a is its lower triangle by columns, entry (i, j) at j*n + i. `factors` has `factor_size(n)` reals; the first
    is 1.0 with pivoting, else 0.0.
    """
    trusted = factor_symmetric(n, a, factors)
    factors[0] = 0.0
    if trusted:
        return False
    factors[0] = 1.0
    return factor_pivoted(n, n, a, factors[1:])


@procedure
def solve_factored(n: int, factors: In, b: Out) -> None:
    """Replace the right-hand side b of a linear system by the solution, by `factors` of `factor_dense`."""
    reciprocals, columns = factors[1:], factors[2 * n + 1 :]
    if factors[0] != 0.0:
        solve_pivoted(n, n, factors[1:], b)
        return
    for j in range(n):
        factor, column = -b[j], columns[j * n :]
        for i in range(j + 1, n):
            b[i] = fma(factor, column[i], b[i])
    for i in range(n):
        b[i] *= reciprocals[i]
    for back in range(n):
        j = n - 1 - back
        column, total = columns[j * n :], b[j]
        for i in range(j + 1, n):
            total = fma(-column[i], b[i], total)
        b[j] = total


@procedure(b=lambda: Array(room=WIDEST_VECTOR))
def solve_columns(n: int, columns: int, factors: In, b: Out, spare: Out) -> None:
    """Replace right-hand sides b of linear systems by the solutions, by `factors` of `factor_dense`.

    Entry k of column c is at k*columns + c. `spare` takes n reals. `columns` is a multiple of `WIDEST_VECTOR`.
    The operations on each column are those of `solve_factored`.
    """
    reciprocals, lower = factors[1:], factors[2 * n + 1 :]
    # Factors with pivoting are rare: their columns are solved one after the other.
    if factors[0] != 0.0:
        for c in range(columns):
            for k in range(n):
                spare[k] = b[k * columns + c]
            solve_factored(n, factors, spare)
            for k in range(n):
                b[k * columns + c] = spare[k]
        return
    for j in range(n):
        source, column = b[j * columns :], lower[j * n :]
        for i in range(j + 1, n):
            target, entry = b[i * columns :], -column[i]
            for c in each(columns, width=WIDEST_VECTOR, spill=True, disjoint=True):
                target[c] = fma(source[c], entry, target[c])
    for back in range(n):
        j = n - 1 - back
        target, column, reciprocal = b[j * columns :], lower[j * n :], reciprocals[j]
        for c in each(columns, width=WIDEST_VECTOR, spill=True, disjoint=True):
            total = target[c] * reciprocal
            for i in range(j + 1, n):
                total = fma(b[i * columns :][c], -column[i], total)
            target[c] = total


@procedure
def invert_dense(n: int, a: In, out: Out, work: Out) -> bool:
    """Write the inverse of a symmetric matrix to `out`, entry (i, j) at j*n + i. Return True if it is singular.

    a is the lower triangle of the matrix, in the same order. `work` takes the factors, `factor_size(n)` reals.
    """
    singular = factor_dense(n, a, work)
    for j in range(n):
        column = out[j * n :]
        for i in range(n):
            column[i] = 0.0
        column[j] = 1.0
        solve_factored(n, work, column)
    return singular
