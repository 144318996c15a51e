"""Small statements for the tests of this folder."""

from __future__ import annotations

from typing import Any

import sympy as sp
from sympy import cos

from lagrange.statement.coordinate import coordinate, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement
from tests.models import bead_on_hoop, charge

theta, x, y, z, r, phi = (coordinate(name) for name in ("theta", "x", "y", "z", "r", "phi"))
m, g, length, k, c, omega = parameters("m g l k c omega")


def pendulum(**more: Any) -> Statement:
    return declare(
        kinetic=m * length**2 * theta.dot**2 / 2,
        potential=-m * g * length * cos(theta),
        parameters={m: 1.0, g: 9.81, length: 1.0},
        name="pendulum",
        **more,
    )


def pulled_pendulum() -> Statement:
    """Return a pendulum whose string becomes shorter, so that the momentum depends on time."""
    string = length * sp.exp(-omega * t)
    return declare(kinetic=m * string**2 * theta.dot**2 / 2, potential=-m * g * string * cos(theta), name="pulled")


def driven_oscillator() -> Statement:
    """Return an oscillator with force, dissipation and explicit time; the default of c is 0."""
    return declare(
        kinetic=m * (x.dot**2 + y.dot**2 + x.dot * y.dot) / 2,
        potential=k * x**2 / 2 + k * sp.exp(x - y),
        forces={x: sp.sin(omega * t) - c * y, y: length * x.dot},
        dissipation=c * (x.dot - y.dot) ** 2 / 2 + c * y.dot**4,
        parameters={m: 1.0, k: 1.0, c: 0.0, omega: 1.0, length: 1.0},
        name="oscillator",
    )


def contact() -> Statement:
    """Return a spring that acts only beyond x = 10, where no random point of order one is."""
    spring = sp.Piecewise((k * (x - 10) ** 2 / 2, x > 10), (0, True))
    return declare(kinetic=m * x.dot**2 / 2, potential=spring + m * g * x, name="contact")


def guarded_root() -> Statement:
    """Return a system with a Piecewise whose other branch has no value."""
    well = sp.Piecewise((sp.sqrt(x) ** 3, x > 0), (x**2, True))
    return declare(kinetic=m * x.dot**2 / 2, potential=well, name="guarded")


def relativistic() -> Statement:
    """Return a relativistic particle: L is not quadratic in the velocity, and is defined below the speed of light."""
    return declare(lagrangian=-m * c**2 * sp.sqrt(1 - x.dot**2 / c**2) - k * x**2 / 2, parameters={c: 3.0}, name="fast")


def half_line() -> Statement:
    return declare(kinetic=m * x.dot**2 / 2, potential=k * sp.log(x) + sp.sqrt(length - x), name="half line")


def kepler() -> Statement:
    return declare(kinetic=m * (r.dot**2 + r**2 * phi.dot**2) / 2, potential=-k * m / r, name="kepler")


def earth_and_moon() -> Statement:
    """Return two bodies in SI units, with numbers between 1e-11 and 1e30."""
    gravity, earth, moon = parameters("G earth moon")
    qs = [coordinate(name) for name in ("xe", "ye", "xm", "ym")]
    distance = sp.sqrt((qs[0] - qs[2]) ** 2 + (qs[1] - qs[3]) ** 2)
    return declare(
        kinetic=earth * (qs[0].dot ** 2 + qs[1].dot ** 2) / 2 + moon * (qs[2].dot ** 2 + qs[3].dot ** 2) / 2,
        potential=-gravity * earth * moon / distance,
        parameters={gravity: 6.6743e-11, earth: 5.972e24, moon: 7.342e22},
        initial={qs[0]: 1.496e11, qs[2]: 1.496e11 + 3.844e8, "ye_dot": 29780.0, "ym_dot": 30802.0},
        name="earth and moon",
    )


ALL = (
    *(pendulum, charge, bead_on_hoop, pulled_pendulum, driven_oscillator, contact, guarded_root, relativistic),
    *(half_line, kepler, earth_and_moon),
)
