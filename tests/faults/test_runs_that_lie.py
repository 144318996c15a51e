"""Thirteen ways to fool an integrator, on each of ours: every run ends, none in silence, and what it has is kept."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import Piecewise, sqrt

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import TARGETS, build, x
from tests.trajectory.runs import ADAPTIVE, FIXED, IMPLICIT, NAMES, SPLITTINGS, run

NOWHERE: Mapping[Any, float] = MappingProxyType({})
STOPPED = (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.MAX_STEPS, Status.MAX_WALL, Status.DIVERGED)
TIME_LIMIT = 1000.0
"""Seconds after which a run does not end of itself, on the busiest machine."""
ANY_FORCE = tuple(name for name in NAMES if name not in SPLITTINGS)


def particle(target: str = "llvm", force: Any = 0, initial: Mapping[Any, float] = NOWHERE) -> Model:
    """A unit mass on a line, one model for all methods."""
    return _particle(target, sp.sympify(force), tuple(initial.items()))


@cache
def _particle(target: str, force: Any, initial: tuple[tuple[Any, float], ...]) -> Model:
    return build(target, kinetic=x.dot**2 / 2, forces={x: force}, initial=dict(initial))


def go(model: Model, end: float, name: str, step: float = 0.01, **options: Any) -> Trajectory:
    """Run with limits that a sane run never meets, and hold the result to what every result must be."""
    if model.target == "numpy" and name in ("bs3", "radau3", "radau5"):
        pytest.skip("the same steps as on llvm, see test_driver and test_implicit, and many of them")
    began = time.process_time()
    if name in FIXED:
        options["step"] = step
    found = run(model, end, name, max_wall=TIME_LIMIT, max_steps=300_000, **options)
    # A hang guard: an interpreted Taylor step takes some milliseconds, and a brief force a thousand steps.
    assert time.process_time() - began < (600.0 if model.target == "numpy" else 60.0)
    assert np.isfinite(found.t).all() and np.isfinite(found.y).all()
    assert found.y.shape == (2, len(found.t)) and len(found.t) == found.steps + 1
    assert found.span == (found.t[0], found.t[-1]) and found.t[-1] <= end
    assert found.message.startswith(name)
    if found.status is not Status.SUCCESS:
        assert f"at t = {found.t[-1]:.6g} on the way from 0 to {end:.6g}" in found.message
        assert found.t[-1] < end
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_initial_state_is_not_a_number(name: str) -> None:
    for bad in (math.nan, math.inf):
        with pytest.raises(StatementError, match=f"the initial value of x is {bad}: give a finite number"):
            go(particle(), 1.0, name, initial={x: bad})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_not_a_number_from_half_time(name: str, target: str) -> None:
    found = go(particle(target, Piecewise((-x, t < 0.5)), initial={x: 1.0}), 1.0, name)
    assert found.status is Status.NON_FINITE
    assert found.t[-1] == pytest.approx(0.5, abs=0.011)
    assert "x_dot is nan" in found.message or "the acceleration of x is nan" in found.message
    assert found.y[0, -1] == pytest.approx(math.cos(found.t[-1]), abs=0.01)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_infinite_from_half_time(name: str, target: str) -> None:
    late = Piecewise((0, t < 0.5), (2000, True))
    found = go(particle(target, sp.exp(late) - 1 - x, initial={x: 1.0}), 1.0, name)
    assert found.status is Status.NON_FINITE and found.t[-1] == pytest.approx(0.5, abs=0.011)
    assert "inf" in found.message or "nan" in found.message


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_root_leaves_its_domain(name: str, target: str) -> None:
    """Towards x = 1 at constant speed, with a force sqrt(1 - x) that ends there."""
    found = go(particle(target, -sqrt(1 - x) / 100, initial={x.dot: 1.0}), 5.0, name)
    assert found.status is Status.NON_FINITE
    assert found.t[-1] == pytest.approx(1.0, abs=0.05) and "its domain" in found.message


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ANY_FORCE)
def test_blow_up_in_finite_time(name: str, target: str) -> None:
    """v' = v^2 from 1 is 1/(1 - t)."""
    found = go(particle(target, x.dot**2, initial={x.dot: 1.0}), 2.0, name)
    assert found.status in (*STOPPED[:2], Status.DIVERGED)
    assert found.t[-1] == pytest.approx(1.0, abs=0.2 if name in ("euler", *IMPLICIT) else 0.06)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_double_pole(name: str, target: str) -> None:
    """x'' = 6 x^2 with x = 1/(1 - t)^2."""
    pole = build(target, kinetic=x.dot**2 / 2, potential=-2 * x**3, initial={x: 1.0, x.dot: 2.0})
    found = go(pole, 5.0, name)
    assert found.status in (*STOPPED[:2], Status.DIVERGED)
    assert found.t[-1] == pytest.approx(1.0, abs=0.4)
    if name in ADAPTIVE:
        assert found.t[-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("events", [[x**3 - x], [x - 1, x - sp.Rational(1001, 1000)], [(x - 1) * (x - 1.001)]])
def test_no_event_hides_behind_another(events: list[Any], target: str) -> None:
    """Three roots of a cubic and two roots 1e-3 apart, within one step; so are those of two events."""
    found = go(particle(target, initial={x: -2.0, x.dot: 1.0}), 6.0, "taylor", events=events)
    times = [time for row in found.t_events for time in row]
    places = [-1.0, 0.0, 1.0] if events[0] == x**3 - x else [1.0, 1.001]
    assert found.status is Status.SUCCESS
    # On a step of 6 a term of the product is 36, and its slope at a root 1e-3: four roundings of that are 1.6e-11.
    precision = 1.6e-11 if len(events) == 1 and len(places) == 2 else 1e-13
    assert times == pytest.approx([2.0 + place for place in places], rel=precision)


@pytest.mark.parametrize("events", [[sp.nan], lambda t, y: math.nan, [sp.Integer(0)]])
def test_an_event_without_a_zero_to_find_is_refused(events: Any) -> None:
    with pytest.raises(StatementError, match="event"):
        go(particle(), 1.0, "taylor", events=events)


@pytest.mark.parametrize("target", TARGETS)
def test_an_event_that_is_not_a_number_on_the_way(target: str) -> None:
    """log(1 - x) and its series end at x = 1, to which they come closer and closer."""
    found = go(particle(target, initial={x.dot: 1.0}), 2.0, "taylor", events=[sp.log(1 - x) + 1])
    assert found.status is Status.NON_FINITE and found.t[-1] == pytest.approx(1.0, abs=1e-10)
    assert "log(1 - x) + 1, which is watched, has a pole there or leaves its domain" in found.message
    assert found.t_events[0] == pytest.approx([1 - math.exp(-1)], rel=1e-9)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["sharp", "smooth"])
def test_a_push_of_a_tenth_of_a_second_within_a_hundred(name: str, target: str, kind: str) -> None:
    if target == "numpy" and name in FIXED:
        pytest.skip("the same steps as on llvm, see test_driver, and many of them")
    push = (
        Piecewise((10, (t > 50) & (t < 50.1)), (0, True)) if kind == "sharp" else 10 * sp.exp(-(((t - 50) / 0.05) ** 2))
    )
    found = go(particle(target, push), 100.0, name, step=5e-3)
    speed = 1.0 if kind == "sharp" else 10 * 0.05 * math.sqrt(math.pi)
    assert found.status is Status.SUCCESS
    assert found.y[1, -1] == pytest.approx(speed, rel=0.06)


@pytest.mark.few
@pytest.mark.parametrize("name", ANY_FORCE)
def test_a_stiff_relaxation_oscillation(name: str) -> None:
    """Van der Pol with mu = 1e5: right, or stopped in words."""
    stiff = particle(force=1e5 * (1 - x**2) * x.dot - x, initial={x: 2.0})
    found = go(stiff, 1.0, name, step=1e-3)
    if found.status is Status.SUCCESS:
        assert found.y[:, -1] == pytest.approx([2 - 1 / 1.5e5, -1 / 1.5e5], rel=1e-4)
    else:
        assert found.status in STOPPED
    far = go(stiff, 1e4, name, step=1e-3)
    if name.startswith("radau"):  # the period is 1.614 mu (Hairer, Wanner, II, IV.1), so this is its first slow part
        slow = far.y[0, -1]
        assert far.status is Status.SUCCESS
        assert np.log(slow) - slow**2 / 2 == pytest.approx(np.log(2) - 2 + 1e4 / 1e5, abs=1e-6)
        return
    assert far.status in STOPPED or name in IMPLICIT
    assert far.status not in (Status.MAX_STEPS, Status.MAX_WALL) or "a stiff system wants an" in far.message


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_tolerances_of_zero(name: str, target: str) -> None:
    found = go(particle(target, -x, initial={x: 1.0}), 3.0, name, rtol=0.0, atol=0.0)
    assert found.status is Status.SUCCESS
    assert found.y[:, -1] == pytest.approx([math.cos(3), -math.sin(3)], abs=1e-11)
    least = 1.11e-16 if name == "taylor" else 2.22e-14  # a series has no estimate made of differences, full of noise
    assert f"rtol = 0 is below round-off and was raised to {least}" in found.message


@pytest.mark.parametrize("name", ADAPTIVE)
def test_tolerances_of_zero_from_rest(name: str) -> None:
    """Every scale of the error is zero at the start."""
    found = go(particle(force=1 - x), 3.0, name, rtol=0.0, atol=0.0)
    assert found.status is Status.SUCCESS
    assert found.y[0, -1] == pytest.approx(1 - math.cos(3), abs=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_time_that_no_step_can_pass(name: str) -> None:
    """Near t = 1e16 the spacing of doubles is two."""
    if name in FIXED:
        with pytest.raises(
            StatementError, match=r"step = 0\.01 is below the spacing of floating-point times near t = 1e\+16"
        ):
            run(particle(force=-x), 1e16 + 8, name, start=1e16, step=0.01)
    else:
        found = run(particle(force=-x, initial={x: 1.0}), 1e16 + 8, name, start=1e16, max_steps=1000)
        assert found.status is Status.STEP_TOO_SMALL and "spacing of floating-point times" in found.message


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_force_that_overflows(name: str, target: str) -> None:
    found = go(particle(target, sp.exp(x), initial={x: 1.0, x.dot: 1.0}), 50.0, name)
    assert found.status in (*STOPPED[:2], Status.DIVERGED)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_a_kink_is_passed_and_not_stuck_on(name: str, target: str) -> None:
    """Dry friction changes sign at rest; a ball meets a hard spring."""
    rubbed = go(particle(target, -sp.sign(x.dot) - x, initial={x: 3.5}), 6.0, name, rtol=1e-6, atol=1e-8)
    assert rubbed.status in (Status.SUCCESS, *STOPPED)
    wall = build(target, kinetic=x.dot**2 / 2, potential=x + 5000 * sp.Max(0, -x) ** 2, initial={x: 1.0})
    bounced = go(wall, 8.0, name)
    assert bounced.status is Status.SUCCESS
    energy = wall.energy(bounced.y[:1], bounced.y[1:])
    assert np.abs(energy - 1).max() < 1e-5
