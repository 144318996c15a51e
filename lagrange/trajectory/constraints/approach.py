"""Runs that come ever nearer to a state where constraints are dependent, in more and more steps, and never get there.

A mass on a rod that shrinks to a point turns faster and faster: with the length r of the rod a step takes a time of
r**2, and the steps to a length r are as many as 1/r.
"""

from __future__ import annotations

import numpy as np

from lagrange.equations.singular import Singular, least_regular, matrices_at, scales
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.trajectory.constraints.residuals import residuals_of

FIRST_TEST = 2**18
"""Steps after which a run is tested first, and then at each double of that: a test takes 0.1 ms."""

SLOWER, NEARER = 0.75, 0.75
"""Ratios of times and of distances at successive tests, each at twice the steps of the one before.

A run does not get there where both are no larger. With steps of equal time the first is 2."""

NEAR = 1e-2
"""Constraints are nearly dependent where their least singular value is this part of that at the start, or less."""

State = tuple[float, FloatArray]
"""A time and a state (2n,)."""


def regularity(model: Model, parameters: FloatArray, start: State, here: State) -> tuple[float, Singular] | None:
    """Return how near M and G are to being singular at a state, relative to the start, and what is; None if unknown."""
    before = matrices_at(model, model.equations, *start, parameters)
    scale = scales(*before)
    first = least_regular(*before, scale)
    found = least_regular(*matrices_at(model, model.equations, *here, parameters), scale)
    if first is None or found is None or not first.regularity:
        return None
    return found.regularity / first.regularity, found


class Independence:
    """How independent the constraints of a model are: the least singular value of G relative to that at a start.

    The rows of G are in units of their lengths there.
    """

    def __init__(self, model: Model, parameters: FloatArray, start: State) -> None:
        self.start, self._parameters, self._residuals = start, parameters, residuals_of(model)
        self._rows = [self._residuals.names.index(name) for name in model.equations.constraints.names]
        first = self._residuals.gradient(*start, parameters)[self._rows]
        lengths = np.sqrt((first**2).sum(axis=1))
        self._lengths, self._first = np.where(lengths > 0, lengths, 1.0)[:, None], 1.0
        self._first = self.at(*start) or 1.0

    def at(self, t: float, y: FloatArray) -> float:
        """Return that value at a state (2n,); infinity where it is not known."""
        rows = self._residuals.gradient(t, y, self._parameters)[self._rows] / self._lengths
        if not np.isfinite(rows).all():
            return np.inf
        return float(np.linalg.svd(rows, compute_uv=False)[-1]) / self._first


class Approach:
    """Tests, now and then, whether a run with constraints comes ever nearer to a singular state."""

    def __init__(self, model: Model, parameters: FloatArray, start: State) -> None:
        self.model, self.parameters, self.start = model, parameters, start
        self.next_test = FIRST_TEST
        self.times = [start[0]]
        self.nearness = [1.0]

    def ends(self, state: DriverState) -> tuple[float, Singular] | None:
        """Return how near a run is to a singular state that it will not get to, and what is singular there; or None."""
        steps = int(state.integers[DriverState.STEPS])
        if steps < self.next_test:
            return None
        self.next_test = 2 * steps
        here = regularity(self.model, self.parameters, self.start, (state.t, state.y))
        share = 1.0 if here is None else here[0]
        self.times.append(state.t)
        self.nearness.append(share)
        if len(self.times) < 4 or share > NEAR:
            return None
        last, before = (abs(end - begin) for end, begin in zip(self.times[-1:-3:-1], self.times[-2:-4:-1], strict=True))
        slower = last <= SLOWER * before
        nearer = all(b <= NEARER * a for a, b in zip(self.nearness[-3:-1], self.nearness[-2:], strict=True))
        return here if slower and nearer else None
