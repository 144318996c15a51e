"""Builder of the procedure that computes the series of members in lanes, in a loop over orders.

A value is a vector with one entry for each member, so that the coefficients of a large system do not fit the first
cache. Each sum over lower orders is computed where it is first read, together with sums of the same factors.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.algorithm.series.jets import ByOrderJet, by_order_scratch, read_later
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Chunk, Packing, depth_first
from lagrange.algorithm.series.rules import OrderSums, SumsAtUse
from lagrange.algorithm.taylor.memory import TaylorLayout

MEMBER_TILE = 8
"""Number of sums that are computed together: enough to hide the latency of multiply-adds, and few enough for 16
registers. The outer solar system takes 1.06 times as long with 12, and 1.2 times with 16 (four members, AMD Zen 3).
"""


class MemberJet(ByOrderJet):
    """Builder of the procedure that computes the series of members up to the order `highest`.

    The packing has vectors of one value. The operands that later orders read are in local memory, and the caller's
    rows have the state and the event functions only. Members that take no part in a call keep their rows; local
    memory is written without a mask.
    """

    def __init__(self, packing: Packing, numbers: SeriesNumbers, highest: int) -> None:
        program, ways = packing.program, {"by_rows": True, "observes": len(packing.program.watched) > 0}
        layout = TaylorLayout.of(program, scratch=by_order_scratch(packing), **ways)
        super().__init__(packing, numbers, layout, tile=MEMBER_TILE)
        self.highest = highest
        self.places = {operand: index for index, operand in enumerate(dict.fromkeys(read_later(packing)))}

    def order_sums(self) -> OrderSums:
        """Reserve memory for the operands that later orders read. Return the builder of the code for the sums."""
        self.stored_width = len(self.places)
        self.stored = self.p.reserve((self.highest + 1) * self.stored_width, name="stored")
        packing = self.packing
        pairs = [pair for part in packing.parts for chunk in depth_first(packing, part) for pair in chunk.sums]
        return SumsAtUse(self.p, pairs, self.places, self.stored, self.stored_width, self.tile)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        super().fill(depth_first(self.packing, chunks))
