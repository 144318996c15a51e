"""Limits of the panels of a run that ends at a singularity, whose last values would make all others a level line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.show.figures.curve import Rows, outputs_alone
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray, Status

BLOWN_UP = (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.SINGULAR, Status.DIVERGED)
"""How runs end whose values may have grown without bound; any other run is drawn whole."""

SHARE = 0.9
"""The part of the time whose values a panel shows at least, with as much room again on either side."""

ROOM = 0.15
"""How far beyond a panel lines go on, in parts of its height."""

EDGE = 0.1
"""Room beside the least or largest value where a window has it, in parts of the range of the middle values."""

_SAMPLES = 2001


@dataclass(frozen=True)
class Window:
    """The values (low, high) that a panel shows of a run that leaves it, and the largest that it does not show."""

    low: float
    high: float
    largest: float

    @property
    def note(self) -> str:
        """What is said of the values beyond."""
        return f"shown: {SHARE:.0%} of the time; then up to {self.largest:.1e}"

    @property
    def bounds(self) -> tuple[float, float]:
        """The values up to which lines are drawn, a little beyond the panel."""
        room = ROOM * (self.high - self.low)
        return self.low - room, self.high + room


def window_of(solution: Solution, values: Rows) -> Window | None:
    """Return what a panel shows of the rows (r, K) of a run at times (K,); None where it shows all of them.

    That is the middle of the values, weighted by time, and as much again on either side. A run that did not end at a
    singularity is shown whole, and so is one whose values are all within these limits.
    """
    if solution.status not in BLOWN_UP or len(solution.t) < 2:
        return None
    first, last = float(solution.t[0]), float(solution.t[-1])
    times, outputs = np.linspace(first, last, _SAMPLES), values(solution.t)
    if outputs_alone(solution.trajectory):
        order = np.argsort(solution.t)
        rows = np.array([np.interp(times, solution.t[order], row[order]) for row in outputs])
    else:
        rows = values(times)
    finite = rows[np.isfinite(rows)]
    if not len(finite):
        return None
    low, high = np.quantile(finite, [(1 - SHARE) / 2, (1 + SHARE) / 2])
    room = float(high - low)
    everything = np.concatenate([finite, outputs[np.isfinite(outputs)]])
    if room <= 0 or (everything.min() >= low - room and everything.max() <= high + room):
        return None
    least, most = float(everything.min()), float(everything.max())
    edge = EDGE * room
    return Window(
        max(float(low) - room, least - edge), min(float(high) + room, most + edge), most if most > -least else least
    )


def row_of(values: Rows, k: int) -> Rows:
    """Return the values of one row alone, (1, K), or of one entry of all points (p, K)."""
    return lambda t: np.atleast_2d(values(t)[k])


def clipped(windows: Sequence[Window | None], rows: FloatArray) -> FloatArray:
    """Return rows (r, ..., K) with the bounds of the window of each for what is beyond them."""
    pairs = zip(windows, rows, strict=True)
    return np.array([row if window is None else np.clip(row, *window.bounds) for window, row in pairs])


def cut(windows: Sequence[Window | None], rows: FloatArray) -> FloatArray:
    """Return clipped rows (r, ..., K) with NaN where one is at its bounds, so that lines end there."""
    beyond = np.zeros(rows.shape[1:], dtype=bool)
    for window, row in zip(windows, rows, strict=True):
        if window is not None:
            beyond |= (row <= window.bounds[0]) | (row >= window.bounds[1])
    inner = beyond.copy()  # a line is drawn up to the first corner beyond
    inner[..., 1:] &= beyond[..., :-1]
    return np.where(inner, np.nan, rows)


def limits_of(windows: Sequence[Window | None], drawn: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return the limits in which some curves are shown, each in its window or whole; None where all are whole."""
    if all(window is None for window in windows):
        return None
    ends = [value for window in windows if window is not None for value in (window.low, window.high)]
    whole = [row[np.isfinite(row)] for window, row in zip(windows, drawn, strict=True) if window is None]
    ends += [float(end(row)) for row in whole if len(row) for end in (np.min, np.max)]
    return min(ends), max(ends)


def notes_of(windows: Iterable[Window | None]) -> str:
    """Return what is said of the values beyond some windows: of the one with the largest."""
    found = [window for window in windows if window is not None]
    return max(found, key=lambda window: abs(window.largest)).note if found else ""
