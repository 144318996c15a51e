"""Impacts of a run with ever shorter flights between them: infinitely many may end at a finite time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

SMALLEST_BOUNCE = 1e-7
"""Speed of an impact, relative to the largest of a series of decreasing impacts, below which the rest of the series is
summed. The height of the omitted bounces is 1e-14 of the first. Times of flight then have 8 digits."""

FEWEST_FLIGHTS = 3
"""Smallest number of flights, each shorter than the one before, that count as an accumulation."""

UNKNOWN_IMPACTS, ELASTIC_IMPACTS = 16, 2**16
"""Largest number of impacts in one call of a compiled loop. The first is for a restitution that depends on the speed,
the second for impacts without loss of energy."""


class Bounces:
    """The present series of impacts with ever shorter flights between them.

    `contacts` has the last `FEWEST_FLIGHTS` impacts: the set of the contacts that take part in each.
    """

    def __init__(self) -> None:
        self._added: list[Any] = [np.empty((2, 0))]
        self.contacts: list[frozenset[int]] = []

    def add(self, times: Any, speeds: Any, contacts: Sequence[frozenset[int]]) -> None:
        """Add impacts with `times` and `speeds` (k,), and the contacts that take part in the last of them."""
        self._added.append((times, speeds))
        self.contacts = [*self.contacts, *contacts][-FEWEST_FLIGHTS:]

    @property
    def series(self) -> FloatArray:
        """Times and speeds of the impacts, (2, k), since the last flight that is not shorter than the one before."""
        if len(self._added) > 1:
            whole = np.concatenate(self._added, axis=1)
            again = np.flatnonzero(np.diff(whole[0], 2) >= 0)
            self._added = [whole[:, again[-1] + 1 if len(again) else 0 :]]
        return np.asarray(self._added[0])

    def most(self, restitutions: Sequence[float | None]) -> int:
        """Return the number of impacts that a compiled loop may handle before the run tests for an accumulation.

        `restitutions` are None if they depend on the speed. After this number of impacts the speed of a bouncing ball
        has decreased to about `SMALLEST_BOUNCE` of the largest speed in the series.
        """
        constants = [e for e in restitutions if e is not None and e > 0]
        weakest = min(constants, default=1.0)
        if len(constants) < len(restitutions) or weakest == 1.0:
            return UNKNOWN_IMPACTS if None in restitutions else ELASTIC_IMPACTS
        speeds = self.series[1]
        share = speeds[-1] / speeds.max() if len(speeds) else 1.0
        return max(1, math.ceil(math.log(SMALLEST_BOUNCE / share) / math.log(weakest)))

    @property
    def limit(self) -> float | None:
        """Limit of the times of impact by the ratio of the last two flights; None if these do not become shorter."""
        times = self.series[0]
        if len(times) < FEWEST_FLIGHTS + 1:
            return None
        a, b, c = times[-3:].tolist()
        ratio = (c - b) / (b - a)
        return c + (c - b) * ratio / (1 - ratio) if ratio < 1 else None

    @property
    def accumulating(self) -> frozenset[int]:
        """Indices of the contacts whose impacts accumulate; none after a fast impact. There must be an impact."""
        speeds = self.series[1]
        slow = speeds[-1] <= SMALLEST_BOUNCE * speeds.max()
        return frozenset().union(*self.contacts) if slow and self.limit is not None else frozenset()
