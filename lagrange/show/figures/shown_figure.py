"""The figure that everything is drawn on: Matplotlib's own, which notebooks show without a backend being set."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from lagrange.errors import counted
from lagrange.show.files.picture import bounded_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCREEN_DPI = 80
"""Pixels of a notebook to an inch: the widest figure, 10.6 in, takes 848, as wide as a column of text."""


def new_figure(**options: Any) -> Figure:
    """Return an empty figure, with the options of Matplotlib's `Figure`."""
    return _figure_class()(**options)


@cache
def _figure_class() -> type[Figure]:
    """Return the class, made when the first figure is: Matplotlib takes 0.2 s to import."""
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A Matplotlib figure that a notebook shows, as a picture that is sharp on screens with two dots to a pixel."""

        __qualname__ = "ShownFigure"  # by which pickle finds it in this module

        def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
            width, height = (round(SCREEN_DPI * size) for size in self.get_size_inches())
            return bounded_png(self, 2 * SCREEN_DPI), {"width": width, "height": height}

        def __repr__(self) -> str:
            titles = [self.get_suptitle(), *(axis.get_title("left") or axis.get_title() for axis in self.axes)]
            name = next((f" {title!r}" for title in titles if title), "")
            return f"<figure{name}, {counted(len(self.axes), 'panel')}: .savefig(path) writes it to a file>"

    return ShownFigure


def __getattr__(name: str) -> Any:
    """Return the class to pickle, which looks for it by name (PEP 562)."""
    if name == "ShownFigure":
        return _figure_class()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
