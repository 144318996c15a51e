"""Runs that come ever nearer to a state where constraints are dependent, in more and more steps, and never get there.

A mass on a rod that shrinks to a point turns faster and faster: with the length r of the rod a step takes a time of
r**2, and the steps to a length r are as many as 1/r.
"""

from __future__ import annotations

from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.singular import Singular, least_regular, matrices_at, scales
from lagrange.machine.state import DriverState

FIRST_LOOK = 2**18
"""The number of steps at which a run is looked at first, and then at each double of it: a look takes 0.1 ms."""

SLOWER, NEARER = 0.75, 0.75
"""A run does not get there if it takes so much less time for the second half of its steps than for the quarter before
it, and is so much nearer; with steps of equal time it takes twice as much."""

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


class Approach:
    """Looks at a run with constraints now and then."""

    def __init__(self, model: Model, parameters: FloatArray, start: State) -> None:
        self.model, self.parameters, self.start = model, parameters, start
        self.next_look = FIRST_LOOK
        self.times = [start[0]]
        self.nearness = [1.0]

    def ends(self, state: DriverState) -> tuple[float, Singular] | None:
        """Return how near a run is to a singular state that it will not get to, and what is singular there; or None."""
        steps = int(state.integers[DriverState.STEPS])
        if steps < self.next_look:
            return None
        self.next_look = 2 * steps
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
