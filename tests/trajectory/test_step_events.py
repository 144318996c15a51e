"""Events of all methods, located on the dense output of steps."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq
from sympy import Abs, Max, Piecewise, cos, exp, log, sin, sqrt, tan

from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.methods.registry import find, table
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import TARGETS, build, x, y
from tests.trajectory import watched
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, OUTSIDE, STEPPED, run
from tests.trajectory.watched import FALL, G, ball, bounces, floor, free, harmonic

TIGHT: dict[str, dict[str, Any]] = {
    **{name: {"rtol": 1e-12, "atol": 1e-14} for name in ADAPTIVE},
    **{name: {"step": 1e-3} for name in FIXED},
    **{name: {"rtol": 1e-9, "atol": 1e-11} for name in OUTSIDE},
}
SHARP = [name for name in ("rk4", "dopri5", "tsit5", "verner9", "dop853", "gauss2", "gauss3") if name in NAMES]
"""Methods whose errors at the settings above stay below 1e-9 over some tens of time units."""


def go(model: Model, end: float, events: Any, name: str, start: float = 0.0, **options: Any) -> Trajectory:
    """Return a run with tight tolerances and events, after checks that every result must pass."""
    return watched.go(model, end, events, start, name, **{**TIGHT[name], **options})


def test_every_method_locates_events() -> None:
    able = {row.name for row in table() if row.claims.events}
    assert able >= {*NAMES, *OUTSIDE}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["taylor", *SHARP, "verlet"])
def test_grazing_turns_of_a_pendulum(name: str) -> None:
    """The pendulum passes 1 - eps twice at each return. SciPy's DOP853 finds 1 to 11 of these 15 crossings."""
    model = build(kinetic=x.dot**2 / 2, potential=-cos(x), initial={x: 1.0})
    for depth in range(1, 9 if name == "taylor" else 7):
        eps = 10.0**-depth
        times = go(model, 50.0, [x - (1 - eps)], name).t_events[0]
        assert len(times) == 15, (name, eps)
        apart = math.sqrt(8 * eps / math.sin(1))
        # Verlet's amplitude is off by some h**2 = 1e-6 times a tenth, and eps with it.
        off = {"verlet": 0.2e-6, "taylor": 1e-11}.get(name, 1e-10)
        assert np.diff(times)[1::2] == pytest.approx(apart, rel=0.5 * eps + off / eps)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["taylor", *STEPPED, *OUTSIDE])
def test_directions_starts_and_ends(name: str, target: str) -> None:
    """A zero at the start is no event, a zero at the end is one. The motion x = t is exact for all methods."""
    options = {} if find(name).claims.adaptive else {"step": 0.07}
    events = [
        x,
        event(x, terminal=True),
        x - 1,
        event(x - 1, direction=1),
        event(x - 1, direction=-1),
        (x - 0.5) ** 2,
        event((x - 0.5) ** 2, direction=1),
        x - 2,
        t - 1.4,
        x.dot - 2,
    ]
    result = go(free(target), 2.0, events, name, **options)
    ones = pytest.approx([1.0], rel=1e-13)
    # A double root is as uncertain as the square root of round-off.
    touch, last = pytest.approx([0.5], abs=1e-6), pytest.approx([2.0], rel=1e-13)
    at = pytest.approx([1.4])
    assert [list(times) for times in result.t_events] == [[], [], ones, ones, [], touch, [], last, at, []]
    assert result.y_events[2][0] == pytest.approx([1.0, 1.0], rel=1e-13) and result.status is Status.SUCCESS


@pytest.mark.parametrize("name", ["taylor", *STEPPED, *OUTSIDE])
@pytest.mark.parametrize(("terminal", "direction", "turns"), [(True, 0, 1), (1, -1, 1), (2, 1, 4), (3, 0, 3)])
def test_a_terminal_event_ends_the_run(terminal: int, direction: int, turns: int, name: str) -> None:
    """Steps beyond the terminal event are not stored."""
    result = go(harmonic(), 4000.0, [event(x, direction=direction, terminal=terminal), x.dot], name, max_steps=500_000)
    assert result.status is Status.EVENT and len(result.t_events[0]) == terminal and len(result.t_events[1]) == turns
    off = 1e-6 if name in OUTSIDE else {1: 2e-2, 2: 1e-5}.get(find(name).claims.order, 1e-9)
    assert result.t[-1] == result.t_events[0][-1] == result.span[1] == pytest.approx(turns * math.pi, abs=off)
    assert result.y[:, -1].tolist() == result.y_events[0][-1].tolist() and result.steps == len(result.t) - 1
    assert result.message.startswith(f"{name} stopped at an event at t = ")
    # The large weights of verner9, of both signs, make up to 7e-13 of the rounding of its slopes, at 80 tolerances.
    off = 1e-12 if name == "verner9" else 5e-14
    assert result.dense(result.t[-1:])[:, 0] == pytest.approx(result.y[:, -1], abs=off)


@cache
def pendulum() -> Model:
    return build(kinetic=x.dot**2 / 2, potential=-cos(x), initial={x: 1.0})


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [*NAMES, *OUTSIDE])
def test_what_stays_zero_is_no_event(name: str) -> None:
    """The event is a conserved quantity minus its value, around which the dense output oscillates by its error."""
    model = pendulum()
    energy = x.dot**2 / 2 - cos(x) + cos(sp.Integer(1))
    options: dict[str, Any] = {} if find(name).claims.adaptive else {"step": 0.01}
    result = run(model, 4.0, name, events=[energy, event(energy, direction=1, terminal=True)], **options)
    assert result.status is Status.SUCCESS and [len(times) for times in result.t_events] == [0, 0]


@pytest.mark.parametrize("level", [0.0, 3.0, 6.4e6])
@pytest.mark.parametrize("restitution", [0.5, 0.9])
@pytest.mark.parametrize("name", ["taylor", "rk4", "dopri5", "dop853"])
def test_a_ball_comes_to_rest_in_words(name: str, restitution: float, level: float) -> None:
    """The ball never falls through the floor.

    Flights below the spacing of doubles have a velocity, but no height. Each may sink by some spacings, except with
    taylor.
    """
    options = {"taylor": {}, "rk4": {"step": 0.05}}.get(name, {"rtol": 1e-9, "atol": 1e-12})
    result = go(ball(height=level + 1), 100.0, [floor(restitution, level)], name, **options)
    end = FALL * (1 + restitution) / (1 - restitution)
    assert result.status is Status.STEP_TOO_SMALL and "comes to rest" in result.message
    spacing = 2.0**-52 * level
    off = 1e-13 * end + 3e-15 * level if name == "taylor" else 1e-11 + 10 * math.sqrt(spacing / G)
    assert result.t[-1] == pytest.approx(end, abs=off)
    assert result.y[0].min() >= level - (4e-15 + 20 * spacing if name == "taylor" else 4e-13 + 3000 * spacing)
    times = result.t_events[0]
    assert len(times) > 30 and times == pytest.approx(bounces(restitution, len(times)), abs=off)


def test_a_start_below_zero_by_rounding_is_the_level_to_come_back_to() -> None:
    """At a height of 1e12 a ball may be 1e-4 below the floor after a bounce, and must not meet the floor as it rises.

    Flights lower than that depend on rounding, and end the run.
    """
    result = go(ball(height=1e12 + 1), 60.0, [floor(0.5, 1e12)], "rk4", step=1e-3)
    assert 12 < len(result.t_events[0]) < 40 and np.diff(result.t_events[0]).min() > 0.03
    assert result.status is Status.STEP_TOO_SMALL and "too quickly for the steps of the method" in result.message


@pytest.mark.few
@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
def test_a_start_on_the_floor(name: str) -> None:
    """A ball that starts on the floor bounces at once if it falls, but not if it rises.

    A ball at rest gets a message.
    """
    falling = go(ball(height=0.0, speed=-2.0), 0.3, [floor(0.5)], name)
    assert list(falling.t_events[0]) == [0.0, pytest.approx(2 / G, rel=1e-10)]
    assert falling.y[:, 0].tolist() == [0.0, -2.0] and falling.y[:, 1].tolist() == [0.0, 1.0]
    rising = go(ball(height=0.0, speed=2.0), 0.3, [floor(0.5)], name)
    assert len(rising.t_events[0]) == 0 and rising.y[0, -1] == pytest.approx(0.6 - G * 0.09 / 2)
    for rest in (go(ball(), 2.0, [floor(0)], name), go(ball(height=0.0), 2.0, [floor(0.9)], name)):
        assert rest.status is Status.STEP_TOO_SMALL and len(rest.t_events[0]) == 1
        assert "is zero, its rate is zero, and the motion would cross zero" in rest.message
        assert "State the reset as a contact, as in contacts={'floor': lagrange.contact(gap=...)}" in rest.message


@pytest.mark.parametrize(("expression", "place", "words"), watched.WITHOUT_VALUE)
@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
def test_an_event_without_a_value_ends_the_run_in_words(name: str, expression: Any, place: float, words: str) -> None:
    result = go(free(), 3.0, [expression, x - 0.25], name, **({"step": 0.11} if name == "rk4" else {}))
    assert result.status is Status.NON_FINITE and words in result.message and result.steps < 200
    assert "pole there or leaves its domain" in result.message or name == "taylor" or place == 0
    assert result.t[-1] == pytest.approx(place, abs=1e-7)
    assert len(result.t_events[1]) == (place > 0.25)


@pytest.mark.few
@pytest.mark.parametrize("name", ["taylor", "dop853", *OUTSIDE])
def test_resets_that_lead_nowhere(name: str) -> None:
    bad = go(free(), 3.0, [event(x - 1, reset={x.dot: log(-t * x)})], name)
    assert bad.t[-1] == pytest.approx(1.0)
    assert bad.status is Status.NON_FINITE and "The reset where x - 1 is zero gives a state that is nan" in bad.message
    polar = build(
        kinetic=(x.dot**2 + x**2 * y.dot**2) / 2, coordinates=[x, y], initial={x: 1.0, x.dot: -0.5, y.dot: 1.0}
    )
    singular = go(polar, 3.0, [event(x - 0.9, direction=-1, reset={x: 0})], name)
    assert singular.status is Status.SINGULAR and "the mass matrix is singular at t = " in singular.message
    edge = build(kinetic=x.dot**2 / 2, forces={x: sp.sqrt(1.5 - x)}, initial={x.dot: 1.0})
    outside = go(edge, 3.0, [event(x - 1, reset={x: 2})], name)
    assert outside.status is Status.NON_FINITE and "x" in outside.message
    assert outside.t[-1] == outside.t_events[0][0] and outside.y[0, -1] == 2


@pytest.mark.parametrize("name", ["taylor", "rk4", "dop853", *OUTSIDE])
@pytest.mark.parametrize(
    ("options", "status"), [({"max_steps": 300}, Status.MAX_STEPS), ({"max_wall": 0.03}, Status.MAX_WALL)]
)
def test_what_a_limit_cuts_off_has_not_happened(name: str, options: dict[str, Any], status: Status) -> None:
    result = go(free(), 1e6, [event(x - 1, reset={x: 0}), sin(20 * t)], name, **options)
    assert result.status is status and result.t[-1] < 1e5
    assert len(result.t_events[0]) == pytest.approx(result.t[-1], abs=1.1)
    assert len(result.t_events[1]) == pytest.approx(result.t[-1] * 20 / math.pi, abs=1.1)


# --- series ----------------------------------------------------------------------------------------------------
# Events on series: each zero of an expression along a run is found once, and resets act by their laws.

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
    result = watched.go(harmonic(), 20.0, [expression])
    assert result.status is Status.SUCCESS
    assert result.t_events[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("factor", [1e-320, 1e-30, 1.0, 1e30, 1e300])
def test_the_size_of_an_event_is_no_matter(factor: float) -> None:
    result = watched.go(free(), 3.0, [sp.Float(factor) * (x - 1)])
    assert result.t_events[0] == pytest.approx([1.0], rel=1e-15)


# --- resets ---------------------------------------------------------------------------------------------------
# Resets at events: impacts by their laws, over thousands of them, and every end where no law says how to go on.


def test_what_begins_in_the_other_direction_is_not_thrown_back() -> None:
    """A ball that starts below the floor falls freely, and a particle that starts at the wall leaves it."""
    below = watched.go(ball(height=-1.0, speed=10.0), 1.0, [floor(0.5)])
    assert len(below.t_events[0]) == 0 and below.y[0, -1] == pytest.approx(9 - G / 2)
    passing = watched.go(free(x=1.0, x_dot=1.0), 1.0, [event(x - 1, direction=1, reset={x.dot: x.dot / 2})])
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
    saw = watched.go(free(), 5.0, [event(x - 1, reset={x: 0})])
    assert saw.t_events[0] == pytest.approx([1, 2, 3, 4, 5], rel=1e-15) and saw.y[:, -1].tolist() == [0.0, 1.0]
    clock = watched.go(free(), 4.0, [event(t - 2, reset={x: t * x.dot, x.dot: x - 1})])
    assert clock.t_events[0].tolist() == [2.0] and clock.y[:, -1].tolist() == [4.0, 1.0]
    last = watched.go(free(), 5.0, [event(x - 1, reset={x.dot: -2 * x.dot}, terminal=True)])
    assert last.status is Status.EVENT and last.y[:, -1].tolist() == [1.0, -2.0]
    assert last.y_events[0].tolist() == [[1.0, 1.0]]
