"""Coordinates so large that doubles do not resolve what the forces change on."""

import pytest
from sympy import cos

import lagrange as lg

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
