"""If the mass matrix becomes singular, the message names the place and the motion without inertia."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import build, x, y
from tests.trajectory.runs import run

METHODS = ("taylor", "dop853", "tsit5", "radau5", "scipy-lsoda")


def quartic(target: str = "llvm") -> Model:
    """Return a system whose momentum v**3 decreases from v = 1 to zero at t = 1, x = 3/4."""
    return build(target, lagrangian=x.dot**4 / 4 - x, initial={x.dot: 1.0})


def indefinite() -> Model:
    """Return a system whose mass matrix has the determinant x (y - 1) - 1, which becomes zero."""
    return build(
        lagrangian=x.dot * y.dot + x * x.dot**2 / 2 + (y - 1) * y.dot**2 / 2 - x - y,
        coordinates=[x, y],
        initial={x: 0.2, y: 0.3, x.dot: 0.1, y.dot: 0.2},
    )


def lightened() -> Model:
    return build(
        kinetic=(x.dot + y.dot) ** 2 / 2 + (1 - x) * y.dot**2 / 2,
        potential=-x,
        coordinates=[x, y],
        initial={x.dot: 0.3},
    )


def told(result: Trajectory, motion: str) -> None:
    assert result.status is Status.SINGULAR and f"{result.method} stopped at t = " in result.message
    assert "the mass matrix d2L/dv2 becomes singular there, at x = " in result.message
    assert (
        f"the inertia of a motion with {motion} is " in result.message and "times the least inertia" in result.message
    )
    assert result.message.endswith("End the run before, or state a Lagrangian whose inertia does not vanish.")
    assert len(result.t) == result.steps + 1 > 5


@pytest.mark.parametrize("method", METHODS)
def test_a_momentum_that_is_not_linear_in_the_velocity(method: str) -> None:
    result = run(quartic(), 5.0, method)
    told(result, "x.dot = 1")
    assert result.t[-1] == pytest.approx(1.0, abs=1e-6) and result.y[0, -1] == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("model", "motion"), [(indefinite, "x.dot = 1, y.dot = 0.8295"), (lightened, "x.dot = 1, y.dot = -1")]
)
def test_a_motion_that_loses_its_inertia(model: Callable[[], Model], motion: str, method: str) -> None:
    told(run(model(), 5.0, method), motion)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "given",
    [
        {"kinetic": x.dot**2 / 2, "potential": -(x**4), "initial": {x: 1.0, x.dot: 1.0}},
        # A fall onto the centre of polar coordinates: y loses its inertia, but the force is what is infinite.
        {"kinetic": (x.dot**2 + x**2 * y.dot**2) / 2, "potential": -1 / x, "coordinates": [x, y], "initial": {x: 1.0}},
    ],
)
def test_other_singularities_are_not_blamed_on_it(given: dict[str, Any], method: str) -> None:
    result = run(build(**given), 5.0, method)
    # LSODA may step over a pole, and what gives it away is the energy.
    ends = (Status.STEP_TOO_SMALL, Status.NON_FINITE, *([Status.UNRELIABLE] if method == "scipy-lsoda" else []))
    assert result.status in ends and "mass matrix" not in result.message
