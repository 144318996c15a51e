"""One value of a series at an order, of which later code reads every coefficient as a value of its own; see `At`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from lagrange.procedure.builder import Builder
from lagrange.procedure.series.packing import Chunk, Operand
from lagrange.procedure.series.rules import OWN, Term, less, plus
from lagrange.procedure.series.systems import System
from lagrange.procedure.values import Real
from lagrange.program.series import SeriesProgram


class Coefficients(Protocol):
    """What values read of a series at an order; `x` has the coefficients of the order at hand."""

    p: Builder
    program: SeriesProgram
    constants: list[Real]
    origin: dict[int, Any]
    systems: list[System]
    x: dict[int, Term]

    def before(self, number: int) -> Term:
        """Return a coefficient of the order before."""

    def over(self, number: int) -> Real:
        """Return one over a value at order 0."""

    def share(self, x: Term) -> Term:
        """Return x scale / k."""

    def part(self, x: Term) -> Term:
        """Return x / k."""

    def start(self) -> Term:
        """Return the coefficient of time: the scale at k = 1, else 0."""


class ValueAt:
    """The lane of a chunk at an order, without its sums; see `At`."""

    def __init__(self, jet: Coefficients, chunk: Chunk, lane: int) -> None:
        self.series, self.chunk, self.lane, self.p = jet, chunk, lane, jet.p

    def number(self, which: int) -> int:
        """Return the number of an argument, or of the value itself."""
        return (self.chunk.whole if which == OWN else self.chunk.args[which]).values[self.lane]

    def now(self, which: int) -> Term:
        """Return the coefficient of an argument at the order at hand."""
        return self.series.x[self.number(which)]

    def before(self, which: int) -> Term:
        """Return the coefficient of an argument at the order before."""
        return self.series.before(self.number(which))

    def first(self, which: int) -> Real:
        """Return an argument, or the value itself, at order 0."""
        found: Real = self.series.origin[self.number(which)]
        return found

    def over(self, which: int) -> Real:
        """Return one over an argument, or over the value itself, at order 0."""
        return self.series.over(self.number(which))

    def known(self, which: int) -> float | None:
        """Return a coefficient of the rule if it is known now."""
        return self.series.program.numbers[self.place(which)]

    def constant(self, which: int) -> Real:
        """Return a coefficient of the rule."""
        return self.series.constants[self.place(which)]

    def place(self, which: int) -> int:
        """Return where a coefficient of the rule stands in the table."""
        return self.chunk.coefficients[which][self.lane]

    def share(self, x: Term) -> Term:
        """Return x scale / k."""
        return self.series.share(x)

    def part(self, x: Term) -> Term:
        """Return x / k."""
        return self.series.part(x)

    def start(self) -> Term:
        """Return the coefficient of time: the scale at k = 1, else 0."""
        return self.series.start()


def solved(series: Coefficients, place: int, guesses: Sequence[Term]) -> list[Term]:
    """Return the unknowns of a stage, corrected from guesses."""
    stage, right = series.program.stages[place], []
    for force, momentum in zip(stage.right, stage.left, strict=True):
        rate = None if force is None else series.share(series.before(force))
        right.append(less(rate, None if momentum is None else series.x[momentum]))
    return [plus(x, guess) for x, guess in zip(series.systems[place].solve(right), guesses, strict=True)]


def divisor(chunk: Chunk) -> Operand | None:
    """Return what a chunk divides by at order 0."""
    if chunk.op in ("div", "against"):
        return chunk.args[1]
    if chunk.op in ("inverse", "power"):
        return chunk.args[0]
    return chunk.whole if chunk.op == "sqrt" else None
