"""Store the states of a run: accepted states, which may be dropped to save memory, and states at output times."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.errors import StatementError
from lagrange.machine.state import DriverState
from lagrange.statement.expression import real_array
from lagrange.trajectory.constraints.discontinuities import Discontinuities, Discontinuity
from lagrange.trajectory.dense_output import StepPath
from lagrange.trajectory.events.event_log import Breaks
from lagrange.trajectory.events.time_switches import TimeSwitches
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray

SPAN_ROUND_OFF = 1e-12
"""Output times beyond an end of the span by less than this relative amount are set to that end."""

SPARE_ROWS = WIDEST_VECTOR // 2
"""Number of unused rows that follow the rows of a driver call. Drivers write whole vectors, which may extend beyond the
last state by this number of rows, since a state has at least two numbers."""

PathOf = Callable[[FloatArray, FloatArray], StepPath]
"""Function that returns the dense output through accepted times (S+1,) and states (S+1, 2n)."""


class WrittenStates(NamedTuple):
    """Accepted times (k,) and states (k, 2n) of a run that driver call number `call` wrote."""

    times: FloatArray
    states: FloatArray
    call: int


class AcceptedStates:
    """The accepted states of a run so far, in the parts that the calls of the driver wrote.

    With `outputs_alone`, all states but the last may be dropped when memory is used up. `dropped` is then True, and
    `removed` is the number of dropped parts. `followed` evaluates the states at output times during the run, or is
    None. `discontinuities` searches steps for jumps and corners of constraints, or is None; the run ends at the first
    one, which is then in `passed`. `switches` ends steps at the times at which forces switch, or is None.
    """

    def __init__(self, t: float, y: FloatArray, *, outputs_alone: bool = False) -> None:
        self.parts = [WrittenStates(np.array([t]), y[None].copy(), 0)]
        self.bytes = 0
        self.outputs_alone, self.removed = outputs_alone, 0
        self.followed: FollowedSteps | None = None
        self.discontinuities: Discontinuities | None = None
        self.passed: Discontinuity | None = None
        self.switches: TimeSwitches | None = None
        self._looked_at, self._calls = 1, 0
        self._times, self._rows = self.parts[0].times[:0], self.parts[0].states[:0]
        self._begin, self._each = self.parts[0], 8 * (len(y) + 1)
        self._sizes: FloatArray | None = None

    @property
    def dropped(self) -> bool:
        """True if accepted states were dropped because memory was used up."""
        return self.removed > 0

    def add(self, t: float, y: FloatArray) -> None:
        """Append the state y (2n,) that the motion reached by a jump at time t, without a step."""
        self.parts.append(WrittenStates(np.array([t]), y[None].copy(), self.parts[-1].call))

    def begin_call(self, budget: int) -> tuple[FloatArray, FloatArray]:
        """Return memory for the times and states that the next call of the driver accepts, at most `budget` steps.

        Each step and each reset takes a row. One more row is reserved for the last step.
        """
        self._times, self._rows = np.empty(budget + 1), np.empty((budget + 1 + SPARE_ROWS, self._rows.shape[1]))
        self._calls += 1
        return self._times, self._rows

    def collect(self, state: DriverState) -> None:
        """Store the accepted states of the last driver call. A second call, as after Ctrl-C, has no effect."""
        written, times, rows = state.count(DriverState.ROWS), self._times, self._rows
        if written and self.parts[-1].call < self._calls:
            # A view of a few rows would keep the memory of all rows.
            short = 2 * written < len(times)
            t, y = times[:written], rows[:written]
            self.bytes += t.nbytes + y.nbytes if short else times.nbytes + rows.nbytes
            self.parts.append(WrittenStates(t.copy() if short else t, y.copy() if short else y, self._calls))

    def follow(self, *, last: bool = False) -> None:
        """Evaluate the states at the output times on the steps since the last call.

        `last` is True if no more steps follow. Nothing happens if these states are not evaluated during the run, so
        that `followed` is None.
        """
        if self.followed is not None:
            self.followed.follow(self.parts, self.removed, last=last)

    def discontinuity(self) -> Discontinuity | None:
        """Search the steps since the last call, and return the first discontinuity of the constraints, or None."""
        if self.discontinuities is not None:
            before, *new = self.parts[self._looked_at - self.removed - 1 :]
            if new:
                self._looked_at = self.removed + len(self.parts)
                times = np.concatenate([before.times[-1:], *(part.times for part in new)])
                states = np.concatenate([before.states[-1:], *(part.states for part in new)])
                self.passed = self.discontinuities.on(times, states)
        return self.passed

    def make_room(self, limit: float) -> int:
        """Return the number of further states that fit into memory. `limit` is the size of this memory in bytes.

        The states at output times on new steps are evaluated first. If no memory is left and `outputs_alone` is True,
        the stored states are dropped.
        """
        self.follow()
        free_rows = int(limit - self.bytes) // self._each
        if free_rows > 0 or not self.outputs_alone:
            return free_rows
        # Keep the largest size of each entry, and the last state.
        self._sizes, last = self._largest(), self.parts[-1]
        self.removed += len(self.parts) - 1
        self.parts = [last._replace(times=last.times[-1:].copy(), states=last.states[-1:].copy())]
        self.bytes = 0
        return int(limit) // self._each

    def joined(self) -> tuple[FloatArray, FloatArray]:
        """Return the accepted times (S+1,) and states (S+1, 2n).

        After states were dropped there are three rows: the start, the largest sizes of the entries, and the end.
        """
        if self.removed:
            begin, end = self._begin, self.parts[-1]
            states = np.array([begin.states[0], self._largest(), end.states[-1]])
            return np.concatenate([begin.times, end.times[-1:], end.times[-1:]]), states
        all_times, all_states, _ = zip(*self.parts, strict=True)
        return np.concatenate(all_times), np.concatenate(all_states)

    def _largest(self) -> FloatArray:
        before = [] if self._sizes is None else [self._sizes]
        return np.asarray(np.max([*before, *(np.abs(part.states).max(axis=0) for part in self.parts)], axis=0))


class FollowedSteps:
    """Evaluates the states at output times during a run, from the dense output of its steps.

    It is not used for Taylor steps, whose driver writes these states. Since a dense output may use the previous step,
    the last two states of a smooth piece are kept until the next call. `breaks` are the rows after which another smooth
    piece begins, which the search for events records. It is None without events. `_known` is replaced by one
    assignment, so Ctrl-C leaves it consistent.
    """

    def __init__(self, problem: Problem, times: FloatArray, path_of: PathOf, breaks: Breaks | None) -> None:
        self._times, self._path_of = times, path_of
        self._breaks = Breaks(len(problem.y0)) if breaks is None else breaks
        self._rising = times if problem.t1 >= problem.t0 else -times
        self._forward = 1.0 if problem.t1 >= problem.t0 else -1.0
        self._y = np.empty((len(problem.y0), len(times)))
        self._done = 0
        self._known = np.array([problem.t0]), problem.y0[None], 0, 0, 1
        """Where the next call continues: the times and states of the accepted rows that were kept for it, the index of
        the first of these rows in the run, the number of breaks before them, and the number of parts of the accepted
        states that were read."""

    def joined(self, count: int, last: FloatArray) -> FloatArray:
        """Return the states (2n, count) at the first `count` output times.

        `last` (2n,) is the state at output times that were not evaluated yet.
        """
        self._y[:, self._done : count] = last[:, None]
        return np.ascontiguousarray(self._y[:, :count])

    def follow(self, parts: Sequence[WrittenStates], removed: int, *, last: bool) -> None:
        """Evaluate the states at the output times on the new parts of the accepted states.

        `parts` are all stored parts, old and new. `removed` is the number of parts that were dropped before them.
        `last` is True if no step follows.
        """
        times, states, first, ended, seen = self._known
        new = parts[seen - removed :]
        times = np.concatenate([times, *(part.times for part in new)])
        states = np.concatenate([states, *(part.states for part in new)])
        rows, ends, whole = self._breaks.since(ended)
        break_rows = rows[rows < first + len(times)] - first
        begins, lasts = np.append(0, break_rows + 1), np.append(break_rows, len(times) - 1)
        until = np.searchsorted(self._rising, self._forward * times[lasts])
        # Evaluate the smooth pieces that contain output times.
        for motion in np.flatnonzero(np.diff(until, prepend=self._done) > 0).tolist():
            begin, end = int(begins[motion]), int(lasts[motion])
            if motion == len(break_rows) and not last:
                break
            t, y = times[begin : end + 1], states[begin : end + 1]
            if motion < len(break_rows) and not math.isnan(ends[motion]):
                t, y = np.append(t[:-1], ends[motion]), np.concatenate([y[:-1], whole[motion][None]])
            if len(t) > 1:
                self._write(t, y, float(times[end]))
        # The present smooth piece continues: the next call needs its last two rows again.
        t, y = times[begins[-1] :], states[begins[-1] :]
        keep = min(1, len(t)) if last else min(2, len(t))
        if not last and len(t) > 2:
            self._write(t, y, float(t[-1]))
        kept = times[len(times) - keep :].copy(), states[len(times) - keep :].copy()
        self._known = *kept, first + len(times) - keep, ended + len(break_rows), removed + len(parts)

    def _write(self, times: FloatArray, states: FloatArray, end: float) -> None:
        """Evaluate and store the states at output times up to the time `end`, by the dense output of steps.

        `times` (k,) and `states` (k, 2n) are the ends of these steps, which follow one another.
        """
        until = self._done + int(np.searchsorted(self._rising[self._done :], self._forward * end))
        if self._done < until:
            self._path_of(times, states).write(self._times[self._done : until], self._y[:, self._done : until])
            self._done = until


def output_times(t_eval: ArrayLike | None, t0: float, t1: float, width: int) -> FloatArray | None:
    """Return the output times `t_eval` of a run from t0 to t1 as a checked array (N,), or None if there are none.

    `width` is the size of a state, for the message if memory does not suffice. Raises StatementError for times outside
    the span, or not sorted in the direction of the run.
    """
    if t_eval is None:
        return None
    times = real_array(t_eval, "t_eval", width=width)
    if times.ndim != 1:
        raise StatementError(
            f"t_eval has shape {times.shape}: give a list of times, such as np.linspace({t0:g}, {t1:g}, 1000)."
        )
    low, high = min(t0, t1), max(t0, t1)
    sorted_along = times[1:] >= times[:-1] if t1 >= t0 else times[1:] <= times[:-1]
    ends = (float(times[0]), float(times[-1])) if times.size and sorted_along.all() else (-math.inf, math.inf)
    if low <= min(ends) and max(ends) <= high:
        return times
    slack = SPAN_ROUND_OFF * (high - low)
    if times.size and not (times.min() >= low and times.max() <= high):
        times = np.where((times > high) & (times <= high + slack), high, times)
        times = np.where((times < low) & (times >= low - slack), low, times)
        outside = times[~((times >= low) & (times <= high))]
        if outside.size:
            raise StatementError(f"t_eval contains {outside[0]:.17g}, outside the time span from {t0:g} to {t1:g}.")
    direction = 1 if t1 >= t0 else -1
    if (np.diff(times) * direction < 0).any():
        raise StatementError(
            "t_eval is not sorted in the direction of the run: give the times in "
            f"{'decreasing' if direction < 0 else 'increasing'} order."
        )
    return times
