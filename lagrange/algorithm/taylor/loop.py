"""The loop over Taylor steps: compute the series at the state, test the defect of the last step, take the next step."""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import MOST_SURVEYS
from lagrange.algorithm.step.run import Counts, Run
from lagrange.algorithm.taylor.defect_test import defect_is_small, record_step, reject_step, retries_exhausted
from lagrange.algorithm.taylor.event_series import contradicts
from lagrange.algorithm.taylor.memory import Held, TaylorLayout, TaylorState, weights_type
from lagrange.algorithm.taylor.step import take_step
from lagrange.algorithm.taylor.step_size import choose_exponent, first_floors, forget_first_floors, logarithm, weigh
from lagrange.algorithm.taylor.watching import Arguments, arguments, numbers_of, restore_sides, watched_of
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, each, likely, mantissa, reals, unlikely


@procedure(given=arguments)
def taylor_steps(given: Arguments, budget: int, *, layout: TaylorLayout) -> Outcome:
    """Take Taylor steps, and return an outcome: at the end, after `budget` steps, or on failure."""
    counts = given.counts
    counts.rows = 0
    given.held.unproven = 0
    if counts.kept == 0:
        begin_run(given.run, counts, given.taylor, given.held, given.work, layout)
    # Minus the binary logarithm of the relative tolerance.
    digits = -logarithm(given.run.rtol)
    # The last iteration only tests the last step.
    for i in range(budget + 1):
        outcome = iteration(given, i == budget, digits, layout=layout)
        if unlikely(outcome != Outcome.PAUSED):
            return outcome
    return Outcome.PAUSED


@inline
def begin_run(run: Run, counts: Counts, taylor: TaylorState, held: Held, work: Any, layout: TaylorLayout) -> None:
    """Reset the compensation, the counters and the limits. Set the sign of the time scale to the run's direction.

    The caller may have asked for an inspection of the first step.
    """
    counts.kept = 1
    low = work[layout.lost :]
    for i in each(layout.padded, **layout.loop):
        low[i] = 0.0
    taylor.low, held.h = 0.0, 0.0
    taylor.scale = -1.0 if run.end < run.t else 1.0
    taylor.next_limit = taylor.limit = math.inf
    taylor.rescalings = taylor.failures = 0


@procedure(given=arguments)
def iteration(given: Arguments, last: bool, digits: float, *, layout: TaylorLayout) -> Outcome:
    """Test the defect of the last step, and take the next one. Return an outcome: PAUSED if the run continues.

    If `last`, no further step is taken. `digits` is minus the binary logarithm of the relative tolerance.
    """
    run, counts, taylor, held = given.run, given.counts, given.taylor, given.held
    work, order = given.work, given.order
    is_there, is_idle = run.t == run.end, held.unproven == 0
    if is_idle and is_there:
        return Outcome.DONE
    if is_idle and last:
        return Outcome.PAUSED
    is_singular = given.jet(run.t, taylor.scale, work, *numbers_of(given, layout), work[layout.rows :], order)
    counts.evaluations += 1
    weights = reals(layout.padded, room=layout.block)
    weigh(run.rtol, given.floors, weights, work, layout=layout)
    if likely(not is_idle):
        outcome = prove_step(given, weights, is_singular, layout=layout)
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
        # Floors of entries that are zero, at the start and after a change of the time scale, until sizes are known.
        is_blind = first_floors(run.share, given.floors, work, order, layout=layout)
        if is_blind and may_ask(run, counts):
            if counts.steps == 0:
                # The first series is in the unit of time, and says nothing of the sizes in a step.
                forget_first_floors(given.floors, work, layout)
            return Outcome.UNSCALED
        weigh(run.rtol, given.floors, weights, work, layout=layout)
    exponent = choose_exponent(run.rtol, digits, given.floors, weights, work, order, layout=layout)
    return take_step(given, exponent, layout=layout)


@procedure(given=arguments, weights=weights_type)
def prove_step(given: Arguments, weights: In, is_singular: bool, *, layout: TaylorLayout) -> Outcome:
    """Record or reject the last step: DONE if it is recorded, PAUSED if it is rejected.

    `weights` are 1 / tolerance of each entry of the state. `is_singular` is true if the new series has a singular
    matrix. At the second, fourth, eighth, ... rejection of a run the outcome is UNSCALED: the caller has to estimate
    the sizes of the entries.
    """
    run, counts, taylor, held = given.run, given.counts, given.taylor, given.held
    work, order, watched = given.work, given.order, watched_of(given)
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
    record_step(run, counts, taylor, held, given.outputs, work, given.times, given.rows, layout=layout)
    if watched is not None:
        watched.watch.done, watched.watch.unproven = watched.watch.ahead, 0
    return Outcome.DONE


@inline
def may_ask(run: Run, counts: Counts) -> bool:
    """Return True if the run may return for an estimate of sizes, because its floors follow the scale."""
    return run.share > 0.0 and counts.surveyed < MOST_SURVEYS
