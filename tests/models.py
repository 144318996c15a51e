"""Systems for tests of several rooms, and their models on both machines."""

import itertools
import tomllib
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import sympy as sp
from sympy import cos, exp, sin, sqrt

from lagrange.compiler import machine, model_of
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.recipes.model import Model
from lagrange.show.notebook.page_writer import scenes
from lagrange.statement.coordinate import coordinate, coordinates, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.scene.library import library_path, load
from lagrange.statement.statement import Statement
from lagrange.system import System, scene

SCENE_NAMES = tuple(scenes())
"""The scenes of the library: their names are read once for all files."""
TARGETS = ("numpy", "llvm")
LLVM_FIRST = (pytest.param("numpy", marks=pytest.mark.slow), "llvm")
"""The same where an interpreted run takes long: a default run takes the compiled one."""
x, y, z, theta, phi, r = coordinates("x y z theta phi r")
m, M, g, l, k, c, omega, B = parameters("m M g l k c omega B")
VALUES = {m: 1.3, M: 2.1, g: 9.81, l: 0.7, k: 3.2, c: 0.15, omega: 1.9, B: 0.8}


def stated(**options: Any) -> Statement:
    """Declare a statement with default values for the parameters above, in their order.

    The order of parameters without a value is that of their latest declaration, which other tests may change.
    """
    statement = declare(**options)
    missing = {p: value for p, value in VALUES.items() if p in statement.parameters and p not in statement.defaults}
    return declare(**options | {"parameters": {**options.get("parameters", {}), **missing}}) if missing else statement


@cache
def loaded(name: str) -> Statement:
    """Return the statement of a scene of the library, read once for all tests."""
    return load(name)


@cache
def stated_in(name: str) -> frozenset[str]:
    """Return the sections of a scene's file, without stating the scene."""
    return frozenset(tomllib.loads(library_path(name).read_text("utf-8")))


@cache
def shared_scene(name: str) -> System:
    """Return a scene of the library as a system, compiled once for all tests. Tests must not change it."""
    return scene(name)


@cache
def statement_of(name: str) -> Statement:
    """Return the statement of a named system, declared once for all tests."""
    return SYSTEMS[name]()


@cache
def laws(name: str) -> Equations:
    """Return the equations of a named system."""
    return euler_lagrange(statement_of(name))


@cache
def model(name: str, target: str = "llvm") -> Model:
    """Return the model of a named system, compiled once for all tests."""
    return model_of(statement_of(name), machine(target), laws(name))


def build(target: str = "llvm", **options: Any) -> Model:
    """Return the model of a system from the arguments of its statement."""
    statement = stated(**options)
    return model_of(statement, machine(target))


def springs(target: str, n: int) -> Model:
    """Return n masses in a row, for states of every length: in registers, in unrolled blocks, and in loops."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    ends = [sp.Integer(0), *xs, sp.Integer(0)]
    stretch = [b - a for a, b in itertools.pairwise(ends)]
    return build(
        target,
        kinetic=m * sum(q.dot**2 for q in xs) / 2,
        potential=sum(k * s**2 / 2 + s**4 / 4 for s in stretch),
        coordinates=xs,
        initial={q: 0.3 * (-1) ** i + 0.1 * i for i, q in enumerate(xs)},
    )


def hanging_rods(n: int) -> Statement:
    """Return n masses on a hanging chain of rods, in Cartesian coordinates with a constraint for each rod."""
    points = [(coordinate(f"x{i}"), coordinate(f"y{i}")) for i in range(n)]
    ends = itertools.pairwise([(sp.Integer(0), sp.Integer(0)), *points])
    return stated(
        kinetic=sum(q.dot**2 for point in points for q in point) / 2,
        potential=sum(g * b for _, b in points),
        constraints={f"rod{i}": (c - a) ** 2 + (d - b) ** 2 - 1 for i, ((a, b), (c, d)) in enumerate(ends)},
        coordinates=[q for point in points for q in point],
        initial={q: value for i, point in enumerate(points) for q, value in zip(point, (i + 1.0, 0.0), strict=True)},
    )


def oscillator() -> Statement:
    return stated(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, initial={x: 1.0}, name="oscillator")


def pendulum() -> Statement:
    return stated(
        kinetic=m * l**2 * theta.dot**2 / 2, potential=-m * g * l * cos(theta), initial={theta: 2.0}, name="pendulum"
    )


def double_pendulum() -> Statement:
    return chain(2)


def chain(n: int) -> Statement:
    """Return a chain of n pendulums, stated by Cartesian positions."""
    angles = [coordinate(f"a{i}") for i in range(n)]
    px = py = sp.S.Zero
    kinetic = potential = sp.S.Zero
    for angle in angles:
        px, py = px + l * sin(angle), py - l * cos(angle)
        kinetic += m * (sp.diff(px, t) ** 2 + sp.diff(py, t) ** 2) / 2
        potential += m * g * py
    start = {angle: 0.5 + 0.1 * i for i, angle in enumerate(angles)}
    return stated(kinetic=kinetic, potential=potential, coordinates=angles, initial=start, name=f"chain of {n}")


def elastic_pendulum() -> Statement:
    return stated(
        kinetic=m * (r.dot**2 + r**2 * theta.dot**2) / 2,
        potential=k * (r - l) ** 2 / 2 - m * g * r * cos(theta),
        coordinates=[r, theta],
        initial={r: 1.1, theta: 0.4, theta.dot: 0.3},
        name="elastic pendulum",
    )


def spherical_pendulum() -> Statement:
    """Return a spherical pendulum: two blocks of one coordinate each, the second singular at the poles."""
    return stated(
        kinetic=m * l**2 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2,
        potential=m * g * l * cos(theta),
        coordinates=[theta, phi],
        initial={theta: 1.0, phi.dot: 0.4},
        name="spherical pendulum",
    )


def cart_and_pole() -> Statement:
    bob = (x + l * sin(theta), -l * cos(theta))
    speed = sum(sp.diff(part, t) ** 2 for part in bob)
    return stated(
        kinetic=M * x.dot**2 / 2 + m * speed / 2,
        potential=m * g * bob[1],
        coordinates=[x, theta],
        forces={x: cos(omega * t) - c * x.dot, theta: -c * theta.dot * theta},
        dissipation=c * theta.dot**2 / 2,
        initial={theta: 0.6},
        name="cart and pole",
    )


def charge() -> Statement:
    """Return a charge in a magnetic field: the potential depends on velocities, and M is constant and diagonal."""
    return stated(
        lagrangian=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2 + B * (x * y.dot - y * x.dot) / 2 - k * z**2 / 2,
        coordinates=[x, y, z],
        initial={x: 1.0, y.dot: 0.5, z: 0.2},
        name="charge",
    )


def bead_on_hoop() -> Statement:
    """Return a bead on a rotating hoop, whose kinetic energy contains time."""
    place = [l * sin(theta) * cos(omega * t), l * sin(theta) * sin(omega * t), -l * cos(theta)]
    speed = sum(sp.diff(part, t) ** 2 for part in place)
    return stated(kinetic=m * speed / 2, potential=m * g * place[2], initial={theta: 0.7}, name="bead on a hoop")


def henon_heiles() -> Statement:
    return stated(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=(x**2 + y**2) / 2 + x**2 * y - y**3 / 3,
        coordinates=[x, y],
        initial={x: 0.1, y: 0.2, x.dot: 0.3, y.dot: -0.1},
        name="Henon-Heiles",
    )


def kepler() -> Statement:
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=-k * m / sqrt(x**2 + y**2),
        coordinates=[x, y],
        parameters={k: 1.0},
        initial={x: 1.0, y.dot: 1.2},
        name="Kepler orbit",
    )


def coupled_masses() -> Statement:
    """Return coupled masses with a constant mass matrix, whose factors are hoisted."""
    return stated(
        kinetic=m * x.dot**2 / 2 + M * l * (x.dot + y.dot) ** 2 / 2,
        potential=k * x**2 / 2 + m * g * sin(x * y) + k * y**4 / 4,
        coordinates=[x, y],
        initial={x: 0.3, y: 0.5},
        name="coupled masses",
    )


def masses(n: int) -> Statement:
    """Return n masses, each carried by the one before: M is constant and full, and too large to be unrolled."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    kinetic = potential = place = sp.S.Zero
    for i, mass in enumerate(xs):
        place += mass
        kinetic += (m + i * M / 10) * sp.diff(place, t) ** 2 / 2
        potential += k * mass**2 / 2 + m * g * cos(place)
    start = {mass: 0.1 * (i + 1) for i, mass in enumerate(xs)}
    return stated(kinetic=kinetic, potential=potential, coordinates=xs, initial=start, name=f"{n} carried masses")


def saddle() -> Statement:
    """Return a system with an indefinite mass matrix with zeros on its diagonal."""
    return stated(
        lagrangian=m * x.dot * y.dot + l * z.dot**2 / 2 - k * x * y - k * z**2 / 2 - k * x**2 * z,
        coordinates=[x, y, z],
        initial={x: 0.4, y: 0.3, z: 0.2, x.dot: 0.1},
        name="saddle",
    )


def blocks() -> Statement:
    """Return a system with two blocks of two coordinates and one of one; the mass matrix depends on coordinates."""
    u, w = coordinates("u w")
    return stated(
        kinetic=m * (x.dot**2 + l * x.dot * y.dot * cos(x - y) + y.dot**2) / 2
        + M * (u.dot**2 + u.dot * w.dot * sin(u) / 2 + w.dot**2) / 2
        + m * (1 + z**2) * z.dot**2 / 2,
        potential=k * (x - u) ** 2 / 2 + k * (y - w) ** 2 / 2 + exp(z * x / 5),
        coordinates=[x, u, y, w, z],
        initial={x: 0.4, u: 0.3, y: -0.2, w: 0.1, z: 0.5},
        name="blocks",
    )


def friction() -> Statement:
    """Return a system with conditions on parameters, time and state, and with min, max, abs and sign."""
    side = sp.Piecewise((k, k > c), (m, True))
    pulse = sp.Piecewise((1, (t > 1) & (t < 2)), (0, True))
    return stated(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=side * x**2 / 2 + sp.Max(0, y - 1) ** 2 * k / 2 + k * sp.Abs(y) ** 3,
        forces={x: pulse - c * sp.sign(x.dot), y: sp.Min(0, -y) - sp.Max(k, c) * y.dot},
        coordinates=[x, y],
        initial={x: 0.5, y: 1.5, x.dot: 0.3},
        name="friction",
    )


SYSTEMS: dict[str, Callable[[], Statement]] = {
    "oscillator": oscillator,
    "pendulum": pendulum,
    "double pendulum": double_pendulum,
    "chain of 7": lambda: chain(7),
    "elastic pendulum": elastic_pendulum,
    "spherical pendulum": spherical_pendulum,
    "cart and pole": cart_and_pole,
    "charge": charge,
    "bead on a hoop": bead_on_hoop,
    "Henon-Heiles": henon_heiles,
    "Kepler orbit": kepler,
    "coupled masses": coupled_masses,
    "8 carried masses": lambda: masses(8),
    "saddle": saddle,
    "blocks": blocks,
    "friction": friction,
}
