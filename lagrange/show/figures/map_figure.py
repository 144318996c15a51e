"""Pictures of maps: a colour for each start on a plane, by the time of a first passage or by where the motion ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.angles import TURN, is_angle, wrapped
from lagrange.dynamics.axes import Plane
from lagrange.dynamics.basins import BasinsData
from lagrange.dynamics.passage import PassageData
from lagrange.errors import StatementError
from lagrange.show.figures.panel import (
    angle_ticks,
    colour_bar,
    entry,
    label_of_entry,
    legend_beside,
    panel_on,
    say_below,
)
from lagrange.show.figures.style import Style, colours, dress, style_of
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALEST = 0.5
"""How much of its colour a start keeps that settles last."""

EARLIEST = 0.02
"""The part of all times that is as bright as can be; a few starts are next to the event, or to an attractor."""

DIFFERENT = 1e-6
"""Difference of attractors in an entry that tells them apart in the legend, relative to 1 and to their size."""


def plot_passage(found: PassageData, ax: Any, style: Any) -> Figure:
    """Return the figure of first passages: early ones bright, late ones dark, none in the colour of the paper."""
    look, statement = style_of(style), found.statement
    met = found.times[np.isfinite(found.times)]
    if not met.size:
        raise StatementError(f"there is nothing to draw: {found.message}")
    figure, axis = panel_on(ax, look, (7.2, 6.0))
    from matplotlib.colors import LogNorm

    first = max(float(np.quantile(met, EARLIEST)), 1e-3 * float(met.max()))
    image = axis.imshow(
        found.times,
        extent=_extent(found.plane),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
        cmap="viridis_r" if look.name == "light" else "viridis",
        norm=LogNorm(first, max(float(met.max()), 1.001 * first)),
    )
    what = f"first time that {' or '.join(found.labels)}"
    colour_bar(axis, image, with_unit(what, unit_of(statement, "t")), look)
    _frame(axis, statement, found.plane, look, found.base)
    none = int((found.which == -1).sum())
    words = f"{none} of {found.times.size} starts without it until t = {found.t_end:g} have no colour."
    say_below(figure, ax, look, words if found.status.complete else found.message)
    return figure


def _extent(plane: Plane) -> tuple[float, float, float, float]:
    """Return the borders of the picture: half a cell beyond the outermost starts."""
    (x, y), halves = plane, [axis.width / (axis.count - 1) / 2 for axis in plane]
    return x.low - halves[0], x.high + halves[0], y.low - halves[1], y.high + halves[1]


def _frame(axis: Axes, statement: Statement, plane: Plane, look: Style, base: FloatArray) -> None:
    on_axes = [one.row for one in plane]
    rest = [(name, x) for k, (name, x) in enumerate(zip(statement.state_names, base, strict=True)) if k not in on_axes]
    held = ", ".join(f"${entry(statement, name)}$ = {x:g}" for name, x in rest)
    dress(axis, look, f"{statement.name}{': starts with ' + held if held else ''}")
    axis.grid(visible=False)
    n = len(statement.names)
    if all(one.row < n for one in plane) and 0.5 < plane[0].width / plane[1].width < 2.0:
        axis.set_aspect("equal")
    for side, one, label in ((axis.xaxis, plane[0], axis.set_xlabel), (axis.yaxis, plane[1], axis.set_ylabel)):
        label(label_of_entry(statement, one.name))
        if is_angle(statement, one.row) and one.width > 0.45 * TURN:
            angle_ticks(side, one.low, one.high)


def plot_basins(found: BasinsData, ax: Any, style: Any) -> Figure:
    """Return the figure of basins: a colour for each attractor, paler where the motion takes longer to it."""
    look, statement = style_of(style), found.statement
    if not (found.labels >= 0).any():
        raise StatementError(f"there is nothing to draw: {found.message}")
    figure, axis = panel_on(ax, look, (8.2, 5.8))
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch

    several = colours(len(found.attractors), look.colours)
    paper = np.array(to_rgb(look.paper))
    picture = np.empty((*found.labels.shape, 3))
    picture[...] = paper
    share = _share_of_time(found.times)[..., None]
    for k, colour in enumerate(several):
        here = found.labels == k
        picture[here] = (paper + (np.array(to_rgb(colour)) - paper) * (1 - (1 - PALEST) * share))[here]
    axis.imshow(picture, extent=_extent(found.plane), origin="lower", aspect="auto", interpolation="nearest")
    limits = axis.get_xlim(), axis.get_ylim()
    for attractor, colour in zip(found.attractors, several, strict=True):
        x, y = (_on_axis(statement, attractor.states[:, one.row], one.row, one.low) for one in found.plane)
        axis.plot(x, y, "o", color=colour, markeredgecolor=look.ink, markersize=7, markeredgewidth=1.3)
    axis.set(xlim=limits[0], ylim=limits[1])
    done = (found.labels != -2).sum()
    handles = [
        Patch(color=colour, label=f"{name}: {(found.labels == k).sum() / done:.1%}")
        for k, (name, colour) in enumerate(zip(attractor_names(found), several, strict=True))
    ]
    if (found.labels == -1).any():
        settled = f"not settled: {(found.labels == -1).sum() / done:.1%}"
        handles.append(Patch(facecolor=look.paper, edgecolor=look.quiet, label=settled))
    legend_beside(axis, ax, look, handles=handles)
    _frame(axis, statement, found.plane, look, found.base)
    say_below(figure, ax, look, "" if found.status.complete else found.message)
    return figure


def _share_of_time(times: FloatArray) -> FloatArray:
    """Return where times stand between early and late ones, from 0 to 1; a few of them are earlier or later still."""
    known = np.isfinite(times)
    if not known.any():
        return np.zeros(times.shape)
    first, last = np.quantile(times[known], [EARLIEST, 1 - EARLIEST])
    return np.asarray(np.clip(np.nan_to_num((times - first) / max(last - first, 1e-300)), 0.0, 1.0))


def _on_axis(statement: Statement, values: FloatArray, row: int, low: float) -> FloatArray:
    return wrapped(values, low) if is_angle(statement, row) else values


def attractor_names(found: BasinsData) -> list[str]:
    """Return what the legend calls each attractor: the coordinates in which it differs from the others."""
    names = found.statement.names
    places = np.array([one.states[0] for one in found.attractors])[:, : len(names)]
    size = 1.0 + np.abs(places).max(axis=0)
    differ = [k for k in range(len(names)) if np.ptp(places[:, k]) > DIFFERENT * size[k]] or [0]
    made = []
    for attractor, place in zip(found.attractors, places, strict=True):
        where = ", ".join(f"${entry(found.statement, names[k])}$ = {_rounded(place[k])}" for k in differ)
        made.append(where if attractor.period == 1 else f"period {attractor.period}, {where}")
    return made


def _rounded(value: float) -> str:
    return f"{value:.3g}" if abs(value) > 1e-9 else "0"
