"""The rolling disc of SymPy's tests: right by Kane's method and multipliers, wrong with the constraint put into L."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, sin, tan

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.statement.declare import declare
from tests.mechanisms.formulation import Formulation
from tests.mechanisms.scenes import g, kane_of_the_disc, m, r, rolling_disc, z1, z5, z6, z7
from tests.models import loaded

VALUES = {m: 1.0, g: 1.0, r: 1.0}
"""Those of test_rolling_disc in SymPy's test_kane.py, where the critical spin is 1/sqrt(3)."""

STATES = [
    # lean, and u1, u2, u3: the rate of leaning, the spin about the axle, and the rate across both
    (0.0, 0.0, 1 / np.sqrt(3), 0.0),
    (0.0, 0.1, 1 / np.sqrt(3), 0.2),
    (0.3, 0.0, 1.0, 0.0),
    (-0.7, 0.4, -2.0, 1.1),
    (1.2, -0.3, 0.6, -0.8),
]


@cache
def formulation() -> Formulation:
    return rolling_disc()


@cache
def model() -> Model:
    statement = loaded("rolling-disc")
    assert dict(statement.defaults) == VALUES
    return model_of(statement, machine("llvm"))


def state(lean: float, u1: float, u2: float, u3: float) -> Any:
    return np.array([0.4, lean, 1.3, 0.2, -0.5, u1, u2, u3])


def test_kanes_method_gives_what_sympy_publishes() -> None:
    """The right-hand side in test_kane.py of SymPy 1.14."""
    published = [
        (6 * z6 * z7 * r - z7**2 * r * tan(z1) + 4 * g * sin(z1)) / (5 * r),
        -2 * z5 * z7 / 3,
        z5 * (-2 * z6 + z7 * tan(z1)),
    ]
    result = kane_of_the_disc()
    assert [sympy.simplify(first - second) for first, second in zip(result, published, strict=True)] == [0, 0, 0]


@pytest.mark.parametrize("given", STATES)
def test_the_multipliers_are_the_friction_at_the_contact(given: tuple[float, ...]) -> None:
    """The multipliers are m times the horizontal acceleration of the centre, by differences with an error of h^2."""
    z = state(*given)
    points = sympy.Matrix([*loaded("rolling-disc").positions["centre"]])
    plain = loaded("rolling-disc").plain
    coordinates = [plain[x] for x in loaded("rolling-disc").coordinates]
    places = sympy.lambdify(coordinates, points.xreplace(plain).subs(VALUES))
    y = formulation().lift(z, 0.0)
    q, v, a = y[:5], y[5:], model().accelerations(y[:5], y[5:])
    h = 1e-3
    sides = [np.array(places(*(q + s * v + s**2 / 2 * a))).ravel() for s in (-h, 0.0, h)]
    pull = (sides[0] - 2 * sides[1] + sides[2]) / h**2
    assert model().multipliers(q, v) == pytest.approx(pull[:2], abs=5e-5)


def rolled(potential: Any) -> Any:
    """Return q'' of the three angles from a Lagrangian into which the constraint has been put."""
    q1, q2, q3 = lg.coordinates("q1 q2 q3")
    along, across = q3.dot + q1.dot * sin(q2), q1.dot * cos(q2)
    # the velocity of the centre is that of a rotation about the contact, which is taken to be at rest
    kinetic = m * r**2 * (along**2 + q2.dot**2) / 2 + m * r**2 * (q2.dot**2 + 2 * along**2 + across**2) / 8
    statement = declare(kinetic=kinetic, potential=potential(q2), parameters=VALUES, coordinates=[q1, q2, q3])
    return model_of(statement, machine("llvm")).accelerations


def test_putting_the_constraint_into_the_lagrangian_gives_what_sympys_lagrange_test_asserts() -> None:
    """The right-hand sides RHS[4] and RHS[5] in test_lagrange.py of SymPy 1.14, with its V = -m g r cos(q2)."""
    accelerations = rolled(lambda q2: -m * g * r * cos(q2))
    for given in STATES:
        lean, (u1, u2, u3) = given[0], given[1:]
        w1, w2 = u3 / np.cos(lean), u1
        w3 = u2 - u3 * np.tan(lean)
        second = (-8 * np.sin(lean) + (5 * np.sin(2 * lean) * w1 + 12 * np.cos(lean) * w3) * w1) / 10
        third = (-5 * np.cos(lean) * w1 + 6 * np.tan(lean) * w3 + 4 * w1 / np.cos(lean)) * w2
        result = accelerations(np.array([0.4, lean, 1.3]), np.array([w1, w2, w3]))
        assert result[1:] == pytest.approx([second, third], rel=1e-12, abs=1e-12)


def test_neither_that_nor_the_same_with_the_sign_mended_is_the_motion() -> None:
    y = formulation().lift(state(*STATES[3]), 0.0)
    right = model().accelerations(y[:5], y[5:])[:3]
    upside_down = rolled(lambda q2: -m * g * r * cos(q2))(y[:3], y[5:8])
    mended = rolled(lambda q2: m * g * r * cos(q2))(y[:3], y[5:8])
    assert abs(upside_down - right)[1] > 0.5
    assert mended[1] == pytest.approx(right[1], rel=1e-12)
    assert abs(mended - right).max() > 0.1
