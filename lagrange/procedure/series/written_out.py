"""The series of a small system written out: every coefficient of every order is a value of its own."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce

from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.series.jet import Jet, divided
from lagrange.procedure.series.numbers import SeriesNumbers
from lagrange.procedure.series.packing import Chunk, Operand, Packing
from lagrange.procedure.series.rules import Term, coefficient, fma, plus
from lagrange.procedure.series.systems import system_size
from lagrange.procedure.series.value import ValueAt, solved
from lagrange.procedure.taylor.constants import LOWEST_ORDER
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.procedure.values import Real

EXACT = 10
"""Up to this order a division by the order is rounded once.

A later coefficient contributes so little to a step that the bias of its rounding is negligible.
"""

PART, LATEST = 4, 2
"""A sum is made of parts of about so many products, but for its `LATEST` ones, which are added last.

The products of a part wait for one another. In one chain a sum of order 26 waits longer than all else at that order
takes: eight members of a pendulum took 154 ns, in parts 128 ns. The latest products wait for the order before.
"""


def written_layout(packing: Packing) -> TaylorLayout:
    """Return where things stand."""
    program = packing.program
    n, watched = 2 * program.dimension, len(program.watched)
    scratch = sum(system_size(stage.plan) for stage in program.stages)
    projected, crossing = program.projection is not None, program.may_cross
    ways = {"projected": projected, "crossing": crossing, "observes": watched > 0}
    return TaylorLayout(n, n + watched, watched, n, block=1, scratch=scratch, chains=True, **ways)


class WrittenJet(Jet):
    """Builds the procedure for orders up to `highest`; `orders` has the coefficients of each value."""

    def __init__(self, packing: Packing, numbers: SeriesNumbers, highest: int) -> None:
        super().__init__(packing, numbers, written_layout(packing))
        self.highest, self.k = highest, 0
        self.orders: list[dict[int, Term]] = []
        self.ranked: dict[tuple[int, int], Real] = {}
        """Coefficients times their orders."""
        self.x: dict[int, Term] = {}
        self.reciprocals: dict[int, Real] = {}
        """One over what is divided by at order 0: found at order 1, which every series has."""

    def build(self) -> Procedure:
        """Return the procedure."""
        p = self.p
        self.begin()
        self.x = self.origin
        self.orders.append(self.x)
        self.write()
        for k in range(1, self.highest + 1):
            self.add_order(k)
        p.leave(self.singular)
        return p.finish(FLAG)

    def add_order(self, k: int) -> None:
        """Build the coefficients of an order; the highest one ends with its row."""
        packing, self.k = self.packing, k
        self.x = {i: self.share(self.before(rate)) for i, rate in enumerate(self.program.rates)}
        self.orders.append(self.x)
        self.fill(packing.before)
        for place, (stage, packed) in enumerate(zip(self.program.stages, packing.stages, strict=True)):
            guesses: list[Term] = [None] * len(stage.unknowns)
            for _ in range(2 if k == 1 and stage.plan.moving else 1):
                self.x |= zip(stage.unknowns, guesses, strict=True)
                self.fill(packed.trial)
                guesses = solved(self, place, guesses)
            self.x |= zip(stage.unknowns, guesses, strict=True)
            last = packed is packing.stages[-1]
            if last and not self.program.watched:
                self.end_order()
            if k < self.highest or self.program.watched or not last:
                self.fill(packed.found)
        if self.program.watched:
            self.end_order()

    def end_order(self) -> None:
        """Write the row of an order, and return behind it if no more is wanted; the highest one is the last."""
        self.write()
        if LOWEST_ORDER <= self.k < self.highest:
            self.p.leave_if(self.order.equals(self.k), self.singular)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Build the coefficients of some chunks."""
        for chunk in chunks:
            for lane in range(chunk.count):
                self.x[chunk.values[lane]] = coefficient(_WrittenAt(self, chunk, lane))

    def write(self) -> None:
        """Write the row."""
        row, zero = self.rows.at(self.k * self.layout.width), self.p.real(0.0)
        for i, number in enumerate((*range(2 * self.program.dimension), *self.program.watched)):
            value = None if number is None else self.x[number]
            row[i] = zero if value is None else value

    def before(self, number: int) -> Term:
        """Return a coefficient of the order before."""
        return self.orders[self.k - 1][number]

    def share(self, x: Term) -> Term:
        """Return x scale / k; see `At`."""
        high, low = reciprocal(self.k)
        scale = self.scale
        small = scale * low if low and self.k <= EXACT else None
        return divided(self, x, scale if high == 1.0 else scale * high, small)

    def start(self) -> Term:
        """Return the coefficient of time: the scale at k = 1, else 0."""
        return self.scale if self.k == 1 else None

    def over(self, number: int) -> Real:
        """Return one over a value at order 0."""
        if number not in self.reciprocals:
            self.reciprocals[number] = 1.0 / self.origin[number]
        return self.reciprocals[number]

    def times_order(self, number: int, k: int) -> Term:
        """Return a coefficient times its order: of a state it is that of the rate before, in the scale of time."""
        if number < len(self.program.rates):
            return self.orders[k - 1][self.program.rates[number]] * self.scale
        return self.orders[k][number] * float(k)

    def part(self, x: Term) -> Term:
        """Return x / k; see `At`."""
        high, low = reciprocal(self.k)
        return divided(self, x, self.p.real(high), self.p.real(low) if low and self.k <= EXACT else None)


class _WrittenAt(ValueAt):
    """A value at an order that is written out; see `At`."""

    series: WrittenJet

    def total(self, which: int) -> Term:
        """Return the sum over 0 < j < k, the oldest coefficients first."""
        k, p = self.series.k, self.p
        a, b = self.chunk.sums[which]
        pairs = sorted(range(1, k), key=lambda j: (max(j, k - j), j))
        if a != b:
            return self.products(a, b, pairs)
        total = self.products(a, b, [j for j in pairs if 2 * j < k])
        total = plus(total, total)
        middle = self.factor(a, k // 2)
        return fma(p, middle, middle, total) if k % 2 == 0 else total

    def products(self, a: Operand, b: Operand, pairs: Sequence[int]) -> Term:
        """Return the sum of a[j] b[k-j] over some j; see `PART`."""
        k, p = self.series.k, self.p
        parts: list[Term] = [None] * max(len(pairs) // PART, 1)
        early = len(pairs) - LATEST
        for place, j in enumerate(pairs):
            if place == early:
                parts = [reduce(plus, parts)]
            which = place % len(parts)
            parts[which] = fma(p, self.factor(a, j), self.factor(b, k - j), parts[which])
        return reduce(plus, parts)

    def factor(self, operand: Operand, k: int) -> Term:
        """Return a factor of a sum at an order."""
        number, jet = operand.values[self.lane], self.series
        x = jet.orders[k][number]
        if not operand.ranked or x is None or k == 1:
            return x
        if (number, k) not in jet.ranked:
            jet.ranked[number, k] = jet.times_order(number, k)
        return jet.ranked[number, k]


def reciprocal(k: int) -> tuple[float, float]:
    """Return 1 / k as the sum of two doubles."""
    high = 1.0 / k
    return high, float(Fraction(1, k) - Fraction(high))
