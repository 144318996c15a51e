"""Systems that tests of several rooms state. A test changes what it needs: `pendulum(initial={theta: 1.0})`."""

from __future__ import annotations

from typing import Any

from sympy import cos

import lagrange as lg
from tests.models import g, l, m, theta, x, y


def pendulum(**changes: Any) -> lg.System:
    """Return a pendulum of length 1, from 2 rad at rest."""
    stated = {
        "kinetic": m * l**2 * theta.dot**2 / 2,
        "potential": -m * g * l * cos(theta),
        "parameters": {m: 1.0, g: 9.81, l: 1.0},
        "initial": {theta: 2.0},
        "name": "pendulum",
    }
    return lg.System(**stated | changes)


def unit_pendulum(**changes: Any) -> lg.System:
    """Return theta'' = -sin(theta), from 1 rad at rest."""
    stated = {"kinetic": theta.dot**2 / 2, "potential": -cos(theta), "initial": {theta: 1.0}, "name": "pendulum"}
    return lg.System(**stated | changes)


def rod_pendulum(**changes: Any) -> lg.System:
    """Return a pendulum in Cartesian coordinates, held by a rod of length 1, from (0.6, -0.8) at rest."""
    stated = {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"rod": x**2 + y**2 - l**2},
        "parameters": {m: 1.0, g: 9.81, l: 1.0},
        "initial": {x: 0.6, y: -0.8},
    }
    return lg.System(**stated | changes)
