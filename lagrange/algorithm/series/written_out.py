"""Builder of the series of a small system without loops: each coefficient is a value of the procedure."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce

from lagrange.algorithm.series.jet import JetBuilder, divided, solved
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Chunk, Operand, Packing
from lagrange.algorithm.series.rules import ChunkAt, Term, coefficient, fma, plus
from lagrange.algorithm.series.systems import ALL, system_size
from lagrange.algorithm.series.vectors import gathered, of_width, put, width
from lagrange.algorithm.taylor.constants import LOWEST_ORDER
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.procedure.form import FLAG, Procedure
from lagrange.program.elimination import LARGEST_IN_LINE

HIGHEST_EXACT_ORDER = 10
"""Highest order at which division by the order is rounded once. A later coefficient contributes so little to a step
that the bias of its rounding is negligible.
"""

PART, LATEST = 4, 2
"""Number of products in each part of a sum, and number of latest products, which are added last. The products of a part
wait for one another. In one chain, a sum of order 26 waits longer than all other operations of that order take: eight
members of a pendulum took 154 ns, in parts 128 ns. The latest products wait for the previous order.
"""


class WrittenJet(JetBuilder):
    """Builder of a procedure without loops that computes a series up to an order from `lowest` to `highest`.

    `x` has the coefficients of each chunk by order.
    """

    def __init__(
        self,
        packing: Packing,
        numbers: SeriesNumbers,
        highest: int,
        *,
        lowest: int = LOWEST_ORDER,
        layout: TaylorLayout | None = None,
    ) -> None:
        largest = ALL if packing.lanes > 1 else LARGEST_IN_LINE
        if layout is None:
            program, scratch = packing.program, sum(system_size(stage.plan) for stage in packing.program.stages)
            layout = TaylorLayout.of(program, scratch=scratch, chains=True, observes=len(program.watched) > 0)
        super().__init__(packing, numbers, layout, largest)
        self.lowest, self.highest, self.k = lowest, highest, 0
        self.x: dict[tuple[Chunk, int], Term] = {}
        self.operands: dict[tuple[Operand, int], Term] = {}
        self.totals: dict[tuple[Chunk, int, int], Term] = {}
        self.shares: dict[tuple[float, int], Term] = {}

    def build(self) -> Procedure:
        """Return the procedure that computes the series without a loop."""
        self.begin()
        self.write()
        for k in range(1, self.highest + 1):
            self.add_order(k)
        self.p.leave(self.singular)
        return self.p.finish(FLAG)

    def add_order(self, k: int) -> None:
        """Add the code of order k: coefficients of all values, and the row that is written.

        After the last linear system of the highest order only event functions need further values.
        """
        packing, self.k = self.packing, k
        for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
            self.x[chunk, k] = self.share(self.before(rate))
        self.fill(packing.before)
        for stage_number, stage in enumerate(packing.stages):
            guesses: list[Term] = [None] * len(stage.unknowns)
            # The unknowns of order 1 are corrected by the residual of dp/dt = f: they carry most of a step's rounding
            # error. Corrected accelerations of chains of 10 and 20 links are two to three times as accurate.
            for _ in range(2 if k == 1 and stage.plan.moving else 1):
                self.know(stage_number, guesses)
                self.fill(stage.trial)
                guesses = solved(self, stage_number, stage, guesses)
            self.know(stage_number, guesses)
            last = stage is packing.stages[-1]
            if last and not self.program.watched:
                self.end_order()
            if k < self.highest or self.program.watched or not last:
                self.fill(stage.found)
        if self.program.watched:
            self.end_order()

    def end_order(self) -> None:
        """Write the row of the present order, and return if it is the last order that is asked for."""
        self.write()
        if self.lowest <= self.k < self.highest:
            self.p.leave_if(self.order.equals(self.k), self.singular)

    def know(self, stage_number: int, values: Sequence[Term]) -> None:
        """Set the present coefficients of the unknowns of linear system `stage_number` to `values`.

        Operands that were gathered with earlier values of the unknowns are dropped.
        """
        for key in [key for key in self.operands if key[1] == self.k and not self.is_known(key[0], stage_number)]:
            del self.operands[key]
        for chunk, value in zip(self.packing.stages[stage_number].unknowns, values, strict=True):
            self.x[chunk, self.k] = value

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        for chunk in chunks:
            self.x[chunk, self.k] = of_width(self.p, coefficient(ChunkAt(self, chunk)), len(chunk.values))

    def write(self) -> None:
        """Write the row of the present order. Zeros are written too, because other runs use the same memory."""
        index = self.k * self.layout.width
        watched_at = index + self.layout.watched_at
        for chunk in self.packing.state:
            put(self.p, self.rows, index, self.now(chunk.whole), len(chunk.values), chunk.count)
            index += chunk.count
        for i, watched in enumerate(self.program.watched, watched_at):
            put(self.p, self.rows, i, None if watched is None else self.now(Operand((watched,))), 1, 1)

    def now(self, operand: Operand) -> Term:
        """Return the coefficient of an operand at the present order."""
        return self.at(operand, self.k)

    def before(self, operand: Operand) -> Term:
        """Return the coefficient of an operand at the previous order."""
        return self.at(operand, self.k - 1)

    def first(self, operand: Operand) -> Term:
        """Return the value of an operand at order 0."""
        return self.at(operand, 0)

    def at(self, operand: Operand, k: int) -> Term:
        """Return the coefficient of an operand at order k."""
        key = operand, k
        if key in self.operands:
            return self.operands[key]
        if k == 0:
            coefficient = self.at_zero(operand)
        else:
            coefficient = gathered(self.p, self.packing, operand, lambda chunk: self.x[chunk, k])
            if operand.ranked and coefficient is not None and k > 1:
                coefficient = coefficient * float(k)
        self.operands[key] = coefficient
        return coefficient

    def over(self, operand: Operand) -> Term:
        """Return the reciprocal of an operand at order 0."""
        if operand not in self.reciprocals:
            first = self.first(operand)
            self.reciprocals[operand] = 1.0 / (self.p.real(0.0) if first is None else first)
        return self.reciprocals[operand]

    def share(self, x: Term) -> Term:
        """Return scale * x / k: the order k of a value from the order k-1 of its derivative, x."""
        if x is None:
            return None
        high, low = reciprocal(self.k)
        small = self.scaled(low, width(x)) if low and self.k <= HIGHEST_EXACT_ORDER else None
        return divided(self, x, self.scaled(high, width(x)), small)

    def scaled(self, factor: float, lanes: int) -> Term:
        """Return the scale times `factor`, in each of the lanes. It is exact, because the scale is a power of two."""
        if (factor, lanes) not in self.shares:
            single = self.scale if factor == 1.0 else self.scale * factor
            if lanes > 1:
                single = self.p.broadcast(self.scaled(factor, 1), lanes)
            self.shares[factor, lanes] = single
        return self.shares[factor, lanes]

    def start(self) -> Term:
        """Return the present Taylor coefficient of the time itself: the scale of time at order 1, else 0."""
        return self.scale if self.k == 1 else None

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""
        high, low = reciprocal(self.k)
        return divided(self, x, self.p.real(high), self.p.real(low) if low and self.k <= HIGHEST_EXACT_ORDER else None)

    def total(self, chunk: Chunk, number: int) -> Term:
        """Return one sum that the rule of a chunk reads: sum number `number`, of x[j] y[k-j] over 0 < j < k.

        Its code is added once at each order.
        """
        key = chunk, number, self.k
        if key not in self.totals:
            self.totals[key] = self.summed(*chunk.sums[number])
        return self.totals[key]

    def summed(self, a: Operand, b: Operand) -> Term:
        """Return the sum of a[j] b[k-j] over 0 < j < k."""
        k, p = self.k, self.p
        pairs = sorted(range(1, k), key=lambda j: (max(j, k - j), j))
        if a != b:
            return self.products(a, b, pairs)
        total = self.products(a, b, [j for j in pairs if 2 * j < k])
        total = plus(total, total)
        middle = self.at(a, k // 2)
        return fma(p, middle, middle, total) if k % 2 == 0 else total

    def products(self, a: Operand, b: Operand, pairs: Sequence[int]) -> Term:
        """Return the sum of a[j] * b[k-j] over the orders j in `pairs`, as partial sums of `PART` products."""
        k, p = self.k, self.p
        parts: list[Term] = [None] * max(len(pairs) // PART, 1)
        early = len(pairs) - LATEST
        for index, j in enumerate(pairs):
            if index == early:
                parts = [reduce(plus, parts)]
            lane = index % len(parts)
            parts[lane] = fma(p, self.at(a, j), self.at(b, k - j), parts[lane])
        return reduce(plus, parts)


def reciprocal(k: int) -> tuple[float, float]:
    """Return 1 / k as a pair of doubles, whose sum is accurate to twice the digits."""
    high = 1.0 / k
    return high, float(Fraction(1, k) - Fraction(high))
