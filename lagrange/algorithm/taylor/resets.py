"""Events at the end of a Taylor step that change the motion: reset of the state, or crossing of a switching surface.

Event functions and switching surfaces are called watched functions. The side of zero of such a function is its sign, 1
or -1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lagrange.algorithm.constants import EARLIEST
from lagrange.algorithm.events.constants import CLOSEST, MOST_COEFFICIENTS
from lagrange.algorithm.step.memory import Counts
from lagrange.algorithm.taylor.event_series import comparable_unit, copy_series, start_of_series, write_noise
from lagrange.algorithm.taylor.memory import EVENT_SLACK, JET, TaylorState, work_type
from lagrange.algorithm.taylor.watched_functions import Watch, Watched, WatchedView, view_of, watched_type
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, larger, quotient, reals

AT_REST = 4.0
"""Largest value of an event function after a reset that counts as zero, as a multiple of its value before the reset."""


@procedure(noinline=True, watched=watched_type)
def sides_at_start(
    t: float, scale: float, rtol: float, margin: float, index: int, numbers: In, start_state: In, watched: Watched
) -> bool:
    """Find the sign of each watched function just after a start or a reset, and the functions that are zero there.

    The results are written to scratch memory. The state at the start, its rounding errors and its series are in the
    work array `start_state`. `numbers` are the parameters of the functions. The function with this `index`, which
    changed the motion, counts as zero up to `margin`. Return False if the signs are undecided: a series is not
    finite; that function does not leave zero at once; or another function starts at zero. At the start of a run
    `index` is -1, and an event without reset may start at zero.
    """
    view, c = view_of(watched), reals(MOST_COEFFICIENTS + 1)
    layout, count = view.layout, watched.order + 1
    first = start_state[layout.rows + layout.watched_at :]
    for i in range(layout.watched):
        view.values[i] = first[i]
    write_noise(view, numbers, t, start_state)
    unit = comparable_unit(t, scale)
    tolerance = larger(rtol, 2.0**-52) * EVENT_SLACK
    for i in range(layout.watched):
        if not copy_series(first[i:], layout.width, count, c):
            return False
        is_own, own_noise = i == index, view.noise[i]
        allowed = larger(own_noise, margin) if is_own else own_noise
        sign, leading = start_of_series(c, count, unit, tolerance, own_noise, allowed)
        turns = view.reset_sizes[i] > 0 and sign == view.directions[i]
        is_quiet = view.is_event(i) and view.roots[i] == 0 and not turns
        if leading != 0 and not ((is_own and leading == 1) or (index < 0 and is_quiet)):
            return False
        view.begun_signs[i], view.begun_orders[i] = sign, leading
    return True


@procedure(noinline=True, watched=watched_type)
def begin_sides(t: float, scale: float, rtol: float, watched: Watched) -> bool:
    """Set the signs of all watched functions at the start of a run. Return False if they are undecided.

    `scale` is the unit of time of the series, and `rtol` the relative tolerance.
    """
    view = view_of(watched)
    is_done = sides_at_start(t, scale, rtol, 0.0, -1, view.numbers, watched.work, watched)
    if is_done:
        put_sides(view)
        watched.watch.fresh = 0
    return is_done


@inline
def put_sides(view: WatchedView) -> None:
    """Copy the signs of watched functions just after a start or a reset from scratch memory to the known signs."""
    for i in range(view.layout.watched):
        view.signs[i], view.near_flags[i] = view.begun_signs[i], 0
        view.starting[i] = view.begun_orders[i]


@inline
def just_changed(t: float, watch: Watch) -> bool:
    """Return True if time t is too close to the last reset or surface crossing to apply another change.

    Changes may accumulate at a time. Therefore the caller handles a change that follows so soon.
    """
    return not abs(t - watch.changed) > CLOSEST * larger(abs(t), EARLIEST)


@procedure(noinline=True, jet=lambda: JET, watched=watched_type)
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
    """Apply the reset that is due at time t, and append the new state to `times` and `rows`. Return True.

    Return False, with nothing changed, if the caller has to apply the reset, for example at the end of the run.
    """
    view, watch, work = view_of(watched), watched.watch, watched.work
    layout = view.layout
    if just_changed(t, watch):
        return False
    index = view.due[0]
    number = view.event_counts[index] + 1
    if watch.checked != 0 or view.reset_sizes[index] == 0:
        return False
    if view.is_last(index, number) or watch.done >= watch.room:
        return False
    new_state = work[layout.ahead(watched.order) :]
    for i in range(layout.padded):
        new_state[i], new_state[i + layout.lost] = work[i], 0.0
    results = view.new_entries
    if watched.resets(t, work, watched.reset_numbers, results):
        return False
    first, size = view.resets_at[index], view.reset_sizes[index]
    for j in range(first, first + size):
        new_state[view.reset_entries[j]] = results[j]
        if not abs(results[j]) < math.inf:
            return False
    if jet(t, taylor.scale, new_state, prepared, constants, new_state[layout.rows :], watched.order):
        return False
    if not sides_after_reset(t, taylor.scale, rtol, index, new_state, watched):
        return False
    state = view.write_event(watch.done, t, index)
    for i in range(layout.dimension):
        state[i] = work[i]
    watch.done += 1
    watch.ahead, watch.due = watch.done, 0
    watch.changed, watch.changed_at = t, index
    watch.jumps += 1
    view.event_counts[index] = number
    put_sides(view)
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

    The signs are written to scratch memory. Return False if they are undecided; then the caller handles the reset.
    The state after the reset and its series are in the work array `new_state`. No other function may start at zero,
    and no surface may change its sign. An event function that the reset does not change keeps its sign. The sign is
    undecided if the function was near zero before, because it may have touched zero.
    """
    view, watch = view_of(watched), watched.watch
    new, old = new_state[view.layout.rows + view.layout.watched_at :], view.rows
    margin = abs(old[index]) * AT_REST
    if not sides_at_start(t, scale, rtol, margin, index, view.numbers, new_state, watched):
        return False
    for i in range(watch.surfaces):
        if view.begun_signs[i] != view.signs[i]:
            return False
    for i in range(watch.surfaces, view.layout.watched):
        sign, root = view.signs[i], view.roots[i]
        stays = abs(new[i] - old[i]) <= view.noise[i] and sign != 0 and i != index and root == 0
        if stays:
            if view.near_flags[i] != 0:
                return False
            view.begun_signs[i] = sign
    return True


@procedure(noinline=True, jet=lambda: JET, watched=watched_type)
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

    `jet` computes the series beyond the surface from the arrays `prepared` and `constants`, which have numbers
    for all combinations of sides. No other surface may be touched. Return True if the surface was crossed.
    Otherwise the state and the sides are unchanged.
    """
    view, watch, work = view_of(watched), watched.watch, watched.work
    layout = view.layout
    if just_changed(t, watch):
        return False
    index, direction = view.due[0], view.due_directions[0]
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
    if view.begun_orders[index] != 1:
        return False
    for i in range(watch.surfaces):
        before = view.signs[i]
        if view.begun_signs[i] != (direction if i == index else before):
            return False
    watch.combination, watch.numbers = new_combination, numbers
    slot = watch.switches
    watched.switch_rows[slot], watched.switch_combinations[slot] = counts.steps + watch.jumps, new_combination
    watch.switches = slot + 1
    for i in range(layout.watched):
        view.starting[i] = int(i == index)
    view.signs[index], view.near_flags[index] = direction, 0
    watch.changed, watch.changed_at, watch.due = t, index, 0
    taylor.next_limit, taylor.inspect = math.inf, 1
    return True
