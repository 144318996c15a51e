"""Written-out linear solves: L D L^T of a small or sparse symmetric matrix as statements of a procedure.

Operations with entries that are always zero are omitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lagrange.algorithm.linear.symmetric import RESIDUAL, band_size, least_pivot
from lagrange.procedure.builder import Builder
from lagrange.procedure.values import Flag, Memory, Real
from lagrange.program.elimination import Elimination

Entries = Mapping[tuple[int, int], Real]
"""Values of a lower triangle by (row, column); missing entries are zero."""


def factored(p: Builder, plan: Elimination, a: Entries) -> tuple[Entries, Flag]:
    """Return the factor L of a matrix with entries `a`, by index pair, and a flag: true if L can be trusted.

    The diagonal of L has 1/d instead of 1. p builds the procedure, and `plan` has the nonzero entries of L. The
    flag is true if every pivot is large enough. A pivot is compared with its diagonal entry. The diagonal entry of
    a multiplier is zero: its pivot is compared with the subtracted terms, those of G M^-1 G^T of the constraint.
    """
    lower: dict[tuple[int, int], Real] = {}
    scaled: dict[tuple[int, int], Real] = {}
    trusted: Flag | None = None
    for j in range(plan.order):
        row = plan.rows[j]
        for i in (j, *plan.columns[j]):
            products = [(scaled[i, k], lower[j, k]) for k in row if (i, k) in scaled and (j, k) in lower]
            value = a.get((i, j))
            for left, right in products:
                value = -(left * right) if value is None else p.fnma(left, right, value)
            if value is not None:
                scaled[i, j] = value
        good = _trusted(p, plan, j, a, [(scaled[j, k], lower[j, k]) for k in row if (j, k) in scaled], scaled)
        trusted = good if trusted is None else trusted & good
        lower[j, j] = 1.0 / scaled.get((j, j), p.real(0.0))
        for i in plan.columns[j]:
            if (i, j) in scaled:
                lower[i, j] = scaled[i, j] * lower[j, j]
    return lower, p.true if trusted is None else trusted


def write_band(p: Builder, plan: Elimination, a: Entries, to: Memory) -> None:
    """Write the entries `a` of a matrix to the memory `to`, as the lower triangle within a band.

    Rows and columns are in the order `ranks` of the plan. In this order entry (i, j), i >= j, is written to
    index j * band + i.
    """
    size = band_size(plan.order, plan.band)
    if len(a) < size:
        with p.each(size, width=1) as k:
            to[k] = 0.0
    for (i, j), value in a.items():
        first, second = sorted((plan.ranks[i], plan.ranks[j]))
        to[first * plan.band + second] = value


def _trusted(
    p: Builder, plan: Elimination, j: int, a: Entries, products: Sequence[tuple[Real, Real]], scaled: Entries
) -> Flag:
    """Return a flag that is true if pivot j has the right sign, and is not small compared with its terms.

    `a` has the entries of the matrix. `products` are pairs of factors of the terms that were subtracted from the
    diagonal entry j, and `scaled` has the pivot.
    """
    pivot = scaled.get((j, j), p.real(0.0))
    if j not in plan.negative:
        return Flag.of(pivot > abs(a.get((j, j), p.real(0.0))) * least_pivot(plan.negative))
    size: Real | None = None
    for left, right in products:
        term = abs(left * right)
        size = term if size is None else size + term
    return Flag.of(-pivot > (p.real(0.0) if size is None else size) * least_pivot(plan.negative))


def solved(p: Builder, plan: Elimination, lower: Entries, right: Sequence[Real | None]) -> list[Real]:
    """Return the solution of a linear system with the right-hand side `right`; an entry None is zero.

    `lower` has the entries of L, with 1/d on the diagonal, as `factored` returns them.
    """
    x = list(right)

    def less(value: Real | None, entry: Real | None, factor: Real | None) -> Real | None:
        return (
            value if entry is None or factor is None else p.real(p.fnma(entry, factor, 0.0 if value is None else value))
        )

    for i, row in enumerate(plan.rows):
        for k in row:
            x[i] = less(x[i], lower.get((i, k)), x[k])
    for i in reversed(range(plan.order)):
        value = x[i]
        x[i] = None if value is None else value * lower[i, i]
        for k in plan.columns[i]:
            x[i] = less(x[i], lower.get((k, i)), x[k])
    return [p.real(0.0) if value is None else value for value in x]


def satisfied(p: Builder, plan: Elimination, a: Entries, x: Sequence[Real], right: Sequence[Real | None]) -> list[Flag]:
    """Return a flag for each multiplier: true if the solution x satisfies the multiplier's row of the system.

    `a` has the entries of the matrix, and `right` the right-hand side. If inertias differ by many orders of
    magnitude, pivots may be large and the solution still wrong: the force on a light body is then the
    difference of two nearly equal forces.
    """
    flags = []
    for i in plan.negative:
        value = right[i]
        left = p.real(0.0) if value is None else value
        size = abs(left)
        for j in range(plan.order):
            entry = max(i, j), min(i, j)
            if entry in a:
                product = a[entry] * x[j]
                left, size = left - product, size + abs(product)
        flags.append(Flag.of(abs(left) <= size * RESIDUAL))
    return flags
