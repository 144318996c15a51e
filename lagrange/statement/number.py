"""Numbers from users: finite, real, and said to be otherwise in words."""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError

TOO_LARGE = "too large for a floating-point number: give one below 1.8e308"


def real_number(value: Any, what: str) -> float:
    """Return a finite float from a Python, NumPy or SymPy number; `what` names it in the refusal."""
    number = value if type(value) is float else _as_float(value, what)
    if not math.isfinite(number):
        raise StatementError(f"{what} is {number}: give a finite number.")
    return number


def _as_float(value: Any, what: str) -> float:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, sympy.Basic):
        return _from_sympy(value, what)
    if isinstance(value, numbers.Complex) and not isinstance(value, numbers.Real):
        raise StatementError(f"{what} is {value!r}, a complex number: give a real number.")
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        raise StatementError(f"{what} is {value!r} ({type(value).__name__}): give a number.")
    try:
        return float(value)
    except OverflowError:
        raise StatementError(f"{what} is {TOO_LARGE}.") from None


def _from_sympy(value: Any, what: str) -> float:
    if not isinstance(value, sympy.Expr):
        raise StatementError(f"{what} is {str(value)[:60]}, which has no value: give a number.")
    if value.free_symbols or not value.is_number:
        raise StatementError(f"{what} is {str(value)[:60]}, an expression with symbols in it: give a number.")
    if value in (sympy.nan, sympy.zoo):
        raise StatementError(f"{what} is {value}: give a finite number.")
    number = complex(value)
    if number.imag != 0.0:
        raise StatementError(f"{what} is {value}, a complex number: give a real number.")
    return number.real
