"""The panel of paths: where named points went, in the plane or in space, with the links between them at the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from lagrange.show.figures.colours import colours
from lagrange.show.figures.curve import Pixels
from lagrange.show.figures.floor import Box, draw_floor
from lagrange.show.figures.paths import Paths, limits, paths_of
from lagrange.show.figures.space_view import View
from lagrange.show.figures.spring import spring
from lagrange.show.figures.style import LINES, Style, dress, few_ticks, legend, mixed, parts_of
from lagrange.show.figures.subtracted import base_of, less, level
from lagrange.show.units import length_unit, with_unit
from lagrange.statement.declare import ORIGIN
from lagrange.statement.link import SPRING
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DEPTHS = 6
"""Depths of a path in space: what is near is wider and darker."""

_FARTHEST = 0.28
"""The part of its colour that the farthest depth has."""

_LETTERS = 40
"""Letters of a line above the panel of a path, as many as have room there."""

_CELLS = 220
"""Cells of the density along the longer side of the panel."""


@dataclass(frozen=True, eq=False)
class PathPanel:
    """The paths of named points of some runs, all seen in one view."""

    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    view: View

    @property
    def shape(self) -> str:
        """The form of the panel: row, column or square."""
        return self.view.shape

    def draw(self, axis: Axes, pixels: Pixels, style: Style) -> None:
        """Draw paths in a panel, open circles where they begin, points and links where they end."""
        runs = [paths_of(run, self.view, pixels) for run in self.solutions]
        statement = self.solutions[0].model.statement
        unit = length_unit(statement)
        dress(axis, style)
        bounds, box = self._bounds(runs), None
        origin = np.array([base_of(np.array(ends)) for ends in bounds.T])
        runs = [run.from_origin(origin) for run in runs]
        if self.view.spatial:
            box = Box.around(np.concatenate([space for run in runs for space in run.space], axis=1))
            draw_floor(axis, self.view, box, unit, style)
        for place, run in enumerate(runs):
            if run.before.shape[1]:
                draw_density(axis, run, style)
            _draw_run(axis, run, self._shades(run, place, style), self.labels[place], box, style, place)
        self._frame(axis, runs, bounds - origin)
        if not self.view.spatial:
            self._name(axis, origin, unit)
        counted = _counted(origin) if self.view.spatial else ""
        notes = dict.fromkeys(run.note for run in runs)
        title = "\n".join(filter(None, (_title(runs[0], self.shape), counted, *notes)))
        axis.set_title(title, loc="left", fontsize=10, color=style.ink)
        if len(axis.get_legend_handles_labels()[1]) > 1:
            legend(axis, style, title, 10)

    def _bounds(self, runs: list[Paths]) -> FloatArray:
        """Return between which values a panel has each direction, (2, d): of paper, or of space seen from a side.

        To scale it has as much of one direction as of the other.
        """
        own = [np.concatenate([*run.space], axis=1) if self.view.spatial else run.on_paper for run in runs]
        low, high = limits(np.concatenate(own, axis=1))
        to_scale = self.shape == "square" and all(run.to_scale for run in runs)
        more = ((high - low).max() - (high - low)) / 2 if to_scale or self.view.spatial else np.zeros(len(low))
        return np.array([low - more, high + more])

    def _shades(self, run: Paths, place: int, style: Style) -> dict[str, str]:
        """Return the colour of each point that moves: its own, or that of the run where one point moves."""
        moving = [name for name, fixed in zip(run.names, run.fixed, strict=True) if not fixed]
        if len(moving) == 1 and len(self.solutions) > 1:
            return {moving[0]: colours(len(self.solutions), style.colours)[place]}
        return dict(zip(moving, colours(len(moving), style.colours), strict=True))

    def _frame(self, axis: Axes, runs: list[Paths], bounds: FloatArray) -> None:
        """Leave room around all points; round-off fills no panel."""
        axis.margins(0.06)
        if self.shape == "square":
            if self.view.spatial:
                axis.set_aspect("equal", adjustable="box")  # without a frame, so that its title stands near it
            elif all(run.to_scale for run in runs):
                axis.set_aspect("equal", adjustable="datalim")
        elif self.shape == "row":
            axis.set(ylim=(-1.0, 1.0), yticks=[])
            axis.spines["left"].set_visible(False)
        else:
            axis.set(xlim=(-1.0, 1.0), xticks=[])
            axis.spines["bottom"].set_visible(False)
        if not self.view.spatial:
            for side, ends, moves in zip("xy", bounds.T, self.view.extended, strict=True):
                if moves and (wide := level(ends)):
                    axis.set(**{f"{side}lim": wide})
        if not self.view.spatial and self.shape != "column":
            axis.apply_aspect()
            few_ticks(axis)

    def _name(self, axis: Axes, origin: FloatArray, unit: str) -> None:
        """Name the directions of the plane, and what was subtracted from them."""
        right, up = (with_unit(less(name, base), unit) for name, base in zip(self.view.labels, origin, strict=True))
        axis.set_xlabel(right if self.shape != "column" else "", labelpad=2.0)
        # Above a narrow column its title has room for this distance and no more.
        axis.set_ylabel(up if self.shape != "row" else "", labelpad=2.0 if self.shape == "column" else 6.0)


def _title(paths: Paths, shape: str) -> str:
    if shape != "square":
        return f"path{chr(10) if shape == 'column' else '; '}open circles: start"
    begun = f" from t = {paths.times[0]:.4g} on, shaded: before" if paths.before.shape[1] else ""
    scale = "" if paths.to_scale or paths.view.spatial else ", not to scale"
    return f"path{begun}{scale}{chr(10) if begun else '; '}open circles: start"


def _counted(origin: FloatArray) -> str:
    """Say from where places in space are counted, whose axes have no room for it."""
    parts = [f"{name} = {base:.15g}" for name, base in zip("xyz", origin, strict=True) if base]
    return fill(f"counted from {', '.join(parts)}".replace("-", "−"), _LETTERS) if parts else ""


def _draw_run(
    axis: Axes, paths: Paths, shades: dict[str, str], label: str, box: Box | None, style: Style, place: int
) -> None:
    size = float(np.max(paths.extents)) if paths.view.shape == "square" else 15.0
    for start, end, kind in paths.links:
        ends = paths.of(start)[:, -1], paths.of(end)[:, -1]
        line = spring(*ends, 0.04 * size) if kind == SPRING else np.array(ends).T
        axis.plot(*line, color=style.quiet, linewidth=1.6, zorder=3)
    shared = bool(label) and len(shades) > 1  # then points have the colours, and runs kinds of lines
    kind = LINES[place % len(LINES)] if shared else "-"
    for k, name in enumerate(paths.names):
        if paths.fixed[k]:
            marker = "s" if any(name in link[:2] for link in paths.links) else "P"
            shown = "_nolegend_" if name == ORIGIN or place else name
            axis.plot(*paths.of(name)[:, -1], marker, color=style.ink, ms=4.5, zorder=5, label=shown, linestyle="none")
            continue
        shade = shades[name]
        if box is None:
            axis.plot(*paths.of(name), kind, color=shade, linewidth=0.9, zorder=2)
        else:
            _draw_in_space(axis, paths, k, box, shade, style, kind)
        axis.plot(*paths.starts[k], "o", mfc=style.paper, mec=shade, ms=5, zorder=4)
        shown = " ".join(part for part in (name if len(shades) > 1 or not label else "", label) if part)
        mark = axis.plot(*paths.of(name)[:, -1], "o", color=shade, ms=7, lw=0.9, zorder=5, label=shown)[0]
        mark.set(linestyle=kind if shared else "none")  # which the legend shows


def _draw_in_space(axis: Axes, paths: Paths, k: int, box: Box, shade: str, style: Style, kind: str) -> None:
    """Draw a path with its shadow on the floor; what is near is wider and darker."""
    view, space = paths.view, paths.space[k]
    floor = np.array([*space[:2], np.full(space.shape[1], box.low[2])])
    axis.plot(*view.of(floor), color=mixed(style.quiet, style.paper, 0.45), linewidth=0.8, zorder=1)
    drop = np.array([space[:, -1], floor[:, -1]]).T
    axis.plot(*view.of(drop), color=style.quiet, linewidth=0.8, linestyle=":", zorder=1.5)
    nearness = view.nearness(space)
    low, high = (float(end(view.nearness(box.corners))) for end in (np.min, np.max))
    for depth, line in enumerate(by_depth(paths.points[k], (nearness - low) / (high - low))):
        share = _FARTHEST + (1 - _FARTHEST) * depth / (_DEPTHS - 1)
        colour = mixed(shade, style.paper, share)
        axis.plot(*line, kind, color=colour, linewidth=0.4 + 1.2 * share, zorder=2 + 0.1 * depth)


def by_depth(points: FloatArray, nearness: FloatArray) -> Iterator[FloatArray]:
    """Yield the parts of a path (2, K) in each range of nearness (K,) from 0 to 1, the farthest first.

    Each is a line (2, C) with NaN between its parts.
    """
    middle = (nearness[1:] + nearness[:-1]) / 2
    depths = np.clip(np.nan_to_num(_DEPTHS * middle), 0, _DEPTHS - 1).astype(int)
    for depth in range(_DEPTHS):
        chords = np.flatnonzero(depths == depth)
        last = np.append(np.diff(chords) > 1, True)[: len(chords)]
        count = np.where(last, 3, 1)
        places = np.repeat(chords, count)
        within = np.arange(len(places)) - np.repeat(np.cumsum(count) - count, count)
        line = points[:, places + np.minimum(within, 1)]
        line[:, within == 2] = np.nan
        yield line


def draw_density(axis: Axes, paths: Paths, style: Style) -> None:
    """Shade where points were before the part of their paths that is drawn: darker where they were for longer."""
    low, high = limits(np.concatenate([paths.before, *paths.points], axis=1))
    cell = float(np.max(high - low)) / _CELLS
    shape = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    ends = low + cell * shape
    column, row = np.clip(((paths.before - low[:, None]) / cell).astype(int), 0, shape[:, None] - 1)
    counts = np.bincount(column * shape[1] + row, minlength=shape.prod()).reshape(shape)
    share = np.log1p(counts) / np.log1p(counts.max())
    ink, paper = (np.array(parts_of(colour)) for colour in (style.quiet, style.paper))
    image = paper + (0.65 * share.T[:, :, None]) * (ink - paper)
    alpha = np.where(counts.T > 0, 1.0, 0.0)[:, :, None]
    extent = (float(low[0]), float(ends[0]), float(low[1]), float(ends[1]))
    coloured = np.concatenate([image, alpha], axis=2)
    shade = axis.imshow(coloured, extent=extent, origin="lower", aspect="auto", zorder=1.1)
    for edges in shade.sticky_edges:
        edges.clear()  # else the panel would have no room around its points, and cut the marks there
