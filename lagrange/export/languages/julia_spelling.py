"""How Julia spells operations, literals and words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.syntax import ATOM

KINDS: Mapping[Kind, str] = {REAL: "Float64", WHOLE: "Int64", FLAG: "Bool"}

SPELLED: Mapping[str, tuple[int, str]] = {
    "or": (1, "{0} || {1}"),
    "and": (2, "{0} && {1}"),
    "equal": (4, "{0} == {1}"),
    "less": (4, "{0} < {1}"),
    "less_equal": (4, "{0} <= {1}"),
    "add": (6, "{0} + {1}"),
    "sub": (6, "{0} - {1}"),
    "fma": (6, "{0} * {1} + {2}"),
    "mul": (7, "{0} * {1}"),
    "div": (7, "{0} / {1}"),
    "neg": (8, "-{0}"),
    "not": (8, "!{0}"),
    "select": (ATOM, "ifelse({0}, {1}, {2})"),
}

OPERANDS: Mapping[str, tuple[int, ...]] = {
    "or": (1, 2),
    "and": (2, 3),
    "equal": (6, 6),
    "less": (6, 6),
    "less_equal": (6, 6),
    "add": (6, 7),
    "sub": (6, 7),
    "fma": (7, 8, 7),
    "mul": (7, 8),
    "div": (7, 8),
    "neg": (9,),
    "not": (9,),
    "select": (0, 0, 0),
}

FUNCTIONS: Mapping[str, str] = {
    **{name: name for name in ("atan", "exp", "sinh", "cosh", "tanh", "asinh", "abs", "copysign", "min", "max")},
    "atan2": "atan",
    "quotient": "div",
    "round": "round",
}
"""Functions that have a value wherever they are given numbers; `min` and `max` are NaN where one of them is."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "Float64({0})",
    ("real", FLAG): "Float64({0})",
    ("whole", REAL): "trunc(Int64, {0})",
    ("whole", FLAG): "Int64({0})",
}
"""Operations that depend on what is given."""


def _helper(name: str, given: str, body: str) -> tuple[str, str]:
    """Return a function of numbers with a body of one expression."""
    return name, f"{name}({given}) = {body}\n"


def _real(name: str, outside: str) -> tuple[str, str]:
    """Return a function of x that is NaN where the one of the language raises an error."""
    return _helper(f"{name}_of", "x", f"{outside} ? oftype(x, NaN) : {name}(x)")


HELPERS: Mapping[str, tuple[str, str]] = {
    **{name: _real(name, "isinf(x)") for name in ("sin", "cos", "tan")},
    "sqrt": _real("sqrt", "x < 0"),
    "log": _real("log", "x < 0"),
    "asin": _real("asin", "abs(x) > 1"),
    "acos": _real("acos", "abs(x) > 1"),
    "acosh": _real("acosh", "x < 1"),
    "atanh": _real("atanh", "abs(x) > 1"),
    "power": _helper(
        "power_of",
        "x, y",
        "x < 0 && isfinite(y) && y != trunc(y) ? (isinf(x) ? abs(x)^y : oftype(x^0 * y, NaN)) : x^y",
    ),
    "magnitude": _helper("magnitude", "a, b", "max(abs(a), abs(b))"),
    "sign": _helper("sign_of", "x", "x > 0 ? one(x) : x < 0 ? -one(x) : x"),
    "two_to": _helper("two_to", "n", "ldexp(1.0, n)"),
    "exponent": _helper("exponent_of", "x", "isfinite(x) ? (abs(x) < floatmin(Float64) ? -1023 : exponent(x)) : 1024"),
    "mantissa": _helper("mantissa", "x", "isfinite(x) && x != 0 ? significand(abs(x)) : abs(x)"),
}
"""Functions that are defined in the file: a name, and the definition. NaN stays NaN in all."""

_KEYWORDS = """
    abstract baremodule begin break catch const continue do else elseif end export false finally for function global if
    import in isa let local macro module mutable primitive public quote return struct true try type using where while
"""
_FROM_BASE = """
    Inf NaN Float64 Int64 Bool Vector AbstractVector DimensionMismatch abs acos acosh asin asinh atan atanh copysign cos
    cosh div exp exponent floatmin ifelse im isfinite isinf lastindex ldexp length log max min nothing oftype one pi
    round significand sin sinh sqrt tan tanh throw trunc undef view zero zeros
"""
_OWN = "y p t h out parameters"

KEYWORDS = (*_KEYWORDS.split(),)
RESERVED = (*KEYWORDS, *_FROM_BASE.split(), *_OWN.split())
"""Words that are not names of values: keywords, functions, and what parameters of functions are called."""

MODULES = ("Base", "Core", "Main", *_FROM_BASE.split())
"""Words that are not names of modules."""


def literal(kind: Kind, data: Any) -> tuple[int, str]:
    """Return a constant and how tightly it binds."""
    if kind is FLAG:
        return ATOM, "true" if data else "false"
    if kind is WHOLE:
        return (ATOM if data >= 0 else 8), str(data)
    return (ATOM if math.isnan(data) or math.copysign(1.0, data) > 0 else 8), real_literal(data)


def real_literal(value: float) -> str:
    """Return a double with all its digits."""
    if math.isnan(value):
        return "NaN"
    if math.isinf(value):
        return "Inf" if value > 0 else "-Inf"
    return repr(value)
