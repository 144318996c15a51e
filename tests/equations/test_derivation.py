"""The textbook derivation: printed results, refusals, and quotients and sums as in a textbook."""

import itertools
from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Abs, Float, Heaviside, Max, Min, Rational, Symbol, cos, sign, sin, sqrt

import lagrange as lg
from lagrange.equations import derivation as module
from lagrange.equations import textbook_algebra
from lagrange.equations.collect import cancelled, shortened
from lagrange.equations.derivation import derive
from lagrange.equations.terms import Algebra, common_factor
from lagrange.errors import StatementError
from lagrange.show.notebook.shown_derivation import written_derivation
from lagrange.statement.coordinate import acceleration_of, coordinate, coordinates, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.energy import gravity, kinetic_energy
from tests.models import chain
from tests.refusals import refusal
from tests.textbook.systems import value

m, g, l, k, m1, m2, c = parameters("m g l k m1 m2 c")
theta, phi, psi, x, y = coordinates("theta phi psi x y")


def left_sides(**stated: Any) -> list[Any]:
    return [equation.lhs for equation in derive(declare(**stated)).equations]


# --- what a book prints ------------------------------------------------------------------------------------------


def test_pendulum_in_cartesian_positions_reads_as_in_the_book() -> None:
    bob = (l * sin(theta), -l * cos(theta))
    derivation = derive(declare(kinetic=kinetic_energy(m, bob), potential=gravity(m, bob, g)))
    assert derivation.lagrangian == m * l**2 * theta.dot**2 / 2 + m * g * l * cos(theta)
    assert derivation.equations[0].lhs == m * l**2 * theta.ddot + m * g * l * sin(theta)
    assert derivation.equations[0].rhs == 0
    assert derivation.momenta == {theta: m * l**2 * theta.dot}
    assert derivation.mass_matrix == sympy.Matrix([[m * l**2]])
    assert derivation.energy == m * l**2 * theta.dot**2 / 2 - m * g * l * cos(theta)
    assert derivation.accelerations == {theta: -g * sin(theta) / l}


def test_sums_of_lengths_stay_together() -> None:
    bob = ((l + x) * sin(theta), -(l + x) * cos(theta))
    stated = {
        "kinetic": kinetic_energy(m, bob),
        "potential": gravity(m, bob, g) + k * x**2 / 2,
        "coordinates": [x, theta],
    }
    assert left_sides(**stated) == [
        m * x.ddot - m * (l + x) * theta.dot**2 - m * g * cos(theta) + k * x,
        m * (l + x) ** 2 * theta.ddot + 2 * m * (l + x) * theta.dot * x.dot + m * g * (l + x) * sin(theta),
    ]
    (solved,) = [derive(declare(**stated)).accelerations[theta]]
    assert str(solved) == "-(g*sin(theta(t)) + 2*Derivative(theta(t), t)*Derivative(x(t), t))/(l + x(t))"


FREE = {"kinetic": m * x.dot**2 / 2}
MAGNETIC = m * (x.dot**2 + y.dot**2) / 2 + c * (x * y.dot - y * x.dot) / 2
GROWING = m * sympy.exp(t) * x.dot**2 / 2 + c * sin(t) * x.dot


@pytest.mark.parametrize(
    ("stated", "lefts"),
    [
        ({"lagrangian": MAGNETIC, "coordinates": [x, y]}, [m * x.ddot - c * y.dot, m * y.ddot + c * x.dot]),
        ({"lagrangian": GROWING}, [m * sympy.exp(t) * x.ddot + m * sympy.exp(t) * x.dot + c * cos(t)]),
        # Functions that are not smooth: signs, no impulses and no derivative that is not evaluated.
        ({**FREE, "potential": k * Abs(x - l)}, [m * x.ddot + k * sign(x - l)]),
        ({**FREE, "dissipation": c * Abs(x.dot) ** 3 / 3}, [m * x.ddot + c * Abs(x.dot) * x.dot]),
        ({**FREE, "potential": k * Heaviside(x - l) * x**2 / 2}, [m * x.ddot + k * x * Heaviside(x - l)]),
        ({**FREE, "potential": k * Abs(sympy.log(x))}, [m * x.ddot + k * sign(sympy.log(x)) / x]),
    ],
)
def test_left_sides(stated: dict[str, Any], lefts: list[Any]) -> None:
    assert left_sides(**stated) == lefts


def test_decimals_stay_decimals_and_halves_halves() -> None:
    (left,) = left_sides(kinetic=0.5 * m * x.dot**2, potential=9.81 * m * x, dissipation=0.1 * x.dot**2)
    assert left == m * x.ddot + Float(9.81) * m + Rational(1, 5) * x.dot
    (equation,) = derive(declare(kinetic=x.dot**2 / 2, potential=(0.1 + 0.2 - 0.3) * x**2 + 6.674e-11 * x)).equations
    assert float(equation.lhs.coeff(acceleration_of(x))) == 1
    assert "6.674e-11" in str(equation)


# --- functions that are not smooth --------------------------------------------------------------------------------


def test_second_derivatives_of_kinks_have_no_delta() -> None:
    kinetic = (
        m * (1 + Abs(x)) * x.dot**2 / 2 + m * sign(y) * x.dot * y.dot + m * (2 + Max(x, y, 0) + Min(x, 1)) * y.dot**2
    )
    statement = declare(kinetic=kinetic, coordinates=[x, y])
    for equation in derive(statement).equations:
        assert not equation.has(sympy.DiracDelta, sympy.Heaviside, sympy.re, sympy.im)
        assert not equation.atoms(sympy.Subs)
    values = {"q": (0.7, -0.4), "v": (1.0, 2.0)}
    statement = declare(kinetic=kinetic, coordinates=[x, y], parameters={m: 2.0})
    result = value(derive(statement).mass_matrix[1, 1], statement, values["q"], values["v"], 0.0)
    assert result == pytest.approx(2 * 2.0 * (2 + 0.7 + 0.7))


# --- solving -------------------------------------------------------------------------------------------------------


def test_a_pivot_that_vanishes_does_no_harm() -> None:
    derivation = derive(declare(lagrangian=x.dot * y.dot + theta.dot**2 / 2 - x * y, coordinates=[x, y, theta]))
    assert derivation.accelerations == {x: -x, y: -y, theta: 0}


# --- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_long_formulas_are_refused_and_point_elsewhere() -> None:
    derivation = derive(chain(9))
    assert len(derivation.equations) == 9
    assert refusal(lambda: derivation.accelerations) == (
        "chain of 9 is too large for the solved accelerations to be written out in symbols (coordinates: a0, a1, a2, "
        "a3, a4, a5, a6, a7, ...). compile() gives the same as numbers, of any size; equations() gives the equations "
        "before they are solved."
    )


def test_a_spent_budget_refuses_in_words_and_leaves_the_other_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BUDGET", 20)
    derivation = derive(chain(2))
    with pytest.raises(
        StatementError, match=r"^chain of 2 is too large for the equations of motion to be written out in"
    ):
        _ = derivation.equations
    monkeypatch.undo()
    assert len(derivation.equations) == 2


@pytest.mark.parametrize(
    ("kinetic", "names"),
    [
        (m * (x.dot + y.dot) ** 2 / 2, "x and y"),
        (m * (x.dot * cos(theta) + y.dot * sin(theta)) ** 2 / 2 + m * theta.dot**2, "x and y"),
        (m * sum((x.dot + j * y.dot + j**2 * theta.dot + phi.dot) ** 2 for j in range(3)), "x, y, theta and phi"),
    ],
)
def test_singular_mass_matrix_is_refused_by_name(kinetic: Any, names: str) -> None:
    statement = declare(kinetic=kinetic, coordinates=[q for q in (x, y, theta, phi) if kinetic.has(q.dot)])
    assert refusal(lambda: derive(statement).accelerations) == (
        f"the mass matrix of {names} is singular at every state, so the accelerations are not determined: give each "
        "coordinate inertia of its own in the kinetic energy, or state fewer coordinates."
    )


def test_nesting_too_deep_for_sympy_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def too_deep(expression: Any) -> Any:
        raise RecursionError

    monkeypatch.setattr(textbook_algebra, "differentiable", too_deep)
    assert "is too large for the equations of motion to be written out" in refusal(left_sides, kinetic=x.dot**2 / 2)


def test_forces_between_all_pairs_are_refused_before_they_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """The derivation shows the statement and one sentence, since the derivatives of 1,225 pairs would take minutes."""
    places = [coordinates(f"x{i} y{i}") for i in range(5)]
    pairs = itertools.combinations(places, 2)
    system = lg.System(
        sum(q.dot**2 for place in places for q in place) / 2,
        -sum(1 / sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) for a, b in pairs),
        coordinates=[q for place in places for q in place],
    )
    assert not derive(system.statement).refusal
    monkeypatch.setattr(textbook_algebra, "LONGEST_SLOPES", 100)
    refused = derive(system.statement)
    monkeypatch.setattr(refused._page.algebra, "differentiate", None)
    with pytest.raises(StatementError, match="too large for the derivatives of the Lagrangian to be written out"):
        _ = refused.gradient
    text = str(written_derivation(system.statement))
    assert text.count("Not written out: ") == 1 and "\nStated\n" in text and "Coordinate" not in text


def test_the_shorter_of_the_collected_and_the_stated_form_is_shown() -> None:
    """As in a textbook, I3*(psi' + phi'*cos(theta)) and k*(s - d)**2/2 are not expanded."""
    phi, theta, psi = coordinates("phi theta psi")
    i1, i3, k, d, m = parameters("I1 I3 k d m")
    spin = psi.dot + phi.dot * cos(theta)
    kinetic = i1 * (theta.dot**2 + phi.dot**2 * sin(theta) ** 2) / 2 + i3 * spin**2 / 2
    top = lg.System(kinetic, coordinates=[phi, theta, psi])
    assert top.momenta[psi] == i3 * spin
    assert top.equations()[2].lhs == i3 * (psi.ddot + phi.ddot * cos(theta) - phi.dot * theta.dot * sin(theta))
    s = coordinate("s")
    spring = lg.System(m * s.dot**2 / 2, k * (s - d) ** 2 / 2)
    assert (
        spring.potential.has((s - d) ** 2, (d - s) ** 2) and sympy.expand(spring.potential - k * (s - d) ** 2 / 2) == 0
    )
    assert spring.equations()[0].lhs == m * s.ddot + k * (s - d)


def test_no_common_denominator_is_made_of_what_was_stated_apart() -> None:
    """The energy of a pulley is not printed as (I + M*R**2)*v**2/(2*R**2)."""
    x, (m1, m2, inertia, R, g) = coordinate("x"), parameters("m1 m2 I R g")
    kinetic = (m1 + m2) * x.dot**2 / 2 + inertia * x.dot**2 / (2 * R**2)
    derivation = derive(declare(kinetic=kinetic, potential=(m2 - m1) * g * x))
    assert derivation.kinetic == kinetic and derivation.energy == kinetic + (m2 - m1) * g * x


# --- quotients are cancelled and sums collected, as in a textbook, without a change of value -------------------


R, a, M = lg.parameters("R a M")
p, q, r, s = (Symbol(name, positive=True) for name in "pqrs")


def test_quotients_are_cancelled() -> None:
    system = lg.System(
        Rational(3, 4) * m * (R - a) ** 2 * theta.dot**2,
        -m * g * (R - a) * cos(theta),
        parameters={m: 1, g: 1, R: 2, a: 1},
    )
    page = system.derivation().unicode()
    assert "    (3/2) m (R − a)² θ̈ + m g (R − a) sin θ = 0\n" in page
    assert "    θ̈ = −(2 g/(3 (R − a))) sin θ\n" in page


def test_a_cylinder_on_a_cart_keeps_its_difference_of_radii() -> None:
    place = (x + (R - a) * sin(theta), -(R - a) * cos(theta))
    system = lg.System(
        M * x.dot**2 / 2 + lg.kinetic_energy(m, place), lg.gravity(m, place, g), parameters={m: 1, M: 1, R: 2, a: 1}
    )
    page = system.derivation().unicode()
    assert "((R − a) (M + m sin² θ))" in page and "a − R" not in page


def test_roots_that_differ_by_whole_powers_are_put_together() -> None:
    system = lg.System(lagrangian=-m * c**2 * sqrt(1 - x.dot**2 / c**2) - k * x**2 / 2)
    page = system.derivation().unicode()
    assert "    m ẍ/(1 − ẋ²/c²)^(3/2) + k x = 0\n" in page
    assert "    ẍ = −(k/m) x (1 − ẋ²/c²)^(3/2)\n" in page
    assert "    E = m c²/√(1 − ẋ²/c²) + ½ k x²\n" in page


@pytest.mark.parametrize(
    ("above", "below", "expected"),
    [
        (p**2 - q**2, p**2 - 2 * p * q + q**2, (2, 2)),
        (r * p - r * q + s * p - s * q, p**2 - q**2, (2, 2)),
        (p * r + q * s, p**2 - q**2, (2, 2)),
        (p + q, p + q, (1, 1)),
        ((p + q) * sqrt(r) * 3, (p + q) * (r + s), (1, 2)),
        (p**3 + q**3, p + q, (3, 1)),
    ],
)
def test_what_is_cancelled(above: Any, below: Any, expected: tuple[int, int]) -> None:
    algebra = Algebra(100_000)
    first, second = algebra.read(above), common_factor(algebra.read(below))[2]
    short, under = cancelled(first, second)
    assert (len(short), len(under)) == expected
    before, after = (algebra.write(up) / algebra.write(down) for up, down in ((first, second), (short, under)))
    assert sympy.cancel(before - after) == 0


@pytest.mark.parametrize(
    ("expression", "terms"),
    [
        (c**2 * (1 - p**2 / c**2) ** Rational(-1, 2) + p**2 * (1 - p**2 / c**2) ** Rational(-3, 2), 1),
        (r * p**2 / (p**2 + q**2) + r * q**2 / (p**2 + q**2), 1),
        (r * p**2 / sqrt(p**2 + q**2) - r * sqrt(p**2 + q**2), 1),
        (r / (p + q) + s / (p + q), 2),
        (p / (p + q) + q * s / (p + q), 2),
        (p**2 * (p + q) ** Rational(-3, 2) - q**2 * (p + q) ** Rational(-3, 2), 2),
    ],
)
def test_what_is_put_together(expression: Any, terms: int) -> None:
    algebra = Algebra(100_000)
    before = algebra.read(expression)
    after = shortened(algebra, before)
    assert len(after) == terms
    point = dict(zip((p, q, r, s, c), (Rational(1, 3), Rational(2, 7), 5, 3, 11), strict=True))
    assert abs(sympy.N((algebra.write(after) - expression).xreplace(point), 30)) < 1e-25


def test_random_sums_keep_their_value() -> None:
    draw = np.random.default_rng(5)
    base = p**2 + q**2 - r
    for _ in range(30):
        powers = [Rational(int(draw.integers(-4, 3)), int(draw.integers(1, 3))) for _ in range(4)]
        factors = [p ** int(i) * q ** int(j) for i, j in draw.integers(0, 4, (4, 2))]
        expression = sum(int(draw.integers(-3, 4)) * f * base**e for f, e in zip(factors, powers, strict=True))
        algebra = Algebra(100_000)
        after = algebra.write(shortened(algebra, algebra.read(sympy.S.Zero + expression)))
        point = {p: Rational(3, 2), q: Rational(5, 3), r: Rational(1, 7)}
        assert abs(sympy.N((after - expression).xreplace(point), 30)) < 1e-24


# --- Lengths along a line in equations of motion ---


rho = lg.coordinate("rho")


POLAR = (rho * cos(theta), rho * sympy.sin(theta))


@pytest.mark.parametrize(
    ("potential", "shown", "slope"),
    [
        (lg.spring(k, POLAR, rest_length=l), k * (sympy.Abs(rho) - l) ** 2 / 2, k * rho - k * l * sign(rho)),
        (-k / sympy.sqrt(POLAR[0] ** 2 + POLAR[1] ** 2), -k / sympy.Abs(rho), k * sign(rho) / rho**2),
        (k * sympy.sqrt(rho**2) ** 3, k * sympy.Abs(rho) ** 3, 3 * k * rho * sympy.Abs(rho)),
        (
            lg.spring(k, (x, 0), (rho, 0), l),
            k * (sympy.Abs(rho - x) - l) ** 2 / 2,
            k * (rho - x) - k * l * sign(rho - x),
        ),
    ],
)
def test_the_root_of_a_square_is_a_magnitude_in_the_derivation(potential: Any, shown: Any, slope: Any) -> None:
    kinetic = m * (rho.dot**2 + rho**2 * theta.dot**2 + x.dot**2) / 2
    page = lg.System(kinetic, potential, coordinates=[rho, theta, x]).statement
    derivation = derive(page)
    real = {symbol: sympy.Symbol(str(symbol), real=True) for symbol in page.plain.values()}

    def in_reals(expression: Any) -> Any:
        return expression.xreplace(page.plain).xreplace(real)

    assert sympy.expand(in_reals(derivation.potential) - in_reals(shown)) == 0
    assert sympy.expand(in_reals(derivation.gradient[rho] + slope - m * rho * theta.dot**2)) == 0
