"""Dense output of a whole run: the stored states at the output times, and one interpolant per step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.errors import RunError
from lagrange.trajectory.paths.step_paths import sorted_along
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class OutputPath:
    """Output times (K,), rising or falling, the states (2n, K) at these times, and the path between them.

    `path` maps times (k,) to states (2n, k). It is None for a run that stored its outputs alone; `refusal` then
    states the cause and the remedy.
    """

    times: FloatArray
    states: FloatArray
    path: Callable[[FloatArray], FloatArray] | None
    refusal: str = ""

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, k) at times (k,) in any order.

        Raises RunError for a time between output times if there is no path.
        """
        forward = len(self.times) < 2 or bool(self.times[-1] >= self.times[0])
        return sorted_along(forward, times, self._sorted)

    def _sorted(self, requested_times: FloatArray) -> FloatArray:
        forward = len(self.times) < 2 or bool(self.times[-1] >= self.times[0])
        output_times, sought = (self.times, requested_times) if forward else (-self.times, -requested_times)
        index = np.searchsorted(output_times, sought, side="right") - 1
        is_inside = index >= 0
        is_inside[is_inside] = output_times[index[is_inside]] == sought[is_inside]
        if is_inside.all():
            return self.states[:, index]
        between = requested_times[~is_inside]
        if self.path is None:
            raise RunError(f"there is no state at t = {between[0]:.16g}: {self.refusal}")
        states = self.path(between)
        if not is_inside.any():
            return states
        result = np.empty((len(states), len(requested_times)))
        result[:, ~is_inside], result[:, is_inside] = states, self.states[:, index[is_inside]]
        return result


@dataclass(frozen=True, eq=False)
class PiecewisePath:
    """Dense output of a run with one interpolant per step: from times (K,) to states (2n, K).

    `edges` (steps + 1,) are the times of the accepted states, rising or falling. `start` (2n,) is the first state.
    `interpolants` are the functions between edges, from times (k,) to states (2n, k). At an edge the later interpolant
    is used.
    """

    edges: FloatArray
    start: FloatArray
    interpolants: Sequence[Callable[[FloatArray], FloatArray]]

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times (K,) in any order."""
        states = np.repeat(self.start[:, None], len(times), axis=1)
        if len(self.interpolants):
            forward = np.sign(self.edges[-1] - self.edges[0])
            steps = np.searchsorted(forward * self.edges, forward * times, side="right") - 1
            steps = np.clip(steps, 0, len(self.interpolants) - 1)
            order = np.argsort(steps, kind="stable")
            for group in np.split(order, np.flatnonzero(np.diff(steps[order])) + 1):
                if len(group):
                    states[:, group] = self.interpolants[steps[group[0]]](times[group])
        return states
