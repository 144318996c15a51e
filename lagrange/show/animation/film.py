"""Draw the frames of an animation with Matplotlib: layout, colours, moving points with trails, and curves over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, log10
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError, shown
from lagrange.show.animation.recording import Recording, Timing
from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.curve import around
from lagrange.show.figures.panel import label_of_entry
from lagrange.show.figures.paths import Box, draw_floor, is_slender, spring, view_of
from lagrange.show.figures.style import (
    NAMED_POINTS,
    FigureStyle,
    colours,
    dress,
    few_ticks,
    legend,
    new_figure,
    of_figure,
    point_look,
    with_unit,
)
from lagrange.show.notation.text import plain_text
from lagrange.statement.expression import real_number, whole_number
from lagrange.statement.statement import EDGE, SPRING, corners, energy_unit, length_unit, unit_of
from lagrange.trajectory.measures.times_and_points import moving_points
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Pixels = NDArray[np.uint8]
"""A frame as an array (height, width, 4) of bytes: red, green, blue, and opacity 255."""

PICTURE_WIDTH, TALLEST = 640, 400
"""Default width of a picture in pixels, and largest default height of its panel of moving points in typographic
points."""

LEAST_SIZE, MOST_SIZE = 160, 2160
"""Least and largest side that users may request, in pixels. Smaller pictures are not readable; in larger ones a frame
takes over 18 MB."""

SMALLEST_SCALE = 0.85  # Least scale factor of fonts and lines: letters below 8.5 pixels are hard to read
TRAIL_SECONDS = 2.5  # Default duration of a trail, in seconds on the screen
FADES = 12  # Parts of a trail with different opacities

FAINT, CLEAR = 0.3, 0.85
"""Opacity of the part of a curve after the time of the frame, and opacity of the newest part of a trail."""

_DOT, _COIL = 14.0, 14.0  # Widths in points: of the dot of a moving point, and of the zigzag of a spring

MOST_PANELS = 6
"""Largest number of panels for coordinates, for which a frame has room. With more coordinates several share a panel."""

_HEADER, _NAMES, _CHART, _TITLE, _TIME = 32.0, 18.0, 88.0, 20.0, 32.0
"""Heights in points: of the header, the names of points, a panel over time with its title, the title, and the labels
of the time axis."""

_LEFT, _RIGHT, _UNDER = 56.0, 16.0, 36.0
"""Margins in points: to the left and right of a panel, and below the panel of moving points for its axis numbers."""

_TALL, _LEAST = 1.7, 60.0
"""Ratio of height to width of the panel of moving points above which the other panels are beside it and not below it,
and least height of this panel in points."""


def checked_options(size: Any, trail: Any) -> tuple[tuple[int, int] | None, float | None]:
    """Return the arguments `size` and `trail` of a `Film`, or None for those that the user leaves out.

    Raises StatementError for an invalid `size` or `trail`.
    """
    if size is not None:
        if not isinstance(size, (tuple, list)) or len(size) != 2:
            raise StatementError(f"size = {shown(size)}: give width and height in pixels, such as size=(640, 480).")
        width, height = (whole_number(side, "a side of size", LEAST_SIZE, MOST_SIZE) for side in size)
        size = width, height
    if trail is not None and (trail := real_number(trail, "trail")) < 0:
        raise StatementError(f"trail = {trail:g}: give the time that trails go back, or 0 for none.")
    return size, trail


@dataclass(frozen=True, eq=False)
class Rows:
    """R curves with S samples for one panel over time: `rows` (R, S), with their labels and colours.

    `title` is the title of the panel, with the unit. A curve is drawn as a level line if its changes are rounding noise
    relative to `size` or to its largest value.
    """

    title: str
    rows: FloatArray
    labels: tuple[str, ...]
    colours: tuple[str, ...]
    size: float = 0.0


def panels_of(recording: Recording, style: FigureStyle) -> list[Rows]:
    """Return the panels over time for a recording: the energies and, if no points are named, the coordinates."""
    panels, statement = list[Rows](), recording.statement
    names = () if recording.points else statement.names
    per_panel = max(1, ceil(len(names) / MOST_PANELS))
    for begin in range(0, len(names), per_panel):
        labels = tuple(label_of_entry(statement, name) for name in names[begin : begin + per_panel])
        title = labels[0] if len(labels) == 1 else f"{labels[0]} to {labels[-1]}"
        shades = colours(len(names), style.colours)[begin : begin + per_panel]
        panels.append(Rows(title, recording.states[begin : begin + len(labels)], labels, shades))
    if recording.energies:
        count, zero, letter = len(recording.energies), recording.zero, recording.energy_letter
        shades = (style.ink,) if count == 1 else (*colours(2, style.colours), style.ink)
        title = "energy" if count == 1 else f"energies, V and {letter} above the least V" if zero else "energies"
        rows = np.array([row if name == "T" else row - zero for name, row in recording.energies.items()])
        labels = tuple(f"${letter if name == 'E' else name}$" for name in recording.energies)
        title = with_unit(title, energy_unit(statement))
        panels.append(Rows(title, rows, labels, shades, recording.energy_size))
    return panels


class Film:
    """Draws the frames of a recording as pixels.

    `timing` has the times of the frames, and `style` the colours. `size` is the width and height in pixels; with None
    the picture fits the motion. A trail is the path of a point before the time of the frame. `trail` is its duration in
    the time of the run; with None the duration is `TRAIL_SECONDS` on the screen. The first frame takes longer, because
    the fixed parts are drawn with it.
    """

    def __init__(
        self,
        recording: Recording,
        timing: Timing,
        style: FigureStyle,
        size: tuple[int, int] | None = None,
        trail: float | None = None,
    ) -> None:
        self.recording, self.timing, self.style = recording, timing, style
        self.panels = panels_of(recording, style)
        self.trail_seconds = TRAIL_SECONDS if trail is None else trail / timing.speed
        self.scene = MovingScene(recording, self.trail_seconds * timing.speed, style) if recording.points else None
        self.plan = _plan(self.scene, len(self.panels), size)
        step = abs(float(timing.t[-1] - timing.t[0])) / max(1, len(timing.t) - 1)
        self.decimals = min(12, max(0, ceil(-log10(step)))) if step > 0 else 3

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in pixels."""
        return self.plan.size

    @cached_property
    def _drawn(self) -> _FilmFigure:
        return _FilmFigure(self)

    @property
    def frames(self) -> int:
        """Number of frames of the film."""
        return len(self.timing.t)

    def frame(self, number: int) -> Pixels:
        """Draw frame `number` and return its pixels. The next frame overwrites this array."""
        t = float(self.timing.t[number])
        text = f"{t:.{self.decimals}f}"
        text = text if float(text) else text.replace("-", "")
        unit = unit_of(self.recording.statement, "t")
        return self._drawn.at(number * self.recording.detail, f"t = {text.replace('-', '−')} {unit}".rstrip())

    @property
    def palette(self) -> tuple[str, ...]:
        """All colours of the picture as #rrggbb, the background first."""
        style, shades = self.style, [colour for part in (self.scene, *self.panels) if part for colour in part.colours]
        return (*dict.fromkeys((style.paper, style.ink, style.quiet, style.grid, *shades)),)


class _FilmFigure:
    """Matplotlib figure of a film: the pixels of its fixed parts, which are drawn once, and the moving parts."""

    def __init__(self, film: Film) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        plan, recording, style = film.plan, film.recording, film.style
        dots = 72 * plan.scale
        self.figure = new_figure(figsize=[side / dots for side in plan.size], dpi=dots, facecolor=style.paper)
        canvas: Any = FigureCanvasAgg(self.figure)
        self.header(film)
        moving: list[tuple[MovingScene | MovingChart, Axes]] = []
        if film.scene is not None:
            axis = self.figure.add_axes(plan.scene)
            film.scene.place(axis)
            moving.append((film.scene, axis))
        for index, (rows, box) in enumerate(zip(film.panels, plan.charts, strict=True)):
            axis = self.figure.add_axes(box)
            moving.append((MovingChart(axis, recording, rows, style, named=index == len(film.panels) - 1), axis))
        canvas.draw()
        self.renderer = canvas.get_renderer()
        self.moving = [(part, Pen(self.renderer, axis, style.paper)) for part, axis in moving]
        self.pixels: Pixels = np.asarray(canvas.buffer_rgba())
        self.still = self.pixels.copy()
        self.charts = [part for part, _ in moving if isinstance(part, MovingChart)]

    @cached_property
    def clear(self) -> Pixels:
        """Pixels of the fixed parts, with all curves opaque over their whole length.

        Each frame copies from these pixels the part of each curve up to the time of the frame.
        """
        self.pixels[...] = self.still
        for chart in self.charts:
            for line in chart.clear:
                line.draw(self.renderer)
        return self.pixels.copy()

    def header(self, film: Film) -> None:
        """Write the name of the system, and the speed of `film` if it differs from real time; create the clock text."""
        style, (width, height) = film.style, film.size
        across, top = width / film.plan.scale, height / film.plan.scale - 20

        def write(x: float, y: float, text: str, colour: str, **more: Any) -> Any:
            more |= {"transform": self.figure.dpi_scale_trans, "parse_math": False}
            return self.figure.text(x / 72, y / 72, text, color=colour, **more)

        write(14, top, plain_text(film.recording.statement.name), style.ink, fontsize=13, fontweight="bold")
        right: dict[str, Any] = {"ha": "right", "fontsize": 13}
        self.clock = write(across - _RIGHT, top, "", style.ink, animated=True, **right)
        if film.timing.speed != 1.0:
            write(across - _RIGHT, top - 15, f"speed {film.timing.speed:g}×", style.quiet, ha="right", fontsize=10)
        if film.scene is None:
            write(14, top - 15, "coordinates; no positions are stated", style.quiet, fontsize=10)

    def at(self, k: int, clock: str) -> Pixels:
        """Draw the picture at sample number `k` of the recording, with the time as text `clock`; return its pixels."""
        clear = self.clear if k else self.still
        self.pixels[...] = self.still
        for chart in self.charts:
            part = chart.past(k, len(self.pixels))
            self.pixels[part] = clear[part]
        for moving, pen in self.moving:
            moving.draw(k, pen)
        self.clock.set_text(clock)
        self.clock.draw(self.renderer)
        return self.pixels


@dataclass(frozen=True)
class _Plan:
    """Layout of a picture: its `size` in pixels, and the rectangles of its panels.

    `scene` is the rectangle of the panel of moving points, and `charts` are those of the panels over time. A rectangle
    is (left, bottom, width, height), as fractions of the picture. `scale` is a factor for the sizes of fonts and lines.
    """

    size: tuple[int, int]
    scale: float
    scene: tuple[float, float, float, float]
    charts: list[tuple[float, float, float, float]]


def _plan(scene: MovingScene | None, count: int, size: tuple[int, int] | None) -> _Plan:
    """Return the layout of a picture: the panel of moving points `scene`, or no such panel if None, and `count` others.

    Panels are below one another; if the panel of points is tall, the others are beside it. `size` is the requested
    width and height in pixels, or None. Raises StatementError if the size is too small.
    """
    width = size[0] if size else PICTURE_WIDTH
    scale = max(SMALLEST_SCALE, width / PICTURE_WIDTH)
    across = width / scale
    top = _HEADER + (_NAMES if scene is not None and scene.named else 0.0) + (14.0 if scene is None else 0.0)
    strip = count * _CHART + _TIME if count else 8.0
    side_by_side = scene is not None and count > 0 and scene.ratio > _TALL
    under = 0.0 if scene is None else _UNDER if scene.box is None else 4.0
    below = (0.0 if side_by_side else strip) + under
    free = 0.0
    if scene is not None:
        free = max(110.0, min(TALLEST, scene.ratio * (across - _LEFT - _RIGHT)))
    height = size[1] if size else 2 * ceil(scale * (top + free + below) / 2)
    down = height / scale
    if scene is not None:
        free = down - top - below
    if down < top + below + (_LEAST if scene is not None else 0.0):
        least = ceil(scale * (top + below + _LEAST))
        raise StatementError(
            f"size = ({width}, {height}) leaves no room for the motion: give a height of {least} or more."
        )
    border = across
    if scene is not None and side_by_side:
        border = max(0.34 * across, min(0.6 * across, free / scene.ratio + _LEFT + _RIGHT))
    left = _LEFT if scene is None or scene.box is None else _RIGHT

    def part(x: float, y: float, wide: float, high: float) -> tuple[float, float, float, float]:
        """Return a rectangle as fractions of the picture. `x` and `y` are its distances from the left and top edges.

        `wide` and `high` are its width and height; all lengths are in points.
        """
        return x / across, 1 - (y + high) / down, wide / across, high / down

    start, first = (border, top) if side_by_side else (0.0, top + free + under)
    panel_height = (down - first - _TIME) / max(count, 1)
    charts = [
        part(
            start + _LEFT, first + k * panel_height + _TITLE, across - start - _LEFT - _RIGHT, panel_height - _TITLE - 4
        )
        for k in range(count)
    ]
    return _Plan((width, height), scale, part(left, top, border - left - _RIGHT, max(free, 1.0)), charts)


class MovingScene:
    """Panel of an animation with the moving named points, their links, and trails of the duration `trail`."""

    def __init__(self, recording: Recording, trail: float, style: FigureStyle) -> None:
        self.recording, self.style = recording, style
        statement, points = recording.statement, recording.points
        self.view = view_of(points)
        self.names = [*points]
        self.seen = np.stack([self.view.of(point) for point in points.values()])
        self.surfaces = [[self.names.index(name) for name in line] for line in statement.outlines.values()]
        self.moving = [self.names.index(name) for name in moving_points(statement)]
        hidden = corners(statement.links).union(*statement.outlines.values())
        shown = [k for k, name in enumerate(self.names) if name not in hidden]
        self.fixed = [k for k in shown if k not in self.moving]
        self.colours, self.part = point_look(len(self.moving), style.colours)
        self.named = 1 < len(self.moving) <= NAMED_POINTS
        self.box = self.shadows = None
        if self.view.spatial:
            space = [np.vstack([point, np.zeros((3 - len(point), point.shape[1]))]) for point in points.values()]
            self.box = Box.around(np.concatenate(space, axis=1))
            flat = [np.vstack([space[k][:2], np.full((1, self.seen.shape[2]), self.box.low[2])]) for k in self.moving]
            self.shadows = np.stack([self.view.of(point) for point in flat]) if flat else None
        together = np.concatenate([*self.seen], axis=1)
        if self.box is not None:
            together = np.concatenate([together, self.view.of(self.box.drawn)], axis=1)
        sides = np.ptp(together, axis=1)
        # With rods, springs or surfaces the scene is to scale, even if the path is slender.
        self.to_scale = bool(statement.links or self.surfaces) or not is_slender(sides)
        room = 0.07 * float(sides.max()) or 1.0
        self.limits = np.array(
            [(row.min() - room, row.max() + room) if self.to_scale else around(row) for row in together]
        )
        step = abs(float(recording.t[-1] - recording.t[0])) / max(1, len(recording.t) - 1)
        self.tail = round(min(trail / step, len(recording.t))) if step > 0 else 0

    @property
    def ratio(self) -> float:
        """Ratio of height to width with which the panel of moving points has no empty border."""
        width, height = np.ptp(self.limits, axis=1)
        return float(height / width) if self.to_scale else 0.6

    def place(self, axis: Axes) -> None:
        """Draw the fixed parts of the panel `axis`: frame, labels, legend and floor. Set the width of springs."""
        style, unit = self.style, length_unit(self.recording.statement)
        dress(axis, style)
        window = axis.get_window_extent()
        limits = self.limits
        if self.to_scale:
            sides = np.array([window.width, window.height])
            half = sides * float((np.ptp(limits, axis=1) / sides).max()) / 2
            limits = limits.mean(axis=1)[:, None] + np.outer(half, (-1.0, 1.0))
        if self.box is None:
            axis.set_xlabel(with_unit(self.view.labels[0], unit), labelpad=1.0)
            axis.set_ylabel(with_unit(self.view.labels[1], unit), labelpad=4.0)
        else:
            draw_floor(axis, self.view, self.box, unit, style)
        axis.set(xlim=tuple(limits[0]), ylim=tuple(limits[1]))
        if self.box is None:
            few_ticks(axis)
            axis.locator_params(axis="y", nbins=6)
        self.spring_width = _COIL * float(np.ptp(limits[0])) / (window.width * 72 / of_figure(axis).dpi)
        if self.named:
            for k, colour in zip(self.moving, self.colours, strict=True):
                axis.plot([], [], "o", color=colour, markersize=7, label=plain_text(self.names[k]))
            legend(axis, style)

    def draw(self, k: int, pen: Pen) -> None:
        """Draw with `pen` the points, links, surfaces and trails at sample number `k`."""
        now, style = self.seen[:, :, k], self.style
        if self.shadows is not None:
            below = self.shadows[:, :, k]
            for ends in zip(now[self.moving], below, strict=True):
                pen.line(np.array(ends).T, style.grid, widths.MARK)
            pen.marks(below.T, style.quiet, 5.0)
        if self.tail:
            cuts = np.linspace(k - self.tail, k, FADES + 1).round().astype(int).clip(0)
            for point, colour in zip(self.moving, self.colours, strict=True):
                for part, (a, b) in enumerate(pairwise(cuts.tolist())):
                    if b > a:
                        opacity = (part + 1) / FADES * CLEAR
                        pen.line(self.seen[point][:, a : b + 1], colour, widths.TRAIL, opacity, cap="butt")
        for surface in self.surfaces:
            pen.line(now[surface].T, style.ink, widths.MOVING_SURFACE)
        positions = {name: now[k] for k, name in enumerate(self.names)}
        for start, end, kind in self.recording.statement.links:
            if kind == SPRING:
                line = spring(positions[start], positions[end], self.spring_width)
                pen.line(line, style.quiet, widths.MOVING_SPRING)
            else:
                width = widths.MOVING_EDGE if kind == EDGE else widths.MOVING_ROD
                pen.line(np.array([positions[start], positions[end]]).T, style.quiet, width)
        pen.marks(now[self.fixed].T, style.ink, 8.5, "s")
        if self.named:
            for point, colour in zip(self.moving, self.colours, strict=True):
                pen.marks(now[[point]].T, colour, _DOT)
        elif self.moving:
            pen.marks(now[self.moving].T, self.colours[0], _DOT * self.part)


class Pen:
    """Draws lines and marks in a panel directly with Matplotlib's renderer, ten times as fast as with artists.

    `paper` is the colour of the background.
    """

    def __init__(self, renderer: Any, axis: Axes, paper: str) -> None:
        from matplotlib.colors import to_rgb
        from matplotlib.path import Path
        from matplotlib.transforms import Affine2D

        self._renderer, self._place, self._paper = renderer, axis.transData.frozen(), paper
        self._path, self._affine, self._rgb = Path, Affine2D, to_rgb
        corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)]
        self._shapes = {"o": Path.circle(radius=0.5), "s": Path(corners, closed=True)}
        self._point = renderer.points_to_pixels(1.0)

    def _context(self, colour: str, width: float) -> Any:
        context = self._renderer.new_gc()
        context.set_foreground(self._rgb(colour), isRGBA=False)
        context.set_linewidth(width * self._point)
        context.set_joinstyle("round")
        return context

    def line(self, points: FloatArray, colour: str, width: float, opacity: float = 1.0, cap: str = "round") -> None:
        """Draw a line through the positions `points` (2, K) in a colour, with a width in typographic points.

        `opacity` is 1 for an opaque line, and `cap` is the shape of its ends in Matplotlib.
        """
        context = self._context(colour, width)
        context.set_alpha(opacity)
        context.set_capstyle(cap)
        self._renderer.draw_path(context, self._path(points.T), self._place)

    def marks(self, points: FloatArray, colour: str, size: float, shape: str = "o") -> None:
        """Draw circles, or squares for the shape "s", at the positions `points` (2, K).

        `size` is their width in typographic points. Their edges have the colour of the background.
        """
        if points.shape[1]:
            size *= self._point
            context, mark, where = self._context(self._paper, 1.0), self._shapes[shape], self._path(points.T)
            self._renderer.draw_markers(
                context, mark, self._affine().scale(size), where, self._place, self._rgb(colour)
            )


class MovingChart:
    """Curves over time in one panel of an animation. If `named`, the time axis has numbers and a name.

    In each frame a curve is opaque up to the time of the frame, pale after it, and has a dot at that time.
    """

    def __init__(self, axis: Axes, recording: Recording, rows: Rows, style: FigureStyle, *, named: bool) -> None:
        self.axis, self.t, self.rows, self.style = axis, recording.t, rows, style
        dress(axis, style)
        first, last = float(self.t[0]), float(self.t[-1])
        axis.set_xlim(*((min(first, last), max(first, last)) if first != last else (first - 0.5, first + 0.5)))
        axis.set_ylim(*around(rows.rows, rows.size))
        few_ticks(axis)
        axis.locator_params(axis="y", nbins=3)
        self.clear: list[Any] = []
        several = 1 < len(rows.rows) <= NAMED_POINTS
        for row, label, colour in zip(rows.rows, rows.labels, rows.colours, strict=True):
            axis.plot(self.t, row, color=colour, linewidth=widths.COMING_CURVE, alpha=FAINT)
            name = label if several else "_nolegend_"
            self.clear += axis.plot(self.t, row, color=colour, linewidth=widths.MOVING_CURVE, animated=True, label=name)
        if several:
            legend(axis, style, rows.title)
        else:
            axis.set_title(rows.title, loc="left", fontsize=9, color=style.ink)
        if named:
            axis.set_xlabel(with_unit("t", unit_of(recording.statement, "t")), labelpad=1.0)
        else:
            axis.tick_params(labelbottom=False)

    def past(self, k: int, height: int) -> tuple[slice, slice]:
        """Return the slices of pixel rows and of pixel columns that contain the curves up to sample number `k`.

        `height` is the height of the picture in pixels.
        """
        box, transform = self.axis.get_window_extent(), self.axis.transData.transform
        left, right = sorted(round(float(transform((float(self.t[n]), 0.0))[0])) for n in (0, k))
        return slice(height - ceil(box.y1) - 2, height - int(box.y0) + 2), slice(left, right)

    def draw(self, k: int, pen: Pen) -> None:
        """Draw with `pen` a vertical line at the time of sample number `k`, and a dot on each curve at that time."""
        t = float(self.t[k])
        pen.line(np.array([[t, t], self.axis.get_ylim()]), self.style.quiet, widths.MARK)
        for row, colour in zip(self.rows.rows, self.rows.colours, strict=True):
            pen.marks(np.array([[t], [row[k]]]), colour, 6.4)
