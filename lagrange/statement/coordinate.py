"""Coordinates, velocities, parameters and multipliers as SymPy symbols: how they are created, named and ordered."""

from __future__ import annotations

import inspect
import keyword
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import count
from threading import Lock
from typing import Any, NoReturn

from sympy import Basic, Derivative, Symbol
from sympy.core.function import Application, AppliedUndef, UndefinedFunction

from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.statement.expression import flag
from lagrange.statement.vocabulary.functions import FUNCTION_NAMES
from lagrange.statement.vocabulary.letters import NAME


class DeclaredOrder:
    """Register of the calls that declared coordinates or parameters, from which their order in a statement follows.

    `of` searches back for the latest calls that together declare all names of the statement, and takes their order.
    Earlier declarations have no effect. So a program that declares its names gets the same order, whatever other
    programs declared before in the same process.
    """

    def __init__(self) -> None:
        self.calls: dict[int, tuple[str, ...]] = {}
        """Names by number of the call. A call is deleted when all its names were declared again later."""
        self._latest: dict[str, int] = {}
        self._numbers = count()
        self._lock = Lock()

    def declare(self, names: Sequence[str]) -> None:
        """Record the names that one call of the user declares, in the order of the call."""
        with self._lock:
            number = next(self._numbers)
            earlier = {self._latest[name] for name in names if name in self._latest}
            self._latest.update(dict.fromkeys(names, number))
            self.calls[number] = tuple(names)
            for call in earlier:
                if all(self._latest[name] != call for name in self.calls[call]):
                    del self.calls[call]

    def of(self, leaves: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return the symbols of `leaves` in the order of their declaration, followed by the undeclared symbols.

        `leaves` are pairs (name, symbol), where a symbol is a coordinate or a parameter. Undeclared symbols keep the
        order of `leaves`.
        """
        pairs = list(leaves)
        names = {name for name, _ in pairs}
        with self._lock:
            first = min((self._latest[name] for name in names if name in self._latest), default=0)
            calls = [call for number, call in self.calls.items() if number >= first]
        order = dict.fromkeys(name for call in calls for name in call if name in names)
        ranks = {name: rank for rank, name in enumerate(order)}
        return [leaf for _, leaf in sorted(pairs, key=lambda pair: ranks.get(pair[0], len(ranks)))]


COORDINATES, PARAMETERS = DeclaredOrder(), DeclaredOrder()


t = Symbol("t")  # Time; the same symbol as SymPy's ``dynamicsymbols._t``

PREDEFINED = {t.name: "time", "pi": "a constant"}
"""Names with a fixed meaning in every statement, and the words for this meaning in messages."""

MOST_LETTERS = 10_000
"""Largest number of characters of an expression that labels a row of a table. It is large, so that different
expressions have different labels."""


def check_name(name: str, what: str) -> str:
    """Return `name`. Raises StatementError unless it is a letter, then letters, digits or underscores, 64 at most.

    `what` is the kind of the named object for the message, such as "coordinate".
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise StatementError(
            f"{shown(name)} cannot name a {what}: a name starts with a letter, goes on with letters, digits and "
            "underscores, and has at most 64 characters. Letters are A to Z, a to z and Greek ones."
        )
    return name


def check_symbol(name: str, what: str) -> str:
    """Return `name` of a coordinate or parameter. Raises StatementError for a word of Python or of scene files.

    `what` is the kind of the named object for the message, such as "coordinate".
    """
    meaning = PREDEFINED.get(check_name(name, what), "a function" if name in FUNCTION_NAMES else "")
    if not meaning and keyword.iskeyword(name):
        meaning = "a reserved word of Python"
    if meaning:
        raise StatementError(
            f"{name!r} cannot name a {what}, because it is {meaning}: choose another name, such as {name}_1."
        )
    return name


def coordinate(name: str) -> Any:
    """Return the generalized coordinate `name`, a SymPy expression such as theta(t).

    It equals the result of SymPy's ``dynamicsymbols`` for the same name. The attribute ``.dot`` is its velocity and
    ``.ddot`` its acceleration. Raises StatementError for a name that is not an identifier, or that has another meaning,
    such as ``t``, ``pi``, ``sin`` or ``lambda``.
    """
    symbol = coordinate_of(name)
    COORDINATES.declare([name])
    return symbol


def coordinate_of(name: str) -> Any:
    """Return the coordinate `name`, without recording it in the order of declaration. Same errors as `coordinate`."""
    check_symbol(name, "coordinate")
    if name not in _DECLARED:
        _DECLARED[name] = function_of_time(name)
    return _DECLARED[name]


def declared(coordinate: Any) -> bool:
    """Return True if `coordinate`, or another coordinate of the same name, was created by this module."""
    return name_of(coordinate) in _DECLARED or rotation_name(coordinate) is not None


def is_ours(function: Any) -> bool:
    """Return True if this module created a function of time. A function of SymPy itself has no attribute `ddot`."""
    return "ddot" in type(function).__dict__


_DECLARED: dict[str, Any] = {}  # Coordinates made so far, by name


def function_of_time(name: str, marks: Mapping[str, Any] | None = None) -> Any:
    """Return the SymPy function of time `name`, such as theta(t), with its derivatives as attributes `dot` and `ddot`.

    `marks` are further attributes of its class, {attribute: value}. SymPy treats functions with different marks as
    different.

    SymPy caches functions: for name(t) it may return an equal function without these attributes, such as one of
    `dynamicsymbols`. So this function, and each one that SymPy rebuilds from it, is made without the cache.
    """
    shorthand: dict[str, Any] = {"dot": property(velocity_of), "ddot": property(acceleration_of)}
    shorthand |= {numpy: _refusing(numpy, ours) for numpy, ours in _NUMPY.items()}
    shorthand["__new__"] = inspect.unwrap(Application.__new__)
    return UndefinedFunction(name, bases=(AppliedUndef,), __dict__=shorthand, **(marks or {}))(t)


ROTATION = "rotation"  # Name of the attribute by which a coordinate of a rotation refers to the rotation's name


RATE = "rate"
"""Name of the attribute with the rate of a quasi-coordinate, which is a function of time with a rate but no value."""


def rotation_name(coordinate: Any) -> str | None:
    """Return the name of the rotation whose quaternion has `coordinate` as an entry, or None for other coordinates."""
    return getattr(coordinate.func, ROTATION, None)


_NUMPY = {name: name for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "sinh", "cosh", "tanh", "sign", "sinc")}
_NUMPY |= {f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")}
"""SymPy's name of each function of NumPy, {NumPy's name: SymPy's name}. For an array of objects, such as coordinates,
NumPy calls the method of its name on each object."""


def _refusing(numpy: str, ours: str) -> Callable[[Any], NoReturn]:
    """Return a method that refuses the NumPy function `numpy` for a coordinate and recommends SymPy's `ours`.

    NumPy calls the method of the same name of each object in an array. The returned method raises StatementError.
    """

    def refuse(self: Any) -> NoReturn:
        name = name_of(self)
        raise StatementError(
            f"numpy.{numpy}({name}) works on numbers, and {name} is a coordinate: write sympy.{ours}({name}), with "
            f"from sympy import {ours}."
        )

    return refuse


def coordinates(names: str) -> Any:
    """Return the coordinates whose names are in a text such as ``"x y"``: a tuple, or one coordinate for one name.

    Raises StatementError for a name that `coordinate` refuses.
    """
    labels = _names(names, "coordinate")
    symbols = tuple(map(coordinate_of, labels))
    COORDINATES.declare(labels)
    return symbols[0] if len(symbols) == 1 else symbols


def parameters(names: str, *, positive: bool = True) -> Any:
    """Return the parameters whose names are in a text such as ``"m g l"``: real symbols, which are positive by default.

    With `positive=False` the symbols have no assumed sign. One name gives one symbol, several names a tuple. Raises
    StatementError for a name that is not an identifier, or that already has a meaning.
    """
    symbols = []
    positive, labels = flag(positive, "positive"), _names(names, "parameter")
    for name in labels:
        check_symbol(name, "parameter")
        symbols.append(Symbol(name, real=True, positive=True) if positive else Symbol(name, real=True))
    PARAMETERS.declare(labels)
    return symbols[0] if len(symbols) == 1 else tuple(symbols)


@lru_cache(maxsize=4096)
def velocity_of(coordinate: Any) -> Any:
    """Return dq/dt of a function of time, or the rate of a quasi-coordinate. Cached, since SymPy takes 40 us."""
    return getattr(coordinate.func, RATE, None) or Derivative(coordinate, t)


def acceleration_of(coordinate: Any) -> Any:
    """Return d2q/dt2 of a function of time `coordinate`. For a quasi-coordinate it is the derivative of its rate."""
    rate = getattr(coordinate.func, RATE, None)
    return Derivative(coordinate, (t, 2)) if rate is None else Derivative(rate, t)


def name_of(coordinate: Any) -> str:
    """Return the name of a function of time as a str, such as ``theta`` for theta(t)."""
    return str(coordinate.func.__name__)


def _names(text: str, what: str) -> list[str]:
    names = text.replace(",", " ").split() if isinstance(text, str) else []
    if not names:
        raise StatementError(f"{shown(text)} names no {what}: give a text such as 'x y'.")
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise StatementError(f"{shown(text)} names the {what} {shown(repeated)} twice: give each name once.")
    return names


def row_label(key: Any) -> str:
    """Return the label of a quantity's row in a table: ``theta`` for theta(t), ``theta_dot`` for its derivative.

    Any other SymPy expression or object `key` is returned as text.
    """
    if isinstance(key, Derivative) and isinstance(key.expr, AppliedUndef) and key == velocity_of(key.expr):
        return f"{name_of(key.expr)}_dot"
    if isinstance(key, AppliedUndef):
        return name_of(key)
    if isinstance(key, Basic):
        return formula(key, MOST_LETTERS)
    return key if isinstance(key, str) else shown(key)


_OPENING, _CLOSING = "lambda[", "]"


def multiplier(name: str) -> Any:
    """Return the symbol of the multiplier of the constraint `name`, for forces, events and `solution.evaluate`.

    The multiplier is the factor lambda of the generalized forces lambda dphi/dq that the constraint phi = 0 exerts. The
    symbol prints as lambda[name]. Raises StatementError for a name that is not an identifier.
    """
    return Symbol(f"{_OPENING}{check_name(name, 'constraint')}{_CLOSING}", real=True)


def constraint_of(symbol: Any) -> str | None:
    """Return the name of the constraint whose multiplier is `symbol`, or None if `symbol` is not a multiplier."""
    name = str(symbol.name)
    if name.startswith(_OPENING) and name.endswith(_CLOSING):
        return name.removeprefix(_OPENING).removesuffix(_CLOSING)
    return None


def check_multipliers(
    names: Iterable[str], expression: str, constraints: Sequence[str], system: str, kind: str = "constraint"
) -> None:
    """Raise StatementError if an expression has multipliers of constraints that the system does not have.

    `names` are the names of the constraints whose multipliers the expression has, and `constraints` the names of the
    system's constraints. For the message, `expression` and `system` are texts that name the two, and `kind` is the word
    for a constraint.
    """
    for name in names:
        if name not in constraints:
            verb = " is" if len(constraints) == 1 else "s are"
            existing = f"the {kind}{verb} {listing(constraints)}" if constraints else f"{system} has no {kind}s"
            raise StatementError(
                f"{expression} contains {multiplier(name)}, but {existing}." + suggestion(name, constraints)
            )
