"""Resets at events: impacts by their laws, over thousands of them, and every end where no law says how to go on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.models import build, x, y
from tests.trajectory.runs import run
from tests.trajectory.watched import FALL, G, ball, bounces, floor, free, go


@pytest.mark.parametrize(("direction", "level"), [(-1, 0.0), (0, 0.0), (0, 6.4e6)])
def test_an_elastic_ball_bounces_on(direction: int, level: float) -> None:
    impact = event(y - level, direction=direction, reset={y.dot: -y.dot})
    found = go(ball(height=level + 1), 1000 * 2 * FALL, [impact])
    count = len(found.t_events[0])
    assert count == 1000 and found.status is Status.SUCCESS
    assert found.t_events[0] == pytest.approx(bounces(1.0, count), rel=1e-12 + 1e-14 * level)
    # Each impact rounds the velocity once: what is lost adds up like a random walk.
    energy = found.y[1] ** 2 / 2 + G * (found.y[0] - level)
    assert np.abs(energy / G - 1).max() < 1e-12 + 1e-8 * (level > 0)


def test_what_begins_in_the_other_direction_is_not_thrown_back() -> None:
    """A ball from below the floor falls freely, and a particle that starts at the wall leaves it."""
    below = go(ball(height=-1.0, speed=10.0), 1.0, [floor(0.5)])
    assert len(below.t_events[0]) == 0 and below.y[0, -1] == pytest.approx(9 - G / 2)
    passing = go(free(x=1.0, x_dot=1.0), 1.0, [event(x - 1, direction=1, reset={x.dot: x.dot / 2})])
    assert len(passing.t_events[0]) == 0 and passing.y[0, -1] == 2.0


def folded(u: Any) -> FloatArray:
    return np.asarray(1 - np.abs(1 - np.mod(u, 2)))


WALLS = [
    event(x * (1 - x), direction=-1, reset={x.dot: -x.dot}),
    event(y * (1 - y), direction=-1, reset={y.dot: -y.dot}),
]


def test_a_square_billiard() -> None:
    """Unfolded, the path is a straight line."""
    start = {x: 0.3, y: 0.1, x.dot: 0.7, y.dot: math.sqrt(0.5)}
    model = build(kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y], initial=start)
    found = go(model, 1400.0, WALLS)
    assert [len(times) for times in found.t_events] == [980, 990]
    assert found.y[0] == pytest.approx(folded(0.3 + 0.7 * found.t), abs=1e-11)
    assert found.y[1] == pytest.approx(folded(0.1 + math.sqrt(0.5) * found.t), abs=1e-11)


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_two_resets_of_one_entry_at_one_time_are_not_settled_by_their_order(method: str) -> None:
    model = build(
        kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y], initial={x: 0.5, y: 0.5, x.dot: 1.0, y.dot: 1.0}
    )
    one, other = event(x - 1, reset={x.dot: -x.dot}), event(y - 1, reset={x.dot: 2.0})
    found = run(model, 1.0, method, events=[one, other])
    assert found.status is Status.NON_FINITE and found.t[-1] == pytest.approx(0.5, rel=1e-12)
    assert "two events at this time that reset one entry to different values" in found.message
    alike = run(model, 0.8, method, events=[one, event(y - 1, reset={x.dot: -y.dot})])
    assert alike.status is Status.SUCCESS and alike.y[2, -1] == pytest.approx(-1.0, rel=1e-12)


def test_resets_of_all_kinds() -> None:
    """Teleports, time in a reset, a reset at the very end, and one together with the end of the run."""
    saw = go(free(), 5.0, [event(x - 1, reset={x: 0})])
    assert saw.t_events[0] == pytest.approx([1, 2, 3, 4, 5], rel=1e-15) and saw.y[:, -1].tolist() == [0.0, 1.0]
    clock = go(free(), 4.0, [event(t - 2, reset={x: t * x.dot, x.dot: x - 1})])
    assert clock.t_events[0].tolist() == [2.0] and clock.y[:, -1].tolist() == [4.0, 1.0]
    last = go(free(), 5.0, [event(x - 1, reset={x.dot: -2 * x.dot}, terminal=True)])
    assert last.status is Status.EVENT and last.y[:, -1].tolist() == [1.0, -2.0]
    assert last.y_events[0].tolist() == [[1.0, 1.0]]
