"""Configurations where two motions cross: a run passes as the smooth one, or ends there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg

a, b, s = lg.coordinates("a b s")

CRANK = lg.System(
    kinetic=(a.dot**2 + b.dot**2 + s.dot**2) / 2,
    coordinates=[a, b, s],
    constraints={"along": cos(a) + cos(b) - s, "across": sin(a) - sin(b)},
    initial={a: 0.3, b: 0.3, s: 2 * np.cos(0.3)},
)
"""A slider-crank with equal rods. As the slider passes the crank's centre, both rods may turn together or apart."""

START = CRANK.consistent({a.dot: 3.0, b.dot: 3.0}).initial


def told(solution: lg.Solution) -> None:
    """Hold that the rods turn together, and that a run that ends before the end says why."""
    assert np.abs(solution[a] - solution[b]).max() < 1e-4
    if solution.status is not lg.Status.SUCCESS:
        assert solution.status is lg.Status.SINGULAR, solution.message
        assert "'across'" in solution.message and "near there, at a = " in solution.message
        assert "an error as small as the tolerance decides how the motion goes on." in solution.message
        assert "pass it with equal steps, such as those of rk4." in solution.message
        # The rods stand upright there.
        assert float(np.cos(solution.y[0, -1])) == pytest.approx(0.0, abs=1e-2)


@pytest.mark.parametrize("method", ["taylor", "dop853", "verner9", "radau5"])
@pytest.mark.parametrize("options", [{}, {"t_eval": np.linspace(0.0, 3.0, 301)}])
def test_no_method_goes_on_as_another_motion(method: str, options: dict[str, Any]) -> None:
    told(CRANK.run(3.0, START, method=method, check=False, **options))


def test_equal_steps_pass_it() -> None:
    solution = CRANK.run(3.0, START, method="rk4", step=0.01, check=False)
    assert solution.status is lg.Status.SUCCESS and float(np.cos(solution[a]).min()) < -0.9
    told(solution)


def test_a_sharp_turn_that_is_no_crossing_is_followed() -> None:
    """With rods that differ by a hundredth the slider turns before the centre, in short steps, and the run goes on."""
    near = lg.System(
        kinetic=(a.dot**2 + b.dot**2 + s.dot**2) / 2,
        coordinates=[a, b, s],
        constraints={"along": cos(a) + cos(b) - s, "across": sin(a) - 0.99 * sin(b)},
    )
    start = near.consistent({a: 0.3, b: 0.3, s: 1.9, a.dot: 3.0, b.dot: 3.0}).initial
    solution = near.run(3.0, start, check=False)
    assert solution.status is lg.Status.SUCCESS, solution.message
