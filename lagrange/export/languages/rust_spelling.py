"""How Rust spells operations, literals and words."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.export.target import QUANTITIES
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.procedure.spelling import Literals, Operator

KINDS: Mapping[Kind, str] = {REAL: "f64", WHOLE: "i64", FLAG: "bool"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "select": Operator(1, "if {0} {{ {1} }} else {{ {2} }}"),
    "quotient": COMMON["div"],
}

LITERALS = Literals("f64::INFINITY", "f64::NAN")

LIBRARY: Mapping[str, str] = {
    **{name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "sinh", "cosh", "tanh")},
    "log": "ln",
    "log1p": "ln_1p",
    "atan2": "atan2",
    "power": "powf",
}
"""Functions of the standard library, each a method of its first argument."""

FOREIGN: Mapping[str, str] = {"power": "pow"}
"""What functions are called in the C library, where that is another name."""

BINARY = ("atan2", "power")

HELPERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "abs": ("abs", ("fn abs(x: f64) -> f64 {", "    f64::from_bits(x.to_bits() & (u64::MAX >> 1))", "}")),
    "min": ("smaller", ("fn smaller(a: f64, b: f64) -> f64 {", "    if a < b || a.is_nan() { a } else { b }", "}")),
    "max": ("larger", ("fn larger(a: f64, b: f64) -> f64 {", "    if a > b || a.is_nan() { a } else { b }", "}")),
    "magnitude": (
        "magnitude",
        (
            "fn magnitude(a: f64, b: f64) -> f64 {",
            "    let (x, y) = (abs(a), abs(b));",
            "    if x > y || x.is_nan() { x } else { y }",
            "}",
        ),
    ),
    "sign": (
        "sign",
        (
            "fn sign(x: f64) -> f64 {",
            "    if x > 0.0 { 1.0 } else if x < 0.0 { -1.0 } else { x }",
            "}",
        ),
    ),
    "copysign": (
        "copysign",
        (
            "fn copysign(x: f64, y: f64) -> f64 {",
            "    let sign = 1 << 63;",
            "    f64::from_bits((x.to_bits() & !sign) | (y.to_bits() & sign))",
            "}",
        ),
    ),
    "round": (
        "round_even",
        (
            "// The sum has no digits behind the point, and is rounded to the nearest, ties to even.",
            "fn round_even(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    let most = 4503599627370496.0;",
            "    if size < most { copysign((size + most) - most, x) } else { x }",
            "}",
        ),
    ),
    "asinh": (
        "asinh",
        (
            "// The methods of the standard library lose digits: here log1p takes what is small.",
            "fn asinh(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    if size > 1.0e8 {",
            "        return copysign(math::log(size) + core::f64::consts::LN_2, x);",
            "    }",
            "    let square = size * size;",
            "    copysign(math::log1p(size + square / (1.0 + math::sqrt(1.0 + square))), x)",
            "}",
        ),
    ),
    "acosh": (
        "acosh",
        (
            "fn acosh(x: f64) -> f64 {",
            "    if x < 1.0 {",
            "        return f64::NAN;",
            "    }",
            "    if x > 1.0e8 {",
            "        return math::log(x) + core::f64::consts::LN_2;",
            "    }",
            "    let above = x - 1.0;",
            "    math::log1p(above + math::sqrt(above * (above + 2.0)))",
            "}",
        ),
    ),
    "atanh": (
        "atanh",
        (
            "fn atanh(x: f64) -> f64 {",
            "    let size = abs(x);",
            "    copysign(0.5 * math::log1p(2.0 * size / (1.0 - size)), x)",
            "}",
        ),
    ),
    "two_to": ("two_to", ("fn two_to(k: i64) -> f64 {", "    f64::from_bits(((k + 1023) as u64) << 52)", "}")),
    "exponent": (
        "exponent",
        ("fn exponent(x: f64) -> i64 {", "    ((x.to_bits() >> 52) & 2047) as i64 - 1023", "}"),
    ),
    "mantissa": (
        "mantissa",
        (
            "fn mantissa(x: f64) -> f64 {",
            "    f64::from_bits((x.to_bits() & ((1 << 52) - 1)) | (1023 << 52))",
            "}",
        ),
    ),
    "real": ("real", ("fn real(k: i64) -> f64 {", "    k as f64", "}")),
    "whole": ("whole", ("fn whole(x: f64) -> i64 {", "    x as i64", "}")),
}
"""Operations that are defined in the file: a name, and its definition. NaN stays NaN in all."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    "magnitude": ("abs",),
    "round": ("abs", "copysign"),
    "asinh": ("abs", "copysign", "log", "log1p", "sqrt"),
    "acosh": ("log", "log1p", "sqrt"),
    "atanh": ("abs", "copysign", "log1p"),
}
"""The operations that the definitions of others use."""

_RESERVED = (
    "as async await break const continue crate dyn else enum extern false fn for if impl in let loop match "
    "move mut pub ref return self Self static struct super trait true type unsafe use where while abstract "
    "become box do final gen macro override priv try typeof unsized virtual yield union f64 i64 u64 u8 usize "
    "bool str core std math Cell Reals Some None Ok Err main test get set cells number at part from_fn "
    "mod "
    "y p out t h parameters "
)
RESERVED = (
    *_RESERVED.split(),
    *(name.upper() for name in (*QUANTITIES, "state", "parameters", "prepared")),
    *("STATE_NAMES", "PARAMETER_NAMES", "DEFAULT_PARAMETERS"),
)
"""Words that are not names of values: keywords, what the file uses, and what parameters of functions are called."""


def needed(ops: Mapping[str, None]) -> dict[str, None]:
    """Return operations and those that their definitions use."""
    found: dict[str, None] = {}
    for op in ops:
        found |= dict.fromkeys((*NEEDS.get(op, ()), op))
    return found


def library_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the functions of a library that a file calls, from the standard library or from C's."""
    used = sorted(op for op in ops if op in LIBRARY)
    if not used:
        return []
    standard, foreign, declared = [], [], []
    for op in used:
        given, args = ("x: f64, y: f64", "x, y") if op in BINARY else ("x: f64", "x")
        rest, name = "y" if op in BINARY else "", FOREIGN.get(op, op)
        head = [f"    pub fn {op}({given}) -> f64 {{"]
        standard += ["    #[inline]", *head, f"        x.{LIBRARY[op]}({rest})", "    }"]
        foreign += [*head, f"        unsafe {{ c::{name}({args}) }}", "    }"]
        declared.append(f"            pub fn {name}({given}) -> f64;")
    return [
        "#[cfg(not(no_std))]",
        "mod math {",
        *standard,
        "}",
        "",
        "// Without the standard library these functions are those of the C library that the program is linked with.",
        "#[cfg(no_std)]",
        "mod math {",
        "    mod c {",
        '        extern "C" {',
        *declared,
        "        }",
        "    }",
        *foreign,
        "}",
        "",
    ]


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of operations that the file defines."""
    lines = []
    for op in sorted(op for op in ops if op in HELPERS):
        *about, head = [line for line in HELPERS[op][1] if line.startswith(("//", "fn "))]
        body = HELPERS[op][1][len(about) + 1 :]
        lines += [*about, "#[inline]", head, *body, ""]
    return lines
