"""The length of the first step, from the change of slopes over a short trial step.

The jerk divided by the velocity is the square of a rate, in any units of the entries and of time and for any origin of
the coordinates. If it is not defined, the acceleration divided by the coordinate is used, or the one divided by the
velocity, squared. The size of an entry is at least the size whose tolerance is its floor. If floors follow the scale,
the floor of an entry that is zero begins at what the step adds to it. An acceleration that may be round-off of
cancelling terms, as at an equilibrium, is replaced by its sensitivity to the coordinate.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Procedure
from lagrange.procedure.step.constants import (
    CANCELLATION,
    CANCELLATION_DOMINANCE,
    DEFAULT_FIRST,
    FIRST_SHARE,
    FIRST_TRIAL,
    LEAST_FIRST,
    LEAST_SPACINGS,
    RELATIVE_PERTURBATION,
    SLOPE_NOISE,
    SPACING,
    perturbation_factors,
)
from lagrange.procedure.step.error_norm import higher
from lagrange.procedure.step.memory import Layout
from lagrange.procedure.step.trial import Running
from lagrange.procedure.values import Flag, Memory, Real, Whole
from lagrange.program.actions import LAWS
from lagrange.program.step import Control

NEEDS_SIZES = -1.0
"""The result if the caller has to estimate the sizes of the entries first."""


def first_step(layout: Layout, control: Control) -> Procedure:
    """Return the procedure that chooses the size of the first step within a span; see `NEEDS_SIZES`."""
    return _FirstStep(layout, control).build()


class _Size(NamedTuple):
    """The size of an entry including its floor, and whether the entry is not zero."""

    whole: Real
    some: Flag


class _FirstStep:
    """Builds the procedure.

    The second half of `sensitivity` has, for accelerations that may be round-off, their derivative by the state times
    its size.
    """

    def __init__(self, layout: Layout, control: Control) -> None:
        self.p = p = Builder("first_step", "Return the size of a first step from three slopes.", apart=True)
        self.layout, self.control, self.half = layout, control, layout.dimension // 2
        self.given = Running(p, layout)
        self.run, self.work, self.floors = self.given.run, self.given.work, self.given.floors
        self.span, self.direction = p.given("span", REAL), p.given("direction", REAL)

    def build(self) -> Procedure:
        p, run, layout, work = self.p, self.run, self.layout, self.work
        if LAWS[layout.step.law].results > 1:
            return self.without_slopes()
        self.y, self.argument, self.result = work.at(0), work.at(layout.argument), work.at(layout.result)
        self.slope, self.later = work.at(layout.place(layout.vectors - 1)), work.at(layout.place(layout.errors))
        self.sensitivity = work.at(layout.place(layout.new))
        self.t, self.follows = run.t, run.share > 0.0
        self.singular = p.variable(p.false, "singular")
        self.evaluate(self.t, self.y, self.slope)
        rate = self.trial_rate()
        trial = p.smaller(p.choose(rate > 0.0, FIRST_SHARE / rate, FIRST_TRIAL * self.span), self.span)
        self.move(trial * self.direction)
        squared = self.squared_rate(trial)
        with p.when(self.singular.value):
            p.leave(DEFAULT_FIRST * self.span)
        change = p.sqrt(squared)
        rate = p.choose((change > 0.0) & (change < math.inf), change, rate)
        aim = (FIRST_SHARE * run.rtol) ** (1.0 / self.control.exponent)
        some = rate > 0.0
        least = abs(self.t) * (LEAST_SPACINGS * SPACING)
        h = p.smaller(p.larger(p.choose(some, aim / rate, DEFAULT_FIRST * self.span), least), self.span).called("h")
        with p.when(self.follows):
            self.first_floors(h, h / trial)
            self.noise_floors(p.choose(some, 1.0 / rate, 0.0))
        p.leave(h)
        return p.finish(REAL)

    def without_slopes(self) -> Procedure:
        """Build the procedure of a law without slopes: the caller estimates the sizes, and errors show the rest."""
        p, run, counts = self.p, self.run, self.given.counts
        p.leave_if((run.share > 0.0) & counts.surveyed.equals(0), NEEDS_SIZES)
        least = abs(run.t) * (LEAST_SPACINGS * SPACING)
        p.leave(p.smaller(p.larger(DEFAULT_FIRST * self.span, least), self.span))
        return p.finish(REAL)

    def evaluate(self, t: Real, y: Memory, out: Memory) -> None:
        """Evaluate the right-hand side at a state, in whole blocks."""
        p, laws, n = self.p, self.given.laws, self.layout.dimension
        if self.layout.in_registers:
            state = [y[i] for i in range(n)]
            *found, failed = laws.law(t, *state, laws.parameters)
            values = [*state[self.half :], *found, *[p.constant(0.0, REAL)] * (self.layout.width - n)]
            for k, value in enumerate(values):
                out[k] = value
        else:
            failed = laws.law(t, y, laws.parameters, self.result)
            p.copy(self.result, out, self.layout.width)
        self.singular.value = self.singular.value | failed

    def size(self, i: Whole) -> _Size:
        size = abs(self.y[i])
        return _Size(size + self.floors[i] / self.run.rtol, size > 0.0)

    def trial_rate(self) -> Real:
        """Return the rate that gives the trial length, from accelerations alone."""
        p, rate = self.p, self.p.variable(0.0, "rate")
        with p.loop(0, self.half) as i:
            force, place, speed = abs(self.slope[i + self.half]), self.size(i), self.size(i + self.half)
            other = p.choose(speed.some, force / speed.whole, 0.0)
            rate.value = p.larger(rate.value, p.choose(place.some, p.sqrt(force / place.whole), other))
        return p.real(rate.value)

    def move(self, h: Real) -> None:
        """Evaluate the right-hand side after an Euler step of h, and at a slightly perturbed state."""
        p = self.p
        with p.each(self.layout.width, spill=True) as i:
            self.argument[i] = p.fma(h, self.slope[i], self.y[i])
        self.evaluate(self.t + h, self.argument, self.later)
        for k, factor in enumerate(perturbation_factors(self.layout.dimension).tolist()):
            self.argument[k] = self.y[k] * (1 + RELATIVE_PERTURBATION * factor)
        self.evaluate(self.t, self.argument, self.result)

    def squared_rate(self, trial: Real) -> Real:
        """Return the square of the rate for the first step; leave to ask for sizes if it is not determined."""
        p, half = self.p, self.half
        doubtful, others, moving, paired = (p.variable(0.0) for _ in range(4))
        with p.loop(0, half) as i:
            below = i + half
            here = self.slope[below]
            force, place, speed = abs(here), self.size(i), self.size(below)
            sensitivity = abs(self.result[below] - here) / RELATIVE_PERTURBATION
            doubt = force < CANCELLATION * sensitivity
            jerk = p.choose(speed.some, abs(self.later[below] - here) / trial / speed.whole, 0.0)
            part = force / speed.whole
            other = p.smaller(
                p.choose(place.some, force / place.whole, math.inf), p.choose(speed.some, part * part, math.inf)
            )
            square = p.choose(jerk > 0.0, jerk, p.choose(place.some | speed.some, other, 0.0))
            largest: list[tuple[Any, Real]] = [
                (doubtful, p.choose(doubt, square, 0.0)),
                (others, p.choose(doubt, 0.0, square)),
                (moving, p.larger(force, abs(self.slope[i]))),
                (paired, p.choose(doubt & place.some, sensitivity / place.whole, 0.0)),
            ]
            for variable, value in largest:
                variable.value = p.larger(variable.value, value)
            self.sensitivity[below] = p.choose(doubt, sensitivity, 0.0)
        asked = (doubtful.value > CANCELLATION_DOMINANCE * others.value) | moving.value.equals(0.0)
        p.leave_if(self.follows & self.given.counts.surveyed.equals(0) & asked & ~self.singular.value, NEEDS_SIZES)
        return p.real(p.larger(p.larger(doubtful.value, others.value), paired.value))

    def first_floors(self, h: Real, longer: Real) -> None:
        """Let the floors of entries that are zero begin at what a step of h adds by its slopes."""
        p = self.p
        factor = p.larger(self.run.share, LEAST_FIRST) * h
        with p.each(self.layout.width, spill=True) as i:
            here = self.slope[i]
            ahead = abs(p.fma(self.later[i] - here, longer, here))
            still = (ahead < math.inf) & abs(here).equals(0.0)
            reach = factor * p.choose(still, ahead, abs(here))
            self.floors[i] = higher(p, p.choose(self.y[i].equals(0.0), reach, 0.0), self.floors[i])

    def noise_floors(self, period: Real) -> None:
        """Raise the floors above the round-off of accelerations that cancel, over a period."""
        p, floors = self.p, self.floors
        with p.loop(0, self.half) as i:
            below = i + self.half
            noise = period * SLOPE_NOISE * self.sensitivity[below]
            floors[i] = p.larger(floors[i], period * noise)
            floors[below] = p.larger(floors[below], noise)
