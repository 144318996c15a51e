"""On which side of each switching surface a motion goes on, where it starts on one or comes to one.

On a surface the sign of g says nothing; the first of its derivatives that is not zero does, on the side that is
tried: a side is consistent if the motion with it goes there. Where neither is, the motion slides along the surface.
Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, section 4.
"""

from __future__ import annotations

import math

import numpy as np

from lagrange.machine.backend import Series
from lagrange.machine.driver import DriverState
from lagrange.trajectory.trajectory import FloatArray

DOUBT = 64 * 2.0**-52
"""A coefficient of g below this part of the sum of all counts as zero."""


class Sliding(Exception):
    """The motion stays on a surface, and the equations do not say how."""

    def __init__(self, surface: int) -> None:
        super().__init__(surface)
        self.surface = surface


def settle(series: Series, order: int, parameters: FloatArray, state: DriverState) -> FloatArray:
    """Return the side of every surface at a state. Raises Sliding."""
    count = series.program.sides
    sides = np.zeros(count)
    for _ in range(count + 1):
        g = _surfaces(series, order, np.concatenate([parameters, sides]), state)
        found = np.sign(g[0])
        if (found == sides).all():
            break
        sides = found
    for surface in range(count):
        if sides[surface] == 0:
            sides[surface] = settled_side(series, order, np.concatenate([parameters, sides]), state, surface, 1)
    return sides


def settled_side(
    series: Series, order: int, values: FloatArray, state: DriverState, surface: int, likely: int
) -> float:
    """Return the side on which the motion leaves a surface that it is on: the likely one if it can. Raises Sliding.

    `values` are the parameters and the sides. Zero is the side of a motion that stays on the surface by itself.
    """
    for side in (likely, -likely, 0):
        trial = values.copy()
        trial[len(values) - series.program.sides + surface] = side
        if leaving(_surfaces(series, order, trial, state)[:, surface])[0] == side:
            return float(side)
    raise Sliding(surface)


def _surfaces(series: Series, order: int, values: FloatArray, state: DriverState) -> FloatArray:
    """Return the series of the surfaces, (order + 1, sides)."""
    rows = series.rows(order, state.t, state.y, signed_scale(state), values)
    return rows[:, len(state.y) : len(state.y) + series.program.sides]


def signed_scale(state: DriverState) -> float:
    """Return the scale of time with the sign of the run's direction."""
    left = state.reals[DriverState.END] - state.t
    return math.copysign(state.reals[DriverState.SCALE], left or state.reals[DriverState.SCALE])


def is_zero(g: FloatArray) -> bool:
    """Whether a function with the series g is zero at its start, to round-off."""
    return bool(abs(g[0]) <= DOUBT * np.abs(g[1:]).sum())


def leaving(g: FloatArray) -> tuple[int, int]:
    """Return the sign of g right after a start at zero, and the order of the term that tells; (0, 0) if g stays."""
    sizes = np.abs(g[1:])
    beyond = sizes > DOUBT * sizes.sum()
    if not beyond.any():
        return 0, 0
    first = int(np.argmax(beyond))
    return int(np.sign(g[1 + first])), 1 + first
