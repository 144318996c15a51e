"""Floors of the tolerances at the rounding noise of each entry of a state.

An entry that is only the rounding of larger terms has nothing that steps could follow. Its floor is what rounding adds
to it in the natural time of the motion: the reciprocal of the fastest rate of the equations, linearized at the state.
"""

from __future__ import annotations

import math

import numpy as np

from lagrange.machine.kernel.rounding_noise import rounding_noise
from lagrange.machine.model import Model
from lagrange.trajectory.sizes import Slopes, slopes_of
from lagrange.trajectory.trajectory import FloatArray

NOISE_MULTIPLE = 4.0
"""Floors are this multiple of the rounding noise of an entry. With 16 a chain of ten links loses a digit at 1e-12."""

VISIBLE = 2.0**8, 2.0**24, 2.0**40
"""Change of an acceleration by a displacement, in multiples of its noise: the least, the aim, and the largest.

A smaller change has no digits, and a larger one may be no longer linear.
"""

MOST_DISPLACEMENTS = 8
"""Most displacements of one entry that are tried; its column is zero if none changes an acceleration visibly."""


def noise_floors(model: Model, parameters: FloatArray, t: float, y: FloatArray, left: float) -> FloatArray:
    """Return a multiple of the rounding noise of each entry (2n,), 0 where it is not known.

    The noise of a velocity is that of its acceleration over the natural time of the motion, at most the time `left`;
    that of a coordinate is half of the same over that time once more. It is not known where the mass matrix is
    singular.
    """
    layout = model.layout
    with np.errstate(all="ignore"):
        noise = rounding_noise(model.interpreted("rhs").program, t, y, parameters)[layout.v]
        rate = _fastest_rate(slopes_of(model, parameters), model, t, y, noise)
        time = min(abs(left), 1 / rate) if rate > 0 else abs(left)
        floors = NOISE_MULTIPLE * np.concatenate([noise * time * time / 2, noise * time])
    return np.nan_to_num(floors, posinf=0.0)


def _fastest_rate(slopes: Slopes, model: Model, t: float, y: FloatArray, noise: FloatArray) -> float:
    """Return the largest rate of the equations linearized at a state (2n,), 0 if nothing responds to displacements.

    It is a spectral radius: it does not depend on the units of the entries. `noise` (n,) is that of accelerations.
    """
    layout = model.layout
    force = slopes(t, y)[layout.v]
    columns = np.array([_response(slopes, layout.v, t, y, j, force, noise) for j in range(len(y))]).T
    stiffness, damping = (_spectral_radius(part) for part in (columns[:, layout.q], columns[:, layout.v]))
    return max(math.sqrt(stiffness), damping)


def _response(
    slopes: Slopes, v: slice, t: float, y: FloatArray, j: int, force: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the derivatives (n,) of accelerations by entry j, 0 where no displacement changes them visibly."""
    least, aim, most = VISIBLE
    step = abs(float(y[j])) * 2.0**-26 or 2.0**-26
    for _ in range(MOST_DISPLACEMENTS):
        moved = y.copy()
        moved[j] += step
        change = abs(slopes(t, moved)[v] - force)
        ratio = float(np.max(change / noise, initial=0.0, where=noise > 0))
        if least <= ratio <= most:
            return np.where(change > least * noise, change / step, 0.0)
        step *= aim / ratio if 1 <= ratio < math.inf else aim if ratio < 1 else 1 / aim
    return np.zeros_like(force)


def _spectral_radius(matrix: FloatArray) -> float:
    """Return the largest absolute eigenvalue of a matrix (n, n), 0 if it has entries that are not finite."""
    if not matrix.any() or not np.isfinite(matrix).all():
        return 0.0
    return float(abs(np.linalg.eigvals(matrix)).max())
