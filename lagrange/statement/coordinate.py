"""Generalized coordinates, parameters and time as SymPy objects, in the order of their declarations."""

from __future__ import annotations

import inspect
import keyword
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count
from threading import Lock
from typing import Any, NoReturn

from sympy import Basic, Derivative, Symbol
from sympy.core.function import Application, AppliedUndef, UndefinedFunction

from lagrange.errors import StatementError, formula, shown
from lagrange.statement.lexer import FUNCTIONS, NAME
from lagrange.statement.number import flag


class DeclaredOrder:
    """The calls that declared names, and the order that they give to the names of one statement.

    A statement reads the latest calls back to the first that, together, declare all its names. Its names are in the
    order of these calls, and earlier declarations are without effect: a program that declares its names gets the same
    order whatever other programs declared before in the same process.
    """

    def __init__(self) -> None:
        self.calls: dict[int, tuple[str, ...]] = {}
        """Names by the number of the call. Calls whose names were all declared again later are left out."""
        self._latest: dict[str, int] = {}
        self._numbers = count()
        self._lock = Lock()

    def declare(self, names: Sequence[str]) -> None:
        """Enter the names of one call."""
        with self._lock:
            number = next(self._numbers)
            earlier = {self._latest[name] for name in names if name in self._latest}
            self._latest.update(dict.fromkeys(names, number))
            self.calls[number] = tuple(names)
            for call in earlier:
                if all(self._latest[name] != call for name in self.calls[call]):
                    del self.calls[call]

    def of(self, leaves: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return what is given with its names in the order of declaration, then the others as they come."""
        pairs = list(leaves)
        names = {name for name, _ in pairs}
        with self._lock:
            first = min((self._latest[name] for name in names if name in self._latest), default=0)
            calls = [call for number, call in self.calls.items() if number >= first]
        order = dict.fromkeys(name for call in calls for name in call if name in names)
        places = {name: place for place, name in enumerate(order)}
        return [leaf for _, leaf in sorted(pairs, key=lambda pair: places.get(pair[0], len(places)))]


COORDINATES, PARAMETERS = DeclaredOrder(), DeclaredOrder()


t = Symbol("t")
"""Time; the same symbol as SymPy's ``dynamicsymbols._t``."""

PREDEFINED = {t.name: "time", "pi": "a constant"}
"""Names that mean something in every statement, and what."""

MOST_LETTERS = 10_000
"""Letters of an expression as the name of a row: as many as two expressions may need to differ in."""


def check_name(name: str, what: str) -> str:
    """Return the name, or refuse it: a letter, then letters, digits and underscores, at most 64 characters."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise StatementError(
            f"{shown(name)} cannot name a {what}: a name starts with a letter, goes on with letters, digits and "
            "underscores, and has at most 64 characters. Letters are A to Z, a to z and Greek ones."
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
    made = coordinate_of(name)
    COORDINATES.declare([name])
    return made


def coordinate_of(name: str) -> Any:
    """Return what `coordinate` does, and leave the order in which coordinates were declared as it is."""
    check_symbol(name, "coordinate")
    if name not in _DECLARED:
        _DECLARED[name] = function_of_time(name)
    return _DECLARED[name]


def declared(coordinate: Any) -> bool:
    """Return whether a function of time has the name of a coordinate that `coordinate` made."""
    return name_of(coordinate) in _DECLARED


def is_ours(function: Any) -> bool:
    """Return whether a function of time was made here, and not by SymPy."""
    return "ddot" in type(function).__dict__


_DECLARED: dict[str, Any] = {}
"""The coordinates that were made, by name."""


def function_of_time(name: str, marks: Mapping[str, Any] | None = None) -> Any:
    """Return the function of time of that name, with its derivatives as attributes.

    Functions with other `marks`, which are attributes, are other functions to SymPy.

    SymPy keeps what it made: asked for name(t), it gives an equal function that was made without the attributes, by
    `dynamicsymbols` for one. So this one is made without asking it.
    """
    shorthand: dict[str, Any] = {"dot": property(velocity_of), "ddot": property(acceleration_of)}
    shorthand |= {numpy: _refusing(numpy, ours) for numpy, ours in _NUMPY.items()}
    made = UndefinedFunction(name, bases=(AppliedUndef,), __dict__=shorthand, **(marks or {}))
    return inspect.unwrap(Application.__new__)(made, t)


_NUMPY = {name: name for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "sinh", "cosh", "tanh", "sign", "sinc")}
_NUMPY |= {f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")}
"""Functions of NumPy, which calls a method of that name of what it does not know, and what SymPy calls them."""


def _refusing(numpy: str, ours: str) -> Callable[[Any], NoReturn]:
    """Return the method that `numpy.cos` calls."""

    def refuse(self: Any) -> NoReturn:
        name = name_of(self)
        raise StatementError(
            f"numpy.{numpy}({name}) works on numbers, and {name} is a coordinate: write sympy.{ours}({name}), with "
            f"from sympy import {ours}."
        )

    return refuse


def coordinates(names: str) -> Any:
    """Return the coordinates named in a text such as ``"x y"``: a tuple, or one coordinate for one name.

    Raises StatementError for a name that `coordinate` refuses.
    """
    given = _names(names, "coordinate")
    found = tuple(map(coordinate_of, given))
    COORDINATES.declare(given)
    return found[0] if len(found) == 1 else found


def parameters(names: str, *, positive: bool = True) -> Any:
    """Return parameters named in a text such as ``"m g l"``: real symbols, positive unless told otherwise.

    One name gives one symbol, several give a tuple. Raises StatementError for a name that is not an identifier, or that
    has a meaning.
    """
    found = []
    positive, given = flag(positive, "positive"), _names(names, "parameter")
    for name in given:
        check_symbol(name, "parameter")
        found.append(Symbol(name, real=True, positive=True) if positive else Symbol(name, real=True))
    PARAMETERS.declare(given)
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


def row_label(key: Any) -> str:
    """Return what a row is called: ``theta`` for theta(t), ``theta_dot`` for its derivative."""
    if isinstance(key, Derivative) and isinstance(key.expr, AppliedUndef) and key == velocity_of(key.expr):
        return f"{name_of(key.expr)}_dot"
    if isinstance(key, AppliedUndef):
        return name_of(key)
    if isinstance(key, Basic):
        return formula(key, MOST_LETTERS)
    return key if isinstance(key, str) else shown(key)
