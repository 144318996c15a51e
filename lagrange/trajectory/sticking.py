"""Runs in which a body sticks: steps that shrink because the equations lead back to a switching surface on both sides.

Friction -mu*sign(v) holds a body at v = 0, where no equation says what it does. A step with error control cannot cross
the surface and becomes shorter and shorter: to the step limit are ten million of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lagrange.graph.differentiate import gradient
from lagrange.graph.node import Node
from lagrange.program.switching import switch
from lagrange.trajectory.events.actions import rates
from lagrange.trajectory.events.ending import EventResult, sliding
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.outputs import Part
from lagrange.trajectory.trajectory import FloatArray

ROWS = 64
"""Number of accepted states, the last ones, from which the motion is looked at."""

LONGEST_SURFACE = 80
"""Most characters of the expression of a surface in a message."""


def stuck(problem: Problem, t: float, parts: Sequence[Part], covered: float) -> EventResult | None:
    """Return the end of a run at t if its last accepted states stick to a surface, else None.

    `covered` is the time that the run has gone on since it was tested before.
    """
    switched = switch(problem.model.equations.graph, problem.model.equations.accelerations)
    if not switched.stated:
        return None
    last = parts[-1].times[-ROWS:], np.ascontiguousarray(parts[-1].states[-ROWS:].T)
    which = _led_back(problem, switched.stated, last, covered)
    return None if which is None else sliding(_name(problem, switched.expressions[which]), t)


def _led_back(
    problem: Problem, nodes: tuple[Node, ...], last: tuple[FloatArray, FloatArray], covered: float
) -> int | None:
    """Return the first surface near all states to which the motion leads back from both sides, or None.

    A state on the other side is its mirror image at the surface. A state is near if its rate leads to the surface
    within the time that was `covered` since the last test.
    """
    times, states = last
    equations, count = problem.model.equations, len(nodes)
    slopes = tuple(slope for node in nodes for slope in gradient(node, (*equations.q, *equations.v)))
    kernel = problem.model.function("surfaces", (*nodes, *rates(equations, nodes), *slopes))
    with np.errstate(all="ignore"):
        values = kernel(times, states, problem.parameter_array)
        for which in range(count):
            g, rise = values[which], values[count + which]
            first = 2 * count + which * len(states)
            slope = values[first : first + len(states)]
            mirrored = states - 2 * g * slope / (slope**2).sum(axis=0)
            beyond = kernel(times, mirrored, problem.parameter_array)[[which, count + which]]
            if _lead_back(np.array([g, rise]), beyond, covered * np.sign(problem.t1 - problem.t0)):
                return which
    return None


def _name(problem: Problem, surface: Node) -> str:
    """Return the expression of a surface in the user's symbols."""
    model = problem.model
    return str(model.equations.express(surface).xreplace(dict(model.statement.plain)))[:LONGEST_SURFACE]


def _lead_back(here: FloatArray, beyond: FloatArray, time: float) -> bool:
    """Whether values and rates (2, k) on both sides of a surface lead to it within a time, negative for a run back."""
    (g, rise), (other, rise_there) = here, beyond
    near = (np.abs(g) <= np.abs(rise * time)) & (g * other < 0)
    back = (g * rise * time < 0) & (other * rise_there * time < 0)
    apart = g != 0
    return bool(apart.any() and (near & back)[apart].all())
