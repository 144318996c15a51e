"""Length of the first step of a run with error control, and the first absolute tolerances (floors).

The length of the first step follows from the change of the derivatives of the state over a short trial step. The jerk
divided by the velocity is the square of a rate, in any units of the entries and for any origin of time and coordinates.
If it is not defined, the rate comes from the acceleration divided by the coordinate, or from the square of the
acceleration divided by the velocity. The size of an entry is at least the size at which the relative tolerance equals
its absolute tolerance, its floor. If floors follow the sizes, the floor of an entry that is zero begins at its change
in the step. An acceleration that may be rounding of cancelling terms, as at an equilibrium, is replaced by its
sensitivity to the coordinate.

Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., 1993, II.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lagrange.algorithm.constants import (
    DEFAULT_FIRST,
    FIRST_SHARE,
    FIRST_TRIAL,
    RELATIVE_PERTURBATION,
    SLOPE_NOISE,
    SPACING,
    perturbation_factors,
)
from lagrange.algorithm.step.memory import Layout, Running, running
from lagrange.algorithm.step.vectors import copy_vector
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, larger, smaller, unrolled
from lagrange.program.step import LAWS
from lagrange.program.step_size_control import Control

CANCELLATION = 2.0**-12
"""Threshold of an acceleration as a fraction of its sensitivity, below which it may be only the rounding error of terms
that cancel. The sensitivity is the change of the acceleration when each entry of the state changes by about its size.
"""

CANCELLATION_DOMINANCE = 16.0
"""Largest ratio of two squared rates at the start of a run: the largest of the accelerations that may be only rounding
errors, and the largest of the other accelerations. Above it the rounding errors would determine the first step, so the
sizes of the entries are estimated first.
"""

LEAST_FIRST = 2.0**-44
"""Least absolute tolerance (floor) of an entry of the state that is zero, as a fraction of its change in the first
step. It is positive because Newton's method has to converge to an error below the tolerance.
"""

LEAST_SPACINGS = 64.0
"""Least length of the first step, as a multiple of the shortest step with which a run may continue at its start time.
The first step is only an estimate, and must not end the run as too small.
"""

NEEDS_SIZES = -1.0
"""Result of `first_step` if the caller has to estimate the sizes of the entries first."""


@procedure(noinline=True, arguments=running)
def first_step(arguments: Running, span: float, direction: float, *, layout: Layout, control: Control) -> float:
    """Return the length of the first step of a run, by the derivatives at three states, or NEEDS_SIZES.

    `span` is the duration of the run, positive, and `direction` its sign. NEEDS_SIZES: the caller must first
    estimate the sizes of the entries. For methods in momenta, which have no derivatives of the state, the length is
    a fraction of `span`. The formulas are at the top of this file.
    """
    run, counts, floors, half = arguments.run, arguments.counts, arguments.floors, layout.dimension // 2
    floors_follow = run.share > 0.0
    lacks_sizes = floors_follow and counts.surveyed == 0
    least = abs(run.t) * (LEAST_SPACINGS * SPACING)
    if LAWS[layout.step.law].results > 1:
        if lacks_sizes:
            return NEEDS_SIZES
        return smaller(larger(DEFAULT_FIRST * span, least), span)
    slopes = slopes_of(arguments, layout)
    singular = evaluate(arguments, run.t, arguments.work, slopes.start, layout)
    rate = trial_rate(arguments.work, slopes.start, floors, run.rtol, half)
    trial = smaller(FIRST_SHARE / rate if rate > 0.0 else FIRST_TRIAL * span, span)
    failed = probe(arguments, slopes, trial * direction, layout)
    singular = singular or failed
    doubtful, certain, stiffness, moving = squared_rates(arguments, slopes, trial, layout)
    is_uncertain = doubtful > CANCELLATION_DOMINANCE * certain or moving == 0.0
    if is_uncertain and lacks_sizes and not singular:
        return NEEDS_SIZES
    if singular:
        return DEFAULT_FIRST * span
    change = math.sqrt(larger(larger(doubtful, certain), stiffness))
    rate = change if change > 0.0 and change < math.inf else rate
    aim = (FIRST_SHARE * run.rtol) ** (1.0 / control.exponent)
    h = smaller(larger(aim / rate if rate > 0.0 else DEFAULT_FIRST * span, least), span)
    if floors_follow:
        first_floors(arguments, slopes, h, h / trial, layout)
        noise_floors(floors, slopes.sensitivity, 1.0 / rate if rate > 0.0 else 0.0, half)
    return h


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the state near the start of a run, in vectors of the step that no trial step has used yet.

    `start` is the derivative at the start, `later` the derivative after an Euler step, and `perturbed` the
    derivative at a slightly perturbed state. `sensitivity` has the sensitivity to the state of each acceleration that
    may consist of rounding errors only. Its other entries are zero.
    """

    start: Out
    later: Out
    perturbed: Out
    sensitivity: Out


@inline
def slopes_of(arguments: Running, layout: Layout) -> Slopes:
    """Return the vectors in which `first_step` stores derivatives of the state."""
    work = arguments.work
    start, later = work[layout.place(layout.vectors - 1) :], work[layout.place(layout.errors) :]
    return Slopes(start, later, work[layout.result :], work[layout.place(layout.new) :])


@inline
def probe(arguments: Running, slopes: Slopes, move: float, layout: Layout) -> bool:
    """Write the slopes after an Euler step of the length `move` and at a perturbed start.

    The result is True if a mass matrix is singular.
    """
    t, y, argument = arguments.run.t, arguments.work[0:], arguments.work[layout.argument :]
    for i in each(layout.width, spill=True, disjoint=True):
        argument[i] = fma(move, slopes.start[i], y[i])
    failed_later = evaluate(arguments, t + move, argument, slopes.later, layout)
    for k, factor in enumerate(perturbation_factors(layout.dimension).tolist()):
        argument[k] = y[k] * (1 + RELATIVE_PERTURBATION * factor)
    failed_perturbed = evaluate(arguments, t, argument, slopes.perturbed, layout)
    return failed_later or failed_perturbed


@inline
def squared_rates(
    arguments: Running, slopes: Slopes, trial: float, layout: Layout
) -> tuple[float, float, float, float]:
    """Return four numbers by which the first step is chosen.

    They are the largest squared rate of the doubtful accelerations, that of the other accelerations, the stiffness, and
    the largest slope. A doubtful acceleration may be only the rounding error of terms that cancel. The stiffness is the
    largest sensitivity of such an acceleration, divided by its coordinate. The sensitivities are written to `slopes`.
    `trial` is the length of the Euler step.
    """
    y, rtol, floors, half = arguments.work[0:], arguments.run.rtol, arguments.floors, layout.dimension // 2
    doubtful, certain, stiffness, moving = 0.0, 0.0, 0.0, 0.0
    for i in range(half):
        below = i + half
        acceleration = slopes.start[below]
        force, position_size, speed = abs(acceleration), size(y, floors, rtol, i), size(y, floors, rtol, below)
        has_position, has_speed = abs(y[i]) > 0.0, abs(y[below]) > 0.0
        sensed = abs(slopes.perturbed[below] - acceleration) / RELATIVE_PERTURBATION
        is_doubtful = force < CANCELLATION * sensed
        jerk = abs(slopes.later[below] - acceleration) / trial / speed if has_speed else 0.0
        ratio = force / speed
        fallback = smaller(
            force / position_size if has_position else math.inf, ratio * ratio if has_speed else math.inf
        )
        square = jerk if jerk > 0.0 else fallback if has_position or has_speed else 0.0
        doubtful = larger(doubtful, square if is_doubtful else 0.0)
        certain = larger(certain, 0.0 if is_doubtful else square)
        moving = larger(moving, larger(force, abs(slopes.start[i])))
        stiffness = larger(stiffness, sensed / position_size if is_doubtful and has_position else 0.0)
        slopes.sensitivity[below] = sensed if is_doubtful else 0.0
    return doubtful, certain, stiffness, moving


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

    A rate is the square root of acceleration / coordinate, or acceleration / velocity if the coordinate is
    zero. The accelerations are in the derivative `slope` of the state y. The first `coordinate_count` entries
    of the state are coordinates, the others velocities.
    """
    rate = 0.0
    for i in range(coordinate_count):
        force, position_size = abs(slope[i + coordinate_count]), size(y, floors, rtol, i)
        speed = size(y, floors, rtol, i + coordinate_count)
        fallback = force / speed if abs(y[i + coordinate_count]) > 0.0 else 0.0
        rate = larger(rate, math.sqrt(force / position_size) if abs(y[i]) > 0.0 else fallback)
    return rate


@inline
def first_floors(arguments: Running, slopes: Slopes, h: float, longer: float, layout: Layout) -> None:
    """Raise the floors (absolute tolerances) of zero entries to a fraction of their change in the first step.

    The change follows from the derivative at the start. If this derivative is zero, the change follows from the
    derivative at the end of the step, which is extrapolated from the trial step. The first step has the length h,
    which is `longer` times the length of the trial step.
    """
    y, floors = arguments.work[0:], arguments.floors
    factor = larger(arguments.run.share, LEAST_FIRST) * h
    for i in each(layout.width, spill=True, disjoint=True):
        start_slope, floor = slopes.start[i], floors[i]
        ahead = abs(fma(slopes.later[i] - start_slope, longer, start_slope))
        still = ahead < math.inf and abs(start_slope) == 0.0
        reach = factor * (ahead if still else abs(start_slope))
        floors[i] = max(floor, reach if y[i] == 0.0 else 0.0)


@inline
def noise_floors(floors: Out, sensitivity: In, period: float, coordinate_count: int) -> None:
    """Raise floors (absolute tolerances) above the effect of rounding errors of accelerations over a `period`.

    Only accelerations whose terms cancel count. For these `sensitivity` has the change of the acceleration when
    each entry of the state changes by about its size; for all others it is zero. The first `coordinate_count`
    entries of both arrays belong to coordinates, the others to velocities.
    """
    for i in range(coordinate_count):
        below = i + coordinate_count
        noise = period * SLOPE_NOISE * sensitivity[below]
        floors[i] = larger(floors[i], period * noise)
        floors[below] = larger(floors[below], noise)
