"""Long runs with fixed steps, in blocks, and whether the energy drifts along them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

import lagrange as lg

CONFIDENCE = 0.99


@dataclass(frozen=True)
class LongRun:
    """The energy error along a run in blocks of equal length: means (B,), its largest magnitude in each block (B,)."""

    means: NDArray[Any]
    largest: NDArray[Any]
    block: float
    seconds: float

    def slope(self) -> tuple[float, float]:
        """Return the slope of the energy error per unit of time, and the half-width of its confidence interval.

        Student's test on the increments of the block means: what is tested is that their mean is zero. Steps of a
        random walk, which rounding makes of the energy, are independent; a fit of a line to the means would take the
        walk for a drift. Increments of means that only scatter are correlated, which makes the interval too wide.
        """
        steps = np.diff(self.means)
        count = len(steps)
        width = student.ppf((1 + CONFIDENCE) / 2, count - 1) * steps.std(ddof=1) / np.sqrt(count)
        return float(steps.mean() / self.block), float(width / self.block)

    def drifts(self) -> bool:
        """Whether the slope differs from zero."""
        slope, width = self.slope()
        return not abs(slope) <= width


def blocks(model: lg.Model, method: str, seconds: float, count: int, **options: Any) -> Iterator[lg.Solution]:
    """Yield the blocks of a run, each beginning where the last one ended; the system must not know the time."""
    initial: dict[str, float] = {}
    for _ in range(count):
        solution = lg.integrate(model, (0.0, seconds), initial, method=method, **options)
        yield solution.require()
        initial = dict(zip(model.layout.names(), solution.y[:, -1].tolist(), strict=True))


def long_run(solutions: Iterable[lg.Solution], scale: float = 1.0) -> LongRun:
    """Return the energy errors of a run in blocks, as multiples of a scale, and the seconds that the blocks took."""
    first: float | None = None
    means, largest, block, seconds, began = [], [], 0.0, 0.0, thread_time()
    for solution in solutions:
        seconds += thread_time() - began
        first = solution.energy[0] if first is None else first
        off = (solution.energy[1:] - first) / scale
        means.append(off.mean())
        largest.append(np.abs(off).max())
        block, began = float(solution.t[-1]), thread_time()
    return LongRun(np.array(means), np.array(largest), block, seconds)
