"""Events: each zero of an expression along a run is found once, with its direction and time; ends have messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq
from sympy import Abs, Max, Piecewise, cos, exp, log, sqrt, tan

from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.trajectory import Status
from tests.models import build, x, y
from tests.trajectory.runs import run
from tests.trajectory.watched import G, ball, floor, free, go, harmonic

# Zeros


ON_A_SINE: list[Any] = [
    1.04 - 0.04 / (1 - 0.99 * x),
    log(x + 1.01) - 0.3,
    x**30 - sp.Rational(1, 1000),
    (2 * x) ** 30 - 1,
    tan(1.4 * x) - 3,
    sp.atan(50 * x) - 1,
    1 / (1 + 100 * x**2) - 0.5,
    exp(20 * x) - 5,
    sqrt(x + 1.1) - 1,
    x * x.dot - 0.4 * cos(3 * t),
    Abs(x) - 0.5,
    Max(x, x.dot) - 0.9,
    Piecewise((x - 0.25, x < 0.5), (0.75 - x, True)),
]


@pytest.mark.few(2)
@pytest.mark.parametrize("expression", ON_A_SINE, ids=str)
def test_the_zeros_are_those_of_a_dense_search(expression: Any) -> None:
    """The reference brackets the zeros of the closed form along x = sin t: near poles, high powers, kinks and a jump.

    Expressions have errors of up to 64 tolerances of 1e-10, so times have errors of 1e-8 divided by the slope.
    """

    def closed(when: float) -> float:
        return float(g(when, math.sin(when), math.cos(when)))

    g = sp.lambdify((t, x, x.dot), expression)
    grid = np.linspace(1e-3, 20.0, 40_001)
    values = np.array([closed(when) for when in grid])
    places = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)
    expected = [brentq(closed, grid[i], grid[i + 1], xtol=1e-15) for i in places]
    result = go(harmonic(), 20.0, [expression])
    assert result.status is Status.SUCCESS
    assert result.t_events[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("factor", [1e-320, 1e-30, 1.0, 1e30, 1e300])
def test_the_size_of_an_event_is_no_matter(factor: float) -> None:
    result = go(free(), 3.0, [sp.Float(factor) * (x - 1)])
    assert result.t_events[0] == pytest.approx([1.0], rel=1e-15)


def test_time_velocity_and_parameters() -> None:
    a = sp.Symbol("a", positive=True)
    model = build(kinetic=x.dot**2 / 2, potential=a * x, parameters={a: 2.0}, initial={x.dot: 3.0})
    result = go(model, 3.0, [t - 1, x.dot, x.dot - a / 2, x - a, x.dot**2 / 2 + a * x - 4.5 - a * (t - 2)])
    assert [list(times) for times in result.t_events] == [
        pytest.approx([1.0]),
        pytest.approx([1.5]),
        pytest.approx([1.0]),
        pytest.approx([1.0, 2.0]),
        pytest.approx([2.0]),
    ]


# --- resets ---------------------------------------------------------------------------------------------------
# Resets at events: impacts by their laws, over thousands of them, and every end where no law says how to go on.


def test_what_begins_in_the_other_direction_is_not_thrown_back() -> None:
    """A ball that starts below the floor falls freely, and a particle that starts at the wall leaves it."""
    below = go(ball(height=-1.0, speed=10.0), 1.0, [floor(0.5)])
    assert len(below.t_events[0]) == 0 and below.y[0, -1] == pytest.approx(9 - G / 2)
    passing = go(free(x=1.0, x_dot=1.0), 1.0, [event(x - 1, direction=1, reset={x.dot: x.dot / 2})])
    assert len(passing.t_events[0]) == 0 and passing.y[0, -1] == 2.0


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_two_resets_of_one_entry_at_one_time_are_not_settled_by_their_order(method: str) -> None:
    model = build(
        kinetic=(x.dot**2 + y.dot**2) / 2, coordinates=[x, y], initial={x: 0.5, y: 0.5, x.dot: 1.0, y.dot: 1.0}
    )
    first, second = event(x - 1, reset={x.dot: -x.dot}), event(y - 1, reset={x.dot: 2.0})
    result = run(model, 1.0, method, events=[first, second])
    assert result.status is Status.NON_FINITE and result.t[-1] == pytest.approx(0.5, rel=1e-12)
    assert "two events at this time that reset one entry to different values" in result.message
    alike = run(model, 0.8, method, events=[first, event(y - 1, reset={x.dot: -y.dot})])
    assert alike.status is Status.SUCCESS and alike.y[2, -1] == pytest.approx(-1.0, rel=1e-12)


def test_resets_of_all_kinds() -> None:
    """Resets of coordinates, with explicit time, at the end of the run, and together with a terminal event."""
    saw = go(free(), 5.0, [event(x - 1, reset={x: 0})])
    assert saw.t_events[0] == pytest.approx([1, 2, 3, 4, 5], rel=1e-15) and saw.y[:, -1].tolist() == [0.0, 1.0]
    clock = go(free(), 4.0, [event(t - 2, reset={x: t * x.dot, x.dot: x - 1})])
    assert clock.t_events[0].tolist() == [2.0] and clock.y[:, -1].tolist() == [4.0, 1.0]
    last = go(free(), 5.0, [event(x - 1, reset={x.dot: -2 * x.dot}, terminal=True)])
    assert last.status is Status.EVENT and last.y[:, -1].tolist() == [1.0, -2.0]
    assert last.y_events[0].tolist() == [[1.0, 1.0]]
