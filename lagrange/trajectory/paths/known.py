"""Dense output that returns exactly the output states of a run at the output times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lagrange.errors import RunError
from lagrange.trajectory.paths.step_paths import sorted_along
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class OutputPath:
    """Output times (K,), rising or falling, their states (2n, K), and the path between them.

    A run that stored only its outputs has no path; `refusal` then gives the cause and the remedy.
    """

    times: FloatArray
    states: FloatArray
    path: Callable[[FloatArray], FloatArray] | None
    refusal: str = ""

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, K) at times in any order.

        Raises RunError for a time between output times if there is no path.
        """
        forward = len(self.times) < 2 or bool(self.times[-1] >= self.times[0])
        return sorted_along(forward, times, self._sorted)

    def _sorted(self, wanted: FloatArray) -> FloatArray:
        forward = len(self.times) < 2 or bool(self.times[-1] >= self.times[0])
        output_times, sought = (self.times, wanted) if forward else (-self.times, -wanted)
        index = np.searchsorted(output_times, sought, side="right") - 1
        is_inside = index >= 0
        is_inside[is_inside] = output_times[index[is_inside]] == sought[is_inside]
        if is_inside.all():
            return self.states[:, index]
        states = self._between(wanted[~is_inside])
        if not is_inside.any():
            return states
        result = np.empty((len(states), len(wanted)))
        result[:, ~is_inside], result[:, is_inside] = states, self.states[:, index[is_inside]]
        return result

    def _between(self, times: FloatArray) -> FloatArray:
        if self.path is None:
            raise RunError(f"there is no state at t = {times[0]:.16g}: {self.refusal}")
        return self.path(times)
