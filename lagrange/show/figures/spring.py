"""The shape of a spring between two points of the plane."""

from __future__ import annotations

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

TURNS = 8
"""Turns of a spring, whatever its length: it is seen to be stretched by how far they are apart."""

_STRAIGHT = 0.1
"""The part of the length that is straight, at each end."""


def spring(start: FloatArray, end: FloatArray, width: float) -> FloatArray:
    """Return the corners of a zigzag from start to end, (2, 2 TURNS + 3), `width` wide, in the units of the points.

    A spring of no length is a point.
    """
    along = np.concatenate([[0.0], np.linspace(_STRAIGHT, 1.0 - _STRAIGHT, 2 * TURNS + 1), [1.0]])
    aside = np.zeros_like(along)
    aside[2:-2:2], aside[3:-2:2] = 0.5, -0.5
    line = np.asarray(end, dtype=float) - start
    length = float(np.hypot(*line))
    normal = np.array([-line[1], line[0]]) / length if length > 0 else np.zeros(2)
    corners: FloatArray = np.asarray(start)[:, None] + line[:, None] * along + width * normal[:, None] * aside
    return corners
