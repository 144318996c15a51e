"""Runs that approach a state with dependent constraints in ever shorter steps, and never reach it.

An example is a mass on a rod whose length r shrinks to zero: the rod turns faster and faster. A step takes a time of
order r**2, and a run needs about 1/r steps to reach the length r.
"""

from __future__ import annotations

from lagrange.equations.singular import Singular, least_regular, matrices_at, scales
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState

FIRST_TEST = 2**18
"""Number of steps before the first test of a run. Each further test is after twice as many steps. A test takes 0.1 ms.
"""

SLOWER, NEARER = 0.75, 0.75
"""Largest ratios of times, and of distances to the singular state, at successive tests. The number of steps doubles
from test to test. If both ratios are smaller, the run does not reach the state. With steps of equal time the first
ratio is 2.
"""

NEARLY_DEPENDENT = 1e-2
"""Constraints are nearly dependent if their least singular value is at most this fraction of its value at the start."""

State = tuple[float, FloatArray]
"""A time and a state (2n,)."""


def regularity(model: Model, parameters: FloatArray, start: State, here: State) -> tuple[float, Singular] | None:
    """Return the least singular value at `here`, relative to `start`, and the nearly singular rows or motion there.

    The matrices are the gradient G of the constraints and the mass matrix. Returns None if an entry is not finite.
    """
    before = matrices_at(model, model.equations, *start, parameters)
    scale = scales(*before)
    first = least_regular(*before, scale)
    singular = least_regular(*matrices_at(model, model.equations, *here, parameters), scale)
    if first is None or singular is None or not first.regularity:
        return None
    return singular.regularity / first.regularity, singular


class Approach:
    """Test, made after some steps, whether a run with constraints approaches a singular state without reaching it."""

    def __init__(self, model: Model, parameters: FloatArray, start: State) -> None:
        self.model, self.parameters, self.start = model, parameters, start
        self.next_test = FIRST_TEST
        self.times = [start[0]]
        self.nearness = [1.0]

    def ends(self, state: DriverState) -> tuple[float, Singular] | None:
        """Return the result of `regularity` if the run approaches a singular state and should end here, else None."""
        steps = int(state.integers[DriverState.STEPS])
        if steps < self.next_test:
            return None
        self.next_test = 2 * steps
        here = regularity(self.model, self.parameters, self.start, (state.t, state.y))
        share = 1.0 if here is None else here[0]
        self.times.append(state.t)
        self.nearness.append(share)
        if len(self.times) < 4 or share > NEARLY_DEPENDENT:
            return None
        last, before = (abs(end - begin) for end, begin in zip(self.times[-1:-3:-1], self.times[-2:-4:-1], strict=True))
        slower = last <= SLOWER * before
        nearer = all(b <= NEARER * a for a, b in zip(self.nearness[-3:-1], self.nearness[-2:], strict=True))
        return here if slower and nearer else None
