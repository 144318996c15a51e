"""Growth of errors along a run: the derivative of its end by each state along it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Trajectory

PARTS = 4
"""Into so many steps of the variational equation each step of the run is divided."""

MOST_STEPS = 50_000
"""Largest number of steps of the run: each takes some 60 us, and a matrix product for each of its parts."""

BLOCK = 2**22
"""Numbers in the matrices that are kept at once: 32 MB."""

ROUNDING = 2.0**-53


@dataclass(frozen=True)
class Sensitivity:
    """The effect at the end of errors made along the run.

    `growth` is the largest factor by which a relative error of a state grows until the end. `floor` is the change of
    the end when the most sensitive state of the run is rounded to double precision.
    """

    growth: float
    floor: float


def sensitivity(
    model: Model, run: Trajectory, parameters: Mapping[Any, float], size: FloatArray, unit: FloatArray
) -> Sensitivity:
    """Return the growth of errors along a run, by the variational equation dW/dt = J(t, y) W with RK4.

    Relative errors are relative to `size` (2n,), the magnitude of each entry of the state; the floor is in units of
    `unit` (2n,). Both are infinite if the numbers overflow. Raises RunError for a run of more than `MOST_STEPS` steps.
    """
    marks = run.t
    if len(marks) > MOST_STEPS:
        raise RunError(
            f"the run until t = {marks[-1]:g} has {len(marks) - 1} steps, and errors are followed over at most "
            f"{MOST_STEPS}: end the race earlier."
        )
    starts, lengths = marks[:-1], np.diff(marks)
    parts = np.arange(PARTS) / PARTS
    begin = (starts[:, None] + lengths[:, None] * parts).ravel()
    h = np.repeat(lengths / PARTS, PARTS)
    with np.errstate(all="ignore"):
        growth, floor, rest = 1.0, ROUNDING * float((np.abs(run.y[:, -1]) / unit).max()), np.eye(len(size))
        length = max(1, BLOCK // len(size) ** 2)
        for first in reversed(range(0, len(h), length)):
            block = slice(first, first + length)
            matrices = _transitions(model, run, parameters, begin[block], h[block])
            states = np.abs(run.dense(begin[block])).T
            for matrix, state in zip(matrices[::-1], states[::-1], strict=True):
                rest = rest @ matrix
                growth = max(growth, float(((np.abs(rest) @ size) / size).max()))
                floor = max(floor, ROUNDING * float(((np.abs(rest) @ state) / unit).max()))
    finite = np.isfinite(rest).all()
    return Sensitivity(growth if finite else np.inf, floor if finite else np.inf)


def _transitions(
    model: Model, run: Trajectory, parameters: Mapping[Any, float], begin: FloatArray, h: FloatArray
) -> FloatArray:
    """Return d y(t + h) / d y(t) for each of the steps, (N, 2n, 2n)."""

    def slope(times: FloatArray) -> FloatArray:
        return np.moveaxis(model.jacobian(times, run.dense(times), parameters), -1, 0)

    low, high = np.sort((begin[0], begin[-1] + h[-1]))
    first, middle, last = (slope(np.clip(begin + share * h, low, high)) for share in (0.0, 0.5, 1.0))
    one, width = np.eye(first.shape[1]), h[:, None, None]
    k1 = first
    k2 = middle @ (one + width / 2 * k1)
    k3 = middle @ (one + width / 2 * k2)
    k4 = last @ (one + width * k3)
    whole: FloatArray = one + width / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return whole
