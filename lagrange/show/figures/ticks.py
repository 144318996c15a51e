"""Ticks of axes: few that do not touch, round ones of logarithmic scales, and multiples of pi for angles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.axes import TURN
from lagrange.show.figures.style import POINTS_OF_A_LETTER, number_labels, of_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_NUMBERS = 7
"""Largest number of numbers at the ticks of a horizontal axis."""

FEWEST_TICKS, MOST_TICKS = 3, 10
"""Least and largest number of tick labels on a logarithmic scale."""


def few_ticks(axis: Axes) -> None:
    """Limit the tick labels of the horizontal axis of a panel so that they do not touch."""
    low, high = axis.get_xlim()
    width = 72 * axis.get_window_extent().width / of_figure(axis).dpi
    for count in range(_MOST_NUMBERS, 1, -1):
        axis.locator_params(axis="x", nbins=count)
        places = [place for place in axis.get_xticks() if low <= place <= high]
        letters = max((len(text) for text in number_labels(places)), default=0)
        if len(places) * (letters + 1) * POINTS_OF_A_LETTER * 1.1 <= width:
            return


def log_ticks(low: float, high: float) -> list[float]:
    """Return round values for a logarithmic scale: 1, 2 and 5 times powers of ten, or finer ones on a short scale."""
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    found = [first * 10.0**power for power in powers for first in (1, 2, 5) if low <= first * 10.0**power <= high]
    if len(found) >= FEWEST_TICKS:
        return found if len(found) <= MOST_TICKS else [one for one in found if math.log10(one) % 1 < 0.1]
    from matplotlib.ticker import MaxNLocator

    return [float(one) for one in MaxNLocator(nbins=MOST_TICKS // 2).tick_values(low, high) if low <= one <= high]


def angle_ticks(axis: Any, low: float, high: float) -> None:
    """Put ticks of an angle at multiples of pi/2, or of pi if the axis is long."""
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
