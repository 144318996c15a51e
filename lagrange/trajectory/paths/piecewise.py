"""Dense output with one interpolant per step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.trajectory.trajectory import FloatArray


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
