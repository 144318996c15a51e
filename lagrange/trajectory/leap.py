"""Leaps over points at which a motion has no Taylor series although its forces hardly change.

With drag -|v|v a body at rest, or at its turning point, is at the root of a square: the force is smooth enough there,
but no series leads on. A step by a method without series does, over so little time that all else is nearly constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from lagrange.machine.backend import Kernel, SingularMassMatrix
from lagrange.machine.driver import DriverState
from lagrange.trajectory.integrator import Integrator, Problem
from lagrange.trajectory.trajectory import FloatArray, Status

SHARE = 1e-6
"""The first leap takes this part of the run; each that follows another at once takes twice the time."""

CHANGE = 0.01
"""No acceleration changes on a leap by more than this part of the largest: a force that jumps, or is infinite, is not
leapt over."""

SHORTER, ATTEMPTS = 1 / 16, 6
"""How much shorter a leap is tried again, and how often."""

MOST_STEPS = 1000
"""So many steps may a leap take: it is hardly more than one where there is something to leap to."""


@dataclass
class Leaps:
    """The leaps of a run so far: the rows that they begin from, and where the last one ended and how long it was."""

    problem: Problem
    method: Integrator
    rtol: float
    atol: float
    rows: list[int] = field(default_factory=list)
    landed: float = math.nan
    length: float = 0.0

    def ahead(self, state: DriverState) -> list[float]:
        """Return the times to leap to, the farthest first."""
        span, left = abs(self.problem.t1 - self.problem.t0), float(state.reals[DriverState.END]) - state.t
        first = 2 * self.length if state.t == self.landed else SHARE * span
        lengths = [first * SHORTER**k for k in range(ATTEMPTS)]
        least = 64 * 2.0**-52 * max(abs(state.t), 2.0**-60 * span)
        return [state.t + math.copysign(min(x, abs(left)), left) for x in lengths if x > least]

    def landing(self, state: DriverState, there: float) -> FloatArray | None:
        """Return the state (2n,) at a time ahead, or None where forces change too much for a leap."""
        part = replace(
            self.problem,
            t0=state.t,
            t1=there,
            y0=state.y.copy(),
            t_eval=None,
            rtol=self.rtol,
            atol=self.atol,
            step=None,
            max_steps=MOST_STEPS,
            events=(),
            progress=None,
        )
        run = self.method.integrate(part)
        y = run.y[:, -1]
        if run.status is not Status.SUCCESS:
            return None
        kernel, parameters = self.problem.model.kernel("rhs"), self.problem.parameter_array
        return y if _steady(kernel, parameters, (state.t, state.y), (there, y)) else None

    def land(self, state: DriverState, there: float, y: FloatArray, row: int) -> None:
        """Let the run go on from a state ahead; `row` is the row that the leap begins from."""
        r = DriverState
        self.rows.append(row)
        self.landed, self.length = there, abs(there - state.t)
        state.reals[[r.T, r.LOW]] = there, 0.0
        state.reals[[r.SCALE, r.ONCE]] = math.copysign(self.length, there - state.t), math.inf
        state.counts[r.TRIES] = 0
        state.y[:] = y


def _steady(
    kernel: Kernel, parameters: FloatArray, start: tuple[float, FloatArray], end: tuple[float, FloatArray]
) -> bool:
    """Return whether the accelerations at both ends are nearly the same."""
    n = len(start[1]) // 2
    try:
        first, last = (kernel(t, y, parameters)[n:] for t, y in (start, end))
    except SingularMassMatrix:
        return False
    largest = float(np.max(np.abs([first, last])))
    return math.isfinite(largest) and bool(np.max(np.abs(last - first)) <= CHANGE * largest)
