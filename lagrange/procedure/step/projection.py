"""The projection of the new state of a step program onto the constraints of the system."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.procedure.projection import project
from lagrange.procedure.step.memory import Layout
from lagrange.procedure.step.trial import Running
from lagrange.procedure.values import Flag, Memory, Real, Whole


def project_new_state(given: Running, t: Real, entries: Sequence[Memory]) -> tuple[Whole, Flag]:
    """Project the new state, which is at a time; return an outcome, and whether the state has moved.

    If it has, the error vectors of the step are how far.
    """
    p, layout = given.p, given.layout
    n, state = layout.dimension, given.work.at(layout.argument)
    lost = p.reserve(n, room=layout.block, name="lost")
    for part, vector, low in _parts(layout):
        p.copy(given.work.at(vector), state.at(part), layout.length)
        if low is None:
            with p.each(layout.length) as i:
                lost.at(part)[i] = 0.0
        else:
            p.copy(given.work.at(low), lost.at(part), layout.length)
    outcome, moved = p.call(project(n, layout.block), *given.projection, t, state, lost)
    with p.when(moved):
        for k in range(len(layout.step.errors)):
            part, vector, _ = _parts(layout)[k % layout.step.states]
            before, error = given.work.at(vector), given.work.at(layout.place(layout.errors + k))
            with p.each(layout.length) as i:
                error[i] = state.at(part)[i] - before[i]
        for part, vector, low in _parts(layout):
            p.copy(state.at(part), given.work.at(vector), layout.length, spill=False)
            if low is not None:
                p.copy(lost.at(part), given.work.at(low), layout.length, spill=False)
        for memory in entries:
            for k in range(n):
                memory[n + k] = state[k]
    return outcome, moved


def _parts(layout: Layout) -> list[tuple[int, int, int | None]]:
    """Return for each vector of the state where it begins in the state, its offset, and that of what it has lost."""
    step = layout.step
    tried = [layout.lost + (step.states + i) * layout.width for i in range(step.states)]
    return [
        (i * layout.length, layout.place(layout.new + i), tried[i] if step.compensated(i) else None)
        for i in range(step.states)
    ]
