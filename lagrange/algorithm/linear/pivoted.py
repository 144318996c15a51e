"""Solve symmetric systems that are not definite: P A = L U with scaled partial pivoting, within a band.

Entries (i, j) with |i - j| above the `band` are zero. The lower triangle is given by columns: entry (i, j), i >= j, at
j*band + i, which for a band of n is a full matrix by columns. Row exchanges widen U to at most twice the band, so a
long chain takes a time like n. The factors are those of the full matrix, rounding included.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sections 3.4 and 4.3.

Units of coordinates and constraints decide nothing: sizes are those in units in which the diagonal is one, and the
largest entry of each row without a diagonal entry.

Factors take `pivoted_size` reals: [row scales (n), the row exchanged with each (n), column scales (n), preferences (n),
columns]. A column stores the rows that may be filled, from row j - 2 band on. `column` is its offset, shifted so that
its index is the row.
"""

from __future__ import annotations

import math

from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, Readable, Writable, fma

PIVOT = 2.0**-46
"""A symmetric matrix is singular within rounding errors if elimination with pivoting meets a scaled pivot of at most
this size, 64 rounding errors. The entries of its inverse, in units in which its diagonal is one, then exceed 1 / PIVOT.
"""

PREFERENCE = 2.0**4
"""Factor on the sizes of rows of constraints in the choice of a pivot. A constraint is solved for a coordinate before
an inertia is: the inertia may be that of a light body, or only rounding.
"""


INDEFINITE = 2.0
"""Largest entry beside a diagonal of ones for a nearly definite matrix. Above it rows are scaled by their largest
entry.
"""


@inline
def band_size(n: int, band: int) -> int:
    """Return the number of reals of a lower triangle of size n with entries (i, j) for i - j <= band only."""
    return n * band + n


def pivoted_size(n: int, band: int) -> int:
    """Return the number of reals of the factors of `factor_pivoted`, for a matrix of size n with a band."""
    return 4 * n + n * min(n, 3 * band + 1)


@inline
def column(n: int, band: int, j: int) -> int:
    """Return the offset of column j of L and U in the factors: the entry of row i is at this offset + i."""
    height = min(n, 3 * band + 1)
    first = min(max(j - 2 * band, 0), n - height)
    return 4 * n + j * height - first


@procedure
def factor_pivoted(n: int, band: int, a: In, factors: Out) -> bool:
    """Factor a symmetric matrix as P A = L U. Return True if it is singular within rounding errors.

    a is its lower triangle within the `band`: entry (i, j), i >= j, at j*band + i. `factors` takes
    `pivoted_size` reals: row scales, exchanged rows, column scales and preferences, n each, then the columns of
    L and U.
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

    Return 0 times the sum of the magnitudes of all entries: NaN if one is not finite. Scaled diagonal entries
    are 1. In a row with a zero diagonal entry the largest entry becomes 1: first among the scaled columns,
    which scales constraints; then among all, which scales coordinates without inertia. `largest` is work
    memory.
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

    Return 0 times the sum of the magnitudes of all entries: NaN if one is not finite.
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
    """Replace the right-hand side b of a linear system by the solution, by `factors` of `factor_pivoted`."""
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
