"""Switching surfaces in the statement: the run ends a step on each, goes on with its other side, or says why not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Abs, Max, Min, Piecewise, sign

from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import Status
from tests.models import LLVM_FIRST, TARGETS, build, x, y
from tests.trajectory.runs import run
from tests.trajectory.watched import go


def particle(potential: Any = 0, force: Any = 0, target: str = "llvm", **initial: float) -> Model:
    return build(target, kinetic=x.dot**2 / 2, potential=potential, forces={x: force}, initial=initial)


SPRINGS = Piecewise((2 * x**2, x > 0), (x**2 / 2, True))
"""Stiffness 4 on one side and 1 on the other: half a period each."""

STOPS = 50 * Max(0, x - 1) ** 2 + 50 * Min(0, x + 1) ** 2
"""Free between -1 and 1, where springs of frequency 10 begin."""


@pytest.mark.parametrize(
    ("potential", "start", "period"),
    [
        (SPRINGS, {"x_dot": 1.0}, 1.5 * math.pi),
        (Abs(x), {"x": 1.0}, 4 * math.sqrt(2)),
        (STOPS, {"x_dot": 1.0}, 4 + math.pi / 5),
        (Abs(x) + Abs(2 * x), {"x": 1.5}, 4.0),
        (Abs(Abs(x) - 1), {"x": 1.5}, 4.0),
        (Max(x, -2 * x), {"x": 1.0}, 2 * math.sqrt(2) * 1.5),
    ],
    ids=str,
)
@pytest.mark.parametrize("target", TARGETS)
def test_a_hundred_periods(potential: Any, start: dict[str, float], period: float, target: str) -> None:
    """Against closed forms at rtol = 1e-12: what a step loses in speed is lost in phase on all the way that follows."""
    count = 100 if target == "llvm" else 3
    model = particle(potential, target=target, **start)
    found = go(model, count * period, rtol=1e-12)
    assert found.status is Status.SUCCESS
    assert found.y[:, -1] == pytest.approx(found.y[:, 0], abs=2e-9)
    energy = model.energy(found.y[:1], found.y[1:])
    assert np.ptp(energy) < 1e-11 * energy[0]
    back = go(model, 0.0, start=3 * period, initial=start)
    assert back.y[:, -1] == pytest.approx(found.y[:, 0], abs=1e-9)


@pytest.mark.parametrize("target", TARGETS)
def test_friction_slips_by_its_law_and_sticks_in_words(target: str) -> None:
    """From 3.2 each half swing loses 1; at 0.2 the spring is weaker than friction."""
    model = particle(x**2 / 2, -sign(x.dot) / 2, target, x=3.2)
    slipping = go(model, 9.0, [x.dot])
    assert slipping.y_events[0][:, 0] == pytest.approx([-2.2, 1.2], abs=1e-9)
    assert slipping.t_events[0] == pytest.approx([math.pi, 2 * math.pi], abs=1e-9)
    assert slipping.y[0, -1] == pytest.approx(0.5 + 0.7 * math.cos(9.0), abs=1e-9)
    stuck = go(model, 20.0)
    assert stuck.status is Status.STEP_TOO_SMALL and stuck.t[-1] == pytest.approx(3 * math.pi, abs=1e-9)
    assert "switch where x_dot is zero, and at t = 9.42478 both sides lead back there" in stuck.message
    assert "State dry friction as a contact" in stuck.message and "tanh(v/0.001) in place of sign(v)" in stuck.message
    ended = go(model, 20.0, [event(x.dot, terminal=3)])
    assert ended.status is Status.EVENT and ended.y[0, -1] == pytest.approx(-0.2, abs=1e-9)


def test_sliding_to_rest() -> None:
    """Without another force zero velocity stays by itself; with a weak one it sticks; a strong one sets it off."""
    rest = go(particle(force=-2 * sign(x.dot), x_dot=4.0), 3.0)
    assert rest.status is Status.SUCCESS and rest.y[:, -1] == pytest.approx([4.0, 0.0], abs=1e-13)
    held = go(particle(force=1 - 2 * sign(x.dot)), 3.0)
    assert held.status is Status.STEP_TOO_SMALL and held.t[-1] == 0.0 and "sticks to the surface" in held.message
    pushed = Piecewise((5, t > 1), (0, True))
    moved = go(particle(force=pushed - 2 * sign(x.dot)), 3.0)
    assert moved.y[:, -1] == pytest.approx([6.0, 6.0], rel=1e-12)
    strong = go(particle(force=-3 - 2 * sign(x.dot)), 2.0)
    assert strong.y[:, -1] == pytest.approx([-2.0, -2.0], rel=1e-12)


def test_chattering_is_said() -> None:
    found = go(particle(force=-sign(x + x.dot), x=1.0), 10.0)
    assert found.status is Status.STEP_TOO_SMALL and found.t[-1] == pytest.approx(math.sqrt(3) - 1, rel=1e-12)
    assert "switch where x + x_dot is zero" in found.message


def test_an_unstable_rest_on_a_surface_stays() -> None:
    """On the ridge of -|x| the equations as stated have sign(0) = 0."""
    assert go(particle(-Abs(x)), 3.0).y[:, -1].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("width", [sp.Rational(1, 10), sp.Rational(1, 1000)])
def test_a_short_push_in_a_long_rest_is_not_missed(width: Any, target: str) -> None:
    found = go(particle(force=Piecewise((10, (t > 50) & (t < 50 + width)), (0, True)), target=target), 100.0)
    speed = 10 * float(width)
    assert found.y[1, -1] == pytest.approx(speed, rel=1e-11)
    assert found.y[0, -1] == pytest.approx(speed * (50 - float(width) / 2), rel=1e-11)


@pytest.mark.parametrize(("end", "expected"), [(2.0, [2.0, 2.0]), (-2.0, [0.0, 0.0])])
def test_a_switch_at_the_start(end: float, expected: list[float]) -> None:
    """The direction of the run tells which side it is."""
    assert go(particle(force=Piecewise((1, t > 0), (0, True))), end).y[:, -1] == pytest.approx(expected, rel=1e-13)


def test_two_surfaces_at_the_same_time() -> None:
    model = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=Abs(x) + Abs(y), initial={x: 1.0, y: 1.0})
    found = go(model, 40 * math.sqrt(2))
    assert found.y[:, -1] == pytest.approx([1.0, 1.0, 0.0, 0.0], abs=1e-12)
    assert found.steps < 60


def test_an_impact_on_a_surface() -> None:
    """The floor of the ball is where its weight changes: the flight is above it alone."""
    model = build(kinetic=y.dot**2 / 2, potential=9 * y + Abs(y - 3), initial={y: 4.0})
    found = go(model, 9.0, [event(y - 3, direction=-1, reset={y.dot: -y.dot})])
    fall = math.sqrt(0.2)
    assert found.t_events[0] == pytest.approx(fall * np.arange(1, 21, 2)[: len(found.t_events[0])], rel=1e-13)
    assert len(found.t_events[0]) == 10 and found.y[0].min() > 3 - 1e-14


def test_a_surface_that_is_only_touched() -> None:
    """On a belt of speed 1 the mass moves as 1 - cos t, which reaches the speed of the belt and turns back."""
    found = go(particle(x**2 / 2, -sign(x.dot - 1)), 20.0)
    assert found.status is Status.SUCCESS
    assert found.y[:, -1] == pytest.approx([1 - math.cos(20), math.sin(20)], abs=1e-8)


def test_against_tight_steps_of_another_method() -> None:
    """DOP853 steps over the kinks, with an error that its tolerance drives down."""
    potential = Max(x, y) ** 2 + Abs(x - y / 2) ** 3 + Piecewise((y, x > 0.3), (0.3, True)) ** 2
    start = {x: 1.0, y: 0.5, y.dot: 0.3}
    model = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=potential, initial=start)
    here, there = go(model, 0.5), run(model, 0.5, "dop853", rtol=1e-12, atol=1e-14)
    assert here.y[:, -1] == pytest.approx(there.y[:, -1], abs=1e-8)


@pytest.mark.parametrize("target", TARGETS)
def test_a_flow_knows_the_sides(target: str) -> None:
    """Also where it never comes near a surface."""
    flow = flow_of(particle(Abs(x), target=target), method="taylor")
    assert flow([1.0, 0.0], 0.0, 0.5) == pytest.approx([0.875, -0.5], rel=1e-13)
    assert flow([10.0, 0.0], 0.0, 0.5) == pytest.approx([9.875, -0.5], rel=1e-13)
    assert flow([1.0, 0.0], 0.0, 4 * math.sqrt(2)) == pytest.approx([1.0, 0.0], abs=1e-12)
