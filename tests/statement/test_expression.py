"""The conversion to SymPy expressions, and values that are refused before SymPy reads them."""

import itertools
from array import array
from collections import deque
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.errors import shown
from lagrange.statement.coordinate import coordinate
from lagrange.statement.expression import entries, expression, flag, real_array, real_number, vector
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
    "value",
    [[x, 1], (x, 1), np.array([x, 1]), sympy.Matrix([x, 1]), sympy.Matrix([[x, 1]]), sympy.Array([x, 1]),
     sympy.Tuple(x, 1), (part for part in (x, 1))],
)  # fmt: skip
def test_vectors(value: Any) -> None:
    assert vector(value, "the position") == [x, 1]


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


# --- Numbers from users ---


@pytest.mark.parametrize(
    "value",
    [
        *(1.5, Fraction(3, 2), np.float64(1.5), np.float32(1.5), np.array(1.5), sympy.Rational(3, 2)),
        *(sympy.Float(1.5), sympy.sqrt(sympy.Rational(9, 4))),
    ],
)
def test_numbers_of_every_kind(value: Any) -> None:
    assert real_number(value, "m") == 1.5 and type(real_number(value, "m")) is float
    assert real_number(np.int64(2), "m") == real_number(2, "m") == 2.0 and flag(np.bool_(1), "progress") is True


@pytest.mark.parametrize(
    "value",
    [
        deque([1, 2]),
        memoryview(array("d", [1, 2])),
        (1.0, 2),
        np.array([1, 2]),
        np.array([1.0, 2.0], ">f8"),
        range(1, 3),
        [np.float64(1), np.int8(2)],
    ],
)
def test_arrays_of_every_kind(value: Any) -> None:
    assert real_array(value, "q").tolist() == [1.0, 2.0]
    assert real_array(value, "q").dtype == np.dtype(float)


def test_room_is_counted_for_what_is_computed_for_each_entry() -> None:
    times = np.broadcast_to(0.5, 10**8)
    assert real_array(times, "t").size == 10**8
    assert "t has 1e+08 entries, which takes 5.96 GiB of memory" in refusal(real_array, times, "t", width=8)


m = sympy.Symbol("m")
REFUSALS: list[tuple[Any, str, Any, str]] = [
    (expression, "m", "x", "m is the text 'x': give a SymPy expression; texts belong in a scene file."),
    (expression, "m", ["x"], "m is ['x'] (list): give one SymPy expression."),
    (expression, "m", sympy.eye(2), "m is a matrix of shape (2, 2): give a scalar, such as its entry [0, 0]."),
    (expression, "m", sympy.Eq(x, 1), "m is Eq(x(t), 1), which has no value"),
    (expression, "m", sympy.true, "m is True, which has no value"),
    (vector, "the position", "x", "the position is the text 'x': give SymPy expressions."),
    (vector, "the position", np.array([x, "y"], object), "component 1 of the position is the text 'y'"),
    (vector, "the position", {x: 1}, "the position is a dict, which has no order: give a list."),
    (vector, "the position", np.ma.array([1.0]), "the position is a masked array: give the values alone."),
    (vector, "the position", np.zeros((2, 2, 2)), "the position has shape (2, 2, 2): give a vector, or a matrix"),
    (vector, "the position", itertools.count(), "the position has more than 10000 entries: give fewer."),
    (vector, "the position", sympy.Matrix([[x, 1], [1, x]]), "component 0 of the position is [x(t), 1] (list)"),
    (real_array, "q", [1j, 0], "q has entries of type complex128: give real numbers."),
    (real_array, "q", [1.0, True], "q has entries of type bool: give real numbers."),
    (real_array, "q", np.array([1.0, None]), "q has entries of type object: give real numbers."),
    (real_array, "q", np.ma.array([1.0, 2.0]), "q is a masked array: give the values alone, such as its .compressed()"),
    (real_array, "q", [1.0, np.ma.masked], "q has entries of type MaskedConstant: give real numbers."),
    (real_array, "q", [[1.0, 2.0], [3.0]], "q is not an array: setting an array element with a sequence."),
    (real_array, "q", range(10**9), "q has 1e+09 entries, which takes 7.45 GiB of memory: give fewer at once, so that"),
    (real_number, "parameter m", float("nan"), "parameter m is nan: give a finite number."),
    (real_number, "parameter m", sympy.exp(1000), "parameter m is inf: give a finite number."),
    (real_number, "parameter m", 10**400, "m is too large for a floating-point number: give a number below 1.8e308."),
    (real_number, "parameter m", 1j, "parameter m is 1j, a complex number: give a real number."),
    (real_number, "parameter m", 2 * m, "parameter m is 2*m, an expression with symbols in it: give a number."),
    (real_number, "parameter m", sympy.Eq(m, 1), "parameter m is Eq(m, 1), which has no value: give a number."),
    (real_number, "parameter m", True, "parameter m is True (bool): give a number."),
    (real_number, "parameter m", np.array([1.0, 2.0]), "parameter m is array([1., 2.]) (ndarray): give a number."),
    *((flag, "progress", value, ": give True or False") for value in (0, 1, None, "yes", np.array([1, 2]), 0.0)),
]


@pytest.mark.parametrize(("read", "name", "value", "message"), REFUSALS, ids=lambda case: str(case)[:20])
def test_values_that_are_refused(read: Callable[..., Any], name: str, value: Any, message: str) -> None:
    assert message in refusal(read, value, name)
