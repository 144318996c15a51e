"""Lengths along a line in equations of motion: no sign of a quantity stands beside its magnitude."""

from __future__ import annotations

from typing import Any

import pytest
import sympy
from sympy import cos, sign

import lagrange as lg
from lagrange.equations.derivation import derive

theta, x, r = lg.coordinates("theta x r")
k, l, m = lg.parameters("k l m")


@pytest.mark.parametrize(
    ("place", "force"), [(x, k * x - k * l * sign(x)), (l * cos(theta), None), (x * cos(theta), None)]
)
def test_a_spring_along_a_line_has_no_sign_beside_a_magnitude(place: sympy.Expr, force: sympy.Expr | None) -> None:
    potential = lg.spring(k, (place, 0), None, l)
    system = lg.System(kinetic=m * (l**2 * theta.dot**2 + x.dot**2) / 2, potential=potential, coordinates=[theta, x])
    for q, equation in zip(system.coordinates, system.equations(), strict=True):
        left = equation.lhs
        for product in left.atoms(sympy.Mul):
            marks = {f.args[0] for f in product.args if isinstance(f, sympy.Abs)}
            assert not marks & {f.args[0] for f in product.args if isinstance(f, sign)}, left
        # by number, on both sides of the kink, against the difference quotient of the stated potential
        for values in ({theta: 0.4, x: 0.7}, {theta: 2.5, x: -0.7}):
            h = 1e-6
            ends = [potential.subs(values | {q: values[q] + step, k: 3, l: 2}) for step in (-h, h)]
            slope = float((ends[1] - ends[0]) / (2 * h))
            ours = left.subs({q.dot.diff(lg.t): 0 for q in (theta, x)}).subs(values | {k: 3, l: 2, m: 1})
            assert float(ours) == pytest.approx(slope, abs=1e-8)  # rounding over h, and h**2 of a smooth function
    if force is not None:
        assert sympy.expand(system.equations()[1].lhs - m * x.ddot - force) == 0


POLAR = (r * cos(theta), r * sympy.sin(theta))


@pytest.mark.parametrize(
    ("potential", "shown", "slope"),
    [
        (lg.spring(k, POLAR, rest_length=l), k * (sympy.Abs(r) - l) ** 2 / 2, k * r - k * l * sign(r)),
        (-k / sympy.sqrt(POLAR[0] ** 2 + POLAR[1] ** 2), -k / sympy.Abs(r), k * sign(r) / r**2),
        (k * sympy.sqrt(r**2) ** 3, k * sympy.Abs(r) ** 3, 3 * k * r * sympy.Abs(r)),
        (lg.spring(k, (x, 0), (r, 0), l), k * (sympy.Abs(r - x) - l) ** 2 / 2, k * (r - x) - k * l * sign(r - x)),
    ],
)
def test_the_root_of_a_square_is_a_magnitude_in_the_derivation(potential: Any, shown: Any, slope: Any) -> None:
    kinetic = m * (r.dot**2 + r**2 * theta.dot**2 + x.dot**2) / 2
    page = lg.System(kinetic, potential, coordinates=[r, theta, x]).statement
    derivation = derive(page)
    real = {symbol: sympy.Symbol(str(symbol), real=True) for symbol in page.plain.values()}

    def in_reals(expression: Any) -> Any:
        return expression.xreplace(page.plain).xreplace(real)

    assert sympy.expand(in_reals(derivation.potential) - in_reals(shown)) == 0
    assert sympy.expand(in_reals(derivation.gradient[r] + slope - m * r * theta.dot**2)) == 0
