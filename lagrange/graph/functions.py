"""Table of elementary functions: arity, derivatives and exact values.

`partials` has one rule per argument, which returns the derivative from the value and the arguments. The code that
computes a function is stated with each target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lagrange.graph.node import Node

PartialRule = Callable[..., "Node"]


@dataclass(frozen=True)
class Function:
    """One elementary function: its name, number of arguments (None: any) and derivative rules.

    min and max always equal one of their two arguments. Instead of rules they have `first`, the condition that this is
    the first argument. They are differentiated as a choice, which ignores an infinite derivative of the other one.
    """

    name: str
    arity: int | None
    partials: tuple[PartialRule, ...] = ()
    first: PartialRule | None = None


def _apply(name: str) -> PartialRule:
    return lambda *args: args[0].graph.call(name, *args)


sin, cos, tan, sinh, cosh, tanh, exp, log, sign, pow_ = map(
    _apply, ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sign", "pow")
)


def _sqrt(a: Node) -> Node:
    return a ** Fraction(1, 2)


def bell(a: Node) -> Node:
    """Return the derivative of the error function, 2/sqrt(pi) exp(-a**2)."""
    return 2 * exp(-(a**2)) / _sqrt(a.graph.call("pi"))


FUNCTIONS: dict[str, Function] = {
    function.name: function
    for function in (
        Function("sin", 1, (lambda y, a: cos(a),)),
        Function("cos", 1, (lambda y, a: -sin(a),)),
        Function("tan", 1, (lambda y, a: 1 + y**2,)),
        Function("asin", 1, (lambda y, a: 1 / _sqrt(1 - a**2),)),
        Function("acos", 1, (lambda y, a: -1 / _sqrt(1 - a**2),)),
        Function("atan", 1, (lambda y, a: 1 / (1 + a**2),)),
        Function("atan2", 2, (lambda y, a, b: b / (a**2 + b**2), lambda y, a, b: -a / (a**2 + b**2))),
        Function("exp", 1, (lambda y, a: y,)),
        Function("log", 1, (lambda y, a: 1 / a,)),
        Function("sinh", 1, (lambda y, a: cosh(a),)),
        Function("cosh", 1, (lambda y, a: sinh(a),)),
        Function("tanh", 1, (lambda y, a: 1 - y**2,)),
        Function("asinh", 1, (lambda y, a: 1 / _sqrt(1 + a**2),)),
        Function("acosh", 1, (lambda y, a: 1 / _sqrt(a**2 - 1),)),
        Function("atanh", 1, (lambda y, a: 1 / (1 - a**2),)),
        Function("erf", 1, (lambda y, a: bell(a),)),
        Function("abs", 1, (lambda y, a: sign(a),)),
        Function("sign", 1, (lambda y, a: a.graph.zero,)),
        Function("min", 2, first=lambda a, b: a.graph.call("less_equal", a, b)),
        Function("max", 2, first=lambda a, b: a.graph.call("less_equal", b, a)),
        Function("pow", 2, (lambda y, a, b: b * pow_(a, b - 1), lambda y, a, b: y * log(a))),
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

ODD = frozenset(("sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "erf", "sign"))
EVEN = frozenset(("cos", "cosh", "abs"))

EXACT: dict[tuple[Any, ...], int] = {
    ("sin", 0): 0,
    ("cos", 0): 1,
    ("tan", 0): 0,
    ("asin", 0): 0,
    ("acos", 1): 0,
    ("atan", 0): 0,
    ("exp", 0): 1,
    ("log", 1): 0,
    ("sinh", 0): 0,
    ("cosh", 0): 1,
    ("tanh", 0): 0,
    ("asinh", 0): 0,
    ("acosh", 1): 0,
    ("atanh", 0): 0,
    ("erf", 0): 0,
}
"""Exact values, used to fold constants: (function, argument) to value."""

FOLDS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "sign": lambda a: (a > 0) - (a < 0),
    "min": min,
    "max": max,
}
"""Functions that fold exact numbers to exact numbers."""
