"""Memory in which the polynomials of a block of steps are computed, one step in each column.

A block has `columns` steps, and its vectors are stored by columns: entry j of step b is at index j * columns + b. So
one operation on an entry serves many steps at once. Machine code has blocks of `WIDEST_VECTOR` steps; in the last block
a step may be repeated. The numpy machine has one column for each step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.procedure.form import READ, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.decorators import Bundle, Plain, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, magnitude, quotient, unlikely, unrolled

COLUMNS = Callee((WHOLE, READ, READ, READ, READ, Array()), (WHOLE,))
"""Type of a function that evaluates a law over columns. Arguments: the number of columns; their times, coordinates and
velocities; the parameters; the results. It returns the first column with a singular matrix, or -1.
"""

INVERT = Callee((WHOLE, WHOLE, Array(), Array()), ())
"""Type of a function that inverts the matrix of each column, such as `invert_columns`."""

POLYNOMIAL = Callee((READ, WHOLE, READ, READ, Array(), Array()), ())
"""Type of a function that writes the polynomials of a block of steps, for any kind of path. Arguments: data that the
machine has prepared for the kind of path, the number of columns, the steps and their neighbours (`OwnStep`), work
memory, and the coefficients. The coefficient of power k and entry j, in the fraction of step b, has the index (k * 2n +
j) * columns + b.
"""


class WorkSize(NamedTuple):
    """Size of work memory: numbers of vectors (a state for each column) and rows (a number for each column)."""

    vectors: int
    rows: int


@dataclass(frozen=True, eq=False)
class StepPolynomial:
    """A kind of dense output: the procedure that writes the polynomials of a block of steps, and its data.

    The procedure `write`, with work memory of size `room`, serves all systems and all methods of this kind.
    `table` has the coefficients of the method, and `stages` is its number of stages. The `degree` of the
    polynomials is at most 16. With `derivative` the procedure also gets the derivative of the right-hand side,
    and the neighbours of the steps. `vectors` is the number of additional work vectors. `matrices` is the
    number of work matrices, of 2n vectors each.
    """

    write: Plain[..., None]
    room: WorkSize
    degree: int
    stages: int
    table: NDArray[np.float64]
    vectors: int
    matrices: int = 0
    derivative: bool = False

    @property
    def procedure(self) -> Procedure:
        """The procedure that writes the polynomials. Its arguments are the fields of `PolynomialBlock`."""
        return self.write.form()

    def size(self, dimension: int, columns: int) -> int:
        """Return the length of the work memory, in doubles: `columns` steps, with states of a `dimension`."""
        vectors = SPARE.vectors + self.room.vectors + self.vectors + self.matrices * dimension
        return (vectors * dimension + SPARE.rows + self.room.rows) * columns + WIDEST_VECTOR


SPARE = WorkSize(vectors=2, rows=1)
"""Size of the work memory at the beginning, used for columns with a singular mass matrix."""


def block_size(dimension: int, columns: int) -> int:
    """Return the length of `OwnStep.memory`, in doubles, for `columns` steps with states of a `dimension`.

    The memory has for each step its start time, its length, `OwnStep.side`, and the states at both ends.
    """
    return (2 * dimension + 3) * columns


@dataclass(frozen=True)
class OwnStep:
    """Steps of a block, by columns: start times t, lengths h, states y at the starts and `new` at the ends.

    `side` is the position of a neighbouring step: -1.0 before, 1.0 after, 0.0 if there is none. All are parts
    of `memory`.
    """

    memory: Any
    dimension: Any
    t: Any
    h: Any
    side: Any
    y: Any
    new: Any


@inline
def steps_in(memory: Any, dimension: int, columns: int) -> OwnStep:
    """Return the steps of a block whose data begin at `memory`: `columns` steps with states of a `dimension`."""
    parts = memory, memory[columns:], memory[2 * columns :], memory[3 * columns :], memory[(dimension + 3) * columns :]
    return OwnStep(memory, dimension, *parts)


@procedure(law=lambda: COLUMNS)
def slopes(
    law: Callable[..., int], parameters: In, dimension: int, columns: int, t: In, y: In, spare: Out, out: Out
) -> None:
    """Write the time derivatives of one state in each column to `out`; NaN where the mass matrix is singular.

    The callback `law` is the right-hand side, with its `parameters`. t has the time of each column. Entry j of
    the state in column b is at index j * columns + b of y, and its derivative at the same index of `out`. If
    one matrix is singular, each column is evaluated separately, in the work memory `spare`.
    """
    half = quotient(dimension, 2) * columns
    if unlikely(law(columns, t, y, y[half:], parameters, out) >= 0):
        alone, values, time = spare, spare[dimension * columns :], spare[2 * dimension * columns :]
        for b in range(columns):
            for other in range(columns):
                time[other] = t[b]
                for j in range(dimension):
                    alone[j * columns + other] = y[j * columns + b]
            singular = law(columns, time, alone, alone[half:], parameters, values) >= 0
            for j in range(dimension):
                slope = values[j * columns]
                out[j * columns + b] = math.nan if singular else slope


@dataclass(frozen=True)
class PolynomialBlock:
    """Arguments of a procedure that writes polynomials of a block of steps, and the layout of its work memory.

    The first arguments are the same for all steps of a run: `law`, the right-hand side at one state in each
    column, with its `parameters`; `jacobian`, its derivative, with `constants`; `invert`, which inverts a
    matrix for each column; the coefficients of the method in `table`, its number of `stages`, the `degree`, and
    the length of a state. `own` are the steps and `beside` their neighbours, each with the data of `OwnStep` in
    a number of `columns`. `work` is work memory. The coefficient of power k and entry j for step b is written
    to `out` at index (k * dimension + j) * columns + b.
    """

    law: Callable[..., int]
    parameters: In
    jacobian: Callable[..., int]
    constants: In
    invert: Callable[..., None]
    table: In
    stages: int
    degree: int
    dimension: int
    columns: int
    own: In
    beside: In
    work: Out
    out: Out

    @property
    def total(self) -> int:
        """Number of doubles of a vector of the block: entries times columns."""
        return self.dimension * self.columns

    @inline
    def with_step(self, step: In, work: Out, out: Out) -> PolynomialBlock:
        """Return a copy of this block with other steps, work memory and output, and without neighbours.

        `step` has the data of the steps, as in `OwnStep`. The copy is for procedures that do not read `beside`;
        there it is `step` too.
        """
        laws = self.law, self.parameters, self.jacobian, self.constants, self.invert
        numbers = self.table, self.stages, self.degree, self.dimension, self.columns
        return PolynomialBlock(*laws, *numbers, step, step, work, out)

    @inline
    def lay_out(self, room: WorkSize) -> tuple[tuple[Out, ...], tuple[Out, ...], Out]:
        """Divide the work memory into vectors and rows. Return these, and the unused memory after them.

        `room` has the numbers of vectors (a state for each column) and of rows (a number for each column).
        """
        total = self.dimension * self.columns
        first = self.work[total * SPARE.vectors + self.columns * SPARE.rows :]
        vectors = tuple(first[total * k :] for k in unrolled(room.vectors))
        rest = first[total * room.vectors :]
        rows = tuple(rest[self.columns * k :] for k in unrolled(room.rows))
        return vectors, rows, rest[self.columns * room.rows :]

    @inline
    def entries(self) -> Iterator[int]:
        """Loop over the indices of all entries of a vector: a state for each column of the block."""
        yield from each(self.dimension * self.columns, width=WIDEST_VECTOR, spill=True, disjoint=True)

    @inline
    def each_column(self) -> Iterator[int]:
        """Loop over the indices of the columns."""
        yield from each(self.columns, width=WIDEST_VECTOR, spill=True, disjoint=True)

    @inline
    def spread(self, row: In, target: Out) -> None:
        """Copy entry b of `row` to all entries of column b of the vector `target`, for each column b."""
        for j in range(self.dimension):
            line = target[j * self.columns :]
            for b in self.each_column():
                line[b] = row[b]

    @inline
    def slopes(self, t: In, y: In, out: Out) -> None:
        """Write the time derivatives of the states y at times t, by columns, to `out`.

        They are NaN in columns with a singular mass matrix.
        """
        slopes(self.law, self.parameters, self.dimension, self.columns, t, y, self.work, out)


READ_STEPS, WRITTEN = Array(read=True, room=WIDEST_VECTOR), Array(room=WIDEST_VECTOR)


def block_type() -> Bundle:
    """Return the type of a `PolynomialBlock` parameter of a procedure."""
    functions = {"law": COLUMNS, "jacobian": COLUMNS, "invert": INVERT}
    memory = {"own": READ_STEPS, "beside": READ_STEPS, "work": WRITTEN, "out": WRITTEN}
    return Bundle(PolynomialBlock, {**functions, **memory})


@inline
def weighted(start: float, vectors: In, total: int, x: int, weights: In, first: int, count: int) -> float:
    """Return start + sum of weights[j] * (entry x of vector j), for j from `first` to `count` - 1.

    The vectors are adjacent in memory and have `total` doubles each.
    """
    for j in range(first, count):
        start = fma(vectors[j * total :][x], weights[j], start)
    return start


@inline
def mend(block: PolynomialBlock, first: In) -> None:
    """Replace each polynomial in `block.out` that is not finite by a parabola through both ends of its step.

    `first` has its derivatives at the start, with respect to the fraction of the step, by columns. This serves
    the last step of a run that ended because the right-hand side has no value at its end.
    """
    total = block.dimension * block.columns
    largest = 0.0
    for x in each(total, width=WIDEST_VECTOR, spill=True):
        nothing = 0.0
        for power in range(block.degree + 1):
            nothing = fma(block.out[power * total :][x], 0.0, nothing)
        largest = magnitude(largest, nothing)
    if unlikely(largest != 0.0):
        step = steps_in(block.own, block.dimension, block.columns)
        parabola(block.dimension, block.columns, block.degree, step.y, step.new, first, block.out)


@procedure
def parabola(dimension: int, columns: int, degree: int, y: In, new: In, first: In, out: Out) -> None:
    """Replace each polynomial in `out` that has a coefficient that is not finite by a parabola.

    The parabola leads from the state y to the state `new`. `first` is its derivative at the start, with respect
    to the fraction of the step. All arrays have one step in each column. `out` has the coefficients of the
    powers 0 to `degree`, one vector after the other.
    """
    total = dimension * columns
    for b in range(columns):
        nothing = 0.0
        for index in range((degree + 1) * dimension):
            nothing = fma(out[index * columns + b], 0.0, nothing)
        if nothing != 0.0:
            for j in range(dimension):
                index = j * columns + b
                out[index], out[total + index] = y[index], first[index]
                out[total * 2 + index] = new[index] - y[index] - first[index]
                for k in range(3, degree + 1):
                    out[k * total + index] = 0.0
