"""A mass matrix that has no inverse anywhere is refused when the system is stated, with the motion without inertia."""

from __future__ import annotations

from typing import Any

import pytest
import sympy as sp
from sympy import cos, sin

from lagrange.compiler import reached
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.equations.regularity import check_regularity
from lagrange.errors import StatementError
from tests.models import SYSTEMS, M, chain, k, l, laws, m, stated, theta, x, y, z


def checked(equations: Equations) -> None:
    check_regularity(equations, reach=reached)


def refusal(**given: Any) -> str:
    with pytest.raises(StatementError) as raised:
        checked(euler_lagrange(stated(**given)))
    return str(raised.value)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_sound_system_passes(name: str) -> None:
    checked(laws(name))


def test_a_coordinate_without_its_velocity() -> None:
    text = refusal(kinetic=m * x.dot**2 / 2, potential=k * (x - y) ** 2 / 2, coordinates=[x, y])
    assert "the kinetic energy does not contain y.dot, so y has no inertia" in text and "make y a parameter" in text


def test_a_lagrangian_without_any_velocity() -> None:
    assert "does not contain x.dot, so x has no inertia" in refusal(lagrangian=-k * x**2, coordinates=[x])


def test_a_lagrangian_linear_in_a_velocity() -> None:
    text = refusal(lagrangian=x.dot * sin(x) - x**2, coordinates=[x])
    assert text.startswith("the Lagrangian has no term of second order in x.dot, so x has no inertia")
    assert "its acceleration is not determined" in text
    assert "Add the kinetic energy of x, or make x a parameter." in text
    mixed = refusal(lagrangian=m * x.dot**2 / 2 + y.dot * sin(x) - k * y**2, coordinates=[x, y])
    assert "no term of second order in y.dot" in mixed


def test_two_coordinates_with_the_inertia_of_one() -> None:
    text = refusal(kinetic=(x.dot + y.dot) ** 2, potential=k * x**2 + k * y**2, coordinates=[x, y])
    assert (
        "the mass matrix d2L/dv2 is singular" in text and "a motion with x.dot = 1, y.dot = -1 has no inertia" in text
    )
    assert "Add the kinetic energy that is missing, or use fewer coordinates." in text


def test_the_motion_without_inertia_is_found_in_proportion() -> None:
    text = refusal(kinetic=m * (x.dot + 2 * y.dot) ** 2 / 2, coordinates=[x, y])
    assert "x.dot = 1, y.dot = -0.5 has no inertia" in text


def test_a_group_among_others_is_named_and_the_others_are_not() -> None:
    text = refusal(
        kinetic=m * (x.dot - y.dot) ** 2 / 2 + M * z.dot**2 / 2 + l * theta.dot**2, coordinates=[z, x, theta, y]
    )
    assert "x.dot = 1, y.dot = 1 has no inertia" in text
    assert "z.dot" not in text and "theta.dot" not in text


def test_three_coordinates_with_the_inertia_of_two() -> None:
    text = refusal(kinetic=m * (x.dot + y.dot) ** 2 / 2 + m * (y.dot + z.dot) ** 2 / 2, coordinates=[x, y, z])
    assert "x.dot = 1, y.dot = -1, z.dot = 1 has no inertia" in text


def test_singular_everywhere_through_moving_entries() -> None:
    text = refusal(kinetic=m * (x.dot * cos(x) + y.dot * sin(y)) ** 2 / 2, coordinates=[x, y])
    assert "the mass matrix d2L/dv2 is singular" in text and "a motion with x.dot = " in text


def test_singular_somewhere_is_not_singular_everywhere() -> None:
    for kinetic in (
        m * sin(x) ** 2 * y.dot**2 / 2 + m * x.dot**2 / 2,
        m * (x.dot + y.dot) ** 2 / 2 + M * x**2 * y.dot**2,
        m * (x.dot + y.dot) ** 2 / 2 + M * sp.Float("1e-9") * y.dot**2,
        x.dot * y.dot * m,
    ):
        checked(euler_lagrange(stated(kinetic=kinetic, coordinates=[x, y])))


def test_units_that_differ_widely_are_no_reason_to_refuse() -> None:
    kinetic = (
        sp.Float("1e-12") * x.dot**2
        + sp.Float("1e-3") * x.dot * y.dot / 2 * sp.Float("1e-6")
        + sp.Float("1e12") * y.dot**2
    )
    checked(euler_lagrange(stated(kinetic=kinetic, coordinates=[x, y])))


def test_a_long_chain_passes() -> None:
    checked(euler_lagrange(chain(12)))


def test_where_the_energy_is_defined_nowhere_that_is_looked_at_there_is_no_verdict() -> None:
    narrow = sp.Piecewise((m * (x.dot + y.dot) ** 2 / 2 + m * x.dot**2, x > 100))
    checked(euler_lagrange(stated(kinetic=narrow, coordinates=[x, y])))
