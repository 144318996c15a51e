"""The scene of an animation: named points in the plane or in space, and their links, in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lagrange.show.animation.axis import Axis
from lagrange.show.animation.charts import Area
from lagrange.show.animation.sheet import DOT, FIRST, FIXED, GRID, INK, Joint, Mark, Stroke, Words
from lagrange.show.animation.space import floor_of, room_of
from lagrange.show.figures.paths import SLENDER, Box
from lagrange.show.figures.space import View, view_of
from lagrange.show.notation.names import plain_text
from lagrange.show.units import length_unit, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

_STILL = 1e-9
"""Movement, as a part of the picture, below which a point counts as fixed."""

_STRAIGHT = 1e-3
"""Width of a path, as a part of its length, below which it is a straight line, which its trail would hide."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A scene in pixels: its moving and its fixed parts."""

    tracks: FloatArray
    marks: tuple[Mark, ...]
    joints: tuple[Joint, ...]
    trails: tuple[tuple[int, int], ...]
    shadows: tuple[tuple[int, int], ...]
    strokes: tuple[Stroke, ...]
    words: tuple[Words, ...]

    @classmethod
    def empty(cls, samples: int) -> Placed:
        """Return the scene without points."""
        return cls(np.empty((0, 2, samples)), (), (), (), (), (), ())


@dataclass(frozen=True, eq=False)
class Scene:
    """Projected points, (P, 2, S), in space followed by their shadows; which of them move; and limits (2, 2)."""

    seen: FloatArray
    view: View
    box: Box | None
    """Box with the floor for the shadows of points in space."""
    moving: tuple[int, ...]
    names: tuple[str, ...]
    joints: tuple[Joint, ...]
    count: int
    limits: FloatArray
    to_scale: bool

    @property
    def ratio(self) -> float:
        """Best ratio of height to width."""
        width, height = np.ptp(self.limits, axis=1)
        return float(height / width) if self.to_scale else 0.6

    def placed(self, area: Area, statement: Statement) -> Placed:
        """Return the scene in an area of the picture."""
        u = area.unit
        level = not self.view.spatial
        left, right = area.left + (48 if level else 14) * u, area.left + area.width - 14 * u
        top, bottom = area.top, area.top + area.height - (34 if level else 8) * u
        across, up = self._axes(left, right, bottom, top)
        tracks = np.stack([across.place(self.seen[:, 0]), up.place(self.seen[:, 1])], axis=1)
        unit = length_unit(statement)
        if self.box is None:
            strokes, words = _grid(across, up, self.view, unit, u)
        else:
            strokes, words = floor_of(self.box, self.view, across, up, unit, u)
        colour = {track: FIRST + k for k, track in enumerate(self.moving)}
        marks = [Mark(k, colour.get(k, INK), DOT if k in colour else FIXED) for k in range(self.count)]
        trails = tuple((k, colour[k]) for k in self.moving if not _straight(tracks[k]))
        shadows = () if level else tuple((k, self.count + n) for n, k in enumerate(self.moving))
        ordered = sorted(marks, key=lambda mark: mark.kind == DOT)
        return Placed(tracks, tuple(ordered), self.joints, trails, shadows, tuple(strokes), tuple(words))

    def _axes(self, left: float, right: float, bottom: float, top: float) -> tuple[Axis, Axis]:
        """Return the axes of the picture; lengths are equal in both directions if the scene is to scale."""
        (x0, x1), (y0, y1) = self.limits
        if self.to_scale:
            per_pixel = max((x1 - x0) / (right - left), (y1 - y0) / (bottom - top))
            wide, high = per_pixel * (right - left) / 2, per_pixel * (bottom - top) / 2
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            x0, x1, y0, y1 = x - wide, x + wide, y - high, y + high
        return Axis(float(x0), float(x1), left, right), Axis(float(y0), float(y1), bottom, top)


def scene_of(points: Mapping[str, FloatArray], statement: Statement) -> Scene:
    """Return the projected scene of named points."""
    view = view_of(points)
    order = list(points)
    seen = np.stack([view.of(point) for point in points.values()])
    size = float(np.ptp(seen, axis=(0, 2)).max())
    moving = tuple(k for k in range(len(order)) if float(np.ptp(seen[k], axis=1).max()) > _STILL * size)
    together = np.concatenate(list(seen), axis=1)
    box = None
    if view.spatial:
        space = [np.vstack([point, np.zeros((3 - len(point), point.shape[1]))]) for point in points.values()]
        box = Box.around(np.concatenate(space, axis=1))
        fallen = [np.vstack([space[k][:2], np.full((1, seen.shape[2]), box.low[2])]) for k in moving]
        seen = np.concatenate([seen, *(view.of(point)[None] for point in fallen)])
        together = room_of(box, view, together)
    joints = tuple(Joint(order.index(link.start), order.index(link.end), link.kind) for link in statement.links)
    extents = np.ptp(together, axis=1)
    # With rods or springs the scene is to scale, even if the path is slender.
    slender = extents.min() > _STILL * extents.max() and extents.max() > SLENDER * extents.min()
    return Scene(
        seen,
        view,
        box,
        moving,
        tuple(plain_text(order[k]) for k in moving),
        joints,
        len(order),
        _limits(together, to_scale := not slender or bool(joints)),
        to_scale,
    )


def height_for(scene: Scene, width: float, u: float) -> float:
    """Return the height of an area of a given width in which the scene fits."""
    level = not scene.view.spatial
    return max(110 * u, scene.ratio * (width - (62 if level else 28) * u) + (34 if level else 8) * u)


def _limits(points: FloatArray, to_scale: bool) -> FloatArray:
    """Return limits around all points with room for marks, (2, 2)."""
    low, high = points.min(axis=1), points.max(axis=1)
    extents = high - low
    size = float(extents.max()) or 1.0
    room = 0.07 * (np.full(2, size) if to_scale else np.where(extents > 0, extents, size))
    return np.stack([low - room, high + room], axis=1)


def _straight(track: FloatArray) -> bool:
    """Return whether a track (2, S) is a straight line."""
    sizes = np.linalg.svd(track - track.mean(axis=1, keepdims=True), compute_uv=False)
    return bool(sizes[1] <= _STRAIGHT * sizes[0])


def _grid(across: Axis, up: Axis, view: View, unit: str, u: float) -> tuple[list[Stroke], list[Words]]:
    """Return pale lines at the ticks of a plane, with numbers and the names of the two directions."""
    strokes, words = [], []
    for value, label in across.ticks(round((across.end - across.start) / (80 * u))):
        x = float(across.place(value))
        strokes.append(Stroke(np.array([[x, x], [up.start, up.end]]), GRID, 0.7 * u))
        words.append(Words(label, x, up.start + 13 * u, 10 * u, "middle"))
    for value, label in up.ticks(round((up.start - up.end) / (50 * u))):
        y = float(up.place(value))
        strokes.append(Stroke(np.array([[across.start, across.end], [y, y]]), GRID, 0.7 * u))
        words.append(Words(label, across.start - 5 * u, y + 3.5 * u, 10 * u, "end"))
    words.append(Words(with_unit(view.labels[0], unit), across.end, up.start + 26 * u, 10 * u, "end"))
    words.append(Words(with_unit(view.labels[1], unit), across.start + 5 * u, up.end + 11 * u, 10 * u, "start"))
    return strokes, words
