"""The path between the steps of a stiffly accurate collocation method: its polynomial, and a degree more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.machine.backend import Kernel, SingularMassMatrix
from lagrange.trajectory.paths.step_paths import Places, StepPath
from lagrange.trajectory.trajectory import FloatArray

MOST_ITERATIONS = 12
"""Corrections of the inner stages, at most; 3 to 5 bring them from a straight line to round-off."""


@dataclass(frozen=True, eq=False)
class CollocationPath(StepPath):
    """The polynomials of the steps, found again when they are asked for.

    The last stage is the end of the step, which is known; the others are solved for, in all steps at once. Their
    values are of order s alone, and so is their polynomial. But their slopes are as well, and one more slope makes the
    integral of the slopes a path of order s + 1: that at the start, which is the last one of the step before; the
    first step takes the first one of the step behind it. All slopes are those of the polynomials: the law itself
    would not do, for on a stiff system round-off in the state is no round-off in the slope. A step that stands alone
    keeps its polynomial.
    """

    jacobian: Kernel
    A: Sequence[Sequence[float]]
    c: Sequence[float]
    basis: Sequence[Any]
    """The Lagrange polynomials of the points c and of 0, without that of 0."""

    def _columns(self, used: Places, which: Places, theta: FloatArray) -> FloatArray:
        """Return the states; see `StepPath`."""
        found: FloatArray = self.states[used[which]].T.copy()
        own = self.increments(used)
        for polynomial, increment in zip(self.basis, own, strict=True):
            found += polynomial(theta) * increment[:, which]
        if len(self.times) > 2:
            nodes = np.poly1d(self.c, r=True)
            # Its integral over the step is zero: a formula of Radau integrates more degrees than that.
            found += self._missing(used, own, nodes)[:, which] * nodes.integ()(theta)
        return found

    def _missing(self, used: Places, own: FloatArray, nodes: Any) -> FloatArray:
        """Return the factors (2n, K) with which the polynomial that is zero at the points c joins the slopes."""
        beside = np.where(used > 0, used - 1, 1)
        lengths = np.diff(self.times)
        ratio = lengths[beside] / lengths[used]
        place = np.where(used > 0, 0.0, 1.0 + self.c[0] * ratio)
        slopes = np.einsum("ij,jak->iak", np.linalg.inv(np.array(self.A)), self.increments(beside))
        there = np.where(used > 0, slopes[-1], slopes[0]) / ratio
        here = sum(line.deriv()(place) * increment for line, increment in zip(self.basis, own, strict=True))
        missing: FloatArray = (there - here) / nodes(place)
        return missing

    def increments(self, steps: Any) -> FloatArray:
        """Return what the state has gained at each of the points c in the given steps (K,), shape (s, 2n, K).

        Where the law is no number the polynomial is a straight line.
        """
        t, y = self.times[steps], self.states[steps].T
        h, whole = self.times[steps + 1] - t, (self.states[steps + 1] - self.states[steps]).T
        line = np.array(self.c)[:, None, None] * whole
        inner, dimension = len(self.c) - 1, len(y)
        A = np.array(self.A)
        with np.errstate(all="ignore"):
            last = self._values(self.kernel, t + h, y + whole)
            derivative = self._values(self.jacobian, t + h, y + whole)
            matrix = -np.einsum("ij,abk,k->kiajb", A[:inner, :inner], derivative, h)
            matrix += np.einsum("ij,ab->iajb", np.eye(inner), np.eye(dimension))
            square = matrix.reshape(-1, inner * dimension, inner * dimension)
            good = np.isfinite(square).all(axis=(1, 2))
            square[~good] = np.eye(inner * dimension)
            inverse = np.linalg.inv(square)
            Z = line.copy()
            for _ in range(MOST_ITERATIONS):
                slopes = [self._values(self.kernel, t + c * h, y + z) for c, z in zip(self.c, Z[:inner], strict=False)]
                residual = np.einsum("ij,jak->iak", A[:inner], np.array([*slopes, last])) * h - Z[:inner]
                move = np.einsum("kab,bk->ak", inverse, residual.reshape(-1, len(t))).reshape(residual.shape)
                Z[:inner] += move
                if not (abs(move) > 1e-14 * (abs(y) + abs(whole))).any():
                    break
        bad = ~np.isfinite(Z).all(axis=(0, 1)) | ~good
        Z[:, :, bad] = line[:, :, bad]
        found: FloatArray = Z
        return found

    def _values(self, kernel: Kernel, t: FloatArray, y: FloatArray) -> FloatArray:
        try:
            return kernel(t, y, self.parameters)
        except SingularMassMatrix:
            return np.full((*kernel.program.shape, len(t)), np.nan)
