"""Factor, solve and invert symmetric matrices, with pivoting if a pivot is small; the test for singular matrices.

A matrix is given as its lower triangle by columns: entry (i, j), i >= j, at j*n + i. The matrix is factored as L D L^T
without pivoting, which is stable for a positive definite mass matrix. If a pivot vanishes against its diagonal entry,
at `PIVOT`, the matrix is factored again with pivoting, which works for every regular matrix. The matrix counts as
singular only if a pivot vanishes with pivoting too. A zero factor subtracts nothing and its column is skipped, so that
the time for a sparse matrix in a good order is proportional to n^2. Factors are kept in an array of `factor_size(n)`
reals: [kind, rest]. The rest is [1/d (n), n unused, columns (n*n)] of L D L^T for kind 0, with L below the diagonal,
and the factors of `factor_pivoted` for kind 1.

Elimination with pivoting is P A = L U with scaled partial pivoting, within a band: entries (i, j) with |i - j| above
the `band` are zero. Entry (i, j) is at j*band + i, which for a band of n is a full matrix by columns. Row exchanges
widen U to at most twice the band, so a long chain takes a time like n. The factors are those of the full matrix,
rounding included. The units of coordinates and constraints do not matter: the matrix is scaled to a diagonal of one,
and rows without a diagonal entry to a largest entry of one. Factors take `pivoted_size` reals: [row scales (n), the row
exchanged with each (n), column scales (n), preferences (n), columns]. A column stores the rows that may be filled, from
row j - 2 band on. `column` is its offset, shifted so that its index is the row.

An inverse is computed in vectors of eight, and written by columns, which are `stride` reals apart, a multiple of eight.
Entries after the n-th row are zero or undefined. A = L D L^T, then L D (L^T X) = I for all columns at once.

Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sections 3.4, 4.1 and 4.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.procedure.form import Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, Readable, Writable, each, fma, likely

PIVOT = 2.0**-46
"""A symmetric matrix is singular within rounding errors if elimination with pivoting meets a scaled pivot of at most
this size, 64 rounding errors. The entries of its inverse, in units in which its diagonal is one, then exceed 1 / PIVOT.
"""

PREFERENCE = 2.0**4
"""Factor on the sizes of rows of constraints in the choice of a pivot. Constraints are preferred, because an inertia
may belong to a light body, or be only rounding.
"""


INDEFINITE = 2.0
"""Largest off-diagonal entry of a row that is scaled so that its diagonal entry is one. A row with a larger entry is
scaled by this entry instead. A positive definite matrix with ones on its diagonal has no entry above 1.
"""


@inline
def band_size(n: int, band: int) -> int:
    """Return the number of reals of a lower triangle of size n with entries (i, j) for i - j <= band only."""
    return n * band + n


def pivoted_size(n: int, band: int) -> int:
    """Return the number of reals of the factors P A = L U of a matrix of size n with a half bandwidth `band`.

    The factors include the scales and the exchanged rows.
    """
    return 4 * n + n * min(n, 3 * band + 1)


@inline
def column(n: int, band: int, j: int) -> int:
    """Return the offset of column j of L and U in the factors: the entry in row i is at this offset + i.

    The factors P A = L U are those of a matrix of size n with a half bandwidth `band`.
    """
    height = min(n, 3 * band + 1)
    first = min(max(j - 2 * band, 0), n - height)
    return 4 * n + j * height - first


@procedure
def factor_pivoted(n: int, band: int, a: In, factors: Out) -> bool:
    """Factor a symmetric matrix as P A = L U. Return True if it is singular within rounding errors.

    a is its lower triangle within the half bandwidth `band`: entry (i, j), i >= j, at j*band + i. `factors`
    takes `pivoted_size` reals: n row scales, the n rows that were exchanged with rows 0 to n - 1, n column
    scales, n factors that make rows of constraints preferred pivots, then the columns of L and U.
    """
    scales, exchanges, units, preferences = factors, factors[n:], factors[2 * n :], factors[3 * n :]
    nothing = scale_rows(n, band, a, scales, exchanges)
    for i in range(n):
        units[i] = scales[i]
        preferences[i] = PREFERENCE if a[i * band + i] == 0.0 else 1.0
    for j in range(n):
        entries = factors[column(n, band, j) :]
        for i in range(max(j - 2 * band, 0), min(n, j + band + 1)):
            entries[i] = 0.0
    for j in range(n):
        entries, source = factors[column(n, band, j) :], a[j * band :]
        for i in range(j, min(n, j + band + 1)):
            entry = source[i]
            entries[i] = entry
            factors[column(n, band, i) :][j] = entry
    singular = False
    for j in range(n):
        entries, rows, reach = factors[column(n, band, j) :], min(n, j + band + 1), min(n, j + 2 * band + 1)
        best, row = -1.0, j
        for i in range(j, rows):
            size = abs(entries[i]) * scales[i] * preferences[i]
            if size > best:
                best, row = size, i
        exchanges[j] = float(row)
        scales[j], scales[row] = scales[row], scales[j]
        preferences[j], preferences[row] = preferences[row], preferences[j]
        for k in range(j, reach):
            other = factors[column(n, band, k) :]
            other[j], other[row] = other[row], other[j]
        pivot = entries[j]
        singular = singular or abs(pivot) * scales[j] * units[j] <= PIVOT
        reciprocal = 1.0 / pivot
        for i in range(j + 1, rows):
            entries[i] *= reciprocal
        for k in range(j + 1, reach):
            target = factors[column(n, band, k) :]
            factor = -target[j]
            if factor != 0.0:
                for i in range(j + 1, rows):
                    target[i] = fma(factor, entries[i], target[i])
    # A matrix with an entry that is not finite does not count as singular: the solution is then not finite.
    return singular and nothing == 0.0


@inline
def scale_rows(n: int, band: int, a: Readable[float], scales: Writable[float], largest: Writable[float]) -> float:
    """Write a scale factor for each row, and the column of the same index, of a symmetric matrix to `scales`.

    a is its lower triangle within a `band`. Scaled diagonal entries are 1, except in rows with an entry above
    `INDEFINITE`. Rows with a zero diagonal entry, of constraints or of coordinates without inertia, are scaled by
    their largest entry. `largest` is work memory. Return NaN if an entry of the matrix is not finite, else 0.
    """
    for i in range(n):
        inertia = abs(a[i * band + i])
        scales[i] = 1.0 / math.sqrt(inertia) if inertia > 0.0 else 0.0
    nothing = largest_in_rows(n, band, a, scales, largest)
    is_open = False
    for i in range(n):
        size = scales[i] * largest[i]
        if scales[i] == 0.0:
            is_open = is_open or largest[i] == 0.0
            scales[i] = 1.0 / largest[i] if largest[i] > 0.0 else 0.0
        elif size > INDEFINITE:
            scales[i] /= math.sqrt(size)
    if is_open:
        nothing = largest_in_rows(n, band, a, scales, largest)
        for i in range(n):
            if scales[i] == 0.0:
                scales[i] = 1.0 / largest[i] if largest[i] > 0.0 else 1.0
        nothing = largest_in_rows(n, band, a, scales, largest)
        for i in range(n):
            if largest[i] > 0.0:
                scales[i] /= math.sqrt(scales[i] * largest[i])
    return nothing


@inline
def largest_in_rows(n: int, band: int, a: Readable[float], scales: Readable[float], largest: Writable[float]) -> float:
    """Write the largest magnitude in each row of a matrix to `largest`, with columns scaled by `scales`.

    a is the lower triangle of the symmetric matrix within a `band`. Return NaN if an entry is not finite, else 0.
    """
    nothing = 0.0
    for i in range(n):
        largest[i] = 0.0
    for j in range(n):
        source = a[j * band :]
        for i in range(j, min(n, j + band + 1)):
            size = abs(source[i])
            across, down = size * scales[j], size * scales[i]
            if across > largest[i]:
                largest[i] = across
            if down > largest[j]:
                largest[j] = down
            # Zero times NaN or infinity is NaN, and remains in the sum.
            nothing = fma(size, 0.0, nothing)
    return nothing


@procedure
def solve_pivoted(n: int, band: int, factors: In, b: Out) -> None:
    """Replace the right-hand side b of a linear system of size n by the solution.

    `factors` are P A = L U within a `band`, as `factor_pivoted` writes them.
    """
    exchanges = factors[n:]
    for j in range(n):
        chosen = int(exchanges[j])
        b[j], b[chosen] = b[chosen], b[j]
        factor, entries = -b[j], factors[column(n, band, j) :]
        for i in range(j + 1, min(n, j + band + 1)):
            b[i] = fma(factor, entries[i], b[i])
    for back in range(n):
        j = n - 1 - back
        entries = factors[column(n, band, j) :]
        x = b[j] / entries[j]
        b[j] = x
        for i in range(max(j - 2 * band, 0), j):
            b[i] = fma(-x, entries[i], b[i])


PIVOT_BESIDE_MULTIPLIERS = 2.0**-10
"""Least pivot, relative to its terms, that elimination in a given order accepts in systems with multipliers. Accepted
pivots lose at most three digits. For definite matrices no digits are lost with any pivot.
"""


RESIDUAL = 2.0**-40
"""Largest residual of a multiplier's row, relative to its terms, at which a solution without pivoting is accepted."""


def least_pivot(negative: Sequence[int]) -> float:
    """Return the smallest pivot that is accepted, relative to the sizes of the terms whose sum it is.

    `negative` are the indices of negative pivots, which belong to multipliers. `negative` is empty without
    multipliers.
    """
    return PIVOT_BESIDE_MULTIPLIERS if negative else PIVOT


def factor_size(n: int) -> int:
    """Return the number of reals that `factor_dense` writes for a matrix of size n."""
    return 1 + pivoted_size(n, n)


@procedure
def factor_columns(n: int, stride: int, a: In, lower: Out, reciprocals: Out) -> bool:
    """Factor a symmetric matrix as L D L^T without pivoting. Return True if every pivot is large enough.

    `lower` has the columns of its lower triangle, `stride` reals apart. Below the diagonal they are replaced by
    L; the diagonal itself is overwritten too. `reciprocals` receives 1/d. The diagonal of the matrix is also
    read from a, where entry (i, j) is at j*n + i.
    """
    trusted = True
    for j in range(n):
        column = lower[j * stride :]
        d = column[j]
        large = d > abs(a[j * n + j]) * PIVOT
        trusted = trusted and large
        reciprocal = 1.0 / d
        reciprocals[j] = reciprocal
        # The finished column is subtracted from the later columns.
        for k in range(j + 1, n):
            factor, target = -(column[k] * reciprocal), lower[k * stride :]
            if factor != 0.0:
                for i in range(k, n):
                    target[i] = fma(factor, column[i], target[i])
        for i in range(j + 1, n):
            column[i] *= reciprocal
    return trusted


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
    return factor_columns(n, n, a, columns, reciprocals)


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
    """Replace the right-hand side b of a linear system of size n by the solution.

    `factors` are those that `factor_dense` writes: L D L^T or, with pivoting, P A = L U.
    """
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
    """Replace the right-hand sides b of several linear systems with one matrix by the solutions.

    `factors` are those that `factor_dense` writes. Entry k of right-hand side c is at k*columns + c. `spare`
    takes n reals. `columns` is a multiple of `WIDEST_VECTOR`. The operations on each column are those of
    `solve_factored`.
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

    a is the lower triangle of the matrix, with entry (i, j), i >= j, at the same index. `work` takes the
    factors, `factor_size(n)` reals.
    """
    singular = factor_dense(n, a, work)
    for j in range(n):
        column = out[j * n :]
        for i in range(n):
            column[i] = 0.0
        column[j] = 1.0
        solve_factored(n, work, column)
    return singular


def padded(n: int) -> int:
    """Return the distance in memory between columns of an inverse of size n, a multiple of eight."""
    return whole_blocks(n, WIDEST_VECTOR)


def work_size(n: int) -> int:
    """Return the number of reals in the work memory of `invert` for a matrix of size n.

    It holds L and 1/d or, with pivoting, the inverse and its factors.
    """
    return max(padded(n) ** 2 + n, n * n + factor_size(n))


@procedure(lower=lambda: Array(read=True, room=WIDEST_VECTOR), x=lambda: Array(room=WIDEST_VECTOR))
def solve_identity(n: int, stride: int, lower: In, d: In, x: Out) -> None:
    """Solve L D L^T X = I for X, the inverse of a matrix of size n. `x` begins as the identity and becomes X.

    `lower` has the columns of L, and the array d the reciprocals of the pivots. Columns of `lower` and `x` are
    `stride` reals apart. The rows of X are also its columns, because X is symmetric.
    """
    for i in range(n):
        row = x[i * stride :]
        # Row j of the inverse of L ends at column j, and so do its contributions.
        for block in range(0, i + 1, WIDEST_VECTOR):
            part, above = row[block:], x[block:]
            for c in each(WIDEST_VECTOR, width=WIDEST_VECTOR, disjoint=True):
                total = part[c]
                for j in range(block, i):
                    total = fma(-lower[j * stride + i], above[j * stride :][c], total)
                part[c] = total
    for i in range(n):
        row, scale = x[i * stride :], d[i]
        for c in each(n, width=WIDEST_VECTOR, spill=True):
            row[c] = row[c] * scale
    for back in range(n):
        i = n - 1 - back
        row, column = x[i * stride :], lower[i * stride :]
        for c in each(n, width=WIDEST_VECTOR, spill=True, disjoint=True):
            total = row[c]
            for j in range(i + 1, n):
                total = fma(-column[j], x[j * stride :][c], total)
            row[c] = total


@procedure(out=lambda: Array(room=WIDEST_VECTOR), work=lambda: Array(room=WIDEST_VECTOR))
def invert(n: int, stride: int, a: In, out: Out, work: Out) -> bool:
    """Write the inverse of a symmetric matrix to `out`. Return True if it is singular within rounding errors.

    a is its lower triangle by columns, entry (i, j) at j*n + i. The columns of the inverse are `stride` reals
    apart. `work` has `work_size` reals.
    """
    square = stride * stride
    reciprocals = work[square:]
    for i in each(square, width=WIDEST_VECTOR, spill=True):
        out[i] = 0.0
    for j in range(n):
        out[j * stride + j] = 1.0
        column = work[j * stride :]
        for i in range(j, n):
            column[i] = a[j * n + i]
    if likely(factor_columns(n, stride, a, work, reciprocals)):
        solve_identity(n, stride, work, reciprocals, out)
        return False
    singular = invert_dense(n, a, work, work[n * n :])
    for j in range(n):
        for i in range(n):
            out[j * stride + i] = work[j * n + i]
    return singular
