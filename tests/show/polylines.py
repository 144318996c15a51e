"""Distance of curves from polylines, computed independently of the package."""

from __future__ import annotations

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

_NEIGHBOURS = 12
"""Chords on either side, by their number, that are compared with each point of a curve."""


def farthest(t: FloatArray, points: FloatArray, times: FloatArray, corners: FloatArray) -> float:
    """Return the largest distance from points (2, K) at times t (K,) to a polyline with corners (2, C) at times (C,).

    Only chords near the time of a point count, so the result may be too large, but never too small.
    """
    forward = 1.0 if times[-1] >= times[0] else -1.0
    place = np.searchsorted(forward * times, forward * t) - 1
    best = np.full(len(t), np.inf)
    for offset in range(-_NEIGHBOURS, _NEIGHBOURS + 1):
        chord = np.clip(place + offset, 0, len(times) - 2)
        begin, along = corners[:, chord], corners[:, chord + 1] - corners[:, chord]
        square = np.maximum(np.sum(along**2, axis=0), 1e-300)
        share = np.clip(np.sum((points - begin) * along, axis=0) / square, 0.0, 1.0)
        best = np.minimum(best, np.hypot(*(points - begin - share * along)))
    return float(best.max())
