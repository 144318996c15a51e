"""Textbook systems that are no scenes. `tests/statement/test_library.py` compares scenes with textbooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import mpmath
import numpy as np
import sympy
from sympy import Abs, Integer, cos, exp, pi, sin, sqrt

from lagrange.statement.coordinate import acceleration_of, coordinates, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.energy import gravity, kinetic_energy, spring
from lagrange.statement.statement import Statement

SYMBOLS = parameters("m M m1 m2 m3 g l l1 l2 l3 k a c omega A C B charge R mu")
m, M, m1, m2, m3, g, l, l1, l2, l3, k, a, c, omega, A, C, B, charge, R, mu = SYMBOLS
theta, phi, psi, x, y, r = coordinates("theta phi psi x y r")
theta1, theta2, theta3 = coordinates("theta1 theta2 theta3")
NUMBERS = (1.3, 2.1, 0.7, 1.9, 0.4, 9.81, 1.1, 0.8, 1.7, 0.6, 3.3, 0.45, 0.25, 2.3, 1.7, 0.9, 2.5, 0.65, 1.45, 0.35)
VALUES = dict(zip(SYMBOLS, NUMBERS, strict=True))


@dataclass(frozen=True, eq=False)
class Case:
    """A system, and where to evaluate it."""

    name: str
    arguments: Mapping[str, Any]
    away: Mapping[Any, float] = field(default_factory=dict)
    """Centre of a coordinate's range where zero is outside the domain."""
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
        """Return (q, v, t) at random points, then at special configurations."""
        random = np.random.default_rng(seed)
        statement = self.statement()
        centre = np.array([self.away.get(q, 0.0) for q in statement.coordinates])
        n = len(centre)
        result = [
            (centre + random.uniform(-0.9, 0.9, n), random.uniform(-1, 1, n) * self.speed, random.uniform(0, 2))
            for _ in range(count)
        ]
        return result + [(np.array(q), random.uniform(-1, 1, n) * self.speed, 0.3) for q in self.special]

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
    """Return the value of an expression at a point, by SymPy and mpmath."""
    table: dict[Any, Any] = {t: time}
    table.update(zip(statement.coordinates, q, strict=True))
    table.update(zip(statement.velocities, v, strict=True))
    table.update(zip(map(acceleration_of, statement.coordinates), acceleration, strict=False))
    table.update(statement.defaults)
    return _function(sympy.sympify(expression), tuple(table))(*(mpmath.mpf(number) for number in table.values()))


def pendulum_chain(masses: list[Any], lengths: list[Any], angles: list[Any]) -> tuple[Any, Any]:
    """Return T and V of a chain of point masses on rods, stated by Cartesian positions."""
    point = (Integer(0), Integer(0))
    kinetic = potential = Integer(0)
    for mass, length, angle in zip(masses, lengths, angles, strict=True):
        point = (point[0] + length * sin(angle), point[1] - length * cos(angle))
        kinetic += kinetic_energy(mass, point)
        potential += gravity(mass, point, g)
    return kinetic, potential


def _two(names: str, parts: tuple[Any, Any]) -> dict[str, Any]:
    return dict(zip(names.split(), parts, strict=True))


_CART = (x + l * sin(theta), -l * cos(theta))

CASES = (
    Case(
        "double pendulum",
        _two("kinetic potential", pendulum_chain([m1, m2], [l1, l2], [theta1, theta2]))
        | {"coordinates": [theta1, theta2]},
        special=((0.0, 0.0), (float(pi) / 2, float(pi) / 2), (float(pi) / 2, 0.0), (0.3, 0.3), (0.0, float(pi))),
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
        special=((0.0, 0.0), (0.0, float(pi) / 2), (1.0, float(pi))),
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
