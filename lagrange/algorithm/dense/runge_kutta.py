"""The path of a Runge-Kutta method: its stages are computed again, and the sums of their weights are coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.dense.block import Block, StepPolynomial, Written, mend
from lagrange.procedure.builder import Builder
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Memory, Whole

FloatArray = NDArray[np.float64]


def runge_kutta_polynomial(rows: FloatArray, abscissae: FloatArray, weights: FloatArray) -> StepPolynomial:
    """Return the dense output y(t + theta h) = y + h sum_j b_j(theta) k_j, b_j = sum_m weights[j][m] theta**(m+1).

    `rows` (s, s) and `abscissae` (s,) are those of all stages, of the path's own too. The degree is at least that of
    the parabola on a step without a slope at its end.
    """
    stages, powers = weights.shape
    degree = max(2, powers)
    padded = np.zeros((stages, degree))
    padded[:, :powers] = weights
    table = np.concatenate([abscissae, rows.ravel(), padded.T.ravel()])
    return StepPolynomial(runge_kutta, degree, stages, table, vectors=stages)


@shared
def runge_kutta() -> Written:
    """Return the procedure. Its table has the abscissae, the rows, and the weights of each power of theta.

    The weights of a path add up to theta, so the slopes enter by what they differ from the first: weights of some
    hundred multiply less round-off then. Where a slope has no value, a zero in the rows does not hide it: the step has
    no path then.
    """
    p = Builder("runge_kutta_polynomial", "Write the polynomials of a block of steps by the stages of a method.")
    block = Block(p)
    own, h, moved, time = block.own, block.vector(), block.vector(), block.row()
    slopes, rows = block.others(), block.table.at(block.stages)
    weights = rows.at(block.stages * block.stages)
    block.spread(own.h, h)
    block.slopes(own.t, own.y, slopes)
    with p.loop(1, block.stages) as i:
        c = block.table[i]
        with block.each_column() as b:
            time[b] = p.fma(own.h[b], c, own.t[b])
        _add(block, rows.at(i * block.stages), slopes, i, moved)
        with block.entries() as x:
            moved[x] = p.fma(h[x], moved[x], own.y[x])
        block.slopes(time, moved, block.nth(slopes, i))
    with p.loop(1, block.stages) as i:
        slope = block.nth(slopes, i)
        with block.entries() as x:
            slope[x] = slope[x] - slopes[x]
    _write(block, h, weights, slopes)
    with block.entries() as x:
        block.coefficients(0)[x] = own.y[x]
        first = h[x] * slopes[x]
        moved[x] = first
        block.coefficients(1)[x] = block.coefficients(1)[x] + first
    mend(block, moved)
    return block.finish()


def _add(block: Block, weights: Memory, slopes: Memory, count: Whole, out: Memory) -> None:
    """Write the weighted sum of `count` slopes."""
    p = block.p
    with block.entries() as x:
        total = p.variable(0.0)
        with p.loop(0, count) as j:
            total.value = p.fma(block.nth(slopes, j)[x], weights[j], total.value)
        out[x] = total.value


def _write(block: Block, h: Memory, weights: Memory, apart: Memory) -> None:
    """Write the coefficients from the first power on, of what the slopes differ from the first."""
    p = block.p
    with p.loop(0, block.degree) as power:
        line, out = weights.at(power * block.stages), block.coefficients(power + 1)
        with block.entries() as x:
            total = p.variable(0.0)
            with p.loop(1, block.stages) as j:
                total.value = p.fma(block.nth(apart, j)[x], line[j], total.value)
            out[x] = h[x] * total.value
