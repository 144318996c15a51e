"""Systems expanded about a point, compared with the full system and its linearization; refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Abs, Piecewise, Rational, cos, pi, sin, sqrt

import lagrange as lg
from tests.models import shared_scene
from tests.refusals import refusal

theta, x, y = lg.coordinates("theta x y")
m, g, l, k, c, a = lg.parameters("m g l k c a")


def pendulum(**more: Any) -> lg.System:
    return lg.System(
        m * l**2 * theta.dot**2 / 2,
        -m * g * l * cos(theta),
        parameters={m: 2, g: 9.81, l: 0.7},
        name="pendulum",
        **more,
    )


def test_the_pendulum_swings_harmonically() -> None:
    small = pendulum().small({theta: 0})
    assert small.equations() == [sympy.Eq(m * l**2 * theta.ddot + m * g * l * theta, 0)]
    assert small.statement.potential == m * g * l * theta**2 / 2 - m * g * l
    assert small.statement.about == ("Expanded about theta = 0 to order 2 in changes of coordinates and velocities.")
    assert small.check()


def test_away_from_equilibrium_terms_of_first_order_stay_and_are_told() -> None:
    small = pendulum().small({theta: pi / 2})
    assert small.accelerations() == {theta: -g / l}
    assert small.statement.about == (
        "Expanded about theta = pi/2 to order 2 in changes of coordinates and velocities. "
        "The point is not an equilibrium: terms of first order remain, and accelerations are those "
        "of the system at the point alone."
    )
    assert "no equilibrium" not in pendulum().small({theta: pi}).statement.about


def test_parameters_keep_the_order_in_which_they_were_stated() -> None:
    assert list(shared_scene("double-pendulum").small().parameters) == list(shared_scene("double-pendulum").parameters)
    assert "½ (m₁ + m₂) l₁² θ̇₁²" in shared_scene("double-pendulum").small().derivation().unicode()


def error(system: lg.System, at: dict[Any, float], order: int, size: float) -> float:
    """Return the error of the expansion's accelerations at a distance from the point."""
    full, small = system.compile(check=False), system.small(at, order=order).compile(check=False)
    draw = np.random.default_rng(3)
    keys = (*system.coordinates, *system.statement.velocities)
    y0 = np.array([float(at.get(key, 0.0)) for key in keys]) + size * draw.uniform(-1, 1, len(keys))
    n = len(keys) // 2
    return float(np.max(np.abs(full.accelerations(y0[:n], y0[n:], 0.4) - small.accelerations(y0[:n], y0[n:], 0.4))))


FORCED = lg.System(
    m * (x.dot**2 + (l + x) ** 2 * theta.dot**2) / 2,
    -m * g * (l + x) * cos(theta) + k * x**2 / 2,
    dissipation=c * sqrt(1 + x) * x.dot**2 / 2,
    forces={theta: a * sin(lg.t) * sin(theta) - theta.dot**3},
    coordinates=[x, theta],
    parameters={m: 1, l: 1, g: 9.81, k: 40, c: 0.3, a: 0.2},
)


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize(
    ("system", "at"),
    [
        (shared_scene("double-pendulum"), {}),
        (FORCED, {x: 9.81 / 40}),
        (shared_scene("elastic-pendulum"), {lg.coordinate("r"): 1.0}),
    ],
    ids=["double", "forced", "elastic"],
)
def test_the_error_falls_with_the_order(system: lg.System, at: dict[Any, float], order: int) -> None:
    # About an equilibrium, equations of order n - 1 leave an error of order n: a tenth of the distance leaves 10^-n of
    # it. Where the terms of that order vanish by symmetry it falls faster.
    far, near = (error(system, at, order, size) for size in (2e-2, 2e-3))
    assert near <= 10 ** (0.5 - order) * far and near < far


def test_constraints_are_expanded_with_their_curvature() -> None:
    rod = shared_scene("cartesian-pendulum")
    length = next(p for p in rod.statement.parameters if p.name == "l")
    small = rod.small({"y": -length})
    assert sympy.expand(small.statement.constraints[0].expression - rod.statement.constraints[0].expression) == 0
    assert "no equilibrium" not in small.statement.about
    wire = lg.System(m * (x.dot**2 + y.dot**2) / 2, constraints={"wire": y - a * (cos(x) - 1)})
    assert wire.small().statement.constraints[0].expression == a * x**2 / 2 + y


T = m * x.dot**2 / 2
NONE = "the potential energy has no expansion about {}: it"
CORNER = f"{NONE} has a corner or a jump where {{}} is zero, as at this point. Choose a point next to it."
INFINITE = (
    f"{NONE}, or a derivative up to order 2, is not finite there. Choose another point, or coordinates that are "
    "regular at it."
)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda: shared_scene("spherical-pendulum").small(),
            "the inertia of phi vanishes at theta = 0 and phi = 0, so the Lagrangian to order 2 does not contain this "
            "velocity: choose coordinates that are regular at the point, or another point.",
        ),
        (lambda: lg.System(T, k * Abs(x)).small(), CORNER.format("x = 0", "x")),
        (lambda: lg.System(T, Piecewise((x**2, x > a), (0, True))).small({x: a}), CORNER.format("x = a", "a - x")),
        (lambda: lg.System(T, x ** Rational(3, 2)).small(), INFINITE.format("x = 0")),
        (
            lambda: shared_scene("cartesian-pendulum").small(),
            "the point is not on the constraint 'rod', which is -l**2 there and not zero: give values of all "
            "coordinates in it.",
        ),
        (lambda: pendulum().small(order=1), "order = 1: give a whole number from 2 to 8."),
    ],
)
def test_what_has_no_expansion_is_refused(act: Callable[[], Any], message: str) -> None:
    assert refusal(act) == message
