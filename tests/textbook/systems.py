"""Statements whose derivations are compared with SymPy's, and the values of expressions at a point."""

from collections.abc import Callable
from functools import cache
from typing import Any

import mpmath
import numpy as np
import sympy
from sympy import Abs, pi, sqrt

from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.statement import Statement
from tests.models import SYSTEMS, c, g, k, m, omega, stated, x, y

CASES: dict[str, Callable[[], Statement]] = {
    **{name: SYSTEMS[name] for name in ("double pendulum", "cart and pole", "elastic pendulum", "bead on a hoop")},
    "relativistic particle": lambda: stated(
        lagrangian=-m * omega**2 * sqrt(1 - (x.dot**2 + y.dot**2) / omega**2) - k * x * y
    ),
    "ball with quadratic drag": lambda: stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        dissipation=c * Abs(x.dot) ** 3 / 3,
        forces={y: -k * Abs(y.dot) * y.dot},
    ),
}
HALF = float(pi) / 2
SPECIAL = {
    "double pendulum": ((0.0, 0.0), (HALF, HALF), (HALF, 0.0), (0.3, 0.3), (0.0, 2 * HALF)),
    "cart and pole": ((0.0, 0.0), (0.0, HALF), (1.0, 2 * HALF)),
}
"""Configurations where solvers by elimination have failed."""


@cache
def case(name: str) -> Statement:
    return CASES[name]()


def points(name: str, count: int = 3) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return (q, v, t) at random points about the initial state, then at special configurations."""
    random, n = np.random.default_rng(20240607), len(case(name).coordinates)
    start = np.array(case(name).initial[:n])
    places = [start + random.uniform(-0.9, 0.9, n) for _ in range(count)]
    return [
        (q, random.uniform(-1, 1, n), random.uniform(0, 2)) for q in (*places, *map(np.array, SPECIAL.get(name, ())))
    ]


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
