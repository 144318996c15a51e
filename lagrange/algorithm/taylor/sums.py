"""Sums of a Taylor series on a step: the state at its end, the derivative, and the states at output times."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.projection import compensated
from lagrange.algorithm.taylor.memory import (
    Held,
    OutputCounts,
    Sizes,
    TaylorLayout,
    layout_of,
    row,
    rows_type,
    work_type,
)
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, likely, magnitude, quotient, reals


@procedure(work=work_type)
def advance(s: float, longer: float, work: Out, order: int, *, layout: TaylorLayout) -> bool:
    """Add the sum of the series at the end of a step to the state. Return False if the result is not finite.

    In that case the state is unchanged. `s` is the length of the step in units of the time scale. The addition is
    compensated. The old state is stored, and so is the derivative at the end of the step, multiplied by `longer`,
    the ratio of the next scale to this one. All are parts of `work`.
    """
    new, lost = reals(layout.padded, room=layout.block), reals(layout.padded, room=layout.block)
    low, slopes, powers = work[layout.lost :], work[layout.slope :], powers_of(s)
    if layout.chains:
        write_slopes(work, order, s, longer, layout)
    sums = sums_by_rows(work, order, s, layout) if layout.by_rows else None
    largest = 0.0
    for i in each(layout.padded, **layout.loop):
        if layout.chains:
            move = chained_sum(work, order, powers, i, layout)
        else:
            move, slope = horner(work, order, s, i, layout) if sums is None else (sums[0][i], sums[1][i])
            slopes[i] = slope * longer
        total, lost[i] = compensated(work[i], move + low[i])
        new[i] = total
        largest = magnitude(largest, total)
    good = largest < math.inf
    if likely(good):
        before, lost_before = work[layout.held :], work[layout.held + layout.padded :]
        for i in each(layout.padded, **layout.loop):
            before[i], lost_before[i] = work[i], low[i]
            work[i], low[i] = new[i], lost[i]
    return good


FIRST = (1, 2, 3, 4)
"""First orders of four partial sums of a series, each in powers of s**4. Four partial sums take a quarter of the time
of one sum.
"""


@inline
def powers_of(s: float) -> tuple[float, float, float]:
    """Return s, its square and its fourth power."""
    square = s * s
    return s, square, square * square


@inline
def series_sum(work: In, order: int, powers: tuple[float, float, float], i: int, layout: TaylorLayout) -> float:
    """Return the sum of x[k] s**k over 0 < k <= order, where x[k] are the coefficients of entry i of the state.

    `powers` are s, s**2 and s**4.
    """
    if layout.chains:
        return chained_sum(work, order, powers, i, layout)
    return horner(work, order, powers[0], i, layout)[0]


@inline
def chained_sum(work: In, order: int, powers: tuple[float, float, float], i: int, layout: TaylorLayout) -> float:
    """Return the sum of x[k] s**k over 0 < k <= order, where x[k] are the coefficients of entry i of the state.

    The sum has four partial sums, over k = first + 4 j for first = 1, 2, 3, 4. Partial sums with one coefficient
    more than the others begin one step earlier. `powers` are s, s**2 and s**4.
    """
    s, square, fourth = powers
    steps = quotient(order, 4)
    longer = order - steps * 4
    chains = tuple([top_of_chain(work, first, steps, longer >= first, fourth, i, layout) for first in FIRST])
    for j in range(2, steps + 1):
        coefficient_rows = [row(work, first + 4 * (steps - j), layout) for first in FIRST]
        chains = tuple(
            [fma(chain, fourth, coefficients[i]) for chain, coefficients in zip(chains, coefficient_rows, strict=True)]
        )
    odd, even = fma(square, chains[2], chains[0]), fma(square, chains[3], chains[1])
    return fma(s, odd, square * even)


@inline
def top_of_chain(
    work: In, first: int, steps: int, is_longer: bool, fourth: float, i: int, layout: TaylorLayout
) -> float:
    """Return the start of Horner's rule for a partial sum: its last coefficient, or the last two combined.

    The partial sum has the orders first, first + 4, ...: `steps` coefficients, one more if `is_longer`.
    `fourth` is s**4, and i the entry of the state.
    """
    top, below = row(work, first + 4 * steps, layout)[i], row(work, first + 4 * (steps - 1), layout)[i]
    return fma(top, fourth, below) if is_longer else below


@inline
def write_slopes(work: Out, order: int, s: float, longer: float, layout: TaylorLayout) -> None:
    """Write the derivative of the series at the end of a step of length s to `work`, for the defect test.

    It is the sum of k x[k] s**(k - 1) for k up to `order`, by Horner's rule, times `longer`, the ratio of the next
    time scale to this one. Only blocks of the state with velocities are summed. Coordinates need no test: their
    series satisfies dq/dt = v by construction.
    """
    begin = layout.moving
    slopes = work[layout.slope + begin :]
    for i in each(layout.padded - begin, **layout.loop):
        total, slope = row(work, order, layout)[begin:][i], 0.0
        for j in range(1, order):
            slope = fma(slope, s, total)
            total = fma(total, s, row(work, order - j, layout)[begin:][i])
        slopes[i] = fma(slope, s, total) * longer


@procedure(noinline=True, to=work_type, work=work_type)
def state_on_step(s: float, to: Out, sizes: Sizes, work: Out, order: int) -> None:
    """Write the state at the time s after the start of a step, in units of the time scale, to `to`.

    The Taylor coefficients of the step are in `work`; `sizes` says where. `order` is the order of the series.
    """
    layout = layout_of(sizes)
    lost = work[layout.lost :]
    if likely(layout.chains != 0):
        powers = powers_of(s)
        for i in each(layout.dimension, width=WIDEST_VECTOR):
            to[i] = work[i] + (chained_sum(work, order, powers, i, layout) + lost[i])
    else:
        for i in each(layout.dimension, width=WIDEST_VECTOR):
            to[i] = work[i] + (horner(work, order, s, i, layout)[0] + lost[i])


@inline
def horner(work: In, order: int, s: float, i: int, layout: TaylorLayout) -> tuple[float, float]:
    """Return the change of entry i of the state at the time s of a step, and its derivative at this time.

    They are the sums over 0 < k <= order of x[k] s**k and of k x[k] s**(k - 1), where x[k] are the coefficients of
    the entry.
    """
    total, slope = 0.0, 0.0
    for j in range(order):
        partial = total + row(work, order - j, layout)[i]
        slope = fma(slope, s, partial)
        total = partial * s
    return total, slope


@inline
def sums_by_rows(work: In, order: int, s: float, layout: TaylorLayout) -> Sequence[Out]:
    """Return two arrays with an entry for each entry of the state: the change by its series, and the derivative.

    They are the sums over 0 < k <= order of x[k] s**k and of k x[k] s**(k - 1), where x[k] are the coefficients. s
    is the time since the start of the step.
    """
    totals, slopes = reals(layout.padded, room=layout.block), reals(layout.padded, room=layout.block)
    for i in each(layout.padded, **layout.loop):
        totals[i] = 0.0
        slopes[i] = 0.0
    for j in range(order):
        coefficients = row(work, order - j, layout)
        for i in each(layout.padded, **layout.loop):
            partial = totals[i] + coefficients[i]
            slopes[i] = fma(slopes[i], s, partial)
            totals[i] = partial * s
    return totals, slopes


@inline
def outstanding(output_times: In, index: int, end: float, scale: float) -> bool:
    """Return True if output time number `index` exists and is before `end`, the time at which a step ends.

    `scale` has the sign of the run, positive for increasing times. The output times end with NaN.
    """
    return (output_times[index] - end) * scale < 0.0


@procedure(noinline=True, states=rows_type, work=work_type)
def write_outputs(
    end: float,
    held: Held,
    outputs: OutputCounts,
    output_times: In,
    states: Out,
    work: Out,
    order: int,
    *,
    layout: TaylorLayout,
) -> None:
    """Write the states at the `output_times` before `end`, the end of the last step, to `states`.

    A time equal to `end` belongs to the next step, which begins with the state at that time. `held` has the
    start of the step, and `outputs` counts the times that are done.
    """
    t, low, scale = held.t, held.low, held.scale
    inverse = 1.0 / scale
    before, lost = work[layout.held :], work[layout.held + layout.padded :]
    k = outputs.done
    while outstanding(output_times, k, end, scale):
        since = output_times[k] - t
        powers = powers_of((0.0 if since == 0.0 else since - low) * inverse)
        target = states[k * layout.dimension :]
        for i in each(layout.dimension, width=layout.block, unrolled=layout.chains):
            target[i] = before[i] + (series_sum(work, order, powers, i, layout) + lost[i])
        k += 1
    outputs.ahead = k
