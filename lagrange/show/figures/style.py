"""The style of every figure: ink, paper and colours, light and dark, and the quiet frame of a panel.

A style is set on each figure and not in Matplotlib's settings, which all threads share.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from lagrange.errors import StatementError
from lagrange.show.figures.colours import COLOURS, DARK_COLOURS
from lagrange.show.figures.number_labels import number_formatter, number_labels
from lagrange.statement.choice import one_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_NUMBERS = 7
_POINTS_OF_A_LETTER = 5.0
"""The width of a letter of 10 points, on average."""

_COMMAND = re.compile(r"\\\\(mathrm|dot|ddot|left|right|frac)?[a-zA-Z]*")
_UNSEEN = str.maketrans("", "", "${}_^\\")


MARKERS = "osD^vP*Xh<p"
"""Marks of lines; as many as have no factor in common with eight colours, so that pairs do not come twice."""


class LineStyle(NamedTuple):
    """How one of many lines is told apart: its colour, its marks and its kind."""

    colour: str
    marker: str
    line: str


@dataclass(frozen=True)
class Style:
    """Colours of a figure: its paper, its ink, what is quieter, the grid, and lines that are drawn together."""

    name: str
    paper: str
    ink: str
    quiet: str
    grid: str
    colours: tuple[str, ...]


LINES = ("-", "--", ":", "-.")
"""Kinds of lines, for runs that share the colours of their rows."""

LIGHT = Style("light", "#ffffff", "#222222", "#737373", "#e3e3e3", COLOURS)
DARK = Style("dark", "#16191d", "#e6e6e6", "#8b9097", "#2c3138", DARK_COLOURS)
STYLES = {style.name: style for style in (LIGHT, DARK)}


def style_of(name: Any) -> Style:
    """Return a style by its name. Raises StatementError for any other."""
    return STYLES[one_of(name, STYLES, "style = {given} is not known: give one of {known}.")]


def line_styles(count: int, style: Style) -> list[LineStyle]:
    """Return how lines are drawn, up to 88 of them, no two alike: in colour, in marks, and in kind or colour."""
    few = style.colours
    return [
        LineStyle(few[k % len(few)], MARKERS[k % len(MARKERS)], LINES[k // len(few) % len(LINES)]) for k in range(count)
    ]


def on_paper(figure: Figure, style: Style) -> Figure:
    """Give a figure, which is returned, the paper of its style."""
    figure.set_facecolor(style.paper)
    return figure


def dress(axis: Axes, style: Style, title: str = "") -> None:
    """Give a panel its quiet frame, and a title at its left."""
    axis.set_facecolor(style.paper)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(style.quiet)
    axis.grid(color=style.grid, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(which="both", color=style.quiet, labelcolor=style.ink, labelsize=9)
    axis.xaxis.label.set_color(style.ink)
    axis.yaxis.label.set_color(style.ink)
    axis.set_title(title, loc="left", fontsize=10, color=style.ink)
    for line in (axis.xaxis, axis.yaxis):
        if line.get_scale() == "linear":
            line.set_major_formatter(number_formatter())


def few_ticks(axis: Axes) -> None:
    """Give the horizontal axis of a panel so many numbers that they stand apart."""
    low, high = axis.get_xlim()
    width = 72 * axis.get_window_extent().width / of_figure(axis).dpi
    for count in range(_MOST_NUMBERS, 1, -1):
        axis.locator_params(axis="x", nbins=count)
        places = [place for place in axis.get_xticks() if low <= place <= high]
        letters = max((len(text) for text in number_labels(places)), default=0)
        if len(places) * (letters + 1) * _POINTS_OF_A_LETTER * 1.1 <= width:
            return


def legend(axis: Axes, style: Style, title: str = "", size: float = 9.0) -> None:
    """Give a panel a legend at its upper right, outside, and a title at its left; above it where both are long."""
    labels = axis.get_legend_handles_labels()[1]
    corners = axis.get_window_extent()
    room = 72 * corners.width / of_figure(axis).dpi
    entry = 30.0 + 4.5 * max(map(letters_in, labels), default=0)
    columns = min(len(labels), max(1, int(room / entry)))
    axis.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        frameon=False,
        fontsize=8,
        labelcolor=style.ink,
        borderaxespad=0.1,
        handlelength=1.8,
        columnspacing=1.2,
    )
    rows = -(-len(labels) // columns)
    above = _POINTS_OF_A_LETTER * letters_in(title) + columns * entry > room
    axis.set_title(title, loc="left", fontsize=size, color=style.ink, pad=6.0 + (14.0 * rows if above else 0.0))


def of_figure(axis: Axes) -> Figure:
    """Return the whole figure that a panel is in."""
    figure = axis.get_figure(root=True)
    if figure is None:
        raise StatementError("the axes were removed from their figure: give others.")
    return figure


def letters_in(text: str) -> int:
    """Return about how many letters wide a text with mathematics in it is."""
    return len(_COMMAND.sub("x", text).translate(_UNSEEN))


def mixed(colour: str, other: str, share: float) -> str:
    """Return a colour made of a share of one and the rest of another, all as #rrggbb."""
    parts = (share * a + (1 - share) * b for a, b in zip(parts_of(colour), parts_of(other), strict=True))
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)


def parts_of(colour: str) -> tuple[float, ...]:
    """Return red, green and blue of #rrggbb, from 0 to 1."""
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
