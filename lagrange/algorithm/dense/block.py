"""Dense output: states at any times along a run, computed from polynomials of its steps, several steps at once.

A block has `columns` steps, one in each column. Its vectors are stored by columns: entry j of step b is at index j *
columns + b. So one operation on an entry serves many steps at once. Machine code has blocks of `WIDEST_VECTOR` steps;
the last block may repeat a step. The numpy machine has one column for each step. The polynomial of a step is computed
once for all output times on the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.procedure.form import READ, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.decorators import Bundle, Plain, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesIn,
    each,
    fma,
    magnitude,
    quotient,
    reals,
    unlikely,
    unrolled,
    wholes,
)

COLUMNS = Callee((WHOLE, READ, READ, READ, READ, Array()), (WHOLE,))
"""Type of a compiled right-hand side that is evaluated at several states, one in each column. Arguments: the number of
columns; their times, coordinates and velocities; the parameters; the results. It returns the first column with a
singular matrix, or -1.
"""

INVERT = Callee((WHOLE, WHOLE, Array(), Array()), ())
"""Type of `invert_columns`, which inverts one matrix for each column of a block of steps. Arguments: the size of the
matrices, the number of columns, the matrices with their inverses, and one row of work memory.
"""

POLYNOMIAL = Callee((READ, WHOLE, READ, READ, Array(), Array()), ())
"""Type of a function that writes the polynomials of a block of steps, for any kind of path. Arguments: data that the
machine has prepared for the kind of path, the number of columns, the steps and their neighbours (as in `BlockSteps`),
work memory, and the coefficients. The coefficient of power k and entry j, in the fraction of step b, has the index (k *
2n + j) * columns + b.
"""


@lru_cache(maxsize=16)
def chebyshev_points(degree: int) -> NDArray[np.float64]:
    """Return the extrema (degree + 1,) of Chebyshev's polynomial of a degree on [0, 1], from 0 to 1."""
    return np.asarray(np.sin(np.pi * np.arange(degree + 1) / (2 * degree)) ** 2)


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
"""Size of the first part of the work memory. If a mass matrix is singular, `slopes` evaluates single columns there."""


def block_size(dimension: int, columns: int) -> int:
    """Return the length of `BlockSteps.memory`, in doubles, for `columns` steps with states of a `dimension`.

    The memory has for each step its start time, its length, `BlockSteps.side`, and the states at both ends.
    """
    return (2 * dimension + 3) * columns


@dataclass(frozen=True)
class BlockSteps:
    """Steps of a block, by columns: start times t, lengths h, states y at the starts and `new` at the ends.

    `side` is the position of a neighbouring step: -1.0 before, 1.0 after, 0.0 for no neighbour. All arrays are
    parts of `memory`. `dimension` is the length of a state.
    """

    memory: Any
    dimension: Any
    t: Any
    h: Any
    side: Any
    y: Any
    new: Any


@inline
def steps_in(memory: Any, dimension: int, columns: int) -> BlockSteps:
    """Return the steps of a block whose data begin at `memory`: `columns` steps with states of a `dimension`."""
    parts = memory, memory[columns:], memory[2 * columns :], memory[3 * columns :], memory[(dimension + 3) * columns :]
    return BlockSteps(memory, dimension, *parts)


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

    The first arguments are the same for all steps of a run: `law`, the right-hand side at one state in each column,
    with its `parameters`; `jacobian`, its derivative, with `constants`; `invert`, which inverts a matrix for each
    column; the coefficients of the method in `table`, its number of `stages`, the `degree`, and the length of a state.
    `step_data` and `neighbours` have the data of the steps and of their neighbours, each by `columns` in the layout of
    `BlockSteps`. `work` is work memory. The coefficient of power k and entry j for step b is written to `out` at index
    (k * dimension + j) * columns + b.
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
    step_data: In
    neighbours: In
    work: Out
    out: Out

    @property
    def total(self) -> int:
        """Number of doubles in one vector of the block: `dimension` times `columns`."""
        return self.dimension * self.columns

    @inline
    def with_step(self, step: In, work: Out, out: Out) -> PolynomialBlock:
        """Return a copy of this block with other steps, work memory and output, and without neighbours.

        `step` has the data of the steps, as in `BlockSteps`. The copy is for procedures that do not read the
        neighbours. Its `neighbours` is therefore `step`, too.
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
        """Loop over the indices of the columns, one for each step of the block."""
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

        The derivatives are NaN in columns with a singular mass matrix.
        """
        slopes(self.law, self.parameters, self.dimension, self.columns, t, y, self.work, out)


READ_BLOCKS, BLOCKS = Array(read=True, room=WIDEST_VECTOR), Array(room=WIDEST_VECTOR)
"""Types of arrays that are accessed in whole vectors, also beyond their ends. Procedures only read the first, and may
write the second.
"""


def block_type() -> Bundle:
    """Return the type of a procedure's parameter of class `PolynomialBlock`: its arrays and callbacks."""
    functions = {"law": COLUMNS, "jacobian": COLUMNS, "invert": INVERT}
    memory = {"step_data": READ_BLOCKS, "neighbours": READ_BLOCKS, "work": BLOCKS, "out": BLOCKS}
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
        step = steps_in(block.step_data, block.dimension, block.columns)
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


CHUNK = 256
"""Largest number of output times on a step at which its polynomial is evaluated by one call."""


@procedure(theta=lambda: READ_BLOCKS, out=lambda: BLOCKS)
def horner(
    degree: int, dimension: int, row: int, column: int, c: In, theta: In, count: int, out: Out, stride: int
) -> None:
    """Write the values of a polynomial with vector values at `count` fractions `theta` of a step to `out`.

    The coefficient of power k and entry j is at index k * row + j * column of c. Entry j at fraction i is written
    to index j * stride + i of `out`. Two entries are computed at a time, so `dimension` is even.
    """
    for j in range(0, dimension, 2):
        sources = tuple(c[(j + i) * column :] for i in unrolled(2))
        first, second = out[j * stride :], out[(j + 1) * stride :]
        for i in each(count, width=WIDEST_VECTOR, disjoint=True):
            values = tuple(source[degree * row] for source in sources)
            for k in range(degree):
                index = (degree - 1 - k) * row
                pairs = zip(values, sources, strict=True)
                values = tuple(fma(value, theta[i], source[index]) for value, source in pairs)
            first[i], second[i] = values


@procedure
def gather(
    dimension: int,
    columns: int,
    starts: WholesIn,
    steps: int,
    times: In,
    states: In,
    with_neighbours: int,
    step_data: Out,
    neighbours: Out,
) -> None:
    """Copy the times and states of `columns` steps of a run to `step_data`, in the layout of `BlockSteps`.

    `starts` has the indices of these steps. `times` and `states` are those of the whole run, which has `steps`
    steps. If `with_neighbours` is 1, a neighbour of each step is copied to `neighbours`. The neighbour is the
    previous step, or the next one for the first step.
    """
    for b in range(columns):
        s = starts[b]
        gather_one(dimension, columns, b, s, times, states, step_data)
        if with_neighbours == 1:
            is_first = s == 0
            gather_one(dimension, columns, b, min(s + 1, steps - 1) if is_first else s - 1, times, states, neighbours)
            side = 0.0 if steps == 1 else 1.0 if is_first else -1.0
            steps_in(neighbours, dimension, columns).side[b] = side


@procedure
def gather_one(dimension: int, columns: int, b: int, s: int, times: In, states: In, block: Out) -> None:
    """Copy start time, length and both states of step number s of a run to column b of `block`.

    `block` is memory in the layout of `BlockSteps`. `times` and `states` are those of the run.
    """
    step = steps_in(block, dimension, columns)
    step.t[b] = times[s]
    step.h[b] = times[s + 1] - times[s]
    step.side[b] = 0.0
    y, new = states[s * dimension :], states[(s + 1) * dimension :]
    for j in range(dimension):
        index = j * columns + b
        step.y[index], step.new[index] = y[j], new[j]


@dataclass(frozen=True)
class RunPath:
    """A run whose states between the ends of its steps are computed by dense output.

    The callback `polynomial` writes the polynomials of a block of `columns` steps, of a `degree`. Its first
    argument `given` has the data of the method. If `both` is 1, it also reads the neighbours of the steps. `times`
    and `states` are those at the ends of the `steps` steps of the run. `step_data` is memory for a block of steps,
    `neighbours` for a neighbour of each, and `work` is work memory.
    """

    polynomial: Callable[..., None]
    given: In
    dimension: int
    degree: int
    columns: int
    both: int
    steps: int
    times: In
    states: In
    step_data: Out
    neighbours: Out
    work: Out

    @inline
    def write(self, starts: WholesIn, out: Out) -> None:
        """Write the coefficients of the polynomials of `columns` steps to `out`; `starts` are their indices."""
        steps = self.steps, self.times, self.states
        gather(self.dimension, self.columns, starts, *steps, self.both, self.step_data, self.neighbours)
        self.polynomial(self.given, self.columns, self.step_data, self.neighbours, self.work, out)


def path_type() -> Bundle:
    """Return the type of a procedure's parameter of class `RunPath`: its callback and its arrays."""
    return Bundle(RunPath, {"polynomial": POLYNOMIAL})


@procedure(path=path_type)
def polynomials(path: RunPath, starts: WholesIn, blocks: int, out: Out) -> None:
    """Write the polynomials of `blocks` blocks of steps of the run `path` to `out`, block by block.

    Each polynomial is written as its coefficients. `starts` are the indices of the steps in the run, `columns` of
    them for each block.
    """
    for k in range(blocks):
        path.write(starts[k * path.columns :], out[(path.degree + 1) * path.dimension * path.columns * k :])


@procedure
def locate(times: In, steps: int, step: int, time: float, sign: float) -> int:
    """Return the index of the last step that begins at or before a `time`, but at least `step`.

    `times` has the starts of the `steps` steps. They increase if `sign` is 1.0, and decrease if it is -1.0. The
    search interval begins at `step`, is doubled until it contains the time, and is then bisected.
    """
    low, reach = step, 1
    while has_begun(times, steps, low + reach, time, sign):
        low = low + reach
        reach = reach * 2
    while reach > 1:
        reach = quotient(reach, 2)
        low = low + reach if has_begun(times, steps, low + reach, time, sign) else low
    return low


@inline
def has_begun(times: In, steps: int, step: int, time: float, sign: float) -> bool:
    """Return True if step number `step` exists and begins at or before a `time`, in the direction of the run.

    `times` has the starts of the `steps` steps, and `sign` is the direction, 1.0 or -1.0.
    """
    begin = times[min(step, steps - 1)]
    return (begin - time) * sign <= 0.0 and step < steps


@procedure(path=path_type, out=lambda: BLOCKS)
def outputs(path: RunPath, output_times: In, count: int, sign: float, out: Out, stride: int, c: Out) -> None:
    """Write the states of the run `path` at `count` sorted times `output_times` to `out`.

    Entry j at time i has the index j * stride + i. The polynomial of a step is computed once, in the memory c. At
    the end of a step the accepted state is copied. If two steps end at the same time, as at a reset, the state of
    the later step is copied. `sign` is the direction of the run, 1.0 or -1.0.
    """
    times, columns, dimension = path.times, path.columns, path.dimension
    starts, begins = wholes(WIDEST_VECTOR), wholes(WIDEST_VECTOR + 1)
    index, step = 0, 0
    while index < count:
        used = 0
        while used < columns and index < count:
            step = locate(times, path.steps, step, output_times[index], sign)
            starts[used], begins[used] = step, index
            used += 1
            end = times[step + 1]
            index += 1
            while (output_times[min(index, count - 1)] - end) * sign < 0.0 and index < count:
                index += 1
        begins[used] = index
        for b in range(used, columns):
            starts[b] = starts[used - 1]
        path.write(starts, c)
        for b in range(used):
            first, s = begins[b], starts[b]
            step_ends, target = (times[s:], path.states[s * dimension :]), (output_times[first:], begins[b + 1] - first)
            on_step(path.degree, dimension, columns, c[b:], *step_ends, *target, out[first:], stride)


@procedure(c=lambda: READ_BLOCKS, times=lambda: READ_BLOCKS, states=lambda: READ_BLOCKS, out=lambda: BLOCKS)
def on_step(
    degree: int,
    dimension: int,
    columns: int,
    c: In,
    times: In,
    states: In,
    output_times: In,
    count: int,
    out: Out,
    stride: int,
) -> None:
    """Write the states at `count` sorted times `output_times` on one step to `out`.

    Entry j at time i has the index j * stride + i. c has the coefficients of the step's polynomial. The coefficient
    of power k and entry j is at index (k * dimension + j) * columns. `times` and `states` begin with the start and
    the end of the step. At these two times the state is copied.
    """
    theta = reals(CHUNK, room=WIDEST_VECTOR)
    t, end = times[0], times[1]
    h = end - t
    for begin in range(0, count, CHUNK):
        part = min(count - begin, CHUNK)
        block_times = output_times[begin:]
        # Whole vectors are computed. Numbers after the last must not be denormal, because multiplying these is slow.
        padding = theta[part:]
        for i in each(WIDEST_VECTOR, width=WIDEST_VECTOR, spill=True):
            padding[i] = 0.0
        for i in range(part):
            theta[i] = (block_times[i] - t) / h
        horner(degree, dimension, dimension * columns, columns, c, theta, part, out[begin:], stride)
    lowest, highest = 0, count
    while lowest < highest and output_times[max(highest - 1, 0)] == end:
        highest -= 1
        copy_state(states[dimension:], dimension, out[highest:], stride)
    while lowest < highest and output_times[min(lowest, count - 1)] == t:
        copy_state(states, dimension, out[lowest:], stride)
        lowest += 1


@inline
def copy_state(state: In, dimension: int, out: Out, stride: int) -> None:
    """Write the entries of a state of length `dimension` to `out`, at indices that are multiples of `stride`."""
    for j in range(dimension):
        out[j * stride] = state[j]
