"""Values that are almost alike: a number is subtracted from them, which is said, and round-off is a level line."""

from __future__ import annotations

from math import floor, log10

import numpy as np

from lagrange.show.figures.curve import LEVEL
from lagrange.trajectory.trajectory import FloatArray

_NARROW = 1e-4
"""Values, and times, that differ by less than this part of the largest are drawn as differences from a number, which
is said: else their labels would have more than five digits alike."""


def base_of(values: FloatArray) -> float:
    """Return a round number that is subtracted from values which are almost alike, else 0."""
    size = float(np.max(np.abs(values), initial=0.0))
    extent = float(np.ptp(values)) if len(values) else 0.0
    if not LEVEL * size < extent < _NARROW * size:
        return 0.0
    return round(float(values[0]), -floor(log10(extent)))


def less(label: str, base: float) -> str:
    """Return a label of values from which a number was subtracted."""
    if base == 0:
        return label
    return f"{label} {'−' if base > 0 else '+'} {abs(base):.15g}"


def level(values: FloatArray) -> tuple[float, float] | None:
    """Return limits in which values that stay put up to round-off are a level line; None for others."""
    size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    if not len(values) or np.ptp(values) > LEVEL * size:
        return None
    middle, half = float(values[0]), 0.5 * size or 1.0
    return middle - half, middle + half
