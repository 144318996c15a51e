"""Whole integrators by explicit methods, for exports: procedures for one step, and for a run to an end time.

They call the same procedures as the runs of this package. The functions of the system, such as the right-hand
side, are parameters, which `lagrange.procedure.rewrite` replaces by procedures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import CORRECTIONS, project, starts_on_constraints
from lagrange.algorithm.step.constants import LEAST_FLOOR
from lagrange.algorithm.step.error_control import controlled_steps
from lagrange.algorithm.step.memory import FUNCTION, Counts, Effort, Layout, Run, Running
from lagrange.algorithm.step.trial import take_step
from lagrange.procedure.form import Array
from lagrange.procedure.front.decorators import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, larger, reals, unrolled
from lagrange.program.step import Control


@dataclass(frozen=True)
class SystemFunctions:
    """The functions of a system: the right-hand side, its derivative, and the corrections of constraints (or None)."""

    law: Callable[..., Any]
    jacobian: Callable[..., Any]
    projection: Any


def functions_of(layout: Layout) -> Bundle:
    """Return the type of a `SystemFunctions` parameter of a procedure."""
    projection = CORRECTIONS if layout.projected else None
    return Bundle(SystemFunctions, {"law": FUNCTION, "jacobian": FUNCTION, "projection": projection})


def state_array(layout: Layout) -> Array:
    """Return the type of a parameter that is the state [q, v]."""
    return Array(size=layout.dimension)


@procedure(of=functions_of, y=state_array)
def one_step(of: SystemFunctions, t: float, h: float, y: Out, p: In, *, layout: Layout, relations: bool) -> Outcome:
    """Replace the state y by that after one step of length h from time t, and return an outcome.

    The outcome is DONE if a step was taken; otherwise it says why not, and y is the state at the start.
    UNPROJECTED means that the old or the new state is too far from the constraints. `p` are the parameters of
    the functions `of` the system. With `relations` some velocities follow from the constraints: y is first
    moved onto them.
    """
    n = layout.dimension
    if is_off_constraints(of, t, y, p, n, relations):
        return Outcome.UNPROJECTED
    arguments = begin(of, y, p, layout)
    work = arguments.work
    new = work[layout.place(layout.new) :]
    if layout.step.law == "accelerations":
        # The law reads velocities, but a step with coordinates alone has none.
        velocities = layout.argument + layout.length
        work[velocities : velocities + layout.length] = 0.0
    outcome = take_step(arguments, t, h, slope_known=False, entries=None, layout=layout)
    if outcome != Outcome.DONE:
        return outcome
    if of.projection is not None:
        lost = reals(n)
        lost[:n] = 0.0
        projected, _ = project(of.projection, p, t + h, new, lost, dimension=n, block=1)
        if projected != Outcome.DONE:
            return projected
    total = 0.0
    for i in each(n):
        total = fma(new[i], 0.0, total)
    if total != 0.0:
        return Outcome.NON_FINITE
    y[:n] = new[:n]
    return Outcome.DONE


@inline
def is_off_constraints(of: SystemFunctions, t: float, y: Out, p: In, n: int, relations: bool) -> bool:
    """Return True if the state y at time t violates the constraints too much to start from it.

    `p` are the parameters, and `n` is the length of the state. With `relations` some velocities follow from the
    constraints: y is moved onto the constraints, and only the violation of the other constraints is limited.
    """
    return of.projection is not None and not starts_on_constraints(
        of.projection, p, t, y, dimension=n, relations=relations
    )


@inline
def begin(of: SystemFunctions, y: In, p: In, layout: Layout) -> Running:
    """Return the arguments of the procedures that take steps, with new memory, for a run from the state y.

    `of` are the functions of the system, and `p` their parameters. All fields of the records `Run` and `Counts`
    are zero.
    """
    work, floors = reals(layout.size), reals(layout.dimension)
    work[: layout.dimension] = y[: layout.dimension]
    return Running(
        law=of.law,
        parameters=p,
        jacobian=of.jacobian,
        constants=p,
        run=Run(),
        counts=Counts(),
        floors=floors,
        effort=Effort(),
        newtons=(),
        starters=(),
        work=work,
        projection=of.projection,
        projection_numbers=None if of.projection is None else p,
    )


@procedure(of=functions_of, t=lambda: Array(size=1), y=state_array)
def adaptive_run(
    of: SystemFunctions,
    t: Out,
    t_end: float,
    y: Out,
    p: In,
    rtol: float,
    atol: float,
    max_steps: int,
    *,
    layout: Layout,
    control: Control,
    relations: bool,
    unlimited: tuple[int, ...],
) -> Outcome:
    """Run with error control from the state y at time t[0] to t_end, and return an outcome.

    The last state and its time are written to y and t[0]. The outcome is DONE at t_end, PAUSED after
    `max_steps` trial steps; otherwise it says why the run ended. `p` are the parameters of the functions `of`
    the system. The error of an entry per step is at most rtol times its size + atol. The entries with the
    indices `unlimited` have no such bound: the motion does not depend on them. With `relations` some velocities
    follow from the constraints.
    """
    n = layout.dimension
    if is_off_constraints(of, t[0], y, p, n, relations):
        return Outcome.UNPROJECTED
    arguments, times, rows = begin(of, y, p, layout), reals(1), reals(1)
    run, floors = arguments.run, arguments.floors
    run.t = t[0]
    run.end = t_end
    run.rtol = rtol
    run.previous = 1.0
    run.longest = math.inf
    for i in each(n):
        floors[i] = larger(atol, LEAST_FLOOR)
    for k in unrolled(len(unlimited)):
        floors[unlimited[k]] = math.inf
    outcome = controlled_steps(arguments, max_steps, times, rows, layout=layout, control=control)
    t[0] = run.t
    y[:n] = arguments.work[:n]
    return outcome
