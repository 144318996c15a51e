"""Where the values of a series stand in memory at one order, like values side by side."""

from __future__ import annotations

from collections.abc import Iterator

from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.series.packing import ZERO_LANE, Chunk, Operand, Packing

ALIGNED = 8
"""Vectors begin at multiples of so many reals in the work array, where they are read quickest."""


NOWHERE = -1
"""In the place of a home that is not known yet."""


class Image:
    """The places of values at an order: the state, operands that later orders read, and behind `width` all others.

    Later orders read the first `width` numbers only, which are a row. Rows begin at `first` in an aligned array. A
    chunk whose values stand in their order somewhere is read there; others are `gathered`, one value after the other.
    """

    def __init__(self, packing: Packing, first: int) -> None:
        self.packing, self.first = packing, first
        n = packing.program.dimension
        self.homes: dict[int, int] = {i: i for i in range(2 * n)}
        """Where each value stands."""
        self.repeated: dict[int, int] = {i: i for i in range(2 * n)}
        """Which value stands at each place of a home."""
        self.places: dict[Operand, int] = {}
        self.gathered: dict[Operand, None] = {}
        self.end = 2 * n
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
        """Place the chunks that are computed, those that are among the wanted operands, or all that are left."""
        unknowns = [chunk for chunk in self.packing.unknowns if chunk.values[0] not in self.homes]
        for chunk in (*self.packing.computed, *unknowns):
            if chunk.values[0] not in self.homes and (wanted is None or chunk.whole in wanted):
                begin = self.room(len(chunk.values))
                for lane, value in enumerate(chunk.values):
                    self.homes.setdefault(value, begin + lane)
                    self.repeated[begin + lane] = value
                self.places[chunk.whole] = begin

    def room(self, lanes: int) -> int:
        """Return a place for a vector."""
        begin = whole_blocks(self.end + self.first, min(lanes, ALIGNED)) - self.first
        self.end = begin + lanes
        return begin

    def place(self, operand: Operand) -> None:
        """Place an operand: where its values stand in their order already, or behind all others."""
        if operand in self.places:
            return
        begin = self.homes.get(operand.values[0], NOWHERE)
        if not operand.ranked and next(self.runs(operand)) == (0, begin, len(operand.values)) and begin != NOWHERE:
            self.places[operand] = begin
        else:
            self.places[operand] = self.room(len(operand.values))
            self.gathered[operand] = None

    def runs(self, operand: Operand) -> Iterator[tuple[int, int, int]]:
        """Return the values of an operand that stand side by side: the first lane, its place, and how many.

        A lane that is zero stands nowhere.
        """
        values, lane = operand.values, 0
        while lane < len(values):
            begin, count = self.homes.get(values[lane], NOWHERE), 1
            while begin != NOWHERE and values[lane : lane + count + 1][count:] == (self.repeated.get(begin + count),):
                count += 1
            yield lane, begin, count
            lane += count

    def filled(self) -> dict[int, int]:
        """Return the value at each place that is read at order 0: in the row, and of what rules read there."""
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
    """Return the arguments that a rule reads at its own order, or at order 0."""
    return () if chunk.op == "integral" else chunk.args
