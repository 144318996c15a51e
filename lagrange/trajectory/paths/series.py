"""Dense output of Taylor steps: the series, computed again for the steps that are requested."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lagrange.machine.backend import Series, SingularMassMatrix
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class SeriesPath:
    """Accepted steps, times (S+1,) and states (S+1, 2n), and the series that leads from each to the next.

    `epochs` says from which step on which parameters and sides hold;
    `continuations` has the paths of steps without a series.
    """

    series: Series
    order: int
    epochs: tuple[tuple[int, FloatArray], ...]
    times: FloatArray
    states: FloatArray
    continuations: Mapping[int, Callable[[FloatArray], FloatArray]] = field(default_factory=dict)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states at the times, in any order, (2n, K)."""
        states = np.repeat(self.states[:1].T, len(times), axis=1)
        if len(self.times) < 2:
            return states
        forward = 1.0 if self.times[-1] >= self.times[0] else -1.0
        found = np.searchsorted(forward * self.times, forward * times, side="right") - 1
        found = np.clip(found, 0, len(self.times) - 2)
        order = np.argsort(found, kind="stable")
        for group in np.split(order, np.flatnonzero(np.diff(found[order])) + 1):
            if len(group):
                states[:, group] = self._piece(int(found[group[0]]), times[group])
        exact = self.times[found + 1] == times
        states[:, exact] = self.states[found[exact] + 1].T
        return states

    def _values(self, step: int) -> FloatArray:
        """Return the parameters and sides of a step."""
        return next(values for begin, values in reversed(self.epochs) if begin <= step)

    def _piece(self, step: int, times: FloatArray) -> FloatArray:
        """Return the states (2n, k) at times within one step."""
        if step in self.continuations:
            return self.continuations[step](times)
        t, y = float(self.times[step]), self.states[step]
        span = float(self.times[step + 1]) - t
        scale = math.copysign(2.0 ** round(math.log2(abs(span))), span) if span else 1.0
        try:
            rows = self.series.rows(self.order, t, y, scale, self._values(step))
        except SingularMassMatrix:
            return np.full((len(y), len(times)), np.nan)
        s = (times - t) / scale
        total: FloatArray = np.zeros((len(y), len(times)))
        for row in rows[:0:-1, : len(y)]:
            total = (total + row[:, None]) * s
        total += y[:, None]
        return total
