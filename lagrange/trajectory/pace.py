"""The pace of a run: at 4,096 tries of steps, 8,192, 16,384 and so on a look decides whether it is slow, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lagrange.machine.state import DriverState
from lagrange.trajectory.events.ending import EventResult
from lagrange.trajectory.floors import raise_to_noise
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.outputs import Part
from lagrange.trajectory.sticking import stuck
from lagrange.trajectory.trajectory import Status

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

    def look(self, state: DriverState, tries: int, parts: Sequence[Part], result: EventResult) -> EventResult:
        """Raise the floors of a slow run, and return its end if it sticks, else the result of its last steps.

        A run may stick if it would use up its steps at the rate since the last look, or if its steps vanish. `parts`
        are its accepted states.
        """
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
