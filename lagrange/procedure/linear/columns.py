"""Inverses of many matrices at once, one in each column: Gauss-Jordan elimination with partial pivoting.

Entry (r, c) of the matrix of column b stands at ((r * 2 order) + c) * columns + b, and behind each row is the row of
the inverse. Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 14.4.
"""

from __future__ import annotations

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

LANES = 8
"""The widest vectors of doubles that processors have."""


@shared
def invert_columns() -> Procedure:
    """Return the inversion; where a matrix is singular its inverse is not finite. `row` takes one number a column."""
    p = Builder("invert_columns", "Invert the matrix of each column, with the inverses behind their rows.")
    order, columns = p.given("order", WHOLE), p.given("columns", WHOLE)
    a, row = p.array("a", room=LANES), p.array("row", room=LANES)

    def entry(r: Whole, c: Whole) -> Memory:
        return a.at((r * 2 * order + c) * columns)

    with p.loop(0, order) as r, p.loop(0, order) as c:
        target, one = entry(r, c + order), p.choose(r.equals(c), 1.0, p.real(0.0))
        with p.each(columns, width=LANES, spill=True) as b:
            target[b] = one
    with p.loop(0, order) as k:
        pivot = entry(k, k)
        with p.loop(k + 1, order) as r:
            below = entry(r, k)
            with p.each(columns, width=LANES, spill=True) as b:
                row[b] = p.choose(abs(below[b]) > abs(pivot[b]), 1.0, p.real(0.0))
            with p.loop(k, order * 2) as c:
                upper, lower = entry(k, c), entry(r, c)
                with p.each(columns, width=LANES, spill=True) as b:
                    swap, x, y = row[b] > 0.5, upper[b], lower[b]
                    upper[b], lower[b] = p.choose(swap, y, x), p.choose(swap, x, y)
        with p.each(columns, width=LANES, spill=True) as b:
            row[b] = 1.0 / pivot[b]
        with p.loop(k + 1, order * 2) as c:
            mine = entry(k, c)
            with p.each(columns, width=LANES, spill=True) as b:
                mine[b] = mine[b] * row[b]
        with p.loop(0, order) as r, p.when(~r.equals(k)):
            factor = entry(r, k)
            with p.loop(k + 1, order * 2) as c:
                mine, other = entry(k, c), entry(r, c)
                with p.each(columns, width=LANES, spill=True) as b:
                    other[b] = p.fma(-factor[b], mine[b], other[b])
    return p.finish()
