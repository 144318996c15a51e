"""The value of nodes at one point, in as many digits as wanted: numbers that can disprove an identity."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import mpmath

from lagrange.graph.node import Kind, Node, reachable

BEYOND_DOUBLES = mpmath.mpf(2) ** 1024
"""Number from which no double is as large. The sine of a number takes as many digits of pi as the number has."""


def values(outputs: Iterable[Node], point: Mapping[Node, Any], context: Any) -> tuple[list[Any], Any] | None:
    """Return the outputs, numbers of an mpmath context, and the largest size of what they are computed from.

    `point` has a number for every symbol. None where something is not a real number in the range of doubles. The
    outputs are formed before any linear system is solved.
    """
    outputs = list(outputs)
    found: dict[Node, Any] = dict(point)
    for node in reachable(outputs):
        if node not in found:
            try:
                value = _value(node, [found[arg] for arg in node.args], context)
            except (ArithmeticError, ValueError):
                return None
            if not isinstance(value, bool) and not (isinstance(value, context.mpf) and abs(value) < BEYOND_DOUBLES):
                return None
            found[node] = value
    largest = max((abs(value) for value in found.values() if not isinstance(value, bool)), default=context.mpf(1))
    return [found[node] for node in outputs], largest


def _value(node: Node, args: list[Any], context: Any) -> Any:
    if node.kind is Kind.CONSTANT:
        return _fraction(node.data, context)
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        terms = [_fraction(c, context) * arg for c, arg in zip(coefficients, args, strict=True)]
        return context.fsum([_fraction(constant, context), *terms])
    if node.kind is Kind.PRODUCT:
        return context.fprod(args)
    if node.kind is Kind.POWER:
        return context.power(args[0], _fraction(node.data, context))
    if node.kind is not Kind.CALL:
        raise ValueError(f"{node.kind.value} has no value here")
    if node.data == "piecewise":
        pairs = zip(args[:-1:2], args[1::2], strict=True)
        return next((value for condition, value in pairs if condition), args[-1])
    return FUNCTIONS[node.data](context, *args)


def _fraction(value: Any, context: Any) -> Any:
    return context.mpf(value.numerator) / value.denominator


def _named(name: str) -> Callable[..., Any]:
    return lambda context, *args: getattr(context, name)(*args)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: _named(name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2")},
    **{name: _named(name) for name in ("exp", "log", "sinh", "cosh", "tanh", "sign")},
    **{name: _named(name) for name in ("asinh", "acosh", "atanh", "erf")},
    "abs": lambda context, a: abs(a),
    "min": lambda context, a, b: min(a, b),
    "max": lambda context, a, b: max(a, b),
    "pow": _named("power"),
    "pi": lambda context: +context.pi,
    "e": lambda context: +context.e,
    "nan": lambda context: context.nan,
    "less": lambda context, a, b: bool(a < b),
    "less_equal": lambda context, a, b: bool(a <= b),
    "equal": lambda context, a, b: bool(a == b),
    "and": lambda context, a, b: a and b,
    "or": lambda context, a, b: a or b,
    "not": lambda context, a: not a,
}
"""The functions of nodes, each of a context and its arguments."""


def precise(digits: int) -> Any:
    """Return an mpmath context of its own with that many digits."""
    context = mpmath.MPContext()
    context.dps = digits
    return context
