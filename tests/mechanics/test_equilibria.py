"""Equilibria in symbols and by number, steady rotations, and analyses with given functions."""

import pickle
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Function, Heaviside, Rational, acos, cos, cosh, diag, exp, pi, sign, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import equilibria as equilibria_module
from lagrange.mechanics.plain_form import PlainForm
from lagrange.mechanics.roots import solved
from lagrange.mechanics.stability import has_energy
from tests.models import shared_scene
from tests.refusals import refusal
from tests.systems import conical_pendulum

m, g, l, k, c, w, R, a = lg.parameters("m g l k c w R a")
u = lg.parameters("u", positive=False)
x, y, z, theta, phi, r = lg.coordinates("x y z theta phi r")


def hoop(**values: float) -> lg.System:
    kinetic = m * R**2 * (theta.dot**2 + w**2 * sin(theta) ** 2) / 2
    return lg.System(kinetic, -m * g * R * cos(theta), parameters=values, initial={theta: 0.3}, name="hoop")


def test_a_bead_on_a_hoop_has_four_and_knows_when() -> None:
    result = hoop(m=1, g=9.81, R=1, w=5).equilibria()
    side, second, bottom, top = result
    assert side.coordinates == {theta: acos(g / (R * w**2))}
    assert second.coordinates == {theta: -acos(g / (R * w**2))}
    assert side.condition == sympy.Le(g / (R * w**2), 1)
    assert (bottom.coordinates, top.coordinates) == ({theta: 0}, {theta: pi})
    assert [first.stable for first in result] == [True, True, False, False]
    assert sympy.simplify(side.energy + m * (R**2 * w**2 + g**2 / w**2) / 2) == 0
    assert sympy.simplify(bottom.criterion[0] - m * R * (g - R * w**2)) == 0
    slow = hoop(m=1, g=9.81, R=1, w=2).equilibria()
    assert [(first.stable, first.exists) for first in slow] == [
        (True, True),
        (False, True),
        (None, False),
        (None, False),
    ]
    free = hoop().equilibria()
    assert [(first.stable, first.exists) for first in free] == [(None, True), (False, True), (None, None), (None, None)]
    assert repr(side) == "<Equilibrium: theta(t) = acos(g/(R*w**2)); stable, where g/(R*w**2) <= 1>"
    assert pickle.loads(pickle.dumps(side)).coordinates == side.coordinates


@pytest.mark.slow
def test_steady_motions_of_ignorable_coordinates() -> None:
    # A conical pendulum: cos(theta) = g/(l w^2).
    pendulum = conical_pendulum(parameters={m: 1, g: 9.81, l: 1, w: 5})
    cone = next(item for item in pendulum.equilibria({phi: w}) if item.stable)
    assert cone.coordinates == {theta: acos(g / (l * w**2)), phi: phi}
    assert cone.velocities == {phi.dot: w}
    assert sympy.simplify(cone.criterion[0] - m * (l**2 * w**4 + 3 * g**2) / w**2) == 0  # at a fixed momentum of phi
    assert cone.at == {theta: acos(g / (l * w**2)), phi.dot: w}
    poles = [item for item in pendulum.equilibria({"phi": w}) if item.coordinates[theta] in (0, pi)]
    assert [item.reason for item in poles] == [
        "the mass matrix is singular there: choose coordinates that are regular there."
    ] * 2
    assert "the mass matrix of system is singular at this point: state the modes" in refusal(pendulum.modes, {theta: 0})


SYSTEMS = {
    "two wells": lg.System(m * x.dot**2 / 2, k * (x**4 / 4 - c * x**2 / 2), parameters={m: 1, k: 2, c: 3}),
    "two pendulums": lg.System(
        m * (theta.dot**2 + phi.dot**2 + theta.dot * phi.dot * cos(theta - phi)) / 2,
        -g * cos(theta) - k * cos(phi),
        coordinates=[theta, phi],
        parameters={m: 1, g: 3, k: 2},
    ),
    "a magnet": lg.System(
        m * theta.dot**2 / 2, -g * cos(theta) - k * sin(theta), parameters={m: 1, g: 3, k: 2}, initial={theta: 0.1}
    ),
    "on a circle": lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        g * y + k * x,
        constraints={"rod": x**2 + y**2 - l**2},
        coordinates=[x, y],
        parameters={m: 1, g: 3, k: 2, l: 2},
        initial={x: 2.0},
    ),
    "a cubic": lg.System(
        (x.dot**2 + y.dot**2) / 2, (x**2 + y**2) / 2 + x**2 * y - y**3 / 3, coordinates=[x, y], parameters={}
    ),
}


@pytest.mark.few
@pytest.mark.parametrize("name", SYSTEMS)
def test_symbols_and_search_find_the_same(name: str) -> None:
    system = SYSTEMS[name]
    result = system.equilibria()
    assert all(item.exact for item in result)
    values = system.parameters
    exact = sorted(
        tuple(round(float(sympy.N(q.subs(values))), 6) + 0.0 for q in item.coordinates.values())
        for item in result
        if item.exists
    )
    problem = equilibria_module._Problem(PlainForm(system.statement), (), None)
    ends = problem.searched()
    searched = sorted(tuple(round(float(end[q]), 6) + 0.0 for q in problem.unknowns) for end in ends)
    np.testing.assert_allclose(exact, searched, atol=2e-6)
    for item in result:
        point = [float(sympy.N(q.subs(values))) for q in item.coordinates.values()] if item.exists else []
        if point:
            a0 = system.compile("numpy").accelerations(point, [0.0] * len(point))
            # Forces of order 1 that cancel, in doubles.
            assert np.abs(a0).max() < 1e-13


def test_coordinates_at_which_forces_are_infinite_are_none() -> None:
    assert "kepler has no equilibrium: the forces on x and y a" in refusal(lambda: shared_scene("kepler").equilibria())


T = m * x.dot**2 / 2
EDGE: dict[str, Any] = {"constraints": {"edge": y.dot * cos(theta) - x.dot * sin(theta)}}


@pytest.mark.parametrize(
    ("system", "rates", "words"),
    [
        (lambda: lg.System(T, m * g * x), None, "system has no equilibrium: the forces on x at rest, solved in symbol"),
        (lambda: lg.System(T, k * exp(x), parameters={m: 1, k: 1}), None, "no equilibrium of system was found: the"),
        (lambda: lg.System(T, k * cosh(x) - c * x**2), None, "the equilibria of system are not found in symbols, and"),
        (lambda: lg.System(x.dot**2 + y.dot**2 + theta.dot**2, **EDGE), None, "system has constraints on velocities"),
        (hoop, {theta: 1}, "the argument rates has a steady velocity of theta, but energies or constraints depend on"),
        (
            lambda: lg.System(T, forces={x: k}, dissipation=c * x.dot**2 / 2),
            {x.dot: 1},
            "the argument rates has a steady velocity of x, but energies or constraints depend on x, or a force acts "
            "along it, so its momentum may change: linearize({x.dot: w}) tells whether the rate w is steady.",
        ),
        (hoop, {theta: 1, theta.dot: 1}, "rates has theta twice, by its symbol and by its name"),
        (hoop, [1], "rates is a list: give a dict from ignorable coordinate to velocity."),
    ],
)
def test_refusals(system: Any, rates: Any, words: str) -> None:
    message = refusal(system().equilibria, rates)
    assert message.startswith(words)
    assert ("Contact forces are left out: state the closed ones of 'floor' as" in message) == ("bouncing" in words)


def test_a_motor_has_a_steady_motion_in_place_of_an_equilibrium() -> None:
    """J phi'' = k i - c phi', i' = u - R i - k phi': both rates vanish at the speed k u/(R c + k^2)."""
    current = lg.coordinate("i")
    resistance, voltage = lg.parameters("R u")
    motor = lg.System(
        m * phi.dot**2 / 2,
        forces={phi: k * current - c * phi.dot, current: voltage - resistance * current - k * phi.dot},
        dissipation=current.dot**2 / 2,
    )
    speed = k * voltage / (c * resistance + k**2)
    message = refusal(motor.equilibria)
    assert f"linearize({{phi.dot: {speed}, i: " in message and message.endswith("is about a steady motion.")
    lin = motor.linearize({phi.dot: speed, current: c * speed / k})
    assert lin.equilibrium and lin.note == "About a steady motion."
    assert refusal(motor.linearize, {phi.dot: 2 * speed}).startswith("this point is not an equilibrium of system")


def test_a_wrong_equilibrium_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(equations: Any, unknowns: Any) -> list[dict[Any, Any]]:
        right = solved(equations, unknowns) or []
        return [{q: x + sympy.Rational(1, 10**6) for q, x in values.items()} for values in right]

    monkeypatch.setattr(equilibria_module, "solved", wrong)
    with pytest.raises(RunError, match=r"an equilibrium of hoop is wrong: a force of .* is left\. This is a fault of"):
        hoop(m=1, g=9.81, R=1, w=5).equilibria()


def test_an_equilibrium_in_decimals_may_be_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the double nearest to pi the force is round-off, relative to its slope."""
    place = {"angle": sympy.Float(float(pi))}

    def rounded(equations: Any, unknowns: Any) -> list[dict[Any, Any]]:
        return [dict.fromkeys(unknowns, place["angle"])]

    monkeypatch.setattr(equilibria_module, "solved", rounded)
    kinetic = m * R**2 * (theta.dot**2 + phi.dot**2) / 2
    potential = -m * g * R * (cos(theta) + cos(phi)) + k * R**2 * (sin(theta) - sin(phi)) ** 2 / 2
    system = lg.System(kinetic, potential, parameters={m: 1, g: 9.81, R: 1, k: 5})
    assert system.equilibria()[0].stable is False
    place["angle"] += 1e-12
    with pytest.raises(RunError, match=r"an equilibrium of system is wrong: a force of 9.81e-12 is left\."):
        system.equilibria()


# --- along a parameter -------------------------------------------------------------------------------------------


def test_eigenvalues_show_the_bifurcation_of_the_hoop() -> None:
    system, speeds = hoop(m=1, g=9.81, R=1, w=2), np.linspace(2.0, 5.0, 7)
    bottom = system.eigenvalues(w, speeds)
    expected = np.sqrt(speeds**2 - 9.81 + 0j)
    np.testing.assert_allclose(np.sort_complex(bottom.eigenvalues**2), np.column_stack([expected**2] * 2), atol=1e-12)
    assert list(bottom.stable) == [True, True, True, False, False, False, False]
    side = system.eigenvalues("w", speeds, {theta: acos(g / (R * w**2))})
    assert list(np.isnan(side.eigenvalues).any(axis=1)) == [True] * 3 + [False] * 4
    followed = system.eigenvalues("w", speeds[:2:-1], {theta: 1.17})
    np.testing.assert_allclose(followed.equilibria[::-1, 0], np.arccos(9.81 / speeds[3:] ** 2), atol=1e-9)
    np.testing.assert_allclose(followed.eigenvalues[::-1].imag ** 2, side.eigenvalues[3:].imag ** 2, rtol=1e-8)


def test_each_column_follows_one_eigenvalue_through_crossings() -> None:
    pair = lg.System((x.dot**2 + y.dot**2) / 2, (x**2 + k * y**2) / 2, coordinates=[x, y], parameters={k: 1})
    result = pair.eigenvalues(k, np.linspace(0.5, 2.0, 16)).eigenvalues
    still = np.abs(result.imag) - 1.0
    # Two stay at -+1, and two grow with sqrt(k) without a jump.
    assert sorted(np.abs(still).max(axis=0).round(12))[:2] == [0.0, 0.0]
    assert np.abs(np.diff(result, axis=0)).max() < 0.1


@pytest.mark.parametrize(
    ("parameter", "values", "at", "words"),
    [
        ("v", [1.0], None, "'v' is not a parameter of this system; its parameters are "),
        (w, 1.0, None, "values has shape (): give a list of 1 to 10000 values of w."),
        (w, [1.0, 2.0], {theta: acos(g / (R * w**2))}, "no equilibrium was found at any of the 2 values of w: give at"),
    ],
)
def test_paths_that_are_none(parameter: Any, values: Any, at: Any, words: str) -> None:
    assert refusal(hoop(m=1, g=9.81, R=1, w=2).eigenvalues, parameter, values, at).startswith(words)


def test_cubics_are_solved_by_number() -> None:
    # Three real roots, which Cardano's formula writes with I; it takes minutes to simplify, and with a parameter its
    # condition is that of another number of roots.
    tilted = lg.System(x.dot**2 / 2, x**4 / 4 - x**2 / 2 + c * x, name="tilted")
    assert "the equilibria of tilted are not found in symbols, and for a search by" in refusal(tilted.equilibria)
    result = tilted.substitute({c: sympy.Rational(1, 10)}).equilibria()
    assert [item.stable for item in result] == [True, True, False]
    assert all(abs(item.coordinates[x] ** 3 - item.coordinates[x] + 0.1) < 1e-12 for item in result)
    pair = lg.System(x.dot**2 / 2, k * (x**-12 - 2 * x**-6)).equilibria()
    assert {item.coordinates[x] for item in pair} == {1, -1}


FRICTION = "the forces jump where {} zero, as dry friction does: they may keep the system at rest at further places,"


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("potential", "forces", "place", "reason"),
    [
        (k * (x - a) ** 2 / 2, {x: -c * sign(x.dot)}, {x: a}, FRICTION.format("x_dot is")),
        (x**2 / 2, {x: -Heaviside(x.dot)}, {x: -Rational(1, 2)}, FRICTION.format("x_dot is")),
        (
            x**2 / 2 + y**2,
            {x: -sign(x.dot - y.dot), y: sign(x.dot - y.dot)},
            {x: 0, y: 0},
            FRICTION.format("x_dot - y_dot is"),
        ),
        (x**2 / 2, {x: c * sign(u - x.dot)}, {x: c * sign(u)}, "eigenvalues on the imaginary axis do not decide"),
        (x**2 / 2, {x: y - sign(x.dot), y: -sign(y.dot) - y}, {x: 0, y: 0}, FRICTION.format("x_dot and y_dot are")),
    ],
)
def test_dry_friction_counts_as_zero_at_rest(
    potential: Any, forces: dict[Any, Any], place: dict[Any, Any], reason: str
) -> None:
    (at_rest,) = lg.System(sum(q.dot**2 / 2 for q in place), potential, forces=forces).equilibria()
    assert (at_rest.coordinates, at_rest.stable) == (place, None)
    assert at_rest.reason.startswith(reason)


def test_friction_may_hold_a_block_where_the_forces_do_not_vanish() -> None:
    slope = lg.System(m * x.dot**2 / 2, m * g * x / 2, forces={x: -c * sign(x.dot)})
    assert "But the forces jump where x_dot is zero, as dry" in refusal(slope.equilibria)


def test_corners_and_poles_leave_the_verdict_open() -> None:
    (corner,) = lg.System(m * x.dot**2 / 2, k * abs(x), parameters={m: 1, k: 1}).equilibria()
    assert (float(corner.coordinates[x]), corner.stable) == (0.0, None)
    assert "the forces on x have a corner or a jump at x = 0" in corner.reason
    curved = lg.System((x.dot**2 + y.dot**2) / y**2, initial={y: 1}, name="curved")
    assert "the forces of curved, or their derivatives, have no value at" in curved.equilibria()[0].reason


@pytest.mark.slow
def test_flat_places_are_found_and_surfaces_are_not_listed() -> None:
    flat = lg.System(m * x.dot**2 / 2, k * cos(x**2), parameters={m: 1, k: 1})
    assert 0.0 in [float(item.coordinates[x]) for item in flat.equilibria()]
    (bowl,) = lg.System((x.dot**2 + y.dot**2) / 2, cosh(x) + y**4 / 4, coordinates=[x, y]).equilibria()
    assert abs(bowl.coordinates[y]) < 1e-3
    with pytest.raises(StatementError, match=r"no equilibrium of tail was found"):  # the force is small far out alone
        lg.System(x.dot**2 / 2, 2 * sympy.tanh(x), name="tail").equilibria()
    assert "free-flip has too many equilibria to list: 256 " in refusal(lambda: shared_scene("free-flip").equilibria())
    with pytest.raises(StatementError, match=r"free-top has too many .* Call equilibria\(\{R.space\[2\]: 0\}\)."):
        shared_scene("free-top").equilibria()


def test_a_power_of_a_sum_with_thousands_of_terms_is_not_multiplied_out() -> None:
    q = lg.coordinates(" ".join(f"q{i}" for i in range(8)))
    drag = {x: -c * (1 + sum(q)) ** 8 * x.dot for x in q}
    system = lg.System(sum(x.dot**2 for x in q) / 2, sum(x**2 for x in q) / 2, forces=drag)
    assert has_energy(PlainForm(system.statement))


FORCES = [
    ({x: -sympy.Abs(x.dot) * x.dot, y: -c * (1 + x**2) * y.dot**5}, True),
    ({x: -c * sqrt(x.dot**2 + y.dot**2) * x.dot, y: -c * sqrt(x.dot**2 + y.dot**2) * y.dot}, True),
    ({x: c * x.dot * y.dot**2, y: -c * x.dot**2 * y.dot}, True),  # without power
    ({x: x.dot**3}, None),
    ({x: -(y.dot**3)}, None),
    ({x: x.dot**3 - 2 * x.dot**3 / (1 + x.dot**2)}, None),  # brakes at low speeds alone: more than is proved
]
"""Forces on a particle in a bowl, and whether their power is certainly never positive."""


@pytest.mark.parametrize(("forces", "stable"), FORCES)
def test_forces_that_only_brake_leave_a_minimum_of_the_energy_stable(forces: Any, stable: bool | None) -> None:
    kinetic, potential = m * (x.dot**2 + y.dot**2) / 2, k * (2 - cos(x) - cos(y))
    for values in ({"m": 1, "k": 2, "c": 0.1}, {}):
        known = {name: value for name, value in values.items() if name != "c" or str(forces).count("c*")}
        system = lg.System(kinetic, potential, forces=forces, parameters=known)
        bowl = next(item for item in system.equilibria() if {*item.coordinates.values()} == {0})
        assert bowl.stable is stable
        assert (bowl.reason == "the energy has a strict minimum there.") is (stable is True)


def lorenz(r: float) -> lg.System:
    x, y, z = lg.coordinates("x y z")
    rates = {x: 10 * (y - x), y: x * (r - z) - y, z: x * y - sympy.Rational(8, 3) * z}
    drag = (x.dot**2 + y.dot**2 + z.dot**2) / 2
    return lg.System(kinetic=0, coordinates=[x, y, z], forces=rates, dissipation=drag, name="lorenz")


def test_equilibria_of_states_of_first_order() -> None:
    """Lorenz's equations: the origin loses its stability at r = 1, the other two equilibria at r = 470/19."""
    assert [place.stable for place in lorenz(24.7).equilibria()].count(True) == 2
    assert [place.stable for place in lorenz(24.8).equilibria()] == [False] * 3
    linear = lorenz(28).linearize()
    assert (linear.A - sympy.Matrix([[-10, 10, 0], [28, -1, 0], [0, 0, -sympy.Rational(8, 3)]])).is_zero_matrix
    assert linear.B.shape == (3, 0)


@pytest.mark.slow
def test_long_formulas_leave_stability_to_numbers() -> None:
    """Determinants of the equilibrium away from the origin would take minutes in symbols."""
    kinetic, potential = m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, k * (x**2 + 2 * y**2 + x * y) / 2 + m * g * z
    values = {"m": 1, "g": 2, "k": 2, "a": 0.6}
    system = lg.System(kinetic, potential, constraints=[z - a * x * y - x**3], parameters=values)
    origin, saddle = system.equilibria()
    assert [origin.stable, saddle.stable, len(origin.criterion), saddle.criterion] == [True, False, 2, ()]
    growth = system.modes(saddle.at)
    assert (growth.stable, growth.symbolic) == (False, False)
    largest = max(value.real for value in growth.eigenvalues)
    assert saddle.reason == f"an eigenvalue has the positive real part {largest:.6g}."
    _, undecided = lg.System(kinetic, potential, constraints=[z - a * x * y - x**3]).equilibria()
    assert undecided.reason.startswith("the matrices of its linear equations have more than 150 operations, too many")


BOB = m * l**2 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2
WEIGHT, SIDEWAYS = -m * g * l * cos(theta), l * sin(theta) * cos(phi)
POLES = [
    (BOB, WEIGHT, 2),
    (BOB, WEIGHT + k * SIDEWAYS**2, 2),  # the forces vanish there for several values of the other angle
    (BOB, WEIGHT + 2 * m * SIDEWAYS, 0),
    (m * (r.dot**2 + r**2 * phi.dot**2) / 2, k * r**2 / 2, 1),
    (m * (r.dot**2 + r**2 * phi.dot**2) / 2, k * r**2 / 2 + m * g * r * sin(phi), 0),
]
"""Energies of a bob on a sphere and in a plane, and how many poles of the coordinates are listed: those in balance."""


@pytest.mark.parametrize("values", [{"m": 1, "g": 9.81, "l": 0.5, "k": 3}, {}])
@pytest.mark.parametrize(("kinetic", "potential", "poles"), POLES)
def test_poles_of_coordinates_are_listed_if_they_are_in_balance(
    kinetic: Any, potential: Any, poles: int, values: dict[str, float]
) -> None:
    radius = theta if kinetic.has(theta) else r
    names = {symbol.name for symbol in (kinetic + potential).free_symbols}
    known = {name: value for name, value in values.items() if name in names}
    system = lg.System(kinetic, potential, coordinates=[radius, phi], parameters=known)
    places = [item.coordinates[radius] for item in system.equilibria()]
    assert len([place for place in places if place in (0, pi)]) == poles


def test_equations_that_have_no_factors_in_symbols_are_solved_by_number() -> None:
    """Exponentials of differences, as of the Toda lattice, are no polynomial for SymPy."""
    system = lg.System(m * (x.dot**2 + y.dot**2) / 2, exp(x - y) + exp(y - x) + y**2, parameters={m: 1})
    (rest,) = system.equilibria()
    assert np.allclose([float(place) for place in rest.coordinates.values()], 0, atol=1e-8)


@pytest.mark.slow
def test_a_search_by_number_lists_a_pole_once() -> None:
    potential = WEIGHT + k * SIDEWAYS**2 + exp(SIDEWAYS**2) * (sin(theta) * sin(phi)) ** 2
    system = lg.System(BOB, potential, parameters={"m": 1, "g": 9.81, "l": 1, "k": 3})
    places = [float(item.coordinates[theta]) for item in system.equilibria()]
    assert [abs(place) % 3.14159265358979 < 1e-6 for place in places].count(True) == 2


@pytest.mark.parametrize("forces", [{}, {r: -sign(r.dot)}])
def test_a_force_that_vanishes_only_at_a_pole_leaves_no_equilibrium(forces: dict[Any, Any]) -> None:
    kinetic, potential = m * (r.dot**2 + r**2 * phi.dot**2) / 2, m * g * r * sin(phi)
    system = lg.System(kinetic, potential, coordinates=[phi, r], forces=forces, name="falling")
    assert refusal(system.equilibria) == (
        "falling has no equilibrium: the forces on phi and r at rest vanish only where the mass matrix is singular, "
        "and the system is not in balance there."
    )


# --- analyses of systems with given functions: with values they are functions of t; open ones are refused ------


def driven(pivot: Any) -> lg.System:
    """Return a pendulum whose pivot moves along a line."""
    bob = (pivot + l * sin(theta), -l * cos(theta))
    return lg.System(lg.kinetic_energy(m, bob), lg.gravity(m, bob, g), parameters={m: 1, g: 9.81, l: 1})


@pytest.mark.slow
def test_equations_may_contain_the_given_function_and_its_derivatives() -> None:
    X = lg.given("X", sin(2 * lg.t))
    system = driven(X)
    assert system.compare("l*theta_ddot + g*sin(theta) + X_ddot*cos(theta)")
    assert system.compare([l * theta.ddot + g * sin(theta) - 4 * X * cos(theta)])
    wrong = system.compare("l*theta_ddot + g*sin(theta) - X_ddot*cos(theta)")
    assert not wrong and "wrong sign" in wrong.message
    with pytest.raises(lg.StatementError, match="'Y_ddot' is not a symbol of this system"):
        system.compare("l*theta_ddot + g*sin(theta) + Y_ddot*cos(theta)")


ASKED: dict[str, Callable[[lg.System], Any]] = {
    "hamiltonian": lambda one: one.hamiltonian(),
    "linearize": lambda one: one.linearize(at={theta: 0}),
    "small": lambda one: one.small({theta: 0}),
    "conserved": lambda one: one.conserved(),
    "equilibria": lambda one: one.equilibria(),
    "compare": lambda one: one.compare("theta_ddot"),
}


@pytest.mark.parametrize("asked", ASKED)
def test_open_functions_are_refused(asked: str) -> None:
    assert "X is a given function of time, and has no values to comput" in refusal(ASKED[asked], driven(lg.given("X")))
    assert "compute with: call linearize(inputs=['X']) for a mat" in refusal(lambda: driven(lg.given("X")).linearize())
    with pytest.raises(lg.StatementError, match=r"U\(theta\(t\)\) has no formula: a derivation leaves"):
        ASKED[asked](lg.System(m * theta.dot**2 / 2, Function("U")(theta), parameters={m: 1}))


# --- steady rotations of a body: turns about an axis of space, and precessions, against closed forms -----------


TURN = lg.rotation("R")

J1, J3 = lg.parameters("J1 J3")
VALUES = {m: 1, g: 9.81, a: 0.1, J1: 0.02, J3: 0.01}


def body(moments: Any, potential: Any = 0, **more: Any) -> lg.System:
    return lg.System(TURN.body.dot(diag(*moments) * TURN.body) / 2, potential, **more)


def rates(result: Any) -> list[float]:
    return [float(result.velocities.get(rate, 0)) for rate in TURN.body]


@pytest.mark.slow
def test_a_free_body_turns_about_its_principal_axes() -> None:
    """Both ways about each, with the energy J w^2/2; the middle axis alone is unstable."""
    result = body((1, 2, 3)).equilibria({TURN.space[2]: 1.5})
    assert sorted(map(rates, result)) == sorted(
        [s * 1.5 * (k == i) for i in range(3)] for k in range(3) for s in (1, -1)
    )
    for each in result:
        axis = int(np.argmax(np.abs(rates(each))))
        assert float(each.energy) == (1 + axis) * 1.5**2 / 2
        assert each.stable is (axis != 1)


@pytest.mark.slow
def test_a_heavy_top_hangs_stands_or_leans() -> None:
    """It leans at cos(tilt) = -m g a/((J1 - J3) w^2), and stands if J3^2 w^2 > 4 m g a J1 (Landau, section 35)."""
    top = body((J1, J1, J3), m * g * a * TURN[2, 2], parameters=VALUES)
    hanging, upright, leaning = top.equilibria({TURN.space[2]: 100})
    assert [each.stable for each in (hanging, upright, leaning)] == [True] * 3
    limit = J3**2 * 100**2 / (4 * J1) - m * g * a
    assert sympy.simplify(upright.criterion[0] - limit) == 0
    w, x, *_ = leaning.coordinates.values()
    assert sympy.simplify(w**2 - x**2 + m * g * a / ((J1 - J3) * 100**2)) == 0
    assert leaning.condition != sympy.true


@pytest.mark.slow
@pytest.mark.parametrize("axis", [2, 0])
def test_both_rates_of_precession_at_a_tilt(axis: int) -> None:
    """They are the roots of J1 cos(tilt) W^2 - J3 w W + m g a, for an axis of symmetry z or x of the body."""
    attitude, spin = lg.turn((0.3, 0.2, 0.5), 2.5), 10.0
    top = body([0.5 if k == axis else 1 for k in range(3)], TURN[2, axis])
    result = top.equilibria({TURN: attitude, TURN.body[axis]: spin})
    matrix = top.run(0.01, {TURN: attitude})[TURN][0]
    tilt = np.arccos(matrix[2, axis])
    roots = np.sort(np.abs(np.roots([np.cos(tilt), -0.5 * spin, 1])))
    across = sorted(np.linalg.norm(np.delete(rates(each), axis)) / np.sin(tilt) for each in result)
    assert across == pytest.approx(roots, rel=1e-12)
    for each in result:
        assert each.stable
        path = top.run(1.0, each.at, rtol=1e-13)[TURN][:, 2, axis]
        assert np.abs(path - np.cos(tilt)).max() < 1e-12


@pytest.mark.slow
def test_a_free_symmetric_body_precesses_or_spins_about_a_fixed_axis() -> None:
    """It precesses at the rate J3 w/(J1 cos(tilt)). Without a precession its axis stays where it is."""
    found = body((1, 1, 2)).equilibria({TURN: lg.turn(lg.x, 0.5), TURN.body[2]: 3})
    assert [each.stable for each in found] == [True, True]
    np.testing.assert_allclose([rates(each) for each in found], [(0, 0, 3), (0, 6 * np.tan(0.5), 3)], rtol=1e-14)


@pytest.mark.slow
def test_a_body_on_a_spring_turns_with_its_spring_stretched() -> None:
    """The spring and the pull of the body, x (R z)_z, balance at x = -(R z)_z / 2."""
    x = lg.coordinate("x")
    kinetic = TURN.body.dot(diag(1, 1, 0.25) * TURN.body) / 2 + x.dot**2 / 2
    result = lg.System(kinetic, x**2 + x * TURN[2, 2]).equilibria({TURN.space[2]: 1})
    w, i, j, k = (np.array([float(each.coordinates[q]) for each in result]) for q in TURN.quaternion)
    assert [float(each.coordinates[x]) for each in result] == pytest.approx(-(w**2 - i**2 - j**2 + k**2) / 2)


@pytest.mark.parametrize(("missing", "count"), [(0.0, 1), (1e-14, 2)])
def test_a_horizontal_top_precesses_at_m_g_a_over_its_momentum(missing: float, count: int) -> None:
    """The other root has the factor of the cosine of the tilt in its denominator, and goes to infinity."""
    top = body((1, 1, 0.5), TURN[2, 2] / 2)
    result = top.equilibria({TURN: lg.turn(lg.x, np.pi / 2 - missing), TURN.body[2]: 100})
    assert len(result) == count
    # m g a = 1/2, J3 w = 50; the slow root differs from their ratio by the relative amount of `missing`.
    assert min(abs(np.linalg.norm(rates(each)[:2])) for each in result) == pytest.approx(0.01, rel=1e-9)


S, height = lg.rotation("S"), lg.coordinate("y")
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "two rates": (lambda: body((1, 2, 3)).equilibria({TURN.space: (0, 1, 2)}), "no steady motion of R: give {R.space"),
    "a spin under a drag": (
        lambda: body((1, 1, 2), dissipation=TURN.body.dot(TURN.body), forces={TURN.body: (0, 0, 1)}).equilibria(),
        "the forces on R are not solved",
    ),
    "a spin alone": (lambda: body((1, 2, 3)).equilibria({TURN.body[2]: 2}), r"or {R: attitude, R.body\[2\]: w}"),
    "no vertical": (
        lambda: body((1, 2, 3), TURN[2, 2]).equilibria({TURN.space[0]: 1}),
        "steadily about the axis x of space",
    ),
    "a drag": (
        lambda: body((1, 2, 3), dissipation=TURN.body.dot(TURN.body)).equilibria({TURN.space[2]: 1}),
        "forces or drags act about this axis",
    ),
    "no symmetry": (
        lambda: body((1, 2, 3)).equilibria({TURN: lg.turn(lg.x, 1), TURN.body[2]: 2}),
        "no steady precession: forces or drags act about its axis z and",
    ),
    "upright": (
        lambda: body((1, 1, 0.5), TURN[2, 2]).equilibria({TURN: lg.turn(lg.z, 1), TURN.body[2]: 2}),
        "axis z of R lies along axis z of space at this attitude",
    ),
    "too slow": (
        lambda: body((1, 1, 0.5), TURN[2, 2]).equilibria({TURN: lg.turn(lg.x, 0.5), TURN.body[2]: 2}),
        "no steady precession at this attitude: R spins too slowly",
    ),
    "another unknown": (
        lambda: lg.System(
            TURN.body.dot(diag(1, 1, 2) * TURN.body) / 2 + height.dot**2, height**2 + TURN[2, 2]
        ).equilibria({TURN: lg.turn(lg.x, 0.5), TURN.body[2]: 9}),
        "depend on",
    ),
    "two rotations": (
        lambda: lg.System(TURN.body.dot(TURN.body) + S.body.dot(S.body)).equilibria({TURN.space[2]: 1}),
        "steady rotations are found for one rotation alone",
    ),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_steady_motion_is_refused(case: str) -> None:
    attempt, sentence = REFUSED[case]
    assert re.search(sentence, refusal(attempt))
