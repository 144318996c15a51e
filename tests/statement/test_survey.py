"""What an expression is made of, and what may not stand in it."""

from __future__ import annotations

from typing import Any

import pytest
import sympy

from lagrange.errors import StatementError
from lagrange.statement.coordinate import coordinates, parameters, t
from lagrange.statement.parameters import Survey
from tests.refusals import refusal

x, y = coordinates("x y")
m, k = parameters("m k")


def survey(*expressions: Any, **options: Any) -> Survey:
    found = Survey()
    for expression in expressions:
        found.add(expression, "the energy", **options)
    return found


def test_leaves_in_order_of_first_appearance() -> None:
    found = survey(m * y.dot**2, k * x**2 + sympy.sin(t * x.dot))
    assert list(found.coordinates) == [y, x]
    assert set(found.velocities) == {y.dot, x.dot}
    assert list(found.parameters) == [m, k]


def test_accelerations_only_where_they_are_asked_for() -> None:
    assert list(survey(x.ddot, accelerations=True).velocities) == [x.dot]
    with pytest.raises(StatementError, match="derivative of order 2 of x"):
        survey(x.ddot)
    with pytest.raises(StatementError, match="derivative of order 3 of x"):
        survey(x.diff(t, 3), accelerations=True)


@pytest.mark.parametrize(
    "expression",
    [
        sympy.Piecewise((x, x < 0), (sympy.pi, sympy.Or(x > 1, sympy.And(x > 2, x > y))), (0, True)),
        sympy.Max(x, y, 1) + sympy.Min(x, 2) + sympy.Abs(x) + sympy.sign(y),
        sympy.cot(x) + sympy.sec(x) + sympy.csc(x) + sympy.atan2(x, y) + sympy.exp(x) + sympy.log(y),
        x ** sympy.Rational(1, 3) + 2**x + x**y + sympy.E,
        sympy.Integer(3),
        sympy.Float(0.5),
    ],
)
def test_what_is_supported(expression: Any) -> None:
    survey(expression)


def test_long_and_shared_expressions_are_walked_once() -> None:
    shared: Any = x
    for _ in range(300):
        shared = sympy.Mul(sympy.Add(shared, shared, evaluate=False), 2, evaluate=False)  # 2**300 parts as a tree
    assert list(survey(shared).coordinates) == [x]


def test_deep_expressions_are_walked_without_recursion() -> None:
    deep: Any = x
    for i in range(2000):
        deep = sympy.Add(sympy.Mul(deep, i + 2, evaluate=False), 1, evaluate=False)
    assert list(survey(deep).coordinates) == [x]


REFUSALS = [
    (sympy.Function("é")(x), "'é' cannot name a function"),
    (sympy.Function("é")(t), "'é' cannot name a coordinate"),
    (sympy.Derivative(x * y, t), "a derivative that is not evaluated. Call .doit() on it, or write it out."),
    (sympy.Derivative(x, m, evaluate=False), "a derivative that is not evaluated"),
    (x.ddot, "the energy contains the derivative of order 2 of x. Only coordinates and velocities may stand there"),
    (sympy.I * x, "the energy contains the imaginary unit I. Energies and forces are real: write real expressions."),
    (sympy.zoo, "the energy contains zoo, which is not a finite number: check for a division by zero."),
    (sympy.Pow(0, -1, evaluate=False), "the energy contains 1/0: check for a division by zero."),
    (sympy.oo, "the energy contains oo, which is not a finite number"),
    (sympy.Add(x, -sympy.oo, evaluate=False), "the energy contains -oo, which is not a finite number"),
    (sympy.nan, "the energy contains nan, which is not a finite number"),
    (sympy.gamma(x), "the energy contains gamma in 'gamma(x(t))', which is not supported. The functions are sin, cos,"),
    (sympy.Integral(x, t), "the energy contains Integral in 'Integral(x(t), t)', which is not supported."),
    (sympy.erfc(x), "erfc"),
    (sympy.re(x), "the energy contains re in 're(x(t))', which is not supported."),
]


@pytest.mark.parametrize(("expression", "message"), REFUSALS, ids=lambda case: str(case)[:24])
def test_refusals(expression: Any, message: str) -> None:
    assert message in refusal(survey, expression)
