"""Dense output of Taylor steps: the series, computed again for the requested steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lagrange.machine.backend import Series
from lagrange.trajectory.paths.step_paths import sorted_along
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class SeriesPath:
    """The path over accepted steps by Taylor series: times (S+1,), states (S+1, 2n), and the series of a given order.

    `epochs` are pairs of a step index and an array: the parameters, and the signs of switching surfaces, from this
    step on. `continuations` maps the indices of steps without a series to their dense output.
    """

    series: Series
    order: int
    epochs: tuple[tuple[int, FloatArray], ...]
    times: FloatArray
    states: FloatArray
    continuations: Mapping[int, Callable[[FloatArray], FloatArray]] = field(default_factory=dict)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order."""
        if len(self.times) < 2 or not len(times):
            return np.repeat(self.states[:1].T, len(times), axis=1)
        return sorted_along(bool(self.times[-1] >= self.times[0]), times, self._sorted)

    def _sorted(self, requested_times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at `requested_times` (K,), which are sorted in the direction of the run."""
        states = np.empty((self.states.shape[1], len(requested_times)))
        if len(self.epochs) == 1 and not self.continuations:
            self.series.dense(self.order, self.epochs[0][1]).at(self.times, self.states, requested_times, states)
            return states
        sign = 1.0 if self.times[-1] >= self.times[0] else -1.0
        steps = np.searchsorted(sign * self.times, sign * requested_times, side="right") - 1
        steps = np.clip(steps, 0, len(self.times) - 2)
        begins = np.searchsorted(steps, [begin for begin, _ in self.epochs]).tolist()
        for (_, values), first, last in zip(self.epochs, begins, [*begins[1:], len(steps)], strict=True):
            if first < last:
                part = slice(first, last)
                self.series.dense(self.order, values).at(
                    self.times, self.states, requested_times[part], states[:, part]
                )
        for step, path in self.continuations.items():
            first, last = np.searchsorted(steps, [step, step + 1])
            if first < last:
                states[:, first:last] = path(requested_times[first:last])
        return states
