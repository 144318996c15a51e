"""The defect test of a Taylor step: at its end the derivative of its series must agree with the equations.

A step is recorded when the series of the next step confirms it. Otherwise the run returns to the beginning of the step
and tries a shorter one. Functions with powers above the order of the series are compared with their series as well.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.algorithm.taylor.constants import DEFECT, DEFECT_NOISE, EVENT_SLACK, MOST_FAILURES, PROBES, RETRY_FRACTION
from lagrange.algorithm.taylor.event_series import event_noise
from lagrange.algorithm.taylor.memory import (
    BLOCK,
    HELD,
    JET,
    OUTPUTS,
    SIZES,
    TAYLOR,
    RecordedLayout,
    SeriesMemory,
    TaylorLayout,
    entries,
    floors_array,
    weights_array,
    work_array,
)
from lagrange.algorithm.taylor.step_size import weigh
from lagrange.algorithm.taylor.sums import horner, state_on_step
from lagrange.algorithm.taylor.watching import FUNCTION
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real


@shared
def defect_is_small(layout: TaylorLayout) -> Procedure:
    """Return the comparison of the stored derivative with the first coefficients of some rows.

    `length` is the length of the step in units of the scale.
    """
    p = Builder("defect_is_small", "Whether the derivative that is held is what the equations say.")
    length, order, first = p.given("length", REAL), p.given("order", WHOLE), p.given("first", WHOLE)
    weights, work = weights_array(p, layout), work_array(p)
    rows, slopes, own = (memory.at(layout.moving) for memory in (work.at(first), work.at(layout.slope), weights))
    with entries(p, layout, layout.moving) as i:
        weight, there = own[i], rows[i]
        off = p.largest_magnitude((there - slopes[i]) * weight)
        most = p.largest_magnitude(there * weight)
    allowed = DEFECT * p.real(order) / length
    p.leave(off.value <= p.fma(DEFECT_NOISE, most.value, allowed))
    return p.finish(FLAG)


def retries_exhausted(taylor: Any) -> Flag:
    """Return the flag that the retry limit is reached: a shorter step would be lost in round-off."""
    found: Flag = taylor.failures >= MOST_FAILURES
    return found


@shared
def retry_shorter() -> Procedure:
    """Return the procedure that prepares a shorter step, with a new inspection of the event functions."""
    p = Builder("retry_shorter", "Try again with a shorter step.", apart=True)
    counts: Any = p.record("counts", COUNTS)
    taylor: Any = p.record("taylor", TAYLOR)
    h: Real = p.given("h", REAL)
    taylor.limit = RETRY_FRACTION * abs(h)
    taylor.next_limit = math.inf
    taylor.failures = taylor.failures + 1
    counts.rejected = counts.rejected + 1
    taylor.inspect, taylor.rescalings = 1, 0
    return p.finish()


@shared
def reject_step(layout: TaylorLayout) -> Procedure:
    """Return the procedure that goes back to the beginning of a step that failed the test."""
    p = Builder("reject_step", "Go back to where the last step began.", apart=True)
    run: Any = p.record("run", RUN)
    counts: Any = p.record("counts", COUNTS)
    taylor: Any = p.record("taylor", TAYLOR)
    held: Any = p.record("held", HELD)
    work = work_array(p)
    p.copy(work.at(layout.held), work, 2 * layout.padded, width=layout.block)
    run.t, taylor.low, taylor.scale = held.t, held.low, held.scale
    held.unproven = 0
    p.call(retry_shorter(), counts, taylor, held.h)
    return p.finish()


@shared
def record_step(layout: TaylorLayout) -> Procedure:
    """Return the procedure that counts and records a confirmed step; after failures the next step at most doubles."""
    p = Builder("record_step", "Count and record a step that passed the defect test.")
    run: Any = p.record("run", RUN)
    counts: Any = p.record("counts", COUNTS)
    taylor: Any = p.record("taylor", TAYLOR)
    held: Any = p.record("held", HELD)
    outputs: Any = p.record("outputs", OUTPUTS)
    work, times, rows = work_array(p), p.array("times"), p.array("rows", room=layout.block)
    failed = (taylor.failures > 0) & ~retries_exhausted(taylor)
    limit = p.choose(failed, abs(held.h), taylor.limit)
    taylor.limit = limit + limit
    taylor.failures = 0
    held.unproven = 0
    counts.steps = counts.steps + 1
    outputs.done = outputs.ahead
    with p.when(~counts.record.equals(0)):
        row = counts.rows
        times[row] = run.t
        target, whole = rows.at(row * layout.dimension), layout.chains
        p.copy(work, target, layout.dimension, width=layout.block, spill=False, unrolled=whole)
        counts.rows = row + 1
    return p.finish()


@shared
def defect_along_step(layout: TaylorLayout) -> Procedure:
    """Return the comparison of a series with the equations along a step of length s in units of the scale."""
    p = Builder("defect_along_step", "Whether the equations say what a series says, all along a step.", apart=True)
    jet, prepared, constants = p.function("jet", JET), p.array("prepared", read=True), p.array("constants", read=True)
    rtol, floors = p.given("rtol", REAL), floors_array(p, layout)
    t, scale, s = (p.given(name, REAL) for name in ("t", "scale", "s"))
    run = SeriesMemory(p, layout, work_array(p))
    weights = p.reserve(layout.padded, room=layout.block, name="weights")
    p.call(weigh(layout), rtol, floors, weights, run.work)
    begin = p.whole(layout.ahead(run.order))
    there, slopes = run.work.at(begin), run.work.at(layout.slope)
    rows = there.at(layout.rows)
    with p.loop(1, PROBES) as j:
        part: Real = s * (p.real(j) * (1.0 / PROBES))
        with run.entries() as i:
            total, slope = horner(run, part, i)
            there[i] = run.work[i] + total
            slopes[i] = slope
        singular = jet(p.fma(part, scale, t), scale, there, prepared, constants, rows, run.order)
        first = begin + (layout.rows + layout.width)
        p.leave_if(singular | ~p.call(defect_is_small(layout), s, run.order, first, weights, run.work), p.false)
    p.leave(p.true)
    return p.finish(FLAG)


MOST_HALVINGS = 60
"""Largest number of halvings of a step until the series agree."""


@shared
def verified_step() -> Procedure:
    """Return the procedure that shortens a step until the series of all watched functions agree with them at its end.

    At x = 0 the series of x**40 is zero up to order 39, and does not show that the function rises.
    """
    return _Verification().build()


class _Verification:
    """Builds the procedure."""

    def __init__(self) -> None:
        self.p = p = Builder("verified_step", "Return a step at whose end all series agree.", apart=True)
        self.function = p.function("function", FUNCTION)
        self.numbers, self.tilts = p.array("numbers", read=True), p.array("tilts", read=True)
        self.t, self.scale, self.rtol, self.s = (p.given(name, REAL) for name in ("t", "scale", "rtol", "s"))
        self.noise, self.there = p.array("noise", read=True), p.array("there", room=BLOCK)
        self.blur, self.state, self.moved = (p.array(name, room=BLOCK) for name in ("blur", "state", "moved"))
        self.sizes: Any = p.record("sizes", SIZES)
        self.layout: Any = RecordedLayout(self.sizes)
        self.memory = SeriesMemory(p, self.layout, work_array(p))
        self.layout.read()

    def build(self) -> Procedure:
        p, layout, again = self.p, self.layout, self.p.variable(self.p.true, "again")
        s, halvings = p.variable(self.s, "length"), p.variable(0, "halvings")
        with p.repeat(lambda: again.value & (halvings.value < MOST_HALVINGS)):
            end = self.t + s.value * self.scale
            p.call(state_on_step(), s.value, self.state, self.sizes, *self.memory.handed)
            p.leave_if(self.function(end, self.state, self.numbers, self.there), s.value)
            again.value = self.disagrees(s.value, None)
            with p.when(again.value):
                # Rounding of the state at the end may explain the difference.
                sizes = layout.dimension, layout.watched
                function = self.function, self.numbers, self.tilts
                p.call(event_noise.form(), *function, end, *sizes, self.state, self.there, self.blur, self.moved)
                again.value = self.disagrees(s.value, self.blur)
            s.value = p.choose(again.value, s.value * 0.5, s.value)
            halvings.value = halvings.value + 1
        p.leave(s.value)
        return p.finish(REAL)

    def disagrees(self, s: Real, blur: Memory | None) -> Flag:
        """Return whether the sum of some series differs from its function at the end of a step."""
        p, width, wrong = self.p, self.layout.width, self.p.variable(self.p.false, "wrong")
        tolerance = p.larger(self.rtol, 2.0**-52)
        first = self.memory.row(0).at(self.layout.watched_at)
        with p.loop(0, self.layout.watched) as i:
            series, total, most = first.at(i), p.variable(0.0, "total"), p.variable(0.0, "most")
            power = p.variable(1.0, "power")
            with p.loop(0, self.memory.order + 1) as k:
                term = series[k * width] * power.value
                total.value, most.value = total.value + term, p.magnitude(most.value, term)
                power.value = power.value * s
            noise = self.noise[i] if blur is None else self.noise[i] + blur[i]
            allowed = EVENT_SLACK * p.fma(tolerance, most.value, noise)
            wrong.value = wrong.value | ~(abs(total.value - self.there[i]) <= allowed)
        found: Flag = wrong.value
        return found
