"""Runs by taylor: accuracy, units, long runs, runs towards a singularity, and threads."""

from __future__ import annotations

from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp

from lagrange.evidence.precise_run import precise_run
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.trajectory import Status
from tests.models import SYSTEMS, TARGETS, build, g, m, model, x, y
from tests.series_systems import relative
from tests.trajectory.runs import exact, run

SMOOTH = ("pendulum", "double pendulum", "Kepler orbit", "cart and pole", "charge", "Henon-Heiles", "bead on a hoop")


@cache
def truth(name: str, end: float) -> Any:
    """Return the end state by collocation in multiple precision, from the stated energies."""
    statement = SYSTEMS[name]()
    values = {p: statement.defaults[p] for p in statement.parameters}
    return np.array(precise_run(model(name, "numpy"), values, 0.0, statement.initial, [end], digits=18)[0], dtype=float)


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("end", [1.5, -1.5])
@pytest.mark.parametrize("name", SMOOTH)
def test_the_error_is_what_was_asked_for(name: str, end: float, target: str) -> None:
    """The error is at most the tolerance times the growth of errors by the motion, up to 20 in this time."""
    expected = truth(name, end)
    size = max(1.0, np.abs(expected).max())
    for rtol in (1e-4, 1e-8, 1e-12, 1e-16):
        result = run(model(name, target), end, "taylor", rtol=rtol, atol=rtol)
        assert result.status is Status.SUCCESS and result.rejected == 0
        assert np.abs(result.y[:, -1] - expected).max() < 20 * max(rtol, 2e-15) * size, rtol


def test_a_system_in_loops() -> None:
    """A chain in seven relative angles has a full mass matrix, which is inverted at each step."""
    given = relative(7)
    compiled = build(
        lagrangian=given.lagrangian,
        coordinates=list(given.coordinates),
        initial=dict(zip((*given.coordinates, *given.velocities), given.initial, strict=True)),
    )
    assert compiled.series()[0].form(20) == "in loops"
    result = run(compiled, 1.0, "taylor", rtol=1e-13, atol=1e-13)
    assert result.y[:, -1] == pytest.approx(exact(compiled, 1.0).y[:, -1], abs=1e-9)


# --- long runs ------------------------------------------------------------------------------------------------


def test_the_phase_of_an_oscillator_after_many_steps() -> None:
    """The motion is cos t, with compensated sums of state and time.

    Each of n = 10^5 steps adds an error of about h eps. Random errors add to sqrt(n) h eps = 1e-13. Without
    compensation the error would be 1e-11 or more.
    """
    compiled = build(kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x: 1.0})
    end = 1.0e5
    result = run(compiled, end, Taylor(rtol=1e-16, atol=1e-16, order=20))
    assert result.steps > 5e4
    with mpmath.workdps(30):
        expected = [float(mpmath.cos(mpmath.mpf(end))), -float(mpmath.sin(mpmath.mpf(end)))]
    assert result.y[:, -1] == pytest.approx(expected, abs=2e-12)


# --- series that end, or have gaps ----------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("end", [1.0, 3.7, -2.0, 1e5])
def test_a_rock_without_air(end: float, target: str) -> None:
    """The series ends with t^2. The run takes one step with an error of one unit in the last place."""
    rock = build(
        target,
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        parameters={m: 1.5, g: 9.75},
        initial={x: 0.25, y: 1.5, x.dot: 3.5, y.dot: 12.0},
    )
    result = run(rock, end, "taylor")
    assert result.steps <= 2
    parts = np.array([[0.25, 3.5 * end, 0.0], [1.5, 12 * end, -9.75 * end**2 / 2], [3.5, 0, 0], [12, -9.75 * end, 0]])
    assert (np.abs(result.y[:, -1] - parts.sum(axis=1)) <= np.spacing(np.abs(parts).max(axis=1))).all()
    middle = result.dense(np.array([end / 2]))[:, 0]
    halves = parts * np.array([1.0, 0.5, 0.25])
    assert (np.abs(middle - halves.sum(axis=1)) <= np.spacing(np.abs(halves).max(axis=1))).all()


# --- tolerances -----------------------------------------------------------------------------------------------


# --- ends -----------------------------------------------------------------------------------------------------

STOPPED = (Status.STEP_TOO_SMALL, Status.NON_FINITE)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("start", "after"), [(0.0, 0.1), (7.0, 1e-100), (7.08, 1e-100)])
def test_coefficients_that_overflow(start: float, after: float, target: str) -> None:
    """In the potential exp(100 x) the motion diverges at once; at x = 7.0 already the second coefficient overflows."""
    steep = build(target, kinetic=x.dot**2 / 2, forces={x: sp.exp(100 * x)}, initial={x: start, x.dot: 1.0})
    result = run(steep, 1.0, "taylor", max_steps=10_000)
    assert result.status in STOPPED and np.isfinite(result.y).all() and 0 <= result.t[-1] < after
    assert "taylor stopped at t = " in result.message and ("x is" in result.message or "x_dot is" in result.message)


# --- flows ----------------------------------------------------------------------------------------------------
