"""Small oscillations and verdicts on stability, and results of textbooks matched as formulas."""

import pickle
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import I, Rational, asin, cos, pi, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError
from lagrange.mechanics import modes as modes_module
from tests.models import shared_scene
from tests.refusals import refusal
from tests.systems import conical_pendulum

m, g, l, k, c, w, M = lg.parameters("m g l k c w M")
a = lg.parameters("a", positive=False)
x, y, z, theta = lg.coordinates("x y z theta")
MANY: Any = lg.coordinates("q1 q2 q3 q4 q5")


def plane(potential: Any, *, turn: Any = 0, **more: Any) -> lg.System:
    lagrangian = m * (x.dot**2 + y.dot**2) / 2 + turn * (x * y.dot - y * x.dot) - potential
    return lg.System(lagrangian=lagrangian, coordinates=[x, y], **more)


def test_a_chain_of_five_is_numbers() -> None:
    # Goldstein, Classical Mechanics, 3rd ed., section 13.1: w_j = 2 sqrt(k/m) sin(j pi/12).
    springs = [MANY[0], *(b - a for a, b in pairwise(MANY)), MANY[-1]]
    system = lg.System(
        sum(q.dot**2 for q in MANY) / 2, k * sum(s**2 for s in springs) / 2, coordinates=MANY, parameters={k: 4}
    )
    result = system.modes()
    assert not result.symbolic
    expected = [4 * np.sin(j * np.pi / 12) for j in range(1, 6)]
    np.testing.assert_allclose([float(w) for w in result.frequencies], expected, rtol=1e-12)
    np.testing.assert_allclose([float(s) for s in result.shapes[1]], [1, 1, 0, -1, -1], atol=1e-12)
    assert result.stable is True
    assert "the modes of system are not found in symbols, an" in refusal(lambda: system.substitute({k: 2 * w}).modes())


def test_damped_and_gyroscopic_modes() -> None:
    damped = lg.System(m * x.dot**2 / 2, k * x**2 / 2, dissipation=c * x.dot**2 / 2).modes()
    assert sympy.simplify(damped.frequencies[0] - sqrt(k / m - (c / (2 * m)) ** 2)) == 0
    assert damped.decay == (c / (2 * m),)
    energies = sum(q.dot**2 for q in MANY) / 2, sum((j + 1) * q**2 for j, q in enumerate(MANY)) / 2
    number = lg.System(*energies, coordinates=MANY, dissipation=energies[0] / 10).modes()
    np.testing.assert_allclose([float(d) for d in number.decay], 0.05, rtol=1e-10)
    assert number.stable is True
    assert number.reason.startswith("all eigenvalues have negative real parts, up to -0.05")
    cyclotron = plane(0, turn=M).modes()
    assert [sympy.simplify(f) for f in cyclotron.frequencies] == [0, 2 * M / m]


@pytest.mark.slow
def test_gyroscopic_forces_decide_nothing_where_the_energy_has_no_minimum() -> None:
    hill = -k * (x**2 + y**2) / 2
    values = {m: 1.0, k: 1.0, M: 3.0}
    assert plane(hill, turn=M, parameters=values).modes().stable is None
    assert "the energy has no minimum" in plane(hill, turn=M, parameters=values).modes().reason
    assert plane(hill, turn=M, parameters={**values, M: 0.3}).modes().stable is False
    # Kelvin and Tait: friction destroys what gyroscopic forces hold.
    friction = c * (x.dot**2 + y.dot**2) / 2
    assert plane(hill, turn=M, dissipation=friction, parameters={**values, c: 0.01}).modes().stable is False
    bowl = plane(k * (x**2 + y**2) / 2, turn=M, dissipation=c * x.dot**2 / 2, parameters={**values, c: 0.01})
    assert bowl.modes().stable is True


@pytest.mark.slow
def test_numbers_lose_no_mode_and_give_every_eigenvalue() -> None:
    """A free motion and an overdamped one have two real eigenvalues each."""
    kinetic = sum(q.dot**2 for q in MANY) / 2
    free = lg.System(kinetic, (MANY[0] - MANY[1]) ** 2 / 2 + MANY[2] ** 2 / 2, coordinates=MANY)
    drag = 2 * (MANY[0].dot - MANY[4].dot) ** 2 + 3 * MANY[1].dot ** 2
    slow = lg.System(kinetic, sum(q**2 for q in MANY[:3]) / 2, dissipation=drag, coordinates=MANY)
    saddle = lg.System(kinetic, -sum(q**2 for q in MANY[1:]), dissipation=drag, coordinates=MANY)
    for system in (free, slow, saddle):
        result = system.modes()
        pairs = [
            complex(-d + s * I * f) for f, d in zip(result.frequencies, result.decay, strict=True) for s in (1, -1)
        ]
        apart = np.abs(np.array(pairs)[:, None] - np.array(result.eigenvalues))
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-7
    shapes = np.array([[complex(x) for x in shape] for shape in free.modes().shapes])
    assert np.linalg.matrix_rank(shapes) == 5
    assert np.allclose(np.array(free.modes().frequencies, complex), (0, 0, 0, 1, 2**0.5), atol=1e-7)


def well(**more: Any) -> lg.System:
    return lg.System(m * x.dot**2 / 2, k * x**2 / 2, **more)


def test_reasons_say_what_is_not_known() -> None:
    assert well(dissipation=-c * x.dot**4).modes().reason == (
        "the energy has a strict minimum there, but forces may feed energy in."
    )
    fed = well(forces={x: x.dot**3}, parameters={m: 1, k: 1})
    assert (
        fed.modes().reason
        == "eigenvalues on the imaginary axis do not decide on stability, and forces may feed energy in."
    )
    hill = plane(-k * (x**2 + y**2) / 2, turn=M)
    assert (
        hill.modes().reason
        == "the energy has no minimum there, so eigenvalues decide on stability: give values of all parameters."
    )


@pytest.mark.few
@pytest.mark.parametrize(
    ("system", "stable"),
    [
        (lambda: lg.System(m * x.dot**2 / 2, k * x**2 / 2), True),
        (lambda: lg.System(m * x.dot**2 / 2, -k * x**2 / 2), False),
        (lambda: lg.System(m * x.dot**2 / 2, k * x**4), None),
        (lambda: lg.System(m * x.dot**2 / 2, k * x**4, parameters={m: 1, k: 1}), None),
        (lambda: plane(k * (x**2 - y**2)), False),
        (lambda: plane(k * x**2 / 2), True),  # y is ignorable
        (lambda: plane(k * (x**2 + y**2), forces={x: c * y, y: -c * x}, parameters={m: 1, k: 1, c: 0.1}), False),
        (lambda: plane(k * (x**2 + y**2) * (2 + sin(lg.t)) - m * y, parameters={m: 1, k: 1}), "refused"),
        # D that C has nothing of: some of these feed energy in, and their amplitudes grow.
        (lambda: well(dissipation=c * x * x.dot**2), None),
        (lambda: plane(k * (x**2 + y**2), dissipation=y**3 * x.dot - x**3 * y.dot, parameters={m: 1, k: 1}), None),
        (lambda: well(dissipation=c * x.dot**4), True),
        # A negative mass turns what a minimum of the energy means.
    ],
)
def test_verdicts(system: Any, stable: Any) -> None:
    if stable == "refused":
        assert "there are no modes at this point. Away from equilibrium: the forc" in refusal(lambda: system().modes())
    else:
        assert system().modes().stable is stable


def test_time_that_cancels_from_the_energy_is_no_time() -> None:
    """A bead on a rotating hoop, stated by positions, has the energy of the system stated in its angle."""
    turning = (l * sin(theta) * cos(w * lg.t), l * sin(theta) * sin(w * lg.t), -l * cos(theta))
    values = {m: 1, g: 9.81, l: 1, w: 2}
    result = lg.System(lg.kinetic_energy(m, turning), m * g * turning[2], parameters=values).modes()
    assert (result.stable, result.reason) == (True, "the energy has a strict minimum there.")
    pushed = lg.System(
        m * l**2 * theta.dot**2 / 2, m * g * l * (1 + theta**4 * cos(w * lg.t)) * theta**2, parameters=values
    )
    assert pushed.modes().stable is None


def test_refusals() -> None:
    pendulum = lg.System(m * l**2 * theta.dot**2 / 2, -m * g * l * cos(theta))
    assert "there are no modes at this point. Away from equilibrium: the f" in refusal(pendulum.modes, {theta: pi / 3})
    driven = lg.System(m * x.dot**2 / 2, k * x**2 * (2 + sin(lg.t)))
    assert "the linear equations of system depend on time at this point, and ha" in refusal(driven.modes)
    assert driven.linearize().K[0, 0].has(lg.t)
    assert "unstable; frequencies" in repr(pendulum.modes({theta: pi}))
    assert pendulum.modes({theta: pi}).frequencies[0].is_imaginary
    assert pendulum.modes({theta: pi}).frequencies[0] / sqrt(g / l) == I


def test_a_wrong_frequency_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modes_module, "_root_of", lambda given: sqrt(given) * 1.001)
    with pytest.raises(RunError, match=r"the frequency .* is wrong: .* is not an eigenvalue of the linear equations\."):
        shared_scene("pendulum").modes()
    with pytest.raises(RunError, match="is wrong"):
        well().modes()


@pytest.mark.slow
def test_frequencies_are_written_short_and_have_the_right_values() -> None:
    turning = lg.System(
        kinetic=m * ((x.dot - w * y) ** 2 + (y.dot + w * x) ** 2) / 2, potential=k * (x**2 + y**2) / 2
    ).modes()
    # seen from a table that turns, the frequency sqrt(k/m) is shifted by that of the table
    natural = sqrt(k) / sqrt(m)
    for result, known in zip(turning.frequencies, (sympy.Abs(natural - w), natural + w), strict=True):
        assert sympy.simplify(result**2 - known**2) == 0 and sympy.count_ops(result) <= 10


def test_a_mass_of_zero_is_refused_in_a_sentence() -> None:
    massless = lg.System(m * l**2 * theta.dot**2 / 2, -m * g * l * cos(theta), parameters={m: 0, g: 9.81, l: 1})
    assert "the mass matrix is singular at these values of the parameters" in refusal(massless.modes)
    assert {item.stable for item in massless.equilibria()} == {None}


def test_modes_print_frequencies_with_one_root() -> None:
    angle, (mass, R, r, gravity) = lg.coordinate("angle"), lg.parameters("mass R r gravity")
    bowl = lg.System(
        sympy.Rational(3, 4) * mass * (R - r) ** 2 * angle.dot**2, -mass * gravity * (R - r) * sympy.cos(angle)
    )
    assert repr(bowl.modes()) == "<Modes: undecided; frequencies sqrt(2*gravity/(3*(R - r)))>"
    assert repr(bowl.modes().frequencies) == "(sqrt(2*gravity/(3*(R - r))),)"
    assert repr(pickle.loads(pickle.dumps(bowl.modes())).frequencies) == "(sqrt(2*gravity/(3*(R - r))),)"


@pytest.mark.slow
def test_shapes_with_roots_of_long_sums_need_no_radsimp(monkeypatch: pytest.MonkeyPatch) -> None:
    """SymPy's `radsimp` takes 8 s for such a shape."""
    monkeypatch.delattr(sympy, "radsimp")
    kinetic, potential = m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, k * (x**2 + 2 * y**2 + x * y) / 2 + m * g * z
    modes = lg.System(kinetic, potential, constraints=[z - x**2 + y**2 / 3]).modes({})
    root = sympy.sqrt(2) * sympy.sqrt(32 * g**2 * m**2 - 24 * g * k * m + 9 * k**2)
    shapes = [3 * k / (8 * g * m - 3 * k + sign * root) for sign in (-1, 1)]
    assert [sympy.simplify(shape[1] - form) for shape, form in zip(modes.shapes, shapes, strict=True)] == [0, 0]


# --- results of textbooks, matched as formulas: what a course of mechanics derives by hand ---------------------
# Landau is L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., 1976; Goldstein is H. Goldstein, C. Poole, J. Safko,
# Classical Mechanics, 3rd ed., 2002; Szebehely is V. Szebehely, Theory of Orbits, 1967.


R, q, B, mu = lg.parameters("R q B mu")
r, u, s, phi, theta1, theta2 = lg.coordinates("r u s phi theta1 theta2")


def same(result: Any, book: Any) -> bool:
    return bool(sympy.simplify(sympy.expand(result - book)) == 0)


def squares(system: lg.System, at: Any = None) -> list[Any]:
    return [sympy.simplify(frequency**2) for frequency in system.modes(at).frequencies]


def match(result: list[Any], book: list[Any]) -> None:
    assert len(result) == len(book)
    assert all(same(first, second) for first, second in zip(result, book, strict=True)), result


def test_double_pendulum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Landau, section 5, problem 1, and section 23, problem 2, with equal masses: w^2 = (2 -+ sqrt(2)) g/l."""
    monkeypatch.delattr(sympy, "radsimp")
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


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("potential", "place", "ratio"), [(-k / r, (k / (m * w**2)) ** Rational(1, 3), 1), (m * w**2 * r**2 / 2, R, 4)]
)
def test_nearly_circular_orbits_close(potential: Any, place: Any, ratio: int) -> None:
    """Goldstein, section 3.6 (Bertrand): radial and orbital frequencies are as 1 and as 2 in the two closed cases."""
    modes = central(potential).modes({r: place, phi.dot: w})
    assert any(same(f**2, ratio * w**2) for f in modes.frequencies), modes.frequencies


def test_spherical_pendulum() -> None:
    """Landau, section 14, problem 1: U_eff = M_z^2/(2 m l^2 sin^2) - m g l cos."""
    system = conical_pendulum()
    p = sympy.Symbol("p_phi", real=True)
    book = p**2 / (2 * m * l**2 * sin(theta) ** 2) - m * g * l * cos(theta)
    assert same(system.routhian(phi).statement.potential, book)
    form = system.hamiltonian()
    assert same(form.expression, form.momenta[theta] ** 2 / (2 * m * l**2) + book.subs(p, form.momenta[phi]))


def test_charge_in_a_field() -> None:
    """Landau, The Classical Theory of Fields, section 21: circles with q B/m; H = (p - q A)^2/2m."""
    charge = lg.System(lagrangian=m * (x.dot**2 + y.dot**2) / 2 + q * B * x * y.dot, coordinates=[x, y])
    form = charge.hamiltonian()
    p, n = form.momenta[x], form.momenta[y]
    assert same(form.expression, (p**2 + (n - q * B * x) ** 2) / (2 * m))
    match(squares(charge), [0, (q * B / m) ** 2])
    assert same(form.poisson(m * x.dot, m * y.dot), q * B)


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


def test_triangular_points() -> None:
    """Szebehely, section 5.4: (1/2 - mu, sqrt(3)/2) rests, with l^4 + l^2 + 27 mu (1 - mu)/4 = 0."""
    near, far = sqrt((x + mu) ** 2 + y**2), sqrt((x - 1 + mu) ** 2 + y**2)
    turning = (x.dot**2 + y.dot**2) / 2 + x * y.dot - y * x.dot + (x**2 + y**2) / 2
    bodies = lg.System(lagrangian=turning + (1 - mu) / near + mu / far, initial={x: 0.5, y: 1.0})
    lin = bodies.linearize({x: Rational(1, 2) - mu, y: sqrt(3) / 2})
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
