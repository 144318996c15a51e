"""Systems, each stated in two or three ways, with the number of conserved quantities that each way has.

The ways are: by positions, expanded by hand, and in other coordinates.
"""

from __future__ import annotations

from typing import Any

import sympy
from sympy import S, cos, sin, sqrt

import lagrange as lg
from lagrange.statement.coordinate import t

x, y, z, u, w = lg.coordinates("x y z u w")
r, rho, theta, phi, psi = lg.coordinates("r rho theta phi psi")
x1, y1, x2, y2, X, Y = lg.coordinates("x1 y1 x2 y2 X Y")
m, m1, m2, k, g, l, B, A, C, c, omega = lg.parameters("m m1 m2 k g l B A C c omega")

Point = tuple[Any, ...]
Statement = dict[str, Any]


def T(place: Point) -> Any:
    return lg.kinetic_energy(m, place)


def body(place: Point, potential: Any = S.Zero, **more: Any) -> Statement:
    """Return a body of mass m, stated by its position."""
    return {"kinetic": T(place), "potential": potential, **more}


def expanded(kinetic: Any, potential: Any, **more: Any) -> Statement:
    return {"kinetic": kinetic, "potential": potential, **more}


def size(place: Point) -> Any:
    return sqrt(sum(entry**2 for entry in place))


def pair(one: Point, other: Point) -> Any:
    return lg.kinetic_energy(m1, one) + lg.kinetic_energy(m2, other)


POLAR, SPHERE = (r * cos(phi), r * sin(phi)), (sin(theta) * cos(phi), sin(theta) * sin(phi), -cos(theta))
BALL = tuple(r * entry for entry in SPHERE)
FLAT, SPACE = (x, y), (x, y, z)
POLAR_T = m * (r.dot**2 + r**2 * phi.dot**2) / 2
ON_BALL = tuple(l * entry for entry in SPHERE)
TILTED = ((u + w) / sqrt(2), (u - w) / sqrt(2))
TOP = A * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2 + C * (psi.dot + phi.dot * cos(theta)) ** 2 / 2
REDUCED = m1 * m2 / (m1 + m2)
ORBITS = (
    (X - m2 * r * cos(phi) / (m1 + m2), Y - m2 * r * sin(phi) / (m1 + m2)),
    (X + m1 * r * cos(phi) / (m1 + m2), Y + m1 * r * sin(phi) / (m1 + m2)),
)
ROTATED = (x * cos(omega * t) - y * sin(omega * t), x * sin(omega * t) + y * cos(omega * t))
ELLIPSE = k * (x * cos(omega * t) + y * sin(omega * t)) ** 2
FIELD = B * (POLAR[0] * sympy.diff(POLAR[1], t) - POLAR[1] * sympy.diff(POLAR[0], t)) / 2

WAYS: dict[str, tuple[Statement, int]] = {
    # energy and angular momentum about the vertical
    "spherical pendulum by positions": (body(ON_BALL, m * g * ON_BALL[2]), 2),
    "spherical pendulum on a rod": (body(SPACE, m * g * z, constraints={"rod": x**2 + y**2 + z**2 - l**2}), 2),
    # energy, angular momentum, and the Runge-Lenz vector
    "Kepler on spheres": (body(BALL, -k / size(BALL)), 7),
    "Kepler on cylinders": (
        expanded(m * (rho.dot**2 + rho**2 * phi.dot**2 + z.dot**2) / 2, -k / sqrt(rho**2 + z**2)),
        7,
    ),
    "Kepler": (body(SPACE, -k / size(SPACE)), 7),
    # energy, and the momenta of which one grows with time
    "thrown body in tilted axes": (body(TILTED, m * g * TILTED[1]), 3),
    "thrown body in polar coordinates": (expanded(POLAR_T, m * g * r * sin(phi)), 3),
    # energy and two momenta
    "heavy top": (expanded(TOP, m * g * l * cos(theta)), 3),
    "heavy top in half angles": (expanded(sympy.expand(TOP), m * g * l * (1 - 2 * sin(theta / 2) ** 2)), 3),
    # energy, momentum, and angular momenta of the whole and about the centre
    "two bodies by positions": ({"kinetic": pair(*ORBITS), "potential": -k / r}, 5),
    "two bodies about their centre": (
        expanded((m1 + m2) * (X.dot**2 + Y.dot**2) / 2 + REDUCED * (r.dot**2 + r**2 * phi.dot**2) / 2, -k / r),
        5,
    ),
    "two bodies": (expanded(pair((x1, y1), (x2, y2)), -k / size((x1 - x2, y1 - y2))), 4),
    # energy, the two momenta of the centre of the circle, and the angular momentum
    "charge in a field by positions": ({"lagrangian": T(POLAR) + FIELD}, 4),
    "charge in a field": ({"lagrangian": T(FLAT) + B * x * y.dot}, 4),
    # the Jacobi integral, which only the turning axes show
    "turning potential": (body(FLAT, ELLIPSE), 0),
    "turning potential in polar coordinates": (expanded(POLAR_T, k * r**2 * cos(phi - omega * t) ** 2), 0),
    "turning potential in its axes": (body(ROTATED, k * x**2), 1),
    # momenta with the impulse of the drag
    "body in a drag, by dissipation": (body(TILTED, dissipation=c * (u.dot**2 + w.dot**2) / 2), 2),
    "body in a drag, by forces": (body(FLAT, forces={x: -c * x.dot, y: -c * y.dot}), 2),
}
"""Statements, and how many quantities are conserved."""
