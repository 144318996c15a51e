"""Leaps over points at which a motion has no Taylor series although its forces hardly change.

With drag -|v|v a body at rest, or at its turning point, is at the root of a square: the force is smooth enough there,
but no series leads on. A step by a method without series does, over so little time that all else is nearly constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.state import DriverState
from lagrange.trajectory.integrator import Integrator, Problem
from lagrange.trajectory.paths.step_paths import StepPath, hermite_path
from lagrange.trajectory.trajectory import FloatArray, Status

SHARE = 1e-6
"""A leap takes this part of the run."""

CHANGE = 0.01
"""No acceleration changes on a leap by more than this part of itself, or of what would change the
velocity by itself along the run: a force that jumps, or is infinite, is not leapt over. See `GROWTH` for bodies at
rest."""

EARLY, GROWTH = 1 / 16, 0.5
"""What is at rest has no velocity to measure by: its acceleration is leapt over if by the first part of a leap it has
changed by less than the second part of its change on all of it. It then grows as a power of the time, of 1/4 or more,
as the force on a bead that another one touches; near a pole, or after log(t), it does not."""

BEHIND = 2.0**-10
"""The part of a leap that lies behind the surface on which it begins."""

IN_A_ROW = 3
"""So many leaps may follow one another without a step between them. What has no series for longer has none."""

SHORTER, ATTEMPTS = 1 / 16, 6
"""How much shorter a leap is tried again, and how often."""

MOST_STEPS = 1000
"""So many steps may a leap take: it is hardly more than one where there is something to leap to."""


@dataclass
class Continuations:
    """The leaps of a run so far, by a method with tolerances of its own.

    `rows` are those that they begin from, `landed` is where the last one ended, and `continuations_in_a_row` counts
    those that followed each other.
    """

    problem: Problem
    method: Integrator
    rows: list[int] = field(default_factory=list)
    landed: float = math.nan
    continuations_in_a_row: int = 0

    def ahead(self, state: DriverState) -> list[float]:
        """Return the times to leap to, the farthest first."""
        span, left = abs(self.problem.t1 - self.problem.t0), float(state.reals[DriverState.END]) - state.t
        if not left or (state.t == self.landed and self.continuations_in_a_row >= IN_A_ROW):
            return []
        lengths = [SHARE * span * SHORTER**k for k in range(ATTEMPTS)]
        least = 64 * 2.0**-52 * max(abs(state.t), 2.0**-60 * span)
        return [state.t + math.copysign(min(x, abs(left)), left) for x in lengths if x > least]

    def landing(self, state: DriverState, there: float, *, switched: Callable[[float], bool]) -> FloatArray | None:
        """Return the state (2n,) at a time ahead, or None where forces change too much for a leap.

        `switched` says whether the equations switch on a surface within some time: what counts then is how forces
        change behind it.
        """
        part = replace(
            self.problem,
            t0=state.t,
            t1=there,
            y0=state.y.copy(),
            t_eval=None,
            rtol=None,
            atol=None,
            step=None,
            max_steps=MOST_STEPS,
            events=(),
            progress=None,
        )
        run = self.method.integrate(part)
        y = run.y[:, -1]
        if run.status is not Status.SUCCESS:
            return None
        begun, start = state.t + BEHIND * (there - state.t), (state.t, state.y)
        if switched(abs(begun - state.t) / 2):
            start = begun, run.dense(np.array([begun]))[:, 0]
        early = state.t + EARLY * (there - state.t)
        between = early, run.dense(np.array([early]))[:, 0]
        return y if self._steady(start, between, (there, y)) else None

    def land(self, state: DriverState, there: float, y: FloatArray, row: int) -> None:
        """Let the run go on from a state ahead; `row` is the row that the leap begins from."""
        taylor = state.taylor
        self.rows.append(row)
        self.continuations_in_a_row = self.continuations_in_a_row + 1 if state.t == self.landed else 1
        self.landed, length = there, there - state.t
        state.outputs.write(there, length, self._path(state, there, y))
        state.reals[DriverState.T] = there
        taylor.low, taylor.scale = 0.0, length
        taylor.next_limit = taylor.limit = math.inf
        taylor.rescalings = taylor.failures = 0
        state.y[:] = y

    def _path(self, state: DriverState, there: float, y: FloatArray) -> StepPath:
        """Return the path of a leap."""
        return hermite_path(4)(self.problem, np.array([state.t, there]), np.array([state.y, y]))

    def _steady(self, *points: tuple[float, FloatArray]) -> bool:
        """Return whether the accelerations at the ends of a leap are nearly the same, or grow from the first end.

        `points` are times and states: of the first end, of a place early on the leap, and of the last end.
        """
        model, parameters = self.problem.model, self.problem.parameter_array
        kernel, v = model.kernel("rhs"), model.layout.v
        try:
            first, early, last = (kernel(t, y, parameters)[v] for t, y in points)
        except SingularMassMatrix:
            return False
        own = np.maximum(np.abs(first), np.abs(last))
        slow = np.maximum(np.abs(points[0][1][v]), np.abs(points[-1][1][v])) / abs(self.problem.t1 - self.problem.t0)
        change = np.abs(last - first)
        steady = (change <= CHANGE * np.maximum(own, slow)) | (np.abs(early - first) <= GROWTH * change)
        return bool(np.isfinite(own).all() and steady.all())
