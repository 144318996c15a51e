"""Solve symmetric systems of any order: L D L^T where the matrix is definite, elimination with pivoting elsewhere.

A matrix is given as its lower triangle by columns: entry (i, j), i >= j, at j*n + i. It is factored as L D L^T without
pivoting, which is stable for a positive definite mass matrix. Where a pivot vanishes against its diagonal entry, at
`PIVOT`, the matrix is factored again with pivoting (see `lagrange.procedure.linear.pivoted`), which serves every
regular matrix; only a pivot that vanishes there too is called singular. A factor that is zero subtracts nothing: its
column is left out, so that a sparse matrix in a good order takes a time like n^2.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, section 4.1.

Factors are kept in an array of `factor_size(n)` reals: [kind, rest]. The rest is [1/d (n), n unused, columns (n*n)] of
L D L^T for kind 0, with L below the diagonal, and the factors of `factor_pivoted` for kind 1.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.procedure.form import Array
from lagrange.procedure.front.plain import procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma
from lagrange.procedure.linear.pivoted import PIVOT, factor_pivoted, pivoted_size, solve_pivoted

PIVOT_BESIDE_MULTIPLIERS = 2.0**-10
"""Elimination in a given order is trusted beside multipliers where each pivot exceeds this part of its terms.

It then loses three digits at most. A definite matrix loses none with any pivot.
"""


COLUMNS_AT_ONCE = 8
"""So many right-hand sides are solved for at once: the widest vectors of doubles that processors have."""


RESIDUAL = 2.0**-40
"""Part of its terms that a row of a multiplier may be off by, for a solution by pivots in their order to be trusted."""


def least_pivot(negative: Sequence[int]) -> float:
    """Return the least pivot that is trusted, relative to its terms, in a matrix with some pivots below zero."""
    return PIVOT_BESIDE_MULTIPLIERS if negative else PIVOT


def factor_size(n: int) -> int:
    """Return the number of reals that the factors of a matrix of order n take."""
    return 1 + pivoted_size(n, n)


@procedure
def factor_symmetric(n: int, a: In, factors: Out) -> bool:
    """Factor A = L D L^T by columns, and say whether every pivot can be trusted."""
    reciprocals, columns = factors[1:], factors[2 * n + 1 :]
    for j in range(n):
        for i in range(j, n):
            columns[j * n + i] = a[j * n + i]
    trusted = True
    for j in range(n):
        column = columns[j * n :]
        d = column[j]
        large = d > abs(a[j * n + j]) * PIVOT
        trusted = trusted and large
        reciprocal = 1.0 / d
        reciprocals[j] = reciprocal
        # The finished column is subtracted from the columns behind it.
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
    """Factor a symmetric matrix, with pivoting where L D L^T cannot be trusted; say whether it is singular."""
    trusted = factor_symmetric(n, a, factors)
    factors[0] = 0.0
    if trusted:
        return False
    factors[0] = 1.0
    return factor_pivoted(n, n, a, factors[1:])


@procedure
def solve_factored(n: int, factors: In, b: Out) -> None:
    """Replace a right-hand side by the solution, with the factors of `factor_dense`."""
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


@procedure(b=lambda: Array(room=COLUMNS_AT_ONCE))
def solve_columns(n: int, columns: int, factors: In, b: Out, spare: Out) -> None:
    """Replace right-hand sides by solutions, entry k of column c at k*columns + c; `spare` takes n reals.

    The columns are a multiple of `COLUMNS_AT_ONCE`. The operations are those of `solve_factored` for each.
    """
    reciprocals, lower = factors[1:], factors[2 * n + 1 :]
    # Factors with pivoting are rare: one column after the other.
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
            for c in each(columns, width=COLUMNS_AT_ONCE, spill=True, disjoint=True):
                target[c] = fma(source[c], entry, target[c])
    for back in range(n):
        j = n - 1 - back
        target, column, reciprocal = b[j * columns :], lower[j * n :], reciprocals[j]
        for c in each(columns, width=COLUMNS_AT_ONCE, spill=True, disjoint=True):
            total = target[c] * reciprocal
            for i in range(j + 1, n):
                total = fma(b[i * columns :][c], -column[i], total)
            target[c] = total


@procedure
def invert_dense(n: int, a: In, out: Out, work: Out) -> bool:
    """Write the inverse by columns, and say whether the matrix is singular; `work` takes the factors."""
    singular = factor_dense(n, a, work)
    for j in range(n):
        column = out[j * n :]
        for i in range(n):
            column[i] = 0.0
        column[j] = 1.0
        solve_factored(n, work, column)
    return singular
