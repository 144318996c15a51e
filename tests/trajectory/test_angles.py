"""Runs across the cut of atan2 (y = 0, x < 0), where its value jumps by 2 pi: a switching surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, x, y
from tests.trajectory.watched import go

ANGLE = sp.atan2(y, x)

LAWS: list[tuple[Any, Any, Callable[[float], tuple[float, float]]]] = [
    (sp.sign(ANGLE) / 10, 0, lambda a: (math.copysign(0.1, a), 0.0)),
    (ANGLE, -ANGLE, lambda a: (a, -a)),
    (sp.Abs(ANGLE - 1), -y, lambda a: (abs(a - 1), math.nan)),
    (-x + sp.Max(ANGLE, -2) / 5, -y, lambda a: (max(a, -2.0) / 5, math.nan)),
]
"""Forces along x and y, and by hand what the angle contributes; where nan stands, y is on a spring."""

STARTS = [([-1.0, 0.5, 0.0, -1.0], 1.5), ([-1.0, 0.5, 0.1, -0.7], 4.0), ([-2.0, -0.3, 0.3, 0.4], 6.0)]


def particle(force_x: Any = 0, force_y: Any = 0, target: str = "llvm", **options: Any) -> Model:
    forces = {x: force_x, y: force_y}
    return build(target, **{"kinetic": (x.dot**2 + y.dot**2) / 2, "forces": forces, "coordinates": [x, y], **options})


def state(values: Any) -> dict[Any, float]:
    return dict(zip((x, y, x.dot, y.dot), values, strict=True))


def by_hand(law: tuple[Any, Any, Callable[[float], tuple[float, float]]], start: list[float], end: float) -> Any:
    """Return the end state by SciPy, integrated from one crossing of y = 0 to the next.

    Between two crossings the angle is continued smoothly to x < 0.
    """
    sprung = law[0].has(sp.Max)
    z0, now, side = np.array(start), 0.0, math.copysign(1.0, start[1])

    def slope(_: float, z: Any) -> list[float]:
        angle = math.atan2(z[1], z[0]) if z[0] > 0 else side * math.pi - math.atan2(z[1], -z[0])
        along, across = law[2](angle)
        return [z[2], z[3], along - sprung * z[0], -z[1] if math.isnan(across) else across]

    def crossing(_: float, z: Any) -> float:
        return float(z[1])

    crossing.__dict__["terminal"] = True
    while now < end:
        crossing.__dict__["direction"] = -side
        part = solve_ivp(slope, (now, end), z0, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.02, events=crossing)
        now, z0, side = part.t[-1], part.y[:, -1], -side if part.status == 1 else side
    return z0


@pytest.mark.few(1)
@pytest.mark.parametrize(("start", "end"), STARTS, ids=["once", "over", "up"])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: str(law[0]))
def test_a_force_jumps_where_the_angle_does(law: Any, start: list[float], end: float) -> None:
    """The tolerance of 1e-8 is the error of the reference solution at kinks."""
    expected = by_hand(law, start, end)
    for target in TARGETS:
        result = go(particle(law[0], law[1], target), end, initial=state(start), rtol=1e-12)
        assert result.status is Status.SUCCESS
        assert result.y[:, -1] == pytest.approx(expected, abs=1e-8)
        back = go(particle(law[0], law[1], target), 0.0, start=end, initial=state(result.y[:, -1]), rtol=1e-12)
        assert back.y[:, -1] == pytest.approx(start, abs=1e-8)


@pytest.mark.few(2)
@pytest.mark.parametrize(("speed", "angle"), [(1.0, math.pi), (-1.0, -math.pi)])
@pytest.mark.parametrize("height", [0.0, -0.0])
def test_a_start_on_the_cut(speed: float, angle: float, height: float) -> None:
    """On the cut the angle has the value of the side to which the motion leaves."""
    result = go(particle(ANGLE), 1e-6, initial={x: -1.0, y: height, y.dot: speed})
    assert result.y[2, -1] == pytest.approx(angle * 1e-6, rel=1e-6) and result.steps < 5


def test_a_motion_that_sticks_to_the_cut_says_so() -> None:
    result = go(particle(sp.atan2(-x.dot, -1)), 4.0, initial={x.dot: 1.0})
    assert result.status is Status.STEP_TOO_SMALL and result.y[2, -1] == pytest.approx(0, abs=1e-12)
    assert "The equations of motion jump where -x_dot is zero" in result.message and "sticks" in result.message


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
def test_a_potential_that_is_periodic_in_the_angle_is_smooth(target: str) -> None:
    """cos(3 a) has no jump on the cut. The run equals that of the same potential written as a polynomial in x and y."""
    r2 = x**2 + y**2
    circle = {x: 1.0, y.dot: 1.1}
    ends = []
    for wave in (sp.cos(3 * ANGLE), (x**3 - 3 * x * y**2) / sp.sqrt(r2) ** 3):
        model = particle(target=target, potential=wave / 30 - 1 / sp.sqrt(r2))
        assert model.series()[0].program.sides == 0
        ends.append(go(model, 10.0, initial=circle, rtol=1e-12).y[:, -1])
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@pytest.mark.parametrize("period", [2.0, 2.1])
def test_zeros_behind_a_jump_of_an_event_are_on_its_step_too(period: float) -> None:
    """A step of length about 2 contains a jump of Mod(t, period) and a zero after it."""
    u = lg.coordinate("u")
    swing = lg.System(u.dot**2 / 2, u**2 / 2, initial={u: 1.0})
    run = swing.run(8.5, events=[sp.Mod(lg.t, period) - 1])
    expected = np.arange(1.0, 8.5, period)
    # Steps end there, and times of zeros have 14 digits.
    assert run.t_events[0] == pytest.approx(expected, abs=1e-9)
