"""Statements on the conservation of energy and momenta are right for all formulations of a system."""

from __future__ import annotations

from typing import Any

import pytest
from sympy import Abs, Max, Piecewise, Rational, cos, cosh, exp, sign, sin, sinh, sqrt, tan

import lagrange as lg
from lagrange.equations import decisions
from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.equations.structure import Structure
from lagrange.statement.coordinate import t
from tests.models import c, g, k, l, m, omega, phi, r, stated, theta, x, y

psi = lg.coordinate("psi")
ON_SPHERE = (l * sin(theta) * cos(phi), l * sin(theta) * sin(phi), -l * cos(theta))
ON_HOOP = (l * sin(theta) * cos(omega * t), l * sin(theta) * sin(omega * t), -l * cos(theta))
IN_PLANE = (r * cos(phi), r * sin(phi))
ON_CONE = (*IN_PLANE, r / tan(c))
BODY_RATES = (
    phi.dot * sin(theta) * sin(psi) + theta.dot * cos(psi),
    phi.dot * sin(theta) * cos(psi) - theta.dot * sin(psi),
    phi.dot * cos(theta) + psi.dot,
)
FREE = {"kinetic": m * (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y]}
ROD = {**FREE, "constraints": {"rod": x**2 + y**2 - 1}}


def laws(**parts: Any) -> Equations:
    return euler_lagrange(stated(**parts))


def found(**parts: Any) -> Structure:
    return laws(**parts).structure


def moving(position: Any, potential: Any) -> dict[str, Any]:
    return {"kinetic": lg.kinetic_energy(m, position), "potential": potential}


STATED_BY_POSITIONS = {
    "sphere": (moving(ON_SPHERE, m * g * ON_SPHERE[2]), "phi"),
    "hoop": (moving(ON_HOOP, m * g * ON_HOOP[2]), ""),
    "central force": (moving(IN_PLANE, -k / sqrt(IN_PLANE[0] ** 2 + IN_PLANE[1] ** 2)), "phi"),
    "cone": (moving(ON_CONE, m * g * ON_CONE[2]), "phi"),
    "top": ({"kinetic": lg.rotational_energy((k, k, c), BODY_RATES), "potential": m * g * l * cos(theta)}, "phi psi"),
    "hyperbola": ({"kinetic": m * y.dot**2 * (cosh(x) ** 2 - sinh(x) ** 2) + m * x.dot**2, "potential": k * x}, "y"),
    "half angles": ({"kinetic": m * x.dot**2 * (cos(phi) - 2 * cos(phi / 2) ** 2 + 2) + m * phi.dot**2}, "phi x"),
}


@pytest.mark.parametrize("name", STATED_BY_POSITIONS)
def test_what_cancels_is_not_there(name: str) -> None:
    parts, ignorable = STATED_BY_POSITIONS[name]
    structure = found(**parts)
    assert structure.conservative and structure.decisions.timeless is True
    assert sorted(structure.names[i] for i in structure.cyclic) == ignorable.split()
    told = " ".join(structure.sentences())
    turning = "Jacobi integral v.p - L is conserved (T + V is not this integral)."
    kept = turning if name == "hoop" else "energy is conserved."
    assert f"no force acts besides the potential: the {kept}" in told
    assert all(f"{item} d" in told for item in ignorable.split()) and "not conserved" not in told


def test_an_integral_that_is_not_the_sum_of_the_energies_is_named() -> None:
    turning = m * ((x.dot - c * y) ** 2 + (y.dot + c * x) ** 2) / 2
    assert found(kinetic=turning).sentences()[2].endswith("the Jacobi integral v.p - L is conserved.")
    mixed = found(kinetic=turning, potential=k * x**2)
    assert mixed.sentences()[2].endswith("the Jacobi integral v.p - L is conserved (T + V is not this integral).")
    # Homogeneous once its angles have cancelled, and not with its expressions as they stand.
    hidden = m * x.dot**2 + k * (sin(x) ** 2 + cos(x) ** 2 - 1)
    assert found(kinetic=hidden, potential=k * x**2).sentences()[2].endswith(": the energy is conserved.")


def test_forces_that_do_no_work_keep_the_energy() -> None:
    turned = found(**FREE, forces={x: k * y.dot, y: -k * x.dot})
    assert turned.conservative
    assert "the forces besides the potential do no work: the energy is conserved." in turned.sentences()[2]
    paid = found(**FREE, potential=t * k * x, forces={x: -k * x / x.dot})
    assert paid.sentences()[2] == (
        "The forces besides the potential do the work that explicit time takes: the energy is conserved."
    )
    assert found(**FREE, dissipation=c * x.dot).energy_kept is False


@pytest.mark.parametrize(
    ("parts", "verdict", "told"),
    [
        ({**ROD, "forces": {x: -c * x.dot}}, False, "is not conserved: forces or dissipation act."),
        ({**ROD, "forces": {x: c * x, y: c * y}}, None, "was not found to be conserved: forces or dissipation act."),
        ({**ROD, "potential": t * (x**2 + y**2 - 1)}, None, "not found to be conserved: the Lagrangian depends on tim"),
        ({**FREE, "constraints": {"wall": x - sin(t)}}, None, "not found to be conserved: constraints that depend on"),
        ({**FREE, "potential": k * x * cos(t)}, False, "is not conserved: the Lagrangian depends on time."),
    ],
)
def test_nothing_is_denied_that_may_hold(parts: dict[str, Any], verdict: bool | None, told: str) -> None:
    structure = found(**parts)
    assert structure.energy_kept is verdict and not structure.conservative
    assert any(told in sentence for sentence in structure.sentences())


def test_methods_that_split_take_what_separates_however_it_is_stated() -> None:
    hoop = lg.System(**STATED_BY_POSITIONS["hoop"][0], parameters={m: 1, l: 1, g: 9.81, omega: 2}, initial={theta: 0.5})
    exact, split = hoop.run(1.0, rtol=1e-12).final, hoop.run(1.0, method="yoshida6", step=0.005).final
    assert split["theta"] == pytest.approx(exact["theta"], abs=1e-9)
    assert not hoop.laws.structure.position_only and hoop.laws.structure.decisions.position_only is True
    # The derivative of sign(v) is zero on either side: dry friction depends on velocities all the same.
    for dry in ({"dissipation": k * Abs(x.dot)}, {"forces": {x: -k * sign(x.dot)}}):
        assert found(kinetic=m * x.dot**2, **dry).decisions.position_only is None
    assert found(kinetic=m * x.dot**2, dissipation=k * x.dot**2).decisions.position_only is False


def test_a_jump_is_no_constant() -> None:
    step = Piecewise((1, phi < 1000), (2, True))
    assert found(kinetic=m * (x.dot**2 + phi.dot**2), potential=k * step, coordinates=[x, phi]).cyclic == (0,)
    heavy = found(kinetic=m * x.dot**2 * Max(1, x - 1000)).sentences()
    assert heavy[0] == "The mass matrix is diagonal." and heavy[1].startswith("Nothing depends on time")


def test_what_is_absent_needs_no_decision(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whether a run is held to its energy is asked of every model: a chain of links must not pay for it.
    monkeypatch.setattr(decisions, "values", None)
    structure = laws(kinetic=lg.kinetic_energy(m, (x, y)), potential=k * x * y, coordinates=[x, y]).structure
    assert structure.conservative and structure.decisions.timeless and structure.separable and structure.constant_mass


EARTH = cos(Rational(729, 10**7) * t) + sin(Rational(1991, 10**10) * t)
"""Two periods that are whole multiples of one part only in the thousands: its cosine is a polynomial of that degree."""


def test_a_proof_has_a_bound_of_work() -> None:
    # The power of these forces disappears in 50 digits beside cos(x), so that only algebra could decide.
    structure = found(kinetic=x.dot**2 / 2, potential=cos(x) + x * EARTH / 10**26, coordinates=[x])
    assert structure.energy_kept is None
    assert found(kinetic=x.dot**2 / 2, potential=x * EARTH, coordinates=[x]).energy_kept is False
    # Samples have the size of the lengths in the formula, here 1e11.
    far = -(10**20) / sqrt(x**2 + 10**22) + x * EARTH
    assert found(kinetic=x.dot**2 / 2, potential=far, coordinates=[x]).energy_kept is False
    twelve = sin(12 * t) - 2 * sin(6 * t) * cos(6 * t)
    assert found(kinetic=x.dot**2 / 2, potential=x * twelve, coordinates=[x]).energy_kept


def test_a_run_that_keeps_its_energy_asks_for_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decisions, "StatedAlgebra", None)
    system = lg.System(x.dot**2 / 2, cos(x) + x * EARTH / 10**26)
    assert system.run(1.0, {x: 1.0}, target="numpy").status is lg.Status.SUCCESS


def test_numbers_beyond_doubles_have_no_value() -> None:
    # The cosine of such a number takes as many digits of pi as the number has in front of the point.
    assert found(kinetic=x.dot**2 / 2, potential=cos(exp(exp(x + 60)) * t), coordinates=[x]).energy_kept is None


def test_card_and_plot_say_what_was_found() -> None:
    wall = lg.System(**FREE, constraints={"wall": x - sin(t)}, parameters={m: 1}, initial={x.dot: 1.0})
    run = wall.run(1.0)
    assert "(not found to be conserved)" in repr(run) and run.card()["energy"]["conserved"] is None
    assert run.plot().axes[2].get_title(loc="left") == "energy (not found to be conserved)"
