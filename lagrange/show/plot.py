"""The picture of a run: coordinates over time, the energy, and the path in the plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from lagrange.errors import StatementError, counted, listing
from lagrange.show.colours import colours
from lagrange.show.invariants import MOST_LINES
from lagrange.show.names import letters
from lagrange.show.units import length_unit, unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray, Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lagrange.show.solution import Solution

_SAMPLES = 2000
"""Fewer outputs than this are filled up from the path between the steps: a Taylor step can hold whole swings."""

_MOST = 20_000
"""More points than this no picture shows; every k-th is taken."""

_PANELS = 28
"""More coordinates than this share panels."""

_SHORT = 10
"""A longer name stands above its panel and not beside it."""

_INK, _GRID, _QUIET = "#222222", "#e3e3e3", "#8a8a8a"
_VIEW = np.radians((-60.0, 25.0))
"""Azimuth and elevation from which paths in space are seen."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Named points along the run, each (2, N), with the labels of the two directions and the rods between points.

    `triad` has the plane directions of the axes of space, one row each, when the points were seen from `_VIEW`.
    """

    points: Mapping[str, FloatArray]
    labels: tuple[str, str]
    links: tuple[tuple[str, str], ...]
    triad: FloatArray | None = None


def plot(solution: Solution) -> Figure:
    """Return a figure with the coordinates over time, the energy, and the paths of the named positions.

    Raises StatementError for a run without output.
    """
    from matplotlib.figure import Figure

    if not len(solution.t):
        raise StatementError("there is nothing to plot: the run ended before the first of its output times.")
    t = _sample_times(solution.t)
    y = solution.at(t)
    scene = _scene(solution, t, y)
    names = solution.model.statement.names
    together = ceil(len(names) / _PANELS)
    count = ceil(len(names) / together)
    columns = 1 if count <= 4 else 2
    rows = ceil(count / columns)
    below = 1 + bool(solution.momentum_drift)
    height = max(4.2, 1.0 + (1.15 if rows <= 4 else 0.85) * (rows + 1 + below))
    figure = Figure(figsize=(6.2 if scene is None else 10.6, height), layout="constrained")
    halves = figure.add_gridspec(1, 2, width_ratios=(1.15, 1.0))
    left = figure if scene is None else figure.add_subfigure(halves[0])
    panels = left.add_gridspec(rows + below, columns, height_ratios=[1.0] * rows + [1.3] * below)
    axes = [left.add_subplot(panels[k % rows, k // rows]) for k in range(count)]
    for k, axis in enumerate(axes):
        chosen = slice(k * together, (k + 1) * together)
        _draw_coordinates(axis, solution.model.statement, chosen, t, y[: len(names)][chosen])
        axis.tick_params(labelbottom=k % rows == rows - 1 or k == count - 1)
    for axis in axes[1:]:
        axis.sharex(axes[0])
    axes[0].set_title("coordinates over time t", loc="left", fontsize=10, color=_INK)
    _draw_energy(left.add_subplot(panels[rows, :]), solution)
    if below > 1:
        _draw_momenta(left.add_subplot(panels[rows + 1, :]), solution)
    if scene is not None:
        right = figure.add_subfigure(halves[1])
        _draw_scene(right.add_subplot(), scene, length_unit(solution.model.statement))
        if sum(name != "origin" for name in scene.points) > 1:
            right.legend(loc="outside lower left", ncols=4, frameon=False, fontsize=9)
    figure.suptitle(_title(solution), x=0.01, ha="left", fontsize=11, color=_INK)
    return figure


def _dress(axis: Axes, title: str = "") -> None:
    """Give a panel its quiet frame; set here and not in Matplotlib's settings, which all threads share."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(_QUIET)
    axis.grid(color=_GRID, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(color=_QUIET, labelcolor=_INK, labelsize=9)
    axis.ticklabel_format(scilimits=(-3, 4), useMathText=True)
    axis.locator_params(axis="x", nbins=7)
    axis.set_title(title, loc="left", fontsize=10, color=_INK)


def _title(solution: Solution) -> str:
    title = f"{solution.model.statement.name}   {solution.method}, {counted(solution.steps, 'step')}"
    if solution.status.complete:
        return title
    what = "not the motion" if solution.status is Status.UNRELIABLE else "ended early"
    return f"{title}   {what}: {solution.status.value}"


def _sample_times(t: FloatArray) -> FloatArray:
    """Return the times to draw at: the outputs, thinned where there are too many, filled up where too few."""
    if len(t) >= _SAMPLES:
        chosen = t[:: ceil(len(t) / _MOST)]
        return chosen if chosen[-1] == t[-1] else np.append(chosen, t[-1])
    if len(t) < 2 or t[0] == t[-1]:
        return t
    filled = np.union1d(t, np.linspace(t[0], t[-1], _SAMPLES))
    return filled if t[-1] > t[0] else filled[::-1]


def _draw_coordinates(axis: Axes, statement: Statement, chosen: slice, t: FloatArray, rows: FloatArray) -> None:
    names = statement.names[chosen]
    units = list(dict.fromkeys(unit_of(statement, name) for name in names))
    unit = units[0] if len(units) == 1 else ""
    _dress(axis)
    for row, colour in zip(rows, colours(len(rows)), strict=True):
        axis.plot(t, row, color=colour, linewidth=1.3)
    if len(names) == 1 and len(names[0]) <= _SHORT:
        label = with_unit(f"${letters(names)[names[0]]}$", unit)
        axis.set_ylabel(label, rotation=0, ha="right", va="center")
    else:
        shown = names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"
        axis.set_title(with_unit(shown, unit), loc="right", fontsize=8, color=_INK)
    axis.margins(x=0.0)
    _widen(axis, rows)
    axis.locator_params(axis="y", nbins=3)


def _draw_energy(axis: Axes, solution: Solution) -> None:
    axis.set_xlabel(with_unit("t", unit_of(solution.model.statement, "t")))
    axis.margins(x=0.0)
    if not solution.has_energy:
        _dress(axis, "energy: it has no value at some state of the run")
        return
    drift, energy = solution.drift, solution.energy
    if drift.conserved:
        scaled = (energy - drift.first) / (drift.scale if drift.scale > 0 else 1.0)
        title = f"energy drift: (E - E0) relative to {drift.against}"
    else:
        scaled, title = energy, f"energy ({drift.unkept})"
    _dress(axis, title)
    axis.plot(solution.t, scaled, color=_INK, linewidth=1.0, marker="o" if len(energy) < 3 else "", markersize=3)
    axis.locator_params(axis="y", nbins=4)


def _draw_momenta(axis: Axes, solution: Solution) -> None:
    """Draw how far the momenta of ignorable coordinates are from their first values."""
    drifts = dict(list(solution.momentum_drift.items())[:MOST_LINES])
    axis.set_xlabel(with_unit("t", unit_of(solution.model.statement, "t")))
    axis.margins(x=0.0)
    _dress(axis, f"drift of {listing(drifts)} relative to the largest term")
    for drift, colour in zip(drifts.values(), colours(len(drifts)), strict=True):
        axis.plot(solution.t, drift, color=colour, linewidth=1.0)
    axis.locator_params(axis="y", nbins=4)


def _widen(axis: Axes, values: FloatArray) -> None:
    """Keep round-off from filling a panel: a coordinate that stays put is drawn as a level line."""
    size = float(np.max(np.abs(values)))
    if np.ptp(values) <= 1e-9 * size:
        middle, half = float(values.flat[0]), 0.5 * size or 1.0
        axis.set_ylim(middle - half, middle + half)


# --- the path in the plane ------------------------------------------------------------------------------------


def _scene(solution: Solution, t: FloatArray, y: FloatArray) -> Scene | None:
    """Return where the named points are at the times, seen in the plane; None if the statement names none."""
    statement = solution.model.statement
    if not statement.positions:
        return None
    space = {}
    for name, parts in statement.positions.items():
        rows = [solution.model.evaluate_expression(part, t, y, solution.parameters) for part in parts]
        space[name] = np.array(rows)
    if any("origin" in link for link in statement.links) and "origin" not in space:
        dimension = max(len(point) for point in space.values())
        space["origin"] = np.zeros((dimension, len(t)))
    return _seen(space, statement.links)


def _seen(space: Mapping[str, FloatArray], links: tuple[tuple[str, str], ...]) -> Scene:
    """Return points of the plane as they are, and points in space from the side where they keep to a plane.

    A direction in which nothing moves is left out; where there is none, the view is from azimuth -60 and elevation
    25 degrees, without perspective.
    """
    dimension = max(len(point) for point in space.values())
    if dimension == 2:
        return Scene(space, ("x", "y"), links)
    full = {name: np.vstack([point, np.zeros((3 - len(point), point.shape[1]))]) for name, point in space.items()}
    together = np.concatenate(list(full.values()), axis=1)
    extents = np.ptp(together, axis=1)
    flat = int(np.argmin(extents))
    if extents[flat] <= 1e-9 * max(float(extents.max()), 1e-300):
        kept = [k for k in range(3) if k != flat]
        labels = "xyz"[kept[0]], "xyz"[kept[1]]
        return Scene({name: point[kept] for name, point in full.items()}, labels, links)
    azimuth, elevation = _VIEW
    across = (-np.sin(azimuth), np.cos(azimuth), 0.0)
    up = (-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation))
    view = np.array([across, up])
    return Scene({name: view @ point for name, point in full.items()}, ("", ""), links, view.T)


def _draw_scene(axis: Axes, scene: Scene, unit: str) -> None:
    for start, end in scene.links:
        ends = np.array([scene.points[start][:, -1], scene.points[end][:, -1]])
        axis.plot(*ends.T, color=_QUIET, linewidth=1.6, zorder=3)
    for (name, point), own in zip(scene.points.items(), colours(len(scene.points)), strict=True):
        fixed = name == "origin"
        colour = _INK if fixed else own
        if not fixed:
            axis.plot(*point, color=colour, linewidth=0.9, alpha=0.75, zorder=2)
            axis.plot(*point[:, 0], "o", mfc="white", mec=colour, markersize=5, zorder=4)
        marker, label = ("s", "_nolegend_") if fixed else ("o", name)
        axis.plot(*point[:, -1], marker, color=colour, markersize=4 if fixed else 7, zorder=5, label=label)
    _frame(axis, np.concatenate(list(scene.points.values()), axis=1))
    axis.set_xlabel(with_unit(scene.labels[0], unit))
    axis.set_ylabel(with_unit(scene.labels[1], unit))
    _dress(axis, f"path in {'the plane' if scene.triad is None else 'space'}; open circles: start")
    if scene.triad is not None:
        _draw_triad(axis, scene.triad)


def _frame(axis: Axes, points: FloatArray) -> None:
    """Leave room around all points; lengths are equal in both directions unless that makes a path a thread."""
    extent = np.ptp(points, axis=1)
    axis.margins(0.06)
    if extent.min() > extent.max() / 12 or extent.min() <= 1e-9 * extent.max():
        axis.set_aspect("equal", adjustable="datalim")


def _draw_triad(axis: Axes, triad: FloatArray) -> None:
    """Show which way x, y and z point, in a corner."""
    axis.set(xticks=[], yticks=[])
    for name, (right, up) in zip("xyz", triad, strict=True):
        tip, end = (0.1 + 0.07 * right, 0.1 + 0.07 * up), (0.1 + 0.095 * right, 0.1 + 0.095 * up)
        arrow = {"arrowstyle": "->", "color": _QUIET}
        axis.annotate("", tip, (0.1, 0.1), "axes fraction", "axes fraction", arrowprops=arrow)
        axis.annotate(name, end, xycoords="axes fraction", ha="center", va="center", color=_INK)
