"""Quotients are cancelled and sums collected, as in a textbook, without a change of value."""

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import Rational, Symbol, cos, sign, sin, sqrt

import lagrange as lg
from lagrange.equations.collect import cancelled, shortened
from lagrange.equations.derivation import derive
from lagrange.equations.terms import Algebra, common_factor

theta, x, y = lg.coordinates("theta x y")
m, g, R, a, c, k, M = lg.parameters("m g R a c k M")
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
l = lg.parameters("l")


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
