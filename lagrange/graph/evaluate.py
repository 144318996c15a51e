"""Evaluate nodes in many digits, in doubles at many points, and modulo a prime; find ranks and sizes of terms.

The size of an expression is the magnitude of its terms, a scale for deciding whether its value is zero.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from lagrange.graph.node import Kind, Node, reachable
from lagrange.statement.vocabulary.functions import ELEMENTARY

BEYOND_DOUBLES = mpmath.mpf(2) ** 1024
"""Smallest number beyond all doubles. Larger values are refused, since their sine would need as many digits of pi."""


@dataclass(frozen=True)
class NumberType:
    """Arithmetic of a type of numbers, such as doubles, as functions that evaluate nodes.

    `number` converts a fraction. `total` adds and `product` multiplies a list. `power` takes base and exponent.
    `choose` takes a condition and two values. `functions` maps names of functions to callables.
    """

    number: Callable[[Fraction], Any]
    total: Callable[[list[Any]], Any]
    product: Callable[[list[Any]], Any]
    power: Callable[[Any, Any], Any]
    choose: Callable[[Any, Any, Any], Any]
    functions: Mapping[str, Callable[..., Any]]


def values(outputs: Iterable[Node], point: Mapping[Node, Any], context: Any) -> tuple[list[Any], Any] | None:
    """Return the outputs as numbers of an mpmath context, and the largest magnitude of all values computed.

    `point` has a number for every symbol. Returns None if a value is not a real number in the range of doubles. Outputs
    must not contain linear solves.
    """
    outputs = list(outputs)
    numbers = _numbers_of(context)
    results: dict[Node, Any] = dict(point)
    for node in reachable(outputs):
        if node not in results:
            try:
                value = _value(node, [results[arg] for arg in node.args], numbers)
            except (ArithmeticError, ValueError):
                return None
            if not isinstance(value, bool) and not (isinstance(value, context.mpf) and abs(value) < BEYOND_DOUBLES):
                return None
            results[node] = value
    largest = max((abs(value) for value in results.values() if not isinstance(value, bool)), default=context.mpf(1))
    return [results[node] for node in outputs], largest


def doubles(outputs: Iterable[Node], point: Mapping[Node, NDArray[np.float64]], count: int) -> NDArray[np.float64]:
    """Return values (outputs, count) of nodes at points {symbol: (count,)}. Undefined values are not finite."""
    outputs = list(outputs)
    results: dict[Node, Any] = dict(point)
    with np.errstate(all="ignore"):
        for node in reachable(outputs):
            if node not in results:
                results[node] = _value(node, [results[arg] for arg in node.args], DOUBLES)
    rows = np.empty((len(outputs), count))
    for row, node in zip(rows, outputs, strict=True):
        row[:] = results[node]
    return rows


def _value(node: Node, args: list[Any], numbers: NumberType) -> Any:
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
    **{name: _named(name) for name in (*ELEMENTARY, "atan2", "sign")},
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
"""Functions that nodes call, by name, in many digits. Their arguments are an mpmath context, then its numbers."""


def precise(digits: int) -> Any:
    """Return a new mpmath context whose numbers have `digits` decimal digits."""
    context = mpmath.MPContext()
    context.dps = digits
    return context


@cache
def _numbers_of(context: Any) -> NumberType:
    """Return the arithmetic of the numbers of an mpmath context as a `NumberType`."""
    return NumberType(
        number=lambda value: context.mpf(value.numerator) / value.denominator,
        total=context.fsum,
        product=context.fprod,
        power=context.power,
        choose=lambda condition, value, otherwise: value if condition else otherwise,
        functions={name: partial(function, context) for name, function in FUNCTIONS.items()},
    )


DOUBLE_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{elementary.name: elementary.of_array for elementary in ELEMENTARY.values()},
    "atan2": np.arctan2,
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
"""Functions that nodes call, by name, in double precision, for numbers and arrays. Programs use them too."""

DOUBLES = NumberType(
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


PRIME = 2**61 - 1


def generic_rank(matrix: Sequence[Sequence[Node]]) -> int:
    """Return the rank of a matrix of nodes at almost every point. It is computed modulo `PRIME` at a random point."""
    nodes = [node for row in matrix for node in row]
    values = _residues(nodes)
    rows = [[values[node] for node in row] for row in matrix]
    rank = 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        inverse = pow(rows[rank][column], -1, PRIME)
        for i in range(rank + 1, len(rows)):
            factor = rows[i][column] * inverse % PRIME
            if factor:
                rows[i] = [(a - factor * b) % PRIME for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
        if rank == len(rows):
            break
    return rank


def _residues(outputs: Sequence[Node]) -> dict[Node, int]:
    """Return {node: residue modulo `PRIME`} at a random point, for every node on which the outputs depend.

    Symbols and values of functions get random residues. Sine and cosine of an angle satisfy sin**2 + cos**2 = 1.
    """
    chosen = random.Random(1)
    residues: dict[Node, int] = {}
    circle: dict[Node, tuple[int, int]] = {}
    for node in reachable(outputs):
        args = [residues[arg] for arg in node.args]
        value: int | None = None
        if node.kind is Kind.CONSTANT:
            value = node.data.numerator * pow(node.data.denominator, -1, PRIME)
        elif node.kind is Kind.SUM:
            constant, coefficients = node.data
            terms = [(constant, 1), *zip(coefficients, args, strict=True)]
            value = sum(c.numerator * pow(c.denominator, -1, PRIME) * arg for c, arg in terms)
        elif node.kind is Kind.PRODUCT:
            value = 1
            for arg in args:
                value = value * arg % PRIME
        elif node.kind is Kind.POWER and isinstance(node.data, int) and (args[0] or node.data > 0):
            value = pow(args[0], node.data, PRIME)
        elif node.kind is Kind.CALL and node.data in ("sin", "cos"):
            if node.args[0] not in circle:
                half = chosen.randrange(1, PRIME)
                over = pow(1 + half * half, -1, PRIME)
                circle[node.args[0]] = 2 * half * over, (1 - half * half) * over
            value = circle[node.args[0]][node.data == "cos"]
        residues[node] = chosen.randrange(1, PRIME) if value is None else value % PRIME
    return residues


BOUNDED = frozenset(elementary.name for elementary in ELEMENTARY.values() if elementary.size == "bounded")
"""Functions whose values are at most 1 in magnitude. Their size, as `term_sizes` defines it, is 1."""

AT_LEAST_ONE = frozenset(
    ("atan2", *(elementary.name for elementary in ELEMENTARY.values() if elementary.size == "unit"))
)
"""Functions whose argument or value is dimensionless, and in whose argument terms may cancel, such as log. So their
size, as `term_sizes` defines it, is at least 1."""


def term_sizes(outputs: Iterable[Node]) -> list[Node]:
    """Return the size of each output as a node that is not negative: a scale for deciding whether the output is zero.

    The size of a sum is the sum of the sizes of its terms. The size of a product is the product of the sizes of its
    factors. Bounded functions, and functions whose value is an angle or a logarithm, have a size of at least 1, the
    unit of their argument or value. So x**2 + y**2 - l**2 has the size x**2 + y**2 + l**2, and l sin(a) has the size l
    at every angle.
    """
    outputs = list(outputs)
    sizes: dict[Node, Node] = {}
    for node in reachable(outputs):
        sizes[node] = _size(node, sizes)
    return [sizes[node] for node in outputs]


def _size(node: Node, sizes: dict[Node, Node]) -> Node:
    """Return the size of a node as a node, from the `sizes` of its arguments.

    The size is the magnitude that the value would have if no terms cancelled.
    """
    graph, inner = node.graph, [sizes[arg] for arg in node.args]
    if node.kind is Kind.SUM:
        constant, coefficients = node.data
        return graph.sum([(abs(c), size) for c, size in zip(coefficients, inner, strict=True)], abs(constant))
    if node.kind is Kind.PRODUCT:
        return graph.product(inner)
    if node.kind is Kind.POWER and node.data > 0:
        return graph.power(inner[0], node.data)
    if node.kind is not Kind.CALL:
        return graph.call("abs", node)
    if node.data in BOUNDED:
        return graph.one
    if node.data in ("min", "max"):
        return graph.call("max", *inner)
    if node.data == "abs":
        return inner[0]
    if node.data == "piecewise":
        conditions = node.args[:-1:2]
        return graph.piecewise(list(zip(conditions, inner[1::2], strict=True)), inner[-1])
    size = graph.call("abs", node)
    return size + 1 if node.data in AT_LEAST_ONE else size
