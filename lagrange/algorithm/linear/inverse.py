"""The inverse of a symmetric matrix, in vectors of eight.

The matrix is given as its lower triangle by columns, entry (i, j) at j*n + i. The inverse is written by columns, which
are `stride` reals apart, a multiple of eight. Entries after the n-th row are zero or undefined. A = L D L^T, then
L D (L^T X) = I for all columns at once. If a pivot cannot be trusted, the matrix is inverted with pivoting.
"""

from __future__ import annotations

from lagrange.algorithm.blocks import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.linear.ldl import factor_size, invert_dense, is_trusted
from lagrange.procedure.form import Array
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, likely, quotient


def padded(n: int) -> int:
    """Return the distance in memory between columns of an inverse of size n, a multiple of eight."""
    return whole_blocks(n, WIDEST_VECTOR)


def work_size(n: int) -> int:
    """Return the length of the work memory: for L and 1/d, or for the inverse by pivoting with its factors."""
    return max(padded(n) ** 2 + n, n * n + factor_size(n))


@inline
def aligned(k: int) -> int:
    """Return the index at which the vector that contains index k begins."""
    return quotient(k, WIDEST_VECTOR) * WIDEST_VECTOR


@procedure(lower=lambda: Array(room=WIDEST_VECTOR))
def factor_columns(n: int, stride: int, a: In, lower: Out, d: Out) -> bool:
    """Factor a symmetric matrix as L D L^T. Return True if all pivots are large enough.

    `lower` has the columns of the lower triangle, `stride` reals apart, which are replaced by L below the
    diagonal. 1/d is written to `d`. The diagonal of the matrix is also read from a, with entry (i, j) at j*n +
    i.
    """
    trusted = True
    for j in range(n):
        column = lower[j * stride :]
        pivot = column[j]
        large = is_trusted(pivot, a[j * n + j])
        trusted = trusted and large
        reciprocal = 1.0 / pivot
        d[j] = reciprocal
        for k in range(j + 1, n):
            factor, first = -(column[k] * reciprocal), aligned(k)
            source, target = column[first:], lower[k * stride + first :]
            for i in each(n - first, width=WIDEST_VECTOR, spill=True, disjoint=True):
                target[i] = fma(factor, source[i], target[i])
        first = aligned(j + 1)
        rest = column[first:]
        for i in each(n - first, width=WIDEST_VECTOR, spill=True):
            rest[i] = rest[i] * reciprocal
    return trusted


@procedure(lower=lambda: Array(read=True, room=WIDEST_VECTOR), x=lambda: Array(room=WIDEST_VECTOR))
def solve_identity(n: int, stride: int, lower: In, d: In, x: Out) -> None:
    """Solve L D L^T X = I for X. `x` begins as the identity. Columns of `lower` and `x` are `stride` reals apart.

    The rows of X are also its columns, because X is symmetric.
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
        first = aligned(j)
        column = work[j * stride + first :]
        for i in each(stride - first, width=WIDEST_VECTOR, spill=True):
            column[i] = 0.0
        for i in range(j, n):
            work[j * stride + i] = a[j * n + i]
    if likely(factor_columns(n, stride, a, work, reciprocals)):
        solve_identity(n, stride, work, reciprocals, out)
        return False
    singular = invert_dense(n, a, work, work[n * n :])
    for j in range(n):
        for i in range(n):
            out[j * stride + i] = work[j * n + i]
    return singular
