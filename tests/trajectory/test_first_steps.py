"""First steps begin where their error estimate means something, and not decades below the steps that follow."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import lagrange as lg
from lagrange.machine.model import Model
from tests.models import shared_scene

METHODS = ("bs3", "dopri5", "tsit5", "dop853", "verner9")
SCENES = (
    *("bead-on-hoop", "chain-of-springs", "charge-in-field", "double-pendulum", "elastic-pendulum", "henon-heiles"),
    *("kepler", "mass-on-spring", "pendulum", "pleiades", "spherical-pendulum", "sun-earth-moon"),
)
"""Scenes that are at no equilibrium, and whose motion is not a polynomial in time that a method follows exactly."""

MOST_GROWTH = 10.0
"""Step control lets a step grow by this factor at most, whatever its error."""


@cache
def scene(name: str) -> Model:
    return shared_scene(name).compile()


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_first_step_is_less_than_two_growths_away(name: str, method: str, rtol: float) -> None:
    """An error far below the tolerance is round-off: a step then grows by the most that it may, again and again."""
    model = scene(name)
    span = shared_scene(name).statement.run.t_end or 10.0
    for absolute in (None, rtol):
        found = lg.integrate(model, (0.0, span), method=method, rtol=rtol, atol=absolute, max_steps=6)
        steps = np.diff(found.t)
        assert len(steps) >= 3
        assert steps[2] < 0.9 * MOST_GROWTH**2 * steps[0]
