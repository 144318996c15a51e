"""The gate to SymPy: what becomes an expression, and what is refused before SymPy sees it."""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.errors import shown
from lagrange.statement.coordinate import coordinate
from lagrange.statement.expression import entries, expression, vector
from tests.refusals import refusal

x = coordinate("x")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (x, x),
        (2, sympy.Integer(2)),
        (np.int64(2), sympy.Integer(2)),
        (Fraction(1, 3), sympy.Rational(1, 3)),
        (0.5, sympy.Float(0.5)),
        (np.array(x, dtype=object), x),
        (np.array(2.0), sympy.Float(2.0)),
    ],
)
def test_expressions_and_numbers(value: Any, expected: Any) -> None:
    assert expression(value, "m") == expected


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("x", "m is the text 'x': give a SymPy expression; texts belong in a scene file."),
        (b"x", "m is the text b'x'"),
        (np.str_("x"), "m is the text"),
        (np.array("x"), "m is the text"),
        (["x"], "m is ['x'] (list): give one SymPy expression."),
        (sympy.Matrix([[x, 1], [2, 3]]), "m is a matrix of shape (2, 2): give a scalar, such as its entry [0, 0]."),
        (sympy.MatrixSymbol("A", 2, 2), "m is a matrix of shape (2, 2)"),
        (sympy.Eq(x, 1), "m is Eq(x(t), 1), which has no value"),
        (sympy.Lambda(sympy.Symbol("u"), 1), "which has no value"),
        (sympy.true, "m is True, which has no value"),
        (True, "m is True (bool): give a number."),
        (None, "m is None (NoneType): give a number."),
        (10**5000, "m is too large for a floating-point number"),
    ],
    ids=lambda case: type(case).__name__,
)
def test_what_is_no_expression(value: Any, words: str) -> None:
    assert words in refusal(expression, value, "m")


@pytest.mark.parametrize(
    "value",
    [[x, 1], (x, 1), np.array([x, 1]), sympy.Matrix([x, 1]), sympy.Matrix([[x, 1]]), sympy.Array([x, 1]),
     sympy.Tuple(x, 1), (part for part in (x, 1))],
)  # fmt: skip
def test_vectors(value: Any) -> None:
    assert vector(value, "the position") == [x, 1]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("x", "the position is the text 'x': give SymPy expressions."),
        ([x, "y"], "component 1 of the position is the text 'y'"),
        (np.array(["x"]), "component 0 of the position is the text 'x'"),
        (np.array([x, "y"], object), "component 1 of the position is the text 'y'"),
        (map(str, [1]), "component 0 of the position is the text '1'"),
        ([[x]], "component 0 of the position is [x(t)] (list): give one SymPy expression."),
        ({x: 1}, "the position is a dict, which has no order: give a list."),
        ({x}, "the position is a set, which has no order: give a list."),
        (np.ma.array([1.0]), "the position is a masked array: give the values alone."),
        (np.zeros((2, 2, 2)), "the position has shape (2, 2, 2): give a vector, or a matrix"),
        (itertools.count(), "the position has more than 10000 entries: give fewer."),
        (sympy.Matrix([[x, 1], [1, x]]), "component 0 of the position is [x(t), 1] (list)"),
    ],
)
def test_what_is_no_vector(value: Any, words: str) -> None:
    assert words in refusal(vector, value, "the position")


def test_what_holds_nothing_is_told_from_what_is_no_container() -> None:
    assert entries([], "links") == []
    assert entries(x, "links") is None
    assert entries(3.0, "links") is None


class Hostile:
    def __repr__(self) -> str:
        raise ValueError


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (10**5000, "a whole number of about 5001 digits"),
        (10**9, "1000000000"),
        ("a" * 1000, "..."),
        ([0.0] * 10**6, "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ...]"),
        (Hostile(), "<Hostile instance at"),
        (np.zeros((2, 1)), "array([[0.], [0.]])"),
    ],
    ids=lambda case: type(case).__name__,
)
def test_any_value_can_be_shown(value: Any, words: str) -> None:
    assert words in shown(value)
    assert len(shown(value)) <= 82
