"""Memory layout of a series' values at one order, with like values adjacent; and sources of coefficients for a lane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, Packing
from lagrange.algorithm.series.rules import OWN, Term
from lagrange.procedure.builder import Builder
from lagrange.procedure.values import Memory, Real, Whole
from lagrange.program.series import SeriesProgram

ALIGNED = 8
"""Alignment of vectors in the work array, in doubles, for the fastest reads."""


NOWHERE = -1
"""Index of a value whose index is not chosen yet."""


class Image:
    """Memory layout of the values of one order: the state, operands that later orders read, then all others.

    Later orders read only the first `width` numbers, which are stored as a row. Rows begin at `first` in an aligned
    array. An operand whose values are adjacent and in order is read where they are. Other operands are `gathered`
    value by value.
    """

    def __init__(self, packing: Packing, first: int) -> None:
        self.packing, self.first = packing, first
        states = range(packing.program.states)
        self.homes: dict[int, int] = {i: i for i in states}
        """Index in memory of each value."""
        self.repeated: dict[int, int] = {i: i for i in states}
        """The value at each index of a home."""
        self.places: dict[Operand, int] = {}
        self.gathered: dict[Operand, None] = {}
        self.end = len(states)
        self.place_homes(dict.fromkeys((*packing.summed, *packing.delayed)))
        kept = dict.fromkeys((*packing.summed, *packing.delayed, *packing.rates))
        for operand in kept:
            self.place(operand)
        self.width = whole_blocks(self.end, ALIGNED)
        self.end = self.width
        self.place_homes(None)
        for operand in dict.fromkeys((*kept, *read(packing))):
            self.place(operand)
        self.size = whole_blocks(self.end, ALIGNED)

    def place_homes(self, wanted: dict[Operand, None] | None) -> None:
        """Choose indices for the computed chunks that have none, and are in `wanted` as operands (or all, if None)."""
        unknowns = [chunk for chunk in self.packing.unknowns if chunk.values[0] not in self.homes]
        for chunk in (*self.packing.computed, *unknowns):
            if chunk.values[0] not in self.homes and (wanted is None or chunk.whole in wanted):
                begin = self.room(len(chunk.values))
                for lane, value in enumerate(chunk.values):
                    self.homes.setdefault(value, begin + lane)
                    self.repeated[begin + lane] = value
                self.places[chunk.whole] = begin

    def room(self, lanes: int) -> int:
        """Reserve the indices of a vector of `lanes` values, and return the first one."""
        begin = whole_blocks(self.end + self.first, min(lanes, ALIGNED)) - self.first
        self.end = begin + lanes
        return begin

    def place(self, operand: Operand) -> None:
        """Choose the index of an operand: where its values are adjacent and in order already, or a new index."""
        if operand in self.places:
            return
        begin = self.homes.get(operand.values[0], NOWHERE)
        if not operand.ranked and next(self.runs(operand)) == (0, begin, len(operand.values)) and begin != NOWHERE:
            self.places[operand] = begin
        else:
            self.places[operand] = self.room(len(operand.values))
            self.gathered[operand] = None

    def runs(self, operand: Operand) -> Iterator[tuple[int, int, int]]:
        """Yield the runs of adjacent values in an operand, as (first lane, index of its value, length).

        A lane that is zero is in no run.
        """
        values, lane = operand.values, 0
        while lane < len(values):
            begin, count = self.homes.get(values[lane], NOWHERE), 1
            while begin != NOWHERE and values[lane : lane + count + 1][count:] == (self.repeated.get(begin + count),):
                count += 1
            yield lane, begin, count
            lane += count

    def filled(self) -> dict[int, int]:
        """Return the number of the value at each index that is read at order 0, in the row or by a rule."""
        found = {place: value for place, value in self.repeated.items() if place < self.width}
        initial = dict.fromkeys(self.packing.initial)
        for operand, begin in self.places.items():
            if not operand.ranked and (begin < self.width or operand in initial):
                places = enumerate(operand.values, begin)
                found |= {place: value for place, value in places if value != ZERO_LANE}
        return found


def read(packing: Packing) -> Iterator[Operand]:
    """Return every operand that a rule or a solve reads at its own order, or at order 0."""
    for chunk in packing.computed:
        yield from arguments(chunk)
        if chunk.sums:
            yield chunk.whole
    for stage in packing.stages:
        yield from (operand for operand in stage.left if operand is not None)


def arguments(chunk: Chunk) -> tuple[Operand, ...]:
    """Return the arguments that the rule of a chunk reads at its own order, or at order 0."""
    return () if chunk.op == "integral" else chunk.args


class Orders(Protocol):
    """What lanes read of the builder of a series in a loop over orders: its arrays, constants and order k."""

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
        """Return the part of a named array from index `place` on."""

    def array_of(self, place: int) -> Memory:
        """Return the array that contains the present order's value with index `place`."""

    def common(self, places: Sequence[int]) -> float | None:
        """Return the number that all constants with the indices `places` equal, if known at compile time; else None."""

    def share(self, x: Term) -> Term:
        """Return scale * x / k, where k is the order, and `scale` the unit of time."""

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""


class ChunkLane:
    """Source of the coefficients of one lane of a chunk, for its rule. `which` is defined in `At`."""

    def __init__(self, jet: Orders, chunk: Chunk, i: Whole) -> None:
        self.jet, self.chunk, self.p, self.i = jet, chunk, jet.p, i

    def operand(self, which: int) -> Operand:
        """Return the operand that is argument `which`, or the chunk itself for OWN."""
        return self.chunk.whole if which == OWN else self.chunk.args[which]

    def read(self, array: str, place: int) -> Real:
        """Return this lane's number from the named array, at index `place`."""
        found: Real = self.jet.part_of(array, place)[self.i]
        return found

    def now(self, which: int) -> Term:
        """Return argument `which` at the present order."""
        return self.read("now", self.jet.image.places[self.operand(which)])

    def before(self, which: int) -> Term:
        """Return argument `which` at the previous order."""
        return self.read("previous", self.jet.image.places[self.operand(which)])

    def first(self, which: int) -> Real:
        """Return argument `which` at order 0, or the value itself for OWN."""
        return self.read("first", self.jet.image.places[self.operand(which)])

    def total(self, which: int) -> Term:
        """Return sum number `which` over 0 < j < k."""
        return self.read("totals", self.jet.sums[self.chunk, which])

    def over(self, which: int) -> Real:
        """Return the reciprocal at order 0 of argument `which`, or of the value itself for OWN."""
        return self.read("reciprocals", self.jet.divisors[self.operand(which)])

    def known(self, which: int) -> float | None:
        """Return coefficient `which` of the rule if it is known at compile time, else None."""
        return self.jet.common(self.chunk.coefficients[which])

    def constant(self, which: int) -> Real:
        """Return coefficient `which` of the chunk's rule, in this lane."""
        known = self.known(which)
        if known is not None:
            return self.p.real(known)
        return self.read("constants", self.jet.vectors[self.chunk.coefficients[which]])

    def share(self, x: Term) -> Term:
        """Return scale * x / k, where k is the order, and `scale` the unit of time."""
        return self.jet.share(x)

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""
        return self.jet.part(x)

    def start(self) -> Term:
        """Return the coefficient of time itself: the scale at k = 1, else 0."""
        return self.jet.time


class ScatteredLane(ChunkLane):
    """Source of the coefficients of one lane of a linear combination whose terms are not adjacent in memory."""

    def __init__(self, jet: Orders, chunk: Chunk, lane: int) -> None:
        super().__init__(jet, chunk, jet.k)
        self.lane = lane

    def now(self, which: int) -> Term:
        """Return argument `which` at the present order."""
        home = self.jet.image.homes[self.chunk.args[which].values[self.lane]]
        return self.jet.array_of(home)[home]

    def known(self, which: int) -> float | None:
        """Return coefficient `which` of the rule if it is known at compile time, else None."""
        return self.jet.program.numbers[self.chunk.coefficients[which][self.lane]]

    def constant(self, which: int) -> Real:
        """Return coefficient `which` of the chunk's rule, in this lane."""
        return self.jet.constants[self.chunk.coefficients[which][self.lane]]
