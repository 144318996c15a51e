"""Empty panels in the style of all figures, for what a user draws."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError, shown
from lagrange.show.figures.shown_figure import new_figure
from lagrange.show.figures.style import dress, on_paper, style_of
from lagrange.statement.number import real_array, whole_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 8
"""More rows or columns of panels than this are too small to be read."""

_WIDTH, _NARROW, _HEIGHT = 7.2, 5.3, 3.4
"""Inches of a panel: the width of one alone, of one beside others, and the height."""

_LONGEST = 40.0
"""Inches of a side of a figure: at 160 dots to an inch some 6,400 pixels."""


def figure(rows: int = 1, columns: int = 1, *, size: Any = None, style: str = "light") -> Figure:
    """Return a Matplotlib figure of empty panels, which a notebook shows: `left, right = lg.figure(columns=2).axes`.

    Panels are drawn on with Matplotlib's own methods, and given to plots as `ax`. `size` is (width, height) in inches,
    `style` is "light" or "dark". Raises StatementError for another style, a size that cannot be, and too many panels.
    """
    look = style_of(style)
    rows, columns = (whole_number(count, what, 1, _MOST) for count, what in ((rows, "rows"), (columns, "columns")))
    width, height = (_WIDTH if columns == 1 else columns * _NARROW, rows * _HEIGHT) if size is None else size_of(size)
    made = new_figure(figsize=(width, height), layout="constrained")
    for axis in made.subplots(rows, columns, squeeze=False).flat:
        axis.set_prop_cycle(color=look.colours)
        dress(axis, look)
    return on_paper(made, look)


def size_of(size: Any) -> tuple[float, float]:
    """Return the width and the height of a figure in inches. Raises StatementError for what can be none."""
    sides = real_array(size, "size")
    if sides.shape != (2,) or not ((sides >= 1.0) & (sides <= _LONGEST)).all():
        raise StatementError(f"size = {shown(size)}: give (width, height) in inches, each from 1 to {_LONGEST:g}.")
    return float(sides[0]), float(sides[1])
