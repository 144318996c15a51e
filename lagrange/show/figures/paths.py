"""Draw the paths of named points along a run: projection of space to the plane, links, springs, floor, and panel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.curve import (
    AXIS_MARGIN,
    LEVEL_RANGE,
    Pixels,
    around,
    in_plane,
    outputs_alone,
    times_in_sight,
)
from lagrange.show.figures.style import (
    LINES,
    NAMED_POINTS,
    FigureStyle,
    colours,
    dress,
    few_ticks,
    legend,
    mixed,
    number_labels,
    point_look,
    with_unit,
)
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import EDGE, SPRING, Link, corners, length_unit
from lagrange.trajectory.measures.times_and_points import moving_points, points_at
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


AZIMUTH, ELEVATION = -60.0, 25.0  # Default direction of view for paths in space, in degrees

_STILL = 1e-9
"""Largest extent of points in a direction in which they count as flat, as a fraction of their largest extent."""


@dataclass(frozen=True, eq=False)
class View:
    """A projection: the matrix (2, d) maps points (d, K), d = 2 or 3, to coordinates to the right and up.

    A view is at right angles to a plane of two axes, or it is oblique and shows all three axes of space. `labels` are
    the names of the axes to the right and up, empty in an oblique view. `depth` (3,) maps points to their nearness to
    the viewer; it is None unless the view is oblique. `extended` has a flag for the direction to the right and one for
    the direction up: True if the points extend in it.
    """

    matrix: FloatArray
    labels: tuple[str, str]
    depth: FloatArray | None = None
    extended: tuple[bool, bool] = (True, True)

    @property
    def shape(self) -> str:
        """Shape of the panel: "row" for points on a horizontal line, "column" on a vertical one, else "square"."""
        if self.extended[0] == self.extended[1]:
            return "square"
        return "row" if self.extended[0] else "column"

    @property
    def spatial(self) -> bool:
        """True for an oblique view, which shows all three axes of space."""
        return self.depth is not None

    def of(self, points: FloatArray) -> FloatArray:
        """Return the projection (2, K) of points (d, K). In an oblique view, z = 0 if points have two coordinates."""
        return np.asarray(self.matrix[:, : len(points)] @ points)

    def nearness(self, points: FloatArray) -> FloatArray:
        """Return the nearness (K,) of points (d, K) to the viewer, in their units; 0 if the view is not oblique."""
        return np.zeros(points.shape[1]) if self.depth is None else np.asarray(self.depth[: len(points)] @ points)


def view_of(points: Mapping[str, FloatArray]) -> View:
    """Return the view of named points, each (2, K) or (3, K) along a run.

    Points of a plane are not projected. Points of space that stay in a plane of two axes are viewed at right angles to
    it. Any other points are viewed from azimuth -60 and elevation 25 degrees, without perspective.
    """
    dimension = max(len(point) for point in points.values())
    full = [np.vstack([point, np.zeros((dimension - len(point), point.shape[1]))]) for point in points.values()]
    together = np.concatenate(full, axis=1)
    low, high = limits(together)
    extents = high - low
    still = extents <= _STILL * max(float(extents.max()), 1e-300)
    if dimension == 2 or still.any():
        kept = np.array([0, 1]) if dimension == 2 else np.sort(np.argsort(-extents, kind="stable")[:2])
        right, up = (not still[k] for k in kept)
        return View(np.eye(dimension)[kept], ("xyz"[kept[0]], "xyz"[kept[1]]), None, (bool(right), bool(up)))
    return from_side(AZIMUTH, ELEVATION)


def from_side(azimuth: float, elevation: float) -> View:
    """Return the oblique view of space from an azimuth and an elevation in degrees, without perspective."""
    a, e = np.radians((azimuth, elevation))
    across = (-np.sin(a), np.cos(a), 0.0)
    up = (-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e))
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return View(np.array([across, up]), ("", ""), towards)


SPRING_TURNS = 8  # Turns of a spring, whatever its length: their distance shows how far it is stretched
_STRAIGHT = 0.1  # Part of the length that is straight, at each end


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


_LEAST_SIDE = 0.25  # Least side of the box relative to its largest side: a narrower floor would look like a line

_TICKS = 4
_FEWEST = 3  # Least number of ticks of an axis: fewer show no scale

_STEPS = [1, 2, 2.5, 5, 10]

_NUMBERS, _NAMES = 9.0, 27.0  # Distance in points from an edge of the floor to its numbers, and to the name of its axis


@dataclass(frozen=True, eq=False)
class Box:
    """Box around points in space: its lowest and its highest corner, (3,) each."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def around(cls, points: FloatArray) -> Box:
        """Return a box with a margin around the finite points (3, K); no side is much shorter than the others.

        The box has no margin at the bottom, so that a body that rolls on a plane z = 0 touches the floor.
        """
        low, high = limits(points)
        largest = float((high - low).max()) or 1.0
        grown = np.maximum(high - low, _LEAST_SIDE * largest) / 2 + AXIS_MARGIN * largest
        middle = (low + high) / 2
        middle[2] = low[2] + grown[2]
        return cls(middle - grown, middle + grown)

    @property
    def corners(self) -> FloatArray:
        """All corners of the box, (3, 8)."""
        return np.array([*product(*zip(self.low, self.high, strict=True))]).T

    @property
    def drawn(self) -> FloatArray:
        """Ends of the drawn parts of the box, (3, 5): the four corners of the floor, and the top of the z axis."""
        (x0, y0, z0), (x1, y1, z1) = self.low, self.high
        return np.array([(x0, y0, z0), (x1, y0, z0), (x0, y1, z0), (x1, y1, z0), (x0, y0, z1)]).T

    def ticks(self, axis: int) -> FloatArray:
        """Return round numbers (k,) between the ends of axis number `axis` of the box."""
        from matplotlib.ticker import MaxNLocator

        low, high = float(self.low[axis]), float(self.high[axis])
        for most in range(_TICKS, 3 * _TICKS):
            values = np.asarray(MaxNLocator(most, steps=_STEPS).tick_values(low, high))
            values = values[(values >= low) & (values <= high)]
            if len(values) >= _FEWEST:
                break
        return values


def draw_floor(axis: Axes, view: View, box: Box, unit: str, style: FigureStyle) -> None:
    """Draw the floor at the lowest z of `box`, with numbers at its front edges, and the z axis at its left corner.

    `view` is an oblique view from above, with an azimuth between -90 and 0 degrees. `unit` is the unit of length for
    the names of the axes, "" for none.
    """
    (x0, y0, z0), (x1, y1, z1) = box.low, box.high
    for k, (begin, end) in enumerate((((0, y0), (0, y1)), ((x0, 0), (x1, 0)))):
        for position in box.ticks(k):
            line = np.array(
                [(position, begin[1]), (position, end[1])] if k == 0 else [(begin[0], position), (end[0], position)]
            )
            _line(axis, view, np.column_stack([line, [z0, z0]]), style.grid, widths.FLOOR)
    edge = np.array([(x0, y1, z0), (x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)])
    _line(axis, view, edge, style.quiet, widths.FRAME)
    _line(axis, view, np.array([(x0, y0, z0), (x0, y0, z1)]), style.quiet, widths.FRAME)
    for k, foot in enumerate(((None, y0, z0), (x1, None, z0), (x0, y0, None))):
        _numbers(axis, view, box, k, foot, unit, style)
    projected = view.of(box.corners)
    low, high = projected.min(axis=1), projected.max(axis=1)
    axis.update_datalim([low - 0.12 * (high - low), high + 0.04 * (high - low)])
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def _line(axis: Axes, view: View, points: FloatArray, colour: str, width: float) -> None:
    axis.plot(*view.of(points.T), color=colour, linewidth=width, zorder=0.5, solid_capstyle="round")


def _numbers(
    axis: Axes, view: View, box: Box, k: int, foot: tuple[float | None, ...], unit: str, style: FigureStyle
) -> None:
    """Write the numbers and the name of axis number `k` of space beside an edge of the floor of `box`, outside of it.

    `foot` is a point on that edge; its coordinate along the axis is None. `unit` is the unit of length behind the name,
    "" for none.
    """
    ticks = box.ticks(k)
    outwards = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0)][k]) if k < 2 else np.zeros(3)
    away = view.of(outwards[:, None])[:, 0] if k < 2 else np.array([-1.0, 0.0])
    away = away / np.hypot(*away)
    texts = [*number_labels(ticks.tolist()), with_unit("xyz"[k], unit)]
    middle = (box.low[k] + box.high[k]) / 2
    for text, position in zip(texts, [*ticks.tolist(), middle if k < 2 else box.high[k]], strict=True):
        named = text is texts[-1]
        at = view.of(np.array([[position if part is None else part] for part in foot]))[:, 0]
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
        written.set_in_layout(False)  # the limits of the panel already leave room for it


SLENDER = 12  # Ratio of length to width above which paths are not drawn to scale, because they would be a narrow strip


def is_slender(extents: FloatArray) -> bool:
    """Return True if paths with these extents (2,) to the right and up would be a narrow strip if drawn to scale."""
    low, high = sorted(extents.tolist())
    return bool(1e-9 * high < low <= high / SLENDER)


_LONGEST = 80.0
"""Length of the longest path that is drawn, as a multiple of the extent of all paths. A path three times as long would
cover half of the panel. Of a longer path the last part is drawn."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of p named points of a run, projected to the plane of the picture.

    - `points` (p, 2, K) are the projected positions at the times `times` (K,).
    - `space` are the same positions before projection, (p, 2, K) or (p, 3, K).
    - `starts` are their projected initial positions, (p, 2).
    - `moving` are the names of the points with a path.
    - `surfaces` has the names of the points along each surface.
    - `late` is true if the paths are only the last part of a long run.
    - `view` is the projection, and `links` are the rods, springs and edges between points.
    """

    times: FloatArray
    points: FloatArray
    space: FloatArray
    starts: FloatArray
    late: bool
    names: tuple[str, ...]
    moving: tuple[str, ...]
    view: View
    links: tuple[Link, ...]
    surfaces: tuple[tuple[str, ...], ...]
    note: str
    """Sentence on points that leave the panel, for the title of the panel; empty if none do."""

    def of(self, name: str) -> FloatArray:
        """Return the path of the point `name`, (2, K)."""
        return np.asarray(self.points[self.names.index(name)])

    @cached_property
    def on_paper(self) -> FloatArray:
        """Projected positions of all points at all times, (2, N)."""
        return np.concatenate([*self.points, self.starts.T], axis=1)

    @cached_property
    def extents(self) -> FloatArray:
        """Extents of all projected paths to the right and up, (2,)."""
        low, high = limits(self.on_paper)
        return high - low

    @property
    def to_scale(self) -> bool:
        """True if a unit of length is equally long to the right and up in a picture of these paths.

        It is False for paths without links and surfaces that would then be a narrow strip.
        """
        return bool(self.links or self.surfaces) or not is_slender(self.extents)


def limits(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest coordinates, (d,) each, of the finite points (d, K)."""
    good = points[:, np.isfinite(points).all(axis=0)]
    return (good.min(axis=1), good.max(axis=1)) if good.shape[1] else (np.zeros(len(points)), np.zeros(len(points)))


def named_points(solution: Solution, t: FloatArray) -> dict[str, FloatArray]:
    """Return the positions, (2, K) or (3, K), of the named points at times t (K,), by name; empty if there are none."""
    return points_at(solution.model, t, solution.at(t), solution.parameters_at(t))


def common_view(solutions: tuple[Solution, ...]) -> View | None:
    """Return one view for the paths of several runs, `solutions`; None if no point is stated."""
    runs = [named_points(run, _times(run)[0]) for run in solutions]
    points_by_name = {f"{name} {k}": points for k, run in enumerate(runs) for name, points in run.items()}
    return view_of(points_by_name) if points_by_name else None


def paths_of(solution: Solution, view: View, pixels: Pixels) -> Paths:
    """Return the paths of the named points of a run in a `view`, exact within a pixel for a panel of size `pixels`.

    For a long run the paths are its last part, because longer paths would cover the panel.
    """
    names = tuple(named_points(solution, solution.t[:1]))

    def placed(t: FloatArray) -> list[FloatArray]:
        return [*named_points(solution, t).values()]

    def seen(t: FloatArray) -> FloatArray:
        return np.array([view.of(point) for point in placed(t)])

    def seen_with_shadows(t: FloatArray) -> FloatArray:
        points = placed(t)
        flat = [point[:2] for point in points] if view.spatial else []
        return np.array([view.of(point) for point in [*points, *flat]])

    first, note = _times(solution)
    drawn = first
    if not outputs_alone(solution.trajectory):
        drawn = in_plane(seen_with_shadows, _last_part(first, seen(first)), pixels)[0]
    space = np.array(placed(drawn))
    return Paths(
        times=drawn,
        points=np.array([view.of(point) for point in space]),
        space=space,
        starts=seen(solution.t[:1])[:, :, 0],
        late=bool(drawn[0] != first[0]),
        names=names,
        moving=tuple(moving_points(solution.model.statement)),
        view=view,
        links=solution.model.statement.links,
        surfaces=tuple(map(tuple, solution.model.statement.outlines.values())),
        note=note,
    )


def _times(solution: Solution) -> tuple[FloatArray, str]:
    """Return the times (K,) at which the paths of a run are sampled first, and a note if points leave the panel."""
    if not named_points(solution, solution.t[:1]):
        return solution.t[:1], ""
    return times_in_sight(solution, lambda t: np.stack([*named_points(solution, t).values()], axis=1))


def _last_part(t: FloatArray, points: FloatArray) -> FloatArray:
    """Return the end of the times `t` (K,), in which no point's path is longer than `_LONGEST` times the extent.

    `points` (p, 2, K) are the positions at the times `t`. Their extent is the larger of their width and height.
    """
    low, high = limits(np.concatenate([*points], axis=1))
    steps = np.nan_to_num(np.hypot(*np.moveaxis(np.diff(points, axis=2), 1, 0)))
    lengths = np.concatenate([np.zeros((len(points), 1)), np.cumsum(steps, axis=1)], axis=1)
    gone, size = lengths[np.argmax(lengths[:, -1])], float(np.max(high - low))
    if size <= 0 or gone[-1] <= _LONGEST * size:
        return t
    return t[np.searchsorted(gone, gone[-1] - _LONGEST * size) :]


_DEPTHS = 6  # Number of widths and colours of a path in space: near parts are wider and darker
_FARTHEST = 0.28  # Share of the path's colour in the colour of its farthest parts; the rest is the background


@dataclass(frozen=True, eq=False)
class PathPanel:
    """Panel with the paths of named points of the runs `solutions` in one `view`; `labels` are names of the runs."""

    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    view: View

    @property
    def shape(self) -> str:
        """Shape of the panel: "row", "column" or "square", as for its view."""
        return self.view.shape

    def draw(self, axis: Axes, pixels: Pixels, style: FigureStyle) -> None:
        """Draw the paths, with open circles at their starts, and points and links at their ends."""
        runs = [paths_of(run, self.view, pixels) for run in self.solutions]
        statement = self.solutions[0].model.statement
        unit = length_unit(statement)
        dress(axis, style)
        bounds, box = self._bounds(runs), None
        if self.view.spatial:
            box = Box.around(np.concatenate([space for run in runs for space in run.space], axis=1))
            draw_floor(axis, self.view, box, unit, style)
        for index, run in enumerate(runs):
            _draw_run(axis, run, self._shades(run, index, style), self.labels[index], box, style, index)
        self._frame(axis, runs, bounds)
        if not self.view.spatial:
            right, up = (with_unit(name, unit) for name in self.view.labels)
            axis.set_xlabel(right if self.shape != "column" else "", labelpad=2.0)
            # The title above a narrow column fits only within this distance.
            axis.set_ylabel(up if self.shape != "row" else "", labelpad=2.0 if self.shape == "column" else 6.0)
        notes = dict.fromkeys(run.note for run in runs)
        title = "\n".join(filter(None, (_title(runs[0], self.shape), *notes)))
        axis.set_title(title, loc="left", fontsize=10, color=style.ink)
        if len(axis.get_legend_handles_labels()[1]) > 1:
            legend(axis, style, title, 10)

    def _to_scale(self, runs: list[Paths]) -> bool:
        """Return True if a unit of length is equally long to the right and up in the picture of the paths `runs`.

        It is False if all points lie on a horizontal or vertical line, or if `Paths.to_scale` is False for a run.
        """
        return self.shape == "square" and all(run.to_scale for run in runs)

    def _bounds(self, runs: list[Paths]) -> FloatArray:
        """Return the least and the largest coordinate of the paths `runs` in each of d directions, (2, d).

        The directions are right and up in the picture, or x, y and z for an oblique view. If the panel is to scale,
        all directions have the same length.
        """
        point_sets = [np.concatenate([*run.space], axis=1) if self.view.spatial else run.on_paper for run in runs]
        low, high = limits(np.concatenate(point_sets, axis=1))
        equal = self._to_scale(runs) or self.view.spatial
        more = ((high - low).max() - (high - low)) / 2 if equal else np.zeros(len(low))
        return np.array([low - more, high + more])

    def _shades(self, run: Paths, index: int, style: FigureStyle) -> dict[str, str]:
        """Return the colour of each moving point by name, for run number `index`.

        If only one point moves, each run has its own colour.
        """
        if len(run.moving) == 1 and len(self.solutions) > 1:
            return {run.moving[0]: colours(len(self.solutions), style.colours)[index]}
        return dict(zip(run.moving, point_look(len(run.moving), style.colours)[0], strict=True))

    def _frame(self, axis: Axes, runs: list[Paths], bounds: FloatArray) -> None:
        """Set the limits of the panel, with a margin around all points of the paths `runs`.

        `bounds` (2, d) are their least and largest coordinates. Paths that are only rounding noise do not fill the
        panel.
        """
        axis.margins(AXIS_MARGIN)
        still = float(np.ptp(bounds, axis=0).max()) <= LEVEL_RANGE * float(np.abs(bounds).max(initial=0.0))
        if self.view.spatial:
            axis.set_aspect("equal", adjustable="box")  # without a frame, so that the title is close to it
        elif self._to_scale(runs) and not still:
            axis.set_aspect("equal", adjustable="datalim")
        else:
            for side, ends, moves in zip("xy", bounds.T, self.view.extended, strict=True):
                if moves:
                    axis.set(**{f"{side}lim": around(ends)})
        if self.shape == "row":
            axis.set(ylim=(-1.0, 1.0), yticks=[])
            axis.spines["left"].set_visible(False)
        elif self.shape == "column":
            axis.set(xlim=(-1.0, 1.0), xticks=[])
            axis.spines["bottom"].set_visible(False)
        if not self.view.spatial and self.shape != "column":
            axis.apply_aspect()
            few_ticks(axis)


def _title(paths: Paths, shape: str) -> str:
    if not paths.moving:
        return f"at t = {paths.times[-1]:.4g}"
    begun = f"from t = {paths.times[0]:.4g}"
    begun = (f"\n{begun}" if shape == "column" else f" {begun} on") * paths.late
    scale = "" if paths.to_scale or paths.view.spatial else ", not to scale"
    return f"path{begun}{scale}{chr(10) if begun or shape == 'column' else '; '}open circles: start"


def _draw_run(
    axis: Axes, paths: Paths, shades: dict[str, str], label: str, box: Box | None, style: FigureStyle, index: int
) -> None:
    size = float(np.max(paths.extents)) if paths.view.shape == "square" else 15.0
    for start, end, kind in paths.links:
        ends = paths.of(start)[:, -1], paths.of(end)[:, -1]
        line = spring(*ends, 0.04 * size) if kind == SPRING else np.array(ends).T
        axis.plot(*line, color=style.quiet, linewidth=widths.THIN if kind == EDGE else widths.BOLD, zorder=3)
    for surface in paths.surfaces:
        line = np.array([paths.of(name)[:, -1] for name in surface]).T
        axis.plot(*line, color=style.ink, linewidth=widths.SURFACE, zorder=2.5)
    hidden = corners(paths.links).union(*paths.surfaces)
    shared = bool(label) and len(shades) > 1  # then points have colours, and runs have line styles
    kind = LINES[index % len(LINES)] if shared else "-"
    part = point_look(len(shades))[1]
    for k, name in enumerate(paths.names):
        if name in hidden:
            continue
        if name not in paths.moving:
            marker = "s" if any(name in link[:2] for link in paths.links) else "P"
            shown = "_nolegend_" if name == ORIGIN or index else name
            axis.plot(*paths.of(name)[:, -1], marker, color=style.ink, ms=4.5, zorder=5, label=shown, linestyle="none")
            continue
        shade = shades[name]
        if box is None:
            axis.plot(*paths.of(name), kind, color=shade, linewidth=widths.THIN, zorder=2)
        else:
            _draw_in_space(axis, paths, k, box, shade, style, kind)
        axis.plot(*paths.starts[k], "o", mfc=style.paper, mec=shade, ms=5 * part, zorder=4)
        named = len(shades) <= NAMED_POINTS and (len(shades) > 1 or not label)
        shown = " ".join(filter(None, (name if named else "", label))) or "_nolegend_"
        last = paths.of(name)[:, -1]
        mark = axis.plot(*last, "o", color=shade, ms=7 * part, lw=widths.THIN, zorder=5, label=shown)[0]
        mark.set(linestyle=kind if shared else "none")  # for the legend


def _draw_in_space(axis: Axes, paths: Paths, k: int, box: Box, shade: str, style: FigureStyle, kind: str) -> None:
    """Draw the path of point number `k` of `paths`, with its shadow on the floor of `box`.

    Parts of the path near the viewer are wider and darker. `shade` is the colour of the path, and `kind` its line
    style.
    """
    view, space = paths.view, paths.space[k]
    floor = np.array([*space[:2], np.full(space.shape[1], box.low[2])])
    axis.plot(*view.of(floor), color=mixed(style.quiet, style.paper, 0.45), linewidth=widths.FLOOR, zorder=1)
    drop = np.array([space[:, -1], floor[:, -1]]).T
    axis.plot(*view.of(drop), color=style.quiet, linewidth=widths.FLOOR, linestyle=":", zorder=1.5)
    nearness = view.nearness(space)
    low, high = (float(end(view.nearness(box.corners))) for end in (np.min, np.max))
    for depth, line in enumerate(by_depth(paths.points[k], (nearness - low) / (high - low))):
        share = _FARTHEST + (1 - _FARTHEST) * depth / (_DEPTHS - 1)
        colour = mixed(shade, style.paper, share)
        width = widths.FARTHEST + share * (widths.NEAREST - widths.FARTHEST)
        axis.plot(*line, kind, color=colour, linewidth=width, zorder=2 + 0.1 * depth)


def by_depth(points: FloatArray, nearness: FloatArray) -> Iterator[FloatArray]:
    """Divide a path `points` (2, K) by distance from the viewer: yield its parts in each of `_DEPTHS` ranges.

    The farthest range comes first. `nearness` (K,) is between 0, far from the viewer, and 1. A yielded line is (2, C),
    with NaN between its parts.
    """
    middle = (nearness[1:] + nearness[:-1]) / 2
    depths = np.clip(np.nan_to_num(_DEPTHS * middle), 0, _DEPTHS - 1).astype(int)
    for depth in range(_DEPTHS):
        chords = np.flatnonzero(depths == depth)
        last = np.append(np.diff(chords) > 1, True)[: len(chords)]
        count = np.where(last, 3, 1)
        positions = np.repeat(chords, count)
        within = np.arange(len(positions)) - np.repeat(np.cumsum(count) - count, count)
        line = points[:, positions + np.minimum(within, 1)]
        line[:, within == 2] = np.nan
        yield line
