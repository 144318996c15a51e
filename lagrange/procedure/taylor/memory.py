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

from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Record
from lagrange.procedure.values import Memory, Real, Whole

READ = Array(read=True)

JET = Callee((REAL, REAL, READ, READ, READ, Array(), WHOLE), (FLAG,))
"""The function that computes a series.

Its arguments are the time, the scale of time, the state followed by its compensation, two arrays of numbers that the
machine has prepared, the rows and the order. It returns whether a matrix is singular.
"""

TAYLOR = Record.of(
    "Taylor_state", low=REAL, scale=REAL, next_limit=REAL, limit=REAL, rescalings=WHOLE, failures=WHOLE, inspect=WHOLE
)
"""The state of a run by Taylor series, beside `RUN` and `COUNTS`.

    low          the part of the time that rounding lost (compensated summation)
    scale        the unit of time of the series, signed
    next_limit   the bound of the next step only, infinite if there is none
    limit        the bound of all steps, set by rejected steps
    rescalings   how often the series of this step was computed again in another unit of time
    failures     consecutive steps rejected by the defect test
    inspect      1 if the event functions are to be inspected on the next step, whatever their bounds say
"""

HELD = Record.of("Held", unproven=WHOLE, t=REAL, low=REAL, scale=REAL, h=REAL)
"""The beginning of the last step: time, the part of it that rounding lost, scale, and length of the step.

`unproven` is 1 until the step has passed the defect test. The state at the beginning is kept in the work array.
"""


OUTPUTS = Record.of("Outputs", done=WHOLE, ahead=WHOLE)
"""How many output times have their states: on steps that are proven, and on the last step too.

The output times stand in the order of the run, and NaN stands behind the last."""


BLOCK = 8
"""Vectors are computed on at most so many entries at once, and the last block of one may be written as a whole."""

SIZES = Record.of(
    "Sizes", dimension=WHOLE, padded=WHOLE, width=WHOLE, watched=WHOLE, watched_at=WHOLE, scratch=WHOLE, chains=WHOLE
)
"""The sizes of a layout, for procedures that serve every layout; see `TaylorLayout`. `chains` is 1 or 0."""


class Offsets:
    """Where the parts of a work array begin."""

    padded: Any
    width: Any
    scratch: Any

    @property
    def lost(self) -> Any:
        """Offset of the compensation of the state: what rounding lost."""
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
    entries at once. `scratch` doubles follow the rows. With `projected` the state is moved onto the constraints of the
    system behind each step, and with `crossing` the radius of convergence does not bound the step. With `by_rows` a
    series is summed row by row, for compilers that compute at once what an innermost loop does, and nothing else. With
    `observes` what is watched are events without resets: the loop returns where one ends the run.
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
    """The sizes of the layout that a record has, for a procedure that reads them once, behind its parameters."""

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
        """Go through the entries of vectors behind a place in all of them, in blocks."""
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
    """Go through the entries of vectors from a place on, in blocks."""
    with p.each(layout.padded - start, width=layout.block, spill=True, unrolled=layout.chains) as i:
        yield i


def work_array(p: Builder) -> Memory:
    """Return the work array, as a parameter."""
    return p.array("work", room=BLOCK)


def weights_array(p: Builder, layout: TaylorLayout, *, read: bool = True) -> Memory:
    """Return one over the tolerance of each entry of the state, as a parameter."""
    return p.array("weights", size=layout.padded, room=layout.block, read=read)


def floors_array(p: Builder, layout: TaylorLayout, *, read: bool = True) -> Memory:
    """Return how wrong each entry of the state may be beside its share of the relative tolerance, as a parameter."""
    return p.array("floors", size=layout.dimension, room=layout.block, read=read)
