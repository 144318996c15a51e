"""The floor under points in space: lines at round numbers, numbers at its front edges, and an upright axis."""

from __future__ import annotations

import numpy as np

from lagrange.show.animation.axis import Axis
from lagrange.show.animation.sheet import GRID, QUIET, Stroke, Words
from lagrange.show.figures.paths import Box
from lagrange.show.figures.space import View
from lagrange.show.figures.style import number_labels
from lagrange.show.units import with_unit
from lagrange.trajectory.trajectory import FloatArray

_BESIDE = 0.08
"""Room beside and below the box for its numbers, relative to its size in the picture."""

_NUMBERS, _NAMES = 13.0, 32.0
"""Distance in pixels from an edge of the floor to its numbers, and to the name of its axis."""


def room_of(box: Box, view: View, points: FloatArray) -> FloatArray:
    """Return corners in the picture, (2, 2), that enclose points (2, K), the floor and its numbers."""
    x, y, z = (np.array([box.low[k], box.high[k]]) for k in range(3))
    floor = np.array([x[[0, 0, 1, 1]], y[[0, 1, 0, 1]], z[[0, 0, 0, 0]]])
    upright = np.array([x[:1], y[:1], z[1:]])
    seen = np.concatenate([points, view.of(floor), view.of(upright)], axis=1)
    low, high = seen.min(axis=1), seen.max(axis=1)
    return np.stack([low - _BESIDE * (high - low), high], axis=1)


def floor_of(box: Box, view: View, across: Axis, up: Axis, unit: str, u: float) -> tuple[list[Stroke], list[Words]]:
    """Return the floor of a box with its numbers, and the z axis at its left corner, as in figures."""

    def seen(*places: tuple[float, float, float]) -> FloatArray:
        right, above = view.of(np.array(places, dtype=float).T)
        return np.array([across.place(right), up.place(above)])

    (x0, y0, z0), (x1, y1, z1) = box.low.tolist(), box.high.tolist()
    strokes = [Stroke(seen((x, y0, z0), (x, y1, z0)), GRID, 0.8 * u) for x in box.ticks(0)]
    strokes += [Stroke(seen((x0, y, z0), (x1, y, z0)), GRID, 0.8 * u) for y in box.ticks(1)]
    edge = seen((x0, y1, z0), (x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0))
    strokes += [Stroke(edge, QUIET, 0.8 * u), Stroke(seen((x0, y0, z0), (x0, y0, z1)), QUIET, 0.8 * u)]
    words = []
    for k, foot, outwards in ((0, (None, y0, z0), (0.0, -1.0, 0.0)), (1, (x1, None, z0), (1.0, 0.0, 0.0))):
        away = np.diff(seen((0.0, 0.0, 0.0), outwards), axis=1)[:, 0]
        away /= np.hypot(*away)
        middle = float(box.low[k] + box.high[k]) / 2
        ticks = box.ticks(k).tolist()
        texts = [*number_labels(ticks), with_unit("xyz"[k], unit)]
        for n, (place, text) in enumerate(zip([*ticks, middle], texts, strict=True)):
            at = seen(tuple(place if part is None else part for part in foot))[:, 0]
            x, y = at + (_NAMES if n == len(ticks) else _NUMBERS) * u * away
            words.append(Words(text, float(x), float(y) + 3.5 * u, 10 * u, "middle"))
    ticks = box.ticks(2).tolist()
    for place, text in zip(ticks, number_labels(ticks), strict=True):
        x, y = seen((x0, y0, place))[:, 0]
        words.append(Words(text, float(x) - 5 * u, float(y) + 3.5 * u, 10 * u, "end"))
    x, y = seen((x0, y0, z1))[:, 0]
    return strokes, [*words, Words(with_unit("z", unit), float(x), float(y) - 6 * u, 10 * u, "middle")]
