"""The defect test of a Taylor step: at its end the derivative of its series must agree with the equations.

A step is recorded when the series of the next step confirms it. Otherwise the run returns to the start of the step and
tries a shorter one. Functions with powers above the order of the series are also compared with their series.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.step.memory import FUNCTION, Counts, Run
from lagrange.algorithm.taylor.event_series import event_noise
from lagrange.algorithm.taylor.memory import (
    EVENT_SLACK,
    JET,
    PROBES,
    Held,
    OutputCounts,
    Sizes,
    TaylorLayout,
    TaylorState,
    floors_type,
    layout_of,
    row,
    rows_type,
    weights_type,
    work_type,
)
from lagrange.algorithm.taylor.step_size import weigh
from lagrange.algorithm.taylor.sums import horner, state_on_step
from lagrange.procedure.form import Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, larger, magnitude, reals

DEFECT, DEFECT_NOISE = 4.0, 2.0**-40
"""Bound of the defect: the derivative of the series at the end of a step minus the right-hand side there. The bound is
this many tolerances per order, divided by the step, plus a relative rounding of the largest derivative. The truncation
error at order p has a derivative of p tolerances over the step. The largest defect in ten scenes at five tolerances was
1.1 times that.
"""

RETRY_FRACTION, MOST_FAILURES = 0.25, 24
"""A rejected step is repeated at a quarter of its length, up to this many times. Then the step is at rounding level."""


@procedure(weights=weights_type, work=work_type)
def defect_is_small(length: float, order: int, first: int, weights: In, work: Out, *, layout: TaylorLayout) -> bool:
    """Return True if the defect of a step is small: two derivatives at its end agree.

    One is that of the step's series, stored in the work array. The other is that of the new series at the end,
    whose coefficients of order 1 begin at index `first` of the work array. `length` is the length of the step
    in units of the time scale, and `weights` are 1 / tolerance of each entry of the state.
    """
    begin = layout.moving
    rows, slopes = work[first:][begin:], work[layout.slope + begin :]
    off, most = 0.0, 0.0
    for i in each(layout.padded - begin, **layout.loop):
        weight, new_slope = weights[begin:][i], rows[i]
        off = magnitude(off, (new_slope - slopes[i]) * weight)
        most = magnitude(most, new_slope * weight)
    allowed = DEFECT * float(order) / length
    return off <= fma(DEFECT_NOISE, most, allowed)


@inline
def retries_exhausted(taylor: TaylorState) -> bool:
    """Return True if the retry limit is reached: a shorter step would be lost in rounding."""
    return taylor.failures >= MOST_FAILURES


@procedure(apart=True)
def retry_shorter(counts: Counts, taylor: TaylorState, h: float) -> None:
    """Count a rejection of a step of length h, and bound the steps that follow by a fraction of h.

    An inspection for events is requested for the next step.
    """
    taylor.limit = RETRY_FRACTION * abs(h)
    taylor.next_limit = math.inf
    taylor.failures += 1
    counts.rejected += 1
    taylor.inspect, taylor.rescalings = 1, 0


@procedure(apart=True, work=work_type)
def reject_step(run: Run, counts: Counts, taylor: TaylorState, held: Held, work: Out, *, layout: TaylorLayout) -> None:
    """Undo the last step, and bound the length with which it is repeated.

    The state at its start and the rounding errors are copied back inside `work`. Its time and its unit of time
    come from `held`.
    """
    kept, size = work[layout.held :], 2 * layout.padded
    for i in each(size, width=layout.block, spill=True, disjoint=True):
        work[i] = kept[i]
    run.t, taylor.low, taylor.scale = held.t, held.low, held.scale
    held.unproven = 0
    retry_shorter(counts, taylor, held.h)


@procedure(rows=rows_type, work=work_type)
def record_step(
    run: Run,
    counts: Counts,
    taylor: TaylorState,
    held: Held,
    outputs: OutputCounts,
    work: Out,
    times: Out,
    rows: Out,
    *,
    layout: TaylorLayout,
) -> None:
    """Count a step that passed the defect test, and write its end to `times` and `rows` if rows are recorded.

    After rejections the next step is at most twice as long.
    """
    length, limit, is_exhausted = abs(held.h), taylor.limit, retries_exhausted(taylor)
    limit = length if taylor.failures > 0 and not is_exhausted else limit
    taylor.limit = limit + limit
    taylor.failures = 0
    held.unproven = 0
    counts.steps += 1
    outputs.done = outputs.ahead
    if counts.record != 0:
        row = counts.rows
        times[row] = run.t
        target = rows[row * layout.dimension :]
        for i in each(layout.dimension, width=layout.block, unrolled=layout.chains):
            target[i] = work[i]
        counts.rows = row + 1


@procedure(apart=True, jet=lambda: JET, floors=floors_type, work=work_type)
def defect_along_step(
    jet: Callable[..., Any],
    prepared: In,
    constants: In,
    rtol: float,
    floors: In,
    t: float,
    scale: float,
    s: float,
    work: Out,
    order: int,
    *,
    layout: TaylorLayout,
) -> bool:
    """Return True if a series satisfies the equations within tolerance at some points along a step.

    The step begins at time t, and has the length s in units of the time `scale`. The coefficients, up to
    `order`, are in the work array. `jet` is the function that computes a series at a state from the arrays
    `prepared` and `constants`. `floors` are the absolute tolerances of the entries of the state.
    """
    weights = reals(layout.padded, room=layout.block)
    weigh(rtol, floors, weights, work, layout=layout)
    begin = layout.ahead(order)
    probe, slopes = work[begin:], work[layout.slope :]
    for j in range(1, PROBES):
        part = s * (float(j) * (1.0 / PROBES))
        for i in each(layout.padded, **layout.loop):
            total, slope = horner(work, order, part, i, layout)
            probe[i] = work[i] + total
            slopes[i] = slope
        is_singular = jet(fma(part, scale, t), scale, probe, prepared, constants, probe[layout.rows :], order)
        first = begin + (layout.rows + layout.width)
        if is_singular or not defect_is_small(s, order, first, weights, work, layout=layout):
            return False
    return True


VERIFIED_HALVINGS = 60
"""Largest number of halvings of a step until the series agree."""


def state_type() -> Array:
    """Return the type of a parameter that is an array written in whole blocks."""
    return Array(room=WIDEST_VECTOR)


@procedure(
    apart=True,
    function=lambda: FUNCTION,
    end_values=state_type,
    end_noise=state_type,
    state=state_type,
    moved=state_type,
    work=work_type,
)
def verified_step(
    function: Callable[..., bool],
    numbers: In,
    tilts: In,
    t: float,
    scale: float,
    rtol: float,
    s: float,
    noise: In,
    end_values: Out,
    end_noise: Out,
    state: Out,
    moved: Out,
    sizes: Sizes,
    work: Out,
    order: int,
) -> tuple[float, int]:
    """Halve a step of length s until the series of all watched functions agree with the functions at its end.

    `function` evaluates the watched functions from a time, a state and `numbers`. The two agree if they differ
    by at most the tolerance `rtol`, relative to the largest term, or the rounding errors of the functions:
    `noise` at the start and `end_noise` at the end. `tilts` are factors near 1 that perturb the entries of a
    state. `end_values`, `end_noise`, `state` and `moved` are work memory. Return the new length, and the index
    of the first function that disagreed on the last step that was halved, or -1. Example: at x = 0 the series
    of x**40 is zero up to order 39, and does not show that the function rises.
    """
    layout = layout_of(sizes)
    again, halvings, limiting = True, 0, -1
    while again and halvings < VERIFIED_HALVINGS:
        end = t + s * scale
        state_on_step(s, state, sizes, work, order)
        if function(end, state, numbers, end_values):
            return s, limiting
        wrong = disagreeing(s, rtol, noise, None, end_values, work, order, layout)
        if wrong >= 0:
            # Rounding of the state at the end may cause the difference.
            event_noise(
                function, numbers, tilts, end, layout.dimension, layout.watched, state, end_values, end_noise, moved
            )
            wrong = disagreeing(s, rtol, noise, end_noise, end_values, work, order, layout)
        again = wrong >= 0
        limiting = wrong if again else limiting
        s = s * 0.5 if again else s
        halvings += 1
    return s, limiting


@inline
def disagreeing(
    s: float, rtol: float, noise: In, end_noise: In | None, end_values: In, work: Out, order: int, layout: Any
) -> int:
    """Return the index of the first watched function that its series does not reproduce at the end of a step.

    It is -1 if there is none. `s` is the length of the step. `end_values` are the functions at its end. `noise`
    and `end_noise` are their rounding errors at the start and at the end; the latter is None if unknown.
    """
    tolerance, wrong = larger(rtol, 2.0**-52), -1
    first = row(work, 0, layout)[layout.watched_at :]
    for i in range(layout.watched):
        total, most, power = 0.0, 0.0, 1.0
        for k in range(order + 1):
            term = first[i:][k * layout.width] * power
            total, most = total + term, magnitude(most, term)
            power *= s
        total_noise = noise[i] if end_noise is None else noise[i] + end_noise[i]
        allowed = EVENT_SLACK * fma(tolerance, most, total_noise)
        is_off = not abs(total - end_values[i]) <= allowed
        wrong = i if is_off and wrong < 0 else wrong
    return wrong
