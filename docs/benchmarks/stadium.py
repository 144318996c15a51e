"""A stadium billiard, for lagrange and for heyoka: a free particle between two lines and two half circles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import heyoka as hy
import numpy as np
from sympy import Max, Min, Piecewise

import lagrange as lg

HALF_LENGTH = 1.0
START = (0.1, 0.2, np.cos(1.1), np.sin(1.1))
"""x, y and the velocity, of length 1."""

INSIDE = 1 - 1e-6
"""The square of the distance from the middle line above which a state is on the wall, and not on a circle inside."""

LONGEST_STEP = 10.0
"""heyoka's: the series of a free particle ends, and nothing else bounds its steps."""


def stadium() -> lg.System:
    """Return a free particle."""
    x, y = lg.coordinates("x y")
    return lg.System(kinetic=lg.kinetic_energy(1, (x, y)), coordinates=[x, y], name="stadium")


def walls(system: lg.System) -> list[lg.Event]:
    """Return the upper and lower line, and the circles around both ends, parts of which are inside.

    All reflect along the normal of the wall that is nearest, so that they agree where line and circle meet.
    """
    x, y = system.coordinates
    out = x - Max(-HALF_LENGTH, Min(HALF_LENGTH, x))
    square = out**2 + y**2
    factor = Piecewise((2 * (out * x.dot + y * y.dot) / square, square > INSIDE), (0, True))
    reset = {x.dot: x.dot - factor * out, y.dot: y.dot - factor * y}
    return [
        lg.event(y - 1, direction=1, reset=reset),
        lg.event(y + 1, direction=-1, reset=reset),
        lg.event((x - HALF_LENGTH) ** 2 + y**2 - 1, direction=1, reset=reset),
        lg.event((x + HALF_LENGTH) ** 2 + y**2 - 1, direction=1, reset=reset),
    ]


def reflections(solution: lg.Solution) -> int:
    """Return how many events of a run were reflections: a circle is also passed inside the stadium."""
    upper, lower, right, left = solution.y_events
    return len(upper) + len(lower) + int((right[:, 0] > HALF_LENGTH).sum() + (left[:, 0] < -HALF_LENGTH).sum())


def rival_stadium(t_end: float, tolerance: float) -> Callable[[], int]:
    """Return the run by heyoka, with terminal events and a callback; it returns the number of reflections."""
    x, y, u, v = hy.make_vars("x", "y", "u", "v")
    count = [0]

    def line(taylor: Any, _: int) -> bool:
        taylor.state[3] = -taylor.state[3]
        count[0] += 1
        return True

    def circle(end: float, taylor: Any, _: int) -> bool:
        state = taylor.state
        out = state[0] - end
        if out * end > 0:
            factor = 2 * (out * state[2] + state[1] * state[3]) / (out * out + state[1] * state[1])
            state[2] -= factor * out
            state[3] -= factor * state[1]
            count[0] += 1
        return True

    rising, falling = hy.event_direction.positive, hy.event_direction.negative
    events = [
        hy.t_event(y - 1.0, callback=line, direction=rising),
        hy.t_event(y + 1.0, callback=line, direction=falling),
    ]
    for end in (HALF_LENGTH, -HALF_LENGTH):
        events.append(
            hy.t_event(
                (x - end) ** 2 + y**2 - 1.0,
                callback=lambda taylor, way, end=end: circle(end, taylor, way),
                direction=rising,
            )
        )
    motion = [(x, u), (y, v), (u, hy.expression(0.0)), (v, hy.expression(0.0))]
    made = hy.taylor_adaptive(motion, START, tol=tolerance, t_events=events)

    def run() -> int:
        made.time = 0.0
        made.state[:] = START
        made.reset_cooldowns()
        count[0] = 0
        made.propagate_until(t_end, max_delta_t=LONGEST_STEP)
        return count[0]

    return run
