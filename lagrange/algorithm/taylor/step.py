"""One Taylor step from its series: its length, the choice of the scale of time, and its end."""

from __future__ import annotations

import math

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.compensated import compensated
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import project
from lagrange.algorithm.step.constants import EARLIEST, SPACING, STRETCH_TO_END
from lagrange.algorithm.taylor.constants import (
    FIRST_SCALE_RATIO,
    LARGEST_SCALE_RATIO,
    LONGER_SCALE,
    MOST_RESCALINGS,
    OVERFLOWED,
    SHORTER_SCALE,
    SHORTEST_SCALE,
    STEP_GROWTH,
)
from lagrange.algorithm.taylor.defect_test import defect_along_step, reject_step, retries_exhausted, retry_shorter
from lagrange.algorithm.taylor.event_series import doubtful_events
from lagrange.algorithm.taylor.events_on_step import GO_ON, WAIT, InspectedStep, inspect_step
from lagrange.algorithm.taylor.memory import TaylorLayout, TaylorState
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.algorithm.taylor.step_size import ends, logarithm, power, raise_floors
from lagrange.algorithm.taylor.sums import advance, outstanding, write_outputs
from lagrange.algorithm.taylor.watching import (
    Arguments,
    Watched,
    arguments,
    is_event,
    numbers_of,
    restore_sides,
    watched_of,
    whole_part,
)
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import larger, nearest, reals, smaller, two_to, unlikely


@procedure(given=arguments)
def take_step(given: Arguments, exponent: float, *, layout: TaylorLayout) -> Outcome:
    """Take a step, or change its scale or its limit. Return an outcome: PAUSED if the run continues.

    `exponent` is the binary logarithm of the step that the series allows, in units of the scale.
    """
    run, taylor, held, outputs = given.run, given.taylor, given.held, given.outputs
    work, order, watched = given.work, given.order, watched_of(given)
    t, low, scale = run.t, taylor.low, taylor.scale
    left = (run.end - t) - low
    is_ending = ends(order, exponent)
    if watched is not None:
        if unlikely(watched.watch.fresh != 0 and not begin_sides(t, scale, run.rtol, watched)):
            return Outcome.WATCHED
        outcome = change_motion(given, t, watched, layout)
        if unlikely(outcome != Outcome.DONE):
            return outcome
    reach = logarithm(smaller(abs(left), run.longest) / abs(scale))
    if unlikely(not fits(given, exponent, reach, is_ending)):
        return rescale(taylor, exponent, reach, is_ending)
    s, whole, final, is_small = length_of_step(given, t, scale, left, exponent)
    if unlikely(is_small):
        return Outcome.STEP_TOO_SMALL
    h = left if final else s * scale
    run.h = h
    if watched is not None:
        cause, taken = inspected(given, InspectedStep(t, low, scale, run.rtol, s, left, final), watched, layout)
        if unlikely(cause != Outcome.DONE):
            return cause
        is_whole = taken == s
        h = h if is_whole else taken * scale
        final = final and is_whole
        s = taken
        run.h = h
    # A series that terminates may not satisfy the equations on a longer step. An event may have shortened it.
    is_longer = abs(h) > STEP_GROWTH * abs(held.h)
    if unlikely(is_ending and is_longer and not retries_exhausted(taylor)):
        numbers, sizes = numbers_of(given, layout), (run.rtol, given.floors)
        if not defect_along_step(given.jet, *numbers, *sizes, t, scale, s, work, order, layout=layout):
            retry_shorter(given.counts, taylor, h)
            if watched is not None:
                restore_sides(watched, layout)
            return Outcome.PAUSED
    raise_floors(run.share, given.floors, work, layout=layout)
    # A series that terminates does not estimate the next step.
    longer = two_to(int(0.0 if whole > LARGEST_SCALE_RATIO else whole))
    if unlikely(not advance(s, longer, work, order, layout=layout)):
        return Outcome.NON_FINITE
    move_on(given, t, h, final)
    if layout.projected:
        result = projected(given, watched, layout)
        if unlikely(result != Outcome.DONE):
            return result
    outputs.ahead = outputs.done
    if unlikely(outstanding(given.output_times, outputs.done, run.t, scale)):
        write_outputs(run.t, held, outputs, given.output_times, given.output_states, work, order, layout=layout)
    taylor.scale = scale * longer
    return Outcome.PAUSED


@inline
def length_of_step(
    given: Arguments, t: float, scale: float, left: float, exponent: float
) -> tuple[float, float, bool, bool]:
    """Return the step in units of the scale, its rounded binary exponent, and two flags: last step, and too small.

    `left` is the time to the end of the run, and `exponent` the binary logarithm of the step that the series allows.
    Operations without the coefficients come first: processors run them before the last coefficient is available.
    """
    run, taylor = given.run, given.taylor
    inverse = 1.0 / abs(scale)
    whole_way = abs(left) * inverse
    own = smaller(run.longest, taylor.limit)
    bound = smaller(smaller(own, taylor.next_limit) * inverse, whole_way)
    spacing = larger(abs(t), EARLIEST) * SPACING
    natural, whole = power(exponent)
    is_bounded = natural * STRETCH_TO_END >= bound
    final = is_bounded and bound == whole_way
    is_small = smaller(natural, own * inverse) < spacing * inverse and not final
    return bound if is_bounded else natural, whole, final, is_small


@inline
def fits(given: Arguments, exponent: float, reach: float, is_ending: bool) -> bool:
    """Return True if the step is near the scale of time, so that all coefficients are in the range of doubles.

    `reach` is the binary logarithm of the longest step, in units of the scale. A series that terminates (`is_ending`)
    fits if the scale is at least about as long as that step. After `MOST_RESCALINGS` changes any scale is accepted.
    """
    tries = given.taylor.rescalings
    is_first = given.counts.steps + tries == 0
    is_near = abs(exponent) < (FIRST_SCALE_RATIO if is_first else LARGEST_SCALE_RATIO)
    is_number = exponent == exponent
    return is_near or (is_ending and reach < 1.0) or (tries >= MOST_RESCALINGS and is_number)


@procedure(apart=True)
def rescale(taylor: TaylorState, exponent: float, reach: float, terminates: bool) -> Outcome:
    """Change the scale of time to that of the step, for a new series. Return an outcome.

    `exponent` is the binary logarithm of the step, and `reach` that of the longest step, in units of the scale. The
    scale becomes shorter if a coefficient overflowed. If the series `terminates`, it becomes as long as the longest
    step.
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
def change_motion(given: Arguments, t: float, watched: Watched, layout: TaylorLayout) -> Outcome:
    """Apply the reset or crossing that is due at the state, if it is regular. Return an outcome.

    DONE means that nothing was changed, and the step is to be taken.
    """
    watch, result = watched.watch, Outcome.DONE
    if layout.observes:
        if unlikely(watch.due != 0):
            result = Outcome.WATCHED
    elif unlikely(watch.due == 1 and watch.enabled != 0):
        jet, rtol, counts, taylor, is_done = given.jet, given.run.rtol, given.counts, given.taylor, False
        if is_event(watched, whole_part(watched, "due", layout)[0]):
            prepared, constants = numbers_of(given, layout)
            is_done = reset_state(jet, prepared, constants, t, rtol, counts, taylor, given.times, given.rows, watched)
        else:
            is_done = cross_surface(jet, given.prepared, given.constants, t, rtol, counts, taylor, watched)
        result = Outcome.PAUSED if is_done else Outcome.DONE
    return result


@inline
def inspected(given: Arguments, step: InspectedStep, watched: Watched, layout: TaylorLayout) -> tuple[Outcome, float]:
    """Search the step for zeros. Return DONE, or the reason why the step is not taken, and its new length.

    The length is in units of the scale.
    """
    taylor, watch, doubtful = given.taylor, watched.watch, reals(layout.watched, room=WIDEST_VECTOR)
    everything, outcome, length = taylor.inspect != 0, Outcome.DONE, step.s
    is_doubtful = doubtful_events(step.s, everything, doubtful, given.work, given.order, layout=layout)
    if unlikely(is_doubtful and taylor.next_limit == math.inf):
        outcome = Outcome.WATCHED
        if watch.enabled != 0 and watch.due == 0:
            answer, length = inspect_step(step, doubtful, taylor, watched)
            decided = Outcome.PAUSED if answer == WAIT else Outcome.WATCHED
            outcome = Outcome.DONE if answer == GO_ON else decided
    return outcome, length


@inline
def move_on(given: Arguments, t: float, h: float, final: bool) -> None:
    """Advance the time t by a step h, with compensation, and save the start of the step; `final` is the last step."""
    run, taylor, held = given.run, given.taylor, given.held
    held.t, held.low, held.scale, held.h = t, taylor.low, taylor.scale, h
    held.unproven = 1
    total, lost = compensated(t, h + taylor.low)
    run.t = run.end if final else total
    taylor.low = 0.0 if final else lost
    taylor.next_limit = math.inf
    taylor.rescalings = 0


@inline
def projected(given: Arguments, watched: Watched | None, layout: TaylorLayout) -> Outcome:
    """Project the compensated state onto the constraints. Return DONE, or PAUSED for a shorter step if that fails."""
    work, taylor = given.work, given.taylor
    corrections, lost = (given.projection, given.projection_numbers), work[layout.lost :]
    result, _ = project(*corrections, given.run.t, work, lost, dimension=layout.dimension, block=layout.block)
    if unlikely(result == Outcome.UNPROJECTED and not retries_exhausted(taylor)):
        reject_step(given.run, given.counts, taylor, given.held, work, layout=layout)
        if watched is not None:
            restore_sides(watched, layout)
        result = Outcome.PAUSED
    return result
