"""The nearest point of a constraint surface, measured by the kinetic energy; when a state counts as on it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lagrange.equations.singular import RANK, balanced
from lagrange.machine.backend import FloatArray

ON_SURFACE = 2.0**-40
"""A residual of at most this fraction of its size is rounding: states of doubles are rarely closer to the surface."""

CONVERGED = 2.0**-52
"""A residual of at most this fraction of its size needs no further correction."""

NEAREST_CORRECTIONS = 60
"""Largest number of corrections. Newton's method converges within ten from a nearby state."""

SHORTEST_SHARE = 2.0**-10
"""Smallest fraction to which a correction is shortened. If that does not help, the search ends."""

MOST_DESCENTS = 200
"""Largest number of steps along the surface to the nearest point. The distance that remains after a step is curvature *
distance times that before it.
"""

NEAREST = 1e-9
"""A point is the nearest if the step along the surface is below this fraction of the distance, or is rounding."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a surface at a point (k,): m values that are zero on the surface, and their gradients (m, k).

    `terms` (m,) are the sizes of the terms that cancel in each value. `sizes` (m,) are the scales to which rounding
    is relative. The scale of a value is the larger of its terms and its gradient times the entries of the point.
    """

    values: FloatArray
    gradient: FloatArray
    terms: FloatArray
    sizes: FloatArray

    @property
    def largest(self) -> float:
        """The largest residual relative to its size; infinity if a residual is not finite."""
        with np.errstate(all="ignore"):
            shares = np.abs(self.values) / np.where(self.sizes > 0, self.sizes, 1.0)
        return float(shares.max(initial=0.0)) if np.isfinite(shares).all() else np.inf


Surface = Callable[[FloatArray], Residuals]


class Nearest:
    """Search for the point of a surface that is nearest to another point.

    `metric` (k, k) is the symmetric matrix that measures distances. It may be singular if it is definite on the
    tangents of the surface. Only the `free` entries (a mask) of the point may change.
    """

    def __init__(self, surface: Surface, metric: FloatArray, free: FloatArray) -> None:
        self._surface, self._metric = surface, metric
        self._free = np.flatnonzero(free)

    def of(self, start: FloatArray) -> tuple[FloatArray, Residuals]:
        """Return the point of the surface nearest to `start` (k,), and its residuals.

        If Newton's method does not converge, the point is the last iterate.
        """
        x, residuals = self.restored(start)
        if residuals.largest > ON_SURFACE:
            return x, residuals
        for _ in range(MOST_DESCENTS):
            along = self._step(residuals, start - x, np.zeros_like(residuals.values))
            if self._length(along) <= max(NEAREST * self._length(x - start), CONVERGED * self._length(x)):
                break
            share, before = 1.0, self._length(x - start)
            while share >= SHORTEST_SHARE:
                trial, trial_residuals = self.restored(x + share * along)
                if trial_residuals.largest <= ON_SURFACE and self._length(trial - start) < before:
                    break
                share /= 2
            else:
                break
            x, residuals = trial, trial_residuals
        return x, residuals

    def restored(self, start: FloatArray) -> tuple[FloatArray, Residuals]:
        """Return a point of the surface close to `start` (k,), and its residuals.

        Newton's method takes the shortest step that solves the linearized equations. Unlike `of`, this does not look
        for the nearest point.
        """
        x, residuals = start, self._surface(start)
        for _ in range(NEAREST_CORRECTIONS):
            if (
                not np.isfinite(residuals.largest)
                or not np.isfinite(residuals.gradient).all()
                or residuals.largest <= CONVERGED
            ):
                break
            correction, share = self._step(residuals, np.zeros_like(x), -residuals.values), 1.0
            while share >= SHORTEST_SHARE:
                trial_residuals = self._surface(x + share * correction)
                if trial_residuals.largest < residuals.largest:
                    break
                share /= 2
            else:
                break
            x, residuals = x + share * correction, trial_residuals
        return x, residuals

    def _step(self, residuals: Residuals, towards: FloatArray, right: FloatArray) -> FloatArray:
        """Return the displacement d (k,) closest to `towards` (k,) with G d = `right` (m,); zero if d overflows.

        G is the gradient of the `residuals`. Distances are measured by the metric.
        """
        free, n = self._free, len(self._free)
        gradient = residuals.gradient[:, free]
        matrix = np.block([[self._metric[np.ix_(free, free)], gradient.T], [gradient, np.zeros((len(right),) * 2)]])
        step = np.zeros_like(towards)
        with np.errstate(all="ignore"):
            scaled, scale = balanced(matrix)
            right_side = np.concatenate([(self._metric @ towards)[free], right]) / scale
            if not (np.isfinite(scaled).all() and np.isfinite(right_side).all()):
                return step
            solution = np.linalg.lstsq(scaled, right_side, rcond=RANK)[0] / scale
        if np.isfinite(solution).all():
            step[free] = solution[:n]
        return step

    def _length(self, displacement: FloatArray) -> float:
        with np.errstate(over="ignore", invalid="ignore"):  # the square of a large distance may overflow
            square = float(displacement @ self._metric @ displacement)
        return math.sqrt(max(square, 0.0)) if not math.isnan(square) else math.inf
