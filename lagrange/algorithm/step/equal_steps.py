"""The loop over equal steps: times are multiples of the step, and the last step ends at the end of the run."""

from __future__ import annotations

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.constants import SHORTEST_LAST_STEP
from lagrange.algorithm.step.memory import Layout, Newton
from lagrange.algorithm.step.run import Running, running
from lagrange.algorithm.step.trial import accept_step, project_new_state, rows_array, try_step
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import Out, each, fma, reals, unrolled

UNROLLED_TEST = 2
"""Largest number of blocks of a vector for which the test for finite entries is written out."""


@procedure(given=running, rows=rows_array)
def equal_steps(given: Running, budget: int, times: Out, rows: Out, *, layout: Layout) -> Outcome:
    """Take equal steps, and return an outcome: at the end, after `budget` steps, or on failure.

    Time k of the grid is `start + k*h`, rounded once, so that errors of the times do not add up.
    """
    run, counts = given.run, given.counts
    discard_history(given, layout)
    entries = kept_entries(given, layout)
    start, end, h = run.start, run.end, run.step
    for _ in range(budget):
        t = run.t
        if t == end:
            return Outcome.DONE
        grid = fma(float(counts.steps + 1), h, start)
        left = end - fma(SHORTEST_LAST_STEP, h, grid)
        is_last = (-left if h < 0.0 else left) <= 0.0
        length = end - t if is_last else h
        outcome = try_step(given, t, length, entries, layout=layout)
        if outcome != Outcome.DONE:
            return outcome
        if not is_finite(given, layout, errors=False):
            return Outcome.NON_FINITE
        after = end if is_last else grid
        moved: bool | None = None
        if layout.projected:
            projected, moved = project_new_state(given, after, entries, layout)
            if projected != Outcome.DONE:
                return projected
        accept_step(given, entries, moved, after, times, rows, layout=layout)
    return Outcome.DONE if run.t == end else Outcome.PAUSED


@inline
def discard_history(given: Running, layout: Layout) -> None:
    """Clear the data of previous steps if they belong to another run. The starter keeps no data between steps."""
    if layout.keeps_history:
        work = given.work
        if given.counts.kept == 0:
            given.counts.kept = 1
            work[layout.flags] = 0.0
            work[layout.flags + 1] = 0.0
            for newton in given.newtons:
                clear(newton)
            lost = work[layout.lost :]
            for i in each(layout.step.states * layout.width if layout.step.exact else 0, spill=True):
                lost[i] = 0.0


@inline
def clear(newton: Newton) -> None:
    """Set the record of a solve, which is kept from step to step, to zero."""
    newton.matrix_step = 0.0
    newton.differentiated = 0
    newton.rate = 0.0
    newton.noise = 0.0
    newton.age = 0
    newton.solved = 0
    newton.tried_step = 0.0
    newton.old_step = 0.0
    newton.known = 0
    newton.order = 0


@inline
def kept_entries(given: Running, layout: Layout) -> Out | None:
    """Return a local array with the entries of the state, if the layout keeps them in registers; else None."""
    if not layout.keeps_entries:
        return None
    entries = reals(2 * layout.dimension)
    for i in unrolled(layout.step.states):
        for k in unrolled(layout.length):
            entries[i * layout.length + k] = given.work[layout.place(i) + k]
    return entries


@inline
def is_finite(given: Running, layout: Layout, *, errors: bool) -> bool:
    """Return True if the new state is finite, and with `errors` its error vectors, too.

    The test uses 0 * x, which is NaN if x is not finite.
    """
    new, total = given.work[layout.place(layout.new) :], 0.0
    vectors = layout.step.states + (len(layout.step.errors) if errors else 0)
    for i in each(vectors * layout.width, unrolled=layout.width <= UNROLLED_TEST * layout.block):
        total = fma(new[i], 0.0, total)
    return total == 0.0
