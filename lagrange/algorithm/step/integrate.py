"""Whole integrators as procedures that need nothing from outside: a step of a length, and a run to an end.

They are made of the procedures that the drivers of this package run, for explicit methods. `law` and `projection` are
functions that they take, to be bound; see `lagrange.procedure.rewrite`.
"""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import CORRECTIONS, project, starts_on_constraints
from lagrange.algorithm.step.constants import LEAST_FLOOR
from lagrange.algorithm.step.controlled_steps import controlled_steps
from lagrange.algorithm.step.memory import EFFORT, Layout
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.algorithm.step.trial import take_step
from lagrange.algorithm.step.vectors import BY_PLACE
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.values import Memory
from lagrange.program.step import StepProgram


def one_step(step: StepProgram, dimension: int, name: str, *, projected: bool = False) -> Procedure:
    """Return one step of a length h from a state y at t, which it replaces: a finite new state, or an outcome.

    With `projected` the new state is moved onto the constraints of the system.
    """
    layout = Layout(step, dimension, block=1)
    p = Builder(name, f"Replace y by the state after a step of length h from t, with the method {step.name}.")
    law, jacobian = p.function("law", BY_PLACE), p.function("jacobian", BY_PLACE)
    projection = p.function("projection", CORRECTIONS) if projected else None
    t, h = p.given("t", REAL), p.given("h", REAL)
    y, parameters = p.array("y", size=dimension), p.array("p", read=True)
    if projection is not None:
        _leave_off_constraints(p, projection, t, y, parameters)
    work, floors = p.reserve(layout.size, name="work"), p.reserve(dimension, name="floors")
    effort = p.reserve_record(EFFORT)
    _clear(p, work, layout)
    for k in range(step.states):
        p.copy(y.at(k * layout.length), work.at(layout.place(k)), layout.length, spill=False)
    given = (law, parameters, jacobian, parameters, t, h, 0.0, floors, effort, work, p.false)
    outcome = p.call(take_step(layout), *given)
    p.leave_if(~outcome.equals(Outcome.DONE), outcome)
    new, zero = p.reserve(dimension, name="new"), p.constant(0.0, REAL)
    for k in range(step.states):
        source = work.at(layout.place(layout.new + k))
        p.copy(source, new.at(k * layout.length), layout.length, spill=False)
    if projection is not None:
        _project(p, projection, t + h, new, parameters, dimension)
    with p.each(dimension) as i:
        total = p.dot(new[i], zero)
    p.leave_if(~total.value.equals(0.0), Outcome.NON_FINITE)
    p.copy(new, y, dimension, spill=False)
    p.leave(Outcome.DONE)
    return p.finish(WHOLE)


def _leave_off_constraints(p: Builder, projection: Any, t: Any, y: Memory, parameters: Memory) -> None:
    """Leave where a state is off the constraints: what starts there is another motion."""
    assert y.array.size is not None
    near = p.call(starts_on_constraints(y.array.size), projection, parameters, t, y)
    p.leave_if(~near, Outcome.UNPROJECTED)


def _clear(p: Builder, work: Memory, layout: Layout) -> None:
    """Write zeros where the law reads velocities that a step of coordinates alone does not give."""
    if layout.step.law != "accelerations":
        return
    velocities = work.at(layout.argument + layout.length)
    with p.each(layout.length) as i:
        velocities[i] = 0.0


def _project(p: Builder, projection: Any, t: Any, new: Memory, parameters: Memory, dimension: int) -> None:
    """Move a state onto the constraints, or leave with an outcome."""
    lost = p.reserve(dimension, name="lost")
    with p.each(dimension) as i:
        lost[i] = 0.0
    outcome, _ = p.call(project(dimension, 1), projection, parameters, t, new, lost)
    p.leave_if(~outcome.equals(Outcome.DONE), outcome)


def adaptive_run(step: StepProgram, dimension: int, name: str, *, projected: bool = False) -> Procedure:
    """Return a run with error control from y at t[0] to t_end; both are replaced by where it ends.

    An entry may err by rtol times its size + atol at a step. It returns an outcome, PAUSED after `max_steps` trials.
    """
    control = step.control
    assert control is not None
    layout = Layout(step, dimension, block=1, projected=projected)
    p = Builder(name, f"Run from y at t[0] to t_end with the method {step.name}; both become those where it ends.")
    law, jacobian = p.function("law", BY_PLACE), p.function("jacobian", BY_PLACE)
    projection = (p.function("projection", CORRECTIONS),) if projected else ()
    time, t_end = p.array("t", size=1), p.given("t_end", REAL)
    y, parameters = p.array("y", size=dimension), p.array("p", read=True)
    rtol, atol, most = p.given("rtol", REAL), p.given("atol", REAL), p.given("max_steps", WHOLE)
    for one in projection:
        _leave_off_constraints(p, one, time[0], y, parameters)
    work, floors = p.reserve(layout.size, name="work"), p.reserve(dimension, name="floors")
    run, counts = p.reserve_record(RUN), p.reserve_record(COUNTS)
    effort = p.reserve_record(EFFORT)
    times, rows = p.reserve(1, name="times"), p.reserve(1, name="rows")
    run.t = time[0]
    run.end = t_end
    run.rtol = rtol
    run.previous = 1.0
    run.longest = math.inf
    with p.each(dimension) as i:
        floors[i] = p.larger(atol, LEAST_FLOOR)
    for k in range(step.states):
        p.copy(y.at(k * layout.length), work.at(layout.place(k)), layout.length, spill=False)
    laws = (law, parameters, jacobian, parameters)
    known = (run, counts, floors, effort, work, *(one for held in projection for one in (held, parameters)))
    outcome = p.call(controlled_steps.form(layout=layout, control=control), *laws, *known, most, times, rows)
    time[0] = run.t
    for k in range(step.states):
        p.copy(work.at(layout.place(k)), y.at(k * layout.length), layout.length, spill=False)
    p.leave(outcome)
    return p.finish(WHOLE)
