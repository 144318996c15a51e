"""Taylor coefficients of several ensemble members at once: builder of the procedure, with a loop over orders.

A value is a vector with one entry for each member, so that the coefficients of a large system do not fit into the
processor's first cache. Each sum over lower orders is computed where a rule first reads it, together with sums of the
same factors.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.algorithm.series.jets import ByOrderJet, run_layout
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import Chunk, Packing, depth_first
from lagrange.algorithm.series.rules import OrderSums, StoredOperands, SumsAtUse, read_later

MEMBER_TILE = 8
"""Number of sums that one loop computes: enough to hide the latency of multiply-adds, and few enough for 16 registers.
The outer solar system takes 1.06 times as long with 12 sums, and 1.2 times with 16 (four members, AMD Zen 3).
"""


class MemberJet(ByOrderJet):
    """Builder of the procedure that computes the series of ensemble members up to the order `highest`.

    The packing has vectors of one value. The operands that later orders read are in local memory, and the caller's
    rows have the state and the event functions only. A call may leave out some members: it must not change their
    rows, but writes their local memory without a mask.
    """

    def __init__(self, packing: Packing, numbers: SeriesNumbers, highest: int) -> None:
        super().__init__(packing, numbers, run_layout(packing), tile=MEMBER_TILE)
        self.highest = highest

    def storage(self) -> StoredOperands:
        """Return new local memory for the operands that later orders read, up to the order `highest`."""
        places = {operand: index for index, operand in enumerate(dict.fromkeys(read_later(self.packing)))}
        memory = self.p.reserve((self.highest + 1) * len(places), name="stored")
        return StoredOperands(memory, len(places), places)

    def order_sums(self) -> OrderSums:
        """Return the builder of the code for the sums over lower orders, each added where a rule first reads it."""
        packing = self.packing
        pairs = [pair for part in packing.parts for chunk in depth_first(packing, part) for pair in chunk.sums]
        return SumsAtUse(self.p, pairs, self.stored, self.tile)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        super().fill(depth_first(self.packing, chunks))
