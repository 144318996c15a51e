"""How MATLAB and Octave spell operations, literals and words. Every number is a double there."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.spelling import ATOM, Literals, Operator, call
from lagrange.procedure.spelling import OPERATORS as COMMON

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "not": COMMON["not"]._replace(text="~{0}"),
    "quotient": Operator(ATOM, "fix({0} / {1})", COMMON["div"].operands),
    "select": call("pick({0}, {1}, {2})"),
}

LITERALS = Literals("Inf", "NaN")

FUNCTIONS: Mapping[str, str] = {
    name: name for name in ("sin", "cos", "tan", "atan", "atan2", "exp", "sinh", "cosh", "tanh", "asinh", "erf", "abs")
}
"""Functions that are real wherever they are given real numbers."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "{0}",
    ("real", FLAG): "double({0})",
    ("whole", REAL): "fix({0})",
    ("whole", FLAG): "double({0})",
}
"""Operations that depend on what is given."""


def _helper(name: str, given: str, body: str) -> tuple[str, str]:
    """Return a function that sets its result r."""
    lines = [f"    {line}" for line in body.splitlines()]
    return name, "\n".join([f"function r = {name}({given})", *lines, "end", ""])


def _real(name: str, outside: str) -> tuple[str, str]:
    """Return a function of x that is NaN where the one of the language has complex values."""
    return _helper(f"{name}_of", "x", f"if {outside}\n    r = NaN;\nelse\n    r = {name}(x);\nend")


HELPERS: Mapping[str, tuple[str, str]] = {
    "sqrt": _real("sqrt", "x < 0"),
    "log": _real("log", "x < 0"),
    "asin": _real("asin", "abs(x) > 1"),
    "acos": _real("acos", "abs(x) > 1"),
    "acosh": _real("acosh", "x < 1"),
    "atanh": _real("atanh", "abs(x) > 1"),
    "power": _helper(
        "power_of",
        "x, y",
        "if x < 0 && isfinite(x) && y ~= fix(y)\n    r = NaN;\nelse\n    r = abs(x)^y;\n"
        "    if (x < 0 || (x == 0 && 1 / x < 0)) && mod(y, 2) == 1\n        r = -r;\n    end\nend",
    ),
    "select": _helper("pick", "condition, a, b", "if condition\n    r = a;\nelse\n    r = b;\nend"),
    "min": _helper("smaller", "a, b", "if a < b || a ~= a\n    r = a;\nelse\n    r = b;\nend"),
    "max": _helper("larger", "a, b", "if a > b || a ~= a\n    r = a;\nelse\n    r = b;\nend"),
    "magnitude": _helper(
        "magnitude", "a, b", "if abs(a) > abs(b) || a ~= a\n    r = abs(a);\nelse\n    r = abs(b);\nend"
    ),
    "sign": _helper("sign_of", "x", "if x > 0\n    r = 1;\nelseif x < 0\n    r = -1;\nelse\n    r = x;\nend"),
    "copysign": _helper("copy_sign", "a, b", "r = abs(a);\nif b < 0 || (b == 0 && 1 / b < 0)\n    r = -r;\nend"),
    "round": _helper(
        "rounded",
        "x",
        "r = x;\nif abs(x) < 4503599627370496\n    r = (abs(x) + 4503599627370496) - 4503599627370496;\n"
        "    if x < 0\n        r = -r;\n    end\nend",
    ),
    "two_to": _helper("two_to", "n", "r = pow2(1, n);"),
    "exponent": _helper(
        "exponent_of",
        "x",
        "if ~(abs(x) < Inf)\n    r = 1024;\nelseif abs(x) < realmin\n    r = -1023;\nelse\n    [~, r] = log2(x);\n"
        "    r = r - 1;\nend",
    ),
    "mantissa": _helper("mantissa", "x", "[r, ~] = log2(abs(x));\nr = 2 * r;"),
}
"""Functions that are defined in a file: a name, and the definition. NaN stays NaN in all."""

_KEYWORDS = """
    arguments break case catch classdef continue do else elseif end end_try_catch end_unwind_protect endclassdef
    endenumeration endevents endfor endfunction endif endmethods endparfor endproperties endspmd endswitch endwhile
    enumeration events for function global if methods otherwise parfor persistent properties return spmd switch try
    until unwind_protect unwind_protect_cleanup while
"""
_BUILT_IN = """
    abs acos acosh asin asinh atan atan2 atanh cos cosh double erf exp false fix Inf inf isinf log log2 mod NaN nan
    numel pow2 realmin sin sinh sqrt struct tan tanh true zeros ans
"""

_OWN = "y p t h out parameters singular outcome"

KEYWORDS = (*_KEYWORDS.split(),)
RESERVED = (*KEYWORDS, *_BUILT_IN.split(), *_OWN.split())
"""Words that are not names of values: keywords, functions, and what parameters and results of functions are called."""
