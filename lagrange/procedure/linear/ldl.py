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
from contextlib import AbstractContextManager

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, WHOLE, Procedure
from lagrange.procedure.linear.pivoted import PIVOT, factor_pivoted, pivoted_size, solve_pivoted
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

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


def _parts(factors: Memory, n: Whole) -> tuple[Memory, Memory]:
    """Return 1/d and the columns of L inside factors."""
    return factors.at(1), factors.at(2 * n + 1)


@shared
def factor_symmetric() -> Procedure:
    """Return L D L^T of a matrix, and whether every pivot can be trusted."""
    p = Builder("factor_symmetric", "Factor A = L D L^T by columns, and say whether every pivot can be trusted.")
    n = p.given("n", WHOLE)
    a, factors = p.array("a", read=True), p.array("factors")
    reciprocals, columns = _parts(factors, n)
    with p.loop(0, n) as j, p.loop(j, n) as i:
        columns[j * n + i] = a[j * n + i]
    trusted = p.variable(p.true, "trusted")
    with p.loop(0, n) as j:
        column = columns.at(j * n)
        d = column[j].called("d")
        trusted.value = trusted.value & (d > abs(a[j * n + j]) * PIVOT)
        reciprocal = 1.0 / d
        reciprocals[j] = reciprocal
        p.note("The finished column is subtracted from the columns behind it.")
        with p.loop(j + 1, n) as k:
            factor = -(column[k] * reciprocal)
            target = columns.at(k * n)
            with p.when(~factor.equals(0.0)), p.loop(k, n) as i:
                target[i] = p.fma(factor, column[i], target[i])
        with p.loop(j + 1, n) as i:
            column[i] = column[i] * reciprocal
    p.leave(trusted.value)
    return p.finish(FLAG)


@shared
def factor_dense() -> Procedure:
    """Return the factorization of a symmetric matrix by L D L^T, or with pivoting if that cannot be trusted."""
    p = Builder("factor_dense", "Factor a symmetric matrix, and say whether it is singular to round-off.")
    n = p.given("n", WHOLE)
    a, factors = p.array("a", read=True), p.array("factors")
    trusted = p.call(factor_symmetric(), n, a, factors)
    factors[0] = 0.0
    p.leave_if(trusted, p.false)
    factors[0] = 1.0
    p.leave(p.call(factor_pivoted(), n, n, a, factors.at(1)))
    return p.finish(FLAG)


@shared
def solve_factored() -> Procedure:
    """Return the solution of a factored system."""
    p = Builder("solve_factored", "Replace a right-hand side by the solution.")
    n = p.given("n", WHOLE)
    factors, b = p.array("factors", read=True), p.array("b")
    reciprocals, columns = _parts(factors, n)
    with p.when(~factors[0].equals(0.0)):
        p.call(solve_pivoted(), n, n, factors.at(1), b)
        p.leave()
    with p.loop(0, n) as j:
        factor, column = -b[j], columns.at(j * n)
        with p.loop(j + 1, n) as i:
            b[i] = p.fma(factor, column[i], b[i])
    with p.loop(0, n) as i:
        b[i] = b[i] * reciprocals[i]
    with p.loop(0, n) as back:
        j = n - 1 - back
        column, total = columns.at(j * n), p.variable(b[j], "total")
        with p.loop(j + 1, n) as i:
            total.value = p.fma(-column[i], b[i], total.value)
        b[j] = total.value
    return p.finish()


@shared
def solve_columns() -> Procedure:
    """Return the solution of factored systems side by side, with the operations of `solve_factored` for each."""
    p = Builder(
        "solve_columns",
        "Replace right-hand sides by solutions, entry k of column c at k*columns + c; `spare` takes n reals. The "
        f"columns are a multiple of {COLUMNS_AT_ONCE}.",
    )
    n, columns = p.given("n", WHOLE), p.given("columns", WHOLE)
    factors, b, spare = p.array("factors", read=True), p.array("b", room=COLUMNS_AT_ONCE), p.array("spare")
    reciprocals, lower = _parts(factors, n)

    def every() -> AbstractContextManager[Whole]:
        return p.each(columns, width=COLUMNS_AT_ONCE, spill=True)

    p.note("Factors with pivoting are rare: one column after the other.")
    with p.when(~factors[0].equals(0.0)):
        with p.loop(0, columns) as c:
            with p.loop(0, n) as k:
                spare[k] = b[k * columns + c]
            p.call(solve_factored(), n, factors, spare)
            with p.loop(0, n) as k:
                b[k * columns + c] = spare[k]
        p.leave()
    with p.loop(0, n) as j:
        source, column = b.at(j * columns), lower.at(j * n)
        with p.loop(j + 1, n) as i:
            target, entry = b.at(i * columns), -column[i]
            with every() as c:
                target[c] = p.fma(source[c], entry, target[c])
    with p.loop(0, n) as back:
        j = n - 1 - back
        target, column, reciprocal = b.at(j * columns), lower.at(j * n), reciprocals[j]
        with every() as c:
            total = p.variable(target[c] * reciprocal, "total")
            with p.loop(j + 1, n) as i:
                total.value = p.fma(b.at(i * columns)[c], -column[i], total.value)
            target[c] = total.value
    return p.finish()


@shared
def invert_dense() -> Procedure:
    """Return the inverse of a symmetric matrix."""
    p = Builder(
        "invert_dense",
        "Write the inverse by columns, and say whether the matrix is singular; `work` takes the factors.",
    )
    n = p.given("n", WHOLE)
    a, out, work = p.array("a", read=True), p.array("out"), p.array("work")
    singular = p.call(factor_dense(), n, a, work)
    with p.loop(0, n) as j:
        column = out.at(j * n)
        with p.loop(0, n) as i:
            column[i] = 0.0
        column[j] = 1.0
        p.call(solve_factored(), n, work, column)
    p.leave(singular)
    return p.finish(FLAG)
