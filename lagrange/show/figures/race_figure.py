"""The picture of a race: error against time, one line per method, both axes logarithmic."""

from __future__ import annotations

import textwrap
from itertools import groupby
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError
from lagrange.show.figures.shown_figure import new_figure
from lagrange.show.figures.style import LineStyle, Style, dress, line_styles, on_paper, style_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lagrange.evidence.work_precision import Entry
    from lagrange.show.race import Race

_ROWS = 15
"""Methods in a column of the legend; with more than one column it leaves their settings out."""

_WIDTH = 125
"""Letters to a line below the picture."""


def plot(race: Race, style: Any = "light") -> Figure:
    """Return a figure of error against time. Raises StatementError if no run reached the end."""
    look = style_of(style)
    shown = [entry for entry in race if entry.complete and 0 < entry.error < float("inf")]
    if not shown:
        raise StatementError("there is nothing to plot: no run of the race reached its end with a finite error.")
    groups = {name: [entry for entry in shown if entry.method == name] for name in race.methods}
    drawn = {name: entries for name, entries in groups.items() if entries}
    columns = -(-len(drawn) // _ROWS)
    figure = new_figure(figsize=(6.6 + 2.2 * columns, 5.8), layout="constrained")
    axis = figure.add_subplot()
    axis.set_xscale("log")
    axis.set_yscale("log")
    for (name, entries), own in zip(drawn.items(), line_styles(len(drawn), look), strict=True):
        _draw(axis, f"{name}\n{_settings(entries)}" if columns == 1 else name, entries, own, look)
    _mark_limits(axis, race, look)
    _dress(axis, race, look)
    axis.legend(
        fontsize=8,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        ncols=columns,
        labelspacing=0.9 if columns == 1 else 0.5,
        labelcolor=look.ink,
        handlelength=3.0,
    )
    text = "\n".join(line for sentence in _below(race, shown) for line in textwrap.wrap(sentence, _WIDTH))
    figure.supxlabel(text, x=0.01, ha="left", fontsize=8, color=look.quiet)
    return on_paper(figure, look)


def _below(race: Race, shown: list[Entry]) -> list[str]:
    """Return the sentences below the picture."""
    failed = len(race) - len(shown)
    below = [f"Reference: {race.result.reference.about}, known to {race.uncertainty:.1e}."]
    below += [f"{failed} of {len(race)} runs did not reach the end and are not shown."] if failed else []
    if not all(entry.resolved for entry in shown):
        below.append("A mark that no line leads to is a bound: the reference cannot tell such a small error.")
    return below + [note for note in race.notes if "does not take part" not in note]


def _draw(axis: Axes, label: str, entries: list[Entry], own: LineStyle, style: Style) -> None:
    """Draw a method; errors below what the reference tells are open and joined by nothing, solvers of others open."""
    rival = entries[0].method.startswith(("scipy-", "cvode"))
    common: dict[str, Any] = {"color": own.colour, "marker": own.marker, "markersize": 5.5, "markeredgewidth": 1.0}
    common["linewidth"] = 1.0 if rival else 1.6
    for resolved, group in groupby(entries, key=lambda entry: entry.resolved):
        part = list(group)
        axis.plot(
            [entry.time for entry in part],
            [entry.error for entry in part],
            markerfacecolor=own.colour if resolved and not rival else style.paper,
            linestyle=own.line if resolved else "none",
            **common,
        )
    face = style.paper if rival else own.colour
    axis.plot([], [], markerfacecolor=face, linestyle=own.line, label=label, **common)


def _settings(entries: list[Entry]) -> str:
    """Return the settings from the coarsest to the finest that is drawn."""
    sizes = [entry.setting for entry in entries]
    what = "tol" if entries[0].adaptive else "h"
    ends = dict.fromkeys(_short(size) for size in (max(sizes), min(sizes)))
    return f"{what} = {' to '.join(ends)}"


def _short(size: float) -> str:
    """Return two digits of a size, small ones as 1e-9."""
    mantissa, _, exponent = f"{size:.1e}".partition("e")
    return f"{size:.2g}" if 1e-2 < size < 1e3 else f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def _mark_limits(axis: Axes, race: Race, style: Style) -> None:
    """Shade what no method in doubles reaches but by luck, where it lies inside the picture."""
    low, high = axis.get_ylim()
    if low < race.floor < float("inf"):
        axis.axhspan(low, min(race.floor, high), color=style.grid, alpha=0.55, zorder=0, linewidth=0)
        axis.annotate(
            "below: rounding one state moves the end further",
            (0.01, min(race.floor, high)),
            (0, -3),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=style.quiet,
        )
        axis.set_ylim(low, high)


def _dress(axis: Axes, race: Race, style: Style) -> None:
    start, end = race.span
    dress(axis, style)
    axis.set_title(f"{race.system}, t = {start:g} to {end:g}", loc="left", fontsize=11, color=style.ink)
    unit = "in parts of each entry's size" if race.relative else "in the state's units"
    where = "at the end" if len(race.result.reference.times) == 1 else f"at {len(race.result.reference.times)} times"
    axis.set_xlabel("time of one run / s")
    axis.set_ylabel(f"largest error {where}, {unit}")
