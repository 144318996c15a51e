"""The picture of a race: error against time, one line per method, both axes logarithmic."""

from __future__ import annotations

import textwrap
from itertools import cycle, groupby
from typing import TYPE_CHECKING

from lagrange.errors import StatementError
from lagrange.show.colours import colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from lagrange.evidence.work_precision import Entry
    from lagrange.show.race import Race

_MARKERS = "osD^vP*Xh<>p"
_INK, _GRID, _QUIET = "#222222", "#e3e3e3", "#8a8a8a"

_WIDTH = 125
"""Letters to a line below the picture."""


def plot(race: Race) -> Figure:
    """Return a figure of error against time. Raises StatementError if no run reached the end."""
    from matplotlib.figure import Figure

    shown = [entry for entry in race if entry.complete and 0 < entry.error < float("inf")]
    if not shown:
        raise StatementError("there is nothing to plot: no run of the race reached its end with a finite error.")
    figure = Figure(figsize=(8.8, 5.8), layout="constrained")
    axis = figure.add_subplot()
    axis.set_xscale("log")
    axis.set_yscale("log")
    styles = zip(race.methods, colours(len(race.methods)), cycle(_MARKERS), strict=False)
    for name, colour, marker in styles:
        entries = [entry for entry in shown if entry.method == name]
        if entries:
            _draw(axis, name, entries, colour, marker)
    _mark_limits(axis, race)
    _dress(axis, race)
    failed = len(race) - len(shown)
    below = [f"Reference: {race.result.reference.about}, known to {race.uncertainty:.1e}."]
    below += [f"{failed} of {len(race)} runs did not reach the end and are not shown."] if failed else []
    if not all(entry.resolved for entry in shown):
        below.append("A mark that no line leads to is a bound: the reference cannot tell such a small error.")
    below += [note for note in race.notes if "does not take part" not in note]
    lines = [line for sentence in below for line in textwrap.wrap(sentence, _WIDTH)]
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8, color=_QUIET)
    return figure


def _draw(axis: Axes, name: str, entries: list[Entry], colour: str, marker: str) -> None:
    """Draw a method; errors below what the reference tells are open and joined by nothing."""
    rival = name.startswith(("scipy-", "cvode"))
    for resolved, group in groupby(entries, key=lambda entry: entry.resolved):
        part = list(group)
        axis.plot(
            [entry.time for entry in part],
            [entry.error for entry in part],
            color=colour,
            marker=marker,
            markersize=5.5,
            markeredgewidth=1.0,
            markerfacecolor=colour if resolved and not rival else "white",
            linestyle="none" if not resolved else "--" if rival else "-",
            linewidth=1.0 if rival else 1.6,
        )
    axis.plot(
        [],
        [],
        color=colour,
        marker=marker,
        markersize=5.5,
        markerfacecolor="white" if rival else colour,
        linestyle="--" if rival else "-",
        linewidth=1.0 if rival else 1.6,
        label=f"{name}\n{_settings(entries)}",
    )


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


def _mark_limits(axis: Axes, race: Race) -> None:
    """Shade what no method in doubles reaches but by luck, where it lies inside the picture."""
    low, high = axis.get_ylim()
    if low < race.floor < float("inf"):
        axis.axhspan(low, min(race.floor, high), color=_GRID, alpha=0.55, zorder=0, linewidth=0)
        axis.annotate(
            "below: rounding one state moves the end further",
            (0.01, min(race.floor, high)),
            (0, -3),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=_QUIET,
        )
        axis.set_ylim(low, high)


def _dress(axis: Axes, race: Race) -> None:
    start, end = race.span
    axis.set_title(f"{race.system}, t = {start:g} to {end:g}", loc="left", fontsize=11, color=_INK)
    unit = "in parts of each entry's size" if race.relative else "in the state's units"
    where = "at the end" if len(race.result.reference.times) == 1 else f"at {len(race.result.reference.times)} times"
    axis.set_xlabel("time of one run / s", color=_INK)
    axis.set_ylabel(f"largest error {where}, {unit}", color=_INK)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(_QUIET)
    axis.grid(color=_GRID, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(which="both", color=_QUIET, labelcolor=_INK, labelsize=9)
    axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, labelspacing=0.9)
