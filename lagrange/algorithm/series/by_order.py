"""Series in a loop over orders for lanes, each of which holds one member of an ensemble.

One vector holds a value of all members. Vectors of the present order are values of the procedure. Each vector
that later orders read is stored in a row of memory. Straight-line code computes the values of the present order
from the sums over lower orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.series.jet import LoopJet, solved
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Chunk, Operand, PackedStage, Packing
from lagrange.algorithm.series.rules import ChunkAt, Term, coefficient
from lagrange.algorithm.series.systems import Diagonal, Inverse, system_size
from lagrange.algorithm.series.vectors import OrderSums, Pair, entries, gathered, of_width, put, wide
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.values import Whole

LARGEST_INVERSE = 12
"""Largest inverse of a mass matrix that is written out. Lanes already hold members, so inner loops do not vectorize."""


class Row:
    """Layout of the memory row of one order: indices of the state, the watched functions and stored operands.

    `places` has the index of each operand that later orders read, and `size` is the length of a row.
    """

    def __init__(self, packing: Packing, watched_at: int) -> None:
        self.places: dict[Operand, int] = {}
        begin = 0
        for chunk in packing.state:
            if chunk.count == len(chunk.values):
                self.places[chunk.whole] = begin
            begin += chunk.count
        self.size = watched_at + len(packing.program.watched)
        # Later orders read the factors of sums, the operands of the next order and dq/dt. With several lanes operands
        # that are read at order 0 are stored, too.
        initial = packing.initial if packing.lanes > 1 else ()
        for operand in (*packing.summed, *packing.delayed, *packing.rates, *initial):
            if operand not in self.places:
                lanes = len(operand.values)
                self.places[operand] = whole_blocks(self.size, lanes)
                self.size = self.places[operand] + lanes
        self.size = whole_blocks(self.size, packing.lanes)


def by_order_scratch(packing: Packing) -> int:
    """Return how many doubles of work memory the matrices of a series need, after its rows of coefficients."""
    return sum(system_size(stage.plan, LARGEST_INVERSE) for stage in packing.program.stages)


class ByOrderJet(LoopJet):
    """Builder of the procedure that computes the Taylor coefficients of all lanes in a loop over orders.

    `x` has the coefficients of each chunk of values at the present order.
    """

    def __init__(self, packing: Packing, numbers: SeriesNumbers, layout: TaylorLayout | None = None) -> None:
        if layout is None:
            program, width = packing.program, Row(packing, packing.program.states).size
            ways = {"by_rows": True, "observes": len(program.watched) > 0}
            layout = TaylorLayout.of(program, width, scratch=by_order_scratch(packing), **ways)
        super().__init__(packing, numbers, layout, LARGEST_INVERSE)
        self.places = Row(packing, self.layout.watched_at).places
        self.x: dict[Chunk, Term] = {}
        self.operands: dict[Operand, Term] = {}
        """Operands that are gathered to vectors at the present order."""
        self.sums: dict[Pair, Term] = {}
        """Sums over lower orders at the present order."""
        self.row = self.previous = self.rows

    def build(self) -> Procedure:
        """Return the procedure that computes the series for all lanes."""
        p, packing = self.p, self.packing
        self.begin()
        for operand in dict.fromkeys(chunk.divisor for chunk in packing.computed):
            if operand is not None:
                self.reciprocals[operand] = 1.0 / self.at_zero(operand)
        for system, stage in zip(self.systems, packing.stages, strict=True):
            if isinstance(system, (Diagonal, Inverse)):
                # The entries are gathered to vectors before the loop over orders.
                system.read(stage.rows)
        pairs = (pair for chunk in packing.computed for pair in chunk.sums)
        sums = OrderSums(p, pairs, self.places, self.rows, self.layout.width)
        self.write_first()
        guesses = [
            [p.variable(wide(p, None, len(chunk.values))) for chunk in stage.unknowns] if stage.plan.moving else None
            for stage in packing.stages
        ]
        with self.each_order() as iteration:
            self.sums = sums.at(self.k)
            for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
                self.x[chunk] = self.share(self.before(rate))
            self.fill(packing.before)
            for stage_number, (stage, guess) in enumerate(zip(packing.stages, guesses, strict=True)):
                self.solve(stage_number, stage, guess, iteration)
            self.write()
        p.leave(self.singular)
        return p.finish(FLAG)

    def set_order(self, k: Whole) -> None:
        """Set k as the present order: compute 1 / k, and find the rows of this and the previous order."""
        width = self.layout.width
        self.row, self.previous = self.rows.at(k * width), self.rows.at((k - 1) * width)
        super().set_order(k)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        for chunk in chunks:
            self.x[chunk] = of_width(self.p, coefficient(ChunkAt(self, chunk)), len(chunk.values))

    def know(self, stage_number: int, values: Sequence[Term]) -> None:
        """Set the present coefficients of the unknowns of linear system `stage_number` to `values`.

        Operands that were gathered with earlier values of the unknowns are dropped.
        """
        self.operands = {operand: x for operand, x in self.operands.items() if self.is_known(operand, stage_number)}
        self.x |= zip(self.packing.stages[stage_number].unknowns, values, strict=True)

    def solve(self, stage_number: int, stage: PackedStage, guess: Sequence[Any] | None, iteration: Whole) -> None:
        """Compute the present unknowns of linear system `stage_number`, then the values that depend on them.

        Order 1 may be computed in two iterations. Then `guess` are variables with the unknowns that the first
        one found; otherwise it is None. `iteration` is the number of the present iteration.
        """
        p = self.p
        guesses = [None if guess is None else variable.value for variable in guess or [None] * len(stage.unknowns)]
        self.know(stage_number, guesses)
        self.fill(stage.trial)
        solution = solved(self, stage_number, stage, guesses)
        values = [wide(p, x, len(chunk.values)) for chunk, x in zip(stage.unknowns, solution, strict=True)]
        if guess is not None:
            weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
            for variable, x in zip(guess, values, strict=True):
                variable.value = x * weight
        self.know(stage_number, values)
        self.fill(stage.found)

    def write_first(self) -> None:
        """Write the row of order 0: state, event functions and stored operands.

        Operands that are multiplied by their order are zero there.
        """
        self.write_state(self.at_zero)
        for operand, index in self.places.items():
            lanes = len(operand.values)
            put(self.p, self.rows, index, None if operand.ranked else self.at_zero(operand), lanes, lanes)

    def write(self) -> None:
        """Write the row of the present order to memory."""
        self.write_state(self.now)
        for operand, index in self.places.items():
            lanes = len(operand.values)
            put(self.p, self.row, index, self.now(operand), lanes, lanes)

    def write_state(self, x: Any) -> None:
        """Write coefficients of the state and of the event functions to a row; `x` returns those of an operand.

        `x` is `at_zero` for the row of order 0, or `now` for the row of the present order. Parts of the state
        that are stored as operands are left out.
        """
        begin, row = 0, self.rows if x == self.at_zero else self.row
        for chunk in self.packing.state:
            if self.places.get(chunk.whole) != begin:
                put(self.p, row, begin, x(chunk.whole), len(chunk.values), chunk.count)
            begin += chunk.count
        for index, number in enumerate(self.program.watched, self.layout.watched_at):
            put(self.p, row, index, None if number is None else x(Operand((number,))), 1, 1)

    def now(self, operand: Operand) -> Term:
        """Return the coefficient of an operand at the present order."""
        if operand not in self.operands:
            x = gathered(self.p, self.packing, operand, self.x.__getitem__)
            self.operands[operand] = x * self.rank if operand.ranked and x is not None else x
        return self.operands[operand]

    def before(self, operand: Operand) -> Term:
        """Return the coefficient of an operand at the previous order."""
        return entries(self.previous, self.places[operand], len(operand.values))

    def first(self, operand: Operand) -> Term:
        """Return the value of an operand at order 0."""
        if self.packing.lanes > 1 and operand in self.places:
            return entries(self.rows, self.places[operand], len(operand.values))
        return self.at_zero(operand)

    def over(self, operand: Operand) -> Term:
        """Return the reciprocal of an operand at order 0."""
        return self.reciprocals[operand]

    def total(self, chunk: Chunk, number: int) -> Term:
        """Return one sum that the rule of a chunk reads: sum number `number`, of x[j] y[k-j] over 0 < j < k."""
        return self.sums[chunk.sums[number]]
