"""How Julia spells operations, literals and words."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.procedure.spelling import Literals, Operator, call

KINDS: Mapping[Kind, str] = {REAL: "Float64", WHOLE: "Int64", FLAG: "Bool"}

OPERATORS: Mapping[str, Operator] = {**COMMON, "select": call("ifelse({0}, {1}, {2})")}

LITERALS = Literals("Inf", "NaN")

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

_LIBRARY = """
    Base Core Main Artifacts Dates Distributed Downloads Future Libdl Logging Markdown Mmap Pkg Printf Profile Random
    Serialization Sockets Statistics Tar Test Unicode
    Any Array Channel Char Cmd Colon Complex Condition Dict Enum Event Exception Expr Float16 Float32 Function Int Int8
    Int16 Int32 Integer Iterators Lockable Matrix Meta Method Missing Module Number Nothing Pair Pairs Ptr Rational Real
    Ref Regex Returns Set Signed Some String Symbol Sys Task Text Threads Timer Tuple Type Union Unsigned Val Vector
    Version
"""
MODULES = (*_LIBRARY.split(), *_FROM_BASE.split())
"""Words that are not names of modules: modules of the standard library, and types."""
