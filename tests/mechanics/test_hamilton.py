"""Hamilton's form: the same motion, brackets that obey their laws, and refusals of degenerate Lagrangians."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import hamilton
from lagrange.mechanics.hamilton import Hamiltonian, Legendre, legendre
from tests.refusals import refusal

m, g, l, c, k, B = lg.parameters("m g l c k B")
theta, x, y, z = lg.coordinates("theta x y z")
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
