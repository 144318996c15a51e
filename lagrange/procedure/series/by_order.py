"""The series in a loop over orders, each value of the order at hand a value of its own.

This form is for members side by side: a value is a vector already, and to bring like values side by side gains nothing.
A row keeps what later orders read, each number once. The values of the order at hand follow from the sums over lower
orders in straight-line code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.series.jet import LoopJet
from lagrange.procedure.series.numbers import SeriesNumbers
from lagrange.procedure.series.order_sums import Kept, OrderSums, Pair
from lagrange.procedure.series.packing import Chunk, Operand, PackedStage, Packing
from lagrange.procedure.series.rules import Term, coefficient
from lagrange.procedure.series.systems import system_size
from lagrange.procedure.series.value import ValueAt, divisor, solved
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.procedure.values import Memory, Real, Whole

LARGEST_INVERSE = 12
"""The inverse of a mass matrix is written out up to this size: for members side by side loops over vectors are none."""


class ByOrderJet(LoopJet):
    """Builds the procedure from values that are packed one by one."""

    def __init__(self, packing: Packing, numbers: SeriesNumbers) -> None:
        state = 2 * packing.program.dimension
        first = [(i, False) for i in range(state)]
        self.places = dict(zip(first, range(state), strict=True))
        """Where the numbers of a row stand: the state, what is watched, and what later orders read."""
        self.width = state + len(packing.program.watched)
        for kept in _kept(packing):
            if kept not in self.places:
                self.places[kept] = self.width
                self.width += 1
        super().__init__(packing, numbers, self.layout_of(packing), LARGEST_INVERSE)
        self.x: dict[int, Term] = {}
        self.sums: dict[Pair, Real] = {}
        """The sums at the order at hand."""
        self.reciprocals: dict[int, Real] = {}
        """One over what is divided by at order 0."""
        self.row = self.previous = self.rows

    def layout_of(self, packing: Packing) -> TaylorLayout:
        """Return where things stand."""
        program = packing.program
        n, watched = 2 * program.dimension, len(program.watched)
        scratch = sum(system_size(stage.plan, LARGEST_INVERSE) for stage in program.stages)
        ways = {"projected": program.projection is not None, "crossing": program.may_cross, "by_rows": True}
        return TaylorLayout(n, self.width, watched, n, block=1, scratch=scratch, observes=watched > 0, **ways)

    def build(self) -> Procedure:
        """Return the procedure."""
        p, packing = self.p, self.packing
        self.begin()
        for operand in dict.fromkeys(operand for chunk in packing.computed if (operand := divisor(chunk)) is not None):
            self.reciprocals[operand.values[0]] = 1.0 / self.origin[operand.values[0]]
        pairs = (pair for chunk in packing.computed for pair in _pairs(chunk))
        sums = OrderSums(p, pairs, self.places, self.rows, self.layout.width)
        self.write_first()
        moving = any(stage.plan.moving for stage in packing.stages)
        guesses = [[p.variable(p.real(0.0)) for _ in stage.unknowns] if moving else None for stage in packing.stages]
        with self.each_order() as iteration:
            self.sums = sums.at(self.k)
            self.x = {i: self.share(self.before(rate)) for i, rate in enumerate(self.program.rates)}
            self.fill(packing.before)
            for place, (stage, guess) in enumerate(zip(packing.stages, guesses, strict=True)):
                self.solve(place, stage, guess, iteration)
            self.write()
        p.leave(self.singular)
        return p.finish(FLAG)

    def set_order(self, k: Whole) -> None:
        """Build what depends on the order alone."""
        width = self.layout.width
        self.row, self.previous = self.rows.at(k * width), self.rows.at((k - 1) * width)
        super().set_order(k)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Build the coefficients of some values."""
        for chunk in chunks:
            self.x[chunk.values[0]] = coefficient(_ByOrder(self, chunk, 0))

    def solve(self, place: int, packed: PackedStage, guess: Sequence[Any] | None, iteration: Whole) -> None:
        """Build the unknowns of a stage, and what follows from them."""
        p, stage = self.p, self.program.stages[place]
        guesses = [None if guess is None else one.value for one in guess or [None] * len(stage.unknowns)]
        self.x |= zip(stage.unknowns, guesses, strict=True)
        self.fill(packed.trial)
        found = [p.real(0.0) if x is None else x for x in solved(self, place, guesses)]
        if guess is not None:
            weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
            for one, x in zip(guess, found, strict=True):
                one.value = x * weight
        self.x |= zip(stage.unknowns, found, strict=True)
        self.fill(packed.found)

    def write_first(self) -> None:
        """Write order 0."""
        zero = self.p.real(0.0)
        for (number, ranked), place in self.places.items():
            self.rows[place] = zero if ranked else self.origin.get(number, zero)
        self.write_watched(self.rows, self.origin)

    def write(self) -> None:
        """Write the row."""
        for (number, ranked), place in self.places.items():
            x = self.x[number]
            value = self.p.real(0.0) if x is None else x
            self.row[place] = value * self.rank if ranked else value
        self.write_watched(self.row, self.x)

    def write_watched(self, row: Memory, x: Mapping[int, Term]) -> None:
        """Write the coefficients of the event functions."""
        for place, number in enumerate(self.program.watched, self.layout.watched_at):
            value = None if number is None else x[number]
            row[place] = self.p.real(0.0) if value is None else value

    def before(self, number: int) -> Term:
        """Return a coefficient of the order before."""
        return self.previous[self.places[number, False]]

    def over(self, number: int) -> Real:
        """Return one over a value at order 0."""
        return self.reciprocals[number]

    def start(self) -> Term:
        """Return the coefficient of time: the scale at k = 1, else 0."""
        return self.time


class _ByOrder(ValueAt):
    """A value at the order at hand; see `At`."""

    series: ByOrderJet

    def total(self, which: int) -> Term:
        """Return the sum over 0 < j < k."""
        return self.series.sums[_pairs(self.chunk)[which]]


def _pairs(chunk: Chunk) -> list[Pair]:
    """Return the sums that the rule of a value reads."""
    return [(_kept_of(a), _kept_of(b)) for a, b in chunk.sums]


def _kept_of(operand: Operand) -> Kept:
    return operand.values[0], operand.ranked


def _kept(packing: Packing) -> Iterator[Kept]:
    """Return what later orders read: the factors of sums, and what is read one order later."""
    yield from (kept for chunk in packing.computed for pair in _pairs(chunk) for kept in pair)
    yield from (_kept_of(operand) for operand in (*packing.delayed, *packing.rates))
