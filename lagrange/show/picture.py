"""A figure as a picture file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lagrange.show.atomic_file import Writer
from lagrange.statement.number import whole_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_DPI, MOST_DPI = 10, 1200
"""Dots per inch of a picture: no letter can be drawn with fewer; drawing with more takes over a gigabyte of memory."""


def picture(figure: Figure, dpi: int = 150) -> Writer:
    """Return what writes a figure as PNG."""
    dpi = whole_number(dpi, "dpi", LEAST_DPI, MOST_DPI)
    return lambda file: figure.savefig(file, format="png", dpi=dpi)
