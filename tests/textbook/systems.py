"""Textbook systems, stated once: shared by the derivation's tests and the compiled model's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import sympy
from sympy import Abs, Integer, cos, exp, pi, sin, sqrt

from lagrange.statement.coordinate import acceleration_of, coordinate, coordinates, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.energy import gravity, kinetic_energy, spring
from lagrange.statement.statement import Statement

m, M, m1, m2, m3, g, l, l1, l2, l3, k, a, c, omega, A, C, G, B, charge, R, mu = parameters(
    "m M m1 m2 m3 g l l1 l2 l3 k a c omega A C G B charge R mu"
)
theta, phi, psi, x, y, z, r = coordinates("theta phi psi x y z r")
theta1, theta2, theta3, x1, y1, x2, y2 = coordinates("theta1 theta2 theta3 x1 y1 x2 y2")
VALUES = dict(
    zip(
        (m, M, m1, m2, m3, g, l, l1, l2, l3, k, a, c, omega, A, C, G, B, charge, R, mu),
        (
            1.3,
            2.1,
            0.7,
            1.9,
            0.4,
            9.81,
            1.1,
            0.8,
            1.7,
            0.6,
            3.3,
            0.45,
            0.25,
            2.3,
            1.7,
            0.9,
            1.25,
            2.5,
            0.65,
            1.45,
            0.35,
        ),
        strict=True,
    )
)


@dataclass(frozen=True, eq=False)
class Case:
    """A system, where to evaluate it, and, where there is one, its book's solved equations."""

    name: str
    arguments: Mapping[str, Any]
    away: Mapping[Any, float] = field(default_factory=dict)
    """Centre of a coordinate's range where zero is outside the domain."""
    book: Mapping[Any, Any] | None = None
    special: tuple[tuple[float, ...], ...] = ()
    """Configurations where solvers by elimination have failed."""

    @cached_property
    def stated(self) -> Statement:
        return declare(name=self.name, parameters=self.parameters, **self.arguments)

    def statement(self) -> Statement:
        return self.stated

    @property
    def parameters(self) -> dict[Any, float]:
        parts = [
            value
            for key, value in self.arguments.items()
            if key in ("kinetic", "potential", "lagrangian", "dissipation")
        ]
        parts += list(self.arguments.get("forces", {}).values())
        used = set().union(*(sympy.sympify(part).free_symbols for part in parts))
        return {symbol: value for symbol, value in VALUES.items() if symbol in used}

    def points(self, count: int = 3, seed: int = 20240607) -> list[tuple[np.ndarray, np.ndarray, float]]:
        """Return (q, v, t) at random points, then at the special configurations."""
        random = np.random.default_rng(seed)
        statement = self.statement()
        centre = np.array([self.away.get(q, 0.0) for q in statement.coordinates])
        n = len(centre)
        found = [
            (centre + random.uniform(-0.9, 0.9, n), random.uniform(-1, 1, n) * self.speed, random.uniform(0, 2))
            for _ in range(count)
        ]
        return found + [(np.array(q), random.uniform(-1, 1, n) * self.speed, 0.3) for q in self.special]

    @property
    def speed(self) -> float:
        return 0.4 if self.name == "relativistic particle" else 1.5


@cache
def _function(expression: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    # A velocity contains its coordinate, so what is longest is replaced first.
    ordered = sorted(arguments, key=lambda node: -len(getattr(node, "variables", ())))
    names = {node: sympy.Dummy() for node in ordered}
    plain = expression.xreplace(names)
    function: Callable[..., Any] = sympy.lambdify(
        [names[node] for node in arguments], plain, modules="mpmath", cse=True
    )
    return function


def value(expression: Any, statement: Statement, q: Any, v: Any, time: float, acceleration: Any = ()) -> Any:
    """Return the expression at a point in mpmath's precision, by SymPy and mpmath alone."""
    table: dict[Any, Any] = {t: time}
    table.update(zip(statement.coordinates, q, strict=True))
    table.update(zip(statement.velocities, v, strict=True))
    table.update(zip(map(acceleration_of, statement.coordinates), acceleration, strict=False))
    table.update(statement.defaults)
    return _function(sympy.sympify(expression), tuple(table))(*(mpmath.mpf(number) for number in table.values()))


def pendulum_chain(masses: list[Any], lengths: list[Any], angles: list[Any]) -> tuple[Any, Any]:
    """Return T and V of point masses on rods, stated in Cartesian positions."""
    point = (Integer(0), Integer(0))
    kinetic = potential = Integer(0)
    for mass, length, angle in zip(masses, lengths, angles, strict=True):
        point = (point[0] + length * sin(angle), point[1] - length * cos(angle))
        kinetic += kinetic_energy(mass, point)
        potential += gravity(mass, point, g)
    return kinetic, potential


def _two(names: str, parts: tuple[Any, Any]) -> dict[str, Any]:
    return dict(zip(names.split(), parts, strict=True))


D = theta1 - theta2
_PENDULUM = (l * sin(theta), -l * cos(theta))
_ELASTIC = ((l + x) * sin(theta), -(l + x) * cos(theta))
_SPHERICAL = (l * sin(theta) * cos(phi), l * sin(theta) * sin(phi), -l * cos(theta))
_HOOP = (a * sin(theta) * cos(omega * t), a * sin(theta) * sin(omega * t), -a * cos(theta))
_CART = (x + l * sin(theta), -l * cos(theta))
_PIVOT = (l * sin(theta), a * cos(omega * t) - l * cos(theta))
_DOUBLE_DETERMINANT = m1 + m2 * sin(D) ** 2
_CART_DETERMINANT = M + m * sin(theta) ** 2

CASES = (
    Case(
        "pendulum",
        {"kinetic": kinetic_energy(m, _PENDULUM), "potential": gravity(m, _PENDULUM, g)},
        book={theta: -g / l * sin(theta)},
        special=((0.0,), (float(pi) / 2,), (float(pi),)),
    ),
    Case(
        "double pendulum",
        _two("kinetic potential", pendulum_chain([m1, m2], [l1, l2], [theta1, theta2]))
        | {"coordinates": [theta1, theta2]},
        book={
            theta1: (
                m2 * g * sin(theta2) * cos(D)
                - m2 * sin(D) * (l1 * theta1.dot**2 * cos(D) + l2 * theta2.dot**2)
                - (m1 + m2) * g * sin(theta1)
            )
            / (l1 * _DOUBLE_DETERMINANT),
            theta2: (
                (m1 + m2) * (l1 * theta1.dot**2 * sin(D) - g * sin(theta2) + g * sin(theta1) * cos(D))
                + m2 * l2 * theta2.dot**2 * sin(D) * cos(D)
            )
            / (l2 * _DOUBLE_DETERMINANT),
        },
        special=((0.0, 0.0), (float(pi) / 2, float(pi) / 2), (float(pi) / 2, 0.0), (0.3, 0.3), (0.0, float(pi))),
    ),
    Case(
        "elastic pendulum",
        {
            "kinetic": kinetic_energy(m, _ELASTIC),
            "potential": gravity(m, _ELASTIC, g) + k * x**2 / 2,
            "coordinates": [x, theta],
        },
        book={
            x: (l + x) * theta.dot**2 + g * cos(theta) - k / m * x,
            theta: -(g * sin(theta) + 2 * x.dot * theta.dot) / (l + x),
        },
        special=((0.0, 0.0), (0.2, float(pi) / 2)),
    ),
    Case(
        "spherical pendulum",
        {"kinetic": kinetic_energy(m, _SPHERICAL), "potential": gravity(m, _SPHERICAL, g), "coordinates": [theta, phi]},
        away={theta: 1.2},
        book={
            theta: phi.dot**2 * sin(theta) * cos(theta) - g / l * sin(theta),
            phi: -2 * theta.dot * phi.dot * cos(theta) / sin(theta),
        },
        special=((float(pi) / 2, 0.0),),
    ),
    Case(
        "Atwood machine",
        {"kinetic": (m1 + m2) * x.dot**2 / 2, "potential": -m1 * g * x - m2 * g * (l - x)},
        book={x: (m1 - m2) / (m1 + m2) * g},
        special=((0.0,),),
    ),
    Case(
        "swinging Atwood machine",
        {
            "kinetic": (M + m) * r.dot**2 / 2 + m * r**2 * theta.dot**2 / 2,
            "potential": M * g * r - m * g * r * cos(theta),
            "coordinates": [r, theta],
        },
        away={r: 1.5},
        book={
            r: (m * r * theta.dot**2 + m * g * cos(theta) - M * g) / (M + m),
            theta: -(g * sin(theta) + 2 * r.dot * theta.dot) / r,
        },
    ),
    Case(
        "cart and pole",
        {
            "kinetic": M * x.dot**2 / 2 + kinetic_energy(m, _CART),
            "potential": gravity(m, _CART, g),
            "forces": {x: -c * x.dot, theta: a},
            "dissipation": mu * theta.dot**2 / 2,
            "coordinates": [x, theta],
        },
        book={
            x: (
                -c * x.dot
                + m * l * theta.dot**2 * sin(theta)
                + m * g * sin(theta) * cos(theta)
                - (a - mu * theta.dot) * cos(theta) / l
            )
            / _CART_DETERMINANT,
            theta: (
                c * x.dot * cos(theta)
                - m * l * theta.dot**2 * sin(theta) * cos(theta)
                - (M + m) * g * sin(theta)
                + (M + m) * (a - mu * theta.dot) / (m * l)
            )
            / (l * _CART_DETERMINANT),
        },
        special=((0.0, 0.0), (0.0, float(pi) / 2), (1.0, float(pi))),
    ),
    Case(
        "bead on a rotating hoop",
        {"kinetic": kinetic_energy(m, _HOOP), "potential": gravity(m, _HOOP, g)},
        book={theta: sin(theta) * (omega**2 * cos(theta) - g / a)},
        special=((0.0,), (float(pi) / 2,)),
    ),
    Case(
        "axisymmetric top",
        {
            "kinetic": A * (phi.dot**2 * sin(theta) ** 2 + theta.dot**2) / 2
            + C * (phi.dot * cos(theta) + psi.dot) ** 2 / 2,
            "potential": m * g * l * cos(theta),
            "coordinates": [theta, phi, psi],
        },
        away={theta: 1.4},
        book={
            theta: ((A - C) * phi.dot**2 * cos(theta) - C * phi.dot * psi.dot + m * g * l) * sin(theta) / A,
            phi: (C * theta.dot * (psi.dot + phi.dot * cos(theta)) - 2 * A * phi.dot * theta.dot * cos(theta))
            / (A * sin(theta)),
            psi: phi.dot * theta.dot * sin(theta)
            - cos(theta)
            * (C * theta.dot * (psi.dot + phi.dot * cos(theta)) - 2 * A * phi.dot * theta.dot * cos(theta))
            / (A * sin(theta)),
        },
        special=((float(pi) / 2, 0.0, 0.0),),
    ),
    Case(
        "charge in a magnetic field",
        {
            "lagrangian": m * (x.dot**2 + y.dot**2 + z.dot**2) / 2
            + charge * B * (x * y.dot - y * x.dot) / 2
            - charge * k * z,
            "coordinates": [x, y, z],
        },
        book={x: charge * B / m * y.dot, y: -charge * B / m * x.dot, z: -charge * k / m},
    ),
    Case(
        "Kepler orbit in polar coordinates",
        {"kinetic": m * (r.dot**2 + r**2 * phi.dot**2) / 2, "potential": -G * m * M / r, "coordinates": [r, phi]},
        away={r: 1.6},
        book={r: r * phi.dot**2 - G * M / r**2, phi: -2 * r.dot * phi.dot / r},
    ),
    Case(
        "two bodies in the plane",
        {
            "kinetic": kinetic_energy(m1, (x1, y1)) + kinetic_energy(m2, (x2, y2)),
            "potential": -G * m1 * m2 / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2),
        },
        away={x1: 2.0, y1: 0.5, x2: -2.0},
        book={
            x1: -G * m2 * (x1 - x2) / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2) ** 3,
            y1: -G * m2 * (y1 - y2) / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2) ** 3,
            x2: G * m1 * (x1 - x2) / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2) ** 3,
            y2: G * m1 * (y1 - y2) / sqrt((x1 - x2) ** 2 + (y1 - y2) ** 2) ** 3,
        },
    ),
    Case(
        "Henon-Heiles",
        {"kinetic": (x.dot**2 + y.dot**2) / 2, "potential": (x**2 + y**2) / 2 + x**2 * y - y**3 / 3},
        book={x: -x - 2 * x * y, y: -y - x**2 + y**2},
        special=((0.0, 0.0),),
    ),
    Case(
        "pendulum on a shaken pivot",
        {"kinetic": kinetic_energy(m, _PIVOT), "potential": gravity(m, _PIVOT, g)},
        book={theta: -(g - a * omega**2 * cos(omega * t)) * sin(theta) / l},
        special=((0.0,),),
    ),
    Case(
        "triple pendulum",
        _two("kinetic potential", pendulum_chain([m1, m2, m3], [l1, l2, l3], [theta1, theta2, theta3]))
        | {"coordinates": [theta1, theta2, theta3]},
        special=((0.0, 0.0, 0.0), (float(pi) / 2,) * 3, (0.0, float(pi) / 2, 0.0)),
    ),
    Case(
        "double pendulum in relative angles, damped",
        _two("kinetic potential", pendulum_chain([m1, m2], [l1, l2], [theta1, theta1 + theta2]))
        | {
            "coordinates": [theta1, theta2],
            "dissipation": c * (theta1.dot**2 + 2 * theta2.dot**2) / 2,
            "forces": {theta1: a * cos(omega * t), theta2: -a * theta1},
        },
        special=((0.0, 0.0), (0.0, float(pi) / 2), (0.4, float(pi))),
    ),
    Case(
        "relativistic particle",
        {"lagrangian": -m * c**2 * sqrt(1 - (x.dot**2 + y.dot**2) / (2 * c) ** 2) - k * x * y},
    ),
    Case(
        "ball with quadratic drag",
        {
            "kinetic": m * (x.dot**2 + y.dot**2) / 2,
            "potential": m * g * y,
            "dissipation": c * Abs(x.dot) ** 3 / 3,
            "forces": {y: -mu * Abs(y.dot) * y.dot},
        },
        book={x: -c / m * Abs(x.dot) * x.dot, y: -g - mu / m * Abs(y.dot) * y.dot},
        special=((0.0, 0.0),),
    ),
    Case(
        "growing mass on springs",
        {
            "kinetic": m * exp(t / 5) * x.dot**2 / 2 + M * (x.dot + y.dot) ** 2 / 2 + mu * t * y.dot,
            "potential": spring(k, (x, 0), (0, 0), l) + spring(c, (x, y), (2, 3), R),
            "coordinates": [x, y],
        },
        away={x: 1.1, y: 0.2},
    ),
)

NAMES = [case.name for case in CASES]


def chain_of_masses(n: int) -> Case:
    """Return n equal masses between walls: M diagonal, n small blocks."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    ends = [Integer(0), *xs, Integer(0)]
    stretch = sum(((q - p) ** 2 for p, q in pairwise(ends)), Integer(0))
    return Case(
        f"chain of {n} masses",
        {"kinetic": m * sum(q.dot**2 for q in xs) / 2, "potential": k * stretch / 2, "coordinates": xs},
    )
