"""The inverse of any matrix: Gauss-Jordan elimination in place, with pivots.

The pivot of each column is its largest entry relative to the size of the row. Rows, columns in units of the rows, and
rows again are scaled first.
Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 14.4.
"""

from __future__ import annotations

from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, PARTIAL, WHOLE, Procedure
from lagrange.procedure.linear.pivoted import PIVOT
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole

WRITTEN_OUT = 16
"""Largest order for which the loops over a row, and the search for a pivot, are written out."""


def row_stride(n: int) -> int:
    """Return the distance between the rows of a matrix of order n: whole blocks."""
    return whole_blocks(n, PARTIAL)


@shared
def inversion(n: int) -> Procedure:
    """Return the inversion of matrices of order n; `scratch` takes three rows."""
    return _Inversion(n).build()


class _Inversion:
    """Builds the procedure for one order."""

    def __init__(self, n: int) -> None:
        self.n, self.stride, self.unrolled = n, row_stride(n), n <= WRITTEN_OUT
        self.p = p = Builder(f"invert{n}", "Replace a matrix by its inverse, and say whether it is singular.")
        self.a = p.array("a", size=n * self.stride, room=PARTIAL)
        scratch = p.array("scratch", size=3 * self.stride, room=PARTIAL)
        self.units, self.columns, self.pivots = (scratch.at(i * self.stride) for i in range(3))
        self.chosen = p.reserve(n, WHOLE)

    def build(self) -> Procedure:
        p, n = self.p, self.n
        self.measure()
        singular = p.variable(p.false, "singular")
        with p.loop(0, n) as k:
            row = self.find_pivot(k).called("row")
            self.chosen[k] = row
            singular.value = singular.value | self.is_round_off(row, k)
            with p.when(~row.equals(k)):
                self.swap_rows(row, k)
            self.eliminate(k)
        with p.loop(0, n) as back:
            last = p.whole(n - 1 - back)
            other = self.chosen[last]
            with p.when(~other.equals(last)):
                self.swap_columns(other, last)
        p.leave(singular.value)
        return p.finish(FLAG)

    def row(self, i: Whole | int) -> Memory:
        return self.a.at(i * self.stride)

    def measure(self) -> None:
        """Find the reciprocal size of each row and column."""
        p, n = self.p, self.n
        with p.each(n, spill=True) as j:
            self.columns[j] = 1.0
        self.measure_rows()
        with p.each(n, unrolled=self.unrolled, spill=True) as j:
            largest = p.variable(0.0, "largest")
            with p.loop(0, n) as i:
                size = abs(self.row(i)[j]) * self.units[i]
                largest.value = p.choose(size > largest.value, size, largest.value)
            self.columns[j] = 1.0 / largest.value
        self.measure_rows()

    def measure_rows(self) -> None:
        """Find the reciprocal size of each row, with columns in their units."""
        p = self.p
        with p.loop(0, self.n) as i:
            row = self.row(i)
            with p.each(self.n, unrolled=self.unrolled) as j:
                largest = p.largest(abs(row[j]) * self.columns[j], numbers=True)
            self.units[i] = 1.0 / largest.value

    def find_pivot(self, k: Whole) -> Whole:
        """Return the row, from k on, in which column k is largest; k if no entry there is finite."""
        p = self.p
        if not self.unrolled:
            best, row = p.variable(-1.0, "best"), p.variable(k, "best_row")
            with p.loop(k, self.n) as i:
                size = abs(self.row(i)[k]) * self.units[i]
                larger = size > best.value
                best.value = p.choose(larger, size, best.value)
                row.value = p.choose(larger, i, row.value)
            return p.whole(row.value)
        found: list[tuple[Real, Whole]] = []
        for place in range(self.n):
            size = abs(self.row(place)[k]) * self.units[place]
            candidate = (size >= 0.0) & (k <= place)
            found.append((p.choose(candidate, size, -1.0), p.whole(place)))
        while len(found) > 1:
            pairs = [self.better(a, b) for a, b in zip(found[::2], found[1::2], strict=False)]
            found = [*pairs, found[-1]] if len(found) % 2 else pairs
        return p.whole(p.choose(found[0][0] >= 0.0, found[0][1], k))

    def better(self, a: tuple[Real, Whole], b: tuple[Real, Whole]) -> tuple[Real, Whole]:
        """Return the larger of two sizes, with its row."""
        larger = b[0] > a[0]
        return self.p.choose(larger, b[0], a[0]), self.p.choose(larger, b[1], a[1])

    def is_round_off(self, row: Whole, k: Whole) -> Flag:
        """Whether a pivot is round-off, in units of its row and column; False if it is not finite."""
        pivot: Real = self.row(row)[k]
        size = abs(pivot) * (self.units[row] * self.columns[k])
        small: Flag = size <= PIVOT
        return small | pivot.equals(0.0)

    def swap_rows(self, one: Whole, other: Whole) -> None:
        """Exchange two rows; the unit of the second row, which becomes the pivot row, is not needed any more."""
        p, first, second = self.p, self.row(one), self.row(other)
        with p.each(self.n, unrolled=self.unrolled, spill=True) as j:
            first[j], second[j] = second[j], first[j]
        self.units[one] = self.units[other]

    def eliminate(self, k: Whole) -> None:
        """Subtract multiples of row k from the others, and replace column k by that of the inverse.

        Whole blocks are stored, with the entry of column k in them: a single store would delay the next load of its
        block.
        """
        p, n, here = self.p, self.n, self.row(k)
        reciprocal = 1.0 / here[k]
        with p.each(n, unrolled=self.unrolled, spill=True) as j:
            self.pivots[j] = p.choose(j.equals(k), reciprocal, here[j] * reciprocal)
        with p.loop(0, n) as i:
            row = self.row(i)
            factor = -row[k]
            with p.each(n, unrolled=self.unrolled, spill=True) as j:
                row[j] = p.fma(factor, self.pivots[j], p.choose(j.equals(k), 0.0, row[j]))
        p.copy(self.pivots, here, n, unrolled=self.unrolled)

    def swap_columns(self, one: Whole, other: Whole) -> None:
        """Exchange two columns."""
        with self.p.loop(0, self.n) as i:
            row = self.row(i)
            row[one], row[other] = row[other], row[one]
