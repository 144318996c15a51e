"""Conserved quantities in any statement of a system, and Hamilton's form.

The ways are: by positions, expanded by hand, and in other coordinates.
"""

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import S, cos, exp, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import hamilton
from lagrange.mechanics.hamilton import Hamiltonian, Legendre, legendre
from lagrange.mechanics.symmetries import SymmetryEquation
from lagrange.statement.coordinate import t
from tests.refusals import refusal

x, y, z, u, w = lg.coordinates("x y z u w")
r, rho, theta, phi, psi = lg.coordinates("r rho theta phi psi")
x1, y1, x2, y2, X, Y = lg.coordinates("x1 y1 x2 y2 X Y")
m, m1, m2, k, g, l, B, A, C, c, omega = lg.parameters("m m1 m2 k g l B A C c omega")

Point = tuple[Any, ...]
Statement = dict[str, Any]


def T(place: Point) -> Any:
    return lg.kinetic_energy(m, place)


def body(place: Point, potential: Any = S.Zero, **more: Any) -> Statement:
    """Return a body of mass m, stated by its position."""
    return {"kinetic": T(place), "potential": potential, **more}


def expanded(kinetic: Any, potential: Any, **more: Any) -> Statement:
    return {"kinetic": kinetic, "potential": potential, **more}


def size(place: Point) -> Any:
    return sqrt(sum(entry**2 for entry in place))


def pair(one: Point, other: Point) -> Any:
    return lg.kinetic_energy(m1, one) + lg.kinetic_energy(m2, other)


POLAR, SPHERE = (r * cos(phi), r * sin(phi)), (sin(theta) * cos(phi), sin(theta) * sin(phi), -cos(theta))
BALL = tuple(r * entry for entry in SPHERE)
FLAT, SPACE = (x, y), (x, y, z)
POLAR_T = m * (r.dot**2 + r**2 * phi.dot**2) / 2
ON_BALL = tuple(l * entry for entry in SPHERE)
TILTED = ((u + w) / sqrt(2), (u - w) / sqrt(2))
TOP = A * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2 + C * (psi.dot + phi.dot * cos(theta)) ** 2 / 2
REDUCED = m1 * m2 / (m1 + m2)
ORBITS = (
    (X - m2 * r * cos(phi) / (m1 + m2), Y - m2 * r * sin(phi) / (m1 + m2)),
    (X + m1 * r * cos(phi) / (m1 + m2), Y + m1 * r * sin(phi) / (m1 + m2)),
)
ROTATED = (x * cos(omega * t) - y * sin(omega * t), x * sin(omega * t) + y * cos(omega * t))
ELLIPSE = k * (x * cos(omega * t) + y * sin(omega * t)) ** 2
FIELD = B * (POLAR[0] * sympy.diff(POLAR[1], t) - POLAR[1] * sympy.diff(POLAR[0], t)) / 2

WAYS: dict[str, tuple[Statement, int]] = {
    # energy and angular momentum about the vertical
    "spherical pendulum by positions": (body(ON_BALL, m * g * ON_BALL[2]), 2),
    "spherical pendulum on a rod": (body(SPACE, m * g * z, constraints={"rod": x**2 + y**2 + z**2 - l**2}), 2),
    # energy, angular momentum, and the Runge-Lenz vector
    "Kepler on spheres": (body(BALL, -k / size(BALL)), 7),
    "Kepler on cylinders": (
        expanded(m * (rho.dot**2 + rho**2 * phi.dot**2 + z.dot**2) / 2, -k / sqrt(rho**2 + z**2)),
        7,
    ),
    "Kepler": (body(SPACE, -k / size(SPACE)), 7),
    # energy, and the momenta of which one grows with time
    "thrown body in tilted axes": (body(TILTED, m * g * TILTED[1]), 3),
    "thrown body in polar coordinates": (expanded(POLAR_T, m * g * r * sin(phi)), 3),
    # energy and two momenta
    "heavy top": (expanded(TOP, m * g * l * cos(theta)), 3),
    "heavy top in half angles": (expanded(sympy.expand(TOP), m * g * l * (1 - 2 * sin(theta / 2) ** 2)), 3),
    # energy, momentum, and angular momenta of the whole and about the centre
    "two bodies by positions": ({"kinetic": pair(*ORBITS), "potential": -k / r}, 5),
    "two bodies about their centre": (
        expanded((m1 + m2) * (X.dot**2 + Y.dot**2) / 2 + REDUCED * (r.dot**2 + r**2 * phi.dot**2) / 2, -k / r),
        5,
    ),
    "two bodies": (expanded(pair((x1, y1), (x2, y2)), -k / size((x1 - x2, y1 - y2))), 4),
    # energy, the two momenta of the centre of the circle, and the angular momentum
    "charge in a field by positions": ({"lagrangian": T(POLAR) + FIELD}, 4),
    "charge in a field": ({"lagrangian": T(FLAT) + B * x * y.dot}, 4),
    # the Jacobi integral, which only the turning axes show
    "turning potential": (body(FLAT, ELLIPSE), 0),
    "turning potential in polar coordinates": (expanded(POLAR_T, k * r**2 * cos(phi - omega * t) ** 2), 0),
    "turning potential in its axes": (body(ROTATED, k * x**2), 1),
    # momenta with the impulse of the drag
    "body in a drag, by dissipation": (body(TILTED, dissipation=c * (u.dot**2 + w.dot**2) / 2), 2),
    "body in a drag, by forces": (body(FLAT, forces={x: -c * x.dot, y: -c * y.dot}), 2),
}
"""Statements, and how many quantities are conserved."""


# --- conserved quantities are found in any statement of a system, and no wrong ones are reported ---------------


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
        kinetic + axial * (psi.dot + phi.dot * cos(theta)) ** 2 / 2, coordinates=[theta, phi, psi]
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
    told = refusal(KEPLER.noether, {x: 1})
    assert told.startswith(
        "this is not a symmetry of kepler: its quantity m*x_dot changes at the rate -k*x/(x**2 + y**2)**(3/2), which "
    )
    assert " at x = " in told and "m = " in told
    held = lg.System(T((x, y, z)), m * g * z, constraints={"wire": y - x**2}, name="wire")
    with pytest.raises(StatementError, match=r"changes at the rate .* It does not keep the constraint wire\.$"):
        held.noether({x: -y, y: x})
    driven = lg.System(T(FLAT), constraints={"wall": x - sin(lg.t)}, name="wall")
    assert "not a symmetry of wall" in refusal(driven.noether, {lg.t: 1})


def test_what_cannot_be_proven_is_not_claimed() -> None:
    hidden = lg.System(m * x.dot**2 / 2, sympy.Piecewise((1, x < 1000), (2, True)), name="hidden")
    assert "it could not be proven that this is a symmetry of hidden: neither a" in refusal(hidden.noether, {x: 1})


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


# --- hamilton's form: the same motion, brackets that obey their laws, and refusals of degenerate Lagrangians ---


MANY: Any = lg.coordinates("q1 q2 q3 q4 q5")


def wagon() -> lg.System:
    """Return a system with coupled inertia, friction, a force in velocities and time, and a linear term in L."""
    return lg.System(
        kinetic=m * (x.dot**2 + l**2 * theta.dot**2 + 2 * l * x.dot * theta.dot * cos(theta)) / 2 + x.dot**2,
        potential=-m * g * l * cos(theta) - B * theta * x.dot,
        coordinates=[x, theta],
        forces={x: sin(lg.t) - k * theta.dot},
        dissipation=c * theta.dot**2 / 2,
        parameters={m: 1.2, l: 0.7, g: 9.81, k: 0.3, c: 0.1, B: 0.5},
        initial={theta: 1.0, x.dot: 0.4},
        positions={"bob": (x + l * sin(theta), -l * cos(theta))},
    )


@cache
def wagons_form() -> Hamiltonian:
    return wagon().hamiltonian()


@pytest.mark.slow
def test_both_forms_run_alike() -> None:
    system, form = wagon(), wagons_form()
    first, second = system.run(3.0, rtol=1e-12), form.run(3.0, rtol=1e-12)
    # Both err by some 1e-12 a step, and friction lets no error grow.
    for key in (x, theta, theta.dot):
        assert second[key][-1] == pytest.approx(first[key][-1], abs=1e-10)
    momenta = system.compile().momenta(first.y[:2, -1], first.y[2:, -1])
    result = [second[p][-1] for p in form.momenta.values()]
    assert result == pytest.approx(momenta, abs=1e-10)


def test_hamiltons_equations_are_those_of_the_book() -> None:
    # Goldstein, Classical Mechanics, 3rd ed., section 8.1: a pendulum.
    system = lg.System(m * l**2 * theta.dot**2 / 2, -m * g * l * cos(theta), dissipation=c * theta.dot**2 / 2)
    form = system.hamiltonian()
    p = form.momenta[theta]
    assert p == lg.coordinate("p_theta")
    assert sympy.expand(form.expression - (p**2 / (2 * m * l**2) - m * g * l * cos(theta))) == 0
    rate, force = form.equations()
    assert rate == sympy.Eq(theta.dot, p / (m * l**2))
    assert force.lhs == p.dot
    assert sympy.expand(force.rhs + m * g * l * sin(theta) + c * p / (m * l**2)) == 0
    assert form.velocities == {theta: p / (m * l**2)}


def test_a_relativistic_particle_among_charges_keeps_their_potential_as_it_is_stated() -> None:
    """Only the roots of the kinetic energy are put over one denominator, not those of five distances."""
    (m, c, *charges), x = lg.parameters("m c k0 k1 k2 k3 k4"), lg.coordinate("x")
    potential = sum(k / sqrt(1 + (x - i) ** 2) for i, k in enumerate(charges))
    system = lg.System(lagrangian=-m * c**2 * sqrt(1 - x.dot**2 / c**2) - potential)
    hamiltonian = system.hamiltonian()
    (p,) = hamiltonian.momenta.values()
    assert hamiltonian.expression == potential + sqrt(c**4 * m**2 + c**2 * p**2)


@pytest.mark.slow
def test_a_momentum_that_is_solved_for_takes_the_branch_of_the_motion() -> None:
    form = lg.System(lagrangian=-sqrt(1 - x.dot**2) - x**2).hamiltonian()
    p = form.momenta[x]
    assert sympy.simplify(form.expression - sqrt(1 + p**2) - x**2) == 0
    cubic = lg.System(lagrangian=x.dot**2 / 2 + x.dot**4 / 4, parameters={}).hamiltonian()
    v = cubic.velocities[x]
    assert sympy.re((v + v**3).subs(cubic.momenta[x], 2).evalf(20)) == pytest.approx(2.0, rel=1e-12)
    with pytest.raises(StatementError, match=r"the momenta of system cannot be solved for the velocities of x and y"):
        lg.System(lagrangian=(x.dot**2 + y.dot**2 + x.dot * y.dot**3) / 2 + x.dot**4 - x * y).hamiltonian()


def test_brackets() -> None:
    """Angular momenta of a free particle: {Lx, Ly} = Lz, and Jacobi's identity with H and a velocity."""
    form = lg.System(m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, k * x * y * z, coordinates=[x, y, z]).hamiltonian()
    p, q, r = (form.momenta[item] for item in (x, y, z))
    lx, ly, lz = y * r - z * q, z * p - x * r, x * q - y * p
    assert form.poisson(x, p) == 1
    assert sympy.expand(form.poisson(lx, ly) - lz) == 0
    assert form.poisson(x, form.expression) == p / m
    assert form.poisson(x, x.dot) == 1 / m
    cyclic = [(lx, lz, form.expression), (lz, form.expression, lx), (form.expression, lx, lz)]
    assert sympy.expand(sum(form.poisson(a, form.poisson(b, d)) for a, b, d in cyclic)) == 0


def test_names_that_are_taken_are_left_alone() -> None:
    p_x = lg.parameters("p_x")
    form = lg.System(x.dot**2 / 2, p_x * x**2).hamiltonian()
    assert form.momenta[x] == lg.coordinate("p_x_")


@pytest.mark.slow
def test_it_pickles_and_keeps_what_is_drawn() -> None:
    form = wagons_form()
    again = pickle.loads(pickle.dumps(form))
    assert again.expression == form.expression
    assert again.system.statement.positions == wagon().statement.positions
    assert repr(form).startswith("<Hamiltonian: ")
    model = again.compile("numpy")
    assert np.isfinite(model.rhs(0.0, model.as_scipy().y0())).all()


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (
            lambda: lg.System(lagrangian=x * y.dot - y * x.dot - x**2 - y**2, coordinates=[x, y]),
            "the Lagrangian of system has no Legendre transform: d2L/dx_dot2 = 0, so that x_dot does not follow from "
            "its momentum. Run it as it is stated, or use fewer coordinates.",
        ),
        (
            lambda: lg.System((x.dot + y.dot) ** 2 / 2, x * y, constraints={"tie": x - 2 * y}),
            "system has constraints (tie), and Hamilton's equations have no constraint forces: eliminate(...) makes a",
        ),
        (
            lambda: lg.System(sum(a.dot * b.dot for a in MANY for b in MANY) + sum(a.dot**2 for a in MANY)),
            "system is too large for its velocities to be written out in momenta: ",
        ),
    ],
)
def test_refusals(system: Any, words: str) -> None:
    assert refusal(system().hamiltonian).startswith(words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (z, "the second function contains z(t), which this system does not have: its coordinates and momenta are x, t"),
        ("x", "the second function is the text 'x': give a SymPy expression"),
        (lg.coordinate("p_x").dot, "the second function contains Derivative(p_x(t), t): give coordinates and momenta"),
    ],
)
def test_brackets_refuse_what_is_not_there(given: Any, words: str) -> None:
    assert refusal(wagons_form().poisson, x, given).startswith(words)


def test_a_wrong_hamiltonian_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(form: Any, symbols: Any) -> Legendre:
        right = legendre(form, symbols)
        return Legendre(right.symbols, right.velocities, right.hamiltonian + form.q[0] / 1000)

    monkeypatch.setattr(hamilton, "legendre", wrong)
    with pytest.raises(RunError, match=r"the Hamiltonian of system is wrong: a formula gives .* is compiled, at x = "):
        wagon().hamiltonian()
