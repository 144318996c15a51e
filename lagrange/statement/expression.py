"""The gate to SymPy: values from users become expressions here, or are refused.

SymPy runs texts: `sympify` evaluates them as Python, also inside lists and matrices. So all values from users reach
SymPy only through this module, entry by entry.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable, Mapping, Set
from functools import wraps
from itertools import islice
from typing import Any, ParamSpec, TypeVar

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError, formula, shown
from lagrange.statement.number import real_number

MOST_ENTRIES = 10_000
"""Largest number of entries of a vector. A generator with more is refused, for it may have no end."""

MOST_LEVELS = 400
"""Largest number of levels of an expression. SymPy's `free_symbols` takes two of Python's 1,000 nested calls for each
level."""

TEXTS = (str, bytes, bytearray, memoryview)


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def refusing_deep(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function that refuses expressions in which SymPy overflows Python's stack.

    Products and derivatives take up to eight nested calls for each level, and so overflow below `MOST_LEVELS` levels.
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
    """A value that is no single expression, such as a rotation; `remedy` says what to give in its place."""

    remedy: str


def expression(value: Any, what: str) -> Any:
    """Return a user's value, an expression or a number, as a SymPy expression; `what` names it in the refusal."""
    return in_full(as_typed(value, what))


def as_typed(value: Any, what: str) -> Any:
    """Return an expression as `expression` does, but with shorthands such as R[0, 0] as they are."""
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
        raise StatementError(f"{what} is {shown(value, 60)} ({type(value).__name__}): give one SymPy expression.")
    if isinstance(value, NonScalar):
        raise StatementError(f"{what} is {shown(value)}: {value.remedy}.")
    number = real_number(value, what)
    if isinstance(value, numbers.Rational):  # an int too, exactly
        return sympy.Rational(int(value.numerator), int(value.denominator))
    return sympy.Float(number)


SHORTHAND = "shorthand"
"""Attribute of a function of time with the expression that it abbreviates, such as an entry of a rotation."""


def is_shorthand(value: Any) -> bool:
    """Return True for a function of time that abbreviates an expression."""
    return isinstance(value, AppliedUndef) and hasattr(value.func, SHORTHAND)


def in_full(expression: Any) -> Any:
    """Return an expression with each shorthand replaced by its expression, also inside derivatives."""
    functions = expression.atoms(AppliedUndef)
    replacements = {f: getattr(f.func, SHORTHAND) for f in functions if is_shorthand(f)}
    return _differentiated(expression.xreplace(replacements)) if replacements else expression


def _differentiated(expression: Any) -> Any:
    """Return an expression with derivatives carried out, except those of coordinates and given functions."""
    return expression.replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )


def is_too_deep(value: Any) -> bool:
    """Return True if an expression is nested too deeply for SymPy's recursive functions."""
    level = {id(value): value}
    for _ in range(MOST_LEVELS):
        level = {id(part): part for node in level.values() for part in node.args if isinstance(part, sympy.Basic)}
        if not level:
            return False
    return True


def entries(value: Any, what: str) -> list[Any] | None:
    """Return the entries of a container unchanged, or None if the value is not a container.

    Containers are lists, tuples, generators, arrays and matrices; a matrix with several rows and columns gives its
    rows. Raises StatementError for texts, sets and dicts.
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
    """Return the entries of a sequence, array or matrix as typed; a single expression is a vector of one entry."""
    components = entries(value, what)
    if components is None:
        return [as_typed(value, what)]
    if not components:
        raise StatementError(f"{what} is empty: give at least one component.")
    return [as_typed(entry, f"component {i} of {what}") for i, entry in enumerate(components)]


def modulo(dividend: Any, divisor: Any) -> Any:
    """Return Mod(dividend, divisor), which has the sign of the divisor, in sines and an arctangent."""
    angle = 2 * sympy.pi * dividend / divisor
    return divisor / 2 + divisor * sympy.atan2(-sympy.sin(angle), -sympy.cos(angle)) / (2 * sympy.pi)


def without_modulo(expression: Any) -> Any:
    """Return the expression with every Mod, such as x % 2, replaced by `modulo`."""
    if not expression.has(sympy.Mod):
        return expression
    replacements: dict[Any, Any] = {}
    # Inner ones first: the outer ones contain them.
    for part in sorted(expression.atoms(sympy.Mod), key=lambda part: (sympy.count_ops(part), str(part))):
        replacements[part] = modulo(*(argument.xreplace(replacements) for argument in part.args))
    return _differentiated(expression.xreplace(replacements))


_PARTS = (sympy.re, sympy.im, sympy.conjugate)


def real(expression: Any) -> Any:
    """Return the expression with re, im and conjugate evaluated for real functions and parameters.

    All quantities of a statement are real, but SymPy's functions of time are not: it turns Abs(exp(x(t))) into
    exp(re(x(t))), and differentiates Abs(x(t)) to a formula in re(x(t)) and im(x(t)).
    """
    if not expression.has(*_PARTS):
        return expression
    parts = sorted(expression.atoms(*_PARTS), key=lambda part: (sympy.count_ops(part), str(part)))
    replacements: dict[Any, Any] = {}
    for part in parts:  # inner ones first: the outer ones contain them
        replacements[part.xreplace(replacements)] = replacements[part] = _real_part(part.xreplace(replacements))
    replaced = expression.xreplace(replacements)
    return replaced.replace(
        lambda node: isinstance(node, sympy.Derivative) and not isinstance(node.expr, AppliedUndef),
        lambda node: node.doit(deep=False),
    )


def _real_part(part: Any) -> Any:
    """Return re(...), im(...) or conjugate(...) evaluated with a real symbol in place of each name."""
    names = [*part.atoms(AppliedUndef, sympy.Derivative), *part.free_symbols]
    stand_ins = {name: sympy.Dummy(real=True) for name in sorted(names, key=str) if not name.is_real}
    return part.xreplace(stand_ins).xreplace({symbol: name for name, symbol in stand_ins.items()})
