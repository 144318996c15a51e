"""Sources of the coefficients of a chunk at one order, each a number or a short vector of like values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lagrange.algorithm.series.packing import Chunk, Operand, PackedStage
from lagrange.algorithm.series.rules import OWN, Term, less, plus
from lagrange.algorithm.series.systems import LinearSystem
from lagrange.procedure.builder import Builder
from lagrange.program.series import SeriesProgram


class OperandSource(Protocol):
    """Source of the operands that chunks read: at the present order, at the previous order, and at order 0."""

    p: Builder
    program: SeriesProgram
    systems: list[LinearSystem]

    def now(self, operand: Operand) -> Term:
        """Return an operand at the present order."""

    def before(self, operand: Operand) -> Term:
        """Return an operand at the previous order."""

    def first(self, operand: Operand) -> Term:
        """Return an operand at order 0."""

    def over(self, operand: Operand) -> Term:
        """Return the reciprocal of an operand at order 0."""

    def constant(self, places: tuple[int, ...]) -> Term:
        """Return the constants of the table with the indices `places`, as one number or vector."""

    def share(self, x: Term) -> Term:
        """Return scale * x / k, where k is the order, and `scale` the unit of time."""

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""

    def start(self) -> Term:
        """Return the coefficient of time itself: the scale at k = 1, else 0."""


class ChunkAt:
    """Source of the coefficients of a chunk at one order, except its sums. `which` is defined in `At`."""

    def __init__(self, series: OperandSource, chunk: Chunk) -> None:
        self.series, self.chunk, self.p = series, chunk, series.p

    def operand(self, which: int) -> Operand:
        """Return the operand that is argument `which`, or the chunk itself for OWN."""
        return self.chunk.whole if which == OWN else self.chunk.args[which]

    def now(self, which: int) -> Term:
        """Return argument `which` at the present order."""
        return self.series.now(self.operand(which))

    def before(self, which: int) -> Term:
        """Return argument `which` at the previous order."""
        return self.series.before(self.operand(which))

    def first(self, which: int) -> Term:
        """Return argument `which` at order 0, or the chunk itself for OWN."""
        found = self.series.first(self.operand(which))
        return self.p.real(0.0) if found is None else found

    def over(self, which: int) -> Term:
        """Return the reciprocal at order 0 of argument `which`, or of the chunk itself for OWN."""
        return self.series.over(self.operand(which))

    def known(self, which: int) -> float | None:
        """Return coefficient `which` of the rule if it is known at compile time and equal in all lanes, else None."""
        found = dict.fromkeys(self.series.program.numbers[place] for place in self.chunk.coefficients[which])
        return next(iter(found)) if len(found) == 1 else None

    def constant(self, which: int) -> Term:
        """Return coefficient `which` of the chunk's rule."""
        return self.series.constant(self.chunk.coefficients[which])

    def share(self, x: Term) -> Term:
        """Return scale * x / k, where k is the order, and `scale` the unit of time."""
        return self.series.share(x)

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""
        return self.series.part(x)

    def start(self) -> Term:
        """Return the coefficient of time itself: the scale at k = 1, else 0."""
        return self.series.start()


def solved(series: OperandSource, place: int, packed: PackedStage, guesses: Sequence[Term]) -> list[Term]:
    """Return the unknowns of stage number `place` by chunk: guesses plus M0^-1 (f[k-1] * scale / k - p^[k]).

    p^[k] is the coefficient of the momenta that was computed with the guesses as unknowns.
    """
    right = []
    for force, momentum in zip(packed.right, packed.left, strict=True):
        rate = None if force is None else series.share(series.before(force))
        right.append(less(rate, None if momentum is None else series.now(momentum)))
    found = series.systems[place].solve(packed.rows, right)
    return [plus(x, guess) for x, guess in zip(found, guesses, strict=True)]


def divisor(chunk: Chunk) -> Operand | None:
    """Return the operand whose value at order 0 divides a chunk, or None."""
    if chunk.op in ("div", "against"):
        return chunk.args[1]
    if chunk.op in ("inverse", "power"):
        return chunk.args[0]
    return chunk.whole if chunk.op == "sqrt" else None
