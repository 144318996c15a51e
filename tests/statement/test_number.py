"""Numbers from users: accepted from every library, refused in words."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.errors import StatementError
from lagrange.statement.number import real_number


@pytest.mark.parametrize(
    "value",
    [
        1.5, Fraction(3, 2), np.float64(1.5), np.float32(1.5), np.array(1.5), sympy.Rational(3, 2), sympy.Float(1.5),
        sympy.sqrt(sympy.Rational(9, 4)),
    ],
)  # fmt: skip
def test_numbers_of_every_kind(value: Any) -> None:
    assert real_number(value, "m") == 1.5
    assert type(real_number(value, "m")) is float


@pytest.mark.parametrize("value", [2, np.int64(2), sympy.Integer(2), 2.0])
def test_whole_numbers(value: Any) -> None:
    assert real_number(value, "m") == 2.0


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
    with pytest.raises(StatementError) as caught:
        real_number(value, "parameter m")
    assert message in str(caught.value)
