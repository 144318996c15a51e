"""Dense output of implicit collocation methods (Radau): the polynomial of a step, raised by one degree.

The methods are stiffly accurate: the last stage is the end of the step and known, and the other stages are solved for.
Stages, polynomial and slopes have order s. With one more slope, at the start, the integral of the slopes is a path of
order s + 1. This slope is the last one of the previous step. For the first step it is the first slope of the next step.
A step without a neighbour keeps its polynomial. All slopes are derivatives of polynomials, not values of the right-hand
side: on a stiff system, rounding of the state causes a large error of the right-hand side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.dense.block import (
    SPARE,
    BlockSteps,
    PolynomialBlock,
    StepPolynomial,
    WorkSize,
    block_type,
    steps_in,
    weighted,
)
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, magnitude, quotient, unlikely

STAGE_CORRECTIONS = 12
"""Largest number of Newton corrections of the inner stages. From points on a straight line, 3 to 5 reduce the error to
rounding.
"""

SETTLED = 1e-14
"""Largest Newton correction of stages that have converged, as a fraction of the state plus its change over the step."""

INCREMENTS, JOINED = WorkSize(vectors=4, rows=3), WorkSize(vectors=4, rows=3)
ROOM = WorkSize(*(sum(counts) for counts in zip(JOINED, SPARE, INCREMENTS, strict=True)))
"""Size of the work memory: for `join`, then for `increments`, then spare memory."""


def collocation_polynomial(A: Sequence[Sequence[float]], c: Sequence[float]) -> StepPolynomial:
    """Return the dense output of the collocation method with matrix A (s, s) and points c (s,), the last of them 1.

    Its table has six parts, one after the other. They are c, A, and the inverse of A; the derivatives of the Lagrange
    polynomials of the points, with 0 as a further node; the polynomial that is zero at the points; and the contribution
    of each stage, and of the integral of that polynomial, to the path. Polynomials are stored by powers of theta, the
    fraction of the step.
    """
    points, s = np.array(c), len(c)
    zero = Polynomial.fromroots(points)
    basis: list[Polynomial] = []
    nodes = np.concatenate([[0.0], points])
    for i in range(1, s + 1):
        other_nodes = np.delete(nodes, i)
        basis.append(Polynomial.fromroots(other_nodes) / np.prod(nodes[i] - other_nodes))
    # `zero` integrates to 0 over the step: Radau's formula is exact for it, and reads only its zeros.
    rates = np.array([polynomial.deriv().coef for polynomial in basis])
    parts = [points, np.array(A), np.linalg.inv(np.array(A)), rates, zero.coef]
    powers = np.zeros((s + 2, s + 1))
    for i, polynomial in enumerate(basis):
        powers[: s + 1, i] = polynomial.coef
    powers[:, s] = zero.integ().coef
    table = np.concatenate([part.ravel() for part in (*parts, powers)])
    matrices = 1 + 2 * (s - 1) ** 2
    return StepPolynomial(collocation, ROOM, s + 1, s, table, vectors=4 * s, matrices=matrices, derivative=True)


@procedure(noinline=True, block=block_type)
def increments(block: PolynomialBlock) -> None:
    """Write the change of the state from the start of each step to each of its stages to `block.out`.

    There is one vector for each stage. The stages are found by Newton's method, beginning with points on the line
    between the ends of the step. These points are the result if the right-hand side has no finite value.
    """
    step, total, stages = steps_in(block.step_data, block.dimension, block.columns), block.total, block.stages
    (h, gap, _, _), (time, _, active), slopes = block.lay_out(INCREMENTS)
    block.spread(step.h, h)
    for x in block.entries():
        gap[x] = step.new[x] - step.y[x]
    for i in range(stages):
        stage, c = block.out[i * total :], block.table[i]
        for x in block.entries():
            stage[x] = gap[x] * c
    for b in block.each_column():
        time[b] = step.t[b] + step.h[b]
        active[b] = 1.0
    block.slopes(time, step.new, slopes[(stages - 1) * total :])
    linearize(block, step)
    iterations, moving = 0, 1.0
    while iterations < STAGE_CORRECTIONS and moving > 0.0:
        correct(block, step)
        moving = 0.0
        for b in each(block.columns, width=WIDEST_VECTOR, spill=True):
            moving = magnitude(moving, active[b])
        iterations += 1
    straighten(block)


@inline
def linearize(block: PolynomialBlock, step: BlockSteps) -> None:
    """Write the inverse of the Newton matrix I - h A J of each step's inner stages to work memory.

    J is the derivative of the right-hand side at the end of each step, and A the matrix of the method. The inverse
    is NaN in all columns if a mass matrix is singular. `block` and `step` have the data of the steps.
    """
    n, columns, stages = block.dimension, block.columns, block.stages
    _, (time, row, _), slopes = block.lay_out(INCREMENTS)
    half, rows, derivative = quotient(n, 2) * columns, block.table[stages:], slopes[2 * stages * block.total :]
    matrix = derivative[n * block.total :]
    singular = block.jacobian(columns, time, step.new, step.new[half:], block.constants, derivative) >= 0
    if unlikely(singular):
        for index in range(n * block.total):
            derivative[index] = math.nan
    inner = stages - 1
    for i in range(inner):
        for j in range(inner):
            a = rows[i * stages + j]
            for r in range(n):
                for c in range(n):
                    source = derivative[(r * n + c) * columns :]
                    target = entry(block, matrix, i * n + r, j * n + c)
                    identity = 1.0 if i == j and r == c else 0.0
                    for b in block.each_column():
                        target[b] = identity - source[b] * a * step.h[b]
    block.invert(inner * n, columns, matrix, row)


@inline
def entry(block: PolynomialBlock, matrix: Out, row: int, column: int) -> Out:
    """Return entry (row, column) of the Newton matrices of all steps: an array with one number for each step.

    `matrix` has the matrices of the steps of a `block`. Each row of a matrix is followed by the row of its inverse:
    column `order` + j is column j of the inverse, for matrices of size `order`.
    """
    order = (block.stages - 1) * block.dimension
    return matrix[(row * 2 * order + column) * block.columns :]


@inline
def correct(block: PolynomialBlock, step: BlockSteps) -> None:
    """Correct the inner stages in `block.out` by one Newton step, in the columns that have not converged."""
    total, stages, rows = block.total, block.stages, block.table[block.stages :]
    (h, _, state, _), (time, _, _), slopes = block.lay_out(INCREMENTS)
    for i in range(stages - 1):
        stage, c = block.out[i * total :], block.table[i]
        for b in block.each_column():
            time[b] = fma(step.h[b], c, step.t[b])
        for x in block.entries():
            state[x] = step.y[x] + stage[x]
        block.slopes(time, state, slopes[i * total :])
    for i in range(stages - 1):
        row, stage, residual = rows[i * stages :], block.out[i * total :], slopes[(stages + i) * total :]
        for x in block.entries():
            residual[x] = weighted(0.0, slopes, total, x, row, 0, stages) * h[x] - stage[x]
    move(block, step)


@inline
def move(block: PolynomialBlock, step: BlockSteps) -> None:
    """Add the inverse matrix times the residuals to the inner stages of the columns that have not converged.

    A column has converged if no correction exceeds `SETTLED` times the state plus its change over the step.
    """
    columns, n, total, stages = block.columns, block.dimension, block.total, block.stages
    (_, gains, _, _), (_, row, active), slopes = block.lay_out(INCREMENTS)
    residual, matrix, order = slopes[stages * total :], slopes[(2 * stages + n) * total :], (stages - 1) * n
    for b in block.each_column():
        row[b] = 0.0
    for r in range(order):
        stage, inverse = block.out[r * columns :], entry(block, matrix, r, order)
        j = r - quotient(r, n) * n
        y, gap = step.y[j * columns :], gains[j * columns :]
        for b in block.each_column():
            correction = 0.0
            for c in range(order):
                correction = fma(inverse[c * columns :][b], residual[c * columns :][b], correction)
            moved = correction if active[b] > 0.5 else 0.0
            stage[b] = stage[b] + moved
            is_far = abs(moved) > (abs(y[b]) + abs(gap[b])) * SETTLED
            moves = row[b]
            row[b] = 1.0 if is_far else moves
    for b in block.each_column():
        active[b] = row[b]


@inline
def straighten(block: PolynomialBlock) -> None:
    """Replace all stages of a step of the `block` by points on the line between its ends if a stage is not finite."""
    total = block.total
    (_, gap, _, spread), (_, row, _), _ = block.lay_out(INCREMENTS)
    for b in block.each_column():
        row[b] = 0.0
    for r in range(block.stages * block.dimension):
        line = block.out[r * block.columns :]
        for b in block.each_column():
            row[b] = fma(line[b], 0.0, row[b])
    block.spread(row, spread)
    for i in range(block.stages):
        stage, c = block.out[i * total :], block.table[i]
        for x in block.entries():
            value, straight = stage[x], gap[x] * c
            stage[x] = value if spread[x] == 0.0 else straight


@procedure(block=block_type)
def collocation(block: PolynomialBlock) -> None:
    """Write the polynomials of a block of steps through their stages to `block.out`, by powers.

    The slopes are continuous between steps.
    """
    total, stages = block.total, block.stages
    _, _, gains = block.lay_out(JOINED)
    neighbour_gains, rest = gains[stages * total :], gains[2 * stages * total :]
    increments(block.with_step(block.step_data, rest, gains))
    write(block, gains)
    joined = 0.0
    for b in each(block.columns, width=WIDEST_VECTOR, spill=True):
        joined = magnitude(joined, steps_in(block.neighbours, block.dimension, block.columns).side[b])
    if joined > 0.0:
        increments(block.with_step(block.neighbours, rest, neighbour_gains))
        join(block, gains, neighbour_gains)


@inline
def write(block: PolynomialBlock, gains: In) -> None:
    """Write the coefficients of each step's polynomial to `block.out`.

    `gains` are the changes of the state from the start of the step to its stages, one vector for each stage.
    """
    step, total, stages = steps_in(block.step_data, block.dimension, block.columns), block.total, block.stages
    _, _, _, powers = parts_of(block.table, stages)
    for power in range(block.degree + 1):
        line, coefficients = powers[power * (stages + 1) :], block.out[power * total :]
        start = 1.0 if power == 0 else 0.0
        for x in block.entries():
            coefficients[x] = weighted(step.y[x] * start, gains, total, x, line, 0, stages)


@inline
def parts_of(table: In, stages: int) -> tuple[In, In, In, In]:
    """Return the four parts that follow the matrix A in the table of `collocation_polynomial`.

    The parts are: the inverse of A; the derivatives of the Lagrange polynomials; the polynomial that is zero at the
    stages; and the contributions to the path, by powers of theta.
    """
    square = stages * stages
    inverse = table[stages + square :]
    rates = inverse[square:]
    nodes = rates[square:]
    return inverse, rates, nodes, nodes[stages + 1 :]


@inline
def join(block: PolynomialBlock, gains: In, neighbour_gains: In) -> None:
    """Make slopes continuous between steps: add multiples of the node polynomial's integral to `block.out`.

    The node polynomial is zero at the stages. `gains` are the changes of the state from the start of each step
    to its stages, and `neighbour_gains` those of the neighbouring step.
    """
    step = steps_in(block.step_data, block.dimension, block.columns)
    neighbour = steps_in(block.neighbours, block.dimension, block.columns)
    total, stages = block.total, block.stages
    inverse, rates, nodes, powers = parts_of(block.table, stages)
    (state, spread, correction, missing), (row, fraction, rate), _ = block.lay_out(JOINED)
    nearest = block.table[0]
    for b in block.each_column():
        ratio = neighbour.h[b] / step.h[b]
        rate[b] = ratio
        fraction[b] = fma(ratio, nearest, 1.0) if neighbour.side[b] > 0.5 else 0.0
    block.spread(neighbour.side, spread)
    block.spread(rate, state)
    last = inverse[(stages - 1) * stages :]
    for x in block.entries():
        before = weighted(0.0, neighbour_gains, total, x, last, 0, stages)
        after = weighted(0.0, neighbour_gains, total, x, inverse, 0, stages)
        slope = after if spread[x] > 0.5 else before
        correction[x] = slope / state[x]
    for i in range(stages):
        write_at_fraction(block, rates[i * stages :], stages, fraction, row)
        block.spread(row, state)
        gain = gains[i * total :]
        for x in block.entries():
            correction[x] = fma(-state[x], gain[x], correction[x])
    write_at_fraction(block, nodes, stages + 1, fraction, row)
    block.spread(row, state)
    for x in block.entries():
        multiple = correction[x] / state[x]
        missing[x] = 0.0 if spread[x] == 0.0 else multiple
    for power in range(1, block.degree + 1):
        share, coefficients = powers[power * (stages + 1) + stages], block.out[power * total :]
        for x in block.entries():
            coefficients[x] = fma(missing[x], share, coefficients[x])


@inline
def write_at_fraction(block: PolynomialBlock, coefficients: In, count: int, fraction: In, row: Out) -> None:
    """Write the value of one polynomial at a different point for each column to `row`.

    `coefficients` has its `count` coefficients, the lowest power first. `fraction` has the points, one for each
    column, as fractions of the step.
    """
    for b in block.each_column():
        value = 0.0
        for k in range(count):
            value = fma(value, fraction[b], coefficients[count - 1 - k])
        row[b] = value
