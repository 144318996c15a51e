"""Tests of Newton's method: whether it has converged, and whether its matrix can be kept.

An equal step is solved to round-off, a step with error control far below its tolerance. After a correction the error is
estimated as the rest of a geometric series, with the contraction rate of the last two corrections, or the rate of the
previous step. Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

from __future__ import annotations

import math

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.memory import Newton
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import larger, smaller

MATRIX_AGE = 3
"""A matrix may be rebuilt after this many corrections of one step, or after this many steps."""

ROUND_OFF_FRACTION = 2.0**-6
"""Largest error of an unknown after an equal step, as a fraction of its rounding error. The remainder has the same sign
at every step and adds up: with a fraction of 1, galerkin6 drifts 15 times as much. This fraction costs up to a quarter
more evaluations, and a second correction of very short steps. Two corrections in a row at rounding level end the
iteration.
"""

TOLERANCE_FRACTION = 0.02
"""Error of Newton's method in steps with error control, as a fraction of the tolerance."""

SLOW_RATE = 0.25
"""Rebuild the matrix when the contraction rate exceeds this."""

DIVERGENCE_RATE = 0.9
"""With error control, shorten the step when the contraction rate exceeds this."""

RATE_INCREASE, LARGEST_RATE = 1.2, 0.9
"""A step that converges at once does not measure the contraction rate. The stored rate is then multiplied by the first
number per step, up to the second number.
"""

LEAST_RATE = 1e-4
"""Lower bound of the stored contraction rate: one good correction does not predict the next one."""

FRESH_RATE = 1e-3
"""With error control, the next step begins with a new matrix when the contraction rate exceeds this.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

FEW_CORRECTIONS = 2
"""If an equal step needs more corrections than this, the next step begins with a new matrix."""

LARGEST_MATRIX_AGE = 64
"""Rebuild the matrix of equal steps after this many steps, even if it converges.

Otherwise a matrix that has become singular would not be noticed.
"""

STAGNATION_NORM, STAGNATION_RATE = 2.0**10, 0.5
"""With a new matrix, corrections are round-off when their rate exceeds the second number and their norm is below the
first.

The norm is in units of the estimated round-off.
"""

DIVERGENCE_GROWTH = 2.0
"""Give up when large corrections grow by this factor with a new matrix.

The iteration might end at another root.
"""

NOISE_DECAY = 0.9
"""The observed round-off level decays by this factor per step."""


@procedure
def assess_correction(
    newton: Newton,
    iteration: int,
    norm: float,
    previous: float,
    since: int,
    *,
    adaptive: bool,
    constrained: bool = False,
) -> Outcome:
    """Decide by the norms of corrections if Newton's method has converged. Return DONE, PAUSED or DIVERGED.

    PAUSED means that another correction is needed. `iteration` counts corrections from 0, and `since` the corrections
    with the current matrix. `norm` is the size of this correction, and `previous` the size of the last one. The first
    correction measures no contraction rate: the rate of the previous step is used. For a `constrained` step with error
    control (`adaptive`), the rate `DIVERGENCE_RATE` is used instead: there the rate depends on the turning of the
    constraints' gradients, and does not decrease with the step.
    """
    first = iteration == 0
    measured = norm / previous
    expected = DIVERGENCE_RATE if adaptive and constrained else newton.rate
    rate = expected if first else measured
    if is_small(newton, norm, math.inf if first else previous, rate, adaptive):
        aged = smaller(newton.rate * RATE_INCREASE, LARGEST_RATE)
        newton.rate = aged if first else larger(measured, LEAST_RATE)
        schedule_matrix(newton, iteration, measured, adaptive)
        return Outcome.DONE
    if not first and not rate <= SLOW_RATE:
        if adaptive:
            if not rate <= DIVERGENCE_RATE:
                return Outcome.DIVERGED
        else:
            old = since >= MATRIX_AGE
            fresh = since >= 1 and not old
            # With a new matrix, small corrections that do not decrease are rounding.
            if fresh and rate >= STAGNATION_RATE and norm < STAGNATION_NORM:
                newton.noise = 2.0 * norm
                return Outcome.DONE
            if fresh and rate >= DIVERGENCE_GROWTH and norm >= STAGNATION_NORM:
                return Outcome.DIVERGED
            if old:
                request_matrix(newton)
    return Outcome.PAUSED


@inline
def is_small(newton: Newton, norm: float, previous: float, rate: float, adaptive: bool) -> bool:
    """Return True if the error of Newton's iterate is small enough, or two corrections are at rounding level.

    The error is estimated from the sizes `norm` and `previous` of the last two corrections, and their
    contraction `rate`. With error control, `adaptive`, only the estimate counts.
    """
    bound = TOLERANCE_FRACTION if adaptive else newton.noise * ROUND_OFF_FRACTION
    small = norm * rate <= (1.0 - rate) * bound
    return small if adaptive else small or larger(norm, previous) <= newton.noise


@inline
def schedule_matrix(newton: Newton, iteration: int, rate: float, adaptive: bool) -> None:
    """Request a new matrix for the next step if the present one is outdated. Reduce the noise estimate slowly.

    With error control (`adaptive`) a matrix is outdated if the contraction `rate` of the corrections is large. For
    equal steps it is outdated by its age, sooner if the step took many corrections (`iteration`).
    """
    newton.age += 1
    if adaptive:
        outdated = iteration > 0 and rate > FRESH_RATE
    else:
        aged = iteration >= FEW_CORRECTIONS and newton.age >= MATRIX_AGE
        outdated = aged or newton.age >= LARGEST_MATRIX_AGE
        newton.noise = larger(newton.noise * NOISE_DECAY, 1.0)
    if outdated:
        request_matrix(newton)


@inline
def request_matrix(newton: Newton) -> None:
    """Request that the matrix and the derivative of the law are computed again when they are needed next."""
    newton.matrix_step = 0.0
    newton.differentiated = 0
