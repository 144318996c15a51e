"""Steps of any method but Taylor series: error norm, acceptance or rejection, and the length of the next step.

The floors are the absolute tolerances of the entries of the state. Numbers of a method, such as the safety factor, are
in lagrange/program/step_size_control.py. Source: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
Equations I, 2nd ed., 1993, II.4 and II.10, and its programs DOPRI5 and DOP853.

Integrators for export are procedures for one step, and for a run to an end time. The functions of the system, such as
the right-hand side, are parameters, which `lagrange.procedure.rewrite` replaces by procedures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    EARLIEST,
    FAR_FROM_ZERO,
    LEAST_FLOOR,
    MOST_SURVEYS,
    SPACING,
    STRETCH_TO_END,
    Outcome,
)
from lagrange.algorithm.projection import CORRECTIONS, project, starts_on_constraints
from lagrange.algorithm.step.first_step import first_step
from lagrange.algorithm.step.memory import FUNCTION, Counts, Effort, Layout, Run, Running, running
from lagrange.algorithm.step.trial import accept_step, project_new_state, rows_array, take_step, try_step
from lagrange.procedure.form import Array, Procedure
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    clear,
    each,
    fma,
    larger,
    likely,
    mantissa,
    reals,
    smaller,
    unrolled,
)
from lagrange.program.step import LAWS
from lagrange.program.step_size_control import Control

REJECTIONS_BEFORE_SURVEY = 3
"""Number of consecutive rejections after which a run estimates the sizes of the state's entries. One rejection suffices
if a step moved an entry that was zero and has the absolute tolerance 0. A Taylor run, whose steps are rejected rarely,
estimates the sizes at its second, fourth, eighth, ... rejection.
"""

ROUNDED = 2.0**-46
"""Tolerance of an entry of the state below which the entry may be only rounding noise, as a fraction (128 units of
rounding) of the largest entry of its kind, coordinate or velocity. `rounding_noise` then decides if it is.
"""

DAMPING = 0.01
"""Weight of the second error vector's sum of squares in the norm of DOP853."""


@procedure(arguments=running)
def error_norm(arguments: Running, *, layout: Layout, control: Control) -> float:
    """Return the root mean square of the errors of a trial step, each divided by its tolerance.

    The step is accepted if the norm is at most 1. The tolerance of an entry is rtol times its magnitude, plus its
    floor. The magnitude is the larger of the magnitudes in the old and the new state. Two error vectors are
    combined as in DOP853.
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
    """Return the error vectors of state vector number `state`, parts of `work`.

    There are two vectors for the norm of DOP853, otherwise one.
    """
    step = layout.step
    return tuple([work[layout.place(layout.errors + k) :] for k in unrolled(state, len(step.errors), step.states)])


@procedure(noinline=True, arguments=running)
def reject(arguments: Running, cause: float, h: float, moved: bool, *, layout: Layout) -> bool:
    """Reject a trial step, and set the length of the next step to h. Return True if sizes must be estimated.

    If so, the run stops, and the caller estimates the sizes of the state's entries, from which absolute tolerances
    follow. `cause` is the `Outcome` of the trial. Sizes are needed after several consecutive rejections, or if an
    entry has no size yet. If the trial `moved` the state, an entry that stayed zero does not count. Sizes are also
    needed at the first, second, fourth, eighth, ... rejection if the entry with the largest error may be the
    rounding of larger entries, as defined at `ROUNDED`.
    """
    run, counts, floors, work = arguments.run, arguments.counts, arguments.floors, arguments.work
    run.cause = cause
    run.h = h
    counts.after_reject += 1
    counts.rejected += 1
    is_due = counts.after_reject == REJECTIONS_BEFORE_SURVEY
    for state in unrolled(layout.step.states):
        new, floor = work[layout.place(layout.new + state) :], floors[state * layout.length :]
        blank = 0.0
        for i in each(layout.width if layout.step.states == 1 else layout.length):
            after, least = new[i], floor[i]
            size = abs(after if moved else least)
            blank = larger(blank, size if least <= LEAST_FLOOR else 0.0)
        is_due = is_due or blank > 0.0
    may_ask = run.share > 0.0 and counts.surveyed < MOST_SURVEYS
    if is_due or not may_ask:
        return is_due and may_ask
    is_power_of_two = mantissa(float(counts.rejected)) == 1.0
    if not (moved and is_power_of_two):
        return False
    return rounding_errs_most(run.rtol, floors, work, layout)


@inline
def rounding_errs_most(rtol: float, floors: In, work: In, layout: Layout) -> bool:
    """Return True if the entry with the largest error in a trial step may be only rounding of larger entries.

    Its tolerance is then below `ROUNDED` times the largest entry of its kind, coordinate or velocity. `work`
    has the old and the new state, and the errors. `floors` are the absolute tolerances.
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
    """Raise the floor (absolute tolerance) of each entry to at least `share` times its magnitude.

    The new state of a trial step, from which the magnitudes are taken, is in `work`.
    """
    single = layout.step.states == 1
    for state in unrolled(layout.step.states):
        new, floor = work[layout.place(layout.new + state) :], floors[state * layout.length :]
        for i in each(layout.width if single else layout.length, spill=single):
            floor[i] = max(floor[i], share * abs(new[i]))


SHORTEST_LAST_STEP = 1e-6
"""Least length of the last of several fixed steps, as a fraction of the step length. A shorter last step comes only
from rounding of the grid of times, and is merged with the previous step.
"""

UNROLLED_TEST = 2
"""Largest number of blocks of a vector for which the test for finite entries is written out."""


@procedure(arguments=running, rows=rows_array)
def fixed_steps(arguments: Running, budget: int, times: Out, rows: Out, *, layout: Layout) -> Outcome:
    """Take steps of equal length. Return DONE at the end of the run, PAUSED after `budget` steps, or a failure.

    If rows are recorded, the time and state after each step are written to `times` and `rows`. Time number k is
    `start + k*h`, rounded once, so that errors of the times do not add up.
    """
    run, counts = arguments.run, arguments.counts
    discard_history(arguments, layout)
    entries = kept_entries(arguments, layout)
    start, end, h = run.start, run.end, run.step
    for _ in range(budget):
        t = run.t
        if t == end:
            return Outcome.DONE
        grid = fma(float(counts.steps + 1), h, start)
        left = end - fma(SHORTEST_LAST_STEP, h, grid)
        is_last = (-left if h < 0.0 else left) <= 0.0
        length = end - t if is_last else h
        outcome = try_step(arguments, t, length, entries, layout=layout)
        if outcome != Outcome.DONE:
            return outcome
        if not is_finite(arguments, layout, errors=False):
            return Outcome.NON_FINITE
        after = end if is_last else grid
        moved: bool | None = None
        if layout.projected:
            projected, moved = project_new_state(arguments, after, entries, layout)
            if projected != Outcome.DONE:
                return projected
        accept_step(arguments, entries, moved, after, times, rows, layout=layout)
    return Outcome.DONE if run.t == end else Outcome.PAUSED


@inline
def discard_history(arguments: Running, layout: Layout) -> None:
    """Clear the data of previous steps in memory if they belong to another run."""
    if layout.keeps_history:
        work = arguments.work
        if arguments.counts.kept == 0:
            arguments.counts.kept = 1
            work[layout.flags] = 0.0
            work[layout.flags + 1] = 0.0
            for newton in arguments.newtons:
                clear(newton)
            lost = work[layout.lost :]
            for i in each(layout.step.states * layout.width if layout.step.exact else 0, spill=True):
                lost[i] = 0.0


@inline
def kept_entries(arguments: Running, layout: Layout) -> Out | None:
    """Return a local array for the entries of the old and the new state, filled with the old ones.

    Return None if the layout does not keep the state in registers.
    """
    if not layout.keeps_entries:
        return None
    entries = reals(2 * layout.dimension)
    for i in unrolled(layout.step.states):
        for k in unrolled(layout.length):
            entries[i * layout.length + k] = arguments.work[layout.place(i) + k]
    return entries


@inline
def is_finite(arguments: Running, layout: Layout, *, errors: bool) -> bool:
    """Return True if the new state is finite. With `errors`, its error vectors must be finite, too.

    The test uses 0 * x, which is NaN if x is not finite.
    """
    new, total = arguments.work[layout.place(layout.new) :], 0.0
    vectors = layout.step.states + (len(layout.step.errors) if errors else 0)
    for i in each(vectors * layout.width, unrolled=layout.width <= UNROLLED_TEST * layout.block):
        total = fma(new[i], 0.0, total)
    return total == 0.0


LARGEST_CORRECTION = 100.0
"""Largest displacement, in tolerances, by which a projection onto constraints may end a step with error control. The
step's distance from the constraints is part of its error, which is estimated to be below one tolerance. A larger
displacement means that the motion changed within the step.
"""

ROUNDED_START, SHORTENINGS = 2.0**-20, 8
"""`ROUNDED_START`: largest distance of a state from the constraints at the start of a step, relative to its size. Such
a distance may come from an event. The displacement onto the constraints then does not decrease with the length of the
step. `SHORTENINGS`: number of times that the step is shortened before this displacement is accepted.
"""

LARGEST_RETRY = 0.95
"""Upper bound of the factor of the step length after a rejection by the error norm."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""Lower bounds of the error norm of a step, and of the error norm of the previous step, in step size control. A step
with nearly no error does not predict the error of the next step.
"""

PI_SHARE = 0.75
"""Fraction of the exponent of the previous error norm by which PI control reduces the exponent of the present norm. The
step length is multiplied by norm**-(1/exponent - `PI_SHARE` * memory) * previous norm**memory, with `exponent` and
`memory` of the method's `Control`. So the step length still follows a norm that changes slowly.
"""


def steps_of(layout: Layout) -> Procedure:
    """Return the procedure that loops over the steps of a method, with error control if the method has it."""
    control = layout.step.control
    return fixed_steps.form(layout=layout) if control is None else controlled_steps.form(layout=layout, control=control)


@procedure(arguments=running, rows=rows_array)
def controlled_steps(
    arguments: Running, budget: int, times: Out, rows: Out, *, layout: Layout, control: Control
) -> Outcome:
    """Take steps with error control. Return DONE at the end, PAUSED after `budget` trials, or a failure.

    An accepted trial becomes the state; if rows are recorded, its time and state are written to `times` and
    `rows`. A rejected trial is repeated with a shorter length. UNSCALED means that the caller must estimate the
    sizes of the state's entries and may then continue.
    """
    run, counts = arguments.run, arguments.counts
    discard_history(arguments, layout)
    entries = kept_entries(arguments, layout)
    end = run.end
    distance = end - run.t
    direction = -1.0 if distance < 0.0 else 1.0
    if run.h == 0.0 and not begin(arguments, abs(distance), direction, layout, control):
        return Outcome.UNSCALED
    for _ in range(budget):
        t = run.t
        h = direction * smaller(abs(run.h), run.longest)
        if t == end:
            return Outcome.DONE
        is_last = abs(h) * STRETCH_TO_END >= abs(end - t)
        is_small = not abs(h) >= larger(abs(t), EARLIEST) * SPACING
        is_retry = counts.after_reject != 0
        if is_small and (not is_last or is_retry):
            return Outcome.STEP_TOO_SMALL
        after = end if is_last else t + h
        # Far from time zero a step is (t + h) - t, rounded. Elsewhere it is h, so that a matrix can be reused.
        length = after - t if is_last or abs(h) < abs(t) * FAR_FROM_ZERO else h
        outcome = try_step(arguments, t, length, entries, layout=layout)
        if is_finite(arguments, layout, errors=True) and outcome == Outcome.DONE:
            norm = error_norm(arguments, layout=layout, control=control)
            exponent = -(1 / control.exponent - PI_SHARE * control.memory)
            factor = larger(norm, LEAST_NORM) ** exponent * control.safety
            if norm <= 1.0:
                next_h = length * growth(factor, run.previous, is_retry, control)
                if layout.projected:
                    cause, moved = project_within_tolerance(arguments, after, entries, layout, control)
                    if likely(cause == Outcome.DONE):
                        accept(arguments, norm, next_h, layout)
                        accept_step(arguments, entries, moved, after, times, rows, layout=layout)
                    elif reject(arguments, float(cause), length * AFTER_DIVERGED, moved=False, layout=layout):
                        return Outcome.UNSCALED
                else:
                    accept(arguments, norm, next_h, layout)
                    accept_step(arguments, entries, None, after, times, rows, layout=layout)
            else:
                shorter = smaller(larger(factor, control.least), LARGEST_RETRY)
                if reject(arguments, float(Outcome.STEP_TOO_SMALL), length * shorter, moved=True, layout=layout):
                    return Outcome.UNSCALED
        else:
            cause = Outcome.NON_FINITE if outcome == Outcome.DONE else outcome
            part = AFTER_DIVERGED if outcome == Outcome.DIVERGED else AFTER_BROKEN
            if reject(arguments, float(cause), length * part, moved=False, layout=layout):
                return Outcome.UNSCALED
    return Outcome.DONE if run.t == end else Outcome.PAUSED


@inline
def begin(arguments: Running, distance: float, direction: float, layout: Layout, control: Control) -> bool:
    """Choose the length of the first step. Return False if the sizes of the entries must be estimated first.

    `distance` is the duration of the run without sign, and `direction` its sign, 1.0 or -1.0.
    """
    size = first_step(arguments, distance, direction, layout=layout, control=control)
    if LAWS[layout.step.law].results == 1:
        arguments.counts.evaluations += 3
    if not size < 0.0:
        arguments.run.h = size * direction
    return not size < 0.0


@inline
def growth(factor: float, previous: float, is_retry: bool, control: Control) -> float:
    """Return the length of the next step, as a multiple of the length of the accepted step.

    `factor` is the multiple that follows from the error norm of the step alone; it is bounded here. `previous`
    is the error norm of the step before. After a rejection (`is_retry`) the next step is not longer.
    """
    longer = factor * previous**control.memory if control.memory else factor
    longer = larger(smaller(longer, 1.0 if is_retry else control.most), control.least)
    if control.hold > 1:
        longer = 1.0 if longer >= 1.0 and longer < control.hold else longer
    return longer


@inline
def project_within_tolerance(
    arguments: Running, after: float, entries: Out | None, layout: Layout, control: Control
) -> tuple[Outcome, bool]:
    """Project the new state of a trial step onto the constraints. Return an outcome, and True if it has moved.

    The outcome is DONE; UNPROJECTED if the state is too far from the constraints; STEP_TOO_SMALL if the
    displacement is too large for the tolerance. `after` is the time at the end of the step. `entries` has the
    entries of the old and new state if they are kept in registers, else it is None.
    """
    outcome, moved = project_new_state(arguments, after, entries, layout)
    correction = 0.0
    if moved:
        correction = error_norm(arguments, layout=layout, control=control)
    begun_off = larger(ROUNDED_START / arguments.run.rtol, LARGEST_CORRECTION)
    most = begun_off if arguments.counts.after_reject >= SHORTENINGS else LARGEST_CORRECTION
    cause = Outcome.STEP_TOO_SMALL if outcome == Outcome.DONE and not correction <= most else outcome
    return cause, moved


@inline
def accept(arguments: Running, norm: float, h: float, layout: Layout) -> None:
    """Store the error norm of an accepted step and the length h of the next one.

    The floors (absolute tolerances) are raised to a fraction of the new state.
    """
    arguments.run.previous = larger(norm, LEAST_PREVIOUS)
    arguments.run.h = h
    arguments.counts.after_reject = 0
    raise_floors(arguments.run.share, arguments.floors, arguments.work, layout)


@dataclass(frozen=True)
class SystemFunctions:
    """The functions of a system: the right-hand side, its derivative, and the corrections of constraints (or None)."""

    law: Callable[..., Any]
    jacobian: Callable[..., Any]
    projection: Any


def functions_of(layout: Layout) -> Bundle:
    """Return the type of a procedure's parameter of class `SystemFunctions`, for a `layout`."""
    projection = CORRECTIONS if layout.projected else None
    return Bundle(SystemFunctions, {"law": FUNCTION, "jacobian": FUNCTION, "projection": projection})


def state_array(layout: Layout) -> Array:
    """Return the type of a parameter that is the state [q, v]."""
    return Array(size=layout.dimension)


@procedure(of=functions_of, y=state_array)
def one_step(of: SystemFunctions, t: float, h: float, y: Out, p: In, *, layout: Layout, relations: bool) -> Outcome:
    """Replace the state y by the state after one step of length h from time t, and return an outcome.

    The outcome is DONE if a step was taken. Otherwise it is the reason, and y is the state at the start.
    UNPROJECTED means that the old or the new state is too far from the constraints. `p` are the parameters of the
    functions `of` the system. With `relations` some velocities follow from the constraints: y is first moved onto
    them.
    """
    n = layout.dimension
    if is_off_constraints(of, t, y, p, n, relations):
        return Outcome.UNPROJECTED
    arguments = new_arguments(of, y, p, layout)
    work = arguments.work
    new = work[layout.place(layout.new) :]
    if layout.step.law == "accelerations":
        # The law reads velocities, but a step with coordinates alone has none.
        velocities = layout.argument + layout.length
        work[velocities : velocities + layout.length] = 0.0
    outcome = take_step(arguments, t, h, slope_known=False, entries=None, layout=layout)
    if outcome != Outcome.DONE:
        return outcome
    if of.projection is not None:
        lost = reals(n)
        lost[:n] = 0.0
        projected, _ = project(of.projection, p, t + h, new, lost, dimension=n, block=1)
        if projected != Outcome.DONE:
            return projected
    total = 0.0
    for i in each(n):
        total = fma(new[i], 0.0, total)
    if total != 0.0:
        return Outcome.NON_FINITE
    y[:n] = new[:n]
    return Outcome.DONE


@inline
def is_off_constraints(of: SystemFunctions, t: float, y: Out, p: In, n: int, relations: bool) -> bool:
    """Return True if the state y at time t violates the constraints too much to start from it.

    `p` are the parameters, and `n` is the length of the state. With `relations` some velocities follow from the
    constraints: y is moved onto the constraints, and only the violation of the other constraints is limited.
    """
    return of.projection is not None and not starts_on_constraints(
        of.projection, p, t, y, dimension=n, relations=relations
    )


@inline
def new_arguments(of: SystemFunctions, y: In, p: In, layout: Layout) -> Running:
    """Return the arguments of the procedures that take steps, with new memory, for a run from the state y.

    `of` are the functions of the system, and `p` their parameters. All fields of the records `Run` and `Counts`
    are zero.
    """
    work, floors = reals(layout.size), reals(layout.dimension)
    work[: layout.dimension] = y[: layout.dimension]
    return Running(
        law=of.law,
        parameters=p,
        jacobian=of.jacobian,
        constants=p,
        run=Run(),
        counts=Counts(),
        floors=floors,
        effort=Effort(),
        newtons=(),
        starters=(),
        work=work,
        projection=of.projection,
        projection_numbers=None if of.projection is None else p,
    )


@procedure(of=functions_of, t=lambda: Array(size=1), y=state_array)
def adaptive_run(
    of: SystemFunctions,
    t: Out,
    t_end: float,
    y: Out,
    p: In,
    rtol: float,
    atol: float,
    max_steps: int,
    *,
    layout: Layout,
    control: Control,
    relations: bool,
    unlimited: tuple[int, ...],
) -> Outcome:
    """Run with error control from the state y at time t[0] to t_end, and return an outcome.

    The last state and its time are written to y and t[0]. The outcome is DONE at t_end, PAUSED after `max_steps`
    trial steps; otherwise it is the reason of an earlier end. `p` are the parameters of the functions `of` the
    system. The error of an entry per step is at most rtol times its size + atol. The entries with the indices
    `unlimited` have no such bound: the motion does not depend on them. With `relations` some velocities follow from
    the constraints.
    """
    n = layout.dimension
    if is_off_constraints(of, t[0], y, p, n, relations):
        return Outcome.UNPROJECTED
    arguments, times, rows = new_arguments(of, y, p, layout), reals(1), reals(1)
    run, floors = arguments.run, arguments.floors
    run.t = t[0]
    run.end = t_end
    run.rtol = rtol
    run.previous = 1.0
    run.longest = math.inf
    for i in each(n):
        floors[i] = larger(atol, LEAST_FLOOR)
    for k in unrolled(len(unlimited)):
        floors[unlimited[k]] = math.inf
    outcome = controlled_steps(arguments, max_steps, times, rows, layout=layout, control=control)
    t[0] = run.t
    y[:n] = arguments.work[:n]
    return outcome
