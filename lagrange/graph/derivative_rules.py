"""Table of the functions that nodes of the graph may call: number of arguments, derivatives, and exact values.

`partials` has one rule for each argument. A rule returns the derivative from the function's value and its arguments.
Each target defines its own code for a function. The rules of elementary functions of one number are in
`lagrange/statement/vocabulary/elementary.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lagrange.statement.vocabulary.elementary import ELEMENTARY

if TYPE_CHECKING:
    from lagrange.graph.node import Node

PartialRule = Callable[..., "Node"]


@dataclass(frozen=True)
class Function:
    """One elementary function: its name, number of arguments (None: any) and derivative rules.

    min and max always equal one of their two arguments. They have no rules. Instead `first` returns the condition that
    the result is the first argument. They are differentiated as a choice, which ignores an infinite derivative of the
    argument not chosen.
    """

    name: str
    arity: int | None
    partials: tuple[PartialRule, ...] = ()
    first: PartialRule | None = None


FUNCTIONS: dict[str, Function] = {
    function.name: function
    for function in (
        *(Function(elementary.name, 1, (elementary.partial,)) for elementary in ELEMENTARY.values()),
        Function("atan2", 2, (lambda y, a, b: b / (a**2 + b**2), lambda y, a, b: -a / (a**2 + b**2))),
        Function("abs", 1, (lambda y, a: a.graph.call("sign", a),)),
        Function("sign", 1, (lambda y, a: a.graph.zero,)),
        Function("min", 2, first=lambda a, b: a.graph.call("less_equal", a, b)),
        Function("max", 2, first=lambda a, b: a.graph.call("less_equal", b, a)),
        Function("pow", 2, (lambda y, a, b: b * a ** (b - 1), lambda y, a, b: y * a.graph.call("log", a))),
        Function("pi", 0),
        Function("e", 0),
        Function("nan", 0),
        Function("less", 2),
        Function("less_equal", 2),
        Function("equal", 2),
        Function("and", 2),
        Function("or", 2),
        Function("not", 1),
        Function("piecewise", None),
    )
}

CONDITIONS = frozenset(("less", "less_equal", "equal", "and", "or", "not"))
"""Functions whose value is true or false."""

ODD = frozenset(("sign", *(elementary.name for elementary in ELEMENTARY.values() if elementary.odd)))
EVEN = frozenset(("abs", *(elementary.name for elementary in ELEMENTARY.values() if elementary.even)))

EXACT: dict[tuple[Any, ...], int] = {
    (elementary.name, elementary.exact[0]): elementary.exact[1] for elementary in ELEMENTARY.values()
}
"""Exact values, used to fold constants: (function, argument) to value."""

FOLDS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "sign": lambda a: (a > 0) - (a < 0),
    "min": min,
    "max": max,
}
"""Functions that fold exact numbers to exact numbers."""
