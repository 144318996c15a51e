"""Conserved quantities are found in any statement of a system, and no wrong ones are reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, exp, sin, sqrt

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.mechanics.symmetries import SymmetryEquation
from tests.mechanics.conserving_systems import (
    FLAT,
    POLAR_T,
    WAYS,
    B,
    T,
    c,
    g,
    k,
    m,
    omega,
    phi,
    r,
    u,
    w,
    x,
    y,
    z,
)


@pytest.mark.few
@pytest.mark.parametrize("way", WAYS)
def test_what_is_conserved_is_found_and_nothing_else(way: str) -> None:
    """The quantities are as many as listed, independent, and constant along the compiled motion."""
    statement, count = WAYS[way]
    system = lg.System(**statement)
    result = system.conserved()
    assert len(result) == count, [item.name for item in result]
    model, draw = system.compile("numpy", check=False), np.random.default_rng(5)
    if model.statement.constraints or not count:
        return
    parameters = draw.uniform(0.5, 1.6, len(model.statement.parameters))
    states, times = draw.uniform(0.3, 1.4, (2 * model.dimension, 60)), draw.uniform(0.2, 1.7, 60)
    flow = model.rhs(times, states, parameters) * 1e-5

    def values(item: Any, way: int = 0) -> Any:
        return model.evaluate_expression(item.expression, times + way * 1e-5, states + way * flow, parameters)

    rows = np.array([[values(item, way) for item in result] for way in (-1, 0, 1)])
    assert np.linalg.matrix_rank(np.vstack([rows[1], np.ones(60)]), tol=1e-6) == count + 1
    # Central differences: their error is some 1e-9 of what moves.
    scale = np.abs(rows).max() * max(1.0, np.abs(flow / 1e-5).max() ** 2)
    assert np.abs(rows[2] - rows[0]).max() / 2e-5 < 1e-6 * scale


def names(**statement: Any) -> list[str]:
    return [item.name for item in lg.System(**statement).conserved()]


def test_names_and_reasons() -> None:
    kepler = lg.System(T((x, y, z)), -k / sqrt(x**2 + y**2 + z**2), coordinates=[x, y, z]).conserved()
    assert sorted(item.name for item in kepler) == [
        *(f"Runge-Lenz vector {axis}" for axis in "xyz"),
        *(f"angular momentum {axis}" for axis in "xyz"),
        "energy",
    ]
    about = {item.name: item for item in kepler}
    assert about["angular momentum z"].expression == m * x * y.dot - m * y * x.dot
    assert about["angular momentum z"].reason == (
        "The symmetry delta x = -y and delta y = x leaves the Lagrangian as it is."
    )
    assert str(about["energy"]).endswith("and no force acts besides the potential.")
    thrown = lg.System(T(FLAT), m * g * y, coordinates=list(FLAT)).conserved()
    assert {item.name: item.expression for item in thrown}["momentum y"] == m * y.dot + g * m * lg.t
    polar = lg.System(POLAR_T, -k / r).conserved()
    assert [item.name for item in polar][:2] == ["energy", "p_phi"] and polar[
        1
    ].reason == "phi is not in the Lagrangian."
    assert names(kinetic=POLAR_T + m * r**2 * omega**2 / 2, potential=k * r**2)[0] == "Jacobi integral"
    x1, x2, y1, y2 = lg.coordinates("x1 x2 y1 y2")
    chained = names(kinetic=x1.dot**2 + 2 * x2.dot**2, potential=(x1 - x2) ** 2)
    assert chained == ["energy", "momentum x"]
    bound = names(kinetic=T((x1, y1)) + T((x2, y2)), potential=(x1 - x2) ** 2 + (y1 - y2) ** 2)
    assert {"momentum x", "momentum y", "angular momentum z"} <= {*bound}
    assert names(coordinates=[u, w], kinetic=T((u, w)), potential=(u - w) ** 2) == ["energy", "momentum of u and w"]


def test_an_energy_has_a_positive_kinetic_part_and_p_is_a_conjugate_momentum() -> None:
    dropped = {item.name: item for item in lg.System(m * x.dot**2 / 2, 0, forces={x: -m * g}).conserved()}
    assert dropped["energy"].expression == m * x.dot**2 / 2 + g * m * x
    assert dropped["energy"].reason.startswith("The symmetry delta t = 1 changes")
    assert dropped["momentum x"].expression == m * x.dot + g * m * lg.t
    for potential, canonical in ((-c * x * y.dot, ["p_y"]), (c * (y * x.dot - x * y.dot) / 2, [])):
        charge = lg.System(T(FLAT), potential)
        result = {item.name: item.expression for item in charge.conserved()}
        assert [name for name in result if name.startswith("p_")] == canonical
        assert result["momentum x"] == m * x.dot - c * y and result["energy"] == T(FLAT).expand()


def test_the_jacobi_integral_is_named_with_and_without_a_potential() -> None:
    turning = m * ((x.dot - omega * y) ** 2 + (y.dot + omega * x) ** 2) / 2
    hoop = m * (phi.dot**2 + omega**2 * sin(phi) ** 2) / 2
    for kinetic, potential in ((turning, 0), (turning, k * x**2), (hoop, m * g * cos(phi))):
        assert names(kinetic=kinetic, potential=potential)[0] == "Jacobi integral"
    assert names(lagrangian=T(FLAT) - c * x * y.dot)[0] == "energy"
    # A charge in a field: terms of first degree beside a potential, without those of a turning frame.
    assert names(kinetic=T(FLAT) + c * (x * y.dot - y * x.dot), potential=k * x**2)[0] == "energy"
    assert names(lagrangian=T(FLAT) + c * (x * y.dot - y * x.dot) - k * x**2)[0] == "energy"
    assert names(lagrangian=turning - k * x**2)[0] == "Jacobi integral"
    assert names(lagrangian=m * (r.dot**2 + r**2 * (phi.dot + omega) ** 2) / 2 - k / r)[0] == "Jacobi integral"
    assert names(lagrangian=-m * c**2 * sqrt(1 - x.dot**2 / c**2) - k * x**2)[0] == "energy"


@pytest.mark.parametrize(
    "statement",
    [
        {"kinetic": T(FLAT), "potential": k * x**2 * y**2 + k * x**4, "dissipation": c * (x.dot**2 + y.dot**2)},
        {"kinetic": T(FLAT), "potential": k * x**2 * y**2 * (1 + cos(omega * lg.t))},
        {"kinetic": T(FLAT), "forces": {x: -k * x + c * y, y: -k * y - c * x}},
        {"kinetic": POLAR_T, "potential": k * r, "forces": {phi: -c * phi.dot**3}},
    ],
)
def test_nothing_is_claimed_where_nothing_is_conserved(statement: dict[str, Any]) -> None:
    assert lg.System(**statement).conserved() == []


def test_a_knife_edge_keeps_what_its_blade_allows() -> None:
    # The momenta along x and y change: the blade holds. Its turn is free, and so is the energy.
    theta = lg.coordinate("theta")
    sleigh = lg.System(T(FLAT) + m * theta.dot**2 / 2, constraints={"blade": x.dot * sin(theta) - y.dot * cos(theta)})
    assert [item.name for item in sleigh.conserved()] == ["energy", "p_theta"]


def test_a_false_proof_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.mechanics.symmetries.is_identity", lambda algebra, terms: True)
    monkeypatch.setattr(SymmetryEquation, "completed", lambda self, symmetry: symmetry)
    with pytest.raises(lg.RunError, match=r"is proven to be conserved, but changes at the rate .* fault of lagrange"):
        lg.System(T(FLAT), k * x**4 * y**2).conserved()


def test_coupled_coordinates_are_compared_with_no_body(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[Any] = []
    monkeypatch.setattr("lagrange.mechanics.symmetries._rest", lambda *arguments: tried.append(arguments))
    assert [item.name for item in lg.scene("double-pendulum").conserved()] == ["energy"]
    assert not tried


def test_terms_linear_in_velocities_leave_the_names_of_momenta() -> None:
    # A free top with p_psi held is a body on a sphere with a gyroscopic term, as of a magnetic charge.
    theta, phi, psi = lg.coordinates("theta phi psi")
    inertia, axial = lg.parameters("inertia axial")
    kinetic = inertia * (theta.dot**2 + (phi.dot * sin(theta)) ** 2) / 2
    top = lg.System(
        kinetic + axial * (psi.dot + phi.dot * cos(theta)) ** 2 / 2,
        coordinates=[theta, phi, psi],
    ).routhian(psi)
    assert [item.name for item in top.conserved()] == ["energy", "p_phi", "angular momentum x", "angular momentum y"]
    flat = lg.System(m * (r.dot**2 + r**2 * phi.dot**2) / 2 + g * r**2 * phi.dot, coordinates=[r, phi], initial={r: 1})
    assert [item.name for item in flat.conserved()] == ["energy", "p_phi", "momentum x", "momentum y"]


# --- The quantity of a symmetry that is given, and what is said of one that is none ---


KEPLER = lg.System(T(FLAT), -k / sqrt(x**2 + y**2), name="kepler")


def same(result: Any, expected: Any) -> bool:
    return bool(sympy.simplify(result - expected) == 0)


@pytest.mark.parametrize(
    ("statement", "generator", "expected"),
    [
        ({"kinetic": T(FLAT), "potential": m * g * y}, {y: 1}, m * y.dot + m * g * lg.t),
        ({"lagrangian": T(FLAT) + B * x * y.dot}, {x: -y, y: x}, m * (x * y.dot - y * x.dot) + B * (x**2 + y**2) / 2),
        ({"kinetic": T((x,)), "dissipation": c * x.dot**2 / 2}, {x: 1}, m * x.dot + c * x),
        ({"lagrangian": T((x,)) + exp(x) * cos(x) * x.dot}, {x: 1}, m * x.dot),
        ({"kinetic": T(FLAT), "potential": m * g * y, "constraints": {"rod": x**2 + y**2 - 1}}, {lg.t: 1}, None),
    ],
)
def test_total_derivatives_forces_and_constraints(statement: Any, generator: Any, expected: Any) -> None:
    system = lg.System(**statement)
    result = system.noether(generator)
    if expected is None:
        expected = -system.energy
    # Additive constants are arbitrary.
    assert same(sympy.diff(result - expected, lg.t), 0)


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
    with pytest.raises(StatementError, match="it could not be proven that this is a symmetry of hidden: neither a"):
        hidden.noether({x: 1})


@pytest.mark.parametrize(
    ("generator", "told"),
    [
        (5, "noether takes a dict from coordinates to how they move, as {x: -y, y: x}, not 5"),
        ({}, "noether takes a dict"),
        ({"u": 1}, "'u' is neither t nor a coordinate of this system; they are x and y"),
        ({x: y.dot}, "the motion of x is .*: give an expression in coordinates, parameters and t"),
        ({lg.t: x}, "the motion of t is .*: give an expression in parameters alone"),
        ({x: z}, r"the motion of x contains z\(t\), which this system does not have; it has x\(t\), y\(t\)"),
    ],
)
def test_generators_that_are_refused(generator: Any, told: str) -> None:
    with pytest.raises(StatementError, match=told):
        KEPLER.noether(generator)


def test_decimals_in_a_generator_are_fractions() -> None:
    assert same(KEPLER.noether({x: -0.1 * y, y: 0.1 * x}), m * (x * y.dot - y * x.dot) / 10)
