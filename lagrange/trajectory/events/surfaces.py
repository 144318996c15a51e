"""The side of each switching surface on which a motion continues, if it starts on a surface or reaches one.

On a surface g is zero, so its first nonzero derivative gives the side. A choice of sides is consistent if the motion
with these sides goes there. If no choice is consistent, the motion slides along a surface.
Source: A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, section 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.program.series import SeriesProgram
from lagrange.trajectory.events.series_on_step import JUMP
from lagrange.trajectory.trajectory import FloatArray

DOUBT = 64 * 2.0**-52
"""Coefficient of g, relative to the sum of all, below which it counts as zero."""

MOST_TRIALS = 3**8
"""Largest number of choices of sides that are tried where surfaces meet: all of them for up to eight surfaces."""

Surfaces = Callable[[FloatArray], FloatArray]
"""Function of the sides of all surfaces that returns the series of all surfaces at a state, (order + 1, surfaces)."""


class Sliding(Exception):
    """The motion slides along a surface, which the equations do not describe."""

    def __init__(self, surface: int) -> None:
        super().__init__(surface)
        self.surface = surface


def stated_sides(program: SeriesProgram, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the sign of every surface at a state (2n,), each from the value of its expression.

    This needs no mass matrix, which may be singular with other sides.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.surfaces, t, y, parameters)
        return np.asarray(np.sign(np.array(values[: program.sides], dtype=float)))


def settled_sides(surfaces: Surfaces, sides: FloatArray, choices: Mapping[int, tuple[int, ...]]) -> FloatArray:
    """Return the first consistent choice of sides with which the motion leaves the surfaces that it is on.

    `choices` has the sides to try for each of those surfaces, the likely one first; 0 is the side of a motion that
    stays on the surface by itself. If no choice is consistent, a side without values is returned, so that the run ends
    there. Otherwise raises Sliding, or SingularMassMatrix if a choice has a singular mass matrix.
    """
    undefined: FloatArray | None = None
    singular: SingularMassMatrix | None = None
    for combination in islice(product(*choices.values()), MOST_TRIALS):
        trial = sides.copy()
        trial[list(choices)] = combination
        try:
            g = _reread(surfaces, trial, choices)
        except SingularMassMatrix as error:
            singular = error
            continue
        if not np.isfinite(g).all():
            undefined = trial if undefined is None else undefined
        elif all(leaving(g[:, i])[0] == side for i, side in zip(choices, combination, strict=True)):
            return trial
    if undefined is not None:
        return undefined
    raise Sliding(next(iter(choices))) if singular is None else singular


def _reread(surfaces: Surfaces, trial: FloatArray, chosen: Container[int]) -> FloatArray:
    """Return the series of the surfaces, and correct the sides in `trial` that contradict their values.

    A surface may depend on the sides of others. A surface in a branch that was not taken may have no side yet. Sides
    in `chosen` are kept.
    """
    g = surfaces(trial)
    for _ in trial:
        wrong = [i for i in np.flatnonzero(clear(g) & (np.sign(g[0]) != trial)) if i not in chosen]
        if not wrong:
            break
        trial[wrong] = np.sign(g[0, wrong])
        g = surfaces(trial)
    return g


def clear(g: FloatArray) -> NDArray[np.bool_]:
    """Return a mask of the functions with series g, (order + 1, ...), that are clearly not zero at their start."""
    return np.asarray(np.abs(g[0]) > JUMP * np.where(np.isfinite(g), np.abs(g), 0.0).max(axis=0))


def is_zero(g: FloatArray, noise: float = 0.0) -> bool:
    """Return True if a function with the series g is zero at its start, up to rounding and `noise`."""
    rest = float(np.abs(g[1:]).sum())
    return bool(abs(g[0]) <= noise + (DOUBT * rest if rest < math.inf else 0.0))


def leaving(g: FloatArray) -> tuple[int, int]:
    """Return the sign of g right after a start at zero, and the order of its leading term; (0, 0) if g stays zero."""
    sizes = np.abs(g[1:])
    beyond = sizes > DOUBT * sizes.sum()
    if not beyond.any():
        return 0, 0
    first = int(np.argmax(beyond))
    return int(math.copysign(1.0, g[1 + first])), 1 + first
