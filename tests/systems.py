"""Systems for tests of several rooms. A test may replace arguments: `pendulum(initial={theta: 1.0})`."""

from functools import cache
from typing import Any

from sympy import cos, sin

import lagrange as lg
from tests.models import g, l, m, phi, theta, x, y


def pendulum(**changes: Any) -> lg.System:
    """Return a pendulum of length 1, released at 2 rad."""
    stated = {
        "kinetic": m * l**2 * theta.dot**2 / 2,
        "potential": -m * g * l * cos(theta),
        "parameters": {m: 1.0, g: 9.81, l: 1.0},
        "initial": {theta: 2.0},
        "name": "pendulum",
    }
    return lg.System(**stated | changes)


def conical_pendulum(**changes: Any) -> lg.System:
    """Return a pendulum in space, in its angle to the vertical and the angle about it."""
    kinetic, potential = m * l**2 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2, -m * g * l * cos(theta)
    return lg.System(kinetic, potential, **{"coordinates": [theta, phi]} | changes)


def unit_pendulum(**changes: Any) -> lg.System:
    """Return the pendulum theta'' = -sin(theta), released at 1 rad."""
    stated = {"kinetic": theta.dot**2 / 2, "potential": -cos(theta), "initial": {theta: 1.0}, "name": "pendulum"}
    return lg.System(**stated | changes)


def rod_pendulum(**changes: Any) -> lg.System:
    """Return a pendulum in Cartesian coordinates on a rod of length 1, released at (0.6, -0.8)."""
    stated = {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"rod": x**2 + y**2 - l**2},
        "parameters": {m: 1.0, g: 9.81, l: 1.0},
        "initial": {x: 0.6, y: -0.8},
    }
    return lg.System(**stated | changes)


@cache
def chain(links: int, masses: tuple[Any, ...] | None = None) -> lg.System:
    """Return a chain of equal links with total length 1 in absolute angles; the first angle starts at 1."""
    angles = [lg.coordinate(f"q{k}") for k in range(1, links + 1)]
    place: Any = (0, 0)
    kinetic, potential, places = 0, 0, {}
    for k, (q, mass) in enumerate(zip(angles, masses or (m,) * links, strict=True), 1):
        place = place[0] + l * sin(q), place[1] - l * cos(q)
        kinetic, potential = kinetic + lg.kinetic_energy(mass, place), potential + lg.gravity(mass, place, g)
        places[f"bob{k}"] = place
    values = dict.fromkeys(masses or (m,), 1.0) | {g: 9.81, l: 1.0 / links}
    start = {angles[0]: 1.0}
    return lg.System(kinetic, potential, parameters=values, initial=start, positions=places, name="chain")
