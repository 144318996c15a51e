"""The pace of a run: at 4,096 tries of steps, 8,192, 16,384 and so on a look decides whether it is slow, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import SMALL_FLOOR
from lagrange.trajectory.events.ending import EventResult
from lagrange.trajectory.floors import raise_to_noise
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.outputs import Part
from lagrange.trajectory.sizes import Slopes, slopes_of
from lagrange.trajectory.sticking import stuck
from lagrange.trajectory.trajectory import FloatArray, Status

FIRST_LOOK = 4096
"""Tries of a run before its first look; the next is after twice as many. Most runs have ended by then."""

SLOW = 16.0
"""A run is slow if it would need this many times the tries so far: its floors are compared with rounding noise.

The noise takes 1 to 20 ms, and 4,096 tries of a small system 2 ms.
"""


class Pace:
    """Looks at a run between calls of its driver; `next_look` is the number of tries before the next one."""

    def __init__(self, problem: Problem) -> None:
        self.next_look = FIRST_LOOK
        self._problem, self._tries, self._t = problem, 0, problem.t0

    def look(self, state: DriverState, parts: Sequence[Part], result: EventResult) -> EventResult:
        """Raise the floors of a slow run, and return its end if it sticks, else the result of its last steps.

        A run may stick if it would use up its steps at the rate since the last look, or if its steps vanish. `parts`
        are its accepted states.
        """
        tries = state.count(DriverState.STEPS) + state.count(DriverState.REJECTED)
        vanished = result.status is Status.STEP_TOO_SMALL
        if result.detail or not (vanished or (result.status is None and tries >= self.next_look)):
            return result
        problem, covered, new = self._problem, abs(state.t - self._t), tries - self._tries
        self._tries, self._t = tries, state.t
        while self.next_look <= tries:
            self.next_look *= 2
        needed = new * abs(problem.t1 - state.t) / covered if covered else math.inf
        if needed > SLOW * tries and not vanished:
            raise_to_noise(problem.model, problem.parameter_array, state)
        found = stuck(problem, state.t, parts, covered) if vanished or needed > problem.max_steps else None
        return found or result


def limiting_entry(problem: Problem, state: DriverState) -> tuple[int, int] | None:
    """Return the entry that limits the step if its tolerance is far below those of its kind, with the largest of these.

    The entry has the largest error, relative to its tolerance, of one step of RK4 against two of half its length.
    """
    t, y, h = state.t, state.y, float(state.reals[DriverState.H])
    law = slopes_of(problem.model, problem.parameter_array)
    tolerances = state.reals[DriverState.RTOL] * np.abs(y) + state.floors
    with np.errstate(all="ignore"):
        half = _rk4(law, t, y, h / 2)
        ratios = np.nan_to_num(np.abs(_rk4(law, t, y, h) - _rk4(law, t + h / 2, half, h / 2)) / tolerances)
    limiting = int(np.argmax(ratios))
    layout = problem.model.layout
    kind = layout.q if limiting < layout.q.stop else layout.v
    largest = kind.start + int(np.argmax(tolerances[kind]))
    small = ratios[limiting] > 0 and tolerances[limiting] < SMALL_FLOOR * tolerances[largest]
    return (limiting, largest) if small else None


def _rk4(law: Slopes, t: float, y: FloatArray, h: float) -> FloatArray:
    """Return the state after a step of the classical method of order 4."""
    a = law(t, y)
    b = law(t + h / 2, y + h / 2 * a)
    c = law(t + h / 2, y + h / 2 * b)
    return y + h / 6 * (a + 2 * b + 2 * c + law(t + h, y + h * c))
