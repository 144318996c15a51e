"""Coordinates so large that doubles do not resolve what the forces change on."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sympy import cos

import lagrange as lg
from lagrange.equations.euler_lagrange import StateLayout
from lagrange.trajectory.endings import _is_rough

theta = lg.coordinate("theta")
x = lg.coordinate("x")


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5", "rk4"])
@pytest.mark.parametrize("damping", [0, 1])
def test_a_pendulum_that_no_step_moves_is_unreliable(method: str, damping: int) -> None:
    """It was a success, with an energy that changed by 130 %; with damping no energy tells."""
    system = lg.System(
        kinetic=theta.dot**2 / 2,
        potential=-10 * cos(theta),
        forces={theta: -damping * theta.dot},
        initial={theta: 1e16},
    )
    found = system.run(0.5, method=method, step=0.01 if method == "rk4" else None)
    assert found.status is lg.Status.UNRELIABLE
    assert "theta is 1e+16, where doubles are 2 apart" in found.message and "nearer to zero" in found.message


@pytest.mark.parametrize("start", [1e16, 1.0, -1e-9])
def test_what_rests_or_is_far_away_is_no_fault(start: float) -> None:
    free = lg.System(kinetic=x.dot**2 / 2, potential=0, initial={x: start, x.dot: 1e-20})
    falling = lg.System(kinetic=x.dot**2 / 2, potential=x, initial={x: start})
    resting = lg.System(kinetic=x.dot**2 / 2, potential=(x - start) ** 2 / 2, initial={x: start})
    for system in (free, falling, resting):
        assert system.run(1e-3, method="dop853").status is lg.Status.SUCCESS


@pytest.mark.parametrize(("size", "rough"), [(1e-16, False), (1e-3, True)])
def test_an_acceleration_that_is_zero_up_to_rounding_is_no_fault(size: float, rough: bool) -> None:
    """Beside an acceleration of 1 one that jumps by 1e-16 from double to double is rounding, one by 1e-3 is not."""

    def rates(t: float, states: Any, parameters: Any) -> Any:
        jumps = size * np.random.default_rng(1).uniform(-1.0, 1.0, states.shape[1])
        return np.stack([states[2], states[3], np.ones_like(jumps), jumps])

    model = SimpleNamespace(kernel=lambda name: rates, layout=StateLayout(("x", "y"), ("x", "y")))
    problem: Any = SimpleNamespace(model=model, parameter_array=np.empty(0))
    assert _is_rough(problem, 0.0, np.array([0.1, 0.2, 0.0, 0.0]), 1) is rough
