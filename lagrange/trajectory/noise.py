"""Floors of the tolerances at the rounding noise of each entry of a state.

An entry that is only the rounding of larger terms has nothing that steps could follow. Its floor is what rounding adds
to it in the natural time of the motion: the reciprocal of the fastest rate of the equations, linearized at the state.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from lagrange.equations.state_layout import StateLayout
from lagrange.machine.kernel.rounding_noise import UNIT, rounding_noise
from lagrange.machine.model import Model
from lagrange.procedure.step.constants import SMALL_FLOOR
from lagrange.trajectory.sizes import Slopes, slopes_of
from lagrange.trajectory.trajectory import FloatArray

NOISE_MULTIPLE = 4.0
"""Floors are this multiple of the rounding noise of an entry. With 16 a chain of ten links loses a digit at 1e-12."""

TINY = 1e-300
"""Added to the noise of an acceleration, which may be zero."""

VISIBLE = 2.0**8, 2.0**24, 2.0**40
"""Change of an acceleration by a displacement, in multiples of its noise: the least, the aim, and the largest.

A smaller change has no digits. A larger one may not be linear, unless a shorter displacement gives the same derivative.
"""

MOST_DISPLACEMENTS = 8
"""Most displacements of one entry that are tried; its derivatives are zero if none is visible and linear."""

AHEAD, EULER_STEPS = 1 / 8, 2
"""The noise is also evaluated ahead: after this number of Euler steps of this part of the natural time.

Terms that vanish at the start, as of a chain that hangs at rest, have noise as soon as it moves.
"""


def some_rounded(layout: StateLayout, floors: FloatArray) -> bool:
    """Return whether an entry may be rounding: its floor (2n,) is far below the largest of its kind."""
    return any(bool(half.min(initial=np.inf) < SMALL_FLOOR * half.max(initial=0.0)) for half in layout.split(floors))


def noise_floors(model: Model, parameters: FloatArray, t: float, y: FloatArray, left: float) -> FloatArray:
    """Return a multiple of the rounding noise of each entry (2n,), 0 where it is not known.

    The noise of a velocity is that of its acceleration over the natural time of the motion, at most the time `left`;
    that of a coordinate is half of the same over that time once more. It is not known where the mass matrix is
    singular.
    """
    layout, law = model.layout, slopes_of(model, parameters)
    with np.errstate(all="ignore"):
        noise = _noise(model, parameters, t, y)
        rate = _fastest_rate(law, layout, t, y, noise)
        time = min(abs(left), 1 / rate) if rate > 0 else abs(left)
        step, ahead = math.copysign(AHEAD * time, left), y
        for _ in range(EULER_STEPS if rate > 0 else 0):
            ahead = ahead + step * law(t, ahead)
        noise = np.fmax(noise, _noise(model, parameters, t, ahead))
        floors = NOISE_MULTIPLE * np.concatenate([noise * time * time / 2, noise * time])
    return np.nan_to_num(floors, posinf=0.0)


def _noise(model: Model, parameters: FloatArray, t: float, y: FloatArray) -> FloatArray:
    """Return the rounding noise of accelerations (n,) at a state (2n,)."""
    return rounding_noise(model.interpreted("rhs").program, t, y, parameters)[model.layout.v]


def _fastest_rate(slopes: Slopes, layout: StateLayout, t: float, y: FloatArray, noise: FloatArray) -> float:
    """Return the largest rate of the equations linearized at a state (2n,), 0 if nothing responds to displacements.

    It is a spectral radius: it does not depend on the units of the entries. `noise` (n,) is that of accelerations.
    """

    def accelerations(state: FloatArray) -> FloatArray:
        return slopes(t, state)[layout.v]

    force = accelerations(y)
    columns = np.array([_derivatives(accelerations, y, j, force, noise) for j in range(len(y))]).T
    stiffness, damping = (_spectral_radius(part) for part in (columns[:, layout.q], columns[:, layout.v]))
    return max(math.sqrt(stiffness), damping)


def _derivatives(
    accelerations: Callable[[FloatArray], FloatArray], y: FloatArray, j: int, force: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the derivatives (n,) of accelerations by entry j, 0 if no displacement shows them.

    `force` (n,) are the accelerations at the state y (2n,), and `noise` (n,) is theirs.
    """
    least, aim, most = VISIBLE
    step, before = abs(float(y[j])) * 2.0**-26 or 2.0**-26, np.full_like(force, np.inf)
    for _ in range(MOST_DISPLACEMENTS):
        moved = y.copy()
        moved[j] += step
        there = accelerations(moved)
        change, doubt = abs(there - force), noise + UNIT * abs(there) + TINY
        ratio = float(np.max(change / doubt))
        found = np.where(change > least * doubt, change / step, 0.0)
        linear = ratio <= most or float(abs(found - before).max()) <= float(found.max()) / 2
        if ratio >= least and linear:
            return found
        before = found
        step *= aim if ratio < 1 else aim / ratio if ratio < math.inf else 1 / aim
    return np.zeros_like(force)


def _spectral_radius(matrix: FloatArray) -> float:
    """Return the largest absolute eigenvalue of a matrix (n, n), 0 if it has entries that are not finite."""
    if not matrix.any() or not np.isfinite(matrix).all():
        return 0.0
    return float(abs(np.linalg.eigvals(matrix)).max())
