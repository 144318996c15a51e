"""The error norm of a step, and the absolute tolerances of the entries of the state (their floors)."""

from __future__ import annotations

import math

from lagrange.algorithm.step.constants import LEAST_FLOOR, MOST_SURVEYS
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.step.run import Running, running
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    each,
    fma,
    larger,
    mantissa,
    unrolled,
)
from lagrange.program.step import Control

REJECTIONS_BEFORE_SURVEY = 3
"""Number of consecutive rejections after which a driver asks for the sizes of the entries. It also asks after one
rejection if a step moved an entry that was zero and has no floor. A Taylor driver, whose steps are rejected rarely,
asks at the second, fourth, eighth, ... rejection of a run.
"""

ROUNDED = 2.0**-46
"""An entry may be rounding if its tolerance is below this fraction of the largest entry of its kind: 128 units of
rounding. Kinds are coordinates and velocities. `rounding_noise` then computes whether it is rounding.
"""

DAMPING = 0.01
"""Weight of the second error vector's sum of squares in the norm of DOP853."""


@procedure(arguments=running)
def error_norm(arguments: Running, *, layout: Layout, control: Control) -> float:
    """Return the root mean square of the errors of a trial step, each relative to its tolerance.

    It is accepted if the norm is at most 1. The tolerance of an entry is rtol times its magnitude, plus its
    floor. Two error vectors are combined as in DOP853.
    """
    rtol, floors, work, squares, second_squares = arguments.run.rtol, arguments.floors, arguments.work, 0.0, 0.0
    for state in unrolled(layout.step.states):
        old, new = work[layout.place(state) :], work[layout.place(layout.new + state) :]
        floor, errors = floors[state * layout.length :], errors_of(work, state, layout)
        for i in each(layout.width if layout.step.states == 1 else layout.length):
            scale = fma(rtol, larger(abs(old[i]), abs(new[i])), floor[i])
            ratio = errors[0][i] / scale
            squares = fma(ratio, ratio, squares)
            second_error = errors[1][i] / scale if control.damped else 0.0
            second_squares = fma(second_error, second_error, second_squares)
    n = float(layout.dimension)
    if control.damped:
        mixed = fma(DAMPING, second_squares, squares)
        return squares / math.sqrt(mixed * n if mixed > 0.0 else 1.0)
    return math.sqrt(squares / n)


@inline
def errors_of(work: In, state: int, layout: Layout) -> tuple[Readable[float], ...]:
    """Return the error vectors of state vector number `state`: one, or two for the norm of DOP853."""
    step = layout.step
    return tuple([work[layout.place(layout.errors + k) :] for k in unrolled(state, len(step.errors), step.states)])


@procedure(apart=True, arguments=running)
def reject(arguments: Running, cause: float, h: float, moved: bool, *, layout: Layout) -> bool:
    """Reject a trial step and set the length of the next one. Return True if a run must stop to estimate sizes.

    The caller then estimates the sizes of the entries of the state, from which absolute tolerances follow.
    `cause` is the `Outcome` of the trial, and `h` the shorter length. Sizes are needed after several
    consecutive rejections, or if an entry has no size yet. If the trial `moved` the state, an entry that stayed
    zero does not count. Sizes are also needed at the first, second, fourth, eighth, ... rejection if the entry
    with the largest error may be the rounding of larger entries, as defined at `ROUNDED`.
    """
    run, counts, floors, work = arguments.run, arguments.counts, arguments.floors, arguments.work
    run.cause = cause
    run.h = h
    counts.after_reject += 1
    counts.rejected += 1
    asked = counts.after_reject == REJECTIONS_BEFORE_SURVEY
    for state in unrolled(layout.step.states):
        new, floor = work[layout.place(layout.new + state) :], floors[state * layout.length :]
        blank = 0.0
        for i in each(layout.width if layout.step.states == 1 else layout.length):
            after, least = new[i], floor[i]
            size = abs(after if moved else least)
            blank = larger(blank, size if least <= LEAST_FLOOR else 0.0)
        asked = asked or blank > 0.0
    may_ask = run.share > 0.0 and counts.surveyed < MOST_SURVEYS
    if asked or not may_ask:
        return asked and may_ask
    is_power_of_two = mantissa(float(counts.rejected)) == 1.0
    if not (moved and is_power_of_two):
        return False
    return rounding_errs_most(run.rtol, floors, work, layout)


@inline
def rounding_errs_most(rtol: float, floors: In, work: In, layout: Layout) -> bool:
    """Return True if the entry with the largest error in a trial step may be the rounding of larger entries.

    Such an entry has a tolerance below `ROUNDED` times the largest entry. The vectors of the step are in
    `work`.
    """
    states, half = layout.step.states, layout.dimension // 2
    rounded, significant = 0.0, 0.0
    # Coordinates and velocities have different units.
    for kind in unrolled(2):
        state, begin = (0, kind * half) if states == 1 else (kind, 0)
        old, new = work[layout.place(state) :], work[layout.place(layout.new + state) :]
        floor, errors = floors[state * layout.length :], errors_of(work, state, layout)
        largest = 0.0
        for i in range(begin, begin + half):
            largest = larger(largest, abs(new[i]))
        for i in range(begin, begin + half):
            tolerance = fma(rtol, larger(abs(old[i]), abs(new[i])), floor[i])
            error = abs(errors[0][i])
            for more in errors[1:]:
                error = larger(error, abs(more[i]))
            ratio = error / tolerance
            is_small = tolerance < ROUNDED * largest
            rounded = larger(rounded, ratio if is_small else 0.0)
            significant = larger(significant, 0.0 if is_small else ratio)
    return rounded > significant


@inline
def raise_floors(share: float, floors: Out, work: In, layout: Layout) -> None:
    """Raise the floor (absolute tolerance) of each entry to at least `share` times its new size."""
    single = layout.step.states == 1
    for state in unrolled(layout.step.states):
        new, floor = work[layout.place(layout.new + state) :], floors[state * layout.length :]
        for i in each(layout.width if single else layout.length, spill=single):
            floor[i] = max(floor[i], share * abs(new[i]))
