"""The path between steps, computed when it is asked for: for the steps that are asked for, all at once as columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import Kernel, SingularMassMatrix
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.tableaux.butcher import ButcherTableau
from lagrange.trajectory.trajectory import FloatArray

Places = NDArray[np.int64]
"""Numbers of steps, (K,)."""


@dataclass(frozen=True, eq=False)
class StepPath(ABC):
    """Accepted steps: times (S+1,), states (S+1, 2n), and the right-hand side that they follow.

    Inside each step the path is a polynomial, of degree 16 at most: events are sought on it.
    """

    kernel: Kernel
    parameters: FloatArray
    times: FloatArray
    states: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, in any order, (2n, K)."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        steps = self._locate(times)
        start = self.times[steps]
        used, which = np.unique(steps, return_inverse=True)
        return self._columns(used, which, (times - start) / (self.times[steps + 1] - start))

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states at the same fractions theta (K,) of each of some steps (k,), (2n, k, K)."""
        which = np.repeat(np.arange(len(steps)), len(theta))
        return self._columns(steps, which, np.tile(theta, len(steps))).reshape(-1, len(steps), len(theta))

    @abstractmethod
    def _columns(self, used: Places, which: Places, theta: FloatArray) -> FloatArray:
        """Return the states at the fractions theta (K,) of the steps used[which]."""

    def _locate(self, times: FloatArray) -> Places:
        """Return for each time the step that it lies in."""
        edges = self.times if self.times[-1] >= self.times[0] else -self.times
        wanted = times if self.times[-1] >= self.times[0] else -times
        found: Places = np.clip(np.searchsorted(edges, wanted, side="right") - 1, 0, len(edges) - 2)
        return found

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
class RungeKuttaPath(StepPath):
    """The dense output of a Runge-Kutta method: its stages are computed again for the steps that are asked for."""

    tableau: ButcherTableau

    def _columns(self, used: Places, which: Places, theta: FloatArray) -> FloatArray:
        t, y = self.times[used], self.states[used].T
        h = self.times[used + 1] - t
        rows, abscissae, weights = _coefficients(self.tableau)
        stages = np.empty((len(rows), y.size))
        for i, c in enumerate(abscissae):
            moved = (rows[i, :i] @ stages[:i]).reshape(y.shape)
            stages[i] = self.slopes(t + c * h, y + h * moved).ravel()
        path = np.zeros((len(y), len(theta)))
        powers = theta ** np.arange(1, weights.shape[1] + 1)[:, None]
        with np.errstate(all="ignore"):
            for share, k in zip(weights, stages.reshape(-1, *y.shape), strict=True):
                if share.any():
                    path += (share @ powers) * k[:, which]
            states: FloatArray = y[:, which] + h[which] * path
        first = h * stages[0].reshape(y.shape)
        return _mended(states, theta, y[:, which], self.states[used + 1].T[:, which], first[:, which])


@lru_cache(maxsize=64)
def _coefficients(tableau: ButcherTableau) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows of a tableau as a square matrix, the abscissae, and the powers of theta, from 1, in each weight.

    Where a slope has no value, a zero in the matrix does not hide it: the step has no path then.
    """
    if tableau.dense is None:
        raise AssertionError("a method is registered with its dense output")
    rows = np.zeros((len(tableau.rows), len(tableau.rows)))
    for i, row in enumerate(tableau.rows):
        rows[i, : len(row)] = [float(a) for a in row]
    powers = max(map(len, tableau.dense.weights))
    weights = np.array([[*map(float, line), *[0.0] * (powers - len(line))] for line in tableau.dense.weights])
    return rows, np.array([float(c) for c in tableau.abscissae]), weights


@dataclass(frozen=True, eq=False)
class HermitePath(StepPath):
    """The cubic through both ends of a step with the slopes there, of order 3, raised to any `order` by Picard's way.

    The integral of the right-hand side along a path of order p is one of order p + 1, and what it misses of the end,
    the error of the step and more, is spread over the step by a cubic that is flat at both ends: so the path goes
    through both ends with their slopes, and needs nothing but the right-hand side. Where the steps are so long that
    this does not converge, as those of an implicit method may be, the path of a step stays the best so far, the cubic
    if need be. Source: W. H. Enright, K. R. Jackson, S. P. Norsett, P. G. Thomsen, Interpolants for Runge-Kutta
    formulas, ACM Trans. Math. Softw. 12, 1986, with the nodes of Chebyshev in place of theirs.
    """

    order: int = 3

    def _columns(self, used: Places, which: Places, theta: FloatArray) -> FloatArray:
        t, end = self.times[used], self.times[used + 1]
        y, new = self.states[used].T, self.states[used + 1].T
        h = end - t
        first, last = h * self.slopes(t, y), h * self.slopes(end, new)
        changes = self._changes(t, h, y, new - y, first, last) if self.order > 3 else None
        y, new, first, last = (array[:, which] for array in (y, new, first, last))
        with np.errstate(all="ignore"):
            states: FloatArray = _cubic(theta, y, new, first, last)
            if changes is not None:
                shares = _weights(self.order) @ theta ** np.arange(self.order + 2)[:, None]
                for share, change in zip(shares, changes, strict=True):
                    states += share * change[:, which]
        return _mended(states, theta, y, new, first)

    def _changes(
        self, t: FloatArray, h: FloatArray, y: FloatArray, gap: FloatArray, first: FloatArray, last: FloatArray
    ) -> FloatArray:
        """Return by how much the slopes (N, 2n, S) at the nodes differ from those of the cubic."""
        order = self.order
        nodes = _nodes(order)
        cubic = [_cubic(s, y, y + gap, first, last) for s in nodes]
        plain = np.stack([_slope(s, gap, first, last) for s in nodes])
        changes, moved = np.zeros_like(plain), np.full(len(t), np.inf)
        to_states = _integrals(order)
        with np.errstate(all="ignore"):
            for _ in range(order - 3):
                trial = changes.copy()
                shifts = np.einsum("ij,jks->iks", to_states, changes)
                for i in range(1, order - 1):
                    state = cubic[i] + shifts[i]
                    trial[i] = h * self.slopes(t + nodes[i] * h, state) - plain[i]
                step = np.abs(trial - changes).max(axis=(0, 1))
                better = step < np.where(np.isinf(moved), np.abs(plain).max(axis=(0, 1)), 0.5 * moved)
                changes[..., better] = trial[..., better]
                moved = np.where(better, step, 0.0)
        return changes


def hermite_path(order: int) -> Callable[[Problem, FloatArray, FloatArray], HermitePath]:
    """Return what makes the Hermite path of a method of an order, as a `StepPlan` wants it: one order less will do."""

    def path(problem: Problem, times: FloatArray, states: FloatArray) -> HermitePath:
        kernel, parameters = problem.model.kernel("rhs"), problem.parameter_array
        return HermitePath(kernel, parameters, times, states, max(3, order - 1))

    return path


def _cubic(theta: Any, y: FloatArray, new: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    bend = (1 - 2 * theta) * (new - y) + (theta - 1) * first + theta * last
    return np.asarray((1 - theta) * y + theta * new + theta * (theta - 1) * bend)


def _slope(theta: float, gap: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Return the derivative of the cubic by theta."""
    inner = 6 * theta * (1 - theta) * gap
    return inner + (1 - theta) * (1 - 3 * theta) * first + theta * (3 * theta - 2) * last


@lru_cache(maxsize=16)
def _nodes(count: int) -> FloatArray:
    """Return the extrema of Chebyshev's polynomial on [0, 1], both ends among them."""
    return np.asarray(np.sin(np.pi * np.arange(count) / (2 * (count - 1))) ** 2)


@lru_cache(maxsize=16)
def _weights(count: int) -> FloatArray:
    """Return powers of theta (count, count + 2): the integral of a node's share of a change of slopes.

    What it misses of zero at the end is taken back along the step.
    """
    nodes = _nodes(count)
    shares = np.zeros((count, count + 2))
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        slope = np.poly1d(others, r=True) / np.prod(node - others)
        integral = slope.integ()
        share = integral - integral(1.0) * np.poly1d([-2.0, 3.0, 0.0, 0.0])
        shares[i, : len(share.coeffs)] = share.coeffs[::-1]
    return shares


@lru_cache(maxsize=16)
def _integrals(count: int) -> FloatArray:
    """Return the matrix from changes of slopes at the nodes to changes of states there."""
    powers = _nodes(count)[:, None] ** np.arange(count + 2)
    return np.asarray(powers @ _weights(count).T)
