"""Figures of points: Poincare sections and bifurcation diagrams."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.axes import is_angle, row_of, wrapped
from lagrange.dynamics.equilibrium_branches import BranchesData
from lagrange.dynamics.section import SectionData, surface
from lagrange.dynamics.sweep import SweepData
from lagrange.errors import StatementError
from lagrange.show.figures.curve import with_neighbours
from lagrange.show.figures.panel import label_of_entry, panel_on, say_below
from lagrange.show.figures.style import angle_ticks, colours, dress, style_of
from lagrange.show.notation.symbols import letters
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LARGEST_POINT, SMALLEST_POINT = 6.0, 0.5
"""Largest and smallest diameter of points, in typographic points: for a hundred points, and for a hundred thousand."""


def plot_section(section: SectionData, x: Any, y: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of a section: a colour for each orbit, and the border of the region that the energy allows."""
    look, statement = style_of(style), section.statement
    if not len(section.points):
        raise StatementError(f"there is nothing to draw: {section.message}")
    names = statement.state_names
    stated = (section.axes[0] if x is None else x, "x"), (section.axes[1] if y is None else y, "y")
    columns = [row_of(statement, given, what) for given, what in stated]
    figure, axis = panel_on(ax, look, (7.0, 6.0))
    size = _diameter(len(section.points))
    for states, colour in zip(section.states, colours(len(section.states), look.colours), strict=True):
        axis.plot(*_wrapped(statement, states, columns), ".", color=colour, markersize=size, markeredgewidth=0.0)
    if (names[columns[0]], names[columns[1]]) == section.axes:
        for line in section.border:
            axis.plot(*line.T, color=look.quiet, linewidth=0.9)
    dress(axis, look, f"{statement.name}: {_where(section)}")
    _label(axis, statement, columns, section.points)
    say_below(figure, ax, look, "" if section.status.complete else section.message)
    return figure


def _diameter(count: int) -> float:
    return float(np.clip(LARGEST_POINT * (100 / max(count, 1)) ** 0.25, SMALLEST_POINT, LARGEST_POINT))


def _wrapped(statement: Statement, states: FloatArray, columns: list[int]) -> list[FloatArray]:
    """Return two entries of states (..., 2n); angles are between -pi and pi."""
    return [wrapped(states[..., k], -np.pi) if is_angle(statement, k) else states[..., k] for k in columns]


def _where(section: SectionData) -> str:
    statement = section.statement
    if section.event is None:
        unit = unit_of(statement, "t")
        return f"every {section.period:.6g}{' ' + unit if unit else ''}"
    side = {1: ", rising", -1: ", falling"}.get(section.event.direction, "")
    at = f" at the energy {section.energy:g}" if section.energy is not None else ""
    return f"{surface(section.event, statement)}{side}{at}"


def _label(axis: Axes, statement: Statement, columns: list[int], points: FloatArray) -> None:
    names = statement.state_names
    axis.set_xlabel(label_of_entry(statement, names[columns[0]]))
    axis.set_ylabel(label_of_entry(statement, names[columns[1]]))
    for side, k in zip((axis.xaxis, axis.yaxis), columns, strict=True):
        if is_angle(statement, k) and np.ptp(wrapped(points[..., k], -np.pi)) > np.pi:
            angle_ticks(side, -np.pi, np.pi)


def plot_sweep(sweep: SweepData, entry: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of a bifurcation diagram: the sampled points against the parameter."""
    look, statement = style_of(style), sweep.statement
    row = row_of(statement, sweep.axes[0] if entry is None else entry, "entry")
    known = np.isfinite(sweep.states[..., row])
    if not known.any():
        raise StatementError(f"there is nothing to draw: {sweep.message}")
    figure, axis = panel_on(ax, look, (8.6, 5.2))
    size = max(0.35, min(2.0, 2.0 * (4000 / known.sum()) ** 0.5))
    for k, colour in enumerate(colours(sweep.states.shape[1], look.colours)):
        (points,) = _wrapped(statement, sweep.states[:, k], [row])
        places = np.broadcast_to(sweep.values[:, None], points.shape)
        axis.plot(
            places.ravel(), points.ravel(), ".", color=colour, markersize=2 * size, markeredgewidth=0.0, rasterized=True
        )
    name = statement.state_names[row]
    dress(axis, look, f"{statement.name}: {_sampled_at(sweep)}")
    _parameter_axis(axis, statement, sweep.parameter, sweep.values)
    axis.set_ylabel(label_of_entry(statement, name))
    say_below(figure, ax, look, "" if sweep.status.complete else sweep.message)
    return figure


def _sampled_at(sweep: SweepData) -> str:
    if sweep.event is None:
        return "after each period of the driving"
    return surface(sweep.event, sweep.statement)


def _parameter_axis(axis: Axes, statement: Statement, parameter: str, values: FloatArray) -> None:
    axis.set_xlabel(with_unit(f"${letters([parameter])[parameter]}$", unit_of(statement, parameter)))
    low, high = float(values.min()), float(values.max())
    if low < high:
        axis.set_xlim(low, high)


def plot_branches(found: BranchesData, entry: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of branches of equilibria: solid lines where they are stable, dashed lines elsewhere."""
    look, statement = style_of(style), found.statement
    row = row_of(statement, found.axis if entry is None else entry, "entry")
    if row >= len(statement.names) or not found.branches:
        raise StatementError(
            f"there is nothing to draw: {found.message}"
            if not found.branches
            else f"equilibria rest: give one of the coordinates, such as {statement.names[0]}, and no velocity."
        )
    figure, axis = panel_on(ax, look, (7.6, 5.0))
    for stable, colour, dashes, label in (
        (1.0, look.colours[0], (1, 0), "no eigenvalue with a positive real part"),
        (0.0, look.colours[1], (5, 3), "unstable"),
    ):
        for branch in found.branches:
            line = np.where(with_neighbours(branch.stable == stable), branch.coordinates[:, row], np.nan)
            if np.isfinite(line).any():
                axis.plot(branch.values, line, color=colour, linewidth=1.8, dashes=dashes, label=label)
                label = "_"
    dress(axis, look, f"{statement.name}: equilibria")
    _parameter_axis(axis, statement, found.parameter, found.values)
    axis.set_ylabel(label_of_entry(statement, statement.names[row]))
    if is_angle(statement, row):
        low, high = axis.get_ylim()
        angle_ticks(axis.yaxis, low, high)
    axis.legend(fontsize=8, frameon=False, labelcolor=look.ink)
    say_below(figure, ax, look, "" if found.status.complete else found.message)
    return figure
