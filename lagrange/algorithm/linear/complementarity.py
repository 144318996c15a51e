"""Linear complementarity problems by Lemke's method: z >= 0 with w = M z + q >= 0 and w z = 0.

The tableau has a row for each of the n equations w - M z - a = q, where a is the artificial variable. Its columns are
w, z, a and the right-hand side. Source: R. W. Cottle, J.-S. Pang, R. E. Stone, The Linear Complementarity Problem,
1992, section 4.4.
"""

from __future__ import annotations

import math

from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, Readable, WholesOut, Writable, larger, smaller

NEGLIGIBLE = 1e-10
"""Smallest pivot, as a fraction of the largest entry of its column. Smaller entries count as rounding errors. Two
ratios of the ratio test are equal if they differ by less than this number, relative to a ratio above 1.
"""

PIVOTS_PER_ROW = 50
"""Largest number of pivots per row of the tableau, after which the method fails. A problem with a solution needs about
one.
"""

NO_ROW = -1
"""Index of a missing row: no row of the tableau limits the entering variable."""


@procedure
def lemke(n: int, matrix: In, right: In, tableau: Out, basis: WholesOut, solution: Out) -> bool:
    """Write a solution z of a complementarity problem to `solution`. Return False if the method ends on a ray.

    `matrix` is M, of size n and stored by rows, and `right` is q. `tableau` is work memory for n rows of 2n + 2
    numbers, and `basis` for n numbers: the index of the variable that each row determines.
    """
    artificial, width = 2 * n, 2 * n + 2
    begin(n, matrix, right, tableau, basis, solution)
    row, entering, pivots = lowest(n, right), artificial, 0
    is_solved = right[row] >= 0.0
    while not is_solved and row != NO_ROW and pivots < PIVOTS_PER_ROW * (n + 1):
        exchange(n, tableau, row, entering)
        leaving, pivots = basis[row], pivots + 1
        basis[row] = entering
        is_solved = leaving == artificial
        if not is_solved:
            entering = leaving + n if leaving < n else leaving - n
            row = leaving_row(n, tableau, basis, entering)
    for i in range(n):
        variable = basis[i]
        if variable >= n and variable < artificial:
            solution[variable - n] = tableau[i * width + width - 1]
    return is_solved


@inline
def begin(n: int, matrix: In, right: In, tableau: Out, basis: WholesOut, solution: Out) -> None:
    """Write the first tableau of n rows, in which each row determines an entry of w, and zeros to `solution`.

    `matrix` is M, stored by rows, and `right` is q. `basis` receives the index of the variable of each row.
    """
    for i in range(n):
        row = tableau[i * (2 * n + 2) :]
        row[:n] = 0.0
        row[i] = 1.0
        for j in range(n):
            row[n + j] = -matrix[i * n + j]
        row[2 * n], row[2 * n + 1] = -1.0, right[i]
        basis[i], solution[i] = i, 0.0


@inline
def lowest(n: int, values: Readable[float]) -> int:
    """Return the index of the least of n values. If several are least, it is the first of these."""
    row, least = 0, values[0]
    for i in range(1, n):
        if values[i] < least:
            row, least = i, values[i]
    return row


@inline
def exchange(n: int, tableau: Writable[float], row: int, entering: int) -> None:
    """Pivot a tableau of n rows, so that `row` determines the variable `entering`. Its column becomes a unit vector."""
    width = 2 * n + 2
    pivots = tableau[row * width :]
    pivot = pivots[entering]
    for j in range(width):
        pivots[j] = pivots[j] / pivot
    for i in range(n):
        if i != row:
            others = tableau[i * width :]
            factor = others[entering]
            for j in range(width):
                others[j] = others[j] - factor * pivots[j]


@inline
def leaving_row(n: int, tableau: Readable[float], basis: Readable[int], entering: int) -> int:
    """Return the row whose variable first becomes zero as the variable `entering` grows, else `NO_ROW`.

    The `tableau` has n rows, and `basis` the index of the variable that each row determines. Among equal ratios it
    is the row of the artificial variable, else the row with the largest pivot.
    """
    width, size, least = 2 * n + 2, 1.0, math.inf
    for i in range(n):
        size = larger(size, abs(tableau[i * width + entering]))
    for i in range(n):
        pivot = tableau[i * width + entering]
        if pivot > NEGLIGIBLE * size:
            least = smaller(least, tableau[i * width + width - 1] / pivot)
    bound, row, largest = least + NEGLIGIBLE * larger(1.0, abs(least)), NO_ROW, 0.0
    for i in range(n):
        pivot = tableau[i * width + entering]
        if pivot > NEGLIGIBLE * size and tableau[i * width + width - 1] / pivot <= bound:
            weight = math.inf if basis[i] == 2 * n else pivot
            if weight > largest:
                row, largest = i, weight
    return row
