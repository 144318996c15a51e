"""Memory layout of a Taylor step: the state, its compensation, and the rows of the series.

A machine that computes on blocks of numbers pads each vector to whole blocks; on other machines a block has one number.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.blocks import whole_blocks
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Record
from lagrange.procedure.values import Memory, Real, Whole
from lagrange.program.series import SeriesProgram

READ = Array(read=True)

JET = Callee((REAL, REAL, READ, READ, READ, Array(), WHOLE), (FLAG,))
"""The function that computes a series.

Its arguments are the time, the scale of time, the state followed by its compensation, two arrays of numbers that the
machine has prepared, the rows and the order. It returns whether a matrix is singular.
"""

TAYLOR = Record.of(
    "Taylor_state", low=REAL, scale=REAL, next_limit=REAL, limit=REAL, rescalings=WHOLE, failures=WHOLE, inspect=WHOLE
)
"""The state of a run by Taylor series, in addition to `RUN` and `COUNTS`.

    low          rounding error of the time (compensated summation)
    scale        the unit of time of the series, signed
    next_limit   bound of the next step, or infinity
    limit        bound of all steps, set by rejected steps
    rescalings   number of times that the series of this step was repeated in another unit of time
    failures     consecutive steps rejected by the defect test
    inspect      1 if the event functions must be inspected on the next step, whatever their bounds
"""

HELD = Record.of("Held", unproven=WHOLE, t=REAL, low=REAL, scale=REAL, h=REAL)
"""The beginning of the last step: its time, rounding error of the time, scale, and length of the step.

`unproven` is 1 until the step has passed the defect test. The state at the beginning is kept in the work array.
"""


OUTPUTS = Record.of("Outputs", done=WHOLE, ahead=WHOLE)
"""Number of output times with states: `done` on proven steps, and `ahead` including the last step.

The output times are sorted in the direction of the run, and end with NaN."""


BLOCK = 8
"""Largest number of entries that are computed at once; the last block of a vector may be written as a whole."""

SIZES = Record.of(
    "Sizes", dimension=WHOLE, padded=WHOLE, width=WHOLE, watched=WHOLE, watched_at=WHOLE, scratch=WHOLE, chains=WHOLE
)
"""The sizes of a layout, for procedures that work for every layout; see `TaylorLayout`. `chains` is 1 or 0."""


class Offsets:
    """Offsets of the parts of a work array."""

    padded: Any
    width: Any
    scratch: Any

    @property
    def lost(self) -> Any:
        """Offset of the compensation of the state: its rounding error."""
        return self.padded

    @property
    def held(self) -> Any:
        """Offset of the beginning of the step: the state there, its compensation, and a derivative."""
        return self.padded * 2

    @property
    def slope(self) -> Any:
        """Offset of the derivative of the series at the end of its step."""
        return self.padded * 4

    @property
    def rows(self) -> Any:
        """Offset of the rows."""
        return self.padded * 5

    def ahead(self, order: Any) -> Any:
        """Return the offset of a second state and its rows, for evaluations along a step."""
        return (order + 1) * self.width + (self.rows + self.scratch)


@dataclass(frozen=True)
class TaylorLayout(Offsets):
    """Offsets in the work array: the state, its compensation, the beginning of the step, and the rows.

    `dimension` is 2n. Rows are `width` doubles apart. A row begins with q and v; its coefficients of the event
    functions begin at `watched_at`. With an order of 0 the code serves every order. Vectors are computed on `block`
    entries at once. `scratch` doubles follow the rows. With `projected` the state is moved onto the constraints after
    each step. With `crossing` the radius of convergence does not bound the step. With `by_rows` a series is summed row
    by row, for compilers that vectorize only innermost loops. With `observes` all watched functions are events without
    resets: the loop returns when one ends the run.
    """

    dimension: int
    width: int
    watched: int
    watched_at: int
    block: int
    scratch: int = 0
    chains: bool = False
    projected: bool = False
    crossing: bool = False
    by_rows: bool = False
    observes: bool = False

    @classmethod
    def of(cls, program: SeriesProgram, width: int = 0, *, block: int = 1, **parts: Any) -> TaylorLayout:
        """Return the layout of the series of a program; without `width` a row has the state and the watched values.

        `parts` are other fields, such as `scratch`.
        """
        dimension, watched = program.states, len(program.watched)
        end = whole_blocks(dimension, block)
        ways = {"projected": program.projection is not None, "crossing": program.may_cross}
        return cls(dimension, width or end + watched, watched, end, block, **ways, **parts)

    @cached_property
    def padded(self) -> int:
        """The length of the state in whole blocks."""
        return whole_blocks(self.dimension, self.block)

    @property
    def moving(self) -> int:
        """The first entry of the first block that contains velocities."""
        return self.dimension // 2 // self.block * self.block

    def coefficients(self, work: NDArray[np.float64], order: int) -> NDArray[np.float64]:
        """Return the rows that begin at the start of an array, (order + 1, 2n + watched)."""
        rows = work[: (order + 1) * self.width].reshape(order + 1, self.width)
        watched = slice(self.watched_at, self.watched_at + self.watched)
        return np.concatenate([rows[:, : self.dimension], rows[:, watched]], axis=1)

    def size(self, order: int) -> int:
        """Return the length of the work array: a state and its rows twice."""
        return 2 * int(self.ahead(order)) + 8

    @cached_property
    def sizes(self) -> Any:
        """The sizes as a record, which is only read."""
        return SIZES.structure(**{name: int(getattr(self, name)) for name in SIZES.places})


class RecordedLayout(Offsets):
    """The sizes of a layout, from a record. A procedure reads them once, after its parameters."""

    dimension: Any
    watched: Any
    watched_at: Any
    chains: Any

    def __init__(self, record: Any) -> None:
        self._record = record

    def read(self) -> None:
        """Read the sizes."""
        for name in SIZES.places:
            setattr(self, name, getattr(self._record, name).called(name))


class SeriesMemory:
    """The work array of a procedure, and the order of its series, which is the last argument and at least 4."""

    def __init__(self, p: Builder, layout: Any, work: Memory) -> None:
        self.p, self.layout, self.work = p, layout, work
        self.order: Whole = p.given("order", WHOLE)

    @property
    def handed(self) -> tuple[Any, ...]:
        """The last arguments for another procedure: the work array and the order."""
        return self.work, self.order

    def less(self, count: int) -> Whole:
        """Return the order minus a number, at least 1."""
        k: Whole = self.order - count
        return self.p.larger(k, 1) if count > 1 else k

    def minus_one_over(self, k: Whole) -> Real:
        """Return -1 over an order."""
        return -1.0 / self.p.real(k)

    def row(self, k: Any) -> Memory:
        """Return the coefficients of an order."""
        return self.work.at(k * self.layout.width + self.layout.rows)

    @contextmanager
    def entries(self, start: int = 0) -> Iterator[Whole]:
        """Loop over the entries of vectors from `start` on, in blocks."""
        with entries(self.p, self.layout, start) as i:
            yield i

    def ratio(self, k: Any, weights: Memory) -> Real:
        """Return the largest coefficient of a row relative to its tolerance, NaN if one is not finite."""
        row = self.row(k)
        with self.entries() as i:
            largest = self.p.largest_magnitude(row[i] * weights[i])
        return largest.value


@contextmanager
def entries(p: Builder, layout: TaylorLayout, start: int = 0) -> Iterator[Whole]:
    """Loop over the entries of vectors from `start` on, in blocks."""
    with p.each(layout.padded - start, width=layout.block, spill=True, unrolled=layout.chains) as i:
        yield i


def work_array(p: Builder) -> Memory:
    """Add the work array as a parameter, and return it."""
    return p.array("work", room=BLOCK)


def weights_array(p: Builder, layout: TaylorLayout, *, read: bool = True) -> Memory:
    """Add the weights as a parameter, one over the tolerance of each entry of the state, and return them."""
    return p.array("weights", size=layout.padded, room=layout.block, read=read)


def floors_array(p: Builder, layout: TaylorLayout, *, read: bool = True) -> Memory:
    """Add the floors as a parameter, the least tolerance of each entry of the state, and return them."""
    return p.array("floors", size=layout.dimension, room=layout.block, read=read)
