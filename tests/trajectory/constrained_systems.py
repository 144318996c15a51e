"""Systems with constraints for tests of methods, with their compiled models and exact motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from sympy import cos, sin

from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, parameters, t
from lagrange.trajectory.integrator import Claims
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.taylor import Taylor
from tests.models import build
from tests.trajectory.runs import CONSTRAINED, implicit, run

x, y, z, a, b, x1, y1, x2, y2 = coordinates("x y z a b x1 y1 x2 y2")
m, g, l, c = parameters("m g l c")
VALUES = {m: 1.3, g: 9.81, l: 0.7, c: 0.15}
SYMPLECTIC = tuple(name for name in CONSTRAINED if find(name).claims.symplectic)
HOLONOMIC = tuple(name for name in CONSTRAINED if implicit(name).holonomic)


# --- systems --------------------------------------------------------------------------------------------------


def pendulum() -> dict[str, Any]:
    """A pendulum in Cartesian coordinates, released at 2 radians."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"rod": x**2 + y**2 - l**2},
        "initial": {x: 0.7 * np.sin(2.0), y: -0.7 * np.cos(2.0)},
    }


def pumped() -> dict[str, Any]:
    """A pendulum whose rod changes its length in time, with friction."""
    length, change = 0.7, 0.2 * 3.0
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "dissipation": c * (x.dot**2 + y.dot**2) / 2,
        "forces": {x: cos(2 * t)},
        "constraints": {"rod": x**2 + y**2 - (l + sin(3 * t) / 5) ** 2},
        "initial": {
            x: length * np.sin(1.0), y: -length * np.cos(1.0),
            x.dot: change * np.sin(1.0), y.dot: -change * np.cos(1.0),
        },
    }  # fmt: skip


def spherical() -> dict[str, Any]:
    """A spherical pendulum in Cartesian coordinates."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        "potential": m * g * z,
        "constraints": {"rod": x**2 + y**2 + z**2 - l**2},
        "initial": {x: 0.7 * np.sin(1.2), z: -0.7 * np.cos(1.2), y.dot: 1.5},
    }


def double_pendulum() -> dict[str, Any]:
    """Two rods in Cartesian coordinates."""
    state = from_angles(np.array([1.2, -0.5, 0.3, 0.8]))
    symbols = (x1, y1, x2, y2, x1.dot, y1.dot, x2.dot, y2.dot)
    return {
        "kinetic": m * (x1.dot**2 + y1.dot**2 + x2.dot**2 + y2.dot**2) / 2,
        "potential": m * g * (y1 + y2),
        "coordinates": [x1, y1, x2, y2],
        "constraints": {"upper": x1**2 + y1**2 - l**2, "lower": (x2 - x1) ** 2 + (y2 - y1) ** 2 - l**2},
        "initial": dict(zip(symbols, state, strict=True)),
    }


def guided() -> dict[str, Any]:
    """A double pendulum in angles whose tip is held at one height. Its mass matrix depends on the angles."""
    second = float(np.arccos(1.2 / 0.7 - np.cos(0.4)))
    rate = -np.sin(0.4) * 0.9 / np.sin(second)
    return {
        **angles(),
        "constraints": {"guide": l * cos(a) + l * cos(b) - 1.2},
        "initial": {a: 0.4, b: second, a.dot: 0.9, b.dot: float(rate)},
    }


def angles() -> dict[str, Any]:
    """The double pendulum in angles."""
    return {
        "kinetic": m * l**2 * (2 * a.dot**2 + b.dot**2 + 2 * a.dot * b.dot * cos(a - b)) / 2,
        "potential": -m * g * l * (2 * cos(a) + cos(b)),
        "coordinates": [a, b],
        "initial": {a: 1.2, b: -0.5, a.dot: 0.3, b.dot: 0.8},
    }


def rotor() -> dict[str, Any]:
    """A pendulum whose direction is a unit vector (x, y). T does not depend on both rates, so M is singular."""
    return {
        "kinetic": m * l**2 * (x * y.dot - y * x.dot) ** 2 / 2,
        "potential": m * g * l * y,
        "constraints": {"unit": x**2 + y**2 - 1},
        "initial": {x: np.sin(1.1), y: -np.cos(1.1), x.dot: 1.5 * np.cos(1.1), y.dot: 1.5 * np.sin(1.1)},
    }


def sleigh() -> dict[str, Any]:
    """Chaplygin's sleigh on an incline. Its knife edge is a constraint on velocities."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2 + m * a.dot**2 / 5,
        "potential": m * g * y / 3 + m * cos(a) / 7,
        "coordinates": [x, y, a],
        "constraints": {"edge": x.dot * sin(a) - y.dot * cos(a)},
        "initial": {a: 0.3, x.dot: np.cos(0.3), y.dot: np.sin(0.3), a.dot: 0.8},
    }


def from_angles(state: FloatArray) -> FloatArray:
    """Return the Cartesian state of a double pendulum from its state in angles."""
    p, q, pv, qv = state
    upper, rate = np.array([np.sin(p), -np.cos(p)]), np.array([np.cos(p), np.sin(p)]) * pv
    lower, other = np.array([np.sin(q), -np.cos(q)]), np.array([np.cos(q), np.sin(q)]) * qv
    return 0.7 * np.concatenate([upper, upper + lower, rate, rate + other])


SYSTEMS = {one.__name__: one for one in (pendulum, pumped, spherical, double_pendulum, guided, rotor)}


@cache
def system(name: str, target: str = "llvm") -> Model:
    stated = sleigh() if name == "sleigh" else SYSTEMS[name]()
    return build(target, parameters=VALUES, **stated) if "dissipation" in stated else build(target, **stated)


def equal(name: str) -> Any:
    """Return an implicit method with equal steps; an adaptive method loses its error estimate."""
    method = implicit(name)
    if method.control is None:
        return method
    return ImplicitMethod(
        f"{name}-equal", Claims(method.claims.order, explicit=False), without_error(method.function), law=method.law
    )


@cache
def without_error(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: function(*arguments)[:2]


def held(compiled: Model, result: Any) -> tuple[FloatArray, FloatArray]:
    """Return the magnitudes of the constraints on coordinates (phi) and on velocities (psi) along a run."""
    count, n = len(compiled.equations.constraints), compiled.dimension
    both = np.abs(compiled.evaluate("constraints", result.y[:n], result.y[n:], result.t))
    return both[:count], both[count:]


@cache
def truth(name: str, end: float = 1.0) -> FloatArray:
    last: FloatArray = run(system(name), end, Taylor(rtol=1e-15, atol=1e-15)).y[:, -1]
    return last
