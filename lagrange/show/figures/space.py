"""Projection of space to paper, and the shape of springs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

AZIMUTH, ELEVATION = -60.0, 25.0
"""Default direction of view for paths in space, in degrees."""

_STILL = 1e-9
"""Extent of points in a direction, relative to their largest extent, below which nothing moves in it."""


@dataclass(frozen=True, eq=False)
class View:
    """A projection: the matrix (2, d) maps points (d, K), d = 2 or 3, to coordinates to the right and up.

    `labels` are the names of the two directions; they are empty for a view from a side. In a view from a side `depth`
    (3,) maps points to their nearness; else `depth` is None. `extended` has True for each direction of the picture in
    which the points extend.
    """

    matrix: FloatArray
    labels: tuple[str, str]
    depth: FloatArray | None = None
    extended: tuple[bool, bool] = (True, True)

    @property
    def shape(self) -> str:
        """Shape of a panel: "row" or "column" if all points lie on one line, else "square"."""
        if self.extended[0] == self.extended[1]:
            return "square"
        return "row" if self.extended[0] else "column"

    @property
    def spatial(self) -> bool:
        """True for a view from a side, which shows three directions."""
        return self.depth is not None

    def of(self, points: FloatArray) -> FloatArray:
        """Return the projection (2, K) of points (d, K). In a view of space, points with two coordinates have z = 0."""
        return np.asarray(self.matrix[:, : len(points)] @ points)

    def nearness(self, points: FloatArray) -> FloatArray:
        """Return the nearness (K,) of points (d, K) to the viewer, in the units of the points; 0 in a plane."""
        return np.zeros(points.shape[1]) if self.depth is None else np.asarray(self.depth[: len(points)] @ points)


def view_of(points: Mapping[str, FloatArray]) -> View:
    """Return the view of named points, each (2, K) or (3, K) along a run.

    Points of a plane are not projected. Points of space that stay in a plane of two axes are viewed at right angles to
    it. Any other points are viewed from azimuth -60 and elevation 25 degrees, without perspective.
    """
    dimension = max(len(point) for point in points.values())
    full = [np.vstack([point, np.zeros((dimension - len(point), point.shape[1]))]) for point in points.values()]
    together = np.concatenate(full, axis=1)
    good = together[:, np.isfinite(together).all(axis=0)]
    extents = np.ptp(good, axis=1) if good.shape[1] else np.zeros(len(together))
    still = extents <= _STILL * max(float(extents.max()), 1e-300)
    if dimension == 2 or still.any():
        kept = np.array([0, 1]) if dimension == 2 else np.sort(np.argsort(-extents, kind="stable")[:2])
        right, up = (not still[k] for k in kept)
        return View(np.eye(dimension)[kept], ("xyz"[kept[0]], "xyz"[kept[1]]), None, (bool(right), bool(up)))
    return from_side(AZIMUTH, ELEVATION)


def from_side(azimuth: float, elevation: float) -> View:
    """Return the parallel projection of space for an azimuth and an elevation in degrees."""
    a, e = np.radians((azimuth, elevation))
    across = (-np.sin(a), np.cos(a), 0.0)
    up = (-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e))
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return View(np.array([across, up]), ("", ""), towards)


SPRING_TURNS = 8
"""Turns of a spring, whatever its length: their distance shows how far it is stretched."""

_STRAIGHT = 0.1
"""Part of the length that is straight, at each end."""


def spring(start: FloatArray, end: FloatArray, width: float) -> FloatArray:
    """Return the corners of a zigzag line from start to end, (2, 2 SPRING_TURNS + 3), in the units of the points.

    The zigzag is `width` wide. A spring of zero length is a point.
    """
    along = np.concatenate([[0.0], np.linspace(_STRAIGHT, 1.0 - _STRAIGHT, 2 * SPRING_TURNS + 1), [1.0]])
    aside = np.zeros_like(along)
    aside[2:-2:2], aside[3:-2:2] = 0.5, -0.5
    line = np.asarray(end, dtype=float) - start
    length = float(np.hypot(*line))
    normal = np.array([-line[1], line[0]]) / length if length > 0 else np.zeros(2)
    corners: FloatArray = np.asarray(start)[:, None] + line[:, None] * along + width * normal[:, None] * aside
    return corners
