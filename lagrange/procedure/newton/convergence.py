"""Whether Newton's method has converged, and whether its matrix still serves.

An equal step is solved to round-off, a step with error control far below its tolerance. After a correction the error is
estimated as the rest of a geometric series, with the contraction rate of the last two corrections, or that of the
previous step.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.newton.constants import (
    DIVERGENCE_GROWTH,
    DIVERGENCE_RATE,
    FEW_CORRECTIONS,
    FRESH_RATE,
    LARGEST_MATRIX_AGE,
    LARGEST_RATE,
    LEAST_RATE,
    MATRIX_AGE,
    NOISE_DECAY,
    RATE_INCREASE,
    ROUND_OFF_FRACTION,
    SLOW_RATE,
    STAGNATION_NORM,
    STAGNATION_RATE,
    TOLERANCE_FRACTION,
)
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.shared import shared
from lagrange.procedure.step.memory import NEWTON
from lagrange.procedure.values import Flag, Real, Whole


@shared
def assess_correction(*, adaptive: bool, constrained: bool = False) -> Procedure:
    """Return the assessment of a correction: done, paused if another one is needed, or diverged.

    The rate of the previous step says nothing of a `constrained` step with error control: it is that by which the
    gradients of constraints turn, and does not fall with the length of the step. Its first correction counts as one of
    the largest rate.
    """
    return _Assessment(adaptive=adaptive, measured=adaptive and constrained).build()


class _Assessment:
    """Builds the procedure; `iteration` counts corrections from 0, and `since` those made with the current matrix."""

    def __init__(self, *, adaptive: bool, measured: bool) -> None:
        kind = "constrained" if measured else "controlled" if adaptive else "equal"
        self.p = p = Builder(
            f"assess_correction_{kind}", "Say whether the unknowns are good enough, by the norms of corrections."
        )
        self.adaptive, self.measured = adaptive, measured
        self.newton: Any = p.record("newton", NEWTON)
        self.iteration: Whole = p.given("iteration", WHOLE)
        self.norm: Real = p.given("norm", REAL)
        self.previous: Real = p.given("previous", REAL)
        self.since: Whole = p.given("since", WHOLE)

    def build(self) -> Procedure:
        p, newton = self.p, self.newton
        first = self.iteration.equals(0)
        measured = self.norm / self.previous
        rate = p.choose(first, DIVERGENCE_RATE if self.measured else newton.rate, measured)
        with p.when(self.converged(first, rate)):
            aged = p.smaller(newton.rate * RATE_INCREASE, LARGEST_RATE)
            newton.rate = p.choose(first, aged, p.larger(measured, LEAST_RATE))
            self.schedule_matrix(measured)
            p.leave(Outcome.DONE)
        with p.when(~first & ~(rate <= SLOW_RATE)):
            if self.adaptive:
                p.leave_if(~(rate <= DIVERGENCE_RATE), Outcome.DIVERGED)
            else:
                self.handle_stagnation(rate)
        p.leave(Outcome.PAUSED)
        return p.finish(WHOLE)

    def converged(self, first: Flag, rate: Real) -> Flag:
        """Whether the estimated error is small enough, or two corrections in a row are round-off."""
        p, norm = self.p, self.norm
        left, bound = norm * rate, TOLERANCE_FRACTION if self.adaptive else self.newton.noise * ROUND_OFF_FRACTION
        small: Flag = left <= (1.0 - rate) * bound
        if self.adaptive:
            return small
        both: Real = p.larger(norm, p.choose(first, math.inf, self.previous))
        round_off: Flag = both <= self.newton.noise
        return small | round_off

    def schedule_matrix(self, rate: Real) -> None:
        """Let the next step begin with a new matrix if this one is outdated; reduce the noise estimate slowly."""
        p, newton = self.p, self.newton
        age = newton.age + 1
        newton.age = age
        if self.adaptive:
            outdated = (self.iteration > 0) & (rate > FRESH_RATE)
        else:
            outdated = ((self.iteration >= FEW_CORRECTIONS) & (age >= MATRIX_AGE)) | (age >= LARGEST_MATRIX_AGE)
            newton.noise = p.larger(newton.noise * NOISE_DECAY, 1.0)
        with p.when(outdated):
            self.request_matrix()

    def handle_stagnation(self, rate: Real) -> None:
        """With a new matrix, accept small corrections that do not shrink, and give up when large ones grow."""
        p, norm = self.p, self.norm
        old = self.since >= MATRIX_AGE
        fresh = (self.since >= 1) & ~old
        with p.when(fresh & (rate >= STAGNATION_RATE) & (norm < STAGNATION_NORM)):
            self.newton.noise = 2.0 * norm
            p.leave(Outcome.DONE)
        p.leave_if(fresh & (rate >= DIVERGENCE_GROWTH) & (norm >= STAGNATION_NORM), Outcome.DIVERGED)
        with p.when(old):
            self.request_matrix()

    def request_matrix(self) -> None:
        """Let the matrix and the derivative of the law be computed anew when they are needed next."""
        self.newton.matrix_step = 0.0
        self.newton.differentiated = 0
