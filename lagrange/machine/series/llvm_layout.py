"""Where the state and the coefficients of a Taylor step stand in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.machine.series.packing import Operand, Packing
from lagrange.procedure.linear.inverse import padded, work_size
from lagrange.program.series import SeriesProgram


@dataclass(frozen=True)
class TaylorLayout:
    """Where things stand in the work memory: the state, what its rounding lost, what is held, and the rows.

    `dimension` is 2n. `width` doubles lie between two rows; a row begins with q and v, and its coefficients of what
    is watched begin at `watched_at`. With an order of 0 the code serves every order. `scratch` doubles follow the rows.
    """

    dimension: int
    order: int
    width: int
    watched: int
    watched_at: int
    scratch: int = 0

    @property
    def lanes(self) -> int:
        """How many entries of the state are handled at once."""
        return 2 if self.dimension <= 2 else 4 if self.dimension <= 4 else 8

    @property
    def padded(self) -> int:
        """The length of the state in whole vectors."""
        return -(-self.dimension // self.lanes) * self.lanes

    @property
    def rows(self) -> int:
        """Where the rows begin."""
        return 5 * self.padded

    @property
    def held(self) -> int:
        """Where what is held of a step begins: the state before it, what rounding lost of that, and a derivative."""
        return 2 * self.padded

    def coefficients(self, work: FloatArray, order: int) -> FloatArray:
        """Return the rows that begin at the start of an array, (order + 1, 2n + watched)."""
        rows = work[: (order + 1) * self.width].reshape(order + 1, self.width)
        watched = slice(self.watched_at, self.watched_at + self.watched)
        return np.concatenate([rows[:, : self.dimension], rows[:, watched]], axis=1)

    def size(self, order: int) -> int:
        """Return the length of the work memory: a state and its rows twice, for a look ahead overwrites them."""
        return 2 * (self.rows + (order + 1) * self.width + self.scratch) + 8


class Slots:
    """Where operands stand in a row, behind q, v and what is watched."""

    def __init__(self, packing: Packing, begin: int) -> None:
        self.places: dict[Operand, int] = {}
        self.size = begin
        for operand in (*packing.summed, *packing.delayed, *packing.initial, *packing.rates):
            if operand not in self.places:
                width = len(operand.values)
                self.size = -(-self.size // width) * width
                self.places[operand] = self.size
                self.size += width
        self.size = -(-self.size // 8) * 8


def scratch_size(program: SeriesProgram) -> int:
    """Return how many doubles the inverse of the mass matrix takes behind the rows, on the way to it too."""
    sizes = (stage.plan.size for stage in program.stages if stage.plan.inverted)
    return sum(padded(n) ** 2 + n * n + work_size(n) for n in sizes)


def unrolled_layout(program: SeriesProgram, order: int) -> TaylorLayout:
    """Return where things stand for a jet that is written out."""
    dimension, watched = 2 * program.dimension, len(program.watched)
    padded = TaylorLayout(dimension, order, 0, watched, 0).padded
    return TaylorLayout(dimension, order, padded + watched, watched, padded)


def looped_layout(program: SeriesProgram, width: int) -> TaylorLayout:
    """Return where things stand for a jet in loops, with rows of that width or of q, v and what is watched."""
    dimension, watched = 2 * program.dimension, len(program.watched)
    padded = TaylorLayout(dimension, 0, 0, watched, 0).padded
    return TaylorLayout(dimension, 0, width or padded + watched, watched, padded, scratch_size(program))
