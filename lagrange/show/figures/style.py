"""The look of figures: size, colours, line styles, legends, numbers at ticks, and angles as multiples of pi."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from colorsys import hls_to_rgb
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lagrange.errors import StatementError, counted, shown
from lagrange.show.figures.line_widths import FRAME
from lagrange.show.files.picture import SCREEN_DPI, bounded_png
from lagrange.statement.expression import one_of, real_array, whole_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = ("#0b6e99", "#d1495b", "#3c7d45", "#a35c00", "#6a4c93", "#00798c", "#8d5b4c", "#4a5568")
"""Colours for up to eight lines on white, which colour-blind people can distinguish."""

DARK_COLOURS = ("#4db3e0", "#f0808c", "#79c585", "#e0a458", "#b79ae0", "#4fd0dd", "#c9a090", "#a9b4c4")
"""Colours with the hues of `COLOURS` in the same order, light enough for a dark background."""

_LIGHTNESS, _SATURATION = (0.33, 0.5, 0.62), (0.75, 0.9, 0.55)


def colours(count: int, few: tuple[str, ...] = COLOURS) -> tuple[str, ...]:
    """Return `count` different colours: the first of `few` if it has enough, else hues around the circle.

    Light and dark hues alternate.
    """
    if count <= len(few):
        return few[:count]
    shares = (hls_to_rgb(k / count, _LIGHTNESS[k % 3], _SATURATION[k % 3]) for k in range(count))
    return tuple("#" + "".join(f"{round(255 * part):02x}" for part in share) for share in shares)


NAMED_POINTS = 10  # Largest number of moving points with a colour and a name each; more points look alike and are small
_SMALL = 0.4  # Factor of the size of moving points beyond `NAMED_POINTS`


def point_look(count: int, few: tuple[str, ...] = COLOURS) -> tuple[tuple[str, ...], float]:
    """Return the colours of `count` moving points, and a factor for their size, which is smaller for many points.

    `few` are the colours for a small number of points.
    """
    return (colours(count, few), 1.0) if count <= NAMED_POINTS else ((few[0],) * count, _SMALL)


POINTS_OF_A_LETTER = 5.0  # Average width of a letter of 10 points, in points

_COMMAND = re.compile(r"\\\\(mathrm|dot|ddot|left|right|frac)?[a-zA-Z]*")
_UNSEEN = str.maketrans("", "", "${}_^\\")


MARKERS = "osD^vP*Xh<p"
"""Markers of lines, as letters of Matplotlib. Successive lines take colours and markers in turn. There are 11 markers
and eight colours, numbers without a common factor, so that 88 pairs differ."""


class LineStyle(NamedTuple):
    """Look of one of many lines: its colour, its marker, and its dashes as a line style of Matplotlib."""

    colour: str
    marker: str
    line: str


@dataclass(frozen=True)
class FigureStyle:
    """Colours of a figure in the style `name`: background `paper`, text `ink`, pale text and lines `quiet`, and `grid`.

    `colours` are the colours of the lines, which are used in turn.
    """

    name: str
    paper: str
    ink: str
    quiet: str
    grid: str
    colours: tuple[str, ...]


LINES = ("-", "--", ":", "-.")  # Line styles that distinguish runs if colours distinguish quantities

LIGHT = FigureStyle("light", "#ffffff", "#222222", "#737373", "#e3e3e3", COLOURS)
DARK = FigureStyle("dark", "#16191d", "#e6e6e6", "#8b9097", "#2c3138", DARK_COLOURS)
STYLES = {style.name: style for style in (LIGHT, DARK)}


def style_of(name: Any) -> FigureStyle:
    """Return the colours of the style `name`, "light" or "dark". Raises StatementError for another name."""
    return STYLES[one_of(name, STYLES, "style = {given} is not known: give one of {known}.")]


def line_styles(count: int, style: FigureStyle) -> list[LineStyle]:
    """Return `count` line styles. Up to 88 of them all differ in colour, marker or dashes."""
    few = style.colours
    return [
        LineStyle(few[k % len(few)], MARKERS[k % len(MARKERS)], LINES[k // len(few) % len(LINES)]) for k in range(count)
    ]


def on_paper(figure: Figure, style: FigureStyle) -> Figure:
    """Set the background colour of a figure to that of `style`, and return the figure."""
    figure.set_facecolor(style.paper)
    return figure


def dress(axis: Axes, style: FigureStyle, title: str = "") -> None:
    """Draw the frame of the panel `axis` in pale colours, and its title at the upper left."""
    axis.set_facecolor(style.paper)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(style.quiet)
    axis.grid(color=style.grid, linewidth=FRAME)
    axis.set_axisbelow(True)
    axis.tick_params(which="both", color=style.quiet, labelcolor=style.ink, labelsize=9)
    axis.xaxis.label.set_color(style.ink)
    axis.yaxis.label.set_color(style.ink)
    axis.set_title(title, loc="left", fontsize=10, color=style.ink)
    for line in (axis.xaxis, axis.yaxis):
        if line.get_scale() == "linear":
            line.set_major_formatter(_classes()["NumberFormatter"]())


def legend(axis: Axes, style: FigureStyle, title: str = "", size: float = 9.0) -> None:
    """Add a legend above the upper right corner of a panel, and a title with letters of `size` points.

    The title is to the left of the legend, or above the legend if one line is too short for both.
    """
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
    above = POINTS_OF_A_LETTER * letters_in(title) + columns * entry > room
    axis.set_title(title, loc="left", fontsize=size, color=style.ink, pad=6.0 + (14.0 * rows if above else 0.0))


def of_figure(axis: Axes) -> Figure:
    """Return the whole figure that contains a panel, also if the panel is in a subfigure."""
    figure = axis.get_figure(root=True)
    if figure is None:
        raise StatementError("the axes were removed from their figure: give other axes.")
    return figure


def letters_in(text: str) -> int:
    """Return the approximate width of a text, as a number of letters; commands of mathematics count as one letter."""
    return len(_COMMAND.sub("x", text).translate(_UNSEEN))


def mixed(colour: str, other: str, share: float) -> str:
    """Return the mixture of two colours: `share` of `colour`, and the rest of `other`. All are #rrggbb."""
    parts = (share * a + (1 - share) * b for a, b in zip(parts_of(colour), parts_of(other), strict=True))
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)


def parts_of(colour: str) -> tuple[float, ...]:
    """Return the red, green and blue parts of the colour "#rrggbb" as numbers from 0 to 1."""
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


_LARGEST, _SMALLEST = 5, -4  # Exponents: numbers from 10⁵ on, and up to 10⁻⁴, are written with powers of ten
_MOST_DIGITS = 15  # Largest number of decimals: more than a double has

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number_labels(values: Sequence[float]) -> list[str]:
    """Return tick labels of `values`, with just enough digits to distinguish them: −0.5, 0 or −2·10⁻⁹, 0, 2·10⁻⁹."""
    finite = sorted({float(value) for value in values if isfinite(value)})
    size = max(map(abs, finite), default=0.0)
    if size == 0.0:
        return ["0" if isfinite(value) else "" for value in values]
    gap = min((b - a for a, b in pairwise(finite)), default=size)
    # Number of decimals of multiples of the gap, which is 1, 2, 2.5 or 5 times a power of ten.
    digits = -floor(log10(gap) + 1e-9)
    digits += abs(gap * 10.0**digits - round(gap * 10.0**digits)) > 1e-3
    power = floor(log10(size) + 1e-9)
    # A few large numbers that are almost alike are shorter without a power of ten.
    if _SMALLEST < power < _LARGEST or (power > 0 and digits + power >= _LARGEST):
        return [_decimal(value, digits) for value in values]
    suffix = "·10" + str(power).translate(_RAISED)
    return [_decimal(value / 10.0**power, digits + power) + (suffix if value else "") for value in values]


def _decimal(value: float, digits: int) -> str:
    if not isfinite(value):
        return ""
    if value == 0:
        return "0"
    text = f"{value:.{min(max(digits, 0), _MOST_DIGITS)}f}"
    return text.replace("-", "−")


@cache
def _classes() -> dict[str, Any]:
    """Return this package's subclasses of Matplotlib classes, by name.

    They are defined at the first figure, because the import of Matplotlib takes 0.2 s. Pickle looks the classes up in
    this module by their names.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import Formatter

    class ShownFigure(Figure):
        """A Matplotlib figure that a notebook shows, sharp on screens with two pixels per point."""

        __qualname__ = "ShownFigure"

        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            width, height = (round(SCREEN_DPI * size) for size in self.get_size_inches())
            return bounded_png(self, 2 * SCREEN_DPI), {"width": width, "height": height}

        def __repr__(self) -> str:
            titles = [self.get_suptitle(), *(axis.get_title("left") or axis.get_title() for axis in self.axes)]
            name = next((f" {title!r}" for title in titles if title), "")
            return f"<figure{name}, {counted(len(self.axes), 'panel')}: .savefig(path) writes it to a file>"

    class NumberFormatter(Formatter):
        """Matplotlib's formatter of the tick labels of an axis, with only the digits that distinguish them."""

        __qualname__ = "NumberFormatter"

        def __call__(self, x: float, pos: int | None = None) -> str:
            if pos is None:  # the position of the pointer, not of a tick
                return f"{x:.6g}"
            return self.format_ticks([*self.locs])[pos] if pos < len(self.locs) else ""

        def format_ticks(self, values: Any) -> list[str]:
            self.set_locs(values)
            return number_labels([float(value) for value in values])

    return {"ShownFigure": ShownFigure, "NumberFormatter": NumberFormatter}


def __getattr__(name: str) -> Any:
    """Return a class of `_classes`, which pickle looks up in this module by its name (PEP 562)."""
    if name in ("ShownFigure", "NumberFormatter"):
        return _classes()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def new_figure(**options: Any) -> Figure:
    """Return an empty figure, which a notebook shows. The options are those of Matplotlib's `Figure`."""
    figure: Figure = _classes()["ShownFigure"](**options)
    return figure


_MOST_NUMBERS = 7  # Largest number of numbers at the ticks of a horizontal axis


def few_ticks(axis: Axes) -> None:
    """Limit the tick labels of the horizontal axis of a panel so that they do not touch."""
    low, high = axis.get_xlim()
    width = 72 * axis.get_window_extent().width / of_figure(axis).dpi
    for count in range(_MOST_NUMBERS, 1, -1):
        axis.locator_params(axis="x", nbins=count)
        positions = [position for position in axis.get_xticks() if low <= position <= high]
        letters = max((len(text) for text in number_labels(positions)), default=0)
        if len(positions) * (letters + 1) * POINTS_OF_A_LETTER * 1.1 <= width:
            return


def angle_ticks(axis: Any, low: float, high: float) -> None:
    """Put ticks at multiples of pi/2 on an axis of an angle from `low` to `high`, or of pi if the axis is long."""
    unit = math.pi / 2 if high - low <= 1.01 * math.tau else math.pi
    multiples = np.arange(math.ceil(low / unit - 1e-9), math.floor(high / unit + 1e-9) + 1)
    axis.set_ticks(multiples * unit, [f"${_multiple(int(k), unit)}$" for k in multiples])


def _multiple(k: int, unit: float) -> str:
    if k == 0:
        return "0"
    halves = k if unit < 2 else 2 * k
    whole = {1: "", -1: "-"}
    if halves % 2 == 0:
        return rf"{whole.get(halves // 2, halves // 2)}\pi"
    return rf"{whole.get(halves, halves)}\pi/2"


_MOST = 8  # Largest number of rows or columns of panels: more are too small to be read

_WIDTH, _NARROW, _HEIGHT = 7.2, 5.3, 3.4
"""Size of a panel in inches: width of a single panel, width of a panel beside others, and height."""

_LONGEST = 40.0  # Longest side of a figure, in inches: at 160 dots per inch some 6,400 pixels


def figure(rows: int = 1, columns: int = 1, *, size: Any = None, style: str = "light") -> Figure:
    """Return a Matplotlib figure of empty panels, which a notebook shows: `left, right = lg.figure(columns=2).axes`.

    The panels are in `rows` and `columns`. Users draw on them with Matplotlib's methods, or pass them to plots as `ax`.
    `size` is (width, height) in inches, `style` is "light" or "dark". Raises StatementError for another style, an
    invalid size, and too many panels.
    """
    look = style_of(style)
    rows, columns = (whole_number(count, what, 1, _MOST) for count, what in ((rows, "rows"), (columns, "columns")))
    width, height = (_WIDTH if columns == 1 else columns * _NARROW, rows * _HEIGHT) if size is None else size_of(size)
    result = new_figure(figsize=(width, height), layout="constrained")
    for axis in result.subplots(rows, columns, squeeze=False).flat:
        axis.set_prop_cycle(color=look.colours)
        dress(axis, look)
    return on_paper(result, look)


def size_of(size: Any) -> tuple[float, float]:
    """Return the width and the height of a figure in inches. Raises StatementError for an invalid size."""
    sides = real_array(size, "size")
    if sides.shape != (2,) or not ((sides >= 1.0) & (sides <= _LONGEST)).all():
        raise StatementError(f"size = {shown(size)}: give (width, height) in inches, each from 1 to {_LONGEST:g}.")
    return float(sides[0]), float(sides[1])


def with_unit(label: str, unit: str) -> str:
    """Return a label followed by its unit in parentheses; the label alone if the unit is empty."""
    return f"{label} ({unit})" if unit else label
