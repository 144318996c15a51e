"""The loop over equal steps: times are multiples of the step, and the last step ends at the end of the run."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.step.constants import SHORTEST_LAST_STEP
from lagrange.procedure.step.memory import NEWTON, Layout
from lagrange.procedure.step.projection import project_new_state
from lagrange.procedure.step.trial import Running, accept_step, try_step
from lagrange.procedure.values import Flag, Memory, Real

WRITTEN_OUT = 2
"""The test for finite entries is written out for vectors of up to this many blocks."""


def equal_steps(layout: Layout) -> Procedure:
    """Return the loop; it returns at the end, after `budget` steps, or when a step fails."""
    p = Builder("equal_steps", "Take equal steps towards the end, and return an outcome.")
    given = Running(p, layout)
    run, counts = given.run, given.counts
    budget, times, rows = p.given("budget", WHOLE), p.array("times"), p.array("rows", room=layout.block)
    discard_history(given)
    entries = keep_entries(given)
    start, end, h = run.start, run.end, run.step
    with p.loop(0, budget):
        t = run.t
        p.leave_if(t.equals(end), Outcome.DONE)
        grid = p.fma(p.real(counts.steps + 1), h, start)
        left = end - p.fma(SHORTEST_LAST_STEP, h, grid)
        beyond = p.choose(h < 0.0, -left, left) <= 0.0
        length = p.choose(beyond, end - t, h)
        outcome = p.call(try_step(layout), *given.handed, t, length, *entries)
        p.leave_if(~outcome.equals(Outcome.DONE), outcome)
        p.leave_if(~is_finite(given), Outcome.NON_FINITE)
        after = p.choose(beyond, end, grid)
        more: list[Any] = [*entries]
        if layout.projected:
            outcome, moved = project_new_state(given, after, entries)
            p.leave_if(~outcome.equals(Outcome.DONE), outcome)
            more.append(moved)
        p.call(accept_step(layout), run, counts, *given.newtons, given.work, *more, after, times, rows)
    leave_at_budget(given, end)
    return p.finish(WHOLE)


def leave_at_budget(given: Running, end: Real) -> None:
    """Return from a loop over steps when its budget is used up."""
    p = given.p
    p.leave(p.choose(given.run.t.equals(end), p.whole(Outcome.DONE), p.whole(Outcome.PAUSED)))


def discard_history(given: Running) -> None:
    """Clear the data of previous steps if it belongs to another run. A starter rebuilds its own at every step."""
    p, layout, work = given.p, given.layout, given.work
    if not layout.keeps_history:
        return
    with p.when(given.counts.kept.equals(0)):
        given.counts.kept = 1
        work[layout.flags] = 0.0
        work[layout.flags + 1] = 0.0
        for newton in given.newtons:
            for name, kind in NEWTON.fields:
                setattr(newton, name, 0.0 if kind is REAL else 0)
        lost = work.at(layout.lost)
        with p.each(layout.step.states * layout.width if layout.step.exact else 0, spill=True) as i:
            lost[i] = 0.0


def keep_entries(given: Running) -> list[Memory]:
    """Return the array of the entries of the state, read from the work array, if they are kept in registers."""
    p, layout = given.p, given.layout
    if not layout.keeps_entries:
        return []
    entries = p.reserve(2 * layout.dimension)
    for i in range(layout.step.states):
        for k in range(layout.length):
            entries[i * layout.length + k] = given.work[layout.place(i) + k]
    return [entries]


def is_finite(given: Running, *, errors: bool = False) -> Flag:
    """Whether the new state is finite, and with `errors` its error vectors: 0 * x is NaN for all other numbers."""
    p, layout = given.p, given.layout
    new, zero = given.work.at(layout.place(layout.new)), p.constant(0.0, REAL)
    vectors = layout.step.states + (len(layout.step.errors) if errors else 0)
    with p.each(vectors * layout.width, unrolled=layout.width <= WRITTEN_OUT * layout.block) as i:
        total = p.dot(new[i], zero)
    found: Flag = total.value.equals(0.0)
    return found
