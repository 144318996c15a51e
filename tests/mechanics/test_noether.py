"""The quantity of a symmetry that is given, and what is said of one that is none."""

from __future__ import annotations

from typing import Any

import pytest
import sympy
from sympy import cos, exp, sin, sqrt

import lagrange as lg
from lagrange.errors import StatementError
from tests.mechanics.conserving_systems import FLAT, POLAR, POLAR_T, B, T, c, g, k, m, omega, phi, r, x, y, z

KEPLER = lg.System(T(FLAT), -k / sqrt(x**2 + y**2), name="kepler")


def same(found: Any, wanted: Any) -> bool:
    return bool(sympy.simplify(found - wanted) == 0)


def test_quantities_of_symmetries() -> None:
    assert same(KEPLER.noether({x: -y, y: x}), m * (x * y.dot - y * x.dot))
    assert same(KEPLER.noether({"x": -2 * y, "y": 2 * x}), 2 * m * (x * y.dot - y * x.dot))
    assert same(KEPLER.noether({lg.t: 1}), -KEPLER.energy)
    polar = lg.System(POLAR_T, -k / r)
    assert same(polar.noether({phi: 1}), m * r**2 * phi.dot)
    free = lg.System(POLAR_T)
    assert same(free.noether({r: cos(phi), phi: -sin(phi) / r}), m * sympy.diff(POLAR[0], lg.t))
    field = x * cos(omega * lg.t) + y * sin(omega * lg.t)
    turning = lg.System(T(FLAT), k * field)
    assert same(turning.noether({lg.t: 1, x: -omega * y, y: omega * x}).coeff(k), -field)


@pytest.mark.parametrize(
    ("statement", "generator", "wanted"),
    [
        ({"kinetic": T(FLAT), "potential": m * g * y}, {y: 1}, m * y.dot + m * g * lg.t),
        ({"lagrangian": T(FLAT) + B * x * y.dot}, {x: 1}, m * x.dot - B * y),
        ({"lagrangian": T(FLAT) + B * x * y.dot}, {x: -y, y: x}, m * (x * y.dot - y * x.dot) + B * (x**2 + y**2) / 2),
        ({"kinetic": T(FLAT)}, {x: lg.t}, m * (x.dot * lg.t - x)),
        ({"kinetic": T((x,)), "dissipation": c * x.dot**2 / 2}, {x: 1}, m * x.dot + c * x),
        ({"lagrangian": T((x,)) + exp(x) * cos(x) * x.dot}, {x: 1}, m * x.dot),
        ({"kinetic": T(FLAT), "potential": m * g * y, "constraints": {"rod": x**2 + y**2 - 1}}, {lg.t: 1}, None),
    ],
)
def test_total_derivatives_forces_and_constraints(statement: Any, generator: Any, wanted: Any) -> None:
    system = lg.System(**statement)
    found = system.noether(generator)
    if wanted is None:
        wanted = -system.energy
    # Additive constants are arbitrary.
    assert same(sympy.diff(found - wanted, lg.t), 0)


def test_what_is_no_symmetry_is_refused_with_its_rate() -> None:
    with pytest.raises(StatementError) as refusal:
        KEPLER.noether({x: 1})
    told = str(refusal.value)
    assert told.startswith(
        "this is not a symmetry of kepler: its quantity m*x_dot changes at the rate -k*x/(x**2 + y**2)**(3/2), which "
    )
    assert " at x = " in told and "m = " in told
    held = lg.System(T((x, y, z)), m * g * z, constraints={"wire": y - x**2}, name="wire")
    with pytest.raises(StatementError, match=r"changes at the rate .* It does not keep the constraint wire\.$"):
        held.noether({x: -y, y: x})
    driven = lg.System(T(FLAT), constraints={"wall": x - sin(lg.t)}, name="wall")
    with pytest.raises(StatementError, match="not a symmetry of wall"):
        driven.noether({lg.t: 1})


def test_what_cannot_be_proven_is_not_claimed() -> None:
    hidden = lg.System(m * x.dot**2 / 2, sympy.Piecewise((1, x < 1000), (2, True)), name="hidden")
    with pytest.raises(StatementError, match="it was not found that this is a symmetry of hidden: no proof was found"):
        hidden.noether({x: 1})


@pytest.mark.parametrize(
    ("generator", "told"),
    [
        (5, "noether takes a dict from coordinates to how they move, as {x: -y, y: x}, not 5"),
        ({}, "noether takes a dict"),
        ({"u": 1}, "'u' is neither t nor a coordinate of this system; they are x and y"),
        ({x: y.dot}, "the motion of x is .*: a point symmetry has an expression in coordinates, parameters and t"),
        ({lg.t: x}, "the motion of t is .*: a point symmetry has an expression in parameters alone"),
        ({x: z}, r"the motion of x contains z\(t\), which this system does not have; it has x\(t\), y\(t\)"),
    ],
)
def test_generators_that_are_refused(generator: Any, told: str) -> None:
    with pytest.raises(StatementError, match=told):
        KEPLER.noether(generator)


def test_decimals_in_a_generator_are_fractions() -> None:
    assert same(KEPLER.noether({lg.t: 0.5}), -KEPLER.energy / 2)
    assert same(KEPLER.noether({x: -0.1 * y, y: 0.1 * x}), m * (x * y.dot - y * x.dot) / 10)
