"""A run that gave up because it was stiff says so, and names a method that gets through."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.trajectory.measures.stiffness import LIMITS, with_stiff_end
from tests.models import shared_scene

theta, phi = lg.coordinates("theta phi")

DAMPED = lg.System(
    kinetic=(theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2,
    potential=-9.81 * cos(theta),
    dissipation=0.3 * (theta.dot**2 + phi.dot**2) / 2,
    initial={theta: 1.0, phi.dot: 1.0},
)
"""A spherical pendulum whose damping is that of its angles: towards the lowest point phi has hardly any inertia, and
the damping of phi becomes stiff without bound, while the motion comes to rest in phi and goes on in theta."""


@pytest.mark.parametrize("method", ["taylor", "dop853", "tsit5"])
def test_a_stiff_run_that_gives_up_names_the_cause_and_an_implicit_method(method: str) -> None:
    found = DAMPED.run(5.0, method=method, max_steps=8000)
    assert found.status is lg.Status.MAX_STEPS
    reached = f"{found.trajectory.span[1]:.6g}"
    assert reached.startswith("0.88") and found.message.startswith(
        f"{method} stopped at t = {reached} on the way from 0 to 5, after {found.steps} steps: max_steps is used up. "
        "The run is stiff: at "
    )
    assert found.message.endswith(
        "times more slowly; use radau5. radau5 is an implicit method, whose steps stability does not limit."
    )


def test_the_method_that_is_named_gets_through() -> None:
    """It swings through the lowest point, where phi has no inertia at all: at lower tolerances a step may end there."""
    assert DAMPED.run(5.0, method="radau5", rtol=1e-8).status is lg.Status.SUCCESS


@pytest.mark.parametrize("status", LIMITS)
def test_each_limit_is_said(status: lg.Status) -> None:
    found = DAMPED.run(5.0, method="dop853", max_steps=8000)
    ended = with_stiff_end(found.model, replace(found.trajectory, status=status), found.parameters, 5.0)
    assert f"steps: {LIMITS[status]}. The run is stiff: at " in ended.message
    assert "singularity" not in ended.message


def test_other_ends_keep_their_message() -> None:
    gone = shared_scene("double-pendulum").run(50.0, method="dop853", max_steps=300)
    assert gone.status is lg.Status.MAX_STEPS and gone.message.startswith("dop853 used up max_steps = 300 at t = ")
    whole = DAMPED.run(0.5, method="dop853")
    assert whole.message == "dop853 reached t = 0.5."
