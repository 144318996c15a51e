"""Operations, literals and reserved words of JavaScript."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.export.languages.c_spelling import OPERATORS as C_OPERATORS
from lagrange.procedure.spelling import ATOM, Literals, Operator
from lagrange.statement.elementary import ELEMENTARY

OPERATORS: Mapping[str, Operator] = {
    **C_OPERATORS,
    "equal": C_OPERATORS["equal"]._replace(text="{0} === {1}"),
    "quotient": Operator(ATOM, "Math.trunc({0} / {1})", C_OPERATORS["div"].operands),
}

LITERALS = Literals("Infinity", "NaN")

_MATH = (*(name for name in ELEMENTARY if name != "erf"), "abs", "sqrt", "atan2", "min", "max", "sign")
FUNCTIONS: Mapping[str, str] = {name: f"Math.{name}" for name in _MATH}
"""Functions of the language: what has no value is NaN or infinite."""

_BITS = "const bits = new DataView(new ArrayBuffer(8));"

HELPERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "power": (
        "power",
        (
            "// Math.pow(1, NaN) and Math.pow(-1, Infinity) are NaN: here they are 1, as in C.",
            "function power(x, y) {",
            "    return x === 1 || (x === -1 && Math.abs(y) === Infinity) ? 1 : Math.pow(x, y);",
            "}",
        ),
    ),
    "magnitude": (
        "magnitude",
        ("function magnitude(a, b) {", "    return Math.max(Math.abs(a), Math.abs(b));", "}"),
    ),
    "copysign": (
        "copysign",
        (
            "function copysign(x, y) {",
            "    const size = Math.abs(x);",
            "    return y < 0 || Object.is(y, -0) ? -size : size;",
            "}",
        ),
    ),
    "round": (
        "round_even",
        (
            "// The sum has no digits behind the point, and is rounded to the nearest, ties to even.",
            "function round_even(x) {",
            "    if (!(Math.abs(x) < 4503599627370496)) {",
            "        return x;",
            "    }",
            "    const size = Math.abs(x) + 4503599627370496 - 4503599627370496;",
            "    return x < 0 || Object.is(x, -0) ? -size : size;",
            "}",
        ),
    ),
    "two_to": (
        "two_to",
        (
            "function two_to(k) {",
            "    bits.setUint32(0, (k + 1023) << 20);",
            "    bits.setUint32(4, 0);",
            "    return bits.getFloat64(0);",
            "}",
        ),
    ),
    "exponent": (
        "exponent",
        (
            "function exponent(x) {",
            "    bits.setFloat64(0, x);",
            "    return ((bits.getUint32(0) >>> 20) & 2047) - 1023;",
            "}",
        ),
    ),
    "mantissa": (
        "mantissa",
        (
            "function mantissa(x) {",
            "    bits.setFloat64(0, x);",
            "    bits.setUint32(0, (bits.getUint32(0) & 0xfffff) | 0x3ff00000);",
            "    return bits.getFloat64(0);",
            "}",
        ),
    ),
}
"""Operations that JavaScript has no function for, or another one: a name, and its definition."""


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of helpers."""
    lines = [_BITS, ""] if any("bits." in line for op in ops for line in HELPERS[op][1]) else []
    for op in sorted(ops):
        lines += [*HELPERS[op][1], ""]
    return lines


_RESERVED = (
    "arguments async await break case catch class const continue debugger default delete do else enum eval "
    "export extends false finally for function get if implements import in instanceof interface let new null "
    "of package private protected public return set static super switch this throw true try typeof var void "
    "while with yield Array ArrayBuffer DataView Float64Array Infinity Math NaN Number Object String "
    "console globalThis process undefined bits check_length test main default_parameters state_names parameter_names "
    "y p out t h parameters "
)
RESERVED = (*_RESERVED.split(),)
"""Words that are not names of values: keywords, what the file uses, and what parameters of functions are called."""
