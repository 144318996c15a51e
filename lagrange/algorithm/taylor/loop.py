"""The loop over Taylor steps: compute the series at the state, test the defect of the last step, take the next."""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import MOST_SURVEYS
from lagrange.algorithm.taylor.defect_test import defect_is_small, record_step, reject_step, retries_exhausted
from lagrange.algorithm.taylor.event_series import contradicts
from lagrange.algorithm.taylor.memory import TaylorLayout, entries
from lagrange.algorithm.taylor.step import take_step
from lagrange.algorithm.taylor.step_size import choose_exponent, first_floors, logarithm, weigh
from lagrange.algorithm.taylor.watching import Arguments, prove_sides, restore_sides
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real


@shared
def taylor_steps(layout: TaylorLayout) -> Procedure:
    """Return the loop; it returns at the end, after `budget` steps, or when a step fails."""
    p = Builder("taylor_steps", "Take Taylor steps towards the end, and return an outcome.")
    given = Arguments(p, layout, budget=WHOLE)
    run, counts = given.run, given.counts
    (budget,) = given.own
    counts.rows = 0
    given.held.unproven = 0
    with p.when(counts.kept.equals(0)):
        begin_run(p, layout, run, counts, given.taylor, given.held, given.series.work)
    p.note("Minus the binary logarithm of the relative tolerance.")
    digits = (-p.call(logarithm(), run.rtol)).called("digits")
    p.note("The last iteration only tests the last step.")
    with p.loop(0, budget + 1) as i:
        outcome = p.call(iteration(layout), *given.handed(i.equals(budget), digits))
        p.leave_if(~outcome.equals(Outcome.PAUSED), outcome, likely=False)
    p.leave(Outcome.PAUSED)
    return p.finish(WHOLE)


def begin_run(p: Builder, layout: TaylorLayout, run: Any, counts: Any, taylor: Any, held: Any, work: Memory) -> None:
    """Reset the compensation, the counters and the limits, and give the scale of time the sign of the run's direction.

    The caller may have asked for an inspection of the first step.
    """
    counts.kept = 1
    low = work.at(layout.lost)
    with entries(p, layout) as i:
        low[i] = 0.0
    taylor.low, held.h = 0.0, 0.0
    taylor.scale = p.choose(run.end < run.t, -1.0, p.real(1.0))
    taylor.next_limit = taylor.limit = math.inf
    taylor.rescalings = taylor.failures = 0


@shared
def iteration(layout: TaylorLayout) -> Procedure:
    """Return one iteration of the loop."""
    p = Builder(
        "iteration", "Prove the last step, take the next one, and return an outcome: paused where the run goes on."
    )
    given = Arguments(p, layout, last=FLAG, digits=REAL)
    run, counts, held, series = given.run, given.counts, given.held, given.series
    last, digits = given.own
    there: Flag = run.t.equals(run.end).called("there")
    idle: Flag = held.unproven.equals(0).called("idle")
    p.leave_if(idle & there, Outcome.DONE)
    p.leave_if(idle & last, Outcome.PAUSED)
    rows, numbers = series.work.at(layout.rows), given.numbers
    singular: Flag = given.jet(run.t, given.taylor.scale, series.work, *numbers, rows, series.order).called("singular")
    counts.evaluations = counts.evaluations + 1
    weights = p.reserve(layout.padded, room=layout.block, name="weights")
    p.call(weigh(layout), run.rtol, given.floors, weights, series.work)
    with p.when(~idle, likely=True):
        _test_defect(given, weights, singular)
        p.leave_if(there, Outcome.DONE)
        p.leave_if(last, Outcome.PAUSED)
    p.leave_if(singular, Outcome.SINGULAR)
    _begin_floors(given, weights)
    sizes = run.rtol, digits, given.floors, weights
    exponent: Real = p.call(choose_exponent(layout), *sizes, *series.handed).called("exponent")
    p.leave(p.call(take_step(layout), *given.handed(exponent)))
    return p.finish(WHOLE)


def _test_defect(given: Arguments, weights: Memory, singular: Flag) -> None:
    """Record or reject the last step. After repeated rejections, return UNSCALED to get the sizes of the entries."""
    p, layout, counts, held, series = given.p, given.layout, given.counts, given.held, given.series
    length = abs(held.h) / abs(given.taylor.scale)
    first = layout.rows + layout.width
    good = p.call(defect_is_small(layout), length, series.order, first, weights, series.work).called("good")
    with p.when(~((good & ~singular) | retries_exhausted(given.taylor)), likely=False):
        p.call(reject_step(layout), given.run, counts, given.taylor, held, series.work)
        if given.watched:
            restore_sides(given.watched)
        failed = p.real(counts.rejected)
        power_of_two = p.operation("mantissa", failed).equals(1.0)
        _leave_unscaled(given, (failed > 1.0) & power_of_two)
        p.leave(Outcome.PAUSED)
    if given.watched:
        _test_events(given, length)
    kept = given.run, counts, given.taylor, held, given.outputs, series.work
    p.call(record_step(layout), *kept, given.times, given.rows)
    if given.watched:
        prove_sides(given.watched)


def _test_events(given: Arguments, length: Real) -> None:
    """Reject the last step if a watched function contradicts its series, up to the limit of retries."""
    p, layout, watched = given.p, given.layout, given.watched
    if watched is None:
        return
    numbers = given.run.t, given.run.rtol, length
    wrong: Flag = p.call(contradicts(layout), *numbers, *watched.handed, *given.series.handed).called("wrong")
    with p.when(wrong, likely=False):
        given.taylor.inspect = 1
        with p.when(~retries_exhausted(given.taylor)):
            p.call(reject_step(layout), given.run, given.counts, given.taylor, given.held, given.series.work)
            restore_sides(watched)
            p.leave(Outcome.PAUSED)


def _leave_unscaled(given: Arguments, asked: Flag) -> None:
    """Return UNSCALED on a condition, if floors follow the scale; see `Outcome`."""
    run, counts = given.run, given.counts
    given.p.leave_if(asked & (run.share > 0.0) & (counts.surveyed < MOST_SURVEYS), Outcome.UNSCALED)


def _begin_floors(given: Arguments, weights: Memory) -> None:
    """Set the first floors at the start of a run, and after a change of the scale of time, until a survey."""
    p, layout, run, counts, taylor = given.p, given.layout, given.run, given.counts, given.taylor
    begins = (counts.steps.equals(0) | ~taylor.rescalings.equals(0)) & counts.surveyed.equals(0)
    with p.when(begins & (run.share > 0.0), likely=False):
        _leave_unscaled(given, p.call(first_floors(layout), run.share, given.floors, *given.series.handed))
        p.call(weigh(layout), run.rtol, given.floors, weights, given.series.work)
