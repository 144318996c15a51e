"""The value of each SymPy node on mpmath's raw numbers: the operations of `lagrange.evidence.precise`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, reduce
from typing import Any

import sympy
from mpmath import libmp

Operation = Callable[..., Any]

_HUGE = 40
"""Binary exponent of an argument from which exp and its like are refused: mpmath would compute for ever."""


_RANGE = 1024
"""Binary exponent of an argument from which sine and its like are refused: no double is as large. mpmath would compute
pi to as many digits as the argument has in front of the point."""


class OutsideDomain(Exception):
    """An expression has no real, finite value at the point asked for."""


class BeyondDoubles(OutsideDomain):
    """The value exists, but an intermediate result exceeds the range of doubles."""


def numeric_operation(node: Any, prec: int) -> Operation:
    """Return the function from a node's argument values to its value, at `prec` bits."""
    if isinstance(node, sympy.Pow):
        return _power(node.exp, prec)
    table = _NUMERIC.get(type(node))
    if table is None:
        raise OutsideDomain(f"{type(node).__name__} cannot be evaluated here")
    return table(prec)


def switch_outcome(node: Any, value: Any, arguments: Sequence[Any]) -> int | None:
    """Return the outcome of a condition, Abs, sign, Min or Max; None if it has no value."""
    if isinstance(value, OutsideDomain):
        return None
    if isinstance(value, bool):
        return int(value)
    if isinstance(node, (sympy.Min, sympy.Max)):
        return list(arguments).index(value)
    return int(libmp.mpf_sign(arguments[0]))


def _add(prec: int) -> Operation:
    return lambda *terms: libmp.mpf_sum(terms, prec, "n")


def _multiply(prec: int) -> Operation:
    def product(first: Any, *rest: Any) -> Any:
        for factor in rest:
            first = libmp.mpf_mul(first, factor, prec, "n")
        return first

    return product


def _power(exponent: Any, prec: int) -> Operation:
    if isinstance(exponent, sympy.Integer):
        n = int(exponent)
        return lambda base, _: libmp.mpf_pow_int(base, n, prec, "n")
    if exponent == sympy.S.Half:
        return lambda base, _: libmp.mpf_sqrt(base, prec, "n")

    def power(base: Any, power: Any) -> Any:
        if base == libmp.fzero and libmp.mpf_sign(power) <= 0:
            raise ZeroDivisionError("zero to a power that is not positive")
        return libmp.mpf_pow(base, _bounded(power), prec, "n")

    return power


def _unary(function: Callable[[Any, int, str], Any]) -> Callable[[int], Operation]:
    # Cached: differencing moves one coordinate at a time, so the same few arguments recur.
    return lambda prec: lru_cache(maxsize=1024)(lambda x: function(x, prec, "n"))


def _bounded(x: Any) -> Any:
    if x[2] + x[3] > _HUGE:
        raise OverflowError("a number beyond any range")
    return x


def _growing(function: Callable[[Any, int, str], Any]) -> Callable[[int], Operation]:
    return _unary(lambda x, prec, rounding: function(_bounded(x), prec, rounding))


def _periodic(function: Callable[[Any, int, str], Any]) -> Callable[[int], Operation]:
    return _unary(lambda x, prec, rounding: function(_double(x), prec, rounding))


def _double(x: Any) -> Any:
    if x[2] + x[3] > _RANGE:
        raise OverflowError("an angle beyond the range of double precision")
    return x


def _reciprocal(function: Callable[[Any, int, str], Any]) -> Callable[[int], Operation]:
    return _periodic(
        lambda x, prec, rounding: libmp.mpf_div(libmp.fone, function(x, prec + 10, rounding), prec, rounding)
    )


def _log(prec: int) -> Operation:
    def log(x: Any) -> Any:
        if x == libmp.fzero:
            raise ZeroDivisionError("logarithm of zero")
        return libmp.mpf_log(x, prec, "n")

    return log


def _atan2(prec: int) -> Operation:
    def atan2(y: Any, x: Any) -> Any:
        if x == libmp.fzero and y == libmp.fzero:
            raise ZeroDivisionError("atan2(0, 0)")
        return libmp.mpf_atan2(y, x, prec, "n")

    return atan2


def _sign(_: int) -> Operation:
    return lambda x: libmp.from_int(libmp.mpf_sign(x))


def _sinc(x: Any, prec: int, rounding: str) -> Any:
    if x == libmp.fzero:
        return libmp.fone
    return libmp.mpf_div(libmp.mpf_sin(x, prec + 10, rounding), x, prec, rounding)


def _heaviside(x: Any, middle: Any) -> Any:
    side = libmp.mpf_sign(x)
    return middle if side == 0 else libmp.fone if side > 0 else libmp.fzero


def _extreme(better: Callable[[Any, Any], bool]) -> Callable[[int], Operation]:
    def choose(a: Any, b: Any) -> Any:
        return a if better(a, b) else b

    return lambda prec: lambda *xs: reduce(choose, xs)


def _piecewise(_: int) -> Operation:
    def select(*parts: Any) -> Any:
        for value, condition in zip(parts[::2], parts[1::2], strict=True):
            if condition is not False:
                return value if condition is True else condition
        raise ValueError("no branch of the Piecewise applies")

    return select


_NUMERIC: dict[Any, Callable[[int], Operation]] = {
    sympy.Add: _add,
    sympy.Mul: _multiply,
    sympy.sin: _periodic(libmp.mpf_sin),
    sympy.cos: _periodic(libmp.mpf_cos),
    sympy.tan: _periodic(libmp.mpf_tan),
    sympy.cot: _reciprocal(libmp.mpf_tan),
    sympy.sec: _reciprocal(libmp.mpf_cos),
    sympy.csc: _reciprocal(libmp.mpf_sin),
    sympy.asin: _unary(libmp.mpf_asin),
    sympy.acos: _unary(libmp.mpf_acos),
    sympy.atan: _unary(libmp.mpf_atan),
    sympy.atan2: _atan2,
    sympy.exp: _growing(libmp.mpf_exp),
    sympy.log: _log,
    sympy.sinh: _growing(libmp.mpf_sinh),
    sympy.cosh: _growing(libmp.mpf_cosh),
    sympy.tanh: _growing(libmp.mpf_tanh),
    sympy.sinc: _periodic(_sinc),
    sympy.asinh: _unary(libmp.mpf_asinh),
    sympy.acosh: _unary(libmp.mpf_acosh),
    sympy.atanh: _unary(libmp.mpf_atanh),
    sympy.erf: _unary(libmp.mpf_erf),
    sympy.Heaviside: lambda _: _heaviside,
    sympy.Abs: lambda _: libmp.mpf_abs,
    sympy.sign: _sign,
    sympy.Min: _extreme(libmp.mpf_lt),
    sympy.Max: _extreme(libmp.mpf_gt),
    sympy.Piecewise: _piecewise,
}


def _decided(parts: Sequence[Any], *, verdict: bool) -> Any:
    """Return the decisive value if a part has it, else the first part without a value, else the opposite."""
    if any(part is verdict for part in parts):
        return verdict
    return next((part for part in parts if not isinstance(part, bool)), not verdict)


def _not(part: Any) -> Any:
    return not part if isinstance(part, bool) else part


def _either(condition: Any, then: Any, otherwise: Any) -> Any:
    """Return the disjunction of two conditions, which SymPy forms from a Max inside a Max."""
    return condition if not isinstance(condition, bool) else then if condition else otherwise


BOOLEAN: dict[Any, Operation] = {
    sympy.StrictLessThan: libmp.mpf_lt,
    sympy.LessThan: libmp.mpf_le,
    sympy.StrictGreaterThan: libmp.mpf_gt,
    sympy.GreaterThan: libmp.mpf_ge,
    sympy.Equality: lambda a, b: bool(libmp.mpf_eq(_number(a), _number(b))),
    sympy.Unequality: lambda a, b: not libmp.mpf_eq(_number(a), _number(b)),
    sympy.And: lambda *parts: _decided(parts, verdict=False),
    sympy.Or: lambda *parts: _decided(parts, verdict=True),
    sympy.Not: _not,
    sympy.ITE: _either,
}


def _number(value: Any) -> Any:
    if not isinstance(value, tuple):
        raise TypeError("not a number")
    return value
