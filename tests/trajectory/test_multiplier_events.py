"""Events on multipliers and accelerations, such as a contact force that becomes zero, on both machines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, sign

import lagrange as lg
from lagrange.trajectory.trajectory import Status

m, g, l, J = lg.parameters("m g l J")
x, y, theta, phi = lg.coordinates("x y theta phi")

METHODS = ["taylor", "dop853", "verner9", "scipy-dop853", "radau5"]


def on_sphere() -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"sphere": x**2 + y**2 - l**2},
        parameters={m: 1.3, g: 9.81, l: 1},
        initial={x: 0.6, y: 0.8},
        name="on the sphere",
    )


def until(system: lg.System, name: str, method: str = "taylor", target: str = "llvm") -> lg.Solution:
    event = lg.event(lg.multiplier(name), terminal=True)
    return system.run(5.0, events=[event], method=method, rtol=1e-12, target=target)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("method", METHODS)
def test_a_particle_leaves_the_sphere_at_two_thirds_of_its_height(method: str, target: str) -> None:
    solution = until(on_sphere(), "sphere", method, target)
    assert solution.status is Status.EVENT
    # Radau's tolerance bounds what a step may err by; the others err by less than it.
    assert solution[y][-1] == pytest.approx(2 / 3 * 0.8, abs=1e-10)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_accelerations_may_be_in_events(target: str) -> None:
    arm = lg.System(
        kinetic=theta.dot**2 + theta.dot * phi.dot * cos(theta - phi) + phi.dot**2 / 2,
        potential=-2 * g * cos(theta) - g * cos(phi),
        parameters={g: 9.81},
        initial={theta: 1.2, phi: 0.7},
    )
    runs = [
        arm.run(2.0, events=[theta.ddot, phi.ddot - theta.ddot], method=method, rtol=1e-12, target=target)
        for method in ("taylor", "dop853")
    ]
    for times, others in zip(*(run.t_events for run in runs), strict=True):
        assert len(times) > 1
        np.testing.assert_allclose(times, others, atol=1e-9)  # steps of 1e-12 over some ten of them


def test_multipliers_are_watched_across_switches_of_the_forces() -> None:
    """A wind acts from x = 0.7 on. The accelerations in an event must be those of the present side."""
    stated: dict[str, Any] = {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"sphere": x**2 + y**2 - l**2},
        "forces": {x: -J * (1 + sign(x - 0.7))},
        "parameters": {m: 1.3, g: 9.81, l: 1, J: 2.0},
        "initial": {x: 0.6, y: 0.8},
    }
    ends = [until(lg.System(**stated), "sphere", method).t[-1] for method in ("taylor", "dop853")]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
