"""Loop over Taylor steps: compute the series at the state, test the defect of the last step, take the next step.

The length of a step follows from its series, in a suitable unit of time. Steps end at zeros of watched functions (event
functions and switching surfaces) that change the motion.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.constants import EARLIEST, MOST_SURVEYS, SPACING, STRETCH_TO_END, WIDEST_VECTOR, Outcome
from lagrange.algorithm.projection import compensated, project
from lagrange.algorithm.step.memory import Counts, Run
from lagrange.algorithm.taylor.event_series import contradicts, doubtful_events
from lagrange.algorithm.taylor.event_zeros import GO_ON, WAIT, InspectedStep, inspect_step
from lagrange.algorithm.taylor.memory import STEP_GROWTH, Held, TaylorLayout, TaylorState, weights_type
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.algorithm.taylor.step_size import (
    choose_exponent,
    defect_along_step,
    defect_is_small,
    ends,
    first_floors,
    forget_first_floors,
    logarithm,
    power,
    raise_floors,
    record_step,
    reject_step,
    retries_exhausted,
    retry_shorter,
    weigh,
)
from lagrange.algorithm.taylor.sums import advance, outstanding, write_outputs
from lagrange.algorithm.taylor.watched_functions import (
    Arguments,
    Watched,
    WatchedView,
    arguments,
    numbers_of,
    restore_sides,
    watched_of,
)
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    each,
    larger,
    likely,
    mantissa,
    nearest,
    reals,
    smaller,
    two_to,
    unlikely,
)

LARGEST_SCALE_RATIO = 10.0
"""Largest binary logarithm of the ratio of the step to the scale of time; beyond it the series is computed again. The
scale is a power of two near the last step. In this unit coefficients neither overflow nor underflow, whatever the units
of the statement.
"""

FIRST_SCALE_RATIO = 1.5
"""Bound in place of `LARGEST_SCALE_RATIO` for the first step of a run. The step and the time scale then differ by less
than a factor of 2**1.5.
"""

OVERFLOWED = -45.0
"""Binary logarithm of a step, in units of the time scale, below which a coefficient has overflowed, or nearly so. An
infinite coefficient counts as 2**1024 tolerances: at order 20 it gives a step of 2**-51.
"""

LONGER_SCALE, SHORTER_SCALE = 20.0, -40.0
"""Powers of two by which the scale of time changes if the last coefficients are zero, and if one has overflowed. At
orders up to 32 they change the last coefficient by 2**640 and 2**-1280. That is less than the range between zero and
overflow: no change skips the suitable scales.
"""

SHORTEST_SCALE = 1e-280
"""Smallest size of the time scale, the unit of time of the series. A step of 2**-45 of it is still a normal double."""

MOST_RESCALINGS = 120
"""Largest number of changes of the scale of time for one step. After these changes the coefficients count as infinite.
From a scale of 1, 24 changes by `SHORTER_SCALE` lead below `SHORTEST_SCALE`, to 1e-289, and 96 by `LONGER_SCALE` from
there to 1e289.
"""


@procedure(arguments=arguments)
def take_step(arguments: Arguments, exponent: float, *, layout: TaylorLayout) -> Outcome:
    """Take a Taylor step if possible. Otherwise change the motion, the time scale or the largest length of the step.

    After such a change the series is computed again. The outcome is PAUSED if the run continues; a failure; or
    WATCHED if the caller must handle a zero of a watched function. `exponent` is the binary logarithm of the step
    that the series allows, in units of the time scale.
    """
    run, taylor, held, outputs = arguments.run, arguments.taylor, arguments.held, arguments.outputs
    work, order, watched = arguments.work, arguments.order, watched_of(arguments)
    t, low, scale = run.t, taylor.low, taylor.scale
    left = (run.end - t) - low
    is_ending = ends(order, exponent)
    if watched is not None:
        if unlikely(watched.watch.fresh != 0 and not begin_sides(t, scale, run.rtol, watched)):
            return Outcome.WATCHED
        outcome = change_motion(arguments, t, watched, layout)
        if unlikely(outcome != Outcome.DONE):
            return outcome
    reach = logarithm(smaller(abs(left), run.longest) / abs(scale))
    if unlikely(not fits(arguments, exponent, reach, is_ending)):
        return rescale(taylor, exponent, reach, is_ending)
    s, rounded_exponent, final, is_small = length_of_step(arguments, t, scale, left, exponent)
    if unlikely(is_small):
        return Outcome.STEP_TOO_SMALL
    h = left if final else s * scale
    run.h = h
    if watched is not None:
        cause, taken = inspected(arguments, InspectedStep(t, low, scale, run.rtol, s, left, final), watched, layout)
        if unlikely(cause != Outcome.DONE):
            return cause
        is_whole = taken == s
        h = h if is_whole else taken * scale
        final = final and is_whole
        s = taken
        run.h = h
    # A series that terminates may not satisfy the equations on a much longer step, for example after an event.
    is_longer = abs(h) > STEP_GROWTH * abs(held.h)
    if unlikely(is_ending and is_longer and not retries_exhausted(taylor)):
        numbers, sizes = numbers_of(arguments, layout), (run.rtol, arguments.floors)
        if not defect_along_step(arguments.jet, *numbers, *sizes, t, scale, s, work, order, layout=layout):
            retry_shorter(arguments.counts, taylor, h)
            if watched is not None:
                restore_sides(watched, layout)
            return Outcome.PAUSED
    raise_floors(run.share, arguments.floors, work, layout=layout)
    # A series that terminates does not estimate the next step.
    longer = two_to(int(0.0 if rounded_exponent > LARGEST_SCALE_RATIO else rounded_exponent))
    if unlikely(not advance(s, longer, work, order, layout=layout)):
        return Outcome.NON_FINITE
    move_on(arguments, t, h, final)
    if layout.projected:
        result = projected(arguments, watched, layout)
        if unlikely(result != Outcome.DONE):
            return result
    outputs.ahead = outputs.done
    if unlikely(outstanding(arguments.output_times, outputs.done, run.t, scale)):
        write_outputs(run.t, held, outputs, arguments.output_times, arguments.output_states, work, order, layout=layout)
    taylor.scale = scale * longer
    return Outcome.PAUSED


@inline
def length_of_step(
    arguments: Arguments, t: float, scale: float, left: float, exponent: float
) -> tuple[float, float, bool, bool]:
    """Return the step length, its rounded binary logarithm, and two flags.

    The first flag is true if the step ends the run, and the second if the step is too small.
    The length is in units of the time scale. `t` is the time, `left` the time from t to the end of the run, and
    `exponent` the binary logarithm of the step that the series allows. Operations without the coefficients come
    first: processors execute them before the last coefficient is available.
    """
    run, taylor = arguments.run, arguments.taylor
    inverse = 1.0 / abs(scale)
    whole_way = abs(left) * inverse
    limit = smaller(run.longest, taylor.limit)
    bound = smaller(smaller(limit, taylor.next_limit) * inverse, whole_way)
    spacing = larger(abs(t), EARLIEST) * SPACING
    natural, rounded_exponent = power(exponent)
    is_bounded = natural * STRETCH_TO_END >= bound
    final = is_bounded and bound == whole_way
    is_small = smaller(natural, limit * inverse) < spacing * inverse and not final
    return bound if is_bounded else natural, rounded_exponent, final, is_small


@inline
def fits(arguments: Arguments, exponent: float, reach: float, is_ending: bool) -> bool:
    """Return True if the step is near the scale of time, so that all coefficients are in the range of doubles.

    `exponent` is the binary logarithm of the step that the series allows, and `reach` that of the longest step, in
    units of the scale. A series that terminates (`is_ending`) fits if the scale is at least about as long as the
    longest step. After `MOST_RESCALINGS` changes any scale is accepted.
    """
    tries = arguments.taylor.rescalings
    is_first = arguments.counts.steps + tries == 0
    is_near = abs(exponent) < (FIRST_SCALE_RATIO if is_first else LARGEST_SCALE_RATIO)
    is_number = exponent == exponent
    return is_near or (is_ending and reach < 1.0) or (tries >= MOST_RESCALINGS and is_number)


@procedure(noinline=True)
def rescale(taylor: TaylorState, exponent: float, reach: float, terminates: bool) -> Outcome:
    """Change the time scale to about the step length, for a new series, and return PAUSED.

    Return NON_FINITE, without a change, if the scale is too short or was changed `MOST_RESCALINGS` times.
    `exponent` is the binary logarithm of the step, and `reach` that of the longest step, in units of the scale.
    The scale becomes shorter if a coefficient overflowed. If the series `terminates`, it becomes as long as the
    longest step.
    """
    tries, scale = taylor.rescalings, taylor.scale
    if tries >= MOST_RESCALINGS or abs(scale) < SHORTEST_SCALE:
        return Outcome.NON_FINITE
    taylor.rescalings = tries + 1
    longer = smaller(reach, LONGER_SCALE) if terminates else exponent
    change = longer if exponent >= OVERFLOWED else SHORTER_SCALE
    taylor.scale = scale * two_to(int(nearest(change)))
    return Outcome.PAUSED


@inline
def change_motion(arguments: Arguments, t: float, watched: Watched, layout: TaylorLayout) -> Outcome:
    """Apply the reset or surface crossing that is due at time t, if this loop can handle it. Return an outcome.

    PAUSED means that the change was applied, and WATCHED that the caller must act. DONE means that nothing was
    changed, and the next step is to be taken.
    """
    watch, result = watched.watch, Outcome.DONE
    if layout.observes:
        if unlikely(watch.due != 0):
            result = Outcome.WATCHED
    elif unlikely(watch.due == 1 and watch.enabled != 0):
        jet, rtol, counts, taylor = arguments.jet, arguments.run.rtol, arguments.counts, arguments.taylor
        view, is_done = WatchedView(watched, layout), False
        if view.is_event(view.due[0]):
            prepared, constants = numbers_of(arguments, layout)
            is_done = reset_state(
                jet, prepared, constants, t, rtol, counts, taylor, arguments.times, arguments.rows, watched
            )
        else:
            is_done = cross_surface(jet, arguments.prepared, arguments.constants, t, rtol, counts, taylor, watched)
        result = Outcome.PAUSED if is_done else Outcome.DONE
    return result


@inline
def inspected(
    arguments: Arguments, step: InspectedStep, watched: Watched, layout: TaylorLayout
) -> tuple[Outcome, float]:
    """Search a step for zeros of watched functions. Return an outcome and the new length of the step.

    DONE means that the step is to be taken, PAUSED that the memory for events is full, and WATCHED that the
    caller must handle the step. The length is in units of the time scale.
    """
    taylor, watch, doubtful = arguments.taylor, watched.watch, reals(layout.watched, room=WIDEST_VECTOR)
    everything, outcome, length = taylor.inspect != 0, Outcome.DONE, step.s
    is_doubtful = doubtful_events(step.s, everything, doubtful, arguments.work, arguments.order, layout=layout)
    if unlikely(is_doubtful and taylor.next_limit == math.inf):
        outcome = Outcome.WATCHED
        if watch.enabled != 0 and watch.due == 0:
            answer, length = inspect_step(step, doubtful, taylor, watched)
            decided = Outcome.PAUSED if answer == WAIT else Outcome.WATCHED
            outcome = Outcome.DONE if answer == GO_ON else decided
    return outcome, length


@inline
def move_on(arguments: Arguments, t: float, h: float, final: bool) -> None:
    """Advance the time t by a step h, with compensation, and save the start of the step in the record `Held`.

    `final` is true for the last step, which ends exactly at the end of the run.
    """
    run, taylor, held = arguments.run, arguments.taylor, arguments.held
    held.t, held.low, held.scale, held.h = t, taylor.low, taylor.scale, h
    held.unproven = 1
    total, lost = compensated(t, h + taylor.low)
    run.t = run.end if final else total
    taylor.low = 0.0 if final else lost
    taylor.next_limit = math.inf
    taylor.rescalings = 0


@inline
def projected(arguments: Arguments, watched: Watched | None, layout: TaylorLayout) -> Outcome:
    """Project the state onto the constraints, with compensation. Return an outcome.

    DONE means that the state satisfies the constraints. PAUSED means that the projection failed: the step is
    undone, and a shorter one follows. UNPROJECTED means that the projection failed too often.
    """
    work, taylor = arguments.work, arguments.taylor
    corrections, lost = (arguments.projection, arguments.projection_numbers), work[layout.lost :]
    result, _ = project(*corrections, arguments.run.t, work, lost, dimension=layout.dimension, block=layout.block)
    if unlikely(result == Outcome.UNPROJECTED and not retries_exhausted(taylor)):
        reject_step(arguments.run, arguments.counts, taylor, arguments.held, work, layout=layout)
        if watched is not None:
            restore_sides(watched, layout)
        result = Outcome.PAUSED
    return result


@procedure(arguments=arguments)
def taylor_steps(arguments: Arguments, budget: int, *, layout: TaylorLayout) -> Outcome:
    """Take Taylor steps. Return DONE at the end of the run, PAUSED after `budget` steps, or another outcome.

    Other outcomes are failures, and WATCHED or UNSCALED, after which the caller acts and continues.
    """
    counts = arguments.counts
    counts.rows = 0
    arguments.held.unproven = 0
    if counts.kept == 0:
        begin_run(arguments.run, counts, arguments.taylor, arguments.held, arguments.work, layout)
    # Minus the binary logarithm of the relative tolerance.
    digits = -logarithm(arguments.run.rtol)
    # The last iteration only tests the last step.
    for i in range(budget + 1):
        outcome = iteration(arguments, i == budget, digits, layout=layout)
        if unlikely(outcome != Outcome.PAUSED):
            return outcome
    return Outcome.PAUSED


@inline
def begin_run(run: Run, counts: Counts, taylor: TaylorState, held: Held, work: Any, layout: TaylorLayout) -> None:
    """Reset rounding errors, limits and time scale at the start of a run.

    The time scale begins as 1, or as -1 for a run backwards in time. If the caller has asked for a search for
    events on the first step, this request remains.
    """
    counts.kept = 1
    low = work[layout.lost :]
    for i in each(layout.padded, **layout.loop):
        low[i] = 0.0
    taylor.low, held.h = 0.0, 0.0
    taylor.scale = -1.0 if run.end < run.t else 1.0
    taylor.next_limit = taylor.limit = math.inf
    taylor.rescalings = taylor.failures = 0


@procedure(arguments=arguments)
def iteration(arguments: Arguments, last: bool, digits: float, *, layout: TaylorLayout) -> Outcome:
    """Compute the series at the state, test the defect of the last step with it, and take the next step.

    Return PAUSED if the run continues, DONE at its end, or another outcome. If `last`, no further step is
    taken. `digits` is minus the binary logarithm of the relative tolerance.
    """
    run, counts, taylor, held = arguments.run, arguments.counts, arguments.taylor, arguments.held
    work, order = arguments.work, arguments.order
    is_there, is_idle = run.t == run.end, held.unproven == 0
    if is_idle and is_there:
        return Outcome.DONE
    if is_idle and last:
        return Outcome.PAUSED
    is_singular = arguments.jet(run.t, taylor.scale, work, *numbers_of(arguments, layout), work[layout.rows :], order)
    counts.evaluations += 1
    weights = reals(layout.padded, room=layout.block)
    weigh(run.rtol, arguments.floors, weights, work, layout=layout)
    if likely(not is_idle):
        outcome = prove_step(arguments, weights, is_singular, layout=layout)
        if unlikely(outcome != Outcome.DONE):
            return outcome
        if is_there:
            return Outcome.DONE
        if last:
            return Outcome.PAUSED
    if is_singular:
        return Outcome.SINGULAR
    begins = (counts.steps == 0 or taylor.rescalings != 0) and counts.surveyed == 0
    if unlikely(begins and run.share > 0.0):
        # At the start and after a change of the time scale, tolerances of zero entries follow from the series.
        is_blind = first_floors(run.share, arguments.floors, work, order, layout=layout)
        if is_blind and may_ask(run, counts):
            if counts.steps == 0:
                # The time scale of the first series is not that of a step: it does not show the sizes in a step.
                forget_first_floors(arguments.floors, work, layout)
            return Outcome.UNSCALED
        weigh(run.rtol, arguments.floors, weights, work, layout=layout)
    exponent = choose_exponent(run.rtol, digits, arguments.floors, weights, work, order, layout=layout)
    return take_step(arguments, exponent, layout=layout)


@procedure(arguments=arguments, weights=weights_type)
def prove_step(arguments: Arguments, weights: In, is_singular: bool, *, layout: TaylorLayout) -> Outcome:
    """Record or reject the last step: DONE if it is recorded, PAUSED if it is rejected.

    `weights` are 1 / tolerance of each entry of the state. `is_singular` is true if the new series has a singular
    matrix. At the second, fourth, eighth, ... rejection of a run the outcome is UNSCALED: the caller has to estimate
    the sizes of the entries.
    """
    run, counts, taylor, held = arguments.run, arguments.counts, arguments.taylor, arguments.held
    work, order, watched = arguments.work, arguments.order, watched_of(arguments)
    length = abs(held.h) / abs(taylor.scale)
    is_good = defect_is_small(length, order, layout.rows + layout.width, weights, work, layout=layout)
    if unlikely(not (is_good and not is_singular) and not retries_exhausted(taylor)):
        reject_step(run, counts, taylor, held, work, layout=layout)
        if watched is not None:
            restore_sides(watched, layout)
        rejected = float(counts.rejected)
        if rejected > 1.0 and mantissa(rejected) == 1.0 and may_ask(run, counts):
            return Outcome.UNSCALED
        return Outcome.PAUSED
    if watched is not None:
        is_wrong = contradicts(run.t, run.rtol, length, watched, layout=layout)
        if unlikely(is_wrong):
            taylor.inspect = 1
            if not retries_exhausted(taylor):
                reject_step(run, counts, taylor, held, work, layout=layout)
                restore_sides(watched, layout)
                return Outcome.PAUSED
    record_step(run, counts, taylor, held, arguments.outputs, work, arguments.times, arguments.rows, layout=layout)
    if watched is not None:
        watched.watch.done, watched.watch.unproven = watched.watch.ahead, 0
    return Outcome.DONE


@inline
def may_ask(run: Run, counts: Counts) -> bool:
    """Return True if the run may return to the caller for an estimate of the sizes of the state's entries.

    The floors (absolute tolerances) must depend on these sizes, and the run must not have returned for this reason
    more than `MOST_SURVEYS` times.
    """
    return run.share > 0.0 and counts.surveyed < MOST_SURVEYS
