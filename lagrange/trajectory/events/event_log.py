"""Occurrences of events so far, and tests for events that occur so often that time does not advance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.events.constants import CLOSEST
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.zeros_on_step import EventZero
from lagrange.trajectory.trajectory import FloatArray

MOST_REPEATS = 3
"""Largest number of changes that one event may cause at nearly the same time."""

SAME_INTERVAL, MOST_SAME = 0.999, 8
"""Intervals between resets no longer decrease if one has at least this fraction of the shortest before it; largest
number of such intervals in a row.
"""


class Occurrences:
    """The occurrences of one event in order, with their times and states. `size` is the length of a state, 2n."""

    def __init__(self, size: int) -> None:
        self._parts: list[tuple[FloatArray, FloatArray, int, object]] = []
        self._count, self._size = 0, size

    def __len__(self) -> int:
        return self._count

    def append(self, t: float, y: FloatArray, steps: int) -> None:
        """Add an occurrence at a time and a state (2n,). It counts once `steps` steps are accepted."""
        self.extend(np.array([t]), y[None], steps)

    def extend(self, t: FloatArray, y: FloatArray, steps: int, mark: object = None) -> None:
        """Add occurrences at times (k,) and states (k, 2n). They count once `steps` steps are accepted.

        A repeated call with the `mark` of the last call adds nothing.
        """
        again = mark is not None and bool(self._parts) and self._parts[-1][3] == mark
        if len(t) and not again:
            self._parts.append((t, y, steps, mark))
            self._count += len(t)

    def until(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the times (k,) and states (k, 2n) of the occurrences that count after `steps` accepted steps."""
        parts = [part for part in self._parts if part[2] <= steps]
        if len(parts) == 1:
            return parts[0][0], parts[0][1]
        if not parts:
            return np.empty(0), np.empty((0, self._size))
        times, states, _, _ = zip(*parts, strict=True)
        return np.concatenate(times), np.concatenate(states)


class Breaks:
    """The rows of a run (indices of stored states) after which a new smooth piece of motion begins.

    `size` is the length 2n of a state. The step before a break may have been shortened. `times` (k,) and `states` (k,
    2n) are the end of the whole step before it was shortened, and NaN for other steps.
    """

    def __init__(self, size: int) -> None:
        self._parts = [(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, size)))]
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: int, whole: tuple[float, FloatArray] | None) -> None:
        """Add a break after a row. `whole` is the end of the step before it was shortened, or None."""
        end, state = (math.nan, np.full(self._parts[0][2].shape[1], math.nan)) if whole is None else whole
        self.extend(np.array([row]), np.array([end]), state[None])

    def extend(self, rows: NDArray[np.int64], times: FloatArray, states: FloatArray) -> None:
        """Add breaks after `rows` (k,), with the `times` (k,) and `states` (k, 2n) at the ends of whole steps."""
        if len(rows):
            self._parts.append((rows, times, states))
            self._count += len(rows)

    def since(self, first: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Return the rows (k,), times (k,) and states (k, 2n) of all breaks except the first `first` ones.

        A row is the index of the stored state before the break. Times and states are the ends of the whole steps, or
        NaN.
        """
        parts, begin = [], self._count
        for part in reversed(self._parts):
            parts.append(part)
            begin -= len(part[0])
            if begin <= first:
                break
        rows, times, states = (np.concatenate(arrays) for arrays in zip(*reversed(parts), strict=True))
        return rows[first - begin :], times[first - begin :], states[first - begin :]


class EventLog:
    """The occurrences of events along a run, for states of length `size`. `state` is the driver's present state."""

    def __init__(self, events: int, size: int) -> None:
        self.occurrences = [Occurrences(size) for _ in range(events)]
        self.state: DriverState | None = None

    def first_change(self, zeros: Iterable[EventZero], impacts: Sequence[Impact]) -> EventZero | None:
        """Return the first zero in `zeros`, in order of time, whose event resets the state or ends the run, or None.

        `impacts` are all events; a zero refers to its event by index.
        """
        seen = [len(times) for times in self.occurrences]
        for zero in zeros:
            index = zero.which
            if impacts[index].counts(zero.root.rising):
                seen[index] += 1
                if impacts[index].reset or 0 < impacts[index].terminal <= seen[index]:
                    return zero
        return None

    def occur(self, indices: Sequence[int], impacts: Sequence[Impact], state: DriverState) -> bool:
        """Record the events `indices` of `impacts` at the present state. Return True if one ends the run."""
        for i in indices:
            self.occurrences[i].append(state.t, state.y.copy(), state.count(DriverState.STEPS))
        return any(0 < impacts[i].terminal <= len(self.occurrences[i]) for i in indices)

    def keep(self, which: NDArray[np.int64], when: FloatArray, states: FloatArray, steps: int) -> None:
        """Add k occurrences, which count once `steps` steps are accepted.

        `which` (k,) are the indices of the events, `when` (k,) the times in order; the states are (k, 2n).
        """
        if len(self.occurrences) == 1:
            self.occurrences[0].extend(when, states, steps)
        elif len(which):
            order = np.argsort(which, kind="stable")
            when, states = when[order], states[order]
            ends = np.cumsum(np.bincount(which, minlength=len(self.occurrences))).tolist()
            for zeros, begin, end in zip(self.occurrences, [0, *ends], ends, strict=False):
                zeros.extend(when[begin:end], states[begin:end], steps)

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of each event, (k,), up to the last accepted step."""
        return tuple(occurrences.until(self.steps)[0] for occurrences in self.occurrences)

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at each event, (k, 2n), up to the last accepted step."""
        return tuple(occurrences.until(self.steps)[1] for occurrences in self.occurrences)

    @property
    def steps(self) -> int:
        """Number of accepted steps of the run."""
        return 0 if self.state is None else self.state.count(DriverState.STEPS)


class ChangeCounter:
    """Counts changes of the motion, such as resets, at nearly one time, to detect that time does not advance."""

    def __init__(self) -> None:
        self.last = -math.inf
        self.counts: Counter[int] = Counter()

    def begin(self, t: float, which: int) -> None:
        """Restart the count with a change of the motion by event `which` at time t, far from all earlier changes."""
        self.counts = Counter([which])
        self.last = t

    def accumulates(self, t: float, which: Iterable[int]) -> bool:
        """Count changes by the events `which` at time t. Return True if one causes too many at nearly one time."""
        if abs(t - self.last) > CLOSEST * max(abs(t), EARLIEST):
            self.counts.clear()
        self.last = t
        self.counts.update(which)
        return max(self.counts.values()) > MOST_REPEATS


class ResetIntervals:
    """Detects that intervals between resets no longer decrease, because only rounding noise separates them."""

    def __init__(self) -> None:
        self.least = 0.0
        self.count = 0

    def begin(self, length: float) -> None:
        """Restart the count with an interval `length` between two resets, to which later ones are compared."""
        self.least, self.count = length, 0

    def idle(self, length: float, *, unseen: bool) -> bool:
        """Count an interval `length` between two resets. Return True if too many in a row no longer decrease.

        `unseen` is True if the event function did not exceed rounding noise in the interval.
        """
        if unseen and length >= SAME_INTERVAL * self.least:
            self.count += 1
        else:
            self.begin(length)
        return self.count > MOST_SAME
