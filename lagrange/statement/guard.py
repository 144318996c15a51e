"""Bounds on what SymPy is asked to compute while an expression is built from text.

SymPy evaluates what it is given at once: 9**9**9 would never end, nor would exp(x + 10**9*log(2)), a sum of a
thousand fractions with long denominators, or the question whether the tanh of nested roots is real. Each rule
here closes one such door.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cmp_to_key
from typing import Any

import sympy
import sympy.assumptions.wrapper  # SymPy loads these three late: named here, reading a scene imports nothing
import sympy.sets.setexpr
import sympy.tensor.tensor
from sympy.functions.elementary.piecewise import ExprCondPair

LARGEST_EXPONENT = 1000
MOST_BITS = 256
"""The most bits of an exact numerator or denominator, which is 77 digits."""
MOST_BRANCHES = 32
"""The most branches of a condition."""
MOST_ARGUMENTS = 16
"""The most arguments of min and max: SymPy compares them pair by pair."""
MOST_DOUBTFUL = 5
"""The most parts that may be complex in an expression that SymPy splits into its real and imaginary part: each can
double the work."""
MOST_COMPARED = 200
"""The most parts of the expressions that a comparison, an absolute value, a minimum or a maximum compares."""
CHUNK = 50
"""The number of terms that SymPy adds at once. The exact coefficients are checked after each such chunk."""

_COMPARING = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.sinc, sympy.erf)
_SPLITTING = (sympy.Abs, sympy.sinh, sympy.cosh, sympy.tanh)
_NUMBER_FIRST = (sympy.Add, sympy.Mul)


class RefusalError(Exception):
    """Why an expression is refused; the reader adds where it stands."""


class Guard:
    """Checks every expression that arises while one text is read, each distinct one once."""

    def __init__(self) -> None:
        self.varies: dict[Any, bool] = {}

    def check(self, expression: Any) -> bool:
        """Check the expression and its parts, and return whether it depends on any name."""
        for node in parts_first(expression, self.varies):
            if not isinstance(node, sympy.Symbol):
                _check_node(node)
            self.varies[node] = isinstance(node, sympy.Symbol) or any(self.varies[part] for part in node.args)
        return self.varies[expression]

    def join(self, build: Callable[..., Any], parts: list[Any]) -> Any:
        """Return `build(*parts)` for sympy.Add or sympy.Mul, in chunks of which each is checked."""
        while len(parts) > CHUNK:
            parts = [build(*parts[i : i + CHUNK]) for i in range(0, len(parts), CHUNK)]
            for part in parts:
                self.check(part)
        return build(*parts)


def parts_first(expression: Any, known: Mapping[Any, Any]) -> Iterator[Any]:
    """Yield the distinct subexpressions that are not known yet, each after its own parts.

    The caller makes each one known before it asks for the next.
    """
    todo = [expression]
    while todo:
        node = todo[-1]
        fresh = [part for part in node.args if part not in known]
        if fresh:
            todo.extend(fresh)
            continue
        todo.pop()
        if node not in known:
            yield node


def replace(expression: Any, table: Mapping[Any, Any]) -> Any:
    """Return the expression with symbols replaced, in SymPy's order of terms, and nothing else evaluated.

    SymPy does not take x(t) for real: evaluated with it, roots and absolute values would lose what they are.
    """
    done: dict[Any, Any] = dict(table)
    for node in parts_first(expression, done):
        args = [done[part] for part in node.args]
        done[node] = node if all(new is old for new, old in zip(args, node.args, strict=True)) else _rebuilt(node, args)
    return done[expression]


def _rebuilt(node: Any, args: list[Any]) -> Any:
    if isinstance(node, ExprCondPair):
        return node.func(*args)
    if isinstance(node, _NUMBER_FIRST):
        numbers = [arg for arg in args if isinstance(arg, sympy.Number)]
        others = [arg for arg in args if not isinstance(arg, sympy.Number)]
        args = numbers + sorted(others, key=cmp_to_key(sympy.Basic.compare))
    return node.func(*args, evaluate=False)


def check_power(base: Any, exponent: Any) -> None:
    """Refuse a power before SymPy computes it."""
    _check_exponent(exponent)
    if isinstance(base, sympy.Rational) and isinstance(exponent, sympy.Number):
        bits = max(abs(base.p).bit_length(), base.q.bit_length())
        if bits > 1 and bits * abs(exponent) > 2 * MOST_BITS:
            raise RefusalError(
                f"{float(base):g}**{float(exponent):g} is too long for an exact number: write a decimal, such as "
                "1.5e100"
            )


def check_arguments(build: Any, arguments: list[Any]) -> None:
    """Refuse arguments of a function that SymPy would take too long to evaluate, or later to ask about."""
    if build is sympy.exp and arguments[0].has(sympy.log):
        _check_exponent(arguments[0])  # exp(n*log(x)) becomes the power x**n
    if build in _COMPARING:
        check_compared(
            arguments, f"the {'argument' if len(arguments) == 1 else 'arguments'} of {build.__name__.lower()}"
        )
    if build in _SPLITTING and _doubtful(arguments[0]) > MOST_DOUBTFUL:
        raise RefusalError(
            f"the argument of {build.__name__.lower()} has more than {MOST_DOUBTFUL} parts that may be complex, "
            "such as roots and logarithms: write it with fewer"
        )


def check_compared(expressions: list[Any], what: str) -> None:
    """Refuse to compare long expressions, which SymPy puts on a common denominator to see the sign."""
    size: dict[Any, int] = {}
    for expression in expressions:
        for node in parts_first(expression, size):
            size[node] = 1 + sum(size[part] for part in node.args)
    if sum(size[expression] for expression in expressions) > MOST_COMPARED:
        raise RefusalError(f"there are more than {MOST_COMPARED} parts in {what}: write something shorter")


def _doubtful(argument: Any) -> int:
    """Return how many parts SymPy does not know to be real."""
    doubt: dict[Any, bool] = {}
    for node in parts_first(argument, doubt):
        doubt[node] = isinstance(node, sympy.Expr) and not node.is_extended_real
    return sum(doubt.values())


def _check_exponent(exponent: Any) -> None:
    for number in exponent.atoms(sympy.Number):
        if abs(number) > LARGEST_EXPONENT:
            raise RefusalError(f"the exponent {float(number):g} is out of bounds: at most {LARGEST_EXPONENT} in size")


def _check_node(node: Any) -> None:
    if isinstance(node, sympy.Rational):
        if max(abs(node.p).bit_length(), node.q.bit_length()) > MOST_BITS:
            raise RefusalError("an exact number here is longer than 77 digits: write a decimal, such as 1.5e100")
    elif isinstance(node, sympy.Float):
        _check_float(node)
    elif node in (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo):
        raise RefusalError("this has no finite value: check for a division by zero")
    elif node is sympy.I:
        raise RefusalError("this is not real: energies and forces are real")
    elif isinstance(node, sympy.Pow):
        _check_exponent(node.exp)
    elif isinstance(node, (sympy.Min, sympy.Max)) and len(node.args) > MOST_ARGUMENTS:
        raise RefusalError(f"min and max take at most {MOST_ARGUMENTS} arguments")


def _check_float(number: Any) -> None:
    if abs(number) > sys.float_info.max:
        raise RefusalError("a number here is too large for a floating-point number")
    if number != 0 and float(number) == 0.0:
        raise RefusalError("a number here is too small for a floating-point number")
