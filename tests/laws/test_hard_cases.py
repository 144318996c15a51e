"""Hard cases with a closed form or a published result, for all explicit adaptive methods of order 5 or more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk, mathieu_a
from sympy import cos, sin, sqrt

import lagrange as lg
from tests.models import shared_scene

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


def attracting(masses: Sequence[float], places: Any, velocities: Any) -> lg.System:
    """Return point masses in the plane that attract each other, with G = 1."""
    points = [lg.coordinates(f"x{i} y{i}") for i in range(len(masses))]
    initial: dict[Any, float] = {}
    for point, place, velocity in zip(points, places, velocities, strict=True):
        initial |= dict(zip((*point, *(q.dot for q in point)), (*place, *velocity), strict=True))
    potential = sum(
        -masses[i] * masses[j] / sqrt(sum((a - b) ** 2 for a, b in zip(points[i], points[j], strict=True)))
        for i, j in combinations(range(len(masses)), 2)
    )
    return lg.System(
        kinetic=sum(lg.kinetic_energy(m, point) for m, point in zip(masses, points, strict=True)),
        potential=potential,
        coordinates=[q for point in points for q in point],
        initial=initial,
        name="bodies",
    )


@pytest.mark.few(2)
@pytest.mark.parametrize("method", METHODS)
def test_the_figure_eight_returns(method: str) -> None:
    """Start and period as published to 14 digits (A. Chenciner, R. Montgomery, 2000, after C. Simo)."""
    place, speed = (0.97000435669734, -0.24308753153583), (-0.93240737144104, -0.86473146092102)
    half = (-speed[0] / 2, -speed[1] / 2)
    eight = attracting((1, 1, 1), (place, (-place[0], -place[1]), (0, 0)), (half, half, speed))
    run = eight.run(6.32591398292621, method=method, **TIGHT).require()
    assert run.y[:, -1] == pytest.approx(run.y[:, 0], abs=2e-11)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_burraus_bodies_part_as_published(method: str) -> None:
    """The mass 3 escapes from the other two (V. Szebehely, C. F. Peters, Astron. J. 72, 1967)."""
    places = np.array([(1, 3), (-2, -1), (1, -1)])
    run = attracting((3, 4, 5), places, ((0, 0),) * 3).run(80.0, method=method, **TIGHT).require()
    where, moving = (part.reshape(3, 2) for part in np.split(run.y[:, -1], 2))
    bound = [
        (i, j)
        for i, j in combinations(range(3), 2)
        if (((moving[i] - moving[j]) ** 2).sum() / 2 < (7 + i + j - 1) / np.linalg.norm(where[i] - where[j]))
    ]
    assert run.energy[0] == pytest.approx(-769 / 60, rel=1e-15)
    assert bound == [(1, 2)]
    assert np.linalg.norm(where[0]) > 10.0


@pytest.mark.few
@pytest.mark.parametrize("method", METHODS)
def test_the_threshold_of_kapitzas_pendulum(method: str) -> None:
    """theta'' = (g - a omega^2 cos(omega t)) theta/l becomes stable at -4 g/(l omega^2) = a_0(2 a/l) of Mathieu."""
    a = lg.parameters("a")
    omega, g = 20.0, 9.81
    place = (sin(theta), a * cos(omega * lg.t) + cos(theta))
    shaken = lg.System(kinetic=lg.kinetic_energy(1, place), potential=g * place[1], parameters={a: 0.2}, name="shaken")
    flow, tiny, period = lg.flow(shaken.compile(), method=method, rtol=1e-12, atol=1e-24), 1e-9, 2 * math.pi / omega

    def trace(amplitude: float) -> float:
        ends = [flow(np.array(start) * tiny, 0.0, period, {a: amplitude}) for start in ([1.0, 0.0], [0.0, 1.0])]
        return float((ends[0][0] + ends[1][1]) / tiny - 2)

    threshold = brentq(lambda q: mathieu_a(0, q) + 4 * g / omega**2, 1e-3, 0.8, xtol=1e-15) / 2
    assert brentq(trace, 0.1, 0.4, xtol=1e-15) == pytest.approx(threshold, rel=1e-10)
    assert threshold == pytest.approx(math.sqrt(2 * g) / omega, rel=0.02)  # a^2 omega^2 = 2 g l, to leading order


@pytest.mark.few
@pytest.mark.parametrize("method", METHODS)
def test_a_lower_bob_that_weighs_nothing_is_not_felt(method: str) -> None:
    chain = shared_scene("double-pendulum")
    run = chain.run(10.0, {"theta1": 1.0, "theta2": 2.0}, parameters={"m2": 1e-12}, method=method, **TIGHT).require()
    k2 = math.sin(0.5) ** 2
    alone = 2 * math.asin(math.sqrt(k2) * ellipj(float(ellipk(k2)) - math.sqrt(9.81) * 10.0, k2)[0])
    assert run["theta1"][-1] == pytest.approx(alone, abs=1e-9)


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
