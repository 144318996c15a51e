"""Numbers from users: accepted from every library, refused in words."""

from __future__ import annotations

from array import array
from collections import deque
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.errors import StatementError
from lagrange.statement.expression import flag, real_array, real_number
from tests.refusals import refusal


@pytest.mark.parametrize(
    "value",
    [
        *(1.5, Fraction(3, 2), np.float64(1.5), np.float32(1.5), np.array(1.5), sympy.Rational(3, 2)),
        *(sympy.Float(1.5), sympy.sqrt(sympy.Rational(9, 4))),
    ],
)
def test_numbers_of_every_kind(value: Any) -> None:
    assert real_number(value, "m") == 1.5 and type(real_number(value, "m")) is float
    assert real_number(np.int64(2), "m") == real_number(2, "m") == 2.0


ENTRIES: list[tuple[Any, str]] = [
    ([1j, 0], "q has entries of type complex128: give real numbers."),
    (["1", "2"], "q has entries of type <U1: give real numbers."),
    ([b"1"], "q has entries of type |S1: give real numbers."),
    ([True, False], "q has entries of type bool: give real numbers."),
    ([1.0, True], "q has entries of type bool: give real numbers."),
    (np.array([1.0, None]), "q has entries of type object: give real numbers."),
    ([10**400], "q has entries of type object: give real numbers."),
    (np.array([1], "m8[s]"), "q has entries of type timedelta64[s]: give real numbers."),
    (np.ma.array([1.0, 2.0]), "q is a masked array: give the values alone, such as its .compressed()."),
    ([1.0, np.ma.masked], "q has entries of type MaskedConstant: give real numbers."),
    ([[1.0, 2.0], [3.0]], "q is not an array: setting an array element with a sequence."),
    (np.broadcast_to(1.0, 10**9), "q has 1e+09 entries, which takes 7.45 GiB of memory: give fewer at once, so that 4"),
    (range(10**9), "q has 1e+09 entries, which takes 7.45 GiB of memory: give fewer at once, so that 4 GiB are enough"),
]


@pytest.mark.parametrize(("value", "message"), ENTRIES, ids=lambda case: str(type(case)))
def test_what_is_no_array_of_real_numbers(value: Any, message: str) -> None:
    assert message in refusal(real_array, value, "q")


@pytest.mark.parametrize("value", [deque([1, 2]), array("d", [1, 2]), memoryview(array("d", [1, 2]))])
def test_sequences_of_other_kinds(value: Any) -> None:
    assert real_array(value, "q").tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "value",
    [[1, 2.0], (1.0, 2), np.array([1, 2]), np.array([1.0, 2.0], ">f8"), range(1, 3), [np.float64(1), np.int8(2)]],
)
def test_arrays_of_every_kind(value: Any) -> None:
    assert real_array(value, "q").tolist() == [1.0, 2.0]
    assert real_array(value, "q").dtype == np.dtype(float)


def test_room_is_counted_for_what_is_computed_for_each_entry() -> None:
    times = np.broadcast_to(0.5, 10**8)
    assert real_array(times, "t").size == 10**8
    with pytest.raises(StatementError, match=r"t has 1e.08 entries, which takes 5.96 GiB of memory"):
        real_array(times, "t", width=8)


@pytest.mark.parametrize("value", [0, 1, None, "yes", np.array([1, 2]), 0.0])
def test_what_is_no_truth_value(value: Any) -> None:
    with pytest.raises(StatementError, match=r"progress = .*: give True or False"):
        flag(value, "progress")
    assert flag(np.bool_(1), "progress") is True


m = sympy.Symbol("m")
REFUSALS: list[tuple[Any, str]] = [
    (float("nan"), "parameter m is nan: give a finite number."),
    (float("inf"), "parameter m is inf: give a finite number."),
    (-np.inf, "parameter m is -inf: give a finite number."),
    (sympy.nan, "parameter m is nan: give a finite number."),
    (sympy.oo, "parameter m is inf: give a finite number."),
    (sympy.zoo, "parameter m is zoo: give a finite number."),
    (sympy.exp(1000), "parameter m is inf: give a finite number."),
    (10**400, "parameter m is too large for a floating-point number: give one below 1.8e308."),
    (1j, "parameter m is 1j, a complex number: give a real number."),
    (np.complex128(1), "a complex number: give a real number."),
    (sympy.I, "parameter m is I, a complex number: give a real number."),
    (2 * m, "parameter m is 2*m, an expression with symbols in it: give a number."),
    (sympy.Function("x")(m), "parameter m is x(m), an expression with symbols in it: give a number."),
    (sympy.Eq(m, 1), "parameter m is Eq(m, 1), which has no value: give a number."),
    (sympy.true, "parameter m is True, which has no value: give a number."),
    (True, "parameter m is True (bool): give a number."),
    (np.bool_(1), "(bool): give a number."),
    ("1.0", "parameter m is '1.0' (str): give a number."),
    (None, "parameter m is None (NoneType): give a number."),
    (Decimal(1), "parameter m is Decimal('1') (Decimal): give a number."),
    ([1.0], "parameter m is [1.0] (list): give a number."),
    (np.array([1.0, 2.0]), "parameter m is array([1., 2.]) (ndarray): give a number."),
]


@pytest.mark.parametrize(("value", "message"), REFUSALS, ids=lambda case: str(case)[:20])
def test_what_is_no_real_number(value: Any, message: str) -> None:
    assert message in refusal(real_number, value, "parameter m")
