"""Inverses of general matrices by Gauss-Jordan elimination with pivots: one matrix in place, or many at once.

One matrix: the pivot of each column is its largest entry relative to the size of the row. Before that, rows are scaled,
then columns, then rows again.

Many matrices, one in each column: entry (r, c) of matrix number b is at index (r * 2 * order + c) * columns + b. Each
row of a matrix is followed by the row of the inverse.

Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 14.4.
"""

from __future__ import annotations

import math

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.linear.symmetric import PIVOT
from lagrange.procedure.form import PARTIAL, Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import Out, Readable, Writable, each, fma, unrolled, wholes

UNROLLED_ORDER = 16
"""Largest order for which the loops over a row, and the search for a pivot, are written out."""


def row_stride(n: int) -> int:
    """Return the distance in memory between the rows of a matrix of size n: n rounded up to whole blocks."""
    return whole_blocks(n, PARTIAL)


@procedure(
    a=lambda n: Array(size=n * row_stride(n), room=PARTIAL),
    scratch=lambda n: Array(size=3 * row_stride(n), room=PARTIAL),
)
def invert_matrix(a: Out, scratch: Out, *, n: int) -> bool:
    """Replace the matrix a, of size n and stored by rows, by its inverse. Return True if it is singular.

    The rows begin `row_stride(n)` numbers apart. `scratch` is work memory for three rows.
    """
    stride, short = row_stride(n), n <= UNROLLED_ORDER
    units, columns, pivots = scratch, scratch[stride:], scratch[2 * stride :]
    chosen = wholes(n)
    measure(n, a, units, columns)
    singular = False
    for k in range(n):
        row = find_pivot(n, a, units, k)
        chosen[k] = row
        pivot = a[row * stride :][k]
        small = abs(pivot) * (units[row] * columns[k]) <= PIVOT
        singular = singular or small or pivot == 0.0
        if row != k:
            # The scales in the second row are not needed later: this row becomes the pivot row.
            first, second = a[row * stride :], a[k * stride :]
            for j in each(n, unrolled=short, spill=True, disjoint=True):
                first[j], second[j] = second[j], first[j]
            units[row] = units[k]
        eliminate(n, a, pivots, k)
    for back in range(n):
        last = n - 1 - back
        chosen_column = chosen[last]
        if chosen_column != last:
            for i in range(n):
                line = a[i * stride :]
                line[chosen_column], line[last] = line[last], line[chosen_column]
    return singular


@inline
def measure(n: int, a: Readable[float], units: Writable[float], columns: Writable[float]) -> None:
    """Write scale factors of the rows of the matrix a to `units`, and of its columns to `columns`.

    A factor is 1 / the largest magnitude in the row or column. First rows are measured, then columns of the
    scaled rows, then rows of the scaled columns.
    """
    stride = row_stride(n)
    for j in each(n, spill=True):
        columns[j] = 1.0
    measure_rows(n, a, units, columns)
    for j in each(n, unrolled=n <= UNROLLED_ORDER, spill=True, disjoint=True):
        largest = 0.0
        for i in range(n):
            size = abs(a[i * stride :][j]) * units[i]
            largest = max(largest, size)
        columns[j] = 1.0 / largest
    measure_rows(n, a, units, columns)


@inline
def measure_rows(n: int, a: Readable[float], units: Writable[float], columns: Readable[float]) -> None:
    """Write a scale factor for each row of the n-by-n matrix a to `units`: 1 / the largest magnitude in the row.

    The magnitudes are those after multiplication of each column by its factor in `columns`.
    """
    for i in range(n):
        row, largest = a[i * row_stride(n) :], -math.inf
        for j in each(n, unrolled=n <= UNROLLED_ORDER):
            largest = max(largest, abs(row[j]) * columns[j])
        units[i] = 1.0 / largest


@inline
def find_pivot(n: int, a: Readable[float], units: Readable[float], k: int) -> int:
    """Return the row, from k on, whose entry in column k is largest after scaling by `units`.

    The result is k if all these entries are NaN.
    """
    stride = row_stride(n)
    if n > UNROLLED_ORDER:
        best, row = -1.0, k
        for i in range(k, n):
            size = abs(a[i * stride :][k]) * units[i]
            larger = size > best
            best, row = size if larger else best, i if larger else row
        return row
    # Candidates are compared in pairs, so that no comparison waits for more than four others.
    candidates = tuple(candidate(a, units, k, i, stride) for i in unrolled(n))
    for _ in unrolled((n - 1).bit_length()):
        candidates = larger_of_pairs(candidates)
    size, row = candidates[0]
    return row if size >= 0.0 else k


@inline
def candidate(a: Readable[float], units: Readable[float], k: int, i: int, stride: int) -> tuple[float, int]:
    """Return (size, i) for row i as a pivot row of column k: the size of its entry after scaling by `units`.

    The size is -1 if the row cannot be the pivot row, because it is above row k, or the entry is NaN.
    """
    size = abs(a[i * stride :][k]) * units[i]
    return size if size >= 0.0 and k <= i else -1.0, i


@inline
def larger_of_pairs(candidates: tuple[tuple[float, int], ...]) -> tuple[tuple[float, int], ...]:
    """Return the larger of each pair of neighbours among the pivot candidates `candidates`, as (size, row)."""
    pairs = tuple(larger_of(a, b) for a, b in zip(candidates[::2], candidates[1::2], strict=False))
    return (*pairs, candidates[-1]) if len(candidates) % 2 else pairs


@inline
def larger_of(a: tuple[float, int], b: tuple[float, int]) -> tuple[float, int]:
    """Return the pivot candidate (size, row) with the larger size."""
    larger = b[0] > a[0]
    return b[0] if larger else a[0], b[1] if larger else a[1]


@inline
def eliminate(n: int, a: Writable[float], pivots: Writable[float], k: int) -> None:
    """Do step k of the Gauss-Jordan elimination of the matrix a in place, with row k as the pivot row.

    Multiples of row k are subtracted from all other rows, and column k becomes column k of the inverse. `pivots` is
    work memory for a row. Whole blocks are stored, including the entry of column k: storing this entry separately
    would delay the next load of its block.
    """
    stride, short = row_stride(n), n <= UNROLLED_ORDER
    pivot_row = a[k * stride :]
    reciprocal = 1.0 / pivot_row[k]
    for j in each(n, unrolled=short, spill=True):
        scaled = pivot_row[j] * reciprocal
        pivots[j] = reciprocal if j == k else scaled
    for i in range(n):
        row = a[i * stride :]
        factor = -row[k]
        for j in each(n, unrolled=short, spill=True):
            entry = row[j]
            row[j] = fma(factor, pivots[j], 0.0 if j == k else entry)
    for j in each(n, unrolled=short, spill=True):
        pivot_row[j] = pivots[j]


@procedure(a=lambda: Array(room=WIDEST_VECTOR), row=lambda: Array(room=WIDEST_VECTOR))
def invert_columns(order: int, columns: int, a: Out, row: Out) -> None:
    """Invert `columns` matrices of size `order` at once by Gauss-Jordan elimination.

    Entry (r, c) of matrix b is at index (r * 2 * order + c) * columns + b of a. Each row of a matrix is
    followed by the row of its inverse, which is written. `row` is work memory, one number for each matrix. The
    inverse of a singular matrix is not finite.
    """

    def entry(r: int, c: int) -> Writable[float]:
        return a[(r * 2 * order + c) * columns :]

    for r in range(order):
        for c in range(order):
            target, diagonal = entry(r, c + order), 1.0 if r == c else 0.0
            for b in each(columns, width=WIDEST_VECTOR, spill=True):
                target[b] = diagonal
    for k in range(order):
        pivot = entry(k, k)
        for r in range(k + 1, order):
            below = entry(r, k)
            for b in each(columns, width=WIDEST_VECTOR, spill=True):
                lower_size, upper_size = abs(below[b]), abs(pivot[b])
                row[b] = 1.0 if lower_size > upper_size else 0.0
            for c in range(k, order * 2):
                upper, lower = entry(k, c), entry(r, c)
                for b in each(columns, width=WIDEST_VECTOR, spill=True, disjoint=True):
                    exchanged, x, y = row[b] > 0.5, upper[b], lower[b]
                    upper[b], lower[b] = y if exchanged else x, x if exchanged else y
        for b in each(columns, width=WIDEST_VECTOR, spill=True):
            row[b] = 1.0 / pivot[b]
        for c in range(k + 1, order * 2):
            mine = entry(k, c)
            for b in each(columns, width=WIDEST_VECTOR, spill=True):
                mine[b] = mine[b] * row[b]
        for r in range(order):
            if r != k:
                factor = entry(r, k)
                for c in range(k + 1, order * 2):
                    mine, other = entry(k, c), entry(r, c)
                    for b in each(columns, width=WIDEST_VECTOR, spill=True, disjoint=True):
                        other[b] = fma(-factor[b], mine[b], other[b])
