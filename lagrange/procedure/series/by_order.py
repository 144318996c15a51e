"""The series in a loop over orders, each value of the order at hand a value of its own.

This form is for members side by side: a value is a vector already, and to bring like values side by side gains nothing.
A row keeps what later orders read, each number once. The values of the order at hand follow from the sums over lower
orders in straight-line code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.series.jet import Jet, divided
from lagrange.procedure.series.numbers import SeriesNumbers
from lagrange.procedure.series.order_sums import Kept, OrderSums, Pair
from lagrange.procedure.series.packing import Chunk, Operand, PackedStage, Packing
from lagrange.procedure.series.rules import Term, coefficient, less
from lagrange.procedure.series.systems import system_size
from lagrange.procedure.series.value import ValueAt, divisor
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.procedure.values import Memory, Real, Whole

LARGEST_INVERSE = 12
"""The inverse of a mass matrix is written out up to this size: for members side by side loops over vectors are none."""


class ByOrderJet(Jet):
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
        self.k: Whole = self.order
        self.rank = self.high = self.low = self.time = self.scale
        self.shares = self.scale, self.scale

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
        if moving:
            p.note("Order 1 is computed twice, the second time from the velocities found first.")
        with p.loop(0 if moving else 1, self.order + 1) as iteration:
            self.set_order(p.larger(iteration, 1) if moving else iteration)
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
        p, width = self.p, self.layout.width
        self.k, self.row, self.previous = k, self.rows.at(k * width), self.rows.at((k - 1) * width)
        self.rank = p.real(k)
        self.high = 1.0 / self.rank
        p.note("What 1 - k high leaves over is exact, and its share is the part of 1 / k that rounding lost.")
        self.low = p.fma(-self.rank, self.high, 1.0) * self.high
        self.shares = self.high * self.scale, self.low * self.scale
        self.time = p.choose(k.equals(1), self.scale, 0.0)

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
        right = []
        for force, momentum in zip(stage.right, stage.left, strict=True):
            rate = None if force is None else self.share(self.before(force))
            right.append(less(rate, None if momentum is None else self.x[momentum]))
        found = [p.real(0.0) if x is None else x for x in self.systems[place].solve(right)]
        if guess is not None:
            weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
            found = [x + one for x, one in zip(found, guesses, strict=True)]
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

    def share(self, x: Term) -> Term:
        """Return x scale / k."""
        return divided(self, x, *self.shares)

    def part(self, x: Term) -> Term:
        """Return x / k."""
        return divided(self, x, self.high, self.low)


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
