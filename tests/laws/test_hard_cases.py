"""Hard cases with a closed form or a published result, for all explicit adaptive methods of order 5 or more."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.special import ellipj, ellipk
from sympy import cos, sin, sqrt

import lagrange as lg

METHODS = [
    row.name
    for row in lg.methods.table()
    if row.claims.adaptive and row.claims.explicit and row.claims.order >= 5 and not row.name.startswith("scipy-")
]
TIGHT: dict[str, Any] = {"rtol": 1e-13, "atol": 1e-16}

x, y, theta, phi, psi = lg.coordinates("x y theta phi psi")


def kepler_state(r: float, v: float, end: float) -> list[float]:
    """Return the state of a Kepler orbit (mu = 1) that starts at the pericentre, from the exact initial doubles."""
    with mpmath.workdps(40):
        axis = 1 / (2 / mpmath.mpf(r) - mpmath.mpf(v) ** 2)
        e, motion = 1 - r / axis, axis ** mpmath.mpf("-1.5")
        low, high = motion * end - e, motion * end + e
        for _ in range(140):
            middle = (low + high) / 2
            low, high = (middle, high) if middle - e * mpmath.sin(middle) < motion * end else (low, middle)
        return [float(axis * (mpmath.cos(low) - e)), float(axis * mpmath.sqrt(1 - e * e) * mpmath.sin(low))]


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("e", "allowed"), [(0.99, 1e-8), (0.9999, 1e-6)])
def test_an_orbit_that_is_nearly_a_fall(method: str, e: float, allowed: float) -> None:
    """The run has three revolutions.

    Round-off at the pericentre changes the period by 1e-16/(1 - e). A tolerance of 1e-13 may have a thousand times
    this effect.
    """
    orbit = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2), name="orbit")
    r, v = 1 - e, math.sqrt((1 + e) / (1 - e))
    run = orbit.run(20.0, {x: r, y.dot: v}, method=method, **TIGHT).require()
    assert run.y[:2, -1] == pytest.approx(kepler_state(r, v, 20.0), abs=allowed)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turn", [1e-3, 1e-6])
def test_a_spherical_pendulum_passes_its_pole(method: str, turn: float) -> None:
    """Near the pole the azimuth changes by pi at once. For a small angular momentum the motion is that in a plane."""
    swing = lg.System(
        kinetic=(theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2, potential=-cos(theta), coordinates=[theta, phi]
    )
    run = swing.run(20.0, {theta: 1.0, phi.dot: turn}, method=method, **TIGHT).require()
    k2 = math.sin(0.5) ** 2
    alone = 2 * np.arcsin(math.sqrt(k2) * ellipj(ellipk(k2) - run.t, k2)[0])
    place = np.array([np.sin(run["theta"]) * np.cos(run["phi"]), -np.cos(run["theta"])])
    assert np.abs(place - [np.sin(alone), -np.cos(alone)]).max() < 20 * turn**2 + 1e-10
    assert np.abs(np.sin(run["theta"])).min() < 0.1
    momentum = run.evaluate(sin(theta) ** 2 * phi.dot)
    assert momentum == pytest.approx(math.sin(1.0) ** 2 * turn, rel=1e-9)
