"""Dense output of a Taylor step: the series, computed again at the start of the step."""

from __future__ import annotations

import math
from collections.abc import Callable

from lagrange.algorithm.dense.block import steps_in
from lagrange.algorithm.taylor.memory import JET
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, exponent, mantissa, two_to

HALF = 2**0.5
"""Mantissa of a step length from which its time scale is the next larger power of two."""


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
    own: In,
    _beside: In,
    work: Out,
    out: Out,
) -> None:
    """Write the Taylor polynomials of a block of steps to `out`, by powers; NaN if a matrix is singular.

    `own` has the steps as `OwnStep`. The procedure `jet` computes the Taylor coefficients up to `order` from
    the numbers `prepared` and `constants`. The work memory has the state and its rounding error (zero), each of
    `padded` doubles. A row of coefficients for each power follows; the rows are `width` doubles apart.
    """
    step, rows, total = steps_in(own, dimension, columns), work[padded * 2 :], dimension * columns
    for i in range(padded * 2):
        work[i] = 0.0
    for b in range(columns):
        h = step.h[b]
        scale = nearest_scale(h)
        for j in range(dimension):
            work[j] = step.y[j * columns + b]
        singular = jet(step.t[b], scale, work, prepared, constants, rows, order)
        ratio = h / scale
        power = math.nan if singular else 1.0
        for k in range(order + 1):
            for j in range(dimension):
                out[k * total + j * columns + b] = rows[k * width + j] * power
            power *= ratio


@inline
def nearest_scale(h: float) -> float:
    """Return the power of two nearest to the length of a step, 1 for length zero."""
    power = exponent(h)
    return 1.0 if h == 0.0 else two_to(power + 1 if mantissa(h) > HALF else power)
