"""Constraints that jump, have corners, or restrict nothing on the way: a run ends before, and says which and where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import Abs, Expr, Piecewise, atan2

import lagrange as lg
from lagrange.errors import RunError
from tests.trajectory.runs import FIXED

x, y = lg.coordinates("x y")
METHODS = ("taylor", "dop853", "rk4", "rattle", "radau5", "lobatto4", "bdf2")
INWARDS = {x: 1.0, y: 1.0, x.dot: -1.0}


def held(constraint: Expr, initial: dict[Any, float], potential: Any = 0, **more: Any) -> lg.System:
    """Return a unit mass in the plane."""
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=potential,
        coordinates=[x, y],
        constraints={"wire": constraint},
        initial=initial,
        **more,
    )


def options(method: str) -> dict[str, Any]:
    return {"method": method, **({"step": 0.01} if method in FIXED else {})}


CORNER = "the constraint 'wire' has a corner where {} = 0: velocities jump there, in a way that is not stated."
JUMP = "the constraint 'wire' jumps where {} = 0, and no motion leads over that."
ENDED = {
    "jump": (held(y - Piecewise((1, x > 0), (-1000, True)), INWARDS), JUMP.format("x")),
    "small jump": (held(y - Piecewise((1, lg.t < 1), (1 + 1e-5, True)), {y: 1.0}), JUMP.format("t - 1")),
    "corner": (held(y - Abs(x), {**INWARDS, y.dot: -1.0}), CORNER.format("x")),
    "corner in time": (held(y - Abs(lg.t - 1), {y: 1.0, y.dot: -1.0}), CORNER.format("t - 1")),
    "angle": (
        held(atan2(y, x) - np.pi + 0.1 - lg.t / 10, {x: -np.cos(0.1), y: np.sin(0.1), x.dot: -1 / 10 * np.sin(0.1)}),
        JUMP.format("y"),
    ),
}
"""All reach their place at t = 1."""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ENDED)
def test_a_run_ends_where_a_constraint_jumps_or_has_a_corner(kind: str, method: str) -> None:
    system, words = ENDED[kind]
    start = system.consistent().initial if kind == "angle" else {}
    run = system.run(2.5, start, check=False, **options(method))
    assert run.status is lg.Status.SINGULAR and words in run.message
    # A step of series ends there, one with error control beside it, and an equal one is the last that is whole.
    assert run.t[-1] == pytest.approx(1.0, abs=0.011 if method in FIXED else 1e-9)
    assert run.t[-1] <= 1.0 + 1e-12 and run.trajectory.span[1] == run.t[-1] and run.trajectory.steps == len(run.t) - 1
    assert run.constraint_error.max() < 1e-9
    assert np.abs(run.at(run.t[-1]) - run.y[:, -1]).max() < 1e-9


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("wire", "wall"), [(x * Abs(x), 1.0), (Piecewise((x**2, x > 0), (0, True)), 0.0)], ids=["cubic", "flat"]
)
def test_a_constraint_that_is_smooth_where_it_switches_is_passed(wire: Expr, wall: float, method: str) -> None:
    run = held(y - wire, {**INWARDS, y.dot: -2.0}).run(2.0, check=False, **options(method))
    assert run.status is lg.Status.SUCCESS, run.message
    assert run[x][-1] < 0 and run[y][-1] == pytest.approx(-wall * run[x][-1] ** 2, abs=1e-10)
    assert run.energy[-1] == pytest.approx(2.5, rel=1e-2)


def test_a_constraint_that_is_stated_otherwise_behind_a_surface_is_the_same() -> None:
    """Twice itself, with another sign: the multiplier jumps, and the motion does not."""
    rod = x**2 + y**2 - 1
    start = {x: 0.6, y: -0.8}
    both = [held(one, start, 9.81 * y) for one in (rod, Piecewise((rod, x > 0), (-2 * rod, True)))]
    plain, other = (system.run(3.0, rtol=1e-11, check=False).y[:, -1] for system in both)
    assert other == pytest.approx(plain, abs=1e-9)


def test_what_a_run_keeps_ends_there_too() -> None:
    """Its outputs and events, and a run back in time; a flow says why it does not get there."""
    system, words = ENDED["corner"]
    for method in ("taylor", "dop853"):
        run = system.run(2.5, t_eval=np.linspace(0.0, 2.5, 26), events=[x - 0.5, x + 0.5], check=False, method=method)
        assert run.status is lg.Status.SINGULAR and run.t == pytest.approx(np.linspace(0.0, 0.9, 10), abs=1e-9)
        assert [len(times) for times in run.t_events] == [1, 0]
        back = system.run(-2.5, {x.dot: 1.0, y.dot: 1.0}, check=False, method=method)
        assert back.t[-1] == pytest.approx(-1.0, abs=1e-9) and words in back.message
    with pytest.raises(RunError, match="has a corner where x = 0"):
        lg.flow(system.compile(check=False), method="rk4", step=0.01)([1.0, 1.0, -1.0, -1.0], 0.0, 2.5)


def test_a_reset_to_the_other_side_is_no_way_over_a_corner() -> None:
    system, _ = ENDED["corner"]
    over = lg.Event(x - 0.5, direction=-1, reset={x: -x, x.dot: x.dot, y.dot: -y.dot})
    run = system.run(2.5, events=[over], check=False)
    assert run.status is lg.Status.SUCCESS and run[x][-1] == pytest.approx(-2.5)


@pytest.mark.few
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5", "gauss2", "bdf2"])
def test_a_constraint_that_comes_to_restrict_nothing_ends_a_run(method: str) -> None:
    """The speed is 1 - t: from rest every direction is as good."""
    brake = held(x.dot**2 + y.dot**2 - (1 - lg.t) ** 2, {x.dot: 1.0})
    run = brake.run(2.0, check=False, **options(method))
    assert run.status is lg.Status.SINGULAR and run.t[-1] <= 1.0 + 1e-9
    assert "the constraint 'wire' restricts no velocity, for all its derivatives by them vanish," in run.message
    assert "it does not say how the motion goes on" in run.message
    turning = held(x.dot**2 + y.dot**2 - 1, {x.dot: 1.0}, forces={x: -5 * y.dot, y: 5 * x.dot})
    turned = turning.run(3.0, method="rk4", step=0.3, check=False)
    assert turned.status is lg.Status.SUCCESS, turned.message


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_rod_that_shrinks_to_a_point_ends_a_run_long_before_its_steps_are_used_up(method: str) -> None:
    rod = held(x**2 + y**2 - (1 - lg.t) ** 2, {x: 1.0, x.dot: -1.0}, 9.81 * y)
    run = rod.run(2.0, t_eval=[0.5], method=method, check=False)
    assert run.status is lg.Status.SINGULAR and run.trajectory.steps < 1.2e6
    assert (
        "the constraint 'wire' restricts no velocity" in run.message and "of what they were at the start" in run.message
    )
    fewer = rod.run(2.0, method=method, max_steps=1000, check=False)
    assert fewer.status is lg.Status.MAX_STEPS
