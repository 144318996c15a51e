"""The value of nodes: in as many digits as wanted, to disprove an identity, or in doubles at many points at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from lagrange.graph.node import Kind, Node, reachable

BEYOND_DOUBLES = mpmath.mpf(2) ** 1024
"""Number from which no double is as large. The sine of a number takes as many digits of pi as the number has."""


@dataclass(frozen=True)
class Numbers:
    """A kind of numbers: the conversion of a fraction, and the operations and functions of nodes on them."""

    number: Callable[[Fraction], Any]
    total: Callable[[list[Any]], Any]
    product: Callable[[list[Any]], Any]
    power: Callable[[Any, Any], Any]
    choose: Callable[[Any, Any, Any], Any]
    functions: Mapping[str, Callable[..., Any]]


def values(outputs: Iterable[Node], point: Mapping[Node, Any], context: Any) -> tuple[list[Any], Any] | None:
    """Return the outputs, numbers of an mpmath context, and the largest size of what they are computed from.

    `point` has a number for every symbol. None where something is not a real number in the range of doubles. The
    outputs are formed before any linear system is solved.
    """
    outputs = list(outputs)
    numbers = _numbers_of(context)
    found: dict[Node, Any] = dict(point)
    for node in reachable(outputs):
        if node not in found:
            try:
                value = _value(node, [found[arg] for arg in node.args], numbers)
            except (ArithmeticError, ValueError):
                return None
            if not isinstance(value, bool) and not (isinstance(value, context.mpf) and abs(value) < BEYOND_DOUBLES):
                return None
            found[node] = value
    largest = max((abs(value) for value in found.values() if not isinstance(value, bool)), default=context.mpf(1))
    return [found[node] for node in outputs], largest


def doubles(outputs: Iterable[Node], point: Mapping[Node, NDArray[np.float64]], count: int) -> NDArray[np.float64]:
    """Return the outputs in doubles, (outputs, count), at `count` points.

    `point` has an array (count,) for every symbol. A value that does not exist is NaN or infinite.
    """
    outputs = list(outputs)
    found: dict[Node, Any] = dict(point)
    with np.errstate(all="ignore"):
        for node in reachable(outputs):
            if node not in found:
                found[node] = _value(node, [found[arg] for arg in node.args], DOUBLES)
    rows = np.empty((len(outputs), count))
    for row, node in zip(rows, outputs, strict=True):
        row[:] = found[node]
    return rows


def _value(node: Node, args: list[Any], numbers: Numbers) -> Any:
    if node.kind is Kind.CONSTANT:
        return numbers.number(node.data)
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        terms = [numbers.number(c) * arg for c, arg in zip(coefficients, args, strict=True)]
        return numbers.total([numbers.number(constant), *terms])
    if node.kind is Kind.PRODUCT:
        return numbers.product(args)
    if node.kind is Kind.POWER:
        return numbers.power(args[0], numbers.number(node.data))
    if node.kind is not Kind.CALL:
        raise ValueError(f"{node.kind.value} has no value here")
    if node.data == "piecewise":
        chosen = args[-1]
        for condition, value in zip(args[-3::-2], args[-2::-2], strict=True):
            chosen = numbers.choose(condition, value, chosen)
        return chosen
    return numbers.functions[node.data](*args)


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
"""The functions of nodes in many digits, each of an mpmath context and its arguments."""


def precise(digits: int) -> Any:
    """Return an mpmath context of its own with that many digits."""
    context = mpmath.MPContext()
    context.dps = digits
    return context


@cache
def _numbers_of(context: Any) -> Numbers:
    """Return the numbers of an mpmath context."""
    return Numbers(
        number=lambda value: context.mpf(value.numerator) / value.denominator,
        total=context.fsum,
        product=context.fprod,
        power=context.power,
        choose=lambda condition, value, otherwise: value if condition else otherwise,
        functions={name: partial(function, context) for name, function in FUNCTIONS.items()},
    )


def _error_function(a: Any) -> Any:
    """Return the error function of a number or of each number; NumPy has none, and SciPy's takes 0.2 s to import."""
    return np.array([math.erf(x) for x in np.ravel(a).tolist()]).reshape(np.shape(a))[()]


DOUBLE_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "exp": np.exp,
    "log": np.log,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "erf": _error_function,
    "abs": np.abs,
    "sign": np.sign,
    "min": np.minimum,
    "max": np.maximum,
    "less": np.less,
    "less_equal": np.less_equal,
    "equal": np.equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
}
"""The functions of nodes in doubles, on numbers or arrays, as programs have them too."""

DOUBLES = Numbers(
    number=float,
    total=sum,
    product=math.prod,
    power=np.power,
    choose=np.where,
    functions={
        **DOUBLE_FUNCTIONS,
        "pow": np.power,
        "pi": lambda: math.pi,
        "e": lambda: math.e,
        "nan": lambda: math.nan,
    },
)
