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

MOST_REPEATS = 3
"""How often in a row that is."""

SAME_INTERVAL, MOST_SAME = 0.999, 8
"""A time between resets that is no shorter than this part of the shortest before, and how many such are too many."""


@dataclass(frozen=True)
class Occurrence:
    """An event: when, the state there (2n,), and the accepted steps without which it has not happened."""

    t: float
    y: FloatArray
    steps: int


class Occurrences:
    """What happened at one event, in order, for states of a `size`: single occurrences, and arrays of many."""

    def __init__(self, size: int) -> None:
        self._parts: list[tuple[FloatArray, FloatArray, int]] = []
        self._count, self._size = 0, size

    def __len__(self) -> int:
        return self._count

    def append(self, one: Occurrence) -> None:
        """Add an occurrence."""
        self.extend(np.array([one.t]), one.y[None], one.steps)

    def extend(self, t: FloatArray, y: FloatArray, steps: int) -> None:
        """Add many, times (k,) and states (k, 2n), that have happened with the number of accepted steps given."""
        if len(t):
            self._parts.append((t, y, steps))
            self._count += len(t)

    def cut(self, count: int) -> None:
        """Keep the first so many; what is left out was added one by one."""
        while self._count > count:
            self._count -= len(self._parts.pop()[0])

    def until(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the times (k,) and states (k, 2n) of all that has happened with so many accepted steps."""
        parts = [part for part in self._parts if part[2] <= steps]
        if len(parts) == 1:
            return parts[0][:2]
        if not parts:
            return np.empty(0), np.empty((0, self._size))
        times, states, _ = zip(*parts, strict=True)
        return np.concatenate(times), np.concatenate(states)


class EventLog:
    """What happened at each of some events along the run of one state of a `size`; `state` is where it stands."""

    def __init__(self, events: int, size: int) -> None:
        self.occurrences = [Occurrences(size) for _ in range(events)]
        self.state: DriverState | None = None

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,), up to the last accepted step."""
        return tuple(found.until(self._steps)[0] for found in self.occurrences)

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n)."""
        return tuple(found.until(self._steps)[1] for found in self.occurrences)

    @property
    def _steps(self) -> int:
        return 0 if self.state is None else self.state.count(DriverState.STEPS)


class ChangeCounter:
    """Tells whether changes of the motion follow one another so closely that time stands still."""

    def __init__(self) -> None:
        self.last = -math.inf
        self.counts: Counter[int] = Counter()

    def begin(self, t: float, which: int) -> None:
        """Note a change at a time that is far from others."""
        self.counts = Counter([which])
        self.last = t

    def accumulates(self, t: float, which: Iterable[int]) -> bool:
        """Count changes of what is watched, by number, at a time."""
        if abs(t - self.last) > CLOSEST * max(abs(t), EARLIEST):
            self.counts.clear()
        self.last = t
        self.counts.update(which)
        return max(self.counts.values()) > MOST_REPEATS


class ResetIntervals:
    """Tells whether times between resets stop falling where nothing is seen between them but round-off."""

    def __init__(self) -> None:
        self.least = 0.0
        self.count = 0

    def idle(self, length: float, *, unseen: bool) -> bool:
        """Count a time between two resets; `unseen` says that the event did not leave zero by more than round-off."""
        if unseen and length >= SAME_INTERVAL * self.least:
            self.count += 1
        else:
            self.least, self.count = length, 0
        return self.count > MOST_SAME
