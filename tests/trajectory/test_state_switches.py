"""Forces that switch with the motion: adaptive methods without series end their steps on the surfaces, too."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg

x, y = lg.coordinates("x y")
HALF = sp.Rational(1, 2)
FORCES: dict[str, Any] = {
    "bilinear spring": -3 * sp.Piecewise((x, x < 0), (0, True)),
    "step": -sp.Heaviside(x - HALF),
    "wall": -40 * sp.Max(x - 1, 0),
    "friction": -sp.sign(x.dot) / 20,
    "two surfaces at once": -sp.Abs(x) - sp.Heaviside(2 * x) / 2,
    "beside a switch of time": -sp.Heaviside(x - HALF) + sp.sign(sp.sin(lg.t)) / 4,
    "a surface that moves": -sp.Max(x - y, 0) + sp.sin(lg.t) / 3,
}


def system(force: str) -> lg.System:
    """Return two oscillators, the first under a force that switches."""
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=x**2 / 2 + y**2,
        forces={x: FORCES[force]},
        initial={x: 1.5, y: 0.4},
        name=force,
    )


@pytest.mark.few
@pytest.mark.parametrize("method", ["dop853", "radau5", "verner9", "scipy-dop853"])
@pytest.mark.parametrize("force", FORCES)
def test_no_step_has_a_switch_inside(force: str, method: str) -> None:
    """Steps across these surfaces leave 1e-8 to 1e-6, and reject half of the tries."""
    model, times = system(force).compile("numpy", check=False), np.linspace(0.0, 8.0, 41)
    expected = lg.integrate(model, (0.0, 8.0), rtol=1e-14, t_eval=times).y
    events = [lg.event(x - HALF), lg.event(y)]
    run = lg.integrate(model, (0.0, 8.0), method=method, rtol=1e-11, atol=1e-11, t_eval=times, events=events)
    assert run.status.complete
    # Errors of steps of 1e-11 grow by the velocity at a surface, and by the stiffness of the wall.
    np.testing.assert_allclose(run.y, expected, rtol=0, atol=2e-9)
    taylor = lg.integrate(model, (0.0, 8.0), events=events)
    for ours, theirs in zip(run.t_events, taylor.t_events, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7)


def test_rejections_at_surfaces_are_gone() -> None:
    run = lg.integrate(system("wall").compile("numpy", check=False), (0.0, 8.0), method="dop853", rtol=1e-10)
    assert run.trajectory.rejected <= 4


THREE_HALVES = sp.Rational(3, 2)
UNDEFINED_BEYOND: dict[str, Any] = {
    "a contact of spheres": -40 * sp.Piecewise(((x - 1) ** THREE_HALVES, x > 1), (0, True)),
    "a surface in a branch": sp.Piecewise((sp.sign(sp.sqrt(-x) - HALF) / 10, x < 0), (0, True)),
}


@pytest.mark.few
@pytest.mark.parametrize("method", ["dop853", "radau5", "scipy-dop853"])
@pytest.mark.parametrize("force", UNDEFINED_BEYOND)
def test_branches_without_a_value_beyond_their_surface_run_as_stated(force: str, method: str) -> None:
    """A step of one side never reaches such a surface, and a wrong side of a surface inside it was an error of 0.05."""
    oscillator = lg.System(x.dot**2 / 2, x**2 / 2, forces={x: UNDEFINED_BEYOND[force]}, initial={x: 1.5})
    model = oscillator.compile("numpy", check=False)
    expected = lg.integrate(model, (0.0, 8.0), rtol=1e-14).y[:, -1]
    run = lg.integrate(model, (0.0, 8.0), method=method, rtol=1e-10)
    assert run.status is lg.Status.SUCCESS
    # Steps over the surfaces as stated leave up to 1e-7 each, as such runs always did.
    np.testing.assert_allclose(run.y[:, -1], expected, rtol=0, atol=1e-6)


def test_messages_state_the_span_and_the_limits_of_the_whole_run() -> None:
    run = system("wall").run(80.0, method="dop853", max_steps=100, target="numpy")
    assert run.status is lg.Status.MAX_STEPS
    assert "on the way from 0 to 80" in run.message and "100" in run.message, run.message
