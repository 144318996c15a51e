"""The algebra of the textbook derivation: each rule, and values unchanged by all rules."""

from itertools import chain
from typing import Any

import mpmath
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy import Max, Min, Rational, Symbol, cos, exp, sin, sqrt

from lagrange.equations.collect import SumWriter
from lagrange.equations.solve_plan import NestedCofactors, vanishes
from lagrange.equations.terms import Algebra, TooLargeError, common_factor, differentiable
from tests.covering import examples

x, y, z = (Symbol(name, real=True) for name in "xyz")
a, b = (Symbol(name, positive=True) for name in "ab")


def merged(expression: Any) -> Any:
    algebra = Algebra(10_000)
    return algebra.write(algebra.merge_angles(algebra.read(expression)))


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        (sqrt((a * cos(x)) ** 2 + (a * sin(x)) ** 2), a),
        ((a + x) ** 2 - x**2 - 2 * a * x, a**2),
        (x / (2 * x + 2 * y) - x / (x + y) / 2, 0),
        (1 / (x - y) + 1 / (y - x), 0),
        (a / (a * sin(x) ** 2 + a * cos(x) ** 2), 1),
        (1 / (a + a * x) ** 2 - 1 / (1 + x) ** 2 / a**2, 0),
    ],
)
def test_merging(stated: Any, expected: Any) -> None:
    assert merged(stated) == expected


def test_common_factor() -> None:
    algebra = Algebra(100)
    number, monomial, rest = common_factor(algebra.read(-4 * a * x**2 - 6 * a**2 * x / y))
    assert (number, algebra.power(monomial), algebra.write(rest)) == (-2, a * x / y, 2 * x * y + 3 * a)
    assert common_factor({}) == (1, (), {})


@pytest.mark.parametrize("kinked", [Max(x, 2 * y, 1), Min(x, 2 * y, 1)])
def test_extremes_keep_their_values(kinked: Any) -> None:
    smooth = differentiable(kinked)
    assert not smooth.has(Max, Min)
    for point in ({x: 3, y: 1}, {x: 0, y: 2}, {x: -5, y: -4}, {x: 2, y: 1}):
        assert smooth.subs(point) == kinked.subs(point)


ATOMS = st.sampled_from(
    [x, y, a, b, sin(x), cos(x), sin(y), cos(y), sin(x - y), exp(x), sqrt(1 + x**2), sympy.Integer(2), Rational(-1, 3)]
)
EXPRESSIONS = st.recursive(
    ATOMS,
    lambda inner: st.one_of(
        st.lists(inner, min_size=2, max_size=3).map(lambda parts: sympy.Add(*parts)),
        st.lists(inner, min_size=2, max_size=3).map(lambda parts: sympy.Mul(*parts)),
        inner.map(lambda part: part**2),
    ),
    max_leaves=10,
)
POINT = {x: Rational(7, 10), y: Rational(-13, 10), a: Rational(3, 2), b: Rational(2, 5)}


def number(expression: Any) -> Any:
    return sympy.N(expression.subs(POINT), 40)


@settings(max_examples=examples(60))
@given(EXPRESSIONS)
def test_every_way_of_writing_keeps_value_and_slope(expression: Any) -> None:
    algebra = Algebra(1_000_000)
    terms = algebra.read(expression)
    value = number(expression)
    size = mpmath.mpf(10) ** -30 * (1 + abs(value))
    collector = SumWriter(algebra, frozenset((x, y)), frozenset((x, y)))
    for written in (terms, algebra.merge_angles(terms), algebra.unfold(terms)):
        assert abs(number(algebra.write(written)) - value) < size * 1000
        assert abs(number(collector.write(written)) - value) < size * 1000
    slope = number(sympy.diff(expression, x))
    assert abs(number(algebra.write(algebra.differentiate(terms, x))) - slope) < mpmath.mpf(10) ** -25 * (
        1 + abs(slope)
    )


def test_budget_is_kept_and_given_back() -> None:
    algebra = Algebra(50)
    with pytest.raises(TooLargeError), algebra.at_most(10):
        algebra.read((1 + x) * (1 + y) * (1 + z) * (a + b))
    assert 35 <= algebra.budget <= 40
    with pytest.raises(TooLargeError):
        algebra.spend(41)


def test_wide_products_stay_products() -> None:
    width = sympy.Add(*(sin(i * x) for i in range(50)))
    algebra = Algebra(10_000)
    assert len(algebra.read(width * width.subs(x, y) * (1 + a))) == 1


def test_nested_cofactors_solve_and_know_when_to_stop() -> None:
    n = 4
    matrix = [[Symbol(f"m{min(i, j)}{max(i, j)}") for j in range(n)] for i in range(n)]
    bias = [Symbol(f"h{i}") for i in range(n)]
    values = {symbol: Rational(3 * i + 1, i + 2) for i, symbol in enumerate(sorted({*chain(*matrix), *bias}, key=str))}
    solved = [entry.subs(values) for entry in NestedCofactors(matrix, bias, 10_000).solution()]
    assert list(sympy.Matrix(matrix).subs(values) * sympy.Matrix(solved)) == [entry.subs(values) for entry in bias]
    with pytest.raises(TooLargeError):
        NestedCofactors(matrix, bias, 50).solution()


def test_vanishing_determinants() -> None:
    assert vanishes([[a, a * cos(x)], [a * cos(x), a - a * sin(x) ** 2]])
    assert not vanishes([[a, a * cos(x)], [a * cos(x), a]])
