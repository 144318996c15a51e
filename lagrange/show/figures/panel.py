"""A panel that a picture is drawn on: the user's own, or that of a new figure; its style, and labels of entries."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.angles import TURN
from lagrange.errors import StatementError, shown
from lagrange.show.figures.number_labels import number_labels
from lagrange.show.figures.shown_figure import new_figure
from lagrange.show.figures.style import Style, of_figure, on_paper
from lagrange.show.notation.names import letters
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure


FEWEST_TICKS, MOST_TICKS = 3, 10
"""Numbers beside a logarithmic scale."""


def panel_on(ax: Any, style: Style, size: tuple[float, float]) -> tuple[Figure, Axes]:
    """Return a user's axes with their figure, or those of a new figure of a size in inches."""
    if ax is None:
        figure = new_figure(figsize=size, layout="constrained")
        return on_paper(figure, style), figure.subplots()
    return figure_of(ax), ax


def figure_of(ax: Any) -> Figure:
    """Return the whole figure of a user's axes. Raises StatementError for what are none, and for axes without one."""
    if getattr(ax, "plot", None) is None or getattr(ax, "get_figure", None) is None:
        raise StatementError(f"ax is {shown(ax)}: give axes of Matplotlib, or leave it out for a new figure.")
    return of_figure(ax)


def colour_bar(axis: Axes, image: ScalarMappable, label: str, style: Style) -> None:
    """Put the scale of the colours of a map beside its panel."""
    from matplotlib.colors import LogNorm

    bar = of_figure(axis).colorbar(image, ax=axis, pad=0.02, aspect=30)
    bar.set_label(label, color=style.ink, fontsize=9)
    if isinstance(image.norm, LogNorm):
        ticks = log_ticks(*image.get_clim())
        bar.set_ticks(ticks, labels=[number_labels([one])[0] for one in ticks])
        bar.minorticks_off()
    bar.ax.tick_params(which="both", color=style.quiet, labelcolor=style.ink, labelsize=8)
    outline: Any = bar.outline
    outline.set_edgecolor(style.quiet)


def log_ticks(low: float, high: float) -> list[float]:
    """Return round values for a logarithmic scale: 1, 2 and 5 times powers of ten, or finer ones where it is short."""
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    found = [first * 10.0**power for power in powers for first in (1, 2, 5) if low <= first * 10.0**power <= high]
    if len(found) >= FEWEST_TICKS:
        return found if len(found) <= MOST_TICKS else [one for one in found if math.log10(one) % 1 < 0.1]
    from matplotlib.ticker import MaxNLocator

    return [float(one) for one in MaxNLocator(nbins=MOST_TICKS // 2).tick_values(low, high) if low <= one <= high]


def say_below(figure: Figure, ax: Any, style: Style, message: str) -> None:
    """Write a sentence below a figure of our own."""
    if ax is None and message:
        lines = "\n".join(textwrap.wrap(message, round(13 * figure.get_size_inches()[0])))
        figure.supxlabel(lines, x=0.01, ha="left", fontsize=8, color=style.quiet)


def legend_beside(axis: Axes, ax: Any, style: Style, **more: Any) -> None:
    """Put the legend beside a panel of our own, and inside one of the user's, whose width is theirs."""
    if ax is None:
        axis.legend(
            fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, labelcolor=style.ink, **more
        )
        return
    frame = {"facecolor": style.paper, "edgecolor": style.grid, "framealpha": 0.85}
    axis.legend(fontsize=7, loc="upper right", labelcolor=style.ink, **frame, **more)


def label_of_entry(statement: Statement, name: str) -> str:
    """Return an entry of the state as a label of an axis, a velocity with a dot, with its unit."""
    return with_unit(f"${entry(statement, name)}$", unit_of(statement, name))


def entry(statement: Statement, name: str, *, rate: bool = False) -> str:
    """Return an entry of the state, or its rate, as mathematics without a unit."""
    known = letters(statement.names)
    dots = int(name not in known) + int(rate)
    letter = known[name] if name in known else known[name.removesuffix("_dot")]
    return letter.dotted(dots) if dots else str(letter)


def angle_ticks(axis: Any, low: float, high: float) -> None:
    """Mark an axis of an angle at multiples of pi/2, or of pi where it is long."""
    unit = math.pi / 2 if high - low <= 1.01 * TURN else math.pi
    places = np.arange(math.ceil(low / unit - 1e-9), math.floor(high / unit + 1e-9) + 1)
    axis.set_ticks(places * unit, [f"${_multiple(int(k), unit)}$" for k in places])


def _multiple(k: int, unit: float) -> str:
    if k == 0:
        return "0"
    halves = k if unit < 2 else 2 * k
    whole = {1: "", -1: "-"}
    if halves % 2 == 0:
        return rf"{whole.get(halves // 2, halves // 2)}\pi"
    return rf"{whole.get(halves, halves)}\pi/2"


def turned_lines(x: FloatArray, y: FloatArray, low: float, high: float) -> list[tuple[FloatArray, FloatArray]]:
    """Return a line (k,) in an angle as it is drawn from low to high: out on one side, and in on the other.

    Each passage of the border has a point on either side of it, with NaN between. Where more than a turn is seen there
    is a copy for each turn.
    """
    turns = np.floor((x - low) / TURN)
    at = np.nonzero(np.diff(turns))[0]
    upwards = turns[at + 1] > turns[at]
    border = low + np.maximum(turns[at], turns[at + 1]) * TURN
    between = y[at] + (border - x[at]) / (x[at + 1] - x[at]) * (y[at + 1] - y[at])
    out, back = low + np.where(upwards, TURN, 0.0), low + np.where(upwards, 0.0, TURN)
    gap = np.full(len(at), np.nan)
    places = np.repeat(at + 1, 3)
    line = np.insert(x - turns * TURN, places, np.column_stack([out, gap, back]).ravel())
    heights = np.insert(y, places, np.column_stack([between, gap, between]).ravel())
    return [(line + k * TURN, heights) for k in range(max(1, math.ceil((high - low) / TURN - 1e-9)))]
