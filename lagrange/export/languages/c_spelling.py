"""Operations, literals and reserved words of C."""

from __future__ import annotations

from collections.abc import Mapping

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.procedure.spelling import Literals, Operator
from lagrange.statement.elementary import ELEMENTARY

KINDS: Mapping[Kind, str] = {REAL: "double", WHOLE: "int64_t", FLAG: "int"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "select": Operator(1, "{0} ? {1} : {2}", (4, 2, 2)),
    "or": COMMON["or"]._replace(operands=(4, 4)),
    "and": COMMON["and"]._replace(operands=(4, 4)),
    "quotient": COMMON["div"],
    "real": Operator(8, "(double){0}", (9,)),
    "whole": Operator(8, "(int64_t){0}", (9,)),
}
"""Operators with precedences; || and && get extra parentheses, since compilers warn without them."""

LITERALS = Literals("HUGE_VAL", 'nan("")', ("0", "1"))

FUNCTIONS: Mapping[str, str] = {
    **{name: name for name in (*ELEMENTARY, "sqrt", "atan2", "copysign")},
    "abs": "fabs",
    "power": "pow",
    "round": "rint",
}
"""Functions of the C library."""

HELPERS: Mapping[str, tuple[str, str]] = {
    "min": ("smaller", "double smaller(double a, double b) {\n    return a < b || a != a ? a : b;\n}"),
    "max": ("larger", "double larger(double a, double b) {\n    return a > b || a != a ? a : b;\n}"),
    "min_whole": ("smaller_whole", "int64_t smaller_whole(int64_t a, int64_t b) {\n    return a < b ? a : b;\n}"),
    "max_whole": ("larger_whole", "int64_t larger_whole(int64_t a, int64_t b) {\n    return a > b ? a : b;\n}"),
    "magnitude": (
        "magnitude",
        "double magnitude(double a, double b) {\n    const double x = fabs(a), y = fabs(b);\n"
        "    return x > y || x != x ? x : y;\n}",
    ),
    "sign": ("sign", "double sign(double x) {\n    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;\n}"),
    "two_to": (
        "two_to",
        "double two_to(int64_t k) {\n    const int64_t bits = (k + 1023) * 4503599627370496;\n    double x;\n"
        "    memcpy(&x, &bits, sizeof x);\n    return x;\n}",
    ),
    "exponent": (
        "exponent",
        "int64_t exponent(double x) {\n    int64_t bits;\n    memcpy(&bits, &x, sizeof bits);\n"
        "    return (bits >> 52 & 2047) - 1023;\n}",
    ),
    "mantissa": (
        "mantissa",
        "double mantissa(double x) {\n    int64_t bits;\n    memcpy(&bits, &x, sizeof bits);\n"
        "    bits = (bits & 4503599627370495) | 4607182418800017408;\n    memcpy(&x, &bits, sizeof x);\n"
        "    return x;\n}",
    ),
    "size_bits": (
        "size_bits",
        "int64_t size_bits(double x) {\n    int64_t bits;\n    memcpy(&bits, &x, sizeof bits);\n"
        "    return bits & INT64_MAX;\n}",
    ),
    "of_bits": (
        "of_bits",
        "double of_bits(int64_t bits) {\n    double x;\n    memcpy(&x, &bits, sizeof x);\n    return x;\n}",
    ),
}
"""Operations without a function in C: name and definition of a helper. All of them keep NaN.

Those of bits read doubles as IEEE 754 has them. Sizes have the order of their bits, and NaN is the largest.
"""

BITS = frozenset(("two_to", "exponent", "mantissa", "size_bits", "of_bits"))
"""The helpers that copy the bits of a number, for which a file includes string.h."""

_CONSTANTS = "E LOG2E LOG10E LN2 LN10 PI PI_2 PI_4 1_PI 2_PI 2_SQRTPI SQRT2 SQRT1_2"
_KINDS = ("", "f", "l", "f32", "f64", "f128", "f32x", "f64x")
_INTEGERS = (
    *(f"{sign}INT{kind}{bits}" for sign in ("", "U") for kind in ("", "_LEAST", "_FAST") for bits in (8, 16, 32, 64)),
    *("INTMAX", "UINTMAX", "INTPTR", "UINTPTR", "PTRDIFF", "SIG_ATOMIC", "SIZE", "WCHAR", "WINT"),
)
_MACROS = """
    BUFSIZ FILENAME_MAX FOPEN_MAX TMP_MAX L_tmpnam L_ctermid L_cuserid P_tmpdir SEEK_CUR SEEK_END SEEK_SET SEEK_DATA
    SEEK_HOLE RENAME_EXCHANGE RENAME_NOREPLACE RENAME_WHITEOUT EXIT_FAILURE EXIT_SUCCESS MB_CUR_MAX RAND_MAX
    BIG_ENDIAN BYTE_ORDER LITTLE_ENDIAN PDP_ENDIAN FD_SETSIZE NFDBITS
    WCONTINUED WEXITED WNOHANG WNOWAIT WSTOPPED WUNTRACED
    FP_ILOGB0 FP_ILOGBNAN FP_LLOGB0 FP_LLOGBNAN FP_INFINITE FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO
    FP_INT_DOWNWARD FP_INT_TONEAREST FP_INT_TONEARESTFROMZERO FP_INT_TOWARDZERO FP_INT_UPWARD
    MATH_ERREXCEPT MATH_ERRNO math_errhandling MAXFLOAT HUGE_VALF HUGE_VALL
    HUGE_VAL_F32 HUGE_VAL_F64 HUGE_VAL_F128 HUGE_VAL_F32X HUGE_VAL_F64X
    SNAN SNANF SNANL SNANF32 SNANF64 SNANF128 SNANF32X SNANF64X DOMAIN OVERFLOW UNDERFLOW SING PLOSS TLOSS HUGE
"""

RESERVED = (
    *(f"M_{one}{kind}" for one in _CONSTANTS.split() for kind in _KINDS),
    *(f"{one}_{what}" for one in _INTEGERS for what in ("MAX", "MIN", "WIDTH")),
    *_MACROS.split(),
    "auto",
    "break",
    "case",
    "char",
    "const",
    "continue",
    "default",
    "do",
    "double",
    "else",
    "enum",
    "extern",
    "float",
    "for",
    "goto",
    "if",
    "inline",
    "int",
    "long",
    "register",
    "restrict",
    "return",
    "short",
    "signed",
    "sizeof",
    "static",
    "struct",
    "switch",
    "typedef",
    "union",
    "unsigned",
    "void",
    "volatile",
    "while",
    "_Bool",
    "bool",
    "true",
    "false",
    "asm",
    "typeof",
    "linux",
    "unix",
    "near",
    "far",
    "main",
    "errno",
    "stdin",
    "stdout",
    "stderr",
    "NULL",
    "EOF",
    "NAN",
    "INFINITY",
    "HUGE_VAL",
    "I",
    "int64_t",
    "int32_t",
    "size_t",
    "complex",
    "imaginary",
    "y",
    "p",
    "out",
    "t",
    "h",
    "parameters",
)
"""Words that cannot be names of values: keywords, macros, and names of parameters of functions."""
