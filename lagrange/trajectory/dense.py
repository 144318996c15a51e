"""The path between steps, computed when it is asked for: the steps' stages, all at once as columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import Kernel
from lagrange.trajectory.methods.runge_kutta import ButcherTableau
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class _Steps:
    """Accepted steps: times (S+1,), states (S+1, 2n), and the right-hand side that they follow."""

    kernel: Kernel
    parameters: FloatArray
    times: FloatArray
    states: FloatArray

    def locate(self, times: FloatArray) -> FloatArray:
        """Return for each time the step that it lies in."""
        edges = self.times if self.times[-1] >= self.times[0] else -self.times
        wanted = times if self.times[-1] >= self.times[0] else -times
        return np.clip(np.searchsorted(edges, wanted, side="right") - 1, 0, len(edges) - 2)

    def slopes(self, t: FloatArray, y: FloatArray) -> FloatArray:
        return self.kernel(t, y, self.parameters)


@dataclass(frozen=True, eq=False)
class RungeKuttaPath(_Steps):
    """The dense output of a Runge-Kutta method: its stages are computed again for the steps that are asked for."""

    tableau: ButcherTableau

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, (2n, K)."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        used, which = np.unique(self.locate(times), return_inverse=True)
        t, y = self.times[used], self.states[used].T
        h = self.times[used + 1] - t
        dense = self.tableau.dense
        if dense is None:
            raise AssertionError("a method is registered with its dense output")
        stages: list[FloatArray] = []
        for row, c in zip(self.tableau.rows, self.tableau.abscissae, strict=True):
            moved = sum((float(a) * k for a, k in zip(row, stages, strict=False) if a), np.zeros_like(y))
            stages.append(self.slopes(t + float(c) * h, y + h * moved))
        theta = (times - t[which]) / h[which]
        path = np.zeros((len(y), len(times)))
        for weights, k in zip(dense.weights, stages, strict=True):
            powers = np.zeros_like(theta)
            for weight in reversed(weights):
                powers = (powers + float(weight)) * theta
            path += powers * k[:, which]
        states: FloatArray = y[:, which] + h[which] * path
        return states


@dataclass(frozen=True, eq=False)
class HermitePath(_Steps):
    """The cubic through both ends of a step with the slopes there: of order 3, for methods up to order 4."""

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, (2n, K)."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        used, which = np.unique(self.locate(times), return_inverse=True)
        t, end = self.times[used], self.times[used + 1]
        y, new = self.states[used].T, self.states[used + 1].T
        h = end - t
        theta = (times - t[which]) / h[which]
        change = (new - y)[:, which]
        first, last = (h * self.slopes(t, y))[:, which], (h * self.slopes(end, new))[:, which]
        bend = (1 - 2 * theta) * change + (theta - 1) * first + theta * last
        states: FloatArray = (1 - theta) * y[:, which] + theta * new[:, which] + theta * (theta - 1) * bend
        return states
