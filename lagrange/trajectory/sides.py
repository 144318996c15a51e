"""On which side of each switching surface a motion goes on, where it starts on one or comes to one.

On a surface the sign of g says nothing; the first of its derivatives that is not zero does, on the side that is
tried: a side is consistent if the motion with it goes there. Where no choice of sides is, the motion slides along a
surface.
Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, section 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import islice, product

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

DOUBT = 64 * 2.0**-52
"""A coefficient of g below this part of the sum of all counts as zero."""

MOST_TRIALS = 3**8
"""How many choices of sides are tried where several surfaces meet: all, up to eight surfaces."""

Surfaces = Callable[[FloatArray], FloatArray]
"""From the side of every surface to the series of all surfaces at a state, (order + 1, surfaces)."""


class Sliding(Exception):
    """The motion stays on a surface, and the equations do not say how."""

    def __init__(self, surface: int) -> None:
        super().__init__(surface)
        self.surface = surface


def apparent_sides(surfaces: Surfaces, count: int, noise: FloatArray) -> FloatArray:
    """Return the sign of every surface at a state, 0 where g is zero to within its noise.

    A surface may depend on the sides of those before it, so the signs are read again until they stay.
    """
    sides = np.zeros(count)
    for _ in range(count + 1):
        g = surfaces(sides)
        doubtful = [is_zero(g[:, i], float(noise[i])) for i in range(count)]
        found = np.where(doubtful, 0.0, np.sign(g[0]))
        if np.array_equal(found, sides, equal_nan=True):
            break
        sides = found
    return sides


def settled_sides(surfaces: Surfaces, sides: FloatArray, choices: Mapping[int, tuple[int, ...]]) -> FloatArray:
    """Return the sides with which the motion leaves the surfaces that it is on, the first consistent choice of all.

    `choices` has the sides to try for each of those surfaces, the likely one first; 0 is the side of a motion that
    stays on the surface by itself. Where the equations have no value behind a surface, the motion goes there all the
    same: the run is to end by that. Raises Sliding.
    """
    undefined: FloatArray | None = None
    for combination in islice(product(*choices.values()), MOST_TRIALS):
        trial = sides.copy()
        trial[list(choices)] = combination
        g = surfaces(trial)
        if not np.isfinite(g).all():
            undefined = trial if undefined is None else undefined
        elif all(leaving(g[:, i])[0] == side for i, side in zip(choices, combination, strict=True)):
            return trial
    if undefined is not None:
        return undefined
    raise Sliding(next(iter(choices)))


def is_zero(g: FloatArray, noise: float = 0.0) -> bool:
    """Whether a function with the series g is zero at its start, to round-off and its noise."""
    rest = float(np.abs(g[1:]).sum())
    return bool(abs(g[0]) <= noise + (DOUBT * rest if rest < math.inf else 0.0))


def leaving(g: FloatArray) -> tuple[int, int]:
    """Return the sign of g right after a start at zero, and the order of the term that tells; (0, 0) if g stays."""
    sizes = np.abs(g[1:])
    beyond = sizes > DOUBT * sizes.sum()
    if not beyond.any():
        return 0, 0
    first = int(np.argmax(beyond))
    return int(math.copysign(1.0, g[1 + first])), 1 + first
