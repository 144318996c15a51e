"""One direction of a panel: its limits, its ticks, and the pixels of its values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.show.figures.style import number_labels
from lagrange.trajectory.trajectory import FloatArray

_STEPS = [1, 2, 2.5, 5, 10]


@dataclass(frozen=True)
class Axis:
    """Values from `low` to `high` mapped to pixels from `start` to `end`; start > end for y, which grows downwards."""

    low: float
    high: float
    start: float
    end: float

    def place(self, values: FloatArray | float) -> FloatArray:
        """Return the pixels of values."""
        share = (np.asarray(values, dtype=float) - self.low) / (self.high - self.low)
        placed: FloatArray = self.start + share * (self.end - self.start)
        return placed

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Return at most `most` + 1 round values with their labels."""
        from matplotlib.ticker import MaxNLocator

        found = MaxNLocator(nbins=max(1, most), steps=_STEPS).tick_values(self.low, self.high)
        slack = 1e-9 * (self.high - self.low)
        kept = [float(value) for value in found if self.low - slack <= value <= self.high + slack]
        return list(zip(kept, number_labels(kept), strict=True))


def around(values: FloatArray, margin: float = 0.06, scale: float = 0.0) -> tuple[float, float]:
    """Return limits with room around all values. Rounding noise of the values, or of `scale`, does not fill them."""
    low, high = float(values.min()), float(values.max())
    size = max(abs(low), abs(high), scale)
    if high - low <= 1e-9 * size or high == low:
        middle, half = (low + high) / 2, 0.5 * size or 1.0
        return middle - half, middle + half
    room = margin * (high - low)
    return low - room, high + room
