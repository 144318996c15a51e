"""One trial step of an implicit method, and what accepting it does."""

from __future__ import annotations

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, WHOLE, Procedure
from lagrange.procedure.newton.corrections import product, solve_unknowns
from lagrange.procedure.newton.prediction import keep
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.step.memory import NEWTON, Layout
from lagrange.procedure.step.vectors import Given, Sum, Vectors
from lagrange.procedure.values import Variable
from lagrange.program.actions import Call, Damp


def take_step(layout: Layout, prefix: str = "") -> Procedure:
    """Return the trial of a step; names of procedures begin with the prefix."""
    step = layout.step
    p = Builder(f"{prefix}take", "Try a step, and return an outcome; the slope at its start may be known.")
    given = Given(p, layout)
    slope_known = p.given("slope_known", FLAG)
    calls = [argument for call in step.calls for argument in call.arguments]
    others = [*(damp.vector for damp in step.damps), *step.results, *step.errors]
    vectors = Vectors(given, [*calls, *others], [call.time for call in step.calls])
    singular = p.variable(p.false, "singular")
    solves = iter(zip(layout.solves, given.newtons, strict=True))
    for i, action in enumerate(step.actions):
        if isinstance(action, Call) and i == 0 and step.starts_with_slope:
            with p.when(~slope_known):
                _evaluate(vectors, action, singular)
        elif isinstance(action, Call):
            _evaluate(vectors, action, singular)
        elif isinstance(action, Damp):
            _damp(vectors, action)
        else:
            solve, newton = next(solves)
            given.leave_unless_done(p.call(solve_unknowns(layout, solve, prefix), *given.handed(newton)))
    for i in range(step.states):
        _keep_result(vectors, i)
    for i, error in enumerate(step.errors):
        vectors.combine(error, vectors.at(layout.errors + i))
    given.leave_if(singular.value, Outcome.SINGULAR)
    p.leave(int(Outcome.DONE))
    return p.finish(WHOLE)


def _evaluate(vectors: Vectors, call: Call, singular: Variable) -> None:
    effort = vectors.given.effort
    effort.evaluations = effort.evaluations + 1
    vectors.evaluate(call, singular)


def _damp(vectors: Vectors, damp: Damp) -> None:
    """Write (I - factor J)^-1 times a vector."""
    layout, work = vectors.layout, vectors.work
    solve = layout.solves[damp.of]
    vectors.combine(damp.vector, work.at(solve.residual))
    result = vectors.at(damp.result)
    with product(vectors.given, solve, work.at(solve.damper(damp)), 1) as (i, value):
        result[i] = value


def _keep_result(vectors: Vectors, state: int) -> None:
    """Write a new state, as a compensated sum of what it was and what the step adds, where rounding is to be kept.

    Source: D. E. Knuth, The Art of Computer Programming, vol. 2, 3rd ed., 1997, 4.2.2, theorem B.
    """
    p, layout, work = vectors.p, vectors.layout, vectors.work
    step = layout.step
    result, new = step.results[state], vectors.at(layout.new + state)
    if not step.compensated(state):
        vectors.combine(result, new)
        return
    added = Sum(vectors, tuple(term for term in result if term != (state, step.graph.one)))
    old = vectors.at(state)
    lost, tried = (work.at(layout.lost + (i * step.states + state) * layout.width) for i in (0, 1))
    with p.each(layout.width, spill=True) as i:
        y = old[i]
        move = added[i] + lost[i]
        total = y + move
        back = total - y
        new[i] = total
        tried[i] = (y - (total - back)) + (move - back)


def accept_step(layout: Layout) -> Procedure:
    """Return what makes the trial step the state."""
    step = layout.step
    p = Builder("accept_step", "Make the trial step the state, and keep its unknowns.")
    newtons = [p.record(f"newton{solve.index}", NEWTON) for solve in layout.solves]
    work = p.array("work", size=layout.size, room=layout.block)

    def copy(source: int, target: int) -> None:
        old, new = work.at(source), work.at(target)
        with p.each(layout.width, spill=True) as i:
            new[i] = old[i]

    for i in range(step.states):
        if step.starter is not None:
            copy(layout.place(i), layout.place(step.states + i))
        copy(layout.place(layout.new + i), layout.place(i))
        if step.compensated(i):
            copy(layout.lost + (step.states + i) * layout.width, layout.lost + i * layout.width)
    for solve, newton in zip(layout.solves, newtons, strict=True):
        p.call(keep(layout, solve), newton, work)
    return p.finish()
