"""Record the occurrences of events, and detect events that accumulate, so that time does not advance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import EARLIEST
from lagrange.algorithm.events.constants import CLOSEST
from lagrange.algorithm.events.roots import first_change
from lagrange.machine.state import DriverState
from lagrange.trajectory.events.array_search import EventZero
from lagrange.trajectory.events.model_events import ModelEvent
from lagrange.trajectory.trajectory import FloatArray

MOST_REPEATS = 3
"""Largest number of resets, or other changes of the motion, that one event may cause at nearly the same time. With more
changes the run ends."""

SAME_INTERVAL, MOST_SAME = 0.999, 8
"""Test for resets that only rounding noise separates. An interval between two resets does not decrease if its length is
at least the first number times the shortest interval before it. The second number is the largest number of intervals in
succession that do not decrease."""


class Occurrences:
    """The occurrences of one event in order, with their times and states. `size` is the length of a state, 2n."""

    def __init__(self, size: int) -> None:
        self._parts: list[tuple[FloatArray, FloatArray, int, object]] = []
        self._count, self._size = 0, size

    def __len__(self) -> int:
        return self._count

    def append(self, t: float, y: FloatArray, steps: int) -> None:
        """Add an occurrence at time t and state y (2n,). It counts as soon as the run has `steps` accepted steps."""
        self.extend(np.array([t]), y[None], steps)

    def extend(self, t: FloatArray, y: FloatArray, steps: int, mark: object = None) -> None:
        """Add occurrences at times (k,) and states (k, 2n).

        They count as soon as the run has `steps` accepted steps. `mark` identifies the added occurrences: a second
        call in succession with the same mark has no effect. An interrupted call may therefore be repeated.
        """
        again = mark is not None and bool(self._parts) and self._parts[-1][3] == mark
        if len(t) and not again:
            self._parts.append((t, y, steps, mark))
            self._count += len(t)

    def until(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Return the times (k,) and states (k, 2n) of the occurrences in the first `steps` accepted steps."""
        parts = [part for part in self._parts if part[2] <= steps]
        if len(parts) == 1:
            return parts[0][0], parts[0][1]
        if not parts:
            return np.empty(0), np.empty((0, self._size))
        times, states, _, _ = zip(*parts, strict=True)
        return np.concatenate(times), np.concatenate(states)


class Breaks:
    """The breaks of a run: the points at which one smooth piece of motion ends and the next one begins.

    A break is stored as a row: the index of the last stored state of the earlier piece. The step that ends at a break
    may have been shortened. Then the time and state at the end of the full step are stored too. They are NaN for other
    steps. `size` is the length 2n of a state.
    """

    def __init__(self, size: int) -> None:
        self._parts = [(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, size)))]
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: int, whole: tuple[float, FloatArray] | None) -> None:
        """Add a break, where a new smooth piece of motion begins, after the stored state with index `row`.

        `whole` is the time and state at the end of the full step if the step was shortened, else None.
        """
        end, state = (math.nan, np.full(self._parts[0][2].shape[1], math.nan)) if whole is None else whole
        self.extend(np.array([row]), np.array([end]), state[None])

    def extend(self, rows: NDArray[np.int64], times: FloatArray, states: FloatArray) -> None:
        """Add breaks, where new smooth pieces of motion begin, after the stored states with the indices `rows` (k,).

        If the step that ends at a break was shortened, `times` (k,) and `states` (k, 2n) have the end of the full step.
        They are NaN for other steps.
        """
        if len(rows):
            self._parts.append((rows, times, states))
            self._count += len(rows)

    def since(self, first: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Return the rows (k,), times (k,) and states (k, 2n) of all breaks except the first `first` ones.

        A row is the index of the stored state before the break. Times and states are the ends of the full steps that
        were shortened, NaN for other steps.
        """
        parts, begin = [], self._count
        for part in reversed(self._parts):
            parts.append(part)
            begin -= len(part[0])
            if begin <= first:
                break
        rows, times, states = (np.concatenate(arrays) for arrays in zip(*reversed(parts), strict=True))
        return rows[first - begin :], times[first - begin :], states[first - begin :]


def until_end(events: Sequence[ModelEvent], occurrences: Sequence[Occurrences]) -> list[int]:
    """Return for each event the number of further occurrences after which it ends the run, or 0 for never.

    `occurrences` are the occurrences of each event so far.
    """
    return [max(event.terminal - len(earlier), 0) for event, earlier in zip(events, occurrences, strict=True)]


class EventLog:
    """The occurrences of each event along a run. `state` is the driver's present state, None before the run.

    `events` is the number of events, and `size` the length 2n of a state.
    """

    def __init__(self, events: int, size: int) -> None:
        self.occurrences = [Occurrences(size) for _ in range(events)]
        self.state: DriverState | None = None

    def change_among(self, zeros: Sequence[EventZero], events: Sequence[ModelEvent]) -> EventZero | None:
        """Return the first of some zeros whose event resets the state or ends the run, or None.

        `zeros` are in order of time. Each has the index of its event in `events`, which are all events of the run.
        """
        remaining = np.where([event.reset for event in events], 1, until_end(events, self.occurrences))
        functions, directions = [zero.which for zero in zeros], [zero.root.rising for zero in zeros]
        expected = [event.direction for event in events]
        change = first_change(len(zeros), functions, directions, expected, remaining)
        return None if change < 0 else zeros[change]

    def occur(self, indices: Sequence[int], events: Sequence[ModelEvent], state: DriverState) -> bool:
        """Record an occurrence of some events at the present state. Return True if one of them ends the run.

        `events` has all events of the run. `indices` are indices in `events`.
        """
        for i in indices:
            self.occurrences[i].append(state.t, state.y.copy(), state.count(DriverState.STEPS))
        return any(0 < events[i].terminal <= len(self.occurrences[i]) for i in indices)

    def keep(self, which: NDArray[np.int64], when: FloatArray, states: FloatArray, steps: int) -> None:
        """Add k occurrences, in order of time. They count as soon as the run has `steps` accepted steps.

        `which` (k,) are the indices of their events, `when` (k,) the times, and `states` (k, 2n) the states.
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
    """Counts changes of the motion, such as resets, at nearly one time: too many mean that the run does not advance."""

    def __init__(self) -> None:
        self.last = -math.inf
        self.counts: Counter[int] = Counter()

    def begin(self, t: float, which: int) -> None:
        """Restart the count at time t with one change of the motion, by the event with index `which`."""
        self.counts = Counter([which])
        self.last = t

    def accumulates(self, t: float, which: Iterable[int]) -> bool:
        """Count a change of the motion at time t by each of the events `which` (indices).

        Return True if one event has caused more than `MOST_REPEATS` changes at nearly the same time: the run then does
        not advance. Changes at other times are not counted.
        """
        if abs(t - self.last) > CLOSEST * max(abs(t), EARLIEST):
            self.counts.clear()
        self.last = t
        self.counts.update(which)
        return max(self.counts.values()) > MOST_REPEATS


class ResetIntervals:
    """Detects that intervals between resets no longer decrease, so that only rounding noise separates the resets."""

    def __init__(self) -> None:
        self.least = 0.0
        self.count = 0

    def begin(self, length: float) -> None:
        """Restart the count. Later intervals between two resets are compared to this interval `length`."""
        self.least, self.count = length, 0

    def idle(self, length: float, *, unseen: bool) -> bool:
        """Count an interval between two resets. Return True if too many intervals in succession do not decrease.

        `length` is the duration of the interval. `unseen` is True if the event function was within rounding noise
        during the interval. Only such intervals count; any other restarts the count.
        """
        if unseen and length >= SAME_INTERVAL * self.least:
            self.count += 1
        else:
            self.begin(length)
        return self.count > MOST_SAME
