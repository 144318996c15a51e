"""Dense output of a Runge-Kutta method. Its stages are computed again, and their weighted sums are the coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import PolynomialBlock, Room, StepPolynomial, block_type, mend, steps_in, weighted
from lagrange.procedure.front.plain import procedure
from lagrange.procedure.front.vocabulary import fma

FloatArray = NDArray[np.float64]

ROOM = Room(vectors=2, rows=1)


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
    return StepPolynomial(runge_kutta, ROOM, degree, stages, table, vectors=stages)


@procedure(block=block_type)
def runge_kutta(block: PolynomialBlock) -> None:
    """Write the polynomials of a block of steps from the stages of a method.

    The table has the abscissae, the rows, and the weights for each power of theta. The weights add up to theta, so that
    only differences of slopes from the first slope enter: weights of some hundred then multiply less rounding. If a
    slope has no value, the step has no path, even if its coefficients are zero.
    """
    step = steps_in(block.own, block.dimension, block.columns)
    total, stages, out = block.total, block.stages, block.out
    (h, moved), (time,), slopes = block.lay_out(ROOM)
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
