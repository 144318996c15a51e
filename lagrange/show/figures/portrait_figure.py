"""The figure of a phase portrait: arrows of the field, nullclines, orbits, separatrices, and marked equilibria."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.orbits import Orbit
from lagrange.dynamics.portrait import PortraitData
from lagrange.show.figures.curve import Pixels, first_times, in_plane
from lagrange.show.figures.panel import (
    entry,
    label_of_entry,
    legend_beside,
    panel_on,
    say_below,
    turned_lines,
)
from lagrange.show.figures.style import FigureStyle, angle_ticks, dress, style_of
from lagrange.trajectory.trajectory import FloatArray, Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL_WIDTH, PANEL_HEIGHT = 1000.0, 800.0
"""Size of the panel in pixels, at 160 dots per inch."""

ARROW = 0.62
"""Length of an arrow of the field, as a part of the distance to the next one."""

_MARKERS = {
    "saddle": ("X", "paper"),
    "centre": ("o", "paper"),
    "linear centre": ("o", "paper"),
    "stable spiral": ("o", "ink"),
    "stable node": ("s", "ink"),
    "unstable spiral": ("o", "open"),
    "unstable node": ("s", "open"),
    "degenerate": ("D", "paper"),
}
"""Marker of each kind of equilibrium, and its fill."""


def plot_portrait(portrait: PortraitData, ax: Any = None, style: Any = "light") -> Figure:
    """Return the figure of a portrait, drawn on `ax` if it is given."""
    look = style_of(style)
    figure, axis = panel_on(ax, look, (8.2, 5.4))
    _field(axis, portrait, look)
    _nullclines(axis, portrait, look)
    for one in portrait.orbits:
        axis.plot(*_line(portrait, one), color=look.colours[0], linewidth=0.9, zorder=2)
    for stable, colour in ((False, look.colours[1]), (True, look.colours[3])):
        label = "separatrix to the saddle" if stable else "separatrix from the saddle"
        for branch in portrait.separatrices:
            if branch.stable == stable:
                line = _line(portrait, branch.orbit)
                axis.plot(
                    *line, color=colour, linewidth=2.0, dashes=(4, 4) if stable else (1, 0), label=label, zorder=3
                )
                label = "_"
    _equilibria(axis, portrait, look)
    _frame(axis, ax, portrait, look)
    say_below(figure, ax, look, portrait.message)
    return figure


def _field(axis: Axes, portrait: PortraitData, look: FigureStyle) -> None:
    """Draw arrows of equal length in the directions of the curves of the picture."""
    widths = np.array([one.width for one in portrait.plane])
    u, v = portrait.u / widths[0], portrait.v / widths[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.hypot(u, v)
        u, v = np.where(size > 0, u / size, 0.0), np.where(size > 0, v / size, 0.0)
    spacing = widths / [len(portrait.x), len(portrait.y)]
    scale = ARROW * min(spacing / widths)
    axis.quiver(
        portrait.x,
        portrait.y,
        u * scale * widths[0],
        v * scale * widths[1],
        angles="xy",
        scale_units="xy",
        scale=1.0,
        pivot="mid",
        color=look.quiet,
        alpha=0.55,
        width=0.0016,
        headwidth=4.5,
        headlength=5.0,
        headaxislength=4.5,
        zorder=1,
    )


def _nullclines(axis: Axes, portrait: PortraitData, look: FigureStyle) -> None:
    colours = look.colours[2], look.colours[4]
    for (name, lines), colour in zip(portrait.nullclines.items(), colours, strict=True):
        label = f"${entry(portrait.statement, name, rate=True)} = 0$"
        for line in lines:
            axis.plot(*line.T, color=colour, linewidth=1.1, linestyle=":", label=label, zorder=1.5)
            label = "_"


def _line(portrait: PortraitData, orbit: Orbit) -> tuple[FloatArray, FloatArray]:
    """Return the two coordinates of an orbit on the plane, (k,) each, exact within a pixel.

    NaN separates its parts.
    """
    first, second = portrait.plane
    rows = [first.row, second.row]
    pieces = []
    for part in orbit.parts:
        begin = first_times(part)
        extent = np.ptp(part.dense(begin)[rows], axis=1)
        # Here a panel shows the window, and an angle may cross it several times.
        pixels = Pixels(PANEL_WIDTH * extent[0] / first.width, PANEL_HEIGHT * extent[1] / second.width)
        _, points = in_plane(partial(_points, part, rows), begin, pixels, equal=False)
        x, y = points[0]
        for line in turned_lines(x, y, first.low, first.high) if portrait.turns else [(x, y)]:
            pieces += [np.column_stack(line), np.full((1, 2), np.nan)]
    whole = np.vstack(pieces[:-1])
    return whole[:, 0], whole[:, 1]


def _points(run: Trajectory, rows: list[int], t: FloatArray) -> FloatArray:
    """Return the two entries of a run that the axes show, at times (K,): (1, 2, K)."""
    return np.asarray(run.dense(t)[rows][None])


def _equilibria(axis: Axes, portrait: PortraitData, look: FigureStyle) -> None:
    first, second = portrait.plane
    seen: set[str] = set()
    for place in portrait.equilibria:
        marker, filled = _MARKERS[place.kind]
        face = {"paper": look.quiet, "ink": look.ink, "open": look.paper}[filled]
        axis.plot(
            [place.state[first.row]],
            [place.state[second.row]],
            marker=marker,
            markersize=8.5 if marker != "X" else 9.5,
            markerfacecolor=look.paper if place.kind == "centre" else face,
            markeredgecolor=look.ink,
            markeredgewidth=1.2,
            linestyle="none",
            label="_" if place.kind in seen else place.kind,
            clip_on=False,
            zorder=5,
        )
        seen.add(place.kind)


def _frame(axis: Axes, ax: Any, portrait: PortraitData, look: FigureStyle) -> None:
    statement, (first, second) = portrait.statement, portrait.plane
    held = ", ".join(f"${entry(statement, name)}$ = {value:g}" for name, value in portrait.held.items())
    title = statement.name + (f" at {held}" if held else "")
    dress(axis, look, title + (f", t = {portrait.time:g}" if portrait.time is not None else ""))
    axis.grid(visible=False)
    axis.set(xlim=(first.low, first.high), ylim=(second.low, second.high))
    axis.set_xlabel(label_of_entry(statement, first.name))
    axis.set_ylabel(label_of_entry(statement, second.name))
    if portrait.turns:
        angle_ticks(axis.xaxis, first.low, first.high)
    handles, _ = axis.get_legend_handles_labels()
    if handles:
        legend_beside(axis, ax, look, handlelength=3.0)
