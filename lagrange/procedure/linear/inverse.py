"""The inverse of a symmetric matrix, in vectors of eight.

The matrix is given as its lower triangle by columns, entry (i, j) at j*n + i. The inverse is written by columns
`stride` reals apart, a multiple of eight, with zeros or anything behind the n-th row. A = L D L^T, then L D (L^T X) = I
for all columns at once. Where a pivot cannot be trusted the matrix is inverted with pivoting.
"""

from __future__ import annotations

from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, WHOLE, Procedure
from lagrange.procedure.linear.ldl import factor_size, invert_dense
from lagrange.procedure.linear.pivoted import PIVOT
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Whole

WIDTH = 8


def padded(n: int) -> int:
    """Return the distance between columns."""
    return whole_blocks(n, WIDTH)


def work_size(n: int) -> int:
    """Return the length of the work memory: for L and 1/d, or for the inverse with pivoting and its factors."""
    return max(padded(n) ** 2 + n, n * n + factor_size(n))


def _aligned(k: Whole) -> Whole:
    """Return the place of the vector that a place lies in."""
    found = (k // WIDTH) * WIDTH
    assert isinstance(found, Whole)
    return found


@shared
def factor_columns() -> Procedure:
    """Return L D L^T by columns, in vectors."""
    p = Builder(
        "factor_columns",
        "Turn columns `lower` into L below the diagonal, and 1/d into `d`; say whether every pivot is trusted.",
    )
    n, stride = p.given("n", WHOLE), p.given("stride", WHOLE)
    a = p.array("a", read=True)
    lower, d = p.array("lower", room=WIDTH), p.array("d")
    trusted = p.variable(p.true, "trusted")
    with p.loop(0, n) as j:
        column = lower.at(j * stride)
        pivot = column[j].called("pivot")
        trusted.value = trusted.value & (pivot > abs(a[j * n + j]) * PIVOT)
        reciprocal = 1.0 / pivot
        d[j] = reciprocal
        with p.loop(j + 1, n) as k:
            factor, first = -(column[k] * reciprocal), _aligned(k)
            source, target = column.at(first), lower.at(k * stride + first)
            with p.each(n - first, width=WIDTH, spill=True) as i:
                target[i] = p.fma(factor, source[i], target[i])
        first = _aligned(j + 1)
        rest = column.at(first)
        with p.each(n - first, width=WIDTH, spill=True) as i:
            rest[i] = rest[i] * reciprocal
    p.leave(trusted.value)
    return p.finish(FLAG)


@shared
def solve_columns() -> Procedure:
    """Return the solution of L D L^T X = I."""
    p = Builder(
        "solve_columns", "Find X of L D L^T X = I; `x` has rows, which are columns as well, and begins as the identity."
    )
    n, stride = p.given("n", WHOLE), p.given("stride", WHOLE)
    lower, d = p.array("lower", read=True, room=WIDTH), p.array("d", read=True)
    x = p.array("x", room=WIDTH)
    with p.loop(0, n) as i:
        row = x.at(i * stride)
        p.note("Row j of the inverse of L ends at column j, and so does what it adds.")
        with p.loop(0, i + 1, WIDTH) as block:
            part, above = row.at(block), x.at(block)
            with p.each(WIDTH, width=WIDTH) as c:
                total = p.variable(part[c])
                with p.loop(block, i) as j:
                    total.value = p.fma(-lower[j * stride + i], above.at(j * stride)[c], total.value)
                part[c] = total.value
    with p.loop(0, n) as i:
        row, scale = x.at(i * stride), d[i]
        with p.each(n, width=WIDTH, spill=True) as c:
            row[c] = row[c] * scale
    with p.loop(0, n) as back:
        i = n - 1 - back
        row, column = x.at(i * stride), lower.at(i * stride)
        with p.each(n, width=WIDTH, spill=True) as c:
            total = p.variable(row[c])
            with p.loop(i + 1, n) as j:
                total.value = p.fma(-column[j], x.at(j * stride)[c], total.value)
            row[c] = total.value
    return p.finish()


@shared
def invert() -> Procedure:
    """Return the inverse."""
    p = Builder("invert", "Write the inverse to `out`, and say whether the matrix is singular to round-off.")
    n, stride = p.given("n", WHOLE), p.given("stride", WHOLE)
    a, out, work = p.array("a", read=True), p.array("out", room=WIDTH), p.array("work", room=WIDTH)
    square = stride * stride
    reciprocals = work.at(square)
    with p.each(square, width=WIDTH, spill=True) as i:
        out[i] = 0.0
    with p.loop(0, n) as j:
        out[j * stride + j] = 1.0
        first = _aligned(j)
        column = work.at(j * stride + first)
        with p.each(stride - first, width=WIDTH, spill=True) as i:
            column[i] = 0.0
        with p.loop(j, n) as i:
            work[j * stride + i] = a[j * n + i]
    trusted = p.call(factor_columns(), n, stride, a, work, reciprocals)
    singular = p.variable(p.false, "singular")
    with p.when(trusted, likely=True) as ways:
        p.call(solve_columns(), n, stride, work, reciprocals, out)
    with ways.otherwise():
        singular.value = p.call(invert_dense(), n, a, work, work.at(n * n))
        with p.loop(0, n) as j, p.loop(0, n) as i:
            out[j * stride + i] = work[j * n + i]
    p.leave(singular.value)
    return p.finish(FLAG)
