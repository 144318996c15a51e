"""Series of impacts with ever shorter flights, which may accumulate at a finite time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

SMALLEST_BOUNCE = 1e-7
"""Speed of an impact, relative to the largest of a series of decreasing impacts, below which the rest of the series is
summed. The height of the omitted bounces is 1e-14 of the first. Times of flight then have 8 digits.
"""

FEWEST_FLIGHTS = 3
"""Smallest number of flights, each shorter than the one before, that count as an accumulation."""

UNKNOWN_IMPACTS, ELASTIC_IMPACTS = 16, 2**16
"""Largest number of impacts in one call of a compiled loop. The first is for a restitution that depends on the speed,
the second for impacts without loss of energy.
"""


class Bounces:
    """The present series of impacts with ever shorter flights between them. It may accumulate at a finite time.

    `times` and `speeds` (k,) are those of the impacts in the series. `contacts` has the last `FEWEST_FLIGHTS`
    impacts: the set of the contacts that take part in each.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Remove all impacts from the series."""
        self.times, self.speeds = np.empty(0), np.empty(0)
        self.contacts: list[frozenset[int]] = []

    def add(self, times: FloatArray, speeds: FloatArray, contacts: Sequence[frozenset[int]]) -> None:
        """Add impacts with `times` and `speeds` (k,) to the series.

        `contacts` has, for each of the last impacts, the set of contacts that take part in it. A flight that is not
        shorter than the previous one begins a new series.
        """
        whole = np.append(self.times, times)
        again = np.flatnonzero(np.diff(whole, 2) >= 0)
        first = int(again[-1]) + 1 if len(again) else 0
        self.times, self.speeds = whole[first:], np.append(self.speeds, speeds)[first:]
        self.contacts = [*self.contacts, *contacts][-FEWEST_FLIGHTS:]

    def most(self, restitutions: Sequence[float | None]) -> int:
        """Return the number of impacts that a compiled loop may handle before the run tests for an accumulation.

        `restitutions` has the value of each contact, None if it depends on the speed. After this number of impacts
        the speed of a bouncing ball has decreased to about `SMALLEST_BOUNCE` of the largest speed in the series.
        """
        constants = [e for e in restitutions if e is not None and e > 0]
        weakest = min(constants, default=1.0)
        if len(constants) < len(restitutions) or weakest == 1.0:
            return UNKNOWN_IMPACTS if None in restitutions else ELASTIC_IMPACTS
        share = self.speeds[-1] / self.speeds.max() if len(self.speeds) else 1.0
        return max(1, math.ceil(math.log(SMALLEST_BOUNCE / share) / math.log(weakest)))

    @property
    def end(self) -> float | None:
        """The time at which the impacts accumulate, from the ratio of successive flights; None if they do not yet.

        None is also the result as long as the impact speed has not decreased to `SMALLEST_BOUNCE` of the largest.
        """
        few = not len(self.speeds) or self.speeds[-1] > SMALLEST_BOUNCE * self.speeds.max()
        return None if few else self.limit

    @property
    def limit(self) -> float | None:
        """The limit of the times of impact, if each of the last flights is shorter by the same ratio; else None."""
        if len(self.times) < FEWEST_FLIGHTS + 1:
            return None
        a, b, c = self.times[-3:].tolist()
        ratio = (c - b) / (b - a)
        return c + (c - b) * ratio / (1 - ratio) if ratio < 1 else None
