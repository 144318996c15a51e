"""Equilibria by number: Newton's method on the forces from many starts at once, and the distinct ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model

STARTS = 256
"""Starts of the search, the initial state among them."""

STEPS = 60
"""Steps of Newton's method from each; near an equilibrium it takes five."""

CLOSE = 1e-9
"""The last step of a start that ended, relative to its coordinates and to 1."""

SAME = 1e-6
"""Distance of two ends that are one equilibrium, in the same measure."""
FLAT = 1e-6
"""The least slope of the forces, relative to the largest, at which an end is flat: as that of y^3 is near zero."""

SAME_FLAT = 1e-3
"""Distance of two flat ends that are one equilibrium: forces like y^3 leave 1e-4 of y open. The one of least force
stands for them."""
WITHIN = 1e-3
"""How far off, in the same measure, forces and slopes may put the end: far out a force may be small and never zero."""

DIFFERENCE = 1e-6
"""Step of central differences, relative to 1 and to the coordinates: Newton's method then gains nine digits a step."""

SMALL_FORCE = 1e-8
"""Forces left at an equilibrium, relative to those at the starts."""


@dataclass(frozen=True, eq=False)
class Search:
    """The search for coordinates at which the forces vanish, on the constraints.

    `unknowns` are the rows of the coordinates that are sought, `angles` says which come round after a full turn.
    `forces` are the residuals of the equations of motion at rest, `gradient` the rows of G and `zeros` the constraints,
    expressions of the model's system; `state` (2n,) has the coordinates that stay, and steady velocities.
    """

    model: Model
    parameters: FloatArray
    state: FloatArray
    unknowns: tuple[int, ...]
    angles: tuple[bool, ...]
    forces: tuple[Any, ...]
    gradient: tuple[tuple[Any, ...], ...]
    zeros: tuple[Any, ...]

    def found(self) -> list[FloatArray]:
        """Return the unknowns at distinct equilibria, (k,) each, in their order."""
        ends: list[FloatArray] = []
        with np.errstate(all="ignore"):
            q, good = self._newton(self._starts())
            left, slopes = np.abs(self._residuals(q)).max(axis=0), self._slopes(q)
            near = left < WITHIN * np.abs(slopes).max(axis=(1, 2)) * (1 + np.abs(q).max(axis=0))
        flat: list[bool] = []
        for i in sorted(np.flatnonzero(good & near), key=lambda i: float(left[i])):
            here, sizes = self._wrapped(q[:, i]), np.linalg.svd(slopes[i], compute_uv=False)
            level = bool(sizes[-1] <= FLAT * sizes[0])
            same = (
                self._same(here, end, SAME_FLAT if level and other else SAME)
                for end, other in zip(ends, flat, strict=True)
            )
            if not any(same):
                ends.append(here)
                flat.append(level)
        return sorted(ends, key=lambda end: [round(float(x), 6) for x in end])

    def _same(self, one: FloatArray, other: FloatArray, close: float) -> bool:
        return bool(np.abs(self._wrapped(one - other)).max() <= close * (1 + np.abs(other).max()))

    def _wrapped(self, q: FloatArray) -> FloatArray:
        """Return angles between -pi and pi, the upper end included, and zeros without round-off."""
        turns = np.ceil(q / (2 * math.pi) - 0.5 - 1e-9)
        wrapped = np.where(self.angles, q - 2 * math.pi * turns, q)
        return np.where(np.abs(wrapped) < 1e-12, 0.0, wrapped)

    @cached_property
    def _scale(self) -> FloatArray:
        size = max(1.0, float(np.abs(self.state[list(self.unknowns)]).max()))
        return np.where(self.angles, 1.0, size)

    def _starts(self) -> FloatArray:
        """Return the starts, (k, STARTS): the initial state, zero, and random ones of several sizes."""
        draw = np.random.default_rng(0)
        k = len(self.unknowns)
        sizes = self._scale[:, None] * 10.0 ** draw.uniform(-1.0, 1.0, STARTS)
        turns = draw.uniform(-math.pi, math.pi, (k, STARTS))
        starts = np.where(np.array(self.angles)[:, None], turns, sizes * draw.normal(size=(k, STARTS)))
        starts[:, 0] = self.state[list(self.unknowns)]
        starts[:, 1] = 0.0
        return starts

    def _residuals(self, q: FloatArray) -> FloatArray:
        """Return what vanishes at an equilibrium: forces that the constraints leave, then the constraints."""
        columns = q.shape[1]
        y = np.repeat(self.state[:, None], columns, axis=1)
        y[list(self.unknowns)] = q
        t = np.zeros(columns)

        def rows(expressions: Sequence[Any]) -> FloatArray:
            return np.array([self.model.evaluate_expression(e, t, y, self.parameters) for e in expressions])

        forces = rows(self.forces)
        if not self.zeros:
            return forces
        gradient = np.array([rows(row) for row in self.gradient])
        sound = np.isfinite(gradient).all(axis=(0, 1)) & np.isfinite(forces).all(axis=0)
        left = np.full_like(forces, np.nan)
        g, f = np.moveaxis(gradient[:, :, sound], 2, 0), forces[:, sound].T[:, :, None]
        left[:, sound] = (f - np.linalg.pinv(g) @ (g @ f))[:, :, 0].T
        return np.vstack([left, rows(self.zeros)])

    def _slopes(self, q: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals, (columns, residuals, k)."""
        slopes = []
        for i in range(len(q)):
            step = np.zeros_like(q)
            step[i] = DIFFERENCE * (1 + np.abs(q[i]))
            slopes.append((self._residuals(q + step) - self._residuals(q - step)) / (2 * step[i]))
        return np.moveaxis(np.array(slopes), (0, 1, 2), (2, 1, 0))

    def _newton(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the starts end, and which of them did at an equilibrium."""
        good = np.zeros(q.shape[1], dtype=bool)
        first = self._residuals(q)
        sizes = np.array([np.median(np.abs(row[np.isfinite(row)])) if np.isfinite(row).any() else 1.0 for row in first])
        for _ in range(STEPS):
            r, slopes = self._residuals(q), self._slopes(q)
            sound = np.isfinite(r).all(axis=0) & np.isfinite(slopes).all(axis=(1, 2))
            step = np.zeros_like(q)
            if sound.any():
                step[:, sound] = (np.linalg.pinv(slopes[sound], rcond=1e-10) @ r.T[sound][:, :, None])[:, :, 0].T
            small = np.abs(r).max(axis=0) <= SMALL_FORCE * max(float(sizes.max()), 1e-300)
            done = np.abs(step).max(axis=0) <= CLOSE * (1 + np.abs(q).max(axis=0))
            good = sound & small & done
            if good.all():
                break
            largest = np.abs(step / self._scale[:, None]).max(axis=0)
            q = q - step * np.minimum(1.0, 1.0 / np.maximum(largest, 1e-300))
        return q, good
