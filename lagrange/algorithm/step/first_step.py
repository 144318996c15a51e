"""The length of the first step, from the change of the derivatives of the state over a short trial step.

The jerk divided by the velocity is the square of a rate, in any units of the entries and for any origin of time
and coordinates. If it is not defined, the rate comes from the acceleration divided by the coordinate, or from
the square of the acceleration divided by the velocity. The size of an entry is at least that for which the
relative tolerance equals its absolute tolerance, its floor. If floors follow the sizes, the floor of an entry
that is zero begins at its change in the step. An acceleration that may be rounding of cancelling terms, as at
an equilibrium, is replaced by its sensitivity to the coordinate.
"""

from __future__ import annotations

import math

from lagrange.algorithm.step.constants import (
    DEFAULT_FIRST,
    FIRST_SHARE,
    FIRST_TRIAL,
    RELATIVE_PERTURBATION,
    SLOPE_NOISE,
    SPACING,
    perturbation_factors,
)
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.step.run import Running, running
from lagrange.algorithm.step.vectors import copy_vector
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, larger, smaller, unrolled
from lagrange.program.step import LAWS, Control

CANCELLATION = 2.0**-12
"""An acceleration may be rounding of cancelling terms if it is below this fraction of its sensitivity. The sensitivity
is the change of the acceleration when each entry of the state changes by about its size.
"""

CANCELLATION_DOMINANCE = 16.0
"""Accelerations that may be rounding must not determine the first step. If their squared rate exceeds this multiple of
that of the others, the sizes of the entries are estimated.
"""

LEAST_FIRST = 2.0**-44
"""Least floor of an entry that is zero, as a fraction of its change in the first step. Newton's method has to converge
below the floor.
"""

LEAST_SPACINGS = 64.0
"""The first step is at least this multiple of the shortest step. It is only an estimate, and must not end the run as
too small.
"""

NEEDS_SIZES = -1.0
"""Result if the caller has to estimate the sizes of the entries first."""


@procedure(apart=True, arguments=running)
def first_step(arguments: Running, span: float, direction: float, *, layout: Layout, control: Control) -> float:
    """Return the length of the first step of a run, from the derivatives at three states, or NEEDS_SIZES.

    `span` is the duration of the run, and `direction` its sign. NEEDS_SIZES means that the caller must estimate
    the sizes of the entries. Without derivatives, as for methods in momenta, the length is a fraction of the span.
    """
    run, work, floors, half = arguments.run, arguments.work, arguments.floors, layout.dimension // 2
    t, follows = run.t, run.share > 0.0
    least = abs(t) * (LEAST_SPACINGS * SPACING)
    if LAWS[layout.step.law].results > 1:
        if follows and arguments.counts.surveyed == 0:
            return NEEDS_SIZES
        return smaller(larger(DEFAULT_FIRST * span, least), span)
    # Vectors of the step that are unused before its first trial. `later` are slopes after an Euler step.
    y, argument, result = work[0:], work[layout.argument :], work[layout.result :]
    slope, later = work[layout.place(layout.vectors - 1) :], work[layout.place(layout.errors) :]
    sensitivity = work[layout.place(layout.new) :]
    singular = evaluate(arguments, t, y, slope, layout)
    rate = trial_rate(y, slope, floors, run.rtol, half)
    trial = smaller(FIRST_SHARE / rate if rate > 0.0 else FIRST_TRIAL * span, span)
    # Slopes after an Euler step, and at a slightly perturbed state.
    move = trial * direction
    for i in each(layout.width, spill=True, disjoint=True):
        argument[i] = fma(move, slope[i], y[i])
    failed_later = evaluate(arguments, t + move, argument, later, layout)
    for k, factor in enumerate(perturbation_factors(layout.dimension).tolist()):
        argument[k] = y[k] * (1 + RELATIVE_PERTURBATION * factor)
    failed_beside = evaluate(arguments, t, argument, result, layout)
    singular = singular or failed_later or failed_beside
    doubtful, certain, moving, paired = 0.0, 0.0, 0.0, 0.0
    for i in range(half):
        below = i + half
        acceleration = slope[below]
        force, position_size, speed = abs(acceleration), size(y, floors, run.rtol, i), size(y, floors, run.rtol, below)
        has_position, has_speed = abs(y[i]) > 0.0, abs(y[below]) > 0.0
        sensed = abs(result[below] - acceleration) / RELATIVE_PERTURBATION
        # An acceleration that may be round-off of cancelling terms.
        is_doubtful = force < CANCELLATION * sensed
        jerk = abs(later[below] - acceleration) / trial / speed if has_speed else 0.0
        part = force / speed
        fallback = smaller(force / position_size if has_position else math.inf, part * part if has_speed else math.inf)
        square = jerk if jerk > 0.0 else fallback if has_position or has_speed else 0.0
        doubtful = larger(doubtful, square if is_doubtful else 0.0)
        certain = larger(certain, 0.0 if is_doubtful else square)
        moving = larger(moving, larger(force, abs(slope[i])))
        paired = larger(paired, sensed / position_size if is_doubtful and has_position else 0.0)
        sensitivity[below] = sensed if is_doubtful else 0.0
    asked = doubtful > CANCELLATION_DOMINANCE * certain or moving == 0.0
    if follows and arguments.counts.surveyed == 0 and asked and not singular:
        return NEEDS_SIZES
    if singular:
        return DEFAULT_FIRST * span
    change = math.sqrt(larger(larger(doubtful, certain), paired))
    rate = change if change > 0.0 and change < math.inf else rate
    aim = (FIRST_SHARE * run.rtol) ** (1.0 / control.exponent)
    h = smaller(larger(aim / rate if rate > 0.0 else DEFAULT_FIRST * span, least), span)
    if follows:
        first_floors(arguments, h, h / trial, layout)
        noise_floors(floors, sensitivity, 1.0 / rate if rate > 0.0 else 0.0, half)
    return h


@inline
def evaluate(arguments: Running, t: float, y: In, out: Out, layout: Layout) -> bool:
    """Write the right-hand side at time t and state y to `out`. Return True if a matrix is singular."""
    n = layout.dimension
    if not layout.in_registers:
        result = arguments.work[layout.result :]
        failed: bool = arguments.law(t, y, arguments.parameters, result)
        copy_vector(result, out, layout.width)
        return failed
    state = tuple([y[i] for i in unrolled(n)])
    results = arguments.law(t, *state, arguments.parameters)
    for k, value in enumerate((*state[n // 2 :], *results[:-1])):
        out[k] = value
    for k in unrolled(n, layout.width):
        out[k] = 0.0
    singular: bool = results[-1]
    return singular


@inline
def size(y: In, floors: In, rtol: float, i: int) -> float:
    """Return the size of entry i of a state for tolerances: its magnitude, plus its floor divided by `rtol`."""
    return abs(y[i]) + floors[i] / rtol


@inline
def trial_rate(y: In, slope: In, floors: In, rtol: float, coordinate_count: int) -> float:
    """Return the largest rate (1 / time) of the entries of a state; it determines the length of the trial step.

    It follows from the state y and its derivative `slope`, with accelerations alone. The first
    `coordinate_count` entries of the state are coordinates, the others velocities.
    """
    rate = 0.0
    for i in range(coordinate_count):
        force, position_size, speed = (
            abs(slope[i + coordinate_count]),
            size(y, floors, rtol, i),
            size(y, floors, rtol, i + coordinate_count),
        )
        fallback = force / speed if abs(y[i + coordinate_count]) > 0.0 else 0.0
        rate = larger(rate, math.sqrt(force / position_size) if abs(y[i]) > 0.0 else fallback)
    return rate


@inline
def first_floors(arguments: Running, h: float, longer: float, layout: Layout) -> None:
    """Raise the floors (absolute tolerances) of zero entries to a fraction of their change in a step.

    The change follows from the derivative at the start. If that is zero, it follows from the derivative at the
    end of the step, which is extrapolated from the trial step. The step has the length h, which is `longer`
    times the trial step.
    """
    work, floors = arguments.work, arguments.floors
    y, slope, later = work[0:], work[layout.place(layout.vectors - 1) :], work[layout.place(layout.errors) :]
    factor = larger(arguments.run.share, LEAST_FIRST) * h
    for i in each(layout.width, spill=True, disjoint=True):
        start_slope, floor = slope[i], floors[i]
        ahead = abs(fma(later[i] - start_slope, longer, start_slope))
        still = ahead < math.inf and abs(start_slope) == 0.0
        reach = factor * (ahead if still else abs(start_slope))
        floors[i] = max(floor, reach if y[i] == 0.0 else 0.0)


@inline
def noise_floors(floors: Out, sensitivity: In, period: float, coordinate_count: int) -> None:
    """Raise floors (absolute tolerances) above the effect of rounding errors of accelerations over a `period`.

    These are accelerations whose terms cancel. `sensitivity` has their changes under a relative change of the
    state, and zero for all others. The first `coordinate_count` floors are those of coordinates.
    """
    for i in range(coordinate_count):
        below = i + coordinate_count
        noise = period * SLOPE_NOISE * sensitivity[below]
        floors[i] = larger(floors[i], period * noise)
        floors[below] = larger(floors[below], noise)
