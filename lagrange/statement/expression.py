"""Check and convert values from users: numbers, arrays, truth values, words, and SymPy expressions.

All expressions from users reach SymPy only through this module, entry by entry, because `sympify` would run texts as
Python code, also texts inside lists and matrices. Mod is replaced by an atan2, and re and im are evaluated.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence, Set, Sized
from functools import wraps
from itertools import islice
from operator import attrgetter
from typing import Any, ParamSpec, TypeVar

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray
from sympy.core.function import AppliedUndef

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
    with_type,
)

TYPED_ROUNDING = 1e-6  # Largest relative rounding of numbers that people type with six or more digits


FloatArray = NDArray[np.float64]

DOUBLE = np.dtype(float)

MOST_NUMBERS = 2**29
"""Largest number of doubles in an array that a user gives or requests: 4 GiB. Larger arrays are refused before
allocation, since the operating system would end the process without a message."""

_FLOATS = frozenset((float,))

_NO_NUMBERS = (bool, np.bool_, np.ma.MaskedArray)
"""Types that NumPy would convert to numbers inside a list, but which are refused."""

_DEGREES = re.compile(r" *([+-]?[0-9.]{1,30}) *(?:deg|degrees|°) *")  # Matches an angle as text, such as "30 deg"


def real_number(value: Any, what: str) -> float:
    """Return a Python, NumPy or SymPy number as a finite float.

    Raises StatementError for other values. In the message `what` is the name of the value.
    """
    number = value if type(value) is float else _as_float(value, what)
    if not math.isfinite(number):
        raise StatementError(f"{what} is {number}: give a finite number.")
    return number


def positive_number(value: Any, what: str, remedy: str) -> float:
    """Return a positive finite float from a number. Raises StatementError for other values.

    In the message `what` is the name of the value, and `remedy` the end.
    """
    number = real_number(value, what)
    if number <= 0:
        raise StatementError(f"{what} = {number:g}: {remedy}.")
    return number


def flag(value: Any, what: str) -> bool:
    """Return True or False as a bool. Raises StatementError, with the name `what`, for other types."""
    if not isinstance(value, (bool, np.bool_)):
        raise StatementError(f"{what} = {shown(value)}: give True or False.")
    return bool(value)


def flag_or_word(value: Any, what: str, word: str) -> bool | str:
    """Return a bool, or the text `word`. Raises StatementError, with the name `what`, for other values."""
    if isinstance(value, str):
        return one_of(value, (word,), what + " = {given}: give True, False or {known}.")
    return flag(value, what)


def whole_number(value: Any, what: str, least: int, most: int | None = None) -> int:
    """Return `value` as an int between `least` and `most` (None: no upper limit). The float 3.0 is accepted as 3.

    Raises StatementError for other values; `what` is the name of the value in the message.
    """
    number = real_number(value, what)
    if number != int(number) or number < least or (most is not None and number > most):
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise StatementError(f"{what} = {shown(value)}: give a whole number {bounds}.")
    return int(value) if isinstance(value, numbers.Integral) else int(number)


def real_array(value: ArrayLike, what: str, *, width: int = 1) -> FloatArray:
    """Return `value` as an array of doubles, of any shape.

    Raises StatementError for complex numbers, texts, truth values, symbols and masked arrays, whose conversion would
    lose information. The error is also raised if the computation would need too much memory. `width` is the number of
    doubles that the caller computes for each entry, and `what` the name of the value in messages.
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
    """Return an array of complex numbers. Raises StatementError for other values, or too many.

    In the message `what` is the name of the array.
    """
    with np.errstate(over="ignore"):
        return _array(value, what, 2, "fiuc").astype(complex)


def _array(value: ArrayLike, what: str, width: int, kinds: str) -> NDArray[Any]:
    """Return an array whose entries are numbers of one of `kinds`, which are letters of `numpy.dtype.kind`.

    Raises StatementError for other entries, and if `width` doubles for each entry take too much memory. `what` is the
    name of the array in messages.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise StatementError(f"{what} is a masked array: give the values alone, such as its .compressed().")
    if isinstance(value, (str, bytes, bytearray)):
        raise StatementError(f"{what} is the text {shown(value, 60)}: give {'' if 'c' in kinds else 'real '}numbers.")
    entries = _count(value, what)
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


MOST_AXES = 64  # Largest number of axes of a NumPy array


def _count(value: Any, what: str, axes: int = 0) -> int:
    """Return the number of entries of an array or of nested sequences, and 1 for any other value.

    `axes` is the number of sequences around the value. Sequences nested deeper than `MOST_AXES` are not opened. Raises
    StatementError, with the name `what`, for entries such as truth values, which NumPy would convert to numbers.
    """
    if isinstance(value, np.ndarray):
        return value.size
    kinds = set(map(type, value)) if isinstance(value, (list, tuple)) and axes < MOST_AXES else ()
    for kind in kinds:
        if issubclass(kind, _NO_NUMBERS):
            raise StatementError(f"{what} has entries of type {kind.__name__}: give real numbers.")
    if any(issubclass(kind, Sized) for kind in kinds):
        return sum(_count(entry, what, axes + 1) for entry in value)
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
        raise StatementError(f"{what} is {with_type(value)}: give a number.")
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

MOST_WORDS = 16  # Largest number of known words in a message


def text(value: Any, what: str) -> str:
    """Return the value if it is a str. Raises StatementError for other types; `what` is its name in the message."""
    if not isinstance(value, str):
        raise StatementError(f"{what} is {with_type(value)}: give a text.")
    return value


def printable(value: Any, what: str) -> str:
    """Return the text `value`. Raises StatementError, with the name `what`, for control characters in it."""
    if not text(value, what).replace("\n", " ").isprintable():
        raise StatementError(f"{what} is {shown(value)}, which has control characters: give plain text.")
    return str(value)


def one_of(value: Any, known: Iterable[str], refusal: str) -> str:
    """Return `value` if it is one of the `known` words. Raises StatementError otherwise.

    `refusal` is the message. In it {given} is replaced by the value, and {known} by the words.
    """
    words = list(known)
    if not isinstance(value, str) or value not in words:
        hint = suggestion(value, words) if isinstance(value, str) else ""
        raise StatementError(refusal.format(given=shown(value), known=listing(words, MOST_WORDS)) + hint)
    return value


def check_once(names: Sequence[str], what: str) -> None:
    """Raise StatementError if a user's table has a key twice, as a symbol and as a name.

    `names` are the names of the keys, and `what` is the name of the table in the message.
    """
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise StatementError(f"{what} has {twice} twice, by its symbol and by its name: give it once.")


class ByName(dict[str, Value]):
    """Dict of values by name. Access by an unknown name raises a StatementError that lists the known names.

    `noun` is the kind of the values in the message, such as "parameters".
    """

    def __init__(self, noun: str, values: Iterable[tuple[str, Value]] = ()) -> None:
        super().__init__(values)
        self.noun = noun

    def __reduce__(self) -> tuple[Any, ...]:
        return ByName, (self.noun, tuple(self.items()))

    def __getitem__(self, name: str) -> Value:
        if not isinstance(name, str) or name not in self:
            known = f"they are {listing(self, MOST_WORDS)}" if self else "it has none"
            hint = suggestion(name, self) if isinstance(name, str) else ""
            raise UnknownKey(f"{shown(name)} is not {singular(self.noun)} of this system; {known}.{hint}")
        return super().__getitem__(name)


MOST_ENTRIES = 10_000
"""Largest number of entries of a vector. A generator with more entries is refused, since it may be endless."""

MOST_LEVELS = 400
"""Largest depth of nesting of an expression. SymPy takes two of Python's 1,000 nested calls for each level."""

TEXTS = (str, bytes, bytearray, memoryview)


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def refusing_deep(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return `function`, changed so that it raises StatementError for an expression that is nested too deeply.

    SymPy's recursive functions overflow Python's stack on such an expression.
    """

    @wraps(function)
    def refused(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except RecursionError:
            raise StatementError(
                "an expression is nested too deeply for SymPy: give symbols to its inner parts, or write it with fewer "
                "levels."
            ) from None

    return refused


class NonScalar:
    """Base class of objects that are not scalar expressions, such as a rotation.

    `remedy` is the end of a message where a scalar is required: what to give instead.
    """

    remedy: str


def expression(value: Any, what: str) -> Any:
    """Return a user's value, an expression or a number, as a SymPy expression. Raises StatementError for other types.

    `what` is the name of the value in the message.
    """
    return in_full(as_typed(value, what))


def as_typed(value: Any, what: str) -> Any:
    """Return a user's value, an expression or a number, as a SymPy expression in which shorthands stay.

    A shorthand is a function of time that abbreviates an expression, such as R[0, 0], an entry of a rotation. Raises
    StatementError for other types; `what` is the name of the value in the message.
    """
    if isinstance(value, sympy.Basic) and is_too_deep(value):
        raise StatementError(
            f"{what} is an expression nested more than {MOST_LEVELS} levels deep, which SymPy cannot read: "
            "give symbols to its inner parts, or write it with fewer levels."
        )
    if isinstance(value, sympy.Expr) and not value.is_Matrix and not isinstance(value, sympy.Lambda):
        return real(without_modulo(value))
    if isinstance(value, np.ndarray) and value.shape == () and not isinstance(value, np.ma.MaskedArray):
        return as_typed(value[()], what)
    if isinstance(value, TEXTS):
        raise StatementError(
            f"{what} is the text {shown(value, 60)}: give a SymPy expression; texts belong in a scene file."
        )
    if isinstance(value, sympy.MatrixBase) or getattr(value, "is_Matrix", False) is True:
        raise StatementError(f"{what} is a matrix of shape {value.shape}: give a scalar, such as its entry [0, 0].")
    if isinstance(value, sympy.Basic) and not isinstance(value, sympy.Expr):
        raise StatementError(f"{what} is {formula(value, 60)}, which has no value: give an expression.")
    function = callable(value) and not isinstance(value, sympy.Basic)
    if function or isinstance(value, (list, tuple, Mapping, Set)):
        raise StatementError(f"{what} is {with_type(value, 60)}: give one SymPy expression.")
    if isinstance(value, NonScalar):
        raise StatementError(f"{what} is {shown(value)}: {value.remedy}.")
    number = real_number(value, what)
    if isinstance(value, numbers.Rational):  # an int is converted exactly, too
        return sympy.Rational(int(value.numerator), int(value.denominator))
    return sympy.Float(number)


SHORTHAND = "shorthand"
"""Attribute of a function of time that abbreviates an expression, such as an entry of a rotation. It holds the
expression."""


def is_shorthand(value: Any) -> bool:
    """Return True for a function of time that abbreviates an expression, such as an entry of a rotation matrix."""
    return isinstance(value, AppliedUndef) and hasattr(value.func, SHORTHAND)


def in_full(expression: Any) -> Any:
    """Return an expression with each shorthand, such as R[0, 0], replaced by the expression that it abbreviates."""
    functions = expression.atoms(AppliedUndef)
    replacements = {f: getattr(f.func, SHORTHAND) for f in functions if is_shorthand(f)}
    return _differentiated(expression.xreplace(replacements)) if replacements else expression


def _differentiated(expression: Any) -> Any:
    """Return an expression with all derivatives evaluated, except those of coordinates and given functions."""
    return expression.replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )


def parts_first(
    expression: Any, known: Container[Any], parts: Callable[[Any], Sequence[Any]] = attrgetter("args")
) -> Iterator[Any]:
    """Yield the distinct subexpressions that are not in `known`, each after its parts, without recursion.

    `parts` is a function that returns the parts of a subexpression, by default its arguments. The caller must add each
    subexpression to `known` before it takes the next one.
    """
    stack = [expression]
    while stack:
        node = stack[-1]
        if node not in known:
            fresh = [part for part in parts(node) if part not in known]
            if fresh:
                stack += fresh
                continue
            yield node
        stack.pop()


def is_too_deep(value: Any) -> bool:
    """Return True if an expression is nested too deeply for SymPy's recursive functions, which overflow the stack."""
    level = {id(value): value}
    for _ in range(MOST_LEVELS):
        level = {id(part): part for node in level.values() for part in node.args if isinstance(part, sympy.Basic)}
        if not level:
            return False
    return True


def entries(value: Any, what: str) -> list[Any] | None:
    """Return the entries of a container as a list, or None if the value is not a container.

    Containers are lists, tuples, generators, arrays and matrices. For a matrix with several rows and columns the
    entries are its rows. Raises StatementError for texts, sets, dicts, and too many entries. `what` is the name of the
    value in messages.
    """
    if isinstance(value, TEXTS):
        raise StatementError(f"{what} is the text {shown(value, 60)}: give SymPy expressions.")
    if isinstance(value, (Mapping, Set)):
        raise StatementError(f"{what} is a {type(value).__name__}, which has no order: give a list.")
    if isinstance(value, (sympy.MatrixBase, np.ndarray, sympy.NDimArray)):
        return _of_array(value, what)
    if isinstance(value, sympy.Basic) and not isinstance(value, sympy.Tuple):
        return None
    if not isinstance(value, Iterable):
        return None
    listed = list(islice(value, MOST_ENTRIES + 1))
    if len(listed) > MOST_ENTRIES:
        raise StatementError(f"{what} has more than {MOST_ENTRIES} entries: give fewer.")
    return listed


def _of_array(value: Any, what: str) -> list[Any] | None:
    if isinstance(value, np.ma.MaskedArray):
        raise StatementError(f"{what} is a masked array: give the values alone.")
    shape = value.shape
    if shape == ():
        return None
    if len(shape) > 2 or max(shape) > MOST_ENTRIES:
        raise StatementError(f"{what} has shape {shape}: give a vector, or a matrix, of at most {MOST_ENTRIES}.")
    listed: list[Any] = value.tolist()
    if len(shape) == 2 and 1 in shape:
        return [entry for row in listed for entry in row]
    return listed


def vector(value: Any, what: str) -> list[Any]:
    """Return the entries of a sequence, array or matrix as a list of SymPy expressions.

    A single expression gives one entry. Shorthands such as R[0, 0] stay. `what` is the name of the value in messages.
    """
    components = entries(value, what)
    if components is None:
        return [as_typed(value, what)]
    if not components:
        raise StatementError(f"{what} is empty: give at least one component.")
    return [as_typed(entry, f"component {i} of {what}") for i, entry in enumerate(components)]


def modulo(dividend: Any, divisor: Any) -> Any:
    """Return Mod(dividend, divisor) as an expression with sines and an arctangent. It has the sign of the divisor."""
    angle = 2 * sympy.pi * dividend / divisor
    return divisor / 2 + divisor * sympy.atan2(-sympy.sin(angle), -sympy.cos(angle)) / (2 * sympy.pi)


def without_modulo(expression: Any) -> Any:
    """Return the expression with each Mod, such as x % 2, replaced by the result of `modulo`."""
    return _replaced(
        expression, (sympy.Mod,), lambda part, inner: {part: modulo(*(entry.xreplace(inner) for entry in part.args))}
    )


def real(expression: Any) -> Any:
    """Return the expression with re, im and conjugate evaluated, given that all its functions and parameters are real.

    All quantities of a statement are real, but SymPy's functions of time are not. SymPy turns Abs(exp(x(t))) into
    exp(re(x(t))), and differentiates Abs(x(t)) to a formula in re(x(t)) and im(x(t)).
    """
    return _replaced(expression, (sympy.re, sympy.im, sympy.conjugate), _real_values)


def _real_values(part: Any, inner: dict[Any, Any]) -> dict[Any, Any]:
    """Return {part: value} for re(...), im(...) or conjugate(...), as all functions and parameters are real.

    `inner` has the values of such parts inside of `part`. The value is also entered for `part` with these replaced.
    """
    inside = part.xreplace(inner)
    names = [*inside.atoms(AppliedUndef, sympy.Derivative), *inside.free_symbols]
    dummies = {name: sympy.Dummy(real=True) for name in sorted(names, key=str) if not name.is_real}
    value = inside.xreplace(dummies).xreplace({dummy: name for name, dummy in dummies.items()})
    return {inside: value, part: value}


def _replaced(expression: Any, classes: tuple[Any, ...], values: Callable[[Any, dict[Any, Any]], Any]) -> Any:
    """Return the expression with each subexpression of one of the SymPy `classes` replaced by its value.

    `values(subexpression, inner)` returns {subexpression: value}, where `inner` has the values of those inside it.
    """
    if not expression.has(*classes):
        return expression
    replacements: dict[Any, Any] = {}
    for part in sorted(expression.atoms(*classes), key=lambda part: (sympy.count_ops(part), str(part))):
        replacements |= values(part, replacements)
    return _differentiated(expression.xreplace(replacements))
