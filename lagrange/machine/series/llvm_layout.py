"""Where the state and the coefficients of a Taylor step stand in memory, for series in machine code."""

from __future__ import annotations

from lagrange.machine.series.llvm_factored import factored_size
from lagrange.machine.state import MOST_LANES
from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.linear.inverse import padded, work_size
from lagrange.procedure.series.packing import Operand, Packing
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.program.elimination import is_factored
from lagrange.program.series import SeriesProgram


class Slots:
    """Where operands stand in a row, behind q, v and what is watched."""

    def __init__(self, packing: Packing, begin: int) -> None:
        self.places: dict[Operand, int] = {}
        self.size = begin
        for operand in (*packing.summed, *packing.delayed, *packing.initial, *packing.rates):
            if operand not in self.places:
                width = len(operand.values)
                self.size = whole_blocks(self.size, width)
                self.places[operand] = self.size
                self.size += width
        self.size = whole_blocks(self.size, MOST_LANES)


def scratch_size(program: SeriesProgram) -> int:
    """Return how many doubles inverses, or factors, take behind the rows, and what is needed on the way to them."""
    plans = [stage.plan for stage in program.stages if stage.plan.inverted]
    inverted = (plan.size for plan in plans if not is_factored(plan))
    factored = sum(factored_size(plan) for plan in plans if is_factored(plan))
    return factored + sum(padded(n) ** 2 + n * n + work_size(n) for n in inverted)


def unrolled_layout(program: SeriesProgram) -> TaylorLayout:
    """Return where things stand for a jet that is written out, for all orders."""
    return _layout(program, 0, 0, chains=True)


def looped_layout(program: SeriesProgram, width: int) -> TaylorLayout:
    """Return where things stand for a jet in loops, with rows of that width or of q, v and what is watched."""
    return _layout(program, width, scratch_size(program), chains=False)


def _layout(program: SeriesProgram, width: int, scratch: int, *, chains: bool) -> TaylorLayout:
    dimension, watched = 2 * program.dimension, len(program.watched)
    block = 2 if dimension <= 2 else 4 if dimension <= 4 else 8
    end = whole_blocks(dimension, block)
    projected = program.projection is not None
    crossing = program.may_cross
    return TaylorLayout(dimension, width or end + watched, watched, end, block, scratch, chains, projected, crossing)
