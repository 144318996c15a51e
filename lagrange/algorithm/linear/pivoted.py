"""Solve symmetric systems that are not definite: P A = L U with scaled partial pivoting, within a band.

Entries (i, j) with |i - j| above the `band` are zero. The lower triangle is given by columns: entry (i, j), i >= j, at
j*band + i, which for a band of n is a full matrix by columns. Row exchanges widen U to at most twice the band, so a
long chain takes a time like n. The factors are those of the full matrix, rounding included.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sections 3.4 and 4.3.

Factors take `pivoted_size` reals: [row scales (n), the row exchanged with each (n), columns]. A column stores the rows
that may be filled, from row j - 2 band on. `column` is its offset, shifted so that its index is the row.
"""

from __future__ import annotations

from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, Readable, Writable, fma

PIVOT = 2.0**-46
"""A symmetric matrix is singular to round-off if elimination with pivoting, its rows scaled, meets a pivot of at most
this fraction of its row's largest entry: 64 rounding errors. The entries of its inverse, in units in which its
diagonal is one, then exceed 1 / PIVOT."""


@inline
def band_size(n: int, band: int) -> int:
    """Return the number of reals of a lower triangle within a band less than n."""
    return n * band + n


def pivoted_size(n: int, band: int) -> int:
    """Return the number of reals that the factors of a matrix of order n take."""
    return 2 * n + n * min(n, 3 * band + 1)


@inline
def column(n: int, band: int, j: int) -> int:
    """Return the offset of column j of L and U in factors, shifted so that its index is the row."""
    height = min(n, 3 * band + 1)
    first = min(max(j - 2 * band, 0), n - height)
    return 2 * n + j * height - first


@procedure
def factor_pivoted(n: int, band: int, a: In, factors: Out) -> bool:
    """Factor P A = L U with scaled pivots, and return whether A is singular to round-off."""
    scales, exchanges = factors, factors[n:]
    nothing = scale_rows(n, band, a, scales)
    for j in range(n):
        entries = factors[column(n, band, j) :]
        for i in range(max(j - 2 * band, 0), min(n, j + band + 1)):
            entries[i] = 0.0
    for j in range(n):
        entries, given = factors[column(n, band, j) :], a[j * band :]
        for i in range(j, min(n, j + band + 1)):
            entry = given[i]
            entries[i] = entry
            factors[column(n, band, i) :][j] = entry
    singular = False
    for j in range(n):
        entries, rows, reach = factors[column(n, band, j) :], min(n, j + band + 1), min(n, j + 2 * band + 1)
        best, row = -1.0, j
        for i in range(j, rows):
            size = abs(entries[i]) * scales[i]
            if size > best:
                best, row = size, i
        exchanges[j] = float(row)
        scales[j], scales[row] = scales[row], scales[j]
        for k in range(j, reach):
            other = factors[column(n, band, k) :]
            other[j], other[row] = other[row], other[j]
        pivot = entries[j]
        # For a row of zeros this product is 0 * inf = NaN.
        vanishes = abs(pivot) * scales[j] <= PIVOT
        singular = singular or vanishes or pivot == 0.0
        reciprocal = 1.0 / pivot
        for i in range(j + 1, rows):
            entries[i] *= reciprocal
        for k in range(j + 1, reach):
            target = factors[column(n, band, k) :]
            factor = -target[j]
            if factor != 0.0:
                for i in range(j + 1, rows):
                    target[i] = fma(factor, entries[i], target[i])
    # A matrix with an entry that is not finite does not count as singular: the entry passes to the solution.
    return singular and nothing == 0.0


@inline
def scale_rows(n: int, band: int, a: Readable[float], scales: Writable[float]) -> float:
    """Write one over the largest entry of each row; return 0 times the sum of their sizes: NaN if one is not finite."""
    nothing = 0.0
    for i in range(n):
        scales[i] = 0.0
    for j in range(n):
        given = a[j * band :]
        for i in range(j, min(n, j + band + 1)):
            size = abs(given[i])
            for row in (i, j):
                largest = scales[row]
                scales[row] = size if size > largest else largest
            # Zero times a NaN or an infinity is NaN, and remains in the sum.
            nothing = fma(size, 0.0, nothing)
    for i in range(n):
        scales[i] = 1.0 / scales[i]
    return nothing


@procedure
def solve_pivoted(n: int, band: int, factors: In, b: Out) -> None:
    """Replace a right-hand side by the solution, using the factors of `factor_pivoted`."""
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
