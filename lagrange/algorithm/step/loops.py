"""The loops over the steps of a method, of equal length or with error control: first step, error norm, floors.

The floors are the absolute tolerances of the entries of the state. Source: E. Hairer, S. P. Norsett, G. Wanner, Solving
Ordinary Differential Equations I, 2nd ed., 1993, II.4.

The length of the first step follows from the change of the derivatives of the state over a short trial step.
The jerk divided by the velocity is the square of a rate, in any units of the entries and for any origin of time
and coordinates. If it is not defined, the rate comes from the acceleration divided by the coordinate, or from
the square of the acceleration divided by the velocity. The size of an entry is at least that for which the
relative tolerance equals its absolute tolerance, its floor. If floors follow the sizes, the floor of an entry
that is zero begins at its change in the step. An acceleration that may be rounding of cancelling terms, as at
an equilibrium, is replaced by its sensitivity to the coordinate.
"""

from __future__ import annotations

import math

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    DEFAULT_FIRST,
    EARLIEST,
    FAR_FROM_ZERO,
    FIRST_SHARE,
    FIRST_TRIAL,
    LEAST_FLOOR,
    MOST_SURVEYS,
    RELATIVE_PERTURBATION,
    SLOPE_NOISE,
    SPACING,
    STRETCH_TO_END,
    perturbation_factors,
)
from lagrange.algorithm.step.memory import Layout, Running, running
from lagrange.algorithm.step.trial import accept_step, project_new_state, rows_array, try_step
from lagrange.algorithm.step.vectors import copy_vector
from lagrange.procedure.form import Procedure
from lagrange.procedure.front.plain import inline, procedure
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
from lagrange.program.step import LAWS, Control

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
    """Return the root mean square of the errors of a trial step, each divided by its tolerance.

    The step is accepted if the norm is at most 1. The tolerance of an entry is rtol times its magnitude, plus
    its floor. The magnitude is the larger one of the old and the new state. Two error vectors are combined as
    in DOP853.
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

    There are two for the norm of DOP853, otherwise one.
    """
    step = layout.step
    return tuple([work[layout.place(layout.errors + k) :] for k in unrolled(state, len(step.errors), step.states)])


@procedure(apart=True, arguments=running)
def reject(arguments: Running, cause: float, h: float, moved: bool, *, layout: Layout) -> bool:
    """Reject a trial step, and set the length of the next to h. Return True if sizes must be estimated.

    The run then stops, and the caller estimates the sizes of the entries of the state, from which absolute
    tolerances follow. `cause` is the `Outcome` of the trial. Sizes are needed after several consecutive
    rejections, or if an entry has no size yet. If the trial `moved` the state, an entry that stayed zero does
    not count. Sizes are also needed at the first, second, fourth, eighth, ... rejection if the entry with the
    largest error may be the rounding of larger entries, as defined at `ROUNDED`.
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
    """Return True if the entry with the largest error in a trial step may be mere rounding of larger entries.

    That is an entry whose tolerance is below `ROUNDED` times the largest entry of its kind, coordinate or
    velocity. `work` has the old and the new state, and the errors. `floors` are the absolute tolerances.
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

    `span` is the duration of the run, positive, and `direction` its sign. NEEDS_SIZES: the caller must first
    estimate the sizes of the entries. Methods in momenta have no derivatives: it is a fraction of `span`.
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
    is_uncertain = doubtful > CANCELLATION_DOMINANCE * certain or moving == 0.0
    if follows and arguments.counts.surveyed == 0 and is_uncertain and not singular:
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

    A rate is the square root of acceleration / coordinate, or acceleration / velocity if the coordinate is
    zero. The accelerations are in the derivative `slope` of the state y. The first `coordinate_count` entries
    of the state are coordinates, the others velocities.
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
    """Raise the floors (absolute tolerances) of zero entries to a fraction of their change in the first step.

    The change follows from the derivative at the start. If that is zero, it follows from the derivative at the
    end of the step, which is extrapolated from the trial step. The step has the length h, which is `longer`
    times that of the trial step.
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

    Only accelerations whose terms cancel count. For these `sensitivity` has the change of the acceleration when
    each entry of the state changes by about its size; for all others it is zero. The first `coordinate_count`
    entries of both arrays belong to coordinates, the others to velocities.
    """
    for i in range(coordinate_count):
        below = i + coordinate_count
        noise = period * SLOPE_NOISE * sensitivity[below]
        floors[i] = larger(floors[i], period * noise)
        floors[below] = larger(floors[below], noise)


SHORTEST_LAST_STEP = 1e-6
"""A last step below this fraction of h results from rounding of the grid. It is merged with the previous step."""

UNROLLED_TEST = 2
"""Largest number of blocks of a vector for which the test for finite entries is written out."""


@procedure(arguments=running, rows=rows_array)
def equal_steps(arguments: Running, budget: int, times: Out, rows: Out, *, layout: Layout) -> Outcome:
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
    """If the data of previous steps in memory belong to another run, clear them."""
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
    """Return a local array for the entries of the old and the new state, with the old ones; or None.

    It is None if the layout does not keep the state in registers.
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
    """Return True if the new state is finite, and with `errors` its error vectors, too.

    The test uses 0 * x, which is NaN if x is not finite.
    """
    new, total = arguments.work[layout.place(layout.new) :], 0.0
    vectors = layout.step.states + (len(layout.step.errors) if errors else 0)
    for i in each(vectors * layout.width, unrolled=layout.width <= UNROLLED_TEST * layout.block):
        total = fma(new[i], 0.0, total)
    return total == 0.0


LARGEST_CORRECTION = 100.0
"""Largest displacement, in tolerances, by which a projection onto constraints may end a step with error control. The
step's distance from the constraints is part of its error, which is below one tolerance by estimate. A larger
displacement is a change of the motion within the step that was not noticed.
"""

ROUNDED_START, SHORTENINGS = 2.0**-20, 8
"""Largest distance of a state from the constraints, relative to its size, at the start of a step, such as after an
event. This displacement does not decrease with the step. It is accepted after the second number of shortenings of the
step.
"""

LARGEST_RETRY = 0.95
"""Upper bound of the factor of the step length after a rejection by the error norm."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""Lower bounds of the error norm, and of the previous error norm. A step without an error does not predict the next
error.
"""

PI_SHARE = 0.75
"""PI control: the exponent of the current norm is 1/k - `PI_SHARE` * memory. So the step still follows the norm where
the norm changes slowly.
"""


def steps_of(layout: Layout) -> Procedure:
    """Return the procedure that loops over the steps of a method, with error control if the method has it."""
    control = layout.step.control
    return equal_steps.form(layout=layout) if control is None else controlled_steps.form(layout=layout, control=control)


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
