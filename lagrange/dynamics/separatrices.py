"""Separatrices: the motions that leave a saddle, and those that come to it, along its eigenvectors.

Near a saddle s the motion along an eigenvector w is s + d w up to an error of the second order in d. The distance d is
halved until the error of the start is below `LINEAR_ERROR` of the window. The component of the velocity along the
other eigenvector gives an estimate of this error.
Source: T. S. Parker, L. O. Chua, Practical Numerical Algorithms for Chaotic Systems, 1989, chapter 6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.dynamics.fixed_points import SADDLE, FixedPoint
from lagrange.dynamics.orbits import Orbit, Window, orbit_of, until_arrival
from lagrange.dynamics.runs import Runs
from lagrange.machine.backend import FloatArray
from lagrange.statement.event import Event

LINEAR_ERROR = 1e-10
"""Largest distance of a start from the separatrix, as a part of the window.

Rounding of the saddle itself is 1e-16 and grows along the motion: a smaller limit has no effect.
"""

FIRST_DISTANCE, LEAST_DISTANCE = 1e-2, 1e-7
"""First and least distance of a start from the saddle, as parts of the window."""


@dataclass(frozen=True, eq=False)
class Separatrix:
    """A branch of the stable or the unstable manifold of a saddle: an orbit that begins, or ends, close to it.

    `saddle` is the number of the saddle among the fixed points. `stable` is true if the motion approaches the saddle
    with increasing time. `distance` is that of its first point from the saddle, in the units of the state.
    """

    saddle: int
    stable: bool
    orbit: Orbit
    distance: float


def separatrices_of(
    runs: Runs, window: Window, places: Sequence[FixedPoint], number: int, exits: Sequence[Event]
) -> list[Separatrix]:
    """Return the four branches through a saddle: two along each eigenvector."""
    saddle = places[number]
    if saddle.kind != SADDLE or not window.holds(saddle.state):
        return []
    found = []
    for column in (0, 1):
        rate = float(saddle.eigenvalues[column].real)
        vector = saddle.eigenvectors[:, column].real / np.linalg.norm(
            saddle.eigenvectors[:, column].real / window.widths
        )
        for side in (1.0, -1.0):
            part = _distance(runs, saddle, column, side * vector, window)
            span = math.copysign(math.log(1.0 / part) / abs(rate) + window.reach, rate)
            run = runs(saddle.state + side * part * vector, 0.0, span, events=exits)
            run = until_arrival(window, run, places)
            length = float(np.linalg.norm(part * vector))
            found.append(Separatrix(number, rate < 0, orbit_of((run,), closed=False), length))
    return found


def _distance(runs: Runs, saddle: FixedPoint, column: int, vector: FloatArray, window: Window) -> float:
    """Return the distance from a saddle, as a part of the window, at which a motion on an eigenvector may begin."""
    rates, inverse = saddle.eigenvalues.real, np.linalg.inv(saddle.eigenvectors.real)
    part = FIRST_DISTANCE
    while part > LEAST_DISTANCE:
        slope = runs.model.rhs(0.0, saddle.state + part * vector, runs.parameters)
        aside = inverse @ slope
        # The term of order d**2 along the other eigenvector grows at twice the rate: aside = (2 rate - other rate) off.
        off = abs(aside[1 - column]) / abs(2 * rates[column] - rates[1 - column])
        size = off * np.linalg.norm(saddle.eigenvectors.real[:, 1 - column] / window.widths)
        if np.isfinite(size) and size <= LINEAR_ERROR:
            return part
        part /= 2
    return part
