"""Frames drawn with Matplotlib: fixed parts are drawn once, and moving parts over a copy of them."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lagrange.show.animation.sheet import DOT, GRID, PAPER, QUIET, Chart, Sheet, Words, palette
from lagrange.show.figures.new_figure import new_figure
from lagrange.show.figures.space import spring
from lagrange.show.figures.style import Style
from lagrange.statement.statement import SPRING
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Pixels = NDArray[np.uint8]
"""A frame, (height, width, 4): red, green, blue, and 255."""

FADES = 12
"""Parts of a trail with different opacities."""

SPRING_WIDTH, ROD, WIRE, TRAIL, MARK, SHADOW, THIN, CURVE = 14.0, 2.4, 1.4, 2.0, 7.0, 2.5, 1.2, 1.5
"""Widths of moving parts, in pixels at a picture width of 640; for marks and shadows the radius."""

_SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))

FAINT, CLEAR = 0.3, 0.85
"""Opacity of curves in the future, and of the newest part of a trail."""


class Canvas:
    """Draws frames of a sheet in a style.

    Matplotlib's artists take 0.1 ms each to create and to query; its renderer draws a path in a tenth of that.
    """

    def __init__(self, sheet: Sheet, style: Style) -> None:
        from matplotlib.colors import to_rgb
        from matplotlib.path import Path
        from matplotlib.transforms import Affine2D

        self.sheet = sheet
        self._path, self._affine = Path, Affine2D
        self._colours = [to_rgb(colour) for colour in palette(style, sheet.lines)]
        width, height = sheet.size
        self._figure = new_figure(figsize=(width / 72, height / 72), dpi=72, facecolor=style.paper)
        self._canvas = _agg(self._figure)
        self._canvas.draw()
        self._renderer = self._canvas.get_renderer()
        self._pixels = Affine2D().scale(1.0, -1.0).translate(0.0, height)
        self._shapes = {True: Path.unit_circle(), False: Path(_SQUARE, closed=True)}
        for stroke in sheet.strokes:
            self._line(stroke.colour, stroke.width, stroke.points, stroke.opacity)
        for chart in sheet.charts:
            places = _places(chart)
            for row, colour in zip(chart.rows, chart.colours, strict=True):
                self._line(colour, THIN * sheet.unit, np.array([places, row]), FAINT)
        for words in sheet.words:
            self._text(words, words.text)
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)

    def frame(self, number: int) -> Pixels:
        """Return a frame by its number. The next frame is drawn in the same memory."""
        self._canvas.restore_region(self._still)
        sheet, u = self.sheet, self.sheet.unit
        k = number * sheet.detail
        now = sheet.tracks[:, :, k]
        for point, below in sheet.shadows:
            self._line(GRID, 1.0 * u, now[[point, below]].T)
            self._dot(now[below], QUIET, SHADOW * u)
        for track, colour in sheet.trails:
            self._trail(track, colour, k)
        for joint in sheet.joints:
            ends = now[[joint.start, joint.end]].T
            wound = joint.kind == SPRING
            self._line(
                QUIET, (WIRE if wound else ROD) * u, spring(ends[:, 0], ends[:, 1], SPRING_WIDTH * u) if wound else ends
            )
        for mark in sheet.marks:
            self._dot(now[mark.track], mark.colour, (MARK if mark.kind == DOT else 0.6 * MARK) * u, mark.kind == DOT)
        for chart in sheet.charts:
            self._reveal(chart, k)
        t = sheet.span[0] + (sheet.span[1] - sheet.span[0]) * (number / max(1, sheet.frames - 1))
        self._text(sheet.clock, sheet.clock_text(t))
        drawn: Pixels = np.asarray(self._canvas.buffer_rgba())
        return drawn

    def _trail(self, track: int, colour: int, k: int) -> None:
        """Draw the path of the last samples; older parts are fainter."""
        sheet = self.sheet
        cuts = np.linspace(k - sheet.tail, k, FADES + 1).round().astype(int).clip(0)
        for part, (a, b) in enumerate(pairwise(cuts)):
            if b > a:
                points = sheet.tracks[track][:, a : b + 1]
                self._line(colour, TRAIL * sheet.unit, points, (part + 1) / FADES * CLEAR, cap="butt")

    def _reveal(self, chart: Chart, k: int) -> None:
        """Draw the curves of a panel up to now, a line at now, and a dot on each curve."""
        u = self.sheet.unit
        places = _places(chart)
        _, top, _, bottom = chart.box
        self._line(QUIET, 1.0 * u, np.array([[places[k], places[k]], [top, bottom]]))
        for row, colour in zip(chart.rows, chart.colours, strict=True):
            self._line(colour, CURVE * u, np.array([places[: k + 1], row[: k + 1]]))
            self._dot(np.array([places[k], row[k]]), colour, 3.2 * u)

    def _line(self, colour: int, width: float, points: FloatArray, opacity: float = 1.0, cap: str = "round") -> None:
        pen = self._pen(colour, width)
        pen.set_alpha(opacity)
        pen.set_capstyle(cap)
        self._renderer.draw_path(pen, self._path(points.T), self._pixels)

    def _dot(self, place: FloatArray, colour: int, radius: float, is_round: bool = True) -> None:
        where = self._affine().scale(radius).translate(*place) + self._pixels
        self._renderer.draw_path(
            self._pen(PAPER, self.sheet.unit), self._shapes[is_round], where, self._colours[colour]
        )

    def _pen(self, colour: int, width: float) -> Any:
        pen = self._renderer.new_gc()
        pen.set_foreground(self._colours[colour], isRGBA=False)
        pen.set_linewidth(width)
        pen.set_joinstyle("round")
        return pen

    def _text(self, words: Words, text: str) -> None:
        from matplotlib.text import Text

        written = Text(
            words.x,
            words.y,
            text,
            fontsize=words.size,
            color=self._colours[words.colour],
            fontweight="bold" if words.bold else "normal",
            ha={"start": "left", "middle": "center", "end": "right"}[words.anchor],
            va="baseline",
            parse_math=False,
            transform=self._pixels,
        )
        written.set_figure(self._figure)
        written.draw(self._renderer)


def _agg(figure: Figure) -> Any:
    """Return the canvas that draws pixels; Matplotlib has no type annotations for it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure)


def _places(chart: Chart) -> FloatArray:
    """Return the x pixel of every sample."""
    return np.linspace(chart.first, chart.last, chart.rows.shape[1])
