"""The series of what is watched from a state on: how far it can be trusted, and how much of it is round-off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.machine.driver import DriverState
from lagrange.trajectory.trajectory import FloatArray

TILT = 2.0**-26
"""The part by which the state is moved to see how much an expression owes to it: half of the digits."""

NOISE = 4 * 2.0**-52
"""Rounding of the state, here and where the step before ended, times what an expression owes to it."""

SLACK = 64.0
"""The series of an expression may end this many tolerances above the end of the state's: it is a sum of products."""


@dataclass(frozen=True, eq=False)
class Look:
    """Series at a state in units of `scale`: those of the state (2n) and of what is watched, and its `noise`."""

    scale: float
    rows: FloatArray
    watched: FloatArray
    noise: FloatArray

    @classmethod
    def at(cls, series: Series, order: int, t: float, y: FloatArray, scale: float, values: FloatArray) -> Look:
        """Look ahead from a state (2n,); the scale has the sign of the run. Raises SingularMassMatrix."""
        size = len(y)
        rows = series.rows(order, t, y, scale, values)
        watched = rows[:, size:]
        # The tilts differ, else the difference of two equal entries would seem to owe nothing to either.
        tilt = _tilt(size + 1)
        try:
            moved = series.rows(order, t * tilt[size], y * tilt[:size], scale, values)[0, size:]
        except SingularMassMatrix:
            moved = watched[0]
        with np.errstate(all="ignore"):
            noise = np.abs(moved - watched[0]) * (NOISE / TILT)
        return cls(scale, rows, watched, np.where(noise < math.inf, noise, 0.0))

    def trusted(self, s: float, rtol: float) -> tuple[float, int]:
        """Return how much of a step the watched series reach with their accuracy, and which of them reaches least.

        The step is as long as the series of the state allow. That of an expression such as log(x) may end earlier.
        """
        order, least = len(self.watched) - 1, -1
        sizes = np.abs(self.watched)
        tolerance = SLACK * max(rtol, 2.0**-52)
        for _ in range(60):
            with np.errstate(all="ignore"):
                terms = sizes * (s ** _ranks(order))[:, None]
                ratios = terms[-2:].max(axis=0) / (tolerance * terms[: order // 2 + 1].max(axis=0))
            # Where all is zero there is nothing to reach; where a term overflows, the step is much too long.
            ratios = np.where(terms[-2:].any(axis=0), np.nan_to_num(ratios, nan=math.inf), 0.0)
            if not (ratios > 1).any():
                break
            least = int(np.argmax(ratios))
            s *= min(0.9, max(0.05, float(ratios[least]) ** (-1 / order)))
        return s, least


@lru_cache(maxsize=64)
def _tilt(size: int) -> FloatArray:
    """Return the factors by which time and state are moved, all different, close to one."""
    return np.asarray(1 + TILT * (1 + np.arange(size) * 0.6180339887498949 % 1))


@lru_cache(maxsize=64)
def _ranks(order: int) -> FloatArray:
    """Return 0, 1, ... up to the order."""
    return np.arange(order + 1.0)


def signed_scale(state: DriverState) -> float:
    """Return the scale of time with the sign of the run's direction."""
    left = state.reals[DriverState.END] - state.t
    return math.copysign(float(state.reals[DriverState.SCALE]), left or float(state.reals[DriverState.SCALE]))


def state_at(y: FloatArray, rows: FloatArray, s: float) -> FloatArray:
    """Return the state (2n,) at a time on the step, in units of the scale."""
    total = np.zeros(len(y))
    for row in rows[:0:-1, : len(y)]:
        total = (total + row) * s
    return y + total
