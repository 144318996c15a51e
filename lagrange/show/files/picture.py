"""Write a figure as a PNG file, or as a PNG of limited size for a notebook."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING

from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import Writer
from lagrange.statement.expression import whole_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_DPI, MOST_DPI = 10, 1200
"""Least and largest dots per inch of a picture: below, no letter can be drawn; above, drawing takes over 1 GB."""

SCREEN_DPI = 80
"""Dots per inch in a notebook: the widest figure, 10.6 in, takes 848 pixels, as wide as a column of text."""

MOST_BYTES = 300_000
"""Largest picture in a notebook, in bytes. The picture of a double pendulum takes 90,000; a notebook with thirty
pictures can still be mailed."""


def picture(draw: Callable[[], Figure], dpi: int | None = None) -> Writer:
    """Return a function that writes a figure as PNG, with `dpi` dots per inch, to the file that it is called with.

    `draw` returns the figure. It is called only after the file was opened. `dpi` is None for the default.
    """
    dots = FILE_DPI if dpi is None else whole_number(dpi, "dpi", LEAST_DPI, MOST_DPI)
    return lambda file: draw().savefig(file, format="png", dpi=dots)


def bounded_png(figure: Figure, dpi: int) -> bytes:
    """Return a figure as PNG of at most `MOST_BYTES`, with `dpi` dots per inch if possible.

    A larger PNG gets 256 colours, then fewer dots per inch.
    """
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    if drawn.getbuffer().nbytes <= MOST_BYTES:
        return drawn.getvalue()
    from PIL import Image  # installed with Matplotlib

    few = BytesIO()
    with Image.open(drawn) as image:
        image.quantize(256).save(few, format="png", optimize=True)
    if few.getbuffer().nbytes <= MOST_BYTES or dpi <= LEAST_DPI:
        return few.getvalue()
    return bounded_png(figure, max(LEAST_DPI, dpi * 3 // 4))
