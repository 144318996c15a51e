"""The same motion in other units has the same digits: no step, tolerance or floor depends on an absolute size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sympy import cos, sin, sqrt

import lagrange as lg

x, y, z, theta, phi, r = lg.coordinates("x y z theta phi r")
a, b, c, d = lg.coordinates("a b c d")
m, k, g, ell, mu, drag, force, omega = lg.parameters("m k g ell mu drag force omega")

MASS, LENGTH, TIME = np.eye(3)
STIFFNESS, FORCE = MASS - 2 * TIME, MASS + LENGTH - 2 * TIME
UNITS_OF = {
    m: MASS,
    k: STIFFNESS,
    g: LENGTH - 2 * TIME,
    ell: LENGTH,
    mu: 3 * LENGTH - 2 * TIME,
    drag: MASS - TIME,
    force: FORCE,
    omega: -TIME,
}
"""The exponents of mass, length and time in every parameter."""

OWN = ("bs3", "dopri5", "tsit5", "verner9", "dop853", "radau3", "radau5", "taylor")
THEIRS = ("scipy-rk45", "scipy-rk23", "scipy-dop853", "scipy-radau", "scipy-bdf", "scipy-lsoda", "cvode")
LOW = {"bs3": 1e-5, "radau3": 1e-5, "scipy-rk23": 1e-4, "scipy-bdf": 1e-6, "cvode": 1e-6, "scipy-rk45": 1e-6}
"""Tolerances of methods that would take too many steps at the default."""

UNITS = ((0, -30, 0), (0, -9, 0), (0, 9, 0), (0, 30, 0), (0, 0, -12), (0, 0, 12), (-20, 7, 0), (20, -25, 10))
"""Powers of ten by which masses, lengths and times are as large."""

ROUND_OFF = 1e-12
"""Errors below this are round-off, which is not the same in other units."""


@dataclass(frozen=True, eq=False)
class Case:
    """A motion in SI units, with coordinates and parameters near one.

    `lengths` flags the coordinates that are lengths.
    """

    system: lg.System
    lengths: tuple[bool, ...]
    start: dict[Any, float]
    end: float
    values: dict[Any, float]

    @property
    def names(self) -> tuple[Any, ...]:
        return tuple(self.system.compile().statement.coordinates)


def case(lengths: str, end: float, start: dict[Any, float], values: dict[Any, float], **stated: Any) -> Case:
    system = lg.System(parameters=values, initial=start, **stated)
    return Case(system, tuple(letter == "L" for letter in lengths), start, end, values)


def kinetic(*coordinates: Any) -> Any:
    return m * sum(q.dot**2 for q in coordinates) / 2


def springs(*stations: Any) -> Any:
    return k * sum((p - q) ** 2 for p, q in pairwise(stations)) / 2


swing = m * ell**2 * theta.dot**2 / 2 + m * g * ell * cos(theta)
both = ell * (theta.dot * sin(theta) + phi.dot * sin(phi)), ell * (theta.dot * cos(theta) + phi.dot * cos(phi))

CASES = {
    "pendulum": case("A", 6.0, {theta: 2.0}, {m: 1, g: 9, ell: 1}, lagrangian=swing, coordinates=[theta]),
    "spring": case("L", 9.0, {x: 1.5}, {m: 1, k: 2}, kinetic=kinetic(x), potential=k * x**2 / 2, coordinates=[x]),
    "orbit": case(
        "LL", 7.0, {x: 0.4, y.dot: 2.0}, {m: 1, mu: 1},
        kinetic=kinetic(x, y), potential=-m * mu / sqrt(x**2 + y**2), coordinates=[x, y],
    ),
    "double pendulum": case(
        "AA", 4.0, {theta: 1.0, phi: 0.5}, {m: 1, g: 9, ell: 1},
        kinetic=m * ell**2 * theta.dot**2 / 2 + m * (both[0] ** 2 + both[1] ** 2) / 2,
        potential=-m * g * ell * (2 * cos(theta) + cos(phi)), coordinates=[theta, phi],
    ),
    "elastic pendulum": case(
        "LA", 5.0, {r: 1.2, theta: 1.0}, {m: 1, k: 30, g: 9, ell: 1},
        kinetic=m * (r.dot**2 + r**2 * theta.dot**2) / 2,
        potential=k * (r - ell) ** 2 / 2 - m * g * r * cos(theta), coordinates=[r, theta],
    ),
    "driven from rest": case(
        "L", 9.0, {}, {m: 1, k: 2, force: 1, omega: 3, drag: 0.2},
        kinetic=kinetic(x), potential=k * x**2 / 2, coordinates=[x],
        forces={x: force * sin(omega * lg.t) - drag * x.dot},
    ),
    "plucked chain": case(
        "LLLLLLLL", 9.0, {a: 1.0}, {m: 1, k: 1},
        kinetic=kinetic(a, b, c, d, x, y, z, r),
        potential=k * (a**2 + r**2) / 2 + springs(a, b, c, d, x, y, z, r), coordinates=[a, b, c, d, x, y, z, r],
    ),
}  # fmt: skip


def run(name: str, method: str, powers: tuple[int, int, int], *, base: float = 10.0, **options: Any) -> NDArray[Any]:
    """Return the states (2n, N) of a run in other units, converted to SI units."""
    one = CASES[name]
    mass, length, time = (base**power for power in powers)
    model = one.system.compile()
    factor = dict(zip(one.names, (length if lengthy else 1.0 for lengthy in one.lengths), strict=True))
    start = {key: value * _factor(key, factor, time) for key, value in one.start.items()}
    values = {}
    for key, value in one.values.items():
        p, q, s = UNITS_OF[key]
        values[key] = value * mass**p * length**q * time**s
    result = lg.integrate(model, (0.0, one.end * time), start, method=method, parameters=values, **options)
    assert result.status is lg.Status.SUCCESS, result.message
    sizes = np.array([factor[q] for q in one.names] + [factor[q] / time for q in one.names])
    return np.asarray(result.y / sizes[:, None])


def _factor(key: Any, factor: dict[Any, float], time: float) -> float:
    return factor[key] if key in factor else next(f / time for q, f in factor.items() if q.dot == key)


@lru_cache(maxsize=64)
def truth(name: str) -> NDArray[Any]:
    return run(name, "dop853", (0, 0, 0), rtol=1e-13)


@lru_cache(maxsize=1024)
def error(name: str, method: str, powers: tuple[int, int, int]) -> float:
    """Return the largest error of the last state, relative to the largest size of each entry along the run."""
    right = truth(name)
    options = {"rtol": LOW[method]} if method in LOW else {}
    sizes = np.abs(right).max(axis=1)
    apart = np.abs(run(name, method, powers, **options)[:, -1] - right[:, -1])
    return max(float(np.max(apart / np.where(sizes > 0, sizes, 1.0))), ROUND_OFF)


def skip_without(method: str) -> None:
    if method == "cvode":
        pytest.importorskip("sksundae")


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "method"), [*product(CASES, OWN)])
def test_a_motion_is_the_same_in_all_units(name: str, method: str) -> None:
    plain = error(name, method, (0, 0, 0))
    for powers in UNITS:
        assert plain / 10 <= error(name, method, powers) <= 10 * plain, powers
    if method.startswith("radau") and len(set(CASES[name].lengths)) > 1:
        return  # How Newton's matrix is balanced depends on the units of its rows, where these differ.
    # Powers of two change no rounding.
    options = {"rtol": LOW[method]} if method in LOW else {}
    here, there = run(name, method, (0, 0, 0), **options), run(name, method, (-40, 60, 0), base=2.0, **options)
    assert np.array_equal(here, there)


@pytest.mark.few(2)
@pytest.mark.parametrize(("name", "method"), [*product(("orbit", "driven from rest", "plucked chain"), THEIRS)])
def test_solvers_of_other_packages_have_the_same_errors_in_all_units(name: str, method: str) -> None:
    skip_without(method)
    plain = error(name, method, (0, 0, 0))
    for powers in ((0, -30, 0), (0, 30, 0), (0, 0, 12), (20, -25, 10)):
        assert plain / 10 <= error(name, method, powers) <= 10 * plain, powers
