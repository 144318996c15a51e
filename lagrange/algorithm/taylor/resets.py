"""Apply the event at which a Taylor step has ended: reset the state, or cross a switching surface.

The side of zero of a watched function (event function or switching surface) is its sign, 1 or -1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lagrange.algorithm.events.constants import CLOSEST, MOST_COEFFICIENTS
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.algorithm.step.memory import Counts
from lagrange.algorithm.taylor.constants import EVENT_SLACK
from lagrange.algorithm.taylor.event_series import comparable_unit, copy_series, start_of_series, write_noise
from lagrange.algorithm.taylor.memory import JET, TaylorState, layout_of, work_type
from lagrange.algorithm.taylor.watching import (
    COUNT,
    DIRECTION,
    NEAR,
    RESET_AT,
    RESET_SIZE,
    ROOT,
    SETTINGS,
    SIGN,
    STARTING,
    Watch,
    Watched,
    is_event,
    is_last,
    new_entries,
    own_numbers,
    real_part,
    setting,
    side,
    watched_type,
    whole_part,
    write_event,
)
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, larger, quotient, reals

AT_REST = 4.0
"""Largest distance of an event function from zero after a reset that counts as zero, relative to that before it."""


@procedure(apart=True, watched=watched_type)
def sides_at_start(
    t: float, scale: float, rtol: float, margin: float, index: int, numbers: In, start_state: In, watched: Watched
) -> bool:
    """Find the sign of each watched function just after the start of a motion, and those that start at zero.

    The results are written to scratch memory. The state at the start, its rounding errors and its series are in
    the work array `start_state`. The watched function with this `index`, which changed the motion, counts as
    zero up to `margin`. Return False if the signs are undecided: a series is not finite; that function does not
    leave zero at once; or another one starts at zero. At the start of a run `index` is -1, and an event without
    reset may start at zero.
    """
    layout, count = layout_of(watched.sizes), watched.order + 1
    series = start_state[layout.rows :]
    signs, starting = whole_part(watched, "begun", layout), whole_part(watched, "begun", layout, 1)
    values, noise = real_part(watched, "values", layout), real_part(watched, "noise", layout)
    c, first = reals(MOST_COEFFICIENTS + 1), series[layout.watched_at :]
    for i in range(layout.watched):
        values[i] = first[i]
    write_noise(watched, numbers, t, start_state, layout)
    unit = comparable_unit(t, scale)
    tolerance = larger(rtol, 2.0**-52) * EVENT_SLACK
    for i in range(layout.watched):
        if not copy_series(first[i:], layout.width, count, c):
            return False
        is_own, own_noise = i == index, noise[i]
        allowed = larger(own_noise, margin) if is_own else own_noise
        sign, leading = start_of_series(c, count, unit, tolerance, own_noise, allowed)
        turns = setting(watched, RESET_SIZE, i, layout) > 0 and sign == setting(watched, DIRECTION, i, layout)
        is_quiet = is_event(watched, i) and setting(watched, ROOT, i, layout) == 0 and not turns
        if leading != 0 and not ((is_own and leading == 1) or (index < 0 and is_quiet)):
            return False
        signs[i], starting[i] = sign, leading
    return True


@procedure(apart=True, watched=watched_type)
def begin_sides(t: float, scale: float, rtol: float, watched: Watched) -> bool:
    """Set the signs of all watched functions at the start of a run. Return True if they are decided."""
    layout = layout_of(watched.sizes)
    is_done = sides_at_start(t, scale, rtol, 0.0, -1, own_numbers(watched), watched.work, watched)
    if is_done:
        put_sides(watched, layout)
        watched.watch.fresh = 0
    return is_done


@inline
def put_sides(watched: Watched, layout: Any) -> None:
    """Set the signs of the watched functions to those at the start of a motion, from scratch memory."""
    signs, starting = whole_part(watched, "begun", layout), whole_part(watched, "begun", layout, 1)
    for i in range(layout.watched):
        side(watched, SIGN, layout)[i], side(watched, NEAR, layout)[i] = signs[i], 0
        side(watched, STARTING, layout)[i] = starting[i]


@inline
def just_changed(t: float, watch: Watch) -> bool:
    """Return True if the last reset or surface crossing was just before time t.

    Such changes may accumulate at a time: the caller handles them.
    """
    return not abs(t - watch.changed) > CLOSEST * larger(abs(t), EARLIEST)


@procedure(apart=True, jet=lambda: JET, watched=watched_type)
def reset_state(
    jet: Callable[..., Any],
    prepared: In,
    constants: In,
    t: float,
    rtol: float,
    counts: Counts,
    taylor: TaylorState,
    times: Out,
    rows: Out,
    watched: Watched,
) -> bool:
    """Apply the only reset that is due at the state at time t, if its event function then leaves zero at once.

    The event is written to `watched`, the new state to `rows`. Return False, with nothing changed, in other cases.
    """
    layout, watch, work = layout_of(watched.sizes), watched.watch, watched.work
    if just_changed(t, watch):
        return False
    index = whole_part(watched, "due", layout)[0]
    number = side(watched, COUNT, layout)[index] + 1
    if watch.checked != 0 or setting(watched, RESET_SIZE, index, layout) == 0:
        return False
    if is_last(watched, index, number, layout) or watch.done >= watch.room:
        return False
    new_state = work[layout.ahead(watched.order) :]
    for i in range(layout.padded):
        new_state[i], new_state[i + layout.lost] = work[i], 0.0
    results = new_entries(watched, layout)
    if watched.resets(t, work, watched.reset_numbers, results):
        return False
    first, size = setting(watched, RESET_AT, index, layout), setting(watched, RESET_SIZE, index, layout)
    entries = watched.settings[layout.watched * SETTINGS :]
    for j in range(first, first + size):
        new_state[entries[j]] = results[j]
        if not abs(results[j]) < math.inf:
            return False
    if jet(t, taylor.scale, new_state, prepared, constants, new_state[layout.rows :], watched.order):
        return False
    if not sides_after_reset(t, taylor.scale, rtol, index, new_state, watched):
        return False
    state = write_event(watched, watch.done, t, index, layout)
    for i in range(layout.dimension):
        state[i] = work[i]
    watch.done += 1
    watch.ahead, watch.due = watch.done, 0
    watch.changed, watch.changed_at = t, index
    watch.jumps += 1
    side(watched, COUNT, layout)[index] = number
    put_sides(watched, layout)
    for i in range(layout.padded * 2):
        work[i] = new_state[i]
    taylor.low, taylor.next_limit, taylor.inspect = 0.0, math.inf, 1
    if counts.record != 0:
        row = counts.rows
        times[row] = t
        for i in range(layout.dimension):
            rows[row * layout.dimension :][i] = new_state[i]
        counts.rows = row + 1
    return True


@procedure(watched=watched_type, new_state=work_type)
def sides_after_reset(t: float, scale: float, rtol: float, index: int, new_state: Out, watched: Watched) -> bool:
    """Find the signs of the watched functions just after a reset by the event with this `index`.

    The state after the reset and its series are in the work array `new_state`. No other function may start at
    zero. An event function that the reset does not change keeps its sign. If one of them came near zero before,
    it may have touched zero: then the result is False, and the caller handles the reset.
    """
    layout, watch = layout_of(watched.sizes), watched.watch
    new, old = [memory[layout.rows :][layout.watched_at :] for memory in (new_state, watched.work)]
    margin = abs(old[index]) * AT_REST
    if not sides_at_start(t, scale, rtol, margin, index, own_numbers(watched), new_state, watched):
        return False
    signs, noise = whole_part(watched, "begun", layout), real_part(watched, "noise", layout)
    for i in range(watch.surfaces):
        if signs[i] != side(watched, SIGN, layout)[i]:
            return False
    for i in range(watch.surfaces, layout.watched):
        sign, root = side(watched, SIGN, layout)[i], setting(watched, ROOT, i, layout)
        stays = abs(new[i] - old[i]) <= noise[i] and sign != 0 and i != index and root == 0
        if stays:
            if side(watched, NEAR, layout)[i] != 0:
                return False
            signs[i] = sign
    return True


@procedure(apart=True, jet=lambda: JET, watched=watched_type)
def cross_surface(
    jet: Callable[..., Any],
    prepared: In,
    constants: In,
    t: float,
    rtol: float,
    counts: Counts,
    taylor: TaylorState,
    watched: Watched,
) -> bool:
    """Cross the only switching surface that is due at the state, if the motion leaves it at once.

    `jet` computes the series beyond the surface from the arrays `prepared` and `constants`. No other surface
    may be touched. Return True if the surface was crossed. Otherwise nothing has changed.
    """
    layout, watch, work = layout_of(watched.sizes), watched.watch, watched.work
    if just_changed(t, watch):
        return False
    index, direction = [whole_part(watched, "due", layout, i)[0] for i in (0, 1)]
    combination = watch.combination
    if combination < 0 or watch.switches >= watch.room:
        return False
    power = 1
    for _ in range(index):
        power *= 2
    above = quotient(combination, power) - quotient(combination, power * 2) * 2
    if direction != 1 - above * 2:
        return False
    new_combination = combination + (1 - above * 2) * power
    numbers = watched.combinations[new_combination]
    if numbers < 0:
        return False
    new_state = work[layout.ahead(watched.order) :]
    for i in range(layout.padded * 2):
        new_state[i] = work[i]
    scale, surface_numbers = taylor.scale, watched.value_numbers[numbers:]
    if jet(t, scale, new_state, prepared[numbers:], constants[numbers:], new_state[layout.rows :], watched.order):
        return False
    if not sides_at_start(t, scale, rtol, math.inf, index, surface_numbers, new_state, watched):
        return False
    signs, starting = whole_part(watched, "begun", layout), whole_part(watched, "begun", layout, 1)
    if starting[index] != 1:
        return False
    for i in range(watch.surfaces):
        before = side(watched, SIGN, layout)[i]
        if signs[i] != (direction if i == index else before):
            return False
    watch.combination, watch.numbers = new_combination, numbers
    slot = watch.switches
    watched.switch_rows[slot], watched.switch_combinations[slot] = counts.steps + watch.jumps, new_combination
    watch.switches = slot + 1
    for i in range(layout.watched):
        side(watched, STARTING, layout)[i] = int(i == index)
    side(watched, SIGN, layout)[index], side(watched, NEAR, layout)[index] = direction, 0
    watch.changed, watch.changed_at, watch.due = t, index, 0
    taylor.next_limit, taylor.inspect = math.inf, 1
    return True
