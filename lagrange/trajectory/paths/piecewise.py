"""Paths made of several: one interpolant for each step, or one path for each motion between two resets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class PiecewisePath:
    """Dense output of a run with one interpolant per step: from times (K,) to states (2n, K).

    `edges` (steps + 1,) are the times of the accepted states, rising or falling, `start` (2n,) the first state, and
    `interpolants` the functions between, from times (k,) to states (2n, k). At a joint the later one is used.
    """

    edges: FloatArray
    start: FloatArray
    interpolants: Sequence[Callable[[FloatArray], FloatArray]]

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, in any order, (2n, K)."""
        states = np.repeat(self.start[:, None], len(times), axis=1)
        if len(self.interpolants):
            forward = np.sign(self.edges[-1] - self.edges[0])
            found = np.searchsorted(forward * self.edges, forward * times, side="right") - 1
            found = np.clip(found, 0, len(self.interpolants) - 1)
            order = np.argsort(found, kind="stable")
            for group in np.split(order, np.flatnonzero(np.diff(found[order])) + 1):
                if len(group):
                    states[:, group] = self.interpolants[found[group[0]]](times[group])
        return states


@dataclass(frozen=True, eq=False)
class MotionsPath:
    """Dense output of a run with resets: the path of each motion by itself, from times (K,) to states (2n, K).

    `times` (S+1,) and `states` (S+1, 2n) are those of the run. Behind some rows the motion is another; the step before
    may have been cut: its whole end, at a time that is NaN for none, is what its path goes through. `path_of` makes the
    path through the states of a motion, when it is asked for.
    """

    times: FloatArray
    states: FloatArray
    breaks: tuple[NDArray[np.int64], FloatArray, FloatArray]
    path_of: Callable[[FloatArray, FloatArray], Callable[[FloatArray], FloatArray]]

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, in any order, (2n, K); at a reset that behind it."""
        found = np.empty((self.states.shape[1], len(times)))
        rows = self.breaks[0][self.breaks[0] < len(self.times) - 1]
        forward = 1.0 if self.times[-1] >= self.times[0] else -1.0
        motions = np.searchsorted(forward * self.times[rows], forward * times, side="right")
        order = np.argsort(motions, kind="stable")
        for group in np.split(order, np.flatnonzero(np.diff(motions[order])) + 1):
            if len(group):
                found[:, group] = self._motion(int(motions[group[0]]))(times[group])
        return found

    def _motion(self, number: int) -> Callable[[FloatArray], FloatArray]:
        """Return the path of a motion by its number."""
        rows, ends, whole = self.breaks
        begin = int(rows[number - 1]) + 1 if number else 0
        last = int(rows[number]) if number < len(rows) else len(self.times) - 1
        t, y = self.times[begin : last + 1], self.states[begin : last + 1]
        if number < len(rows) and not np.isnan(ends[number]):
            t, y = np.append(t[:-1], ends[number]), np.concatenate([y[:-1], whole[number][None]])
        return self.path_of(t, y)
