"""The path of a member on a step, by the dense output of single runs: its polynomials, and states on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.dense.block import StepPolynomial, block_size, steps_in
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.sums import powers_of, series_sum
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import READ, REAL, WHOLE, Array, Callee, Procedure
from lagrange.procedure.front.building import Tracer
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, generated
from lagrange.procedure.rewrite import bound
from lagrange.procedure.values import Memory, Real

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
    work, out, order = p.array("work", read=True), p.array("out"), p.given("order", WHOLE)
    before, lost = (work.at(layout.held + place) for place in (0, layout.padded))
    powers, trace = powers_of(theta * ratio), Tracer(p, ())
    for j in entries:
        out[j] = before[j] + (trace.call(series_sum, work, order, powers, p.whole(j), layout) + lost[j])
    return p.finish()


@dataclass(frozen=True)
class MemberDenseOutput:
    """The dense output of a method: the kind of its polynomials, and the right-hand side as a procedure."""

    kind: StepPolynomial
    law: Procedure

    @cached_property
    def column(self) -> Procedure:
        """The right-hand side as a law over columns, for one column."""
        return law_of_column.form(law=self.law)


@dataclass(frozen=True, eq=False)
class MemberStepPath:
    """The polynomial of one step of a member: a kind of dense output, and its procedure for a right-hand side."""

    kind: StepPolynomial
    procedure: Procedure
    dimension: int

    @classmethod
    def of(cls, kind: StepPolynomial, law: Procedure, dimension: int, prefix: str) -> MemberStepPath:
        """Return the path for a law over columns; `prefix` is added to the names of its procedures."""
        return cls(kind, bound(kind.procedure, {"law": law}, prefix=prefix), dimension)

    @property
    def size(self) -> int:
        """Number of doubles of its work memory."""
        return self.kind.size(self.dimension, 1)

    @inline
    def write(self, given: tuple[In, In], columns: int, own: In, beside: In, work: Out, out: Out) -> None:
        """Write the polynomial of a step; `given` are the numbers of the law and of the method. See `POLYNOMIAL`."""
        numbers, table = given
        names = "parameters", "table", "stages", "degree", "dimension", "columns", "own", "beside", "work", "out"
        layout = self.kind.stages, self.kind.degree, self.dimension, columns
        arguments = dict(zip(names, (numbers, table, *layout, own, beside, work, out), strict=True))
        generated(self.procedure, *[arguments[one.name] for one in self.procedure.parameters])


class StepCoefficients:
    """Coefficients of the polynomial of a member's step, in memory of a procedure; the same as in single runs."""

    def __init__(self, p: Builder, dense: MemberDenseOutput, dimension: int) -> None:
        kind = dense.kind
        self.p, self.kind, self.dimension = p, kind, dimension
        self.path = MemberStepPath.of(kind, dense.column, dimension, "path_")
        self.own = p.reserve(block_size(dimension, 1), room=WIDEST_VECTOR, name="own")
        self.step = Tracer(p, ()).call(steps_in, self.own, p.whole(dimension), p.whole(1))
        self.work = p.reserve(kind.size(dimension, 1), room=WIDEST_VECTOR, name="path_work")
        self.c = p.reserve((kind.degree + 1) * dimension, room=WIDEST_VECTOR, name="c")

    def find(self, table: Memory, numbers: Memory) -> None:
        """Write the polynomial of the step, from the numbers of the method and those of the law."""
        Tracer(self.p, ()).call(self.path.write, (numbers, table), 1, self.own, self.own, self.work, self.c)


@procedure
def law_of_column(_columns: int, t: In, q: In, _v: In, numbers: In, out: Out, *, law: Procedure) -> int:
    """Write the right-hand side of one column; return 0 if a matrix is singular, else -1. See `COLUMNS`."""
    return int(generated(law, t[0], q, numbers, out)) - 1
