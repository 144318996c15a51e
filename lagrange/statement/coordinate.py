"""Generalized coordinates, parameters and time as SymPy objects."""

from __future__ import annotations

import keyword
import re
from typing import Any

from sympy import Derivative, Symbol
from sympy.core.function import AppliedUndef, UndefinedFunction

from lagrange.errors import StatementError, shown
from lagrange.statement.number import flag
from lagrange.statement.vocabulary import FUNCTIONS

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")

t = Symbol("t")
"""Time; the same symbol as SymPy's ``dynamicsymbols._t``."""

PREDEFINED = {t.name: "time", "pi": "a constant"}
"""Names that mean something in every statement, and what."""


def check_name(name: str, what: str) -> str:
    """Return the name, or refuse it: a letter, then letters, digits and underscores, at most 64 characters."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise StatementError(
            f"{shown(name)} cannot name a {what}: a name starts with a letter, goes on with letters, digits and "
            "underscores, and has at most 64 characters."
        )
    return name


def check_symbol(name: str, what: str) -> str:
    """Return the name of a coordinate or parameter, or refuse one that no expression of a scene can contain.

    The names are the same in Python and in scenes: no predefined one, no function, no reserved word of Python.
    """
    meaning = PREDEFINED.get(check_name(name, what), "a function" if name in FUNCTIONS else "")
    if not meaning and keyword.iskeyword(name):
        meaning = "a reserved word of Python"
    if meaning:
        raise StatementError(f"{name!r} cannot name a {what}, it is {meaning}: choose another name, such as {name}_1.")
    return name


def coordinate(name: str) -> Any:
    """Return the generalized coordinate of that name, a SymPy expression such as theta(t).

    It equals SymPy's ``dynamicsymbols`` of that name; its velocity is ``.dot``, its acceleration ``.ddot``. Raises
    StatementError for a name that is not an identifier, or that has a meaning: ``t``, ``pi``, ``sin``, ``lambda``.
    """
    check_symbol(name, "coordinate")
    shorthand = {"dot": property(velocity_of), "ddot": property(acceleration_of)}
    return UndefinedFunction(name, bases=(AppliedUndef,), __dict__=shorthand)(t)


def coordinates(names: str) -> Any:
    """Return the coordinates named in a text such as ``"x y"``: a tuple, or one coordinate for one name."""
    found = tuple(coordinate(name) for name in _names(names, "coordinate"))
    return found[0] if len(found) == 1 else found


def parameters(names: str, *, positive: bool = True) -> Any:
    """Return parameters named in a text such as ``"m g l"``: real symbols, positive unless told otherwise.

    One name gives one symbol, several give a tuple.
    """
    found = []
    positive = flag(positive, "positive")
    for name in _names(names, "parameter"):
        check_symbol(name, "parameter")
        found.append(Symbol(name, real=True, positive=True) if positive else Symbol(name, real=True))
    return found[0] if len(found) == 1 else tuple(found)


def velocity_of(coordinate: Any) -> Any:
    """Return dq/dt of any function of time, a ``dynamicsymbols`` too."""
    return Derivative(coordinate, t)


def acceleration_of(coordinate: Any) -> Any:
    """Return d2q/dt2 of any function of time."""
    return Derivative(coordinate, (t, 2))


def name_of(coordinate: Any) -> str:
    """Return the plain name of a coordinate: ``theta`` for theta(t)."""
    return str(coordinate.func.__name__)


def _names(text: str, what: str) -> list[str]:
    names = text.replace(",", " ").split() if isinstance(text, str) else []
    if not names:
        raise StatementError(f"{shown(text)} names no {what}: give a text such as 'x y'.")
    return names
