"""Search for zeros of event functions and switching surfaces on the next Taylor step, in order of time.

Both kinds are called watched functions. The first zero that changes the motion, by a reset, a crossed surface or the
end of the run, ends the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.events.constants import JUMP, TOGETHER
from lagrange.algorithm.events.roots import first_change, is_counted, roots, sort_zeros
from lagrange.algorithm.taylor.event_series import (
    LATE,
    column_of,
    event_terms,
    is_balanced,
    keeps_sign,
    largest_term,
    only_passage,
    only_zero,
    reach,
    safe_step,
    terms_of,
    vanishes,
    write_noise,
)
from lagrange.algorithm.taylor.memory import EVENT_SLACK, RecordedLayout, TaylorState, row
from lagrange.algorithm.taylor.step_size import verified_step
from lagrange.algorithm.taylor.sums import state_on_step
from lagrange.algorithm.taylor.watched_functions import MOST_ZEROS, Watch, Watched, WatchedView, view_of, watched_type
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, WholesOut, fma, larger, likely, magnitude, smaller, unlikely

LEAST_PART = 2.0**-70
"""Lower bound of the length of a step that makes progress, as a fraction of the rest of the run."""

SEARCH_MARGIN = 1 / 64
"""Least fraction of a step by which the search continues after the first zero that changes the motion."""


@dataclass(frozen=True)
class Zeros:
    """The zeros of watched functions on a step, and the signs of the functions at its end.

    Each zero has a time in units of the time scale, the index of its function in `places`, and a direction: the
    sign to which the function changes, or 0 if it touches zero. `near_flags` is 1 for each function that is
    near zero at the end.
    """

    times: Out
    places: WholesOut
    directions: WholesOut
    signs: WholesOut
    near_flags: WholesOut


@inline
def zeros_of(view: WatchedView, number: int) -> Zeros:
    """Return one of the two lists of zeros in the scratch memory; `number` is 0 or 1."""
    count, ends = view.layout.watched, view.ends
    size = count * MOST_ZEROS
    indices, directions = [view.zeros[size * (2 * number + i) :] for i in (0, 1)]
    return Zeros(view.times[size * number :], indices, directions, *[ends[count * (2 * number + i) :] for i in (0, 1)])


@procedure(noinline=True, watched=watched_type)
def zeros_on_step(
    s: float, stored_length: float, zeros: Zeros, doubtful: In, watched: Watched, last: bool, until: bool
) -> int:
    """Find the zeros of watched functions on a step of length s, sorted by time, and return their number.

    The zeros are written to `zeros`. The result is -1 on failure. Only functions with a nonzero entry in `doubtful`
    are searched. With `until`, only zeros up to the first that certainly changes the motion, and zeros simultaneous
    with it, are needed. The search then ends at twice the time of that zero, or at `SEARCH_MARGIN` of the step
    after it if that is later. At that time, simultaneous zeros are clearly passed. `stored_length` is the length
    for which `event_terms` has stored terms. `last` is true if the run ends at the end of the step.
    """
    view, count, far = view_of(watched), 0, s
    for i in range(view.layout.watched):
        zeros.signs[i], zeros.near_flags[i] = view.start_signs[i], view.start_near_flags[i]
        if doubtful[i] != 0.0:
            more = find_zeros(i, count, far, s, stored_length, last, zeros, watched)
            if more < 0:
                return -1
            for j in range(count, count + more):
                zeros.places[j] = i
            if until:
                may_change, expected = view.moves(i), view.directions[i]
                for j in range(count, count + more):
                    at = zeros.times[j]
                    changes = may_change and is_counted(zeros.directions[j], expected)
                    end = at + larger(at, SEARCH_MARGIN * s)
                    far = end if changes and end < far else far
            count += more
    sort_zeros(count, zeros.times, (zeros.places, zeros.directions))
    return count


@procedure(watched=watched_type)
def find_zeros(
    i: int, to: int, s: float, step: float, stored_length: float, last: bool, zeros: Zeros, watched: Watched
) -> int:
    """Write the zeros of watched function i up to time s to `zeros`, from index `to` on. Return their number.

    The result is negative on failure. The sums of the terms of its series usually decide. Otherwise roots are
    isolated. A function that starts at zero is divided by time, which removes that root: the next root may be close
    to it. `step` is the length of the whole step, and `stored_length` the length for which terms are stored. `last`
    is true if the run ends at the end of the step.
    """
    view, order = view_of(watched), watched.order
    sign, is_near = view.start_signs[i], view.start_near_flags[i] != 0
    begins, noise = view.starting[i] != 0, view.noise[i]
    terms, slopes, sums = terms_of(view, i)
    answer, is_smooth = 2, not begins and not is_near
    if likely(is_smooth and s == stored_length):
        answer = only_zero(s, order, sign, noise, terms, sums)
    else:
        is_finite, c = column_of(view, i)
        if not is_finite:
            return -1
        if is_smooth and keeps_sign(c, view.coefficient_counts[i], s, noise, float(sign)):
            answer = 0
    if unlikely(answer == 2):
        is_finite, c = column_of(view, i)
        if not is_finite:
            return -1
        first, allowed = int(begins), 0.0 if begins else noise
        series, size = c[first:], view.coefficient_counts[i] - first
        at_end, times, directions = last and s == step, zeros.times[to:], zeros.directions[to:]
        more, zeros.signs[i], comes_near = roots(
            series, size, s, allowed, sign, is_near, at_end, times, directions, MOST_ZEROS
        )
        zeros.near_flags[i] = int(comes_near)
        return more
    if answer != 0:
        zeros.times[to] = s * only_passage(terms, slopes, sums, order, answer)
        zeros.directions[to] = zeros.signs[i] = answer
        return 1
    return 0


CLOSE_ROOTS = 8.0
"""Distance of two zeros of one function below which they are one zero, as a multiple of the distance of simultaneous
zeros.
"""

MOST_BALANCING = 200
"""Largest number of halvings of a step until no term of power 2 or more dominates the series of a watched function."""

GO_ON, LEAVE, WAIT = range(3)
"""Decisions: take the step, leave the step to the caller, or return because the memory for events is full."""


@dataclass(frozen=True)
class InspectedStep:
    """A Taylor step whose watched functions are to be searched for zeros.

    t      The time at which the step begins.
    low    The rounding error of `t`.
    scale  The unit of time of the series.
    rtol   The relative tolerance of the series.
    s      The length of the step in units of `scale`.
    left   Time from the beginning of the step to the end of the run.
    final  True if the step ends at the end of the run.
    """

    t: float
    low: float
    scale: float
    rtol: float
    s: float
    left: float
    final: bool


@dataclass(frozen=True)
class StepEnd:
    """The end of a Taylor step. Times are in units of the time scale.

    time   The end of the step. It is infinite if no zero ends the step.
    close  Zeros closer to the end than this belong to the end. For a due function this distance is larger: the
           longer and the shorter step locate its zero at slightly different times.
    due    The number of functions that are zero at the end and change the motion there.
    """

    time: float
    close: float
    due: int


@procedure(noinline=True, watched=watched_type)
def inspect_step(step: InspectedStep, doubtful: In, taylor: TaylorState, watched: Watched) -> tuple[int, float]:
    """Search a step for zeros of watched functions. Return a decision about the step and its new length.

    The decision is `GO_ON` to take it, `LEAVE` to leave it to the caller, or `WAIT` if the memory for events is
    full. The length is in units of the time scale. Only functions with a nonzero entry in `doubtful` are
    searched. If the step is taken, its events and the signs at its end are written. Otherwise the step and the
    events are unchanged.
    """
    view, watch, s = view_of(watched), watched.watch, step.s
    for i in range(view.layout.watched):
        view.values[i], view.coefficient_counts[i] = view.rows[i], 0
    write_noise(view, view.numbers, step.t, watched.work)
    is_polynomial = terminates(watched.work, watched.order, view.layout)
    length = trusted_part(step, is_polynomial, doubtful, watched)
    if length < 0.0:
        return LEAVE, s
    if unlikely(watch.steep != 0):
        length = verified_length(step, length, view)
    is_whole = length == s
    shortest = TOGETHER * abs(step.t) + LEAST_PART * abs(step.left)
    if not is_whole and abs(length * step.scale) < shortest:
        return LEAVE, s
    if not write_sides(length, doubtful, watched):
        return LEAVE, s
    zeros, until = zeros_of(view, 0), watch.changing != 0
    count = zeros_on_step(length, s, zeros, doubtful, watched, last=is_whole and step.final, until=until)
    if count < 0:
        return LEAVE, s
    change = change_on_step(zeros, count, watched)
    if change < 0:
        end = StepEnd(time=math.inf, close=0.0, due=0)
        return accept_zeros(zeros, count, end, step, taylor, watched, again=is_polynomial), length
    return end_at_change(zeros, count, change, step, doubtful, taylor, watched)


@inline
def verified_length(step: InspectedStep, length: float, view: WatchedView) -> float:
    """Return the step length, at most `length`, at whose end the watched functions agree with their series.

    `step` is the step that is shortened to this length, in units of the time scale.
    """
    functions = view.watched.values, view.numbers, view.tilts
    scratch = view.noise, view.end_values, view.end_noise, view.new_entries, view.moved
    series = view.sizes, view.work, view.order
    verified, limiting = verified_step(*functions, step.t, step.scale, step.rtol, length, *scratch, *series)
    view.watch.limiting = limiting if verified < length else view.watch.limiting
    return verified


@procedure(watched=watched_type)
def end_at_change(
    zeros: Zeros, number: int, change: int, step: InspectedStep, doubtful: In, taylor: TaylorState, watched: Watched
) -> tuple[int, float]:
    """Shorten the step to the first zero that changes the motion. Return a decision and the new length.

    The decision is `GO_ON`, `LEAVE` or `WAIT`, as for `inspect_step`. `number` is the number of `zeros` on the
    step, and `change` the index of the zero that changes the motion. On the shorter step more zeros may be
    resolved: they are recorded, and one of them may be an earlier change. The functions that are zero at the
    new end are written to the list of due functions: their reset or crossing follows. If the change is at the
    start, no step is taken.
    """
    watch, count, s = watched.watch, number, step.s
    shorter, at, again = zeros_of(view_of(watched), 1), zeros.times[change], True
    due = add_due(zeros, count, at, simultaneous(step, at), 0, watched, proven=False)
    while again and at > 0.0:
        count = zeros_on_step(at, s, shorter, doubtful, watched, last=False, until=False)
        if count < 0:
            return LEAVE, s
        early = count_before(shorter, count, at - simultaneous(step, at))
        earlier = change_on_step(shorter, early, watched)
        again = earlier >= 0
        if again:
            at = shorter.times[earlier]
            due = add_due(shorter, count, at, simultaneous(step, at), 0, watched, proven=False)
    if at <= 0.0:
        watch.due = due
        return LEAVE, s
    close = simultaneous(step, at)
    due = add_due(shorter, count, at, close, due, watched, proven=True)
    answer = accept_zeros(shorter, count, StepEnd(at, close, due), step, taylor, watched, again=True)
    watch.due = due if answer == GO_ON else 0
    return answer, at


@procedure(watched=watched_type)
def add_due(zeros: Zeros, count: int, at: float, close: float, due: int, watched: Watched, proven: bool) -> int:
    """Append the functions that are zero at the end of a step to the list of due functions. Return its length.

    Due functions are those whose reset or crossing follows. `due` is the present length of the list. The step ends
    at the time `at`, and `count` is the number of `zeros`. Zeros within the time `close` of the end count. If the
    zeros are not `proven`, a function whose zero is not exactly at the end must vanish at the end within its noise.
    """
    view, number = view_of(watched), due
    for j in range(count):
        index = zeros.places[j]
        if abs(zeros.times[j] - at) <= close and not is_due(index, number, view):
            is_zero = proven or zeros.times[j] == at
            if not is_zero:
                is_finite, c = column_of(view, index)
                is_zero = is_finite and vanishes(c, watched.order + 1, at, view.noise[index])
            if is_zero:
                view.due[number], view.due_directions[number] = index, zeros.directions[j]
                number += 1
    return number


@inline
def is_due(index: int, due: int, view: WatchedView) -> Any:
    """Return True if function number `index` is among the first `due` entries of the list of due functions.

    Due functions are zero at the end of the step, and change the motion there.
    """
    indices, is_there = view.due, False
    for j in range(due):
        is_there = is_there or indices[j] == index
    return is_there


@inline
def terminates(work: In, order: int, layout: RecordedLayout) -> bool:
    """Return True if the series of the state are polynomials: their last two coefficients are zero.

    Such series do not limit the step. The rows of coefficients are in the work array.
    """
    last, before = row(work, order, layout), row(work, order - 1, layout)
    index = 0
    while index < layout.dimension and last[index] == 0.0 and before[index] == 0.0:
        index += 1
    return index == layout.dimension


@procedure(watched=watched_type)
def trusted_part(step: InspectedStep, is_polynomial: bool, doubtful: In, watched: Watched) -> float:
    """Return the length, at most that of the step, up to which the series of watched functions are accurate.

    The result is -1 if a series is not finite. Only functions with a nonzero entry in `doubtful` count.
    `is_polynomial` is true if the series of the state terminate.
    """
    view, order, s, watch = view_of(watched), watched.order, step.s, watched.watch
    count, length = order + 1, s
    tolerance, hides_growth = larger(step.rtol, 2.0**-52) * EVENT_SLACK, watch.hides_growth != 0
    for i in range(view.layout.watched):
        if doubtful[i] != 0.0:
            (terms, slopes, sums), noise = terms_of(view, i), view.noise[i]
            event_terms(view.rows[i:], view.layout.width, order, s, terms, slopes, sums)
            late, early = sums[LATE], magnitude(terms[0], terms[1])
            if unlikely(not late <= fma(tolerance, early, noise)):
                is_finite, c = column_of(view, i)
                if not is_finite:
                    return -1.0
                length = limited_to(reach(c, count, s, tolerance, noise), length, i, watch)
            if unlikely(hides_growth):
                is_finite, c = column_of(view, i)
                if not is_finite:
                    return -1.0
                length = limited_to(safe_step(c, count), length, i, watch)
    if unlikely(is_polynomial):
        # A series whose terms are balanced on a step is also balanced on each shorter step.
        halvings = 0
        for i in range(view.layout.watched):
            if doubtful[i] != 0.0:
                is_finite, c = column_of(view, i)
                if not is_finite:
                    return -1.0
                is_done = False
                while not is_done and halvings < MOST_BALANCING:
                    is_done = is_balanced(c, view.coefficient_counts[i], length)
                    halvings += int(not is_done)
                    length = length if is_done else length * 0.5
    return length


@inline
def limited_to(far: float, length: float, which: int, watch: Watch) -> float:
    """Return the smaller of two lengths, `far` and `length`.

    If `far` is smaller, record that watched function number `which` limits the step.
    """
    watch.limiting = which if far < length else watch.limiting
    return smaller(length, far)


@procedure(watched=watched_type)
def write_sides(s: float, doubtful: In, watched: Watched) -> bool:
    """Write the signs of watched functions at the start of a step, for a search on the length s.

    The signs are those known so far. A function that jumped over zero since the last step has the opposite sign;
    only functions with a nonzero entry in `doubtful` are tested for such a jump. Return False if a series is not
    finite.
    """
    view = view_of(watched)
    for i in range(view.layout.watched):
        sign = view.signs[i]
        view.start_signs[i], view.start_near_flags[i] = sign, view.near_flags[i]
        if unlikely(doubtful[i] != 0.0 and float(sign) * view.values[i] < 0.0):
            is_finite, c = column_of(view, i)
            if not is_finite:
                return False
            if abs(c[0]) > JUMP * largest_term(c, view.coefficient_counts[i], s):
                view.start_signs[i], view.start_near_flags[i] = -sign, 0
    return True


@procedure(watched=watched_type)
def change_on_step(zeros: Zeros, count: int, watched: Watched) -> int:
    """Return the index of the first of `count` zeros that changes the motion, or -1 if none does.

    Changes of the motion are resets, crossed surfaces and the end of the run.
    """
    view = view_of(watched)
    if watched.watch.changing == 0:
        return -1
    for i in range(view.layout.watched):
        terminal = view.terminals[i]
        left = max(terminal - view.event_counts[i], 1) if terminal > 0 else 0
        view.remaining[i] = 1 if view.moves(i) else left
    return first_change(count, zeros.places, zeros.directions, view.directions, view.remaining)


@inline
def count_before(zeros: Zeros, count: int, time: float) -> int:
    """Return the number of zeros before `time` among the first `count`, which are in order of time."""
    early = 0
    for j in range(count):
        early += int(zeros.times[j] < time)
    return early


@inline
def simultaneous(step: InspectedStep, at: float) -> float:
    """Return the time within which zeros near the time `at` of a step count as simultaneous.

    Both times are in units of the time scale.
    """
    return TOGETHER * larger(abs(step.t / step.scale), at)


@procedure(watched=watched_type)
def accept_zeros(
    zeros: Zeros, count: int, end: StepEnd, step: InspectedStep, taylor: TaylorState, watched: Watched, again: bool
) -> int:
    """Write the events on a step before its `end`, and the signs of watched functions at the end.

    `count` is the number of `zeros`. The signs before the step are saved. `again` forces an inspection of the next
    step. The result is `GO_ON`, or `LEAVE` or `WAIT` if the arrays have no space.
    """
    view, watch = view_of(watched), watched.watch
    if watch.done + count > watch.room:
        return LEAVE if watch.done == 0 else WAIT
    save_sides(view)
    is_near_zero = take_sides(zeros, view)
    taylor.inspect = int(again or watch.hides_growth != 0 or watch.steep != 0 or is_near_zero)
    watch.ahead, watch.due, watch.unproven = write_events(zeros, count, end, step, view), 0, 1
    return GO_ON


@inline
def save_sides(view: WatchedView) -> None:
    """Save the signs at the start of a step and the numbers of events, in case the step is not taken."""
    for i in range(view.layout.watched):
        view.kept_signs[i], view.kept_near_flags[i] = view.start_signs[i], view.start_near_flags[i]
        view.kept_starting[i], view.kept_event_counts[i] = view.starting[i], view.event_counts[i]


@inline
def take_sides(zeros: Zeros, view: WatchedView) -> bool:
    """Store the signs of watched functions at the end of a step. Return True if a function is zero or near zero."""
    is_near_zero = False
    for i in range(view.layout.watched):
        sign, near = zeros.signs[i], zeros.near_flags[i]
        view.signs[i], view.near_flags[i], view.starting[i] = sign, near, 0
        is_near_zero = is_near_zero or sign == 0 or near != 0
    return is_near_zero


@inline
def write_events(zeros: Zeros, count: int, end: StepEnd, step: InspectedStep, view: WatchedView) -> int:
    """Write the events among the zeros before the end of a step. Return the number of events that are written."""
    slot: int = view.watch.done
    for j in range(count):
        index, time = zeros.places[j], zeros.times[j]
        counts = view.is_event(index) and is_counted(zeros.directions[j], view.directions[index])
        distance = end.close * CLOSE_ROOTS if is_due(index, end.due, view) else end.close
        if counts and time < end.time - distance:
            view.event_counts[index] += 1
            state = view.write_event(slot, (step.t + step.low) + time * step.scale, index)
            state_on_step(time, state, view.sizes, view.work, view.order)
            slot += 1
    return slot
