"""Whether a correction was the last one, and what it says about the matrix.

A step of equal length is solved to round-off, one that follows the error far below its tolerance. What is left after a
correction is the rest of a geometric series: corrections shrink by the `rate` that the last two show, or those of the
step before.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

from __future__ import annotations

import math
from functools import cache
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
from lagrange.procedure.step.memory import NEWTON
from lagrange.procedure.values import Flag, Real, Whole


@cache
def assess_correction(*, adaptive: bool) -> Procedure:
    """Return the judgement of a correction: done, paused where another one is wanted, or diverged."""
    return _Assessment(adaptive=adaptive).build()


class _Assessment:
    """Builds the procedure; `iteration` counts corrections from 0, and `since` those that the matrix has made."""

    def __init__(self, *, adaptive: bool) -> None:
        kind = "controlled" if adaptive else "equal"
        self.p = p = Builder(
            f"assess_correction_{kind}", "Say whether the unknowns are good enough, by the norms of corrections."
        )
        self.adaptive = adaptive
        self.newton: Any = p.record("newton", NEWTON)
        self.iteration: Whole = p.given("iteration", WHOLE)
        self.norm: Real = p.given("norm", REAL)
        self.previous: Real = p.given("previous", REAL)
        self.since: Whole = p.given("since", WHOLE)

    def build(self) -> Procedure:
        p, newton = self.p, self.newton
        first = self.iteration.equals(0)
        measured = self.norm / self.previous
        rate = p.choose(first, newton.rate, measured)
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
        """Whether what is left is too small to matter, or two corrections in a row are round-off."""
        p, norm = self.p, self.norm
        left, bound = norm * rate, TOLERANCE_FRACTION if self.adaptive else self.newton.noise * ROUND_OFF_FRACTION
        small: Flag = left <= (1.0 - rate) * bound
        if self.adaptive:
            return small
        both: Real = p.larger(norm, p.choose(first, math.inf, self.previous))
        round_off: Flag = both <= self.newton.noise
        return small | round_off

    def schedule_matrix(self, rate: Real) -> None:
        """Have the next step begin with a new matrix where this one is outdated; forget noise slowly."""
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
        """Take the unknowns where a new matrix no longer shrinks small corrections; give up where large ones grow."""
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
        """Have the matrix and the derivative of the law made anew where they are needed next."""
        self.newton.matrix_step = 0.0
        self.newton.differentiated = 0
