"""Figures that are created without pyplot, and that a notebook can show."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from lagrange.errors import StatementError, counted, shown
from lagrange.show.figures.style import dress, on_paper, style_of
from lagrange.show.files.picture import bounded_png
from lagrange.statement.expression import real_array, whole_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SCREEN_DPI = 80
"""Dots per inch in a notebook: the widest figure, 10.6 in, takes 848 pixels, as wide as a column of text."""


def new_figure(**options: Any) -> Figure:
    """Return an empty figure. The options are those of Matplotlib's `Figure`."""
    return _figure_class()(**options)


@cache
def _figure_class() -> type[Figure]:
    """Return the class `ShownFigure`. It is defined at the first figure: the import of Matplotlib takes 0.2 s."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A Matplotlib figure that a notebook shows, sharp on screens with two pixels per point."""

        __qualname__ = "ShownFigure"  # the name under which pickle looks it up in this module

        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            width, height = (round(SCREEN_DPI * size) for size in self.get_size_inches())
            return bounded_png(self, 2 * SCREEN_DPI), {"width": width, "height": height}

        def __repr__(self) -> str:
            titles = [self.get_suptitle(), *(axis.get_title("left") or axis.get_title() for axis in self.axes)]
            name = next((f" {title!r}" for title in titles if title), "")
            return f"<figure{name}, {counted(len(self.axes), 'panel')}: .savefig(path) writes it to a file>"

    return ShownFigure


def __getattr__(name: str) -> Any:
    """Return the class `ShownFigure`, which pickle looks up in this module by its name (PEP 562)."""
    if name == "ShownFigure":
        return _figure_class()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


_MOST = 8
"""Largest number of rows or columns of panels: more are too small to be read."""

_WIDTH, _NARROW, _HEIGHT = 7.2, 5.3, 3.4
"""Size of a panel in inches: width of a single one, width of one beside others, and height."""

_LONGEST = 40.0
"""Longest side of a figure, in inches: at 160 dots per inch some 6,400 pixels."""


def figure(rows: int = 1, columns: int = 1, *, size: Any = None, style: str = "light") -> Figure:
    """Return a Matplotlib figure of empty panels, which a notebook shows: `left, right = lg.figure(columns=2).axes`.

    Users draw on the panels with Matplotlib's methods, or pass them to plots as `ax`. `size` is (width, height) in
    inches, `style` is "light" or "dark". Raises StatementError for another style, an invalid size, and too many panels.
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
