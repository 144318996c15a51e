"""The projection of the new state of a step program onto the constraints of the system."""

from __future__ import annotations

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import project
from lagrange.algorithm.step.memory import Layout
from lagrange.algorithm.step.trial import Running, copy_vector
from lagrange.procedure.front.plain import inline
from lagrange.procedure.front.vocabulary import Out, each, generated, reals, unrolled


@inline
def project_new_state(given: Running, t: float, entries: Out | None, layout: Layout) -> tuple[Outcome, bool]:
    """Project the new state, which is at a time; return an outcome, and whether the state has moved.

    If it has, the error vectors of the step are how far.
    """
    n, length, work = layout.dimension, layout.length, given.work
    state, lost = work[layout.argument :], reals(n, room=layout.block)
    for part, vector, low in state_parts(layout):
        copy_vector(work[vector:], state[part:], length)
        if low is None:
            for i in each(length):
                lost[part:][i] = 0.0
        else:
            copy_vector(work[low:], lost[part:], length)
    outcome, moved = generated(project(n, layout.block), given.projection, given.projection_numbers, t, state, lost)
    if moved:
        for k in unrolled(len(layout.step.errors)):
            part, vector, low = state_parts(layout)[k % layout.step.states]
            after, before, error = state[part:], work[vector:], work[layout.place(layout.errors + k) :]
            for i in each(length, disjoint=True):
                error[i] = after[i] - before[i]
        for part, vector, low in state_parts(layout):
            work[vector : vector + length] = state[part : part + length]
            if low is not None:
                work[low : low + length] = lost[part : part + length]
        if entries is not None:
            for k in unrolled(n):
                entries[n + k] = state[k]
    return outcome, moved


def state_parts(layout: Layout) -> list[tuple[int, int, int | None]]:
    """Return for each vector of the state where it begins in the state, its offset, and that of what it has lost."""
    step = layout.step
    tried = [layout.lost + (step.states + i) * layout.width for i in range(step.states)]
    return [
        (i * layout.length, layout.place(layout.new + i), tried[i] if step.compensated(i) else None)
        for i in range(step.states)
    ]
