"""Systems, each stated in three ways, with their conserved quantities in Cartesian coordinates.

The ways are: by positions, expanded by hand, and in other coordinates. `places` maps the Cartesian names in `conserved`
to expressions in the coordinates of a statement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sympy
from sympy import Matrix, S, cos, sin, sqrt

import lagrange as lg
from lagrange.statement.coordinate import t

x, y, z, u, w = lg.coordinates("x y z u w")
r, rho, theta, phi, psi = lg.coordinates("r rho theta phi psi")
x1, y1, x2, y2, X, Y = lg.coordinates("x1 y1 x2 y2 X Y")
m, m1, m2, k, g, l, B, A, C, c, omega, a = lg.parameters("m m1 m2 k g l B A C c omega a")

Point = tuple[Any, ...]
Statement = dict[str, Any]


@dataclass(frozen=True)
class Way:
    """One statement, and the position of the body in its coordinates."""

    statement: Statement
    places: tuple[Point, ...]


@dataclass(frozen=True)
class Listed:
    """Conserved quantities as functions of positions and velocities, and the number found in each way."""

    conserved: Callable[..., list[Any]]
    ways: tuple[Way, ...]
    counts: tuple[int, ...]


def rates(place: Point) -> Point:
    return tuple(sympy.diff(entry, t) for entry in place)


def body(place: Point, potential: Any = S.Zero, **more: Any) -> Way:
    """Return a body of mass m, stated by its position."""
    return Way({"kinetic": lg.kinetic_energy(m, place), "potential": potential, **more}, (place,))


def expanded(kinetic: Any, potential: Any, *places: Point, **more: Any) -> Way:
    return Way({"kinetic": kinetic, "potential": potential, **more}, places)


def T(place: Point) -> Any:
    return lg.kinetic_energy(m, place)


def angular(place: Point) -> list[Any]:
    """Return the angular momentum m r x v: one component in a plane, three in space."""
    p = [m * rate for rate in rates(place)]
    if len(place) == 2:
        return [place[0] * p[1] - place[1] * p[0]]
    return list(Matrix(place).cross(Matrix(p)))


def runge_lenz(place: Point) -> list[Any]:
    r_, p = (Matrix([*part, *([0] * (3 - len(part)))]) for part in (place, [m * rate for rate in rates(place)]))
    whole = p.cross(r_.cross(p)) - m * k * r_ / sqrt(r_.dot(r_))
    return list(whole)[: len(place)]


def size(place: Point) -> Any:
    return sqrt(sum(entry**2 for entry in place))


POLAR, SPHERE = (r * cos(phi), r * sin(phi)), (sin(theta) * cos(phi), sin(theta) * sin(phi), -cos(theta))
BALL = tuple(r * entry for entry in SPHERE)
CYLINDER = (rho * cos(phi), rho * sin(phi), z)
FLAT, SPACE = (x, y), (x, y, z)
POLAR_T = m * (r.dot**2 + r**2 * phi.dot**2) / 2
ON_BALL = tuple(l * entry for entry in SPHERE)
TILTED = ((u + w) / sqrt(2), (u - w) / sqrt(2))
RATES = (
    phi.dot * sin(theta) * sin(psi) + theta.dot * cos(psi),
    phi.dot * sin(theta) * cos(psi) - theta.dot * sin(psi),
    phi.dot * cos(theta) + psi.dot,
)
TOP = A * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2 + C * (psi.dot + phi.dot * cos(theta)) ** 2 / 2


def pair(masses: Any, one: Point, other: Point) -> Any:
    return lg.kinetic_energy(masses[0], one) + lg.kinetic_energy(masses[1], other)


def total(one: Point, other: Point) -> list[Any]:
    return [m1 * p + m2 * q for p, q in zip(rates(one), rates(other), strict=True)]


def turning(one: Point, other: Point) -> Any:
    (first,), (second,) = angular(one), angular(other)
    return sympy.expand((first * m1 + second * m2) / m)


REDUCED = m1 * m2 / (m1 + m2)
ORBITS = (
    (X - m2 * r * cos(phi) / (m1 + m2), Y - m2 * r * sin(phi) / (m1 + m2)),
    (X + m1 * r * cos(phi) / (m1 + m2), Y + m1 * r * sin(phi) / (m1 + m2)),
)
ROTATED = (x * cos(omega * t) - y * sin(omega * t), x * sin(omega * t) + y * cos(omega * t))
ELLIPSE = k * (x * cos(omega * t) + y * sin(omega * t)) ** 2


SYSTEMS: dict[str, Listed] = {
    "spherical pendulum": Listed(
        lambda p: [T(p) + m * g * p[2], angular(p)[2]],
        (
            body(ON_BALL, m * g * ON_BALL[2]),
            expanded(m * l**2 * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2, -m * g * l * cos(theta), ON_BALL),
            body(SPACE, m * g * z, constraints={"rod": x**2 + y**2 + z**2 - l**2}),
        ),
        (2, 2, 2),
    ),
    "Kepler in space": Listed(
        lambda p: [T(p) - k / size(p), *angular(p), *runge_lenz(p)],
        (
            body(BALL, -k / size(BALL)),
            expanded(m * (rho.dot**2 + rho**2 * phi.dot**2 + z.dot**2) / 2, -k / sqrt(rho**2 + z**2), CYLINDER),
            body(SPACE, -k / size(SPACE)),
        ),
        (7, 7, 7),
    ),
    "thrown body": Listed(
        lambda p: [T(p) + m * g * p[1], m * rates(p)[0], m * rates(p)[1] + m * g * t],
        (body(TILTED, m * g * TILTED[1]), expanded(POLAR_T, m * g * r * sin(phi), POLAR), body(FLAT, m * g * y)),
        (3, 3, 3),
    ),
    "heavy top": Listed(
        lambda q: [TOP + m * g * l * cos(theta), TOP.diff(phi.dot), TOP.diff(psi.dot)],
        (
            Way({"kinetic": lg.rotational_energy((A, A, C), RATES), "potential": m * g * l * cos(theta)}, ((),)),
            expanded(TOP, m * g * l * cos(theta), ()),
            expanded(sympy.expand(TOP), m * g * l * (1 - 2 * sin(theta / 2) ** 2), ()),
        ),
        (3, 3, 3),
    ),
    "two bodies in the plane": Listed(
        lambda p, q: [
            pair((m1, m2), p, q) - k / size((q[0] - p[0], q[1] - p[1])),
            *total(p, q),
            turning(p, q),
            (q[0] - p[0]) * (rates(q)[1] - rates(p)[1]) - (q[1] - p[1]) * (rates(q)[0] - rates(p)[0]),
        ],
        (
            Way({"kinetic": pair((m1, m2), *ORBITS), "potential": -k / r}, ORBITS),
            expanded(
                (m1 + m2) * (X.dot**2 + Y.dot**2) / 2 + REDUCED * (r.dot**2 + r**2 * phi.dot**2) / 2, -k / r, *ORBITS
            ),
            expanded(
                pair((m1, m2), (x1, y1), (x2, y2)), -k / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2), (x1, y1), (x2, y2)
            ),
        ),
        (5, 5, 4),
    ),
    "charge in a magnetic field": Listed(
        lambda p: [
            T(p),
            m * rates(p)[0] - B * p[1],
            m * rates(p)[1] + B * p[0],
            *(one + B * (p[0] ** 2 + p[1] ** 2) / 2 for one in angular(p)),
        ],
        (
            Way({"lagrangian": T(POLAR) + B * (POLAR[0] * rates(POLAR)[1] - POLAR[1] * rates(POLAR)[0]) / 2}, (POLAR,)),
            Way({"lagrangian": POLAR_T + B * r**2 * phi.dot / 2}, (POLAR,)),
            Way({"lagrangian": T(FLAT) + B * x * y.dot}, (FLAT,)),
        ),
        (4, 4, 4),
    ),
    "turning potential": Listed(
        lambda p: [T(p) + k * (p[0] * cos(omega * t) + p[1] * sin(omega * t)) ** 2 - omega * angular(p)[0]],
        (body(FLAT, ELLIPSE), expanded(POLAR_T, k * r**2 * cos(phi - omega * t) ** 2, POLAR), body(ROTATED, k * x**2)),
        (0, 0, 1),
    ),
    "body in a drag": Listed(
        lambda p: [m * rate + c * entry for rate, entry in zip(rates(p), p, strict=True)],
        (
            body(TILTED, dissipation=c * (u.dot**2 + w.dot**2) / 2),
            expanded(m * (x.dot**2 + y.dot**2) / 2, S.Zero, FLAT, forces={x: -c * x.dot, y: -c * y.dot}),
            expanded(
                m * (x.dot**2 + 4 * y.dot**2) / 2, S.Zero, (x, 2 * y), dissipation=c * (x.dot**2 + 4 * y.dot**2) / 2
            ),
        ),
        (2, 2, 2),
    ),
}
