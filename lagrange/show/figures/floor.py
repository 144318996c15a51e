"""The floor under paths in space: a grid with numbers, an upright axis, and the box in which all of it stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lagrange.show.figures.number_labels import number_labels
from lagrange.show.figures.space_view import View
from lagrange.show.figures.style import Style
from lagrange.show.units import with_unit
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEAST_SIDE = 0.25
"""The least side of the box relative to its largest: a floor that is thinner cannot be seen."""

_MARGIN = 0.06
_TICKS = 4
_STEPS = [1, 2, 2.5, 5, 10]

_NUMBERS, _NAMES = 9.0, 27.0
"""Points from an edge of the floor to its numbers, and to the name of its axis."""


@dataclass(frozen=True, eq=False)
class Box:
    """The box around points in space: its lowest and its highest corner, (3,) each."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def around(cls, points: FloatArray) -> Box:
        """Return the box around the finite points (3, K), a little larger, no side much shorter than the others.

        The floor is at the lowest point: what rolls on a plane z = 0 rolls on it.
        """
        good = points[:, np.isfinite(points).all(axis=0)]
        low, high = (good.min(axis=1), good.max(axis=1)) if good.shape[1] else (np.zeros(3), np.zeros(3))
        largest = float((high - low).max()) or 1.0
        grown = np.maximum(high - low, _LEAST_SIDE * largest) / 2 + _MARGIN * largest
        middle = (low + high) / 2
        middle[2] = low[2] + grown[2]
        return cls(middle - grown, middle + grown)

    @property
    def corners(self) -> FloatArray:
        """All corners, (3, 8)."""
        ends = np.array([self.low, self.high])
        return np.array([ends[list(np.unravel_index(k, (2, 2, 2))), range(3)] for k in range(8)]).T

    def ticks(self, axis: int) -> FloatArray:
        """Return round numbers between both ends of an axis, (k,)."""
        from matplotlib.ticker import MaxNLocator

        low, high = float(self.low[axis]), float(self.high[axis])
        found = np.asarray(MaxNLocator(_TICKS, steps=_STEPS).tick_values(low, high))
        return found[(found >= low) & (found <= high)]


def draw_floor(axis: Axes, view: View, box: Box, unit: str, style: Style) -> None:
    """Draw the floor at the lowest z of a box, with numbers at its front edges, and the z axis at its left corner.

    The view is from an azimuth between -90 and 0 degrees, from above.
    """
    (x0, y0, z0), (x1, y1, z1) = box.low, box.high
    for k, (begin, end) in enumerate((((0, y0), (0, y1)), ((x0, 0), (x1, 0)))):
        for place in box.ticks(k):
            line = np.array([(place, begin[1]), (place, end[1])] if k == 0 else [(begin[0], place), (end[0], place)])
            _line(axis, view, np.column_stack([line, [z0, z0]]), style.grid, 0.8)
    edge = np.array([(x0, y1, z0), (x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)])
    _line(axis, view, edge, style.quiet, 0.7)
    _line(axis, view, np.array([(x0, y0, z0), (x0, y0, z1)]), style.quiet, 0.7)
    for k, foot in enumerate(((None, y0, z0), (x1, None, z0), (x0, y0, None))):
        _numbers(axis, view, box, k, foot, unit, style)
    seen = view.of(box.corners)
    low, high = seen.min(axis=1), seen.max(axis=1)
    axis.update_datalim([low - 0.12 * (high - low), high + 0.04 * (high - low)])
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def _line(axis: Axes, view: View, points: FloatArray, colour: str, width: float) -> None:
    axis.plot(*view.of(points.T), color=colour, linewidth=width, zorder=0.5, solid_capstyle="round")


def _numbers(axis: Axes, view: View, box: Box, k: int, foot: tuple[float | None, ...], unit: str, style: Style) -> None:
    """Write the numbers and the name of one axis of space outside of its edge."""
    ticks = box.ticks(k)
    outwards = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0)][k]) if k < 2 else np.zeros(3)
    away = view.of(outwards[:, None])[:, 0] if k < 2 else np.array([-1.0, 0.0])
    away = away / np.hypot(*away)
    texts = [*number_labels(ticks.tolist()), with_unit("xyz"[k], unit)]
    middle = (box.low[k] + box.high[k]) / 2
    for text, place in zip(texts, [*ticks.tolist(), middle if k < 2 else box.high[k]], strict=True):
        named = text is texts[-1]
        at = view.of(np.array([[place if part is None else part] for part in foot]))[:, 0]
        offset = (_NAMES if named and k < 2 else _NUMBERS) * away + (0.0, 8.0 * (named and k == 2))
        written = axis.annotate(
            text,
            (float(at[0]), float(at[1])),
            (float(offset[0]), float(offset[1])),
            textcoords="offset points",
            ha="right" if k == 2 else "center",
            va="center",
            fontsize=9 if named else 8,
            color=style.ink,
        )
        written.set_in_layout(False)  # the limits of the panel leave room for it
