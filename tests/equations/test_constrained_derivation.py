"""Derivations with constraints: Euler-Lagrange equations with multipliers, and constraint forces."""

from __future__ import annotations

from typing import Any

import pytest
import sympy
from sympy import cos, sin

import lagrange as lg
from lagrange.equations import textbook_algebra
from lagrange.equations.derivation import derive
from lagrange.errors import StatementError
from lagrange.statement.declare import declare

m, g, l, a, R, I, J, omega = lg.parameters("m g l a R I J omega")
x, y, z, phi, psi = lg.coordinates("x y z phi psi")
rod, roll, side = lg.multiplier("rod"), lg.multiplier("roll"), lg.multiplier("side")

PENDULUM: dict[str, Any] = {
    "kinetic": m * (x.dot**2 + y.dot**2) / 2,
    "potential": m * g * y,
    "constraints": {"rod": x**2 + y**2 - l**2},
}
DISC: dict[str, Any] = {
    "kinetic": m * (x.dot**2 + y.dot**2) / 2 + I * phi.dot**2 / 2 + J * psi.dot**2 / 2,
    "potential": 0,
    "coordinates": [x, y, phi, psi],
    "constraints": {"roll": x.dot - R * phi.dot * cos(psi), "side": y.dot - R * phi.dot * sin(psi)},
}


def test_multipliers_stand_on_the_right() -> None:
    derivation = derive(declare(**PENDULUM))
    assert [(law.lhs, law.rhs) for law in derivation.equations] == [
        (m * x.ddot, 2 * rod * x),
        (m * y.ddot + m * g, 2 * rod * y),
    ]
    assert [(law.lhs, law.rhs) for law in derivation.constraints] == [(x**2 + y**2 - l**2, 0)]
    assert derivation.constraint_forces == {"rod": {x: 2 * rod * x, y: 2 * rod * y}}


def test_tension_of_the_rod_as_in_the_book() -> None:
    derivation = derive(declare(**PENDULUM))
    radius = x**2 + y**2
    assert sympy.expand(derivation.multipliers["rod"] * 2 * radius) == sympy.expand(m * (g * y - x.dot**2 - y.dot**2))
    assert str(derivation.accelerations[x]).startswith("(g*y(t) - Derivative(x(t), t)**2")


def test_rolling_needs_no_more_than_the_disc_turns() -> None:
    derivation = derive(declare(**DISC))
    rights = [law.rhs for law in derivation.equations]
    assert rights == [roll, side, -R * roll * cos(psi) - R * side * sin(psi), 0]
    assert derivation.accelerations[x] == -R * phi.dot * psi.dot * sin(psi)
    assert derivation.multipliers["side"] == m * R * phi.dot * psi.dot * cos(psi)


def test_constraints_that_move_have_their_second_rate_in_the_accelerations() -> None:
    derivation = derive(declare(kinetic=m * (x.dot**2 + y.dot**2) / 2, constraints={"lift": y - a * sin(omega * lg.t)}))
    assert derivation.accelerations == {x: 0, y: -a * omega**2 * sin(omega * lg.t)}
    assert derivation.multipliers["lift"] == -m * a * omega**2 * sin(omega * lg.t)


def test_forces_of_a_constraint_that_is_not_linear_follow_chetaev() -> None:
    stated = declare(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        potential=m * g * z,
        constraints={"appell": x.dot**2 + y.dot**2 - a**2 * z.dot**2},
    )
    exerted = derive(stated).constraint_forces["appell"]
    appell = lg.multiplier("appell")
    assert exerted == {x: 2 * appell * x.dot, y: 2 * appell * y.dot, z: -2 * a**2 * appell * z.dot}


def test_a_coordinate_without_inertia_that_a_constraint_holds_is_solved_for() -> None:
    derivation = derive(declare(kinetic=m * x.dot**2 / 2, coordinates=[x, y], constraints={"tie": y - 2 * x}))
    assert derivation.accelerations == {x: 0, y: 0}


def test_multipliers_are_refused_with_the_accelerations_where_they_are_too_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(textbook_algebra, "LONGEST_FORMULA", 3)
    monkeypatch.setattr(textbook_algebra, "EXPANDED_WITH_MULTIPLIERS", 0)
    for part in ("accelerations", "multipliers"):
        with pytest.raises(StatementError, match="too large for the solved accelerations to be written out"):
            getattr(derive(declare(**PENDULUM)), part)


@pytest.mark.parametrize("expanded", [0, 6])
def test_constraints_that_depend_on_one_another_have_no_formula(expanded: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(textbook_algebra, "EXPANDED_WITH_MULTIPLIERS", expanded)
    stated = declare(
        kinetic=m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, constraints={"first": x - 2 * y, "second": 4 * y - 2 * x}
    )
    with pytest.raises(StatementError) as refusal:
        _ = derive(stated).accelerations
    assert str(refusal.value) == (
        "the accelerations of x and y and the multipliers of first and second are not determined by a formula, at any "
        "state: the constraints depend on one another, or a motion that they allow has no inertia. Drop a constraint "
        "that follows from the others, or add the kinetic energy that is missing."
    )
