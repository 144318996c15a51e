"""What happened at events so far, and how close together changes of the motion came."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lagrange.machine.state import DriverState
from lagrange.procedure.step.constants import EARLIEST
from lagrange.trajectory.trajectory import FloatArray

TOGETHER = 4 * 2.0**-52
"""Roots closer than this part of the time happen at once."""

CLOSEST = 64 * 2.0**-52
"""An event or surface that is met again and again closer than this part of the time accumulates."""

AGAIN = 3
"""How often in a row that is."""

SAME, IDLE = 0.999, 8
"""A time between resets that is no shorter than this part of the shortest before, and how many such are too many."""


@dataclass(frozen=True)
class Occurrence:
    """An event: when, the state there (2n,), and the accepted steps without which it has not happened."""

    t: float
    y: FloatArray
    steps: int


class Record:
    """What happened at each of some events along the run of one state of a `size`; `state` is where it stands."""

    def __init__(self, events: int, size: int) -> None:
        self.occurrences: list[list[Occurrence]] = [[] for _ in range(events)]
        self.state: DriverState | None = None
        self._size = size

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,), up to the last accepted step."""
        return tuple(np.array([one.t for one in found]) for found in self._happened())

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n)."""
        return tuple(np.array([one.y for one in found]).reshape(-1, self._size) for found in self._happened())

    def _happened(self) -> list[list[Occurrence]]:
        steps = 0 if self.state is None else self.state.count(DriverState.STEPS)
        return [[one for one in found if one.steps <= steps] for found in self.occurrences]


class Crowd:
    """Tells whether changes of the motion follow one another so closely that time stands still."""

    def __init__(self) -> None:
        self.last = -math.inf
        self.counts: Counter[int] = Counter()

    def accumulates(self, t: float, which: Iterable[int]) -> bool:
        """Count changes of what is watched, by number, at a time."""
        if abs(t - self.last) > CLOSEST * max(abs(t), EARLIEST):
            self.counts.clear()
        self.last = t
        self.counts.update(which)
        return max(self.counts.values()) > AGAIN


class Flights:
    """Tells whether times between resets stop falling where nothing is seen between them but round-off."""

    def __init__(self) -> None:
        self.least = 0.0
        self.count = 0

    def idle(self, length: float, *, unseen: bool) -> bool:
        """Count a time between two resets; `unseen` says that the event did not leave zero by more than round-off."""
        if unseen and length >= SAME * self.least:
            self.count += 1
        else:
            self.least, self.count = length, 0
        return self.count > IDLE
