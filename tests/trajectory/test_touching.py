"""Balls that touch: impacts at one place act one after the other, and a wrong order is said."""

from itertools import pairwise

import numpy as np
import pytest
from sympy import cos

import lagrange as lg

a = lg.coordinates("ball0 ball1 ball2 ball3 ball4 ball5 ball6")  # names that no other file declares
m, g, l = lg.parameters("m g l")


def cradle(count: int, gap: float = 0.0) -> tuple[lg.System, list[lg.Event]]:
    """Return pendulums side by side, and the impacts of neighbours, which exchange their velocities."""
    balls = a[:count]
    system = lg.System(
        kinetic=sum(m * l**2 * q.dot**2 / 2 for q in balls),
        potential=sum(-m * g * l * cos(q) for q in balls),
        parameters={m: 1, g: 9.81, l: 1},
        initial={balls[0]: -0.5},
    )
    pairs = pairwise(balls)
    impacts = [
        lg.event(right - left + gap, direction=-1, reset={left.dot: right.dot, right.dot: left.dot})
        for left, right in pairs
    ]
    return system, impacts


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_cradle_of_balls_that_touch_hands_its_velocity_on(method: str) -> None:
    """Equal balls that exchange velocities are pendulums that pass one another: the exact motion is known.

    With taylor the fifth impact ended the run: a value of -2e-17 between balls was taken for a passage.
    """
    system, impacts = cradle(5)
    found = system.run(10.0, method=method, events=impacts)
    assert found.status is lg.Status.SUCCESS, found.message
    alone = lg.System(kinetic=a[0].dot ** 2 / 2, potential=-9.81 * cos(a[0]), initial={a[0]: -0.5})
    one = alone.run(10.0, rtol=1e-12)
    free = one.at(10.0)[0]
    assert np.sort(found.y[:5, -1]) == pytest.approx(found.y[:5, -1], abs=1e-7)
    assert found.y[:5, -1] == pytest.approx(np.sort([free, 0, 0, 0, 0]), abs=1e-6)


@pytest.mark.parametrize(
    ("count", "raised", "method"), [(3, {"ball1": -0.5, "ball2": 0.4}, "taylor"), (7, {}, "dop853")]
)
def test_impacts_in_a_wrong_order_are_no_success(count: int, raised: dict[str, float], method: str) -> None:
    """A ball that was let through another was a success."""
    system, impacts = cradle(count)
    found = system.run(40.0, raised, method=method, events=impacts)
    assert not found.status.complete
    assert "Bodies that touch need a small gap" in found.message
    apart, impacts = cradle(count, gap=1e-6)
    found = apart.run(10.0, raised, method=method, events=impacts)
    assert found.status is lg.Status.SUCCESS and np.diff(found.y[:count], axis=0).min() > -2e-6
