"""Inverses of the matrices of Newton's method in machine code: Gauss-Jordan elimination in place, with pivots.

    i32 invert<n>(ptr a, ptr scratch)     replaces a matrix by its inverse; 1 if it is singular to round-off, else 0

`a` has n rows that begin a whole number of blocks apart, and `scratch` takes 4 such rows. The pivot of each column is
the largest entry against the size of its row, with columns and rows measured in units of their own.
Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 14.4.
"""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.vectors import BLOCK, KIND, TRUTH, cut_block, lane_is, splat
from lagrange.procedure.linear.dense import PIVOT

WRITTEN_OUT = 16
"""Up to this order the blocks of a row are written out, and the search for a pivot."""


def inversion_function(n: int) -> str:
    """Emit the inversion of matrices of order n."""
    return _Inversion(n).function()


class _Inversion:
    """Emits the function for one order."""

    def __init__(self, n: int) -> None:
        self.n, self.stride = n, -(-n // BLOCK) * BLOCK
        self.e = Emitter()
        self.units = "%scratch"
        self.columns, self.chosen, self.pivots = (self.e.address("%scratch", i * self.stride) for i in (1, 2, 3))

    def function(self) -> str:
        e = self.e
        self.measure()
        singular = e.reserve("i32")
        e.store("0", singular, "i32")
        with e.loop(0, self.n) as k:
            row = self.find_pivot(k)
            e.put(row, self.chosen, k, "i64")
            bad = e.value(f"zext i1 {self.is_round_off(row, k)} to i32")
            e.store(e.value(f"or i32 {e.load(singular, 'i32')}, {bad}"), singular, "i32")
            with e.when(e.value(f"icmp ne i64 {row}, {k}")):
                self.swap_rows(row, k)
            self.eliminate(k)
        with e.loop(0, self.n) as back:
            k = e.value(f"sub nsw i64 {self.n - 1}, {back}")
            other = e.get(self.chosen, k, "i64")
            with e.when(e.value(f"icmp ne i64 {other}, {k}")):
                self.swap_columns(other, k)
        e.do(f"ret i32 {e.load(singular, 'i32')}")
        return e.function(f"define internal i32 @invert{self.n}(ptr noalias %a, ptr noalias %scratch) noinline")

    def row(self, i: str | int) -> str:
        """Return the address of a row."""
        place = i * self.stride if isinstance(i, int) else self.e.value(f"mul nsw i64 {i}, {self.stride}")
        return self.e.address("%a", place)

    def blocks(self) -> Iterator[str | int]:
        """Repeat the body of a for statement for each block of a row."""
        if self.n <= WRITTEN_OUT:
            yield from range(0, self.n, BLOCK)
        else:
            with self.e.loop(0, self.n, BLOCK) as j:
                yield j

    def larger(self, a: str, b: str, kind: str = KIND) -> str:
        """Return the larger numbers, b where a is none."""
        truth = "i1" if kind == "double" else TRUTH
        return self.e.value(f"select {truth} {self.e.value(f'fcmp ogt {kind} {a}, {b}')}, {kind} {a}, {kind} {b}")

    def measure(self) -> None:
        """Store the reciprocal size of each row and column: of rows, of columns in those units, and of rows again."""
        e = self.e
        if self.n % BLOCK:
            with e.loop(0, self.n) as i:
                last = e.address(self.row(i), self.stride - BLOCK)
                e.store(cut_block(e, e.load(last, KIND), self.n, self.stride - BLOCK), last, KIND)
        for j in self.blocks():
            e.store(splat(e, literal(1.0)), e.address(self.columns, j), KIND)
        self.measure_rows()
        for j in self.blocks():
            largest = e.address(self.columns, j)
            e.store("zeroinitializer", largest, KIND)
            with e.loop(0, self.n) as i:
                size = e.fabs(e.load(e.address(self.row(i), j), KIND), KIND)
                size = e.value(f"fmul {KIND} {size}, {splat(e, e.get(self.units, i))}")
                e.store(self.larger(size, e.load(largest, KIND)), largest, KIND)
            e.store(e.value(f"fdiv {KIND} {splat(e, literal(1.0))}, {e.load(largest, KIND)}"), largest, KIND)
        self.measure_rows()

    def measure_rows(self) -> None:
        """Store the reciprocal size of each row, its columns in their units."""
        e = self.e
        cell = e.reserve(KIND)
        with e.loop(0, self.n) as i:
            e.store("zeroinitializer", cell, KIND)
            for j in self.blocks():
                size = e.fabs(e.load(e.address(self.row(i), j), KIND), KIND)
                size = e.value(f"fmul {KIND} {size}, {e.load(e.address(self.columns, j), KIND)}")
                e.store(self.larger(size, e.load(cell, KIND)), cell, KIND)
            sizes = e.load(cell, KIND)
            entries = [e.value(f"extractelement {KIND} {sizes}, i64 {lane}") for lane in range(BLOCK)]
            while len(entries) > 1:
                entries = [self.larger(a, b, "double") for a, b in zip(entries[::2], entries[1::2], strict=True)]
            e.put(e.real("fdiv", literal(1.0), entries[0]), self.units, i)

    def find_pivot(self, k: str) -> str:
        """Return the row, from k on, in which column k is largest; k where nothing there is a number."""
        e = self.e
        if self.n > WRITTEN_OUT:
            with e.carry(k, self.n, [("double", literal(-1.0)), ("i64", k)]) as best:
                size = e.real("fmul", e.fabs(e.get(self.row(best.index), k)), e.get(self.units, best.index))
                above = e.real("fcmp ogt", size, best.values[0])
                row = e.value(f"select i1 {above}, i64 {best.index}, i64 {best.values[1]}")
                best.following = [e.choose(above, size, best.values[0]), row]
            return best.values[1]
        found = []
        for i in range(self.n):
            size = e.real("fmul", e.fabs(e.get(self.row(i), k)), e.get(self.units, i))
            number = e.real("fcmp oge", size, literal(0.0))
            good = e.value(f"and i1 {number}, {e.value(f'icmp sge i64 {i}, {k}')}")
            found.append((e.choose(good, size, literal(-1.0)), str(i)))
        found.append((literal(-1.0), k))
        while len(found) > 1:
            pairs = zip(found[::2], found[1::2], strict=False)
            found = [self.better(a, b) for a, b in pairs] + ([found[-1]] if len(found) % 2 else [])
        return e.value(f"select i1 {e.real('fcmp oge', found[0][0], literal(0.0))}, i64 {found[0][1]}, i64 {k}")

    def better(self, a: tuple[str, str], b: tuple[str, str]) -> tuple[str, str]:
        """Return the larger of two sizes, with its row."""
        above = self.e.real("fcmp ogt", b[0], a[0])
        return self.e.choose(above, b[0], a[0]), self.e.value(f"select i1 {above}, i64 {b[1]}, i64 {a[1]}")

    def is_round_off(self, row: str, k: str) -> str:
        """Return whether a pivot is too small, in units of its row and column; one that is no number says nothing."""
        e = self.e
        pivot = e.get(self.row(row), k)
        size = e.real("fmul", e.fabs(pivot), e.real("fmul", e.get(self.units, row), e.get(self.columns, k)))
        small = e.real("fcmp ole", size, literal(PIVOT))
        return e.value(f"or i1 {small}, {e.real('fcmp oeq', pivot, literal(0.0))}")

    def swap_rows(self, one: str, other: str) -> None:
        """Exchange two rows; the unit of the second, where the pivot comes to stand, is not needed any more."""
        e = self.e
        rows = self.row(one), self.row(other)
        for j in self.blocks():
            places = [e.address(row, j) for row in rows]
            values = [e.load(place, KIND) for place in places]
            e.store(values[0], places[1], KIND)
            e.store(values[1], places[0], KIND)
        e.put(e.get(self.units, other), self.units, one)

    def eliminate(self, k: str) -> None:
        """Take multiples of row k from the others, and let column k become that of the inverse.

        Whole blocks are stored, its entry in them: a number stored alone would keep the next load of a block waiting.
        """
        e = self.e
        here = self.row(k)
        reciprocal = splat(e, e.real("fdiv", literal(1.0), e.get(here, k)))
        for j in self.blocks():
            scaled = e.value(f"fmul {KIND} {e.load(e.address(here, j), KIND)}, {reciprocal}")
            e.store(self.select(j, k, reciprocal, scaled), e.address(self.pivots, j), KIND)
        with e.loop(0, self.n) as i:
            row = self.row(i)
            factor = splat(e, e.value(f"fneg double {e.get(row, k)}"))
            for j in self.blocks():
                place = e.address(row, j)
                old = self.select(j, k, "zeroinitializer", e.load(place, KIND))
                e.store(e.fma(factor, e.load(e.address(self.pivots, j), KIND), old, KIND), place, KIND)
        for j in self.blocks():
            e.store(e.load(e.address(self.pivots, j), KIND), e.address(here, j), KIND)

    def select(self, j: str | int, k: str, inside: str, outside: str) -> str:
        """Return the block at column j of two, the first in column k and the second elsewhere."""
        return self.e.value(f"select {TRUTH} {lane_is(self.e, k, j)}, {KIND} {inside}, {KIND} {outside}")

    def swap_columns(self, one: str, other: str) -> None:
        """Exchange two columns."""
        e = self.e
        with e.loop(0, self.n) as i:
            row = self.row(i)
            first, second = e.get(row, one), e.get(row, other)
            e.put(second, row, one)
            e.put(first, row, other)
