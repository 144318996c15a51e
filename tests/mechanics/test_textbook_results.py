"""Results of textbooks, matched as formulas: what a course of mechanics derives by hand comes out of the statement.

Landau is L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., 1976; Goldstein is H. Goldstein, C. Poole, J. Safko,
Classical Mechanics, 3rd ed., 2002; Szebehely is V. Szebehely, Theory of Orbits, 1967.
"""

from __future__ import annotations

from typing import Any

import sympy
from sympy import Rational, asin, cos, sin, sqrt

import lagrange as lg

m, M, g, l, k, K, c, a, R, w, q, B = lg.parameters("m M g l k K c a R w q B")
I1, I3, mu, alpha, gamma, m1, m2 = lg.parameters("I1 I3 mu alpha gamma m1 m2")
x, y, z, X, Y, r, u, s = lg.coordinates("x y z X Y r u s")
theta, phi, psi, theta1, theta2 = lg.coordinates("theta phi psi theta1 theta2")


def same(result: Any, book: Any) -> bool:
    return bool(sympy.simplify(sympy.expand(result - book)) == 0)


def squares(system: lg.System, at: Any = None) -> list[Any]:
    return [sympy.simplify(frequency**2) for frequency in system.modes(at).frequencies]


def match(result: list[Any], book: list[Any]) -> None:
    assert len(result) == len(book)
    assert all(same(first, second) for first, second in zip(result, book, strict=True)), result


def test_double_pendulum() -> None:
    """Landau, section 5, problem 1, and section 23, problem 2, with equal masses: w^2 = (2 -+ sqrt(2)) g/l."""
    upper = (l * sin(theta1), -l * cos(theta1))
    lower = (upper[0] + l * sin(theta2), upper[1] - l * cos(theta2))
    pendulum = lg.System(
        lg.kinetic_energy(m, upper) + lg.kinetic_energy(m, lower),
        lg.gravity(m, upper, g) + lg.gravity(m, lower, g),
        coordinates=[theta1, theta2],
    )
    turning = l**2 * (theta1.dot**2 + theta2.dot**2 / 2 + theta1.dot * theta2.dot * cos(theta1 - theta2))
    assert same(pendulum.lagrangian, m * turning + m * g * l * (2 * cos(theta1) + cos(theta2)))
    modes = pendulum.modes()
    match([f**2 for f in modes.frequencies], [g * (2 - sqrt(2)) / l, g * (2 + sqrt(2)) / l])
    assert [shape[1] for shape in modes.shapes] == [sqrt(2), -sqrt(2)]


def central(potential: Any) -> lg.System:
    return lg.System(m * (r.dot**2 + r**2 * phi.dot**2) / 2, potential, coordinates=[r, phi], initial={r: 1.0})


def test_central_force_by_routh() -> None:
    """Goldstein, section 3.3 and 8.3: the effective potential U + p^2/(2 m r^2)."""
    p = sympy.Symbol("p_phi", real=True)
    small = central(-k / r).routhian(phi)
    assert same(small.statement.potential, -k / r + p**2 / (2 * m * r**2))
    (orbit,) = small.equilibria()
    assert same(orbit.coordinates[r], p**2 / (k * m))
    assert same(orbit.energy, -m * k**2 / (2 * p**2))


def test_spherical_pendulum() -> None:
    """Landau, section 14, problem 1: U_eff = M_z^2/(2 m l^2 sin^2) - m g l cos."""
    system = lg.System(
        m * l**2 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2, -m * g * l * cos(theta), coordinates=[theta, phi]
    )
    p = sympy.Symbol("p_phi", real=True)
    book = p**2 / (2 * m * l**2 * sin(theta) ** 2) - m * g * l * cos(theta)
    assert same(system.routhian(phi).statement.potential, book)
    form = system.hamiltonian()
    assert same(form.expression, form.momenta[theta] ** 2 / (2 * m * l**2) + book.subs(p, form.momenta[phi]))


def top() -> lg.System:
    return lg.System(
        I1 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2 + I3 * (psi.dot + cos(theta) * phi.dot) ** 2 / 2,
        m * g * l * cos(theta),
        coordinates=[theta, phi, psi],
    )


def test_symmetric_top_by_routh() -> None:
    """Landau, section 35, problem 1: U_eff = (M_z - M_3 cos)^2/(2 I1 sin^2) + M_3^2/(2 I3) + m g l cos."""
    p, n = sympy.symbols("p_phi p_psi", real=True)
    book = (p - n * cos(theta)) ** 2 / (2 * I1 * sin(theta) ** 2) + n**2 / (2 * I3) + m * g * l * cos(theta)
    assert same(top().routhian(phi, psi).statement.potential, book)


def test_cycloid() -> None:
    """Landau, section 11: on a cycloid every swing takes 4 pi sqrt(R/g), for the height is R u^2 with u'' = -g u/4R."""
    bead = (R * (s + sin(s)), R * (1 - cos(s)))
    wire = lg.System(lg.kinetic_energy(m, bead), lg.gravity(m, bead, g), coordinates=[s])
    match(squares(wire), [g / (4 * R)])
    straight = wire.transform({s: 2 * asin(u)})
    assert same(straight.accelerations()[u], -g * u / (4 * R))


def three_bodies() -> lg.System:
    near, far = sqrt((x + mu) ** 2 + y**2), sqrt((x - 1 + mu) ** 2 + y**2)
    turning = (x.dot**2 + y.dot**2) / 2 + x * y.dot - y * x.dot + (x**2 + y**2) / 2
    return lg.System(lagrangian=turning + (1 - mu) / near + mu / far, coordinates=[x, y], initial={x: 0.5, y: 1.0})


TRIANGLE = {x: Rational(1, 2) - mu, y: sqrt(3) / 2}


def test_triangular_points() -> None:
    """Szebehely, section 5.4: (1/2 - mu, sqrt(3)/2) rests, with l^4 + l^2 + 27 mu (1 - mu)/4 = 0."""
    lin = three_bodies().linearize(TRIANGLE)
    assert lin.equilibrium
    rate = sympy.Symbol("rate")
    book = rate**4 + rate**2 + Rational(27, 4) * mu * (1 - mu)
    assert same((lin.M * rate**2 + lin.C * rate + lin.K).det(), book)


def test_bead_on_a_turning_wire() -> None:
    """Goldstein, section 1.6: r'' = r w^2, with Jacobi's integral m r'^2/2 - m w^2 r^2/2."""
    radius = y * cos(w * lg.t) - x * sin(w * lg.t)
    plane = lg.System(m * (x.dot**2 + y.dot**2) / 2, coordinates=[x, y], constraints=[radius], initial={x: 1.0})
    turning = plane.transform({x: r * cos(phi), y: r * sin(phi)}, initial={r: 1.0})
    assert same(turning.statement.constraints[0].expression, r * sin(phi - w * lg.t))
    wire = turning.eliminate({phi: w * lg.t})
    assert same(wire.accelerations()[r], r * w**2)
    assert same(wire.energy, m * r.dot**2 / 2 - m * w**2 * r**2 / 2)
