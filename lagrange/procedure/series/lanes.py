"""The lanes of a chunk of like values at an order, which rules read; see `At`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lagrange.procedure.builder import Builder
from lagrange.procedure.series.image import Image
from lagrange.procedure.series.packing import Chunk, Operand
from lagrange.procedure.series.rules import OWN, Term
from lagrange.procedure.values import Memory, Real, Whole
from lagrange.program.series import SeriesProgram


class Orders(Protocol):
    """What lanes read of a series in a loop over orders."""

    p: Builder
    program: SeriesProgram
    image: Image
    k: Whole
    time: Real
    constants: list[Real]
    sums: dict[tuple[Chunk, int], int]
    vectors: dict[tuple[int, ...], int]
    divisors: dict[Operand, int]

    def part_of(self, array: str, place: int) -> Memory:
        """Return an array from a place on."""

    def array_of(self, place: int) -> Memory:
        """Return the array in which a value of the order at hand stands."""

    def common(self, places: Sequence[int]) -> float | None:
        """Return the number that coefficients are in all lanes, if it is known now."""

    def share(self, x: Term) -> Term:
        """Return x scale / k."""

    def part(self, x: Term) -> Term:
        """Return x / k."""


class ChunkLane:
    """A lane of a chunk at an order; see `At`."""

    def __init__(self, jet: Orders, chunk: Chunk, i: Whole) -> None:
        self.jet, self.chunk, self.p, self.i = jet, chunk, jet.p, i

    def operand(self, which: int) -> Operand:
        """Return an argument, or the chunk itself."""
        return self.chunk.whole if which == OWN else self.chunk.args[which]

    def read(self, array: str, place: int) -> Real:
        """Return a number of this lane."""
        found: Real = self.jet.part_of(array, place)[self.i]
        return found

    def now(self, which: int) -> Term:
        """Return the coefficient of an argument at the order at hand."""
        return self.read("now", self.jet.image.places[self.operand(which)])

    def before(self, which: int) -> Term:
        """Return the coefficient of an argument at the order before."""
        return self.read("previous", self.jet.image.places[self.operand(which)])

    def first(self, which: int) -> Real:
        """Return an argument, or the value itself, at order 0."""
        return self.read("first", self.jet.image.places[self.operand(which)])

    def total(self, which: int) -> Term:
        """Return a sum over 0 < j < k."""
        return self.read("totals", self.jet.sums[self.chunk, which])

    def over(self, which: int) -> Real:
        """Return one over an argument, or over the value itself, at order 0."""
        return self.read("reciprocals", self.jet.divisors[self.operand(which)])

    def known(self, which: int) -> float | None:
        """Return a coefficient of the rule if it is known now."""
        return self.jet.common(self.chunk.coefficients[which])

    def constant(self, which: int) -> Real:
        """Return a coefficient of the rule."""
        known = self.known(which)
        if known is not None:
            return self.p.real(known)
        return self.read("constants", self.jet.vectors[self.chunk.coefficients[which]])

    def share(self, x: Term) -> Term:
        """Return x scale / k."""
        return self.jet.share(x)

    def part(self, x: Term) -> Term:
        """Return x / k."""
        return self.jet.part(x)

    def start(self) -> Term:
        """Return the coefficient of time: the scale at k = 1, else 0."""
        return self.jet.time


class ScatteredLane(ChunkLane):
    """One lane of a linear combination, whose terms stand anywhere; see `At`."""

    def __init__(self, jet: Orders, chunk: Chunk, lane: int) -> None:
        super().__init__(jet, chunk, jet.k)
        self.lane = lane

    def now(self, which: int) -> Term:
        """Return the coefficient of an argument at the order at hand."""
        home = self.jet.image.homes[self.chunk.args[which].values[self.lane]]
        return self.jet.array_of(home)[home]

    def known(self, which: int) -> float | None:
        """Return a coefficient of the rule if it is known now."""
        return self.jet.program.numbers[self.chunk.coefficients[which][self.lane]]

    def constant(self, which: int) -> Real:
        """Return a coefficient of the rule."""
        return self.jet.constants[self.chunk.coefficients[which][self.lane]]
