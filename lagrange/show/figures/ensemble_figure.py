"""Pictures of ensembles: a map over two axes, a curve over one, a histogram of samples, a fan of trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.errors import StatementError, counted, listing
from lagrange.members.chunk import SUCCESS
from lagrange.members.keep import OUTPUTS, STATE, STATUS, TIME
from lagrange.show.figures.colours import colours
from lagrange.show.figures.panel import colour_bar, label_of_entry, panel_on, say_below
from lagrange.show.figures.style import Style, dress, style_of
from lagrange.show.units import unit_of, with_unit
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lagrange.show.ensemble import Ensemble

BANDS = ((0.05, 0.95), (0.25, 0.75))
"""Quantiles between which a fan is shaded, the wider band paler."""

FEW = 12
"""Up to so many members are drawn as lines of their own in a fan."""

BINS = 60
"""Most bins of a histogram."""


def plot_ensemble(runs: Ensemble, what: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of a row or a kept quantity over what varies; see `Ensemble.plot`."""
    look, label = style_of(style), _chosen(runs, what)
    figure, axis = panel_on(ax, look, (7.2, 5.4))
    axes = _axes(runs)
    over_time = label in runs.names and any(column.name == OUTPUTS for column in runs.columns)
    if over_time:
        _fan(axis, runs, label, look)
    elif len(axes) == 2:
        _map(axis, runs, label, look)
    elif len(axes) == 1 and "member" not in axes:
        _curve(axis, runs, label, look)
    elif len(axes) < 2:
        _histogram(axis, runs, label, look)
    else:
        raise StatementError(
            f"{len(axes)} things vary, {listing(axes)}: a picture has two axes. Vary one or two, or draw "
            "a part of runs.to_xarray()."
        )
    failed = int(np.count_nonzero(runs.results.column(STATUS) != SUCCESS))
    said = f"{counted(failed, 'member')} of {len(runs)} did not get to the end." if failed else ""
    say_below(figure, ax, look, said)
    return figure


def _axes(runs: Ensemble) -> dict[str, Any]:
    """Return the axes along which something varies."""
    return {name: values for name, values in runs.table.varied.axes.items() if len(values) > 1}


def _chosen(runs: Ensemble, what: Any) -> str:
    """Return the name of what is drawn: what was asked for, or the first that there is."""
    if what is not None:
        return runs.label(what)
    own = [column.name for column in runs.columns if column.name not in (STATE, OUTPUTS, STATUS, TIME)]
    kept = [name for name in own if runs.results.column(name).ndim == 1]
    if kept:
        return kept[0]
    return runs.names[0] if any(one.name in (STATE, OUTPUTS) for one in runs.columns) else TIME


def _label(runs: Ensemble, name: str, *, end: bool = False) -> str:
    """Return a name as a label of an axis."""
    statement = runs.model.statement
    if name in runs.names:
        text = label_of_entry(statement, name)
        return f"{text} at the end" if end else text
    return with_unit(name, unit_of(statement, name))


def _map(axis: Axes, runs: Ensemble, name: str, look: Style) -> None:
    """Draw a colour for every combination of two axes."""
    down, across = _axes(runs).items()
    shape = len(down[1]), len(across[1])
    values = np.asarray(runs[name] if name not in runs.table.labels else _end(runs, name), dtype=float).reshape(shape)
    mesh = axis.pcolormesh(across[1], down[1], values, shading="nearest", cmap="viridis", rasterized=True)
    colour_bar(axis, mesh, _label(runs, name, end=True), look)
    dress(axis, look, f"{runs.model.statement.name}: {len(runs):,} runs")
    axis.grid(visible=False)
    axis.set_xlabel(_label(runs, across[0]))
    axis.set_ylabel(_label(runs, down[0]))


def _end(runs: Ensemble, name: str) -> FloatArray:
    """Return the last values of a coordinate that varies; what varies and is none has its own."""
    if name not in runs.names:
        return runs.given(name)
    row: FloatArray = runs.y[runs.names.index(name)]
    return row


def _curve(axis: Axes, runs: Ensemble, name: str, look: Style) -> None:
    """Draw a quantity over the one that varies."""
    ((varied, values),) = _axes(runs).items()
    axis.plot(values, _end(runs, name) if name in runs.names else runs[name], color=look.colours[0], linewidth=1.3)
    dress(axis, look, f"{runs.model.statement.name}: {len(runs):,} runs")
    axis.set_xlabel(_label(runs, varied))
    axis.set_ylabel(_label(runs, name, end=True))


def _histogram(axis: Axes, runs: Ensemble, name: str, look: Style) -> None:
    """Draw how often values occur, with their median and the middle nine tenths."""
    values = np.asarray(_end(runs, name) if name in runs.names else runs[name], dtype=float)
    values = values[np.isfinite(values)]
    if not len(values):
        raise StatementError(f"there is nothing to draw: {name} is not finite for any member.")
    axis.hist(values, bins=min(BINS, max(8, round(len(values) ** 0.5))), color=look.colours[0], alpha=0.85)
    low, middle, high = np.quantile(values, [BANDS[0][0], 0.5, BANDS[0][1]])
    for place, width in ((low, 0.9), (middle, 1.6), (high, 0.9)):
        axis.axvline(place, color=look.ink, linewidth=width, linestyle="-" if width > 1 else "--")
    dress(axis, look, f"{runs.model.statement.name}: median {middle:.4g}, nine tenths from {low:.4g} to {high:.4g}")
    axis.set_xlabel(_label(runs, name, end=True))
    axis.set_ylabel("members")


def _fan(axis: Axes, runs: Ensemble, name: str, look: Style) -> None:
    """Draw quantiles of a row over time, or each member where there are few."""
    row, times = runs.y[runs.names.index(name)], runs.t
    if len(runs) <= FEW:
        for values, colour in zip(row.T, colours(len(runs), look.colours), strict=True):
            axis.plot(times, values, color=colour, linewidth=1.0)
        dress(axis, look, f"{runs.model.statement.name}: {len(runs)} runs")
    else:
        levels = [level for band in BANDS for level in band]
        found = np.full((len(levels) + 1, len(times)), np.nan)
        some = np.isfinite(row).any(axis=1)
        found[:, some] = np.nanquantile(row[some], [*levels, 0.5], axis=1)
        for k, shade in enumerate((0.22, 0.4)):
            axis.fill_between(times, found[2 * k], found[2 * k + 1], color=look.colours[0], alpha=shade, linewidth=0)
        axis.plot(times, found[-1], color=look.colours[0], linewidth=1.6)
        dress(axis, look, f"{runs.model.statement.name}: median, middle half and nine tenths of {len(runs):,} runs")
    axis.set_xlabel(_label(runs, "t"))
    axis.set_ylabel(_label(runs, name))
