"""Draw an ensemble as a map, a curve, a histogram or a fan of quantiles, and choose the drawn quantity."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.axes import TURN, is_angle, wrapped
from lagrange.errors import StatementError, listing
from lagrange.members.results import DRIFT, INTERRUPTED, OUTPUTS, STATE, STATUS, STATUSES, TIME, end_row, event_times
from lagrange.members.table import MemberNumbers
from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.panel import label_of_entry, panel_on, say_below
from lagrange.show.figures.style import FigureStyle, angle_ticks, colours, dress, of_figure, style_of, with_unit
from lagrange.show.notation.latex_mathml import LatexNotation
from lagrange.statement.statement import unit_of
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    from lagrange.show.ensemble import Ensemble


COMPLETE = np.array([status.complete for status in STATUSES])
"""Table by status code: True if the run is complete."""

_REDUCED = re.compile(r"(max|min|mean)\((.*)\)")
_WORDS = {"max": "largest", "min": "least", "mean": "mean"}
_EVENT = re.compile(r"t_event_([0-9]+)")


@dataclass(frozen=True, eq=False)
class MemberQuantity:
    """A quantity with one value per member: `values` (members,), NaN if the member failed or has no value.

    `name` is the name of the quantity, and `label` the label of its axis. `failed` (members,) is true for members
    without a complete run; `unrun` is the number of members that were not run. `angle` is true for an angle, wrapped to
    between -pi and pi.
    """

    name: str
    label: str
    values: FloatArray
    failed: NDArray[np.bool_]
    unrun: int
    angle: bool

    @property
    def remark(self) -> str:
        """Sentence about members that the picture does not show; empty if it shows all members."""
        sentences, members = [], len(self.values)
        lost = int(self.failed.sum()) - self.unrun
        none = int((~np.isfinite(self.values) & ~self.failed).sum())
        if lost:
            sentences.append(f"{lost:,} of {members:,} members failed")
        if self.unrun:
            sentences.append(f"{self.unrun:,} of {members:,} members were not run")
        if none:
            sentences.append(f"{none:,} of {members:,} members have none")
        return "; ".join(sentences)


def quantity(runs: Ensemble, name: str) -> MemberQuantity:
    """Return the quantity `name` for a picture. Raises StatementError if it has several numbers for each member."""
    statement = runs.model.statement
    codes = np.asarray(runs.results.column(STATUS))
    row = runs.names.index(name) if name in runs.names else None
    if row is not None:
        numbers = runs.y[row] if runs.problem.t_eval is None else runs.y[row, -1]
        label = f"{label_of_entry(statement, name)} at the end"
    elif name not in runs.table.labels and (row := end_row(name, runs.names)) is not None:
        numbers = runs[name]
        label = f"{label_of_entry(statement, runs.names[row])} at the end"
    else:
        numbers = np.asarray(runs[name], dtype=float)
        label = label_of(runs, name)
    if _EVENT.fullmatch(name):
        numbers = numbers[:, 0]
    if numbers.ndim != 1:
        raise StatementError(
            f"{name} has {numbers[0].size} numbers for each member, and a picture shows one: choose another quantity."
        )
    angle = row is not None and is_angle(statement, row)
    values = np.where(COMPLETE[codes], wrapped(numbers, -np.pi) if angle else numbers, np.nan)
    unrun = int(np.count_nonzero((codes == INTERRUPTED) & np.isnan(runs.results.column(TIME))))
    return MemberQuantity(name, label, values, ~COMPLETE[codes], unrun, angle)


def label_of(runs: Ensemble, name: str) -> str:
    """Return the label of an axis for the varied or kept quantity `name`: its symbol with its unit."""
    statement = runs.model.statement
    if name in runs.names:
        varied = " at the start" if name in runs.table.labels else ""
        return f"{label_of_entry(statement, name)}{varied}"
    if name in (TIME, "t"):
        return with_unit("time of the end" if name == TIME else "$t$", unit_of(statement, "t"))
    if name == DRIFT:
        return "energy drift, relative"
    if (match := _REDUCED.fullmatch(name)) and match[2] in runs.names:
        return f"{_WORDS[match[1]]} {label_of_entry(statement, match[2])}"
    if match := _EVENT.fullmatch(name):
        event = runs.problem.events[int(match[1])]
        written = statement.quote(event.expression, 40)
        return with_unit(f"first time of {written} = 0", unit_of(statement, "t"))
    is_parameter = any(parameter.name == name for parameter in statement.parameters)
    return with_unit(f"${LatexNotation().letter(name)}$" if is_parameter else name, unit_of(statement, name))


def first_drawn(runs: Ensemble) -> str:
    """Return the name of the quantity to draw by default.

    It is the first kept quantity with one number for each member, else the first coordinate, else a time.
    """
    shapes = {column.name: column.shape for column in runs.columns if column.name not in (STATUS, TIME)}
    if numbers := [name for name, shape in shapes.items() if name not in (STATE, OUTPUTS) and not shape]:
        return numbers[0]
    if STATE in shapes or OUTPUTS in shapes:
        return runs.names[0]
    return event_times(0) if event_times(0) in shapes else TIME


Values = FloatArray | MemberNumbers  # Values along an axis: stated values, or indices of members
BANDS = ((0.05, 0.95), (0.25, 0.75))  # Quantiles over time between which the figure is shaded; the wider band is paler
FAN_LINES = 12  # Largest number of members that are drawn over time as separate lines instead of quantiles
BINS = 60  # Largest number of bins of a histogram

MOST_CROSSES = 200
"""Largest number of failed members that are marked with a cross each on a map; more are shown by their colour only."""

EVEN_SPACING = 1e-9
"""Largest difference between the spacings of values that count as equally spaced, relative to the range of the
values."""


def plot_ensemble(runs: Ensemble, what: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of `what`, the name of a coordinate, velocity or kept quantity, against the varied quantities.

    `ax` are axes of the user, None for a new figure; `style` is "light" or "dark". Raises StatementError if more than
    two quantities vary, and if no member has a value.
    """
    look, label = style_of(style), first_drawn(runs) if what is None else runs.label(what)
    axes = {name: values for name, values in runs.table.varied.axes.items() if len(values) > 1}
    over_time = label in runs.names and any(column.name == OUTPUTS for column in runs.columns)
    if len(axes) > 2 and not over_time:
        raise StatementError(
            f"{len(axes)} quantities vary, {listing(axes)}: a picture has two axes. Vary one or two, or draw "
            "a part of runs.to_xarray()."
        )
    if over_time and not len(runs.t):
        raise StatementError("there is nothing to draw: t_eval has no times. Give some, or leave it out.")
    drawn = quantity(runs, label)
    if not over_time and not np.isfinite(drawn.values).any():
        raise StatementError(
            f"there is nothing to draw: {drawn.label} is not finite for any member. See runs.status and runs.messages "
            "for how the runs ended, or draw another quantity."
        )
    figure, axis = panel_on(ax, look, (7.2, 5.4))
    remark = drawn.remark
    if over_time:
        _fan(axis, runs, label, look)
    elif len(axes) == 2:
        remark = _map(axis, runs, axes, drawn, look)
    elif len(axes) == 1 and "member" not in axes:
        _curve(axis, runs, axes, drawn, look)
    else:
        _histogram(axis, runs, drawn, look)
    say_below(figure, ax, look, f"{remark}." if remark else "")
    return figure


def _title(runs: Ensemble, subject: str) -> str:
    return f"{runs.model.statement.name}: {subject}"


def _map(axis: Axes, runs: Ensemble, axes: Mapping[str, Values], quantity: MemberQuantity, look: FigureStyle) -> str:
    """Draw a coloured map of a quantity over the two varied quantities, and return the sentence below the map.

    `axes` has the values of the varied quantities by name; the first one is on the horizontal axis.
    """
    from matplotlib.colors import ListedColormap

    across, up = axes.items()
    shape = len(across[1]), len(up[1])
    # Angles have cyclic colours; failures have a colour that is not in the scale.
    name, mark, colour = "viridis", look.colours[1], "red"
    if quantity.angle:
        name, mark, colour = "twilight", look.colours[2], "green"
    image = _image(axis, across[1], up[1], np.ma.masked_invalid(quantity.values.reshape(shape).T), cmap=name)
    if quantity.angle:
        image.set_clim(-np.pi, np.pi)
    failed = quantity.failed.reshape(shape).T
    if failed.any():
        _image(axis, across[1], up[1], np.ma.masked_where(~failed, failed), cmap=ListedColormap([mark]))
    if 0 < failed.sum() <= MOST_CROSSES:
        rows, columns = np.nonzero(failed)
        axis.plot(across[1][columns], up[1][rows], "x", color=look.ink, markersize=4, markeredgewidth=widths.THIN)
    bar = of_figure(axis).colorbar(image, ax=axis, pad=0.02, aspect=30)
    bar.set_label(quantity.label, color=look.ink, fontsize=9)
    bar.ax.tick_params(which="both", color=look.quiet, labelcolor=look.ink, labelsize=8)
    bar.outline.set(edgecolor=look.quiet)
    if quantity.angle:
        angle_ticks(bar.ax.yaxis, -np.pi, np.pi)
    dress(axis, look, _title(runs, f"{len(runs):,} runs"))
    axis.grid(visible=False)
    for side, (key, values) in ((axis.xaxis, across), (axis.yaxis, up)):
        side.set_label_text(label_of(runs, key))
        low, high = float(values.min()), float(values.max())
        if key in runs.names and is_angle(runs.model.statement, runs.names.index(key)) and high - low > 0.45 * TURN:
            angle_ticks(side, low, high)
    remark = quantity.remark.replace("failed", f"failed, in {colour}")
    return remark.replace("were not run", f"were not run, in {colour}")


def _image(axis: Axes, x: Values, y: Values, values: Any, **look: Any) -> ScalarMappable:
    """Draw the values (k, m) as coloured cells at x (m,) and y (k,), and return the artist for a colour bar.

    Equally spaced cells are drawn as an image. `look` are Matplotlib's options for the colours.
    """
    steps = np.diff(x), np.diff(y)
    if all(step[0] > 0 and np.ptp(step) <= EVEN_SPACING * step.sum() for step in steps):
        (dx, dy) = (float(step[0]) / 2 for step in steps)
        extent = (x[0] - dx, x[-1] + dx, y[0] - dy, y[-1] + dy)
        return axis.imshow(values, extent=extent, origin="lower", aspect="auto", interpolation="nearest", **look)
    return axis.pcolormesh(x, y, values, shading="nearest", rasterized=True, **look)


def _curve(axis: Axes, runs: Ensemble, axes: Mapping[str, Values], quantity: MemberQuantity, look: FigureStyle) -> None:
    """Draw a quantity of the members against the varied quantity in `axes`; a cross marks each failed member."""
    ((varied, values),) = axes.items()
    dot = "." if len(values) <= 100 else ""
    axis.plot(values, quantity.values, color=look.colours[0], linewidth=widths.CURVE, marker=dot)
    bottom = axis.get_xaxis_transform()
    if quantity.failed.any():
        lost = values[quantity.failed]
        axis.plot(lost, np.zeros(len(lost)), "x", color=look.colours[1], transform=bottom, clip_on=False, markersize=5)
    dress(axis, look, _title(runs, f"{len(runs):,} runs"))
    axis.set_xlabel(label_of(runs, varied))
    axis.set_ylabel(quantity.label)


def _histogram(axis: Axes, runs: Ensemble, quantity: MemberQuantity, look: FigureStyle) -> None:
    """Draw the distribution of a quantity over the members, with its median and the middle nine tenths."""
    values = quantity.values[np.isfinite(quantity.values)]
    axis.hist(values, bins=min(BINS, max(8, round(len(values) ** 0.5))), color=look.colours[0], alpha=0.85)
    low, middle, high = np.quantile(values, [BANDS[0][0], 0.5, BANDS[0][1]])
    axis.axvline(middle, color=look.ink, linewidth=widths.BRANCH)
    for quantile in (low, high):
        axis.axvline(quantile, color=look.ink, linewidth=widths.MANY, linestyle="--")
    dress(axis, look, _title(runs, f"median {middle:.4g}, nine tenths from {low:.4g} to {high:.4g}"))
    axis.set_xlabel(quantity.label)
    axis.set_ylabel("members")


def _fan(axis: Axes, runs: Ensemble, name: str, look: FigureStyle) -> None:
    """Draw quantiles of the row `name` of `y` over all members against time, or each member if there are few."""
    row, times = runs.y[runs.names.index(name)], runs.t
    if len(runs) <= FAN_LINES:
        for values, colour in zip(row.T, colours(len(runs), look.colours), strict=True):
            axis.plot(times, values, color=colour, linewidth=widths.MANY)
        dress(axis, look, _title(runs, f"{len(runs)} runs"))
    else:
        levels = [level for band in BANDS for level in band]
        bands = np.full((len(levels) + 1, len(times)), np.nan)
        some = np.isfinite(row).any(axis=1)
        bands[:, some] = np.nanquantile(row[some], [*levels, 0.5], axis=1)
        for k, shade in enumerate((0.22, 0.4)):
            low, high = bands[2 * k : 2 * k + 2]
            axis.fill_between(times, low, high, color=look.colours[0], alpha=shade, linewidth=0)
        axis.plot(times, bands[-1], color=look.colours[0], linewidth=widths.BOLD)
        dress(axis, look, _title(runs, f"median, middle half and nine tenths of {len(runs):,} runs"))
    axis.set_xlabel(label_of(runs, "t"))
    axis.set_ylabel(label_of_entry(runs.model.statement, name) if name in runs.names else label_of(runs, name))
