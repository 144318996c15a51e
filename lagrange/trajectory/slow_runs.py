"""Find why a run is slow: rounding noise, sticking to a switching surface, a singularity ahead, late compilation."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from lagrange.algorithm.constants import SMALL_FLOOR
from lagrange.graph.differentiate import gradient
from lagrange.machine.state import DriverState
from lagrange.program.switching import switch
from lagrange.statement.run_settings import COMPILE_SECONDS
from lagrange.trajectory.endings import NEARLY_DEPENDENT, rank_lost, remaining_regularity
from lagrange.trajectory.events.end_messages import EventResult, sliding
from lagrange.trajectory.events.model_events import rates
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.outputs import WrittenStates
from lagrange.trajectory.sizes import raise_to_noise, slopes_of
from lagrange.trajectory.tableaux.butcher import moved
from lagrange.trajectory.tableaux.explicit import dopri5
from lagrange.trajectory.trajectory import Status

LAST_ROWS = 64
"""Number of last accepted states that are tested for sticking."""

UNSOLVED_ROWS, UNSOLVED_REACH = 8, 2.0
"""Test for sticking to a switching surface after an implicit step that did not converge. The first number is the number
of last accepted states that are tested. The second number times the time from the first of them to the present is the
longest time in which their rates of change must lead to the surface."""


def stuck(
    problem: Problem, t: float, parts: Sequence[WrittenStates], covered: float, rows: int = LAST_ROWS
) -> EventResult | None:
    """Return the end of a run at time t if its last accepted states stick to a switching surface, else None.

    States stick if the motion returns to the surface from both sides within the time `covered`, by which the run
    advanced since the last test. `parts` are blocks of accepted states. The last `rows` states of the last block are
    tested.
    """
    switched = switch(problem.model.equations.graph, problem.model.equations.accelerations)
    if not switched.stated:
        return None
    times, states = parts[-1].times[-rows:], np.ascontiguousarray(parts[-1].states[-rows:].T)
    equations, nodes, count = problem.model.equations, switched.stated, len(switched.stated)
    slopes = tuple(slope for node in nodes for slope in gradient(node, (*equations.q, *equations.v)))
    kernel = problem.model.function("surfaces", (*nodes, *rates(equations, nodes), *slopes))
    duration = covered * np.sign(problem.t1 - problem.t0)
    with np.errstate(all="ignore"):
        values = kernel(times, states, problem.parameter_array)
        for which in range(count):
            g, rise = values[which], values[count + which]
            first = 2 * count + which * len(states)
            slope = values[first : first + len(states)]
            # The other side is tested at the states mirrored at the surface.
            mirrored = states - 2 * g * slope / (slope**2).sum(axis=0)
            other, rise_there = kernel(times, mirrored, problem.parameter_array)[[which, count + which]]
            near = (np.abs(g) <= np.abs(rise * duration)) & (g * other < 0)
            back = (g * rise * duration < 0) & (other * rise_there * duration < 0)
            if (g != 0).any() and (near & back)[g != 0].all():
                return sliding(problem.model.statement.quote(equations.express(switched.expressions[which])), t)
    return None


FIRST_TEST = 4096
"""Number of trial steps before the first test, doubled for each further test. Most runs end before the first."""

SLOW = 16.0
"""A run is slow if it still needs more than this multiple of its steps so far. The floors (least absolute tolerances)
of a slow run are then compared with rounding noise. Computing the noise takes 1 to 20 ms; 4,096 steps of a small system
take 2 ms."""

LONG_APPROACH, NEARER = 2**19, 0.75
"""A slow run with constraints ends as singular if three conditions hold: the run has taken the first number of trial
steps, its regularity is below `NEARLY_DEPENDENT`, and the regularity is below the second number times the regularity at
the last test. A run that only passes near a singular state needs fewer steps."""


class Pace:
    """Tests between driver calls for causes of a slow run: rounding noise, or sticking to a switching surface.

    The next test is made after `next_test` trial steps.
    """

    def __init__(self, problem: Problem) -> None:
        self.next_test = FIRST_TEST
        self._problem, self._tries, self._t, self._regularity = problem, 0, problem.t0, 1.0

    def test(self, state: DriverState, parts: Sequence[WrittenStates], result: EventResult) -> EventResult:
        """Return the end of a run that sticks to a switching surface, else the `result` of the last driver call.

        `parts` are the accepted states. Sticking is tested in three cases: the run would reach `max_steps` at the pace
        since the last test; steps become too small; an implicit step of any length did not converge. In a slow run the
        floors (least absolute tolerances) are raised to rounding noise.
        """
        if result.status is Status.DIVERGED and not result.detail and state.reals[DriverState.RTOL]:
            reach = UNSOLVED_REACH * abs(state.t - float(parts[-1].times[-UNSOLVED_ROWS:][0]))
            return stuck(self._problem, state.t, parts, reach, UNSOLVED_ROWS) or result
        tries = state.count(DriverState.STEPS) + state.count(DriverState.REJECTED)
        vanished = result.status is Status.STEP_TOO_SMALL
        if result.detail or not (vanished or (result.status is None and tries >= self.next_test)):
            return result
        problem, covered, new = self._problem, abs(state.t - self._t), tries - self._tries
        self._tries, self._t = tries, state.t
        while self.next_test <= tries:
            self.next_test *= 2
        needed = new * abs(problem.t1 - state.t) / covered if covered else math.inf
        if needed > SLOW * tries and not vanished:
            raise_to_noise(problem.model, problem.parameter_array, state)
        if not vanished and needed <= problem.max_steps:
            return result
        return stuck(problem, state.t, parts, covered) or self._approaching(state) or result

    def _approaching(self, state: DriverState) -> EventResult | None:
        """Return the end of a run with constraints that approaches a singular state without reaching it, else None.

        A mass on a rod whose length r shrinks to zero turns faster and faster, for example: it needs about 1/r steps.
        """
        if not len(self._problem.model.equations.constraints):
            return None
        (singular,), before = remaining_regularity(self._problem, [state.t], state.y), self._regularity
        if singular is None:
            return None
        self._regularity = singular.regularity
        if self._tries < LONG_APPROACH or singular.regularity > min(NEARLY_DEPENDENT, NEARER * before):
            return None
        return EventResult(Status.SINGULAR, rank_lost(self._problem, state.y, singular))


def limiting_entry(problem: Problem, state: DriverState) -> tuple[int, int] | None:
    """Return the index of the entry of the state that limits the step size, and the index of a second entry, or None.

    The first entry has the largest error of one DOPRI5 step relative to its tolerance. The second has the largest
    tolerance among the entries of the same kind, coordinates or velocities. The result is None unless the first entry
    has a tolerance far below the tolerance of the second.
    """
    y, h = state.y, float(state.reals[DriverState.H])
    law = slopes_of(problem.model, problem.parameter_array)
    tolerances = state.reals[DriverState.RTOL] * np.abs(y) + state.floors
    with np.errstate(all="ignore"):
        ratios = np.nan_to_num(np.abs(moved(dopri5(), law, state.t, y, h)[1]) / tolerances)
    limiting = int(np.argmax(ratios))
    layout = problem.model.layout
    kind = layout.q if limiting < layout.q.stop else layout.v
    largest = kind.start + int(np.argmax(tolerances[kind]))
    small = ratios[limiting] > 0 and tolerances[limiting] < SMALL_FLOOR * tolerances[largest]
    return (limiting, largest) if small else None


def compiled_late(problem: Problem) -> str:
    """Return a sentence with the remedy if compiling took longer than the run's limit `max_wall`, else ""."""
    seconds = time.perf_counter() - problem.began
    if problem.max_wall is None or seconds <= max(problem.max_wall, COMPILE_SECONDS):
        return ""
    return (
        f"Compiling took {seconds:.3g} s, more than max_wall = {problem.max_wall:.6g} s. What is compiled stays with "
        "the model: run it again, raise max_wall, or take a method that compiles less, such as dop853."
    )
