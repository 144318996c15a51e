"""Dense output of a solver of another package: its interpolant over a step, sampled while the step is available."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from lagrange.algorithm.events.samples import nodes
from lagrange.machine.backend import Places
from lagrange.trajectory.trajectory import FloatArray

FEWEST_SPACINGS = 256
"""Length of a step, in spacings of the solver's times, below which its path is a straight line. A polynomial of degree
up to 12 through states at rounded times would oscillate.
"""


@dataclass(frozen=True, eq=False)
class StepInterpolant:
    """The polynomial over one step from the time `begin`, by its `values` (k, 2n) at Chebyshev points.

    `length` is the length of the step. The polynomial passes through both accepted states. The solver's own
    interpolant may miss them by the tolerance.
    """

    begin: float
    length: float
    values: FloatArray

    @classmethod
    def read(
        cls,
        times: tuple[float, float],
        ends: tuple[FloatArray, FloatArray],
        solver_times: tuple[float, float],
        interpolant: Callable[[FloatArray], FloatArray],
        degree: int,
    ) -> StepInterpolant:
        """Return the polynomial of a given `degree` over one step, sampled from a solver's interpolant.

        The step goes from the first to the second of `times`, and `ends` are the states (2n,) there, which the
        polynomial has exactly. `interpolant` maps times of the solver (k,) to states (2n, k). `solver_times` are the
        solver's times at both ends, which may count from another origin.
        """
        first, last = solver_times
        x = nodes(degree)[:, None]
        if len(x) == 2 or abs(last - first) < FEWEST_SPACINGS * float(np.spacing(max(abs(first), abs(last)))):
            values = (1 - x) * ends[0] + x * ends[1]
        else:
            inner = interpolant(first + x[1:-1, 0] * (last - first)).T
            values = np.concatenate([ends[0][None], inner, ends[1][None]])
            if not np.isfinite(inner).all():
                values = (1 - x) * ends[0] + x * ends[1]
        return cls(times[0], times[1] - times[0], values)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n, k) at times (k,) on the step."""
        shares = _shares(len(self.values), (times - self.begin) / self.length)
        return np.asarray((shares @ self.values).T)


class StepInterpolants(Sequence[StepInterpolant]):
    """The polynomials over the steps of a run, from the step with index `first` on. Each is made at its first access.

    `entries` has for each step its polynomial, or a function that makes it by sampling the solver's path. Sampling
    takes as long as a step of a fast solver, and few runs need states between their steps.
    """

    def __init__(self, entries: list[Any], first: int = 0) -> None:
        self._entries, self._first = entries, first

    def __reduce__(self) -> tuple[Any, ...]:
        return StepInterpolants, (list(self),)

    def __len__(self) -> int:
        return len(self._entries) - self._first

    def __getitem__(self, which: Any) -> Any:
        index = range(self._first, len(self._entries))[which]
        entry = self._entries[index]
        if isinstance(entry, partial):
            with np.errstate(all="ignore"):
                entry = self._entries[index] = entry()
        return entry


@dataclass(frozen=True, eq=False)
class SampledPath:
    """The path over accepted steps: times (S+1,), states (S+1, 2n), and polynomials of one degree, one per step."""

    times: FloatArray
    states: FloatArray
    interpolants: Sequence[StepInterpolant]

    def inside(self, steps: Places, theta: FloatArray) -> FloatArray:
        """Return the states (2n, k, K) at the fractions theta (K,) of each of k steps, which are given by index."""
        values = np.stack([self.interpolants[step].values for step in steps.tolist()])
        return np.asarray(np.moveaxis(_shares(values.shape[1], theta) @ values, -1, 0))


def _shares(count: int, theta: FloatArray) -> FloatArray:
    """Return the weights (K, count) with which values at `count` Chebyshev points enter the polynomial at theta (K,).

    The points and theta are fractions of a step. Source: J.-P. Berrut, L. N. Trefethen, Barycentric Lagrange
    interpolation, SIAM Review 46 (2004) 501, (4.2) and (5.4).
    """
    away = theta[:, None] - nodes(count - 1)
    hits = away == 0
    shares = np.where(hits.any(axis=1)[:, None], hits, _weights(count) / np.where(hits, 1.0, away))
    return np.asarray(shares / shares.sum(axis=1)[:, None])


@lru_cache(maxsize=16)
def _weights(count: int) -> FloatArray:
    weights = np.where(np.arange(count) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    return weights
