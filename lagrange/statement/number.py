"""Numbers, arrays, truth values and words from users: finite, real or known, or refused with a message."""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterable, Sized
from typing import Any, TypeVar

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from lagrange.errors import (
    MANY_PARTS,
    TOO_LARGE,
    StatementError,
    UnknownKey,
    formula,
    has_many_parts,
    listing,
    shown,
    singular,
    suggestion,
)

TYPED_ROUNDING = 1e-6
"""Largest relative rounding of numbers that people type, with six or more digits."""


FloatArray = NDArray[np.float64]

DOUBLE = np.dtype(float)

MOST_NUMBERS = 2**29
"""Largest number of entries of an array from a user, or computed for it: 4 GiB. Larger arrays are refused before
allocation: the operating system would end the process without a message."""

_FLOATS = frozenset((float,))

_NO_NUMBERS = (bool, np.bool_, np.ma.MaskedArray)
"""Types that are refused in place of numbers; NumPy would convert them inside a list."""

_DEGREES = re.compile(r" *([+-]?[0-9.]{1,30}) *(?:deg|degrees|°) *")
"""A text that means an angle in degrees."""


def real_number(value: Any, what: str) -> float:
    """Return a finite float from a Python, NumPy or SymPy number; `what` names it in the refusal."""
    number = value if type(value) is float else _as_float(value, what)
    if not math.isfinite(number):
        raise StatementError(f"{what} is {number}: give a finite number.")
    return number


def flag(value: Any, what: str) -> bool:
    """Return a bool. Raises StatementError for other types, which Python would convert to one."""
    if not isinstance(value, (bool, np.bool_)):
        raise StatementError(f"{what} = {shown(value)}: give True or False.")
    return bool(value)


def flag_or_word(value: Any, what: str, word: str) -> bool | str:
    """Return a bool or a word. Raises StatementError for other values."""
    if isinstance(value, str):
        return one_of(value, (word,), what + " = {given}: give True, False or {known}.")
    return flag(value, what)


def whole_number(value: Any, what: str, least: int, most: int | None = None) -> int:
    """Return a whole number of at least `least`, and of at most `most` unless that is None; 3.0 is accepted as 3."""
    number = real_number(value, what)
    if number != int(number) or number < least or (most is not None and number > most):
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise StatementError(f"{what} = {shown(value)}: give a whole number {bounds}.")
    return int(value) if isinstance(value, numbers.Integral) else int(number)


def real_array(value: ArrayLike, what: str, *, width: int = 1) -> FloatArray:
    """Return an array of doubles.

    Raises StatementError for complex numbers, texts, truth values, symbols and masked arrays: conversion would lose
    information. Also raises it for arrays that take too much memory; `width` is the number of values computed for each
    entry.
    """
    if type(value) is np.ndarray and value.dtype is DOUBLE and value.size * width <= MOST_NUMBERS:
        return value
    plain: Any = value
    if type(plain) is list and _FLOATS.issuperset(map(type, plain)) and len(plain) * width <= MOST_NUMBERS:
        return np.array(plain, dtype=float)
    array = _array(value, what, width, "fiu")
    if array.dtype is DOUBLE:
        return array
    with np.errstate(over="ignore"):  # an entry beyond all doubles is infinite
        return array.astype(float)


def complex_array(value: ArrayLike, what: str) -> NDArray[np.complex128]:
    """Return an array of complex numbers, with the refusals of `real_array`."""
    with np.errstate(over="ignore"):
        return _array(value, what, 2, "fiuc").astype(complex)


def _array(value: ArrayLike, what: str, width: int, kinds: str) -> NDArray[Any]:
    """Return an array whose dtype is of one of `kinds`, letters of `numpy.dtype.kind`."""
    if isinstance(value, np.ma.MaskedArray):
        raise StatementError(f"{what} is a masked array: give the values alone, such as its .compressed().")
    for kind in set(map(type, value)) if isinstance(value, (list, tuple)) else ():
        if issubclass(kind, _NO_NUMBERS):
            raise StatementError(f"{what} has entries of type {kind.__name__}: give real numbers.")
    entries = _count(value)
    if entries * width > MOST_NUMBERS:
        raise StatementError(
            f"{what} has {entries:.3g} entries, which takes {8 * entries * width / 2**30:.3g} GiB of memory: give "
            f"fewer at once, so that {MOST_NUMBERS / 2**27:g} GiB are enough."
        )
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise StatementError(f"{what} is not an array: {str(error).rstrip('.')}. Give rows of one length.") from error
    if array.dtype.kind not in kinds:
        raise StatementError(
            f"{what} has entries of type {array.dtype}: give {'' if 'c' in kinds else 'real '}numbers."
        )
    return array


MOST_AXES = 64
"""Largest number of axes of an array of NumPy."""


def _count(value: Any, axes: int = 0) -> int:
    """Return the number of entries of an array, a sequence or sequences in one, and 1 for anything else."""
    if isinstance(value, np.ndarray):
        return value.size
    kinds = set(map(type, value)) if isinstance(value, (list, tuple)) and axes < MOST_AXES else ()
    if any(issubclass(kind, Sized) for kind in kinds):
        return sum(_count(entry, axes + 1) for entry in value)
    return len(value) if isinstance(value, Sized) else 1


def _as_float(value: Any, what: str) -> float:
    if isinstance(value, np.ndarray) and value.ndim == 0 and not isinstance(value, np.ma.MaskedArray):
        value = value[()]
    if isinstance(value, sympy.Basic):
        return _from_sympy(value, what)
    if isinstance(value, numbers.Complex) and not isinstance(value, numbers.Real):
        raise StatementError(f"{what} is {value!r}, a complex number: give a real number.")
    if isinstance(value, str) and (degrees := _DEGREES.fullmatch(value)):
        raise StatementError(f"{what} is {value!r}, a text: give a number, in radians, as math.radians({degrees[1]}).")
    if isinstance(value, (bool, np.bool_, np.timedelta64)) or not isinstance(value, numbers.Real):
        raise StatementError(f"{what} is {shown(value)} ({type(value).__name__}): give a number.")
    try:
        return float(value)
    except OverflowError:
        raise StatementError(f"{what} is {TOO_LARGE}.") from None


def _from_sympy(value: Any, what: str) -> float:
    if has_many_parts(value):
        raise StatementError(f"{what} is {MANY_PARTS}: give a number.")
    if not isinstance(value, sympy.Expr) or isinstance(value, sympy.Lambda):
        raise StatementError(f"{what} is {formula(value, 60)}, which has no value: give a number.")
    if value.free_symbols or not value.is_number:
        raise StatementError(f"{what} is {formula(value, 60)}, an expression with symbols in it: give a number.")
    if value in (sympy.nan, sympy.zoo):
        raise StatementError(f"{what} is {value}: give a finite number.")
    try:
        number = complex(value)
    except (TypeError, ValueError) as error:
        raise StatementError(f"{what} is {formula(value, 60)}, which has no value: give a number.") from error
    except OverflowError:
        raise StatementError(f"{what} is {TOO_LARGE}.") from None
    if number.imag != 0.0:
        raise StatementError(f"{what} is {formula(value, 60)}, a complex number: give a real number.")
    return number.real


Value = TypeVar("Value")

MOST_WORDS = 16
"""Largest number of known words that a message lists."""


def text(value: Any, what: str) -> str:
    """Return the value if it is a str. Raises StatementError, which names it `what`, for any other type."""
    if not isinstance(value, str):
        raise StatementError(f"{what} is {shown(value)} ({type(value).__name__}): give a text.")
    return value


def printable(value: Any, what: str) -> str:
    """Return a text whose lines have no characters on which a terminal acts. Raises StatementError otherwise."""
    if not text(value, what).replace("\n", " ").isprintable():
        raise StatementError(f"{what} is {shown(value)}, which has control characters: give plain text.")
    return str(value)


def one_of(value: Any, known: Iterable[str], refusal: str) -> str:
    """Return the value if it is one of the known words. Raises StatementError otherwise.

    `refusal` is the message, with the placeholders {given} and {known}.
    """
    words = list(known)
    if not isinstance(value, str) or value not in words:
        hint = suggestion(value, words) if isinstance(value, str) else ""
        raise StatementError(refusal.format(given=shown(value), known=listing(words, MOST_WORDS)) + hint)
    return value


class ByName(dict[str, Value]):
    """Values by name; an unknown name raises a StatementError that lists the known ones."""

    def __init__(self, noun: str, values: Iterable[tuple[str, Value]] = ()) -> None:
        super().__init__(values)
        self.noun = noun

    def __reduce__(self) -> tuple[Any, ...]:
        return ByName, (self.noun, tuple(self.items()))

    def __getitem__(self, name: str) -> Value:
        if not isinstance(name, str) or name not in self:
            hint = suggestion(name, self) if isinstance(name, str) else ""
            raise UnknownKey(
                f"{shown(name)} is not {singular(self.noun)} of this system; "
                f"they are {listing(self, MOST_WORDS)}.{hint}"
            )
        return super().__getitem__(name)
