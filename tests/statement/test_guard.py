"""Bounds on what SymPy is asked to compute."""

from __future__ import annotations

from typing import Any

import pytest
import sympy

from lagrange.statement.coordinate import coordinates
from lagrange.statement.scene.guard import CHUNK, Guard, RefusalError, replaced

a, b = sympy.symbols("a b", real=True)
x, y = coordinates("x y")


@pytest.mark.parametrize("build", [sympy.Add, sympy.Mul])
def test_long_chains_are_joined_in_chunks_to_the_same_result(build: Any) -> None:
    parts = [sympy.Symbol(f"s{i % 70}", real=True) ** (i % 3 + 1) for i in range(3 * CHUNK + 7)]
    assert Guard().join(build, parts) == build(*parts)
    assert Guard().join(build, [a, b]) == build(a, b)


def test_coefficients_are_checked_between_chunks() -> None:
    parts = [a / (10**30 + i) for i in range(20 * CHUNK)]
    with pytest.raises(RefusalError, match="longer than 77 digits"):
        Guard().join(sympy.Add, parts)


@pytest.mark.parametrize(
    "expression",
    [
        *(a * b + 2 * b + sympy.Rational(1, 3), sympy.sin(b) * sympy.cos(a) ** 2 / (a + b) ** sympy.Rational(3, 2)),
        *(-2 * (a + b) * b, sympy.Max(a, b, 1) - sympy.Abs(b - a), sympy.atan2(b, a) * sympy.exp(-a)),
        *(sympy.Piecewise((a, a < b), (b, sympy.And(a > 1, b > 2)), (1, True)), a, sympy.pi, sympy.Integer(2)),
    ],
)
def test_replacing_gives_what_sympy_builds(expression: Any) -> None:
    table = {a: y, b: x.dot}  # in the other order: y(t) is sorted after Derivative(x(t), t)
    assert replaced(expression, dict(table)) == expression.xreplace(table)
    assert hash(replaced(expression, dict(table))) == hash(expression.xreplace(table))


def test_replacing_evaluates_nothing() -> None:
    assert replaced(sympy.Abs(a), {a: x}) == sympy.Abs(x)
    assert replaced(sympy.sqrt(a), {a: x**2}) == sympy.Pow(x**2, sympy.Rational(1, 2), evaluate=False)
    assert replaced(a - b, {a: x, b: x}) != 0
