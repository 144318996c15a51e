"""What happened at events so far, and how close together changes of the motion came."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.state import DriverState
from lagrange.procedure.events.constants import CLOSEST
from lagrange.procedure.step.constants import EARLIEST
from lagrange.trajectory.trajectory import FloatArray

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
        self._parts: list[tuple[FloatArray, FloatArray, int, object]] = []
        self._count, self._size = 0, size

    def __len__(self) -> int:
        return self._count

    def append(self, one: Occurrence) -> None:
        """Add an occurrence."""
        self.extend(np.array([one.t]), one.y[None], one.steps)

    def extend(self, t: FloatArray, y: FloatArray, steps: int, mark: object = None) -> None:
        """Add many, times (k,) and states (k, 2n), that have happened with the number of accepted steps given.

        What was added last with the same `mark` is the same, and not added again.
        """
        again = mark is not None and bool(self._parts) and self._parts[-1][3] == mark
        if len(t) and not again:
            self._parts.append((t, y, steps, mark))
            self._count += len(t)

    def cut(self, count: int) -> None:
        """Keep the first so many; what is left out was added one by one."""
        while self._count > count:
            self._count -= len(self._parts.pop()[0])

    def until(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the times (k,) and states (k, 2n) of all that has happened with so many accepted steps."""
        parts = [part for part in self._parts if part[2] <= steps]
        if len(parts) == 1:
            return parts[0][0], parts[0][1]
        if not parts:
            return np.empty(0), np.empty((0, self._size))
        times, states, _, _ = zip(*parts, strict=True)
        return np.concatenate(times), np.concatenate(states)


class Breaks:
    """The rows of a run, by number, behind which the motion is another, for states of a `size`.

    The step before may have been cut within: `times` (k,) and `states` (k, 2n) are its whole end, NaN for none.
    """

    def __init__(self, size: int) -> None:
        self._parts = [(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, size)))]
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: int, whole: tuple[float, FloatArray] | None) -> None:
        """Add a break."""
        end, state = (math.nan, np.full(self._parts[0][2].shape[1], math.nan)) if whole is None else whole
        self.extend(np.array([row]), np.array([end]), state[None])

    def extend(self, rows: NDArray[np.int64], times: FloatArray, states: FloatArray) -> None:
        """Add many."""
        if len(rows):
            self._parts.append((rows, times, states))
            self._count += len(rows)

    def since(self, first: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Return the rows, times and states of all from one on."""
        parts, begin = [], self._count
        for part in reversed(self._parts):
            parts.append(part)
            begin -= len(part[0])
            if begin <= first:
                break
        rows, times, states = (np.concatenate(arrays) for arrays in zip(*reversed(parts), strict=True))
        return rows[first - begin :], times[first - begin :], states[first - begin :]


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

    def begin(self, length: float) -> None:
        """Note a time between two resets that is as it should be."""
        self.least, self.count = length, 0

    def idle(self, length: float, *, unseen: bool) -> bool:
        """Count a time between two resets; `unseen` says that the event did not leave zero by more than round-off."""
        if unseen and length >= SAME_INTERVAL * self.least:
            self.count += 1
        else:
            self.begin(length)
        return self.count > MOST_SAME
