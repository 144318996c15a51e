"""The common part of the builders of series: order 0, constants and linear systems.

A builder makes the procedure

    jet(t, scale, y, prepared, constants, rows, order) -> whether a matrix is singular

It writes the Taylor coefficients of q and v at the state y, times scale**k, to row k of `rows`, for k from 0 to
the order. `prepared` are the numbers that depend on parameters alone. Like values are adjacent, in chunks of a
length known at compile time, so that a compiler turns each chunk into vectors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.kernel.body import SOURCE
from lagrange.algorithm.series.numbers import ALONE, SeriesNumbers, Start
from lagrange.algorithm.series.packing import ZERO_LANE, Operand, PackedStage, Packing
from lagrange.algorithm.series.rules import Term, less, plus
from lagrange.algorithm.series.systems import LinearSystem, moving_system, system_size
from lagrange.algorithm.series.vectors import joined
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE
from lagrange.procedure.values import Flag, Memory, Real, Whole
from lagrange.program.elimination import LARGEST_IN_LINE
from lagrange.program.series import SeriesProgram

NAME = "taylor_jet"
"""Name of the procedure that computes the series, in printed code."""

ANGLES_AT_ONCE = 8
"""Number of angles whose sines and cosines are computed at once, where there are vectors."""


class JetBuilder:
    """Base class of builders of the procedure that computes the Taylor series at a state, order after order.

    `origin` has the values at order 0, by the number of the value. Inverses of mass matrices are written out up
    to the size `largest`.
    """

    def __init__(
        self, packing: Packing, numbers: SeriesNumbers, layout: TaylorLayout, largest: int = LARGEST_IN_LINE
    ) -> None:
        self.packing, self.numbers, self.layout, self.largest = packing, numbers, layout, largest
        self.program: SeriesProgram = packing.program
        self.p = p = Builder(NAME, "Write the coefficients of the series, and say whether a matrix is singular.")
        self.t, self.scale = p.given("t", REAL), p.given("scale", REAL)
        self.y, self.prepared = p.array("y", read=True), p.array("prepared", read=True)
        p.array("constants", read=True)
        self.rows = p.array("rows", room=WIDEST_VECTOR)
        self.order: Whole = p.given("order", WHOLE)
        self.constants: list[Real] = []
        self.origin: dict[int, Any] = {}
        self.systems: list[LinearSystem] = []
        self.singular: Flag = p.false

    def begin(self) -> None:
        """Add the code for constants, values of order 0, and inverses or factors of the mass matrices."""
        program, p = self.program, self.p
        self.constants = [self.numbers.constant(self.prepared, index) for index in range(len(program.numbers))]
        self.joined: dict[tuple[int, ...], Term] = {}
        """Coefficients joined to vectors, by their indices in the table."""
        self.reciprocals: dict[Operand, Term] = {}
        """Reciprocals of the divisors at order 0."""
        style = ALONE if self.packing.lanes > 1 else SOURCE
        start = Start(p, self.numbers, self.prepared, self.constants, self.t, self.y, self.layout.padded, style)
        start.run_moving(ANGLES_AT_ONCE if self.packing.lanes > 1 else 1)
        values = [start.value(ref) for ref in program.start.outputs]
        self.origin = dict(zip(program.started, values, strict=False))
        for i in range(program.states):
            self.origin.setdefault(i, self.y[i])
        triangles, memory = iter(values[len(program.started) :]), self.matrices()
        flags = [p.false if start.singular is None else Flag.of(start.singular.value)]
        for stage, known in zip(program.stages, self.numbers.systems(p, self.prepared), strict=True):
            if known is None:
                known, singular = moving_system(p, stage.plan, triangles, memory, self.largest)
                memory = memory.at(size) if (size := system_size(stage.plan, self.largest)) else memory
                flags += singular
            self.systems.append(known)
        self.singular = reduce(lambda a, b: a | b, flags)

    def constant(self, indices: tuple[int, ...]) -> Term:
        """Return the constants of the series program with these `indices`, as one number or vector."""
        if indices not in self.joined:
            self.joined[indices] = self.numbers.vector(self.prepared, indices, self.constants)
        return self.joined[indices]

    def common(self, indices: Sequence[int]) -> float | None:
        """Return the number that all constants with these `indices` equal, if known at compile time; else None."""
        known = dict.fromkeys(self.program.numbers[index] for index in indices)
        return next(iter(known)) if len(known) == 1 else None

    def is_known(self, operand: Operand, stage_number: int) -> bool:
        """Return True if no value of an operand depends on a linear system after number `stage_number`."""
        depth = self.program.depth
        return all(value == ZERO_LANE or depth[value] <= stage_number for value in operand.values)

    def at_zero(self, operand: Operand) -> Term:
        """Return an operand at order 0, as a number or vector."""
        zero = (None, 0)
        return joined(self.p, [zero if value == ZERO_LANE else (self.origin.get(value), 0) for value in operand.values])

    def matrices(self) -> Memory:
        """Return the memory for matrices, which follows the rows."""
        return self.rows.at((self.order + 1) * self.layout.width)


class LoopJet(JetBuilder):
    """Base class of builders whose procedure loops over orders k. It computes 1 / k and scale / k."""

    def __init__(
        self, packing: Packing, numbers: SeriesNumbers, layout: TaylorLayout, largest: int = LARGEST_IN_LINE
    ) -> None:
        super().__init__(packing, numbers, layout, largest)
        self.k: Whole = self.order
        self.rank = self.time = self.high = self.low = self.scale
        self.shares = self.scale, self.scale

    @contextmanager
    def each_order(self) -> Iterator[Whole]:
        """Add a loop over the orders from 1 on; the body of the `with` statement adds the code of one order.

        With a mass matrix that depends on the state there is an iteration 0 as well: order 1 is computed twice.
        """
        p, moving = self.p, any(stage.plan.moving for stage in self.packing.stages)
        if moving:
            p.note("Order 1 is computed twice, the second time from the velocities found first.")
        with p.loop(0 if moving else 1, self.order + 1) as iteration:
            self.set_order(p.larger(iteration, 1) if moving else iteration)
            yield iteration

    def set_order(self, k: Whole) -> None:
        """Set k as the present order, and compute its reciprocal and scale / k, in two doubles each."""
        p = self.p
        self.k, self.rank = k, p.real(k)
        self.high = 1.0 / self.rank
        p.note("What 1 - k high leaves over is exact, and its share is the part of 1 / k that rounding lost.")
        self.low = p.fma(-self.rank, self.high, 1.0) * self.high
        self.shares = self.high * self.scale, self.low * self.scale
        self.time = p.choose(k.equals(1), self.scale, 0.0)

    def start(self) -> Term:
        """Return the present Taylor coefficient of the time itself: the scale of time at order 1, else 0."""
        return self.time

    def share(self, x: Term) -> Term:
        """Return scale * x / k: the order k of a value from the order k-1 of its derivative, x."""
        return divided(self, x, *self.shares)

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the order."""
        return divided(self, x, self.high, self.low)


def divided(jet: JetBuilder, x: Term, high: Term, low: Term) -> Term:
    """Return x * (high + low), rounded once; high + low is 1 / k, or scale / k, in two doubles.

    The rounded reciprocal of an order k has an error of the same sign at every step, which would add up.
    """
    if x is None:
        return None
    return x * high if low is None else jet.p.fma(x, high, x * low)


def solved(jet: Any, stage_number: int, stage: PackedStage, guesses: Sequence[Term]) -> list[Term]:
    """Return the coefficients of the unknowns of a linear system at the present order k, by chunk.

    They are guesses + M0^-1 (f[k-1] * scale / k - p^[k]), with the matrix M0 at order 0, the forces f, and the
    momenta p^ computed with the guesses as unknowns. `jet` is the builder, `stage` the system and `stage_number` its
    number.
    """
    right = []
    for force, momentum in zip(stage.right, stage.left, strict=True):
        rate = None if force is None else jet.share(jet.before(force))
        right.append(less(rate, None if momentum is None else jet.now(momentum)))
    solution = jet.systems[stage_number].solve(stage.rows, right)
    return [plus(x, guess) for x, guess in zip(solution, guesses, strict=True)]
