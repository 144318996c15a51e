"""What the two forms of a series have in common: its start, its constants and its systems.

    jet(t, scale, y, prepared, constants, rows, order) -> whether a matrix is singular

writes the coefficients of q and v, times scale**k, to row k of `rows` for k from 0 to the order; see
`lagrange.procedure.taylor.memory.JET`. Like values stand side by side, in chunks of compile-time length, so that a
compiler turns each chunk into vectors.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE
from lagrange.procedure.series.numbers import SeriesNumbers, Start
from lagrange.procedure.series.packing import Packing
from lagrange.procedure.series.rules import Term
from lagrange.procedure.series.systems import System, moving_system, system_size
from lagrange.procedure.taylor.memory import BLOCK, TaylorLayout
from lagrange.procedure.values import Flag, Memory, Real, Whole
from lagrange.program.elimination import WRITTEN_OUT
from lagrange.program.series import SeriesProgram


class Jet:
    """A series under construction at one order after the other. `origin` has the values of order 0 by number.

    Inverses of mass matrices are written out up to a largest size.
    """

    def __init__(
        self, packing: Packing, numbers: SeriesNumbers, layout: TaylorLayout, largest: int = WRITTEN_OUT
    ) -> None:
        self.packing, self.numbers, self.layout, self.largest = packing, numbers, layout, largest
        self.program: SeriesProgram = packing.program
        self.p = p = Builder(
            "taylor_jet", "Write the coefficients of the series, and say whether a matrix is singular."
        )
        self.t, self.scale = p.given("t", REAL), p.given("scale", REAL)
        self.y, self.prepared = p.array("y", read=True), p.array("prepared", read=True)
        p.array("constants", read=True)
        self.rows = p.array("rows", room=BLOCK)
        self.order: Whole = p.given("order", WHOLE)
        self.constants: list[Real] = []
        self.origin: dict[int, Any] = {}
        self.systems: list[System] = []
        self.singular: Flag = p.false

    def begin(self) -> None:
        """Build order 0, the constants and the matrices."""
        program, p = self.program, self.p
        self.constants = [self.numbers.constant(self.prepared, place) for place in range(len(program.numbers))]
        start = Start(p, self.numbers, self.prepared, self.constants, self.t, self.y)
        start.run(range(program.start.hoisted, len(program.start.instructions)))
        values = [start.value(ref) for ref in program.start.outputs]
        self.origin = dict(zip(program.started, values, strict=False))
        for i in range(2 * program.dimension):
            self.origin.setdefault(i, self.y[i])
        triangles, memory, flags = iter(values[len(program.started) :]), self.matrices(), [p.false]
        for stage, known in zip(program.stages, self.numbers.systems(p, self.prepared), strict=True):
            if known is None:
                known, found = moving_system(p, stage.plan, triangles, memory, self.largest)
                memory = memory.at(size) if (size := system_size(stage.plan, self.largest)) else memory
                flags += found
            self.systems.append(known)
        self.singular = reduce(lambda a, b: a | b, flags)

    def matrices(self) -> Memory:
        """Return memory for matrices, behind the rows."""
        return self.rows.at((self.order + 1) * self.layout.width)


def divided(jet: Jet, x: Term, high: Real, low: Real | None) -> Term:
    """Return x (high + low), rounded once.

    The rounded reciprocal of an order has an error of the same sign at every step, so errors would grow with time.
    """
    if x is None:
        return None
    return x * high if low is None else jet.p.fma(x, high, x * low)
