"""Runs that passed what no motion leads over, or what rounding decides: they end before it, and say what it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.constraints.approach import Independence, regularity
from lagrange.trajectory.constraints.discontinuities import Discontinuity
from lagrange.trajectory.constraints.passage import dependent_passage
from lagrange.trajectory.inertia import crossing
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory, run_until

AT_THE_END = 1e-6
"""A place within this last part of a step is its end: there steps of series end on surfaces that they know."""

STEPS_AHEAD, PLACES_AHEAD, MUCH_NEARER = 2.0, 65, 0.1
"""Where a step fails, a crossing is sought at so many places over so many steps ahead: where the least singular value
of the constraints falls to that part."""


def until_dependent(
    problem: Problem, rtol: float, found: Trajectory, accepted: tuple[FloatArray, FloatArray]
) -> Trajectory:
    """Return a run as it is, or up to a configuration that it passed where rounding decides how the motion goes on."""
    times, states = accepted
    stopped = not found.status.complete and found.status is not Status.STEP_TOO_SMALL
    passed = dependent_passage(problem.model, times, states, problem.parameter_array, rtol, stopped=stopped)
    if passed is None:
        return found
    row, dependent = passed
    detail = crossing(problem, dependent, states[row])
    return _shortened(problem, found, (float(times[row]), states[row]), row, detail)


def until_discontinuity(problem: Problem, found: Trajectory, passed: Discontinuity, *, series: bool) -> Trajectory:
    """Return a run up to the last state before a discontinuity of its constraints.

    A step of a `series` that ends there, and is kept, is the motion up to it, whatever the projection makes of its end.
    """
    steps = found.steps - passed.steps
    if not series or passed.part < 1.0 - AT_THE_END:
        return _shortened(problem, found, (passed.t, passed.y), steps, passed.what)
    end = math.nextafter(passed.after, passed.t)
    y = found.dense(np.array([end]))[:, 0]
    short = _shortened(problem, found, (end, y), steps + 1, passed.what)
    if problem.t_eval is not None:
        return short
    return replace(short, t=np.append(short.t, end), y=np.column_stack([short.y, y]))


def dependent_ahead(problem: Problem, t: float, y: FloatArray, step: float) -> str:
    """Return the message for equal steps that find no end of the step over a crossing of motions, or ""."""
    model, parameters = problem.model, problem.parameter_array
    if not len(model.equations.constraints):
        return ""
    try:
        slope = model.kernel("rhs")(t, y, parameters)
    except SingularMassMatrix:
        return ""
    start, near = (problem.t0, problem.y0), Independence(model, parameters, (problem.t0, problem.y0))
    ahead = [(t + s * step, y + s * step * slope) for s in np.linspace(0.0, STEPS_AHEAD, PLACES_AHEAD).tolist()]
    values = [near.at(*place) for place in ahead]
    least = int(np.argmin(values))
    if not values[least] <= MUCH_NEARER * values[0]:
        return ""
    found = regularity(model, parameters, start, ahead[least])
    return "" if found is None or not found[1].rows else crossing(problem, found[1], y)


def _shortened(
    problem: Problem, found: Trajectory, end: tuple[float, FloatArray], steps: int, detail: str
) -> Trajectory:
    """Return a run up to a time and a state, as singular there."""
    t, y = end
    told = message(Status.SINGULAR, problem, t, y, found.method, detail=detail)
    return replace(run_until(found, t), status=Status.SINGULAR, message=told, steps=steps)
