"""Memory of the polynomials of steps: a block of steps by columns, and laws evaluated over columns.

Steps are taken in blocks of `columns`, and each vector of a block is by columns: entry j of step b stands at
j * columns + b. So an operation on an entry of a step serves many steps at once. Machine code has blocks of `LANES`
steps, of which the last may be repeated. The numpy machine has as many columns as there are steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Array, Callee, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

LANES = 8
"""The steps of a block in machine code: the widest vectors of doubles that processors have."""

READ = Array(read=True)

COLUMNS = Callee((WHOLE, READ, READ, READ, READ, Array()), (WHOLE,))
"""A law over columns: of how many there are, their times, coordinates and velocities, and the parameters, to the
results. It gives the first column in the block in which a matrix is singular, or -1."""

INVERT = Callee((WHOLE, WHOLE, Array(), Array()), ())
"""A function that inverts the matrix of each column; see `invert_columns`."""

POLYNOMIAL = Callee((READ, WHOLE, READ, READ, Array(), Array()), ())
"""A function that writes the polynomials of a block of steps, for any kind of path.

Its arguments: data that the machine has prepared for the kind of path, the number of columns, the steps and their
neighbours (see `OwnStep`), work memory, and the coefficients. The coefficient of power k and entry j, in the fraction
of step b, has the index (k * 2n + j) * columns + b."""


@dataclass(frozen=True, eq=False)
class StepPolynomial:
    """A kind of path: what writes the polynomials of a block of steps, and with which numbers.

    One procedure, which `write` returns, serves all systems and all methods with this kind of path: of a method it is
    given `table`, its numbers, and how many `stages` it has. The `degree` is at most 16. With `derivative` it is given
    the derivative of the law as well, and the neighbours of the steps of a block. `vectors` is the number of work
    vectors beside its own, `matrices` that of work matrices of 2n vectors each.
    """

    write: Callable[[], Written]
    degree: int
    stages: int
    table: NDArray[np.float64]
    vectors: int
    matrices: int = 0
    derivative: bool = False

    @property
    def procedure(self) -> Procedure:
        """The procedure that writes the polynomials; its arguments are those of `Block`."""
        return self.write().procedure

    def size(self, dimension: int, columns: int) -> int:
        """Return the number of doubles of work memory of the procedure, for states (2n,)."""
        written = self.write()
        vectors = written.vectors + self.vectors + self.matrices * dimension
        return (vectors * dimension + written.rows) * columns + LANES


@dataclass(frozen=True, eq=False)
class Written:
    """A procedure that writes polynomials, and how many vectors and rows of a block it has places for."""

    procedure: Procedure
    vectors: int
    rows: int


def block_size(dimension: int, columns: int) -> int:
    """Return the number of doubles of the steps of a block, as `gather` writes them."""
    return (2 * dimension + 3) * columns


class OwnStep:
    """The steps of a block: their times t and lengths h, and the states y at their starts and `new` at their ends.

    `side` is the position of a neighbour: -1.0 before the step, 1.0 after it, 0.0 if there is no neighbour.
    """

    def __init__(self, memory: Memory, dimension: Whole, columns: Whole) -> None:
        self.memory, self.dimension = memory, dimension
        self.t, self.h, self.side = memory, memory.at(columns), memory.at(2 * columns)
        self.y = memory.at(3 * columns)
        self.new = memory.at((dimension + 3) * columns)


@shared
def slopes() -> Procedure:
    """Return the procedure that evaluates a law over columns; if a matrix is singular, each column by itself."""
    p = Builder("slopes", "Write the right-hand side of each column, NaN where the mass matrix is singular.")
    law, parameters = p.function("law", COLUMNS), p.array("parameters", read=True)
    dimension, columns = p.given("dimension", WHOLE), p.given("columns", WHOLE)
    t, y = p.array("t", read=True), p.array("y", read=True)
    spare, out = p.array("spare"), p.array("out")
    half = dimension // 2 * columns
    with p.when(law(columns, t, y, y.at(half), parameters, out) >= 0, likely=False):
        alone, found, time = spare, spare.at(dimension * columns), spare.at(2 * dimension * columns)
        with p.loop(0, columns) as b:
            with p.loop(0, columns) as other:
                time[other] = t[b]
                with p.loop(0, dimension) as j:
                    alone[j * columns + other] = y[j * columns + b]
            singular = law(columns, time, alone, alone.at(half), parameters, found) >= 0
            with p.loop(0, dimension) as j:
                out[j * columns + b] = p.choose(singular, math.nan, found[j * columns])
    return p.finish()


class Block:
    """The arguments of a procedure that writes polynomials, and places in the memory that it works in.

    The first are what a machine prepares for a path: the law by columns with its parameters, its derivative with its
    own, what inverts matrices, the numbers of the method, its stages and the degree, and the length of a state. What
    follows is as in `POLYNOMIAL`.
    """

    def __init__(self, p: Builder) -> None:
        self.p = p
        self.law, self.parameters = p.function("law", COLUMNS), p.array("parameters", read=True)
        self.jacobian, self.constants = p.function("jacobian", COLUMNS), p.array("constants", read=True)
        self.invert = p.function("invert", INVERT)
        self.table = p.array("table", read=True)
        self.stages: Whole = p.given("stages", WHOLE)
        self.degree: Whole = p.given("degree", WHOLE)
        self.dimension: Whole = p.given("dimension", WHOLE)
        self.columns: Whole = p.given("columns", WHOLE)
        own, beside = (p.array(name, read=True, room=LANES) for name in ("own", "beside"))
        self.work, self.out = p.array("work", room=LANES), p.array("out", room=LANES)
        self.total: Whole = (self.dimension * self.columns).called("total")
        """The numbers of a vector of the block."""
        self.spare = self.work
        """Work memory for columns with a singular mass matrix."""
        self.own, self.beside = (OwnStep(memory, self.dimension, self.columns) for memory in (own, beside))
        self._vectors, self._rows = 2, 1

    def handed(self, step: Memory, work: Memory, out: Memory) -> tuple[Any, ...]:
        """Return the arguments for another such procedure, with its own step, memory and results."""
        laws = self.law, self.parameters, self.jacobian, self.constants, self.invert
        numbers = self.table, self.stages, self.degree, self.dimension, self.columns
        return (*laws, *numbers, step, step, work, out)

    def vector(self) -> Memory:
        """Return memory for a vector of the block."""
        self._vectors += 1
        return self._behind(self._vectors - 1, self._rows)

    def row(self) -> Memory:
        """Return memory for a number of each column."""
        self._rows += 1
        return self._behind(self._vectors, self._rows - 1)

    def _behind(self, vectors: int, rows: int) -> Memory:
        return self.work.at(self.total * vectors + self.columns * rows)

    def others(self) -> Memory:
        """Return the memory of the method's own vectors, after all others; see `nth`."""
        return self._behind(self._vectors, self._rows)

    def nth(self, vectors: Memory, place: Any) -> Memory:
        """Return vector number `place` of consecutive vectors of the block."""
        return vectors.at(self.total * place)

    def coefficients(self, power: Any) -> Memory:
        """Return where the coefficients of a power stand."""
        return self.nth(self.out, power)

    @contextmanager
    def entries(self) -> Iterator[Whole]:
        """Go through all numbers of a vector of the block."""
        with self.p.each(self.total, width=LANES, spill=True) as x:
            yield x

    @contextmanager
    def each_column(self) -> Iterator[Whole]:
        """Go through the columns."""
        with self.p.each(self.columns, width=LANES, spill=True) as b:
            yield b

    def spread(self, row: Memory, target: Memory) -> None:
        """Write the number of each column as all entries of a vector."""
        with self.p.loop(0, self.dimension) as j:
            line = target.at(j * self.columns)
            with self.each_column() as b:
                line[b] = row[b]

    def slopes(self, t: Memory, y: Memory, out: Memory) -> None:
        """Write the right-hand side of each column, NaN where the mass matrix is singular."""
        given = self.law, self.parameters, self.dimension, self.columns
        self.p.call(slopes(), *given, t, y, self.spare, out)

    def derive(self, t: Memory, y: Memory, out: Memory) -> None:
        """Write the derivative of the law by columns, NaN in all of them where a mass matrix is singular."""
        p, half = self.p, self.dimension // 2 * self.columns
        singular = self.jacobian(self.columns, t, y, y.at(half), self.constants, out) >= 0
        with p.when(singular, likely=False), p.loop(0, self.dimension * self.total) as place:
            out[place] = math.nan

    def finish(self) -> Written:
        """Return the procedure with the memory that it takes."""
        return Written(self.p.finish(), self._vectors, self._rows)


def mend(block: Block, first: Memory) -> None:
    """Write a parabola where a coefficient is not finite.

    It has the slope `first` / h at the start. It serves the last step of a run that ended because the slope has no
    value at its end.
    """
    p = block.p
    with block.entries() as x:
        nothing = p.variable(0.0, "nothing")
        with p.loop(0, block.degree + 1) as power:
            nothing.value = p.fma(block.coefficients(power)[x], 0.0, nothing.value)
        largest = p.largest_magnitude(nothing.value)
    with p.when(~largest.value.equals(0.0), likely=False):
        given = block.dimension, block.columns, block.degree, block.own.y, block.own.new
        p.call(parabola(), *given, first, block.out)


@shared
def parabola() -> Procedure:
    """Return the procedure that writes a parabola with the slope `first` / h at the start, in columns not finite."""
    p = Builder("parabola", "Write the parabola with the slope of the start where a coefficient is not finite.")
    dimension, columns, degree = (p.given(name, WHOLE) for name in ("dimension", "columns", "degree"))
    y, new = p.array("y", read=True), p.array("new", read=True)
    first, out = p.array("first", read=True), p.array("out")
    total = dimension * columns
    with p.loop(0, columns) as b:
        nothing = p.variable(0.0, "nothing")
        with p.loop(0, (degree + 1) * dimension) as place:
            nothing.value = p.fma(out[place * columns + b], 0.0, nothing.value)
        with p.when(~nothing.value.equals(0.0)), p.loop(0, dimension) as j:
            place = j * columns + b
            out[place], out[total + place] = y[place], first[place]
            out[total * 2 + place] = new[place] - y[place] - first[place]
            with p.loop(3, degree + 1) as k:
                out[k * total + place] = 0.0
    return p.finish()
