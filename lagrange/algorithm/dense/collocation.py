"""The path of a stiffly accurate collocation method: its polynomial, found again, and a degree more.

The last stage is the end of the step, which is known; the others are solved for. Their values are of order s alone, and
so is their polynomial. But their slopes are as well, and one more slope makes the integral of the slopes a path of
order s + 1: that at the start, which is the last one of the step before; the first step takes the first one of the step
after it. All slopes are those of the polynomials and not of the law: on a stiff system round-off in the state makes a
large error in the slope. A step without a neighbour keeps its polynomial.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import Block, StepPolynomial, Written
from lagrange.procedure.builder import Builder
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

TURNS = 12
"""Corrections of the inner stages, at most; 3 to 5 bring them from a straight line to round-off."""

SETTLED = 1e-14
"""The part of the state by which a correction of settled stages moves them."""


def collocation_polynomial(A: Sequence[Sequence[float]], c: Sequence[float]) -> StepPolynomial:
    """Return the path of the collocation method with the matrix A (s, s) and the points c (s,), the last of them 1.

    The table has c, A, the inverse of A, the derivative of each Lagrange polynomial of the points and of 0 by powers,
    the polynomial that is zero at the points, and by powers of theta what each stage and that polynomial, integrated,
    add to the path.
    """
    points, s = np.array(c), len(c)
    zero = Polynomial.fromroots(points)
    basis = [_lagrange(np.concatenate([[0.0], points]), i + 1) for i in range(s)]
    # The integral over the step is zero: a formula of Radau integrates more degrees than that.
    rates = np.array([one.deriv().coef for one in basis])
    parts = [points, np.array(A), np.linalg.inv(np.array(A)), rates, zero.coef]
    powers = np.zeros((s + 2, s + 1))
    for i, one in enumerate(basis):
        powers[: s + 1, i] = one.coef
    powers[:, s] = zero.integ().coef
    table = np.concatenate([part.ravel() for part in (*parts, powers)])
    matrices = 1 + 2 * (s - 1) ** 2
    return StepPolynomial(collocation, s + 1, s, table, vectors=4 * s, matrices=matrices, derivative=True)


def _lagrange(points: NDArray[np.float64], which: int) -> Polynomial:
    """Return the polynomial that is 1 at one of the points and 0 at the others."""
    others = np.delete(points, which)
    found: Polynomial = Polynomial.fromroots(others) / np.prod(points[which] - others)
    return found


@shared
def increments() -> Written:
    """Return the procedure that writes the change of the state at each of the points c, in the steps of a block.

    If the law is not finite, the polynomial is a straight line.
    """
    return _Increments().build()


class _Increments:
    """Builds the procedure: Newton's corrections of the inner stages, from a straight line."""

    def __init__(self) -> None:
        about = "Write what the state has gained at each stage in the steps of a block."
        self.p = p = Builder("increments", about, apart=True)
        self.block = block = Block(p)
        self.c, self.A = block.table, block.table.at(block.stages)
        self.step, self.stages = block.own, block.out
        self.h, self.gap, self.state, self.spread = (block.vector() for _ in range(4))
        self.time, self.row, self.active = (block.row() for _ in range(3))
        self.inner = (block.stages - 1).called("inner")
        others = block.others()
        self.slopes, self.residual = others, block.nth(others, block.stages)
        self.derivative = block.nth(others, block.stages * 2)
        self.matrix = block.nth(others, block.stages * 2 + block.dimension)

    def build(self) -> Written:
        p, block, step = self.p, self.block, self.step
        block.spread(step.h, self.h)
        with block.entries() as x:
            self.gap[x] = step.new[x] - step.y[x]
        with p.loop(0, block.stages) as i:
            stage, c = block.nth(self.stages, i), self.c[i]
            with block.entries() as x:
                stage[x] = self.gap[x] * c
        with block.each_column() as b:
            self.time[b] = step.t[b] + step.h[b]
            self.active[b] = 1.0
        block.slopes(self.time, step.new, block.nth(self.slopes, self.inner))
        self.linearize()
        iterations, moving = p.variable(0, "iterations"), p.variable(1.0, "moving")
        with p.repeat(lambda: (iterations.value < TURNS) & (moving.value > 0.0)):
            self.correct()
            with block.each_column() as b:
                largest = p.largest_magnitude(self.active[b])
            moving.value = largest.value
            iterations.value = iterations.value + 1
        self.straighten()
        return block.finish()

    def linearize(self) -> None:
        """Write the inverse of I - h A J of the inner stages, J the derivative of the law at the end of each step."""
        p, block = self.p, self.block
        n, columns, inner = block.dimension, block.columns, self.inner
        block.derive(self.time, self.step.new, self.derivative)
        order = inner * n
        with p.loop(0, inner) as i, p.loop(0, inner) as j:
            a = self.A[i * block.stages + j]
            with p.loop(0, n) as r, p.loop(0, n) as c:
                source = self.derivative.at((r * n + c) * columns)
                target = self.entry(i * n + r, j * n + c)
                one = p.choose(i.equals(j) & r.equals(c), 1.0, p.real(0.0))
                with block.each_column() as b:
                    target[b] = one - source[b] * a * self.step.h[b]
        block.invert(order, columns, self.matrix, self.row)

    def entry(self, row: Whole, column: Whole) -> Memory:
        """Return an entry of the matrices, or behind their order of the inverses, in all columns."""
        order = self.inner * self.block.dimension
        return self.matrix.at((row * 2 * order + column) * self.block.columns)

    def correct(self) -> None:
        """Correct the inner stages in the columns in which they still move."""
        p, block, inner = self.p, self.block, self.inner
        with p.loop(0, inner) as i:
            stage, c = block.nth(self.stages, i), self.c[i]
            with block.each_column() as b:
                self.time[b] = p.fma(self.step.h[b], c, self.step.t[b])
            with block.entries() as x:
                self.state[x] = self.step.y[x] + stage[x]
            block.slopes(self.time, self.state, block.nth(self.slopes, i))
        with p.loop(0, inner) as i:
            row, stage, residual = self.A.at(i * block.stages), block.nth(self.stages, i), block.nth(self.residual, i)
            with block.entries() as x:
                total = p.variable(0.0)
                with p.loop(0, block.stages) as j:
                    total.value = p.fma(block.nth(self.slopes, j)[x], row[j], total.value)
                residual[x] = total.value * self.h[x] - stage[x]
        self.move()

    def move(self) -> None:
        """Move the inner stages by the inverses times the residuals; a column has settled where none moves far."""
        p, block = self.p, self.block
        columns, n = block.columns, block.dimension
        order = self.inner * n
        with block.each_column() as b:
            self.row[b] = 0.0
        with p.loop(0, order) as r:
            stage, first, j = self.stages.at(r * columns), self.entry(r, order), r - r // n * n
            y, gap = self.step.y.at(j * columns), self.gap.at(j * columns)
            with block.each_column() as b:
                total = p.variable(0.0)
                with p.loop(0, order) as c:
                    total.value = p.fma(first.at(c * columns)[b], self.residual.at(c * columns)[b], total.value)
                moved = p.choose(self.active[b] > 0.5, total.value, 0.0)
                stage[b] = stage[b] + moved
                far = abs(moved) > (abs(y[b]) + abs(gap[b])) * SETTLED
                self.row[b] = p.choose(far, 1.0, self.row[b])
        with block.each_column() as b:
            self.active[b] = self.row[b]

    def straighten(self) -> None:
        """Write a straight line where a stage is not finite."""
        p, block = self.p, self.block
        with block.each_column() as b:
            self.row[b] = 0.0
        with p.loop(0, block.stages * block.dimension) as r:
            line = self.stages.at(r * block.columns)
            with block.each_column() as b:
                self.row[b] = p.fma(line[b], 0.0, self.row[b])
        block.spread(self.row, self.spread)
        with p.loop(0, block.stages) as i:
            stage, c = block.nth(self.stages, i), self.c[i]
            with block.entries() as x:
                stage[x] = p.choose(self.spread[x].equals(0.0), stage[x], self.gap[x] * c)


@shared
def collocation() -> Written:
    """Return the procedure."""
    return _Collocation().build()


class _Collocation:
    """Builds the procedure: increments of the stages in steps and in those beside them, and what joins their slopes."""

    def __init__(self) -> None:
        self.p = p = Builder("collocation_polynomial", "Write the polynomials of a block of steps by their stages.")
        self.block = block = Block(p)
        s, table = block.stages, block.table
        self.c, self.inverse = table, table.at(s + s * s)
        self.rates = self.inverse.at(s * s)
        self.nodes = self.rates.at(s * s)
        self.powers = self.nodes.at(s + 1)
        self.state, self.spread, self.there, self.missing = (block.vector() for _ in range(4))
        self.row, self.place, self.rate = (block.row() for _ in range(3))
        self.inner = (s - 1).called("inner")
        self.own, self.beside = block.others(), block.nth(block.others(), s)

    def build(self) -> Written:
        p, block = self.p, self.block
        inner = increments()
        rest = block.nth(block.others(), block.stages * 2)
        p.call(inner.procedure, *block.handed(block.own.memory, rest, self.own))
        self.write(self.own)
        with block.each_column() as b:
            joined = p.largest_magnitude(block.beside.side[b])
        with p.when(joined.value > 0.0):
            p.call(inner.procedure, *block.handed(block.beside.memory, rest, self.beside))
            self.join()
        made = block.finish()
        return Written(made.procedure, made.vectors + inner.vectors, made.rows + inner.rows)

    def write(self, stages: Memory) -> None:
        """Write the coefficients of the polynomials through the stages."""
        p, block = self.p, self.block
        own = block.own
        with p.loop(0, block.degree + 1) as power:
            line, out = self.powers.at(power * (block.stages + 1)), block.coefficients(power)
            start = p.choose(power.equals(0), 1.0, p.real(0.0))
            with block.entries() as x:
                total = p.variable(own.y[x] * start)
                with p.loop(0, block.stages) as j:
                    total.value = p.fma(block.nth(stages, j)[x], line[j], total.value)
                out[x] = total.value

    def join(self) -> None:
        """Add the multiple of the polynomial that is zero at the points, integrated, with which the slopes join."""
        p, block = self.p, self.block
        own, beside, s = block.own, block.beside, block.stages
        with block.each_column() as b:
            ratio = beside.h[b] / own.h[b]
            self.rate[b] = ratio
            self.place[b] = p.choose(beside.side[b] > 0.5, p.fma(ratio, self.c[0], 1.0), 0.0)
        block.spread(beside.side, self.spread)
        block.spread(self.rate, self.state)
        first, last = self.inverse, self.inverse.at(self.inner * s)
        with block.entries() as x:
            before, behind = p.variable(0.0), p.variable(0.0)
            with p.loop(0, s) as j:
                gained = block.nth(self.beside, j)[x]
                before.value = p.fma(gained, last[j], before.value)
                behind.value = p.fma(gained, first[j], behind.value)
            self.there[x] = p.choose(self.spread[x] > 0.5, behind.value, before.value) / self.state[x]
        with p.loop(0, s) as i:
            self.at_place(self.rates.at(i * s), s)
            block.spread(self.row, self.state)
            stage = block.nth(self.own, i)
            with block.entries() as x:
                self.there[x] = p.fma(-self.state[x], stage[x], self.there[x])
        self.at_place(self.nodes, s + 1)
        block.spread(self.row, self.state)
        with block.entries() as x:
            alone = self.spread[x].equals(0.0)
            self.missing[x] = p.choose(alone, 0.0, self.there[x] / self.state[x])
        with p.loop(1, block.degree + 1) as power:
            share, out = self.powers[power * (s + 1) + s], block.coefficients(power)
            with block.entries() as x:
                out[x] = p.fma(self.missing[x], share, out[x])

    def at_place(self, coefficients: Memory, count: Whole) -> None:
        """Write the value of a polynomial with `count` coefficients at the place of each column."""
        p = self.p
        with self.block.each_column() as b:
            total = p.variable(0.0)
            with p.loop(0, count) as k:
                total.value = p.fma(total.value, self.place[b], coefficients[count - 1 - k])
            self.row[b] = total.value
