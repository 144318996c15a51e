"""The path of a member on a step, by the dense output of single runs: its polynomials, and states on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lagrange.algorithm.dense.block import LANES, READ, OwnStep, StepPolynomial, block_size, steps_in
from lagrange.algorithm.taylor.memory import SeriesMemory, TaylorLayout
from lagrange.algorithm.taylor.sums import increment
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Memory, Real, Whole

PATH = Callee((REAL, REAL, READ, Array(), WHOLE), ())
"""A callback that writes the state at a fraction of a step, or some entries of it. Arguments: the fraction, the length
of the step in the unit of the polynomial, the coefficients, the state, and the degree."""


def polynomial_path(name: str, entries: Sequence[int], dimension: int) -> Procedure:
    """Return the path by polynomials in the fraction of the step; the coefficients of a power are adjacent."""
    p = Builder(name, "Write the state at a fraction of a step.")
    fraction, ratio = p.given("theta", REAL), p.given("ratio", REAL)
    c, out, degree = p.array("c", read=True), p.array("out"), p.given("degree", WHOLE)
    theta: Real = fraction * ratio
    totals = {j: p.variable(c[degree * dimension + j]) for j in entries}
    with p.loop(0, degree) as k:
        line = c.at((degree - 1 - k) * dimension)
        for j, total in totals.items():
            total.value = p.fma(total.value, theta, line[j])
    for j, total in totals.items():
        out[j] = total.value
    return p.finish()


def series_path(layout: TaylorLayout, entries: Sequence[int]) -> Procedure:
    """Return the path by the series of the last step; the state before the step is stored with its rows."""
    p = Builder("series_path", "Write the state at a fraction of a step.")
    theta, ratio = p.given("theta", REAL), p.given("ratio", REAL)
    work, out = p.array("work", read=True), p.array("out")
    run = SeriesMemory(p, layout, work)
    before, lost = (work.at(layout.held + place) for place in (0, layout.padded))
    sums = increment(run, theta * ratio)
    for j in entries:
        out[j] = before[j] + (sums(p.whole(j)) + lost[j])
    return p.finish()


@dataclass(frozen=True)
class DenseOutput:
    """The dense output of a method: the kind of its polynomials, and the right-hand side as a procedure."""

    kind: StepPolynomial
    law: Procedure

    @cached_property
    def column(self) -> Procedure:
        """The right-hand side as a law over columns, for one column."""
        return _of_column(self.law)


class StepCoefficients:
    """The polynomial of a member's step, in memory of a procedure: the same dense output as in single runs."""

    def __init__(self, p: Builder, dense: DenseOutput, dimension: int) -> None:
        kind = dense.kind
        self.p, self.kind, self.dimension = p, kind, dimension
        functions = {"law": dense.column}
        self.polynomial = bound(kind.procedure, functions, prefix="path_")
        self.own = p.reserve(block_size(dimension, 1), room=LANES, name="own")
        self.step = Tracer(p, ()).call(steps_in, self.own, p.whole(dimension), p.whole(1))
        self.work = p.reserve(kind.size(dimension, 1), room=LANES, name="path_work")
        self.c = p.reserve((kind.degree + 1) * dimension, room=LANES, name="c")

    def find(self, table: Memory, numbers: Memory) -> None:
        """Write the polynomial of the step, from the numbers of the method and those of the law."""
        write_polynomial(self.p, self.kind, self.polynomial, (numbers, table), self.step, self.work, self.c)


def write_polynomial(
    p: Builder,
    kind: StepPolynomial,
    procedure: Procedure,
    numbers: tuple[Memory, Memory],
    own: OwnStep,
    work: Memory,
    c: Memory,
) -> None:
    """Write the polynomial of one step by a procedure of its kind, from the numbers of the law and of the method."""
    parameters, table = numbers
    given: dict[str, Any] = {"parameters": parameters, "table": table, "stages": p.whole(kind.stages)}
    given |= {"degree": p.whole(kind.degree), "dimension": own.dimension, "columns": p.whole(1)}
    given |= {"own": own.memory, "beside": own.memory, "work": work, "out": c}
    p.call(procedure, *(given[one.name] for one in procedure.parameters))


def _of_column(law: Procedure) -> Procedure:
    """Return a law of a time and a state as a law over columns, for one column; see `COLUMNS`."""
    p = Builder("law_of_column", "Write the right-hand side of a column, and return 0 where a matrix is singular.")
    p.given("columns", WHOLE)
    t, y = p.array("t", read=True), p.array("q", read=True)
    p.array("v", read=True)
    numbers, out = p.array("numbers", read=True), p.array("out")
    singular = p.call(law, t[0], y, numbers, out)
    failed: Whole = p.whole(singular)
    p.leave(failed - 1)
    return p.finish(WHOLE)
