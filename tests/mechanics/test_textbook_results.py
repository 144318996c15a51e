"""Results of textbooks, matched as formulas: what a course of mechanics derives by hand comes out of the statement.

Landau is L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., 1976; Goldstein is H. Goldstein, C. Poole, J. Safko,
Classical Mechanics, 3rd ed., 2002; Szebehely is V. Szebehely, Theory of Orbits, 1967.
"""

from typing import Any

import pytest
import sympy
from sympy import Rational, acos, asin, cos, pi, sin, sqrt

import lagrange as lg
from tests.models import shared_scene

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


def test_pivot_on_a_circle() -> None:
    """Landau, section 5, problem 3a: L = m l^2 phi'^2/2 + m a l gamma^2 sin(phi - gamma t) + m g l cos(phi)."""
    bob = (a * cos(gamma * lg.t) + l * sin(phi), a * sin(gamma * lg.t) - l * cos(phi))
    driven = lg.System(lg.kinetic_energy(m, bob), lg.gravity(m, bob, g), coordinates=[phi])
    book = (a * gamma**2 * cos(phi - gamma * lg.t) - g * sin(phi)) / l
    assert same(driven.accelerations()[phi], book)


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


@pytest.mark.few(1)
@pytest.mark.parametrize(("potential", "ratio"), [(-k / r, 1), (k * r**2 / 2, 4)])
def test_nearly_circular_orbits_close(potential: Any, ratio: int) -> None:
    """Goldstein, section 3.6 (Bertrand): radial and orbital frequencies are as 1 and as 2 in the two closed cases."""
    system = central(potential)
    radial = sorted({sympy.simplify(f**2) for f in _circular(system).frequencies}, key=str)
    assert any(same(f, ratio * w**2) for f in radial), radial


def _circular(system: lg.System) -> Any:
    place = (k / (m * w**2)) ** Rational(1, 3)
    if system.statement.potential.has(r**2):
        system = system.substitute({k: m * w**2})
        place = a
    return system.modes({r: place, phi.dot: w})


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


def test_precession_of_the_top() -> None:
    """Goldstein, equation (5.77): steady precession W has m g l = W (I3 w3 - I1 W cos(theta))."""
    turn, spin = sympy.symbols("W w3", real=True)
    point = {theta: alpha, phi.dot: turn, psi.dot: spin - turn * cos(alpha)}
    rest = top().equations()[0]
    residual = (rest.lhs - rest.rhs).subs({theta.ddot: 0, theta.dot: 0}).subs(point)
    residual = residual.subs(theta, alpha)
    assert same(residual, -sin(alpha) * (m * g * l - turn * (I3 * spin - I1 * turn * cos(alpha))))


def test_sleeping_top() -> None:
    """Landau, section 35, problem 1: upright rotation is stable if M_3^2 > 4 I1 m g l."""
    p, n = sympy.symbols("p_phi p_psi", real=True)
    potential = top().routhian(phi, psi).statement.potential.subs(p, n)
    angle = sympy.Symbol("angle", positive=True)
    stiffness = sympy.series(potential.subs(theta, angle), angle, 0, 3).removeO().coeff(angle, 2) * 2
    assert same(stiffness, (n**2 - 4 * I1 * m * g * l) / (4 * I1))


@pytest.mark.slow
def test_foucault() -> None:
    """Landau, section 39, problem 3: the plane of a pendulum turns with w = W sin(latitude)."""
    plane = lg.System(
        lagrangian=m * (x.dot**2 + y.dot**2) / 2 + m * w * (x * y.dot - y * x.dot) - m * g * (x**2 + y**2) / (2 * l),
        coordinates=[x, y],
    )
    slow, fast = plane.modes().frequencies
    assert same((fast - slow) / 2, w)
    assert same(fast * slow, g / l)


def test_charge_in_a_field() -> None:
    """Landau, The Classical Theory of Fields, section 21: circles with q B/m; H = (p - q A)^2/2m."""
    charge = lg.System(lagrangian=m * (x.dot**2 + y.dot**2) / 2 + q * B * x * y.dot, coordinates=[x, y])
    form = charge.hamiltonian()
    p, n = form.momenta[x], form.momenta[y]
    assert same(form.expression, (p**2 + (n - q * B * x) ** 2) / (2 * m))
    match(squares(charge), [0, (q * B / m) ** 2])
    assert same(form.poisson(m * x.dot, m * y.dot), q * B)


def test_triatomic_molecule() -> None:
    """Goldstein, section 6.4: w^2 = 0, k/m and (k/m)(1 + 2 m/M)."""
    molecule = lg.System(
        m * (x.dot**2 + z.dot**2) / 2 + M * y.dot**2 / 2, k * ((y - x) ** 2 + (z - y) ** 2) / 2, coordinates=[x, y, z]
    ).modes()
    match([f**2 for f in molecule.frequencies], [0, k / m, k / m * (1 + 2 * m / M)])
    match(list(molecule.shapes[2]), [1, -2 * m / M, 1])


def test_atwood() -> None:
    """Goldstein, section 1.6: x'' = g (m1 - m2)/(m1 + m2)."""
    machine = lg.System((m1 + m2) * x.dot**2 / 2, -m1 * g * x - m2 * g * (l - x))
    assert same(machine.accelerations()[x], g * (m1 - m2) / (m1 + m2))
    both = lg.System(
        (m1 * x.dot**2 + m2 * y.dot**2) / 2,
        -m1 * g * x - m2 * g * y,
        constraints={"string": x + y - l},
        coordinates=[x, y],
    )
    assert same(both.eliminate(y).accelerations()[x], g * (m1 - m2) / (m1 + m2))


@pytest.mark.slow
def test_kapitza() -> None:
    """Landau, section 30, problem 1: a pivot that shakes upright holds the pendulum up if a^2 gamma^2 > 2 g l."""
    bob = (l * sin(theta), a * cos(gamma * lg.t) - l * cos(theta))
    shaken = lg.System(lg.kinetic_energy(m, bob), lg.gravity(m, bob, g), coordinates=[theta])
    force = sympy.expand(m * l**2 * shaken.accelerations()[theta]).coeff(cos(gamma * lg.t))
    averaged = force**2 / (4 * m * l**2 * gamma**2)  # of f cos(gamma t): f^2/(4 M gamma^2)
    mean = lg.System(m * l**2 * theta.dot**2 / 2, -m * g * l * cos(theta) + averaged)
    up = next(item for item in mean.equilibria() if item.coordinates[theta] == pi)
    assert same(up.criterion[0], m * (a**2 * gamma**2 - 2 * g * l) / 2)
    tilted = next(item for item in mean.equilibria() if item.coordinates[theta].has(acos))
    assert same(cos(tilted.coordinates[theta]), -2 * g * l / (a**2 * gamma**2))


def test_cycloid() -> None:
    """Landau, section 11: on a cycloid every swing takes 4 pi sqrt(R/g), for the height is R u^2 with u'' = -g u/4R."""
    bead = (R * (s + sin(s)), R * (1 - cos(s)))
    wire = lg.System(lg.kinetic_energy(m, bead), lg.gravity(m, bead, g), coordinates=[s])
    match(squares(wire), [g / (4 * R)])
    straight = wire.transform({s: 2 * asin(u)})
    assert same(straight.accelerations()[u], -g * u / (4 * R))


def test_henon_heiles() -> None:
    """M. Henon, C. Heiles, Astronomical Journal 69, 1964: three saddles at the energy 1/6 about the minimum."""
    result = shared_scene("henon-heiles").equilibria()
    assert [item.energy for item in result] == [0, *[Rational(1, 6)] * 3]
    assert [item.stable for item in result] == [True, False, False, False]
    places = {tuple(item.coordinates.values()) for item in result[1:]}
    assert places == {(0, 1), (sqrt(3) / 2, -Rational(1, 2)), (-sqrt(3) / 2, -Rational(1, 2))}


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


def test_two_bodies() -> None:
    """Goldstein, section 3.1: the centre of mass moves freely, the distance with the reduced mass."""
    system = lg.System((m1 * x.dot**2 + m2 * y.dot**2) / 2, k * (x - y) ** 2 / 2, coordinates=[x, y])
    total = m1 + m2
    apart = system.transform({x: X + m2 * r / total, y: X - m1 * r / total})
    assert same(apart.statement.kinetic, total * X.dot**2 / 2 + m1 * m2 / total * r.dot**2 / 2)
    assert same(apart.statement.potential, k * r**2 / 2)
    match(squares(apart), [0, k * total / (m1 * m2)])


def test_bead_on_a_turning_wire() -> None:
    """Goldstein, section 1.6: r'' = r w^2, with Jacobi's integral m r'^2/2 - m w^2 r^2/2."""
    radius = y * cos(w * lg.t) - x * sin(w * lg.t)
    plane = lg.System(m * (x.dot**2 + y.dot**2) / 2, coordinates=[x, y], constraints=[radius], initial={x: 1.0})
    turning = plane.transform({x: r * cos(phi), y: r * sin(phi)}, initial={r: 1.0})
    assert same(turning.statement.constraints[0].expression, r * sin(phi - w * lg.t))
    wire = turning.eliminate({phi: w * lg.t})
    assert same(wire.accelerations()[r], r * w**2)
    assert same(wire.energy, m * r.dot**2 / 2 - m * w**2 * r**2 / 2)
