"""Runs in which a body sticks: steps that shrink because the equations lead back to a switching surface on both sides.

Friction -mu*sign(v) holds a body at v = 0, where no equation says what it does. A step with error control cannot cross
the surface and becomes shorter and shorter: to the step limit are ten million of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lagrange.graph.differentiate import gradient
from lagrange.graph.node import Node
from lagrange.machine.state import DriverState
from lagrange.program.switching import switch
from lagrange.trajectory.events.actions import rates
from lagrange.trajectory.events.ending import EventResult, sliding
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.outputs import Part
from lagrange.trajectory.trajectory import FloatArray, Status

FIRST_TEST = 4096
"""Tries of steps after which a run is tested first: one that goes on has mostly ended by then."""

ROWS = 64
"""Number of accepted states, the last ones, from which the motion is looked at."""

LONGEST_SURFACE = 80
"""Most characters of the expression of a surface in a message."""


class Sticking:
    """Tests from time to time whether the steps of a run get nowhere because a body sticks."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._tries, self._t = 0, problem.t0

    def ended(self, state: DriverState, parts: Sequence[Part], result: EventResult) -> EventResult:
        """Return the end of a run that sticks, from its accepted states, else the result of its last steps.

        Tested are a run that would use up its steps at the rate of the last ones, and one whose steps vanish.
        """
        stuck = result.status is Status.STEP_TOO_SMALL and not result.detail
        if result.status is not None and not stuck:
            return result
        tries = state.count(DriverState.STEPS) + state.count(DriverState.REJECTED)
        new = tries - self._tries
        if new < FIRST_TEST and not stuck:
            return result
        problem, covered = self._problem, abs(state.t - self._t)
        self._tries, self._t = tries, state.t
        if covered * problem.max_steps >= new * abs(problem.t1 - state.t) and not stuck:
            return result
        switched = switch(problem.model.equations.graph, problem.model.equations.accelerations)
        last = parts[-1].times[-ROWS:], np.ascontiguousarray(parts[-1].states[-ROWS:].T)
        which = self._led_back(switched.stated, last, covered) if switched.stated else None
        return result if which is None else sliding(self._name(switched.expressions[which]), state.t)

    def _led_back(self, nodes: tuple[Node, ...], last: tuple[FloatArray, FloatArray], covered: float) -> int | None:
        """Return the first surface near all states to which the motion leads back from both sides, or None.

        A state on the other side is its mirror image at the surface. A state is near if its rate leads to the surface
        within the time that was `covered` since the last test.
        """
        problem, (times, states) = self._problem, last
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

    def _name(self, surface: Node) -> str:
        """Return the expression of a surface in the user's symbols."""
        model = self._problem.model
        return str(model.equations.express(surface).xreplace(dict(model.statement.plain)))[:LONGEST_SURFACE]


def _lead_back(here: FloatArray, beyond: FloatArray, time: float) -> bool:
    """Whether values and rates (2, k) on both sides of a surface lead to it within a time, negative for a run back."""
    (g, rise), (other, rise_there) = here, beyond
    near = (np.abs(g) <= np.abs(rise * time)) & (g * other < 0)
    back = (g * rise * time < 0) & (other * rise_there * time < 0)
    apart = g != 0
    return bool(apart.any() and (near & back)[apart].all())
