"""Inverses of many matrices at once, one in each column: Gauss-Jordan elimination with partial pivoting.

Entry (r, c) of matrix number b is at index (r * 2 * order + c) * columns + b. Each row of a matrix is followed by the
row of the inverse. Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 14.4.
"""

from __future__ import annotations

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.procedure.form import Array
from lagrange.procedure.front.plain import procedure
from lagrange.procedure.front.vocabulary import Out, Writable, each, fma


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
