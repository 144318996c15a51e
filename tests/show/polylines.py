"""Distance of curves from polylines, computed independently of the package."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from lagrange.trajectory.trajectory import FloatArray


def farthest(exact: FloatArray, lines: list[FloatArray]) -> float:
    """Return the largest distance in pixels from points (2, K) to polylines (2, C)."""
    placed = []
    for line in lines:
        begin, along = line[:, :-1], np.diff(line)
        length = np.nan_to_num(np.hypot(*along), nan=-1.0)
        parts = np.where(length < 0, 0, np.ceil(length / 0.25) + 1).astype(int)
        chord = np.repeat(np.arange(len(parts)), parts)
        part = np.arange(len(chord)) - np.repeat(np.cumsum(parts) - parts, parts)
        placed.append(begin[:, chord] + along[:, chord] * (part / np.maximum(parts[chord] - 1, 1)))
    tree = KDTree(np.concatenate(placed, axis=1).T)
    distance = np.asarray(tree.query(exact.T)[0])
    return float(distance.max())
