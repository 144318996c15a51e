"""Dense output of steps: Picard's iteration from Hermite's cubic, Runge-Kutta stages, or Taylor series.

For any method: the integral of the right-hand side along a path of order p is a path of order p + 1. Its difference
from the state at the end is distributed over the step by a cubic that is flat at both ends. So the path meets both ends
with their slopes, and needs only the right-hand side. On long steps, such as steps of implicit methods, the iteration
may diverge. Then the path is the last accepted iterate, or the cubic.

For a Runge-Kutta method, the stages are computed again, and their weighted sums are the coefficients. For a Taylor
step, the series is computed again at the start of the step.

Source: W. H. Enright, K. R. Jackson, S. P. Norsett, P. G. Thomsen, Interpolants for Runge-Kutta formulas, ACM Trans.
Math. Softw. 12, 1986, with Chebyshev's nodes in place of theirs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import (
    BlockSteps,
    PolynomialBlock,
    StepPolynomial,
    WorkSize,
    block_type,
    chebyshev_points,
    mend,
    steps_in,
    weighted,
)
from lagrange.algorithm.taylor.memory import JET
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, exponent, fma, magnitude, mantissa, two_to

FloatArray = NDArray[np.float64]

ROOM = WorkSize(vectors=5, rows=4)


@cache
def hermite_polynomial(order: int) -> StepPolynomial:
    """Return dense output of an order. For order 3 it is Hermite's cubic, else Picard's iteration from this cubic.

    The degree is one more than the order. The table has the inner nodes; the matrix from changes of slopes to changes
    of states at the nodes; and, by powers of theta, the contribution of each change of slope to the path.
    """
    if order == 3:
        return StepPolynomial(hermite, ROOM, 3, 0, np.zeros(1), vectors=0)
    points, inner, contributions = chebyshev_points(order - 1), slice(1, -1), weights(order)
    integrals = np.asarray(points[:, None] ** np.arange(order + 2) @ contributions.T)
    parts = points[inner], integrals[inner, inner].ravel(), contributions[inner].T.ravel()
    return StepPolynomial(hermite, ROOM, order + 1, order - 2, np.concatenate(parts), vectors=2 * (order - 2))


@dataclass(frozen=True)
class Cubic:
    """Hermite's cubics through both ends of steps: states y and `new` there, and slopes `first` and `last`.

    Slopes are derivatives by theta, the fraction of the step. Arrays are by columns, one step in each column.
    """

    y: In
    new: In
    first: Out
    last: Out

    @inline
    def value(self, s: float, x: int) -> float:
        """Return entry x of the state at the fraction s of the step, as Hermite's cubic gives it."""
        gap, first, last = self.ends(x)
        bend = gap * (1.0 - s * 2.0) + (first * (s - 1.0) + last * s)
        return self.y[x] + (gap * s + bend * (s * (s - 1.0)))

    @inline
    def slope(self, s: float, x: int) -> float:
        """Return the derivative of entry x of Hermite's cubic by the fraction of the step, at fraction s."""
        gap, first, last = self.ends(x)
        ends = first * ((1.0 - s) * (1.0 - s * 3.0)) + last * (s * (s * 3.0 - 2.0))
        return gap * (s * 6.0 * (1.0 - s)) + ends

    @inline
    def ends(self, x: int) -> tuple[float, float, float]:
        """Return the change of entry x of the state over the step, and its slopes at both ends of the step."""
        return self.new[x] - self.y[x], self.first[x], self.last[x]


@procedure(block=block_type)
def hermite(block: PolynomialBlock) -> None:
    """Write the polynomials of a block of steps by Picard's iteration.

    In work memory `changes` are the differences between the slopes of the path and of the cubic at the inner
    nodes, followed by the same differences for the next iterate. `moved` has for each column the change of its
    slopes in the last iteration, 0 once the iteration diverges.
    """
    step = steps_in(block.step_data, block.dimension, block.columns)
    (h, first, last, _, _), (time, _, _, _), changes = block.lay_out(ROOM)
    cubic = Cubic(step.y, step.new, first, last)
    block.spread(step.h, h)
    block.slopes(step.t, step.y, first)
    for b in block.each_column():
        time[b] = step.t[b] + step.h[b]
    block.slopes(time, step.new, last)
    for x in block.entries():
        first[x] = h[x] * first[x]
        last[x] = h[x] * last[x]
    if block.stages > 0:
        begin(block, cubic)
        for _ in range(1, block.stages):
            iterate(block, step, cubic)
            judge(block)
    write(block, cubic, changes)
    mend(block, first)


@inline
def begin(block: PolynomialBlock, cubic: Cubic) -> None:
    """Begin Picard's iteration with the cubic, and write the bound for accepting the next iterate.

    For each step of the block (a column) the next iterate is accepted if it changes slopes by less than the
    largest slope of the cubic at the ends and inner nodes.
    """
    total = block.total
    (_, _, _, _, largest), (_, moved, size, _), changes = block.lay_out(ROOM)
    for x in block.entries():
        largest[x] = magnitude(cubic.first[x], cubic.last[x])
    for i in range(block.stages):
        s, change = block.table[i], changes[i * total :]
        for x in block.entries():
            largest[x] = magnitude(largest[x], cubic.slope(s, x))
            change[x] = 0.0
    measure(block)
    for b in block.each_column():
        moved[b] = size[b] * 2.0


@inline
def measure(block: PolynomialBlock) -> None:
    """Write to the row `size` the largest magnitude in each column of the work vector `largest`.

    `size` has one number for each step of the block, `largest` a state for each step.
    """
    (_, _, _, _, largest), (_, _, size, _), _ = block.lay_out(ROOM)
    for b in block.each_column():
        size[b] = 0.0
    for j in range(block.dimension):
        line = largest[j * block.columns :]
        for b in block.each_column():
            size[b] = magnitude(size[b], line[b])


@inline
def iterate(block: PolynomialBlock, step: BlockSteps, cubic: Cubic) -> None:
    """Write the next iterate of Picard's iteration after the present one in the work memory of the `block`.

    An iterate is the difference of the path's slope from the slope of the `cubic` at each inner node of the `step`.
    The present differences are integrated to states on the path. There the right-hand side, times h, is evaluated,
    and the slope of the cubic is subtracted.
    """
    total, stages = block.total, block.stages
    (h, _, _, state, _), (time, _, _, _), changes = block.lay_out(ROOM)
    to_states = block.table[stages:]
    for i in range(stages):
        s, row, trial = block.table[i], to_states[i * stages :], changes[(stages + i) * total :]
        for b in block.each_column():
            time[b] = fma(step.h[b], s, step.t[b])
        for x in block.entries():
            state[x] = cubic.value(s, x) + weighted(0.0, changes, total, x, row, 0, stages)
        block.slopes(time, state, trial)
        for x in block.entries():
            trial[x] = h[x] * trial[x] - cubic.slope(s, x)


@inline
def judge(block: PolynomialBlock) -> None:
    """Replace the present iterate of Picard's iteration by the next one, in the columns that converge.

    A column converges if the change from one iterate to the next is less than half of the previous change.
    """
    total, stages = block.total, block.stages
    (_, _, _, _, largest), (_, moved, size, better), changes = block.lay_out(ROOM)
    for x in block.entries():
        largest[x] = 0.0
    for i in range(stages):
        trial, change = changes[(stages + i) * total :], changes[i * total :]
        for x in block.entries():
            largest[x] = magnitude(largest[x], trial[x] - change[x])
    measure(block)
    for b in block.each_column():
        now = size[b]
        converges = now < moved[b] * 0.5
        moved[b] = now if converges else 0.0
        better[b] = 1.0 if converges else 0.0
    block.spread(better, largest)
    for i in range(stages):
        trial, change = changes[(stages + i) * total :], changes[i * total :]
        for x in block.entries():
            after, before = trial[x], change[x]
            change[x] = after if largest[x] > 0.5 else before


@inline
def write(block: PolynomialBlock, cubic: Cubic, changes: In) -> None:
    """Write the coefficients of the steps' polynomials to `block.out`, one power of theta after the other.

    They are the coefficients of the cubic through both ends of the step, plus a weighted sum of `changes`: the
    differences between the slopes of the path and of the cubic at the inner nodes.
    """
    total, stages, out = block.total, block.stages, block.out
    for power in range(4, block.degree + 1):
        higher = out[power * total :]
        for x in block.entries():
            higher[x] = 0.0
    linear, square, third = out[total:], out[2 * total :], out[3 * total :]
    for x in block.entries():
        gap, first, last = cubic.ends(x)
        out[x] = cubic.y[x]
        linear[x] = first
        square[x] = gap * 3.0 - first * 2.0 - last
        third[x] = first + last - gap * 2.0
    if stages > 0:
        shares = block.table[stages + stages * stages :]
        for power in range(block.degree + 1):
            line, coefficients = shares[power * stages :], out[power * total :]
            for x in block.entries():
                coefficients[x] = weighted(coefficients[x], changes, total, x, line, 0, stages)


def weights(count: int) -> FloatArray:
    """Return for each node the contribution of a slope of 1 at the node to the path, by powers of theta.

    The shape is (count, count + 2). A contribution is the integral of the node's Lagrange polynomial, minus a
    cubic, so that it is zero at theta = 1.
    """
    points = chebyshev_points(count - 1)
    shares = np.zeros((count, count + 2))
    for i, node in enumerate(points):
        other_points = np.delete(points, i)
        slope = np.poly1d(other_points, r=True) / np.prod(node - other_points)
        integral = slope.integ()
        share = integral - integral(1.0) * np.poly1d([-2.0, 3.0, 0.0, 0.0])
        shares[i, : len(share.coeffs)] = share.coeffs[::-1]
    return shares


STAGES_ROOM = WorkSize(vectors=2, rows=1)


def runge_kutta_polynomial(rows: FloatArray, abscissae: FloatArray, weights: FloatArray) -> StepPolynomial:
    """Return the dense output y(t + theta h) = y + h sum_j b_j(theta) k_j, b_j = sum_m weights[j][m] theta**(m+1).

    `rows` (s, s) and `abscissae` (s,) include the additional stages of the dense output. The degree is at least 2, for
    the parabola on a step without a slope at its end.
    """
    stages, powers = weights.shape
    degree = max(2, powers)
    padded = np.zeros((stages, degree))
    padded[:, :powers] = weights
    table = np.concatenate([abscissae, rows.ravel(), padded.T.ravel()])
    return StepPolynomial(runge_kutta, STAGES_ROOM, degree, stages, table, vectors=stages)


@procedure(block=block_type)
def runge_kutta(block: PolynomialBlock) -> None:
    """Write the polynomials of a block of steps from the stages of a Runge-Kutta method to `block.out`.

    The table has the abscissae, the rows, and the weights for each power of theta. The weights add up to theta, so
    that slopes enter only by their differences from the first slope: weights of some hundred then amplify less
    rounding. If a slope is not finite, the polynomial is not finite, even if the slope has weight zero. Then a
    parabola replaces it.
    """
    step = steps_in(block.step_data, block.dimension, block.columns)
    total, stages, out = block.total, block.stages, block.out
    (h, moved), (time,), slopes = block.lay_out(STAGES_ROOM)
    rows = block.table[stages:]
    weights = rows[stages * stages :]
    block.spread(step.h, h)
    block.slopes(step.t, step.y, slopes)
    for i in range(1, stages):
        c, row = block.table[i], rows[i * stages :]
        for b in block.each_column():
            time[b] = fma(step.h[b], c, step.t[b])
        for x in block.entries():
            moved[x] = fma(h[x], weighted(0.0, slopes, total, x, row, 0, i), step.y[x])
        block.slopes(time, moved, slopes[i * total :])
    for i in range(1, stages):
        slope = slopes[i * total :]
        for x in block.entries():
            slope[x] = slope[x] - slopes[x]
    for power in range(block.degree):
        line, coefficients = weights[power * stages :], out[(power + 1) * total :]
        for x in block.entries():
            coefficients[x] = h[x] * weighted(0.0, slopes, total, x, line, 1, stages)
    linear = out[total:]
    for x in block.entries():
        out[x] = step.y[x]
        first = h[x] * slopes[x]
        moved[x] = first
        linear[x] = linear[x] + first
    mend(block, moved)


HALF = 2**0.5
"""Significand above which a step length is rounded up to a power of two, and else down. The step length is m * 2**e
with a significand m from 1 to 2. So its ratio to the power of two is within a factor of sqrt(2).
"""


@procedure(jet=lambda: JET)
def series_polynomial(
    jet: Callable[..., bool],
    prepared: In,
    constants: In,
    order: int,
    width: int,
    padded: int,
    dimension: int,
    columns: int,
    step_data: In,
    _neighbours: In,
    work: Out,
    out: Out,
) -> None:
    """Write the Taylor polynomials of a block of steps to `out`, by powers; NaN if a matrix is singular.

    `step_data` has the steps by columns, as in `BlockSteps`; `_neighbours` is not used. The procedure `jet` computes
    the Taylor coefficients of a state up to `order`. `prepared` are the parameters and the values that depend on them
    alone, and `constants` the constants of the series. The work memory has the state and its rounding error (zero),
    each of `padded` doubles. A row of coefficients for each power follows; the rows are `width` doubles apart.
    """
    step, rows, total = steps_in(step_data, dimension, columns), work[padded * 2 :], dimension * columns
    for i in range(padded * 2):
        work[i] = 0.0
    for b in range(columns):
        h = step.h[b]
        # The power of two nearest to the length of the step.
        binary = exponent(h)
        scale = 1.0 if h == 0.0 else two_to(binary + 1 if mantissa(h) > HALF else binary)
        for j in range(dimension):
            work[j] = step.y[j * columns + b]
        singular = jet(step.t[b], scale, work, prepared, constants, rows, order)
        ratio = h / scale
        power = math.nan if singular else 1.0
        for k in range(order + 1):
            for j in range(dimension):
                out[k * total + j * columns + b] = rows[k * width + j] * power
            power *= ratio
