"""The path between steps, computed when it is asked for: the steps' stages, all at once as columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import Kernel, SingularMassMatrix
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
        """Return the right-hand side of each column, NaN where the mass matrix is singular."""
        try:
            return self.kernel(t, y, self.parameters)
        except SingularMassMatrix as error:
            found = np.full_like(y, np.nan)
            if error.column is not None and y.shape[1] > 1:
                others = np.arange(y.shape[1]) != error.column
                found[:, others] = self.slopes(t[others], y[:, others])
            return found


def _mended(states: FloatArray, theta: FloatArray, y: FloatArray, new: FloatArray, first: FloatArray) -> FloatArray:
    """Return the states, those that are not finite replaced by the parabola with the slope `first` / h at the start.

    It is the last step of a run that ended for want of a slope: its end is known, and the slope there is not.
    """
    bad = ~np.isfinite(states).all(axis=0)
    if bad.any():
        theta, y, new, first = theta[bad], y[:, bad], new[:, bad], first[:, bad]
        states[:, bad] = y + theta * first + theta**2 * (new - y - first)
    return states


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
        with np.errstate(all="ignore"):
            for weights, k in zip(dense.weights, stages, strict=True):
                powers = np.zeros_like(theta)
                for weight in reversed(weights):
                    powers = (powers + float(weight)) * theta
                path += powers * k[:, which]
            states: FloatArray = y[:, which] + h[which] * path
        return _mended(states, theta, y[:, which], self.states[used + 1].T[:, which], (h * stages[0])[:, which])


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
        first, last = (h * self.slopes(t, y))[:, which], (h * self.slopes(end, new))[:, which]
        y, new = y[:, which], new[:, which]
        with np.errstate(all="ignore"):
            bend = (1 - 2 * theta) * (new - y) + (theta - 1) * first + theta * last
            states: FloatArray = (1 - theta) * y + theta * new + theta * (theta - 1) * bend
        return _mended(states, theta, y, new, first)
