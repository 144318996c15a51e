"""The systems that the benchmarks measure, stated for lagrange and, with the same symbols, for its rivals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sympy import cos, sin

import lagrange as lg

CHAIN_MASS, CHAIN_LENGTH, GRAVITY = 1.0, 1.0, 9.81
DOUBLE = {"m1": 1.5, "m2": 0.8, "l1": 1.1, "l2": 0.9, "g": GRAVITY}
"""Parameters of the double pendulum: no ones, which a compiler that knows them would multiply by for nothing."""


def chain(n: int, *, relative: bool = False) -> dict[str, Any]:
    """Return the statement of n pendulums hung below one another in the plane, as sums of Cartesian velocities.

    The angles are measured from the vertical, or each from the link above (`relative`).
    """
    angles = [lg.coordinate(f"theta{i + 1}") for i in range(n)]
    masses = [lg.parameters(f"m{i + 1}") for i in range(n)]
    lengths = [lg.parameters(f"l{i + 1}") for i in range(n)]
    g = lg.parameters("g")
    x = y = angle = kinetic = potential = 0
    for theta, m, length in zip(angles, masses, lengths, strict=True):
        angle = angle + theta if relative else theta
        x, y = x + length * sin(angle), y - length * cos(angle)
        kinetic += lg.kinetic_energy(m, (x, y))
        potential += lg.gravity(m, (x, y), g)
    return {
        "kinetic": kinetic,
        "potential": potential,
        "coordinates": angles,
        "parameters": {
            g: GRAVITY,
            **dict.fromkeys(masses, CHAIN_MASS),
            **dict.fromkeys(lengths, CHAIN_LENGTH),
        },
        "initial": dict.fromkeys(angles, 0.5),
        "name": f"chain of {n}",
    }


def double_pendulum(*, cartesian: bool = False, numbers: bool = False) -> lg.System:
    """Return the double pendulum, with the Lagrangian of the textbooks or as sums of Cartesian velocities.

    With `numbers`, the textbook Lagrangian has the values in place of the parameters.
    """
    a, b = lg.coordinates("theta1 theta2")
    symbols = lg.parameters(" ".join(DOUBLE))
    m1, m2, l1, l2, g = DOUBLE.values() if numbers else symbols
    if cartesian:
        upper = (l1 * sin(a), -l1 * cos(a))
        lower = (upper[0] + l2 * sin(b), upper[1] - l2 * cos(b))
        kinetic = lg.kinetic_energy(m1, upper) + lg.kinetic_energy(m2, lower)
        potential = lg.gravity(m1, upper, g) + lg.gravity(m2, lower, g)
    else:
        kinetic = (m1 + m2) * l1**2 * a.dot**2 / 2 + m2 * l2**2 * b.dot**2 / 2
        kinetic += m2 * l1 * l2 * a.dot * b.dot * cos(a - b)
        potential = -(m1 + m2) * g * l1 * cos(a) - m2 * g * l2 * cos(b)
    return lg.System(
        kinetic=kinetic,
        potential=potential,
        coordinates=[a, b],
        parameters={} if numbers else DOUBLE,
        initial={a: 0.5, b: 0.5},
        name="double pendulum",
    )


def elastic_pendulum(k: float, initial: Mapping[Any, float] | None = None) -> lg.System:
    """Return the library's elastic pendulum with a spring constant k in N/m."""
    scene = lg.scene("elastic-pendulum")
    return lg.System(
        lagrangian=scene.statement.lagrangian,
        coordinates=scene.coordinates,
        parameters={symbol: k if symbol.name == "k" else value for symbol, value in scene.parameters.items()},
        initial=initial,
        name="elastic pendulum",
    )


def henon_heiles() -> lg.System:
    """Return a star in a galaxy (M. Henon, C. Heiles, Astron. J. 69, 1964), where kicks and drifts are legal."""
    x, y = lg.coordinates("x y")
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3,
        initial={x: 0.1, y: 0.2, x.dot: 0.3, y.dot: 0.2},
        name="Henon-Heiles",
    )
