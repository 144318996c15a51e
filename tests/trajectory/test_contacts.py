"""Contacts that touch at the start, and simultaneous events: all families of methods give the same answer.

The rule is stated in `lagrange.trajectory.events.motion_start`.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.special import erfinv
from sympy import Rational, cos, erf, exp, tanh

import lagrange as lg
from tests.covering import Share
from tests.trajectory.runs import OUTSIDE

STEPS = {"rk4": 0.01, "verlet": 0.01}
METHODS = ["taylor", "dop853", "rk4", "verlet", "radau5", *(one for one in ("scipy-dop853", "cvode") if one in OUTSIDE)]

a, b, c, x, y = lg.coordinates("a b c x y")
BALLS = lg.System(kinetic=(a.dot**2 + b.dot**2 + c.dot**2) / 2, potential=0, initial={a: -1, a.dot: 1})
PLANE = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=0, initial={x: 0.5, y: 0.5})
THROWN = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=10 * y)
FALLING = lg.System(kinetic=y.dot**2 / 2, potential=9.81 * y, initial={y: 1})


def turn(expression: Any, rate: Any, direction: int = -1) -> lg.Event:
    return lg.event(expression, direction=direction, reset={rate: -rate})


def hit(p: Any, q: Any) -> lg.Event:
    return lg.event(q - p, direction=-1, reset={p.dot: q.dot, q.dot: p.dot})


def run(system: lg.System, end: float, method: str, events: list[Any], **initial: float) -> lg.Solution:
    return system.run(end, method=method, events=events, step=STEPS.get(method), initial=initial)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_a_contact_that_touches_already_passes_the_impact_on(method: str) -> None:
    for gap, first in ((0.0, -1.0), (1e-17, -1.0), (1e-12, -1.0), (0.0, 0.0)):
        result = run(BALLS, 5, method, [hit(a, b), hit(b, c)], a=first, b=0.0, c=gap, a_dot=1.0)
        end = result.require().final
        assert end["c"] == pytest.approx(5 + first, abs=1e-9) and abs(end["a"]) + abs(end["b"]) < 1e-9
        assert [len(times) for times in result.t_events] == [1, 1]


@pytest.mark.parametrize("method", METHODS)
def test_a_contact_entered_the_wrong_way_acts_at_once(method: str) -> None:
    """The ball is put onto the floor by a reset, or starts below it by a rounding error."""
    floor = turn(y, y.dot)
    put = run(FALLING, 1, method, [lg.event(lg.t - 0.1, reset={y: 0}), floor])
    assert put.require().t_events[1][0] == put.t_events[0][0] and put.final["y"] > -1e-9
    assert put.final["y"] == pytest.approx(0.04905, abs=1e-7)
    below = run(FALLING, 0.1, method, [floor], y=-1e-17, y_dot=-1.0)
    assert below.require().t_events[0].tolist() == [0.0] and below.final["y"] == pytest.approx(0.05095, abs=1e-7)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_a_ball_aimed_at_a_corner_stays_in_the_box(method: str, share: Share) -> None:
    walls = [turn(x - 1, x.dot, 1), turn(x, x.dot), turn(y - 1, y.dot, 1), turn(y, y.dot)]
    known = run(PLANE, 40, method, walls, x=0.9666666666666667, y=0.900000000000001, x_dot=1.0, y_dot=3.0)
    assert [len(times) for times in known.require().t_events] == [20, 20, 60, 60]
    at_once = run(THROWN, 5, method, [walls[1], walls[0], walls[3]], x=0.5, y=1.25, x_dot=1.0)
    assert at_once.require().final["y"] == pytest.approx(1.25, abs=1e-5)
    random = np.random.default_rng(1)
    for _ in range(share(24)):
        (u, w), until = random.uniform(0.5, 3, 2), random.uniform(0.1, 0.3)
        late = random.choice([0.0, 1e-16, 1e-15, -1e-15, 3e-15, 1e-14])
        result = run(PLANE, 4, method, walls, x=1 - u * until, y=1 - w * (until + late), x_dot=u, y_dot=w)
        place = np.array([result.require().final["x"], result.final["y"]])
        assert ((place > -1e-6) & (place < 1 + 1e-6)).all()
        assert len(result.t_events[0]) and len(result.t_events[2])


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_an_event_beside_a_reset_happens_once(method: str, share: Share) -> None:
    """The event occurs before, after or at the time of the reset, ends the run, or has the same function."""
    random = np.random.default_rng(2)
    wall = turn(x, x.dot)
    for _ in range(share(24)):
        (u, w), until = random.uniform(0.5, 3, 2), random.uniform(0.1, 0.3)
        late = random.uniform(-1, 1) * 10.0 ** random.integers(-17, -13)
        start = {"x": u * until, "y": w * (until + late), "x_dot": -u, "y_dot": -w}
        for events in ([wall, y, x], [y, x, wall]):
            result = run(PLANE, 1, method, events, **start)
            assert [len(times) for times in result.require().t_events] == [1, 1, 1]
        ended = run(PLANE, 1, method, [wall, lg.event(y, direction=-1, terminal=True)], **start)
        assert ended.status is lg.Status.EVENT and ended.t_events[1][0] == pytest.approx(until, rel=1e-9)


# --- events that saturate -------------------------------------------------------------------------------------
# Events that saturate: where they are flat, their series knows nothing of the zero that lies ahead.

UPWARDS = lg.System(kinetic=x.dot**2 / 2, potential=x, initial={x.dot: 10})
OSCILLATOR = lg.System(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1})

SATURATING = [
    (erf(x - 5) - Rational(3, 10), 5 + float(erfinv(0.3))),
    (tanh(10 * (x - 5)) - Rational(1, 2), 5 + math.atanh(0.5) / 10),
    (1 / (1 + exp(-20 * (x - 5))) - Rational(3, 10), 5 + math.log(3 / 7) / 20),
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("event", "level"), SATURATING, ids=["erf", "tanh", "logistic"])
def test_both_passages_are_found(method: str, event: Any, level: float) -> None:
    half = math.sqrt(100 - 2 * level)
    result = UPWARDS.run(20, events=[event], method=method, step=STEPS.get(method)).require()
    assert result.t_events[0] == pytest.approx([10 - half, 10 + half], rel=1e-6)
    falling = lg.event(event, direction=-1, terminal=True)
    ended = UPWARDS.run(20, events=[falling], method=method, step=STEPS.get(method))
    assert ended.status is lg.Status.EVENT and ended.t[-1] == pytest.approx(10 + half, rel=1e-6)


# --- balls that touch -----------------------------------------------------------------------------------------
# Balls that touch: impacts at one place act one after the other, and a wrong order is said.

beads = lg.coordinates("ball0 ball1 ball2 ball3 ball4 ball5 ball6")  # names that no other file declares
m, g, l = lg.parameters("m g l")


def cradle(count: int, gap: float = 0.0) -> tuple[lg.System, list[lg.Event]]:
    """Return a row of pendulums, and the impacts of neighbours, which exchange their velocities."""
    balls = beads[:count]
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


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_cradle_of_balls_that_touch_hands_its_velocity_on(method: str) -> None:
    """Equal balls that exchange velocities move like pendulums that pass through one another.

    With taylor the run ended at the fifth impact, because a gap of -2e-17 was taken for a crossing.
    """
    system, impacts = cradle(5)
    result = system.run(10.0, method=method, events=impacts)
    assert result.status is lg.Status.SUCCESS, result.message
    alone = lg.System(kinetic=beads[0].dot ** 2 / 2, potential=-9.81 * cos(beads[0]), initial={beads[0]: -0.5})
    one = alone.run(10.0, rtol=1e-12)
    free = one.at(10.0)[0]
    assert np.sort(result.y[:5, -1]) == pytest.approx(result.y[:5, -1], abs=1e-7)
    assert result.y[:5, -1] == pytest.approx(np.sort([free, 0, 0, 0, 0]), abs=1e-6)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("count", "raised", "method"), [(3, {"ball1": -0.5, "ball2": 0.4}, "taylor"), (7, {}, "dop853")]
)
def test_impacts_in_a_wrong_order_are_no_success(count: int, raised: dict[str, float], method: str) -> None:
    """A run in which one ball passed through another had the status SUCCESS."""
    system, impacts = cradle(count)
    result = system.run(40.0, raised, method=method, events=impacts)
    assert not result.status.complete
    assert "Bodies that touch need a small gap" in result.message
    apart, impacts = cradle(count, gap=1e-6)
    result = apart.run(10.0, raised, method=method, events=impacts)
    assert result.status is lg.Status.SUCCESS and np.diff(result.y[:count], axis=0).min() > -2e-6
