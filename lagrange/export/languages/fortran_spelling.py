"""How Fortran spells operations, literals and words."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.procedure.spelling import WORDS, Literals, Operator, call

KINDS: Mapping[Kind, str] = {REAL: "real(dp)", WHOLE: "integer(int64)", FLAG: "logical"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "or": WORDS["or"]._replace(text="{0} .or. {1}"),
    "and": WORDS["and"]._replace(text="{0} .and. {1}"),
    "not": WORDS["not"]._replace(text=".not. {0}"),
    "neg": Operator(6, "-{0}", (7,)),
    "quotient": COMMON["div"],
    "power": Operator(8, "{0}**{1}", (9, 9)),
    "select": call("merge({1}, {2}, {0})"),
}
"""A sign does not stand behind an operator: a number with one binds as a sum does."""


def _finite(value: float) -> str:
    """Return a finite double; one below the normal numbers by its bits, since compilers warn of it."""
    if 0.0 < abs(value) < 2.0**-1022:
        (bits,) = struct.unpack("<q", struct.pack("<d", abs(value)))
        return f"{'-' if value < 0 else ''}transfer({bits}_int64, 1.0_dp)"
    return f"{value!r}_dp"


LITERALS = Literals("infinity", "not_a_number", (".false.", ".true."), 6, "{}_int64".format, _finite)

FUNCTIONS: Mapping[str, str] = {
    **{name: name for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "erf")},
    **{name: name for name in ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "abs")},
    "copysign": "sign",
}
"""Intrinsic functions."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "real({0}, dp)",
    ("real", FLAG): "merge(1.0_dp, 0.0_dp, {0})",
    ("whole", REAL): "int({0}, int64)",
    ("whole", FLAG): "merge(1_int64, 0_int64, {0})",
    ("min", WHOLE): "min({0}, {1})",
    ("max", WHOLE): "max({0}, {1})",
    ("equal", REAL): "equal({0}, {1})",
}
"""Operations that depend on what is given. Compilers warn of reals that are compared by ==."""


def _helper(kind: str, name: str, given: str, body: str, local: str = "") -> tuple[str, str]:
    """Return a function of reals (or of a whole number, n) that sets its result r."""
    lines = [f"  elemental function {name}({given}) result(r)"]
    lines.append(f"    {'integer(int64)' if given == 'n' else 'real(dp)'}, intent(in) :: {given}")
    lines += [f"    {kind} :: r", *([f"    {local}"] if local else []), *(f"    {one}" for one in body.splitlines())]
    return name, "\n".join([*lines, f"  end function {name}", ""])


HELPERS: Mapping[str, tuple[str, str]] = {
    "equal": _helper("logical", "equal", "a, b", "r = a <= b .and. a >= b"),
    "min": _helper("real(dp)", "smaller", "a, b", "r = b\nif (a < b .or. .not. (a <= a)) r = a"),
    "max": _helper("real(dp)", "larger", "a, b", "r = b\nif (a > b .or. .not. (a <= a)) r = a"),
    "magnitude": _helper("real(dp)", "magnitude", "a, b", "r = abs(b)\nif (abs(a) > r .or. .not. (a <= a)) r = abs(a)"),
    "sign": _helper("real(dp)", "sign_of", "x", "r = x\nif (x > 0.0_dp) r = 1.0_dp\nif (x < 0.0_dp) r = -1.0_dp"),
    "round": _helper(
        "real(dp)",
        "rounded",
        "x",
        "r = x\nif (abs(x) < two_to_52) r = sign((abs(x) + two_to_52) - two_to_52, x)",
        "real(dp), parameter :: two_to_52 = 4503599627370496.0_dp",
    ),
    "two_to": _helper("real(dp)", "two_to", "n", "r = scale(1.0_dp, int(n))"),
    "exponent": _helper(
        "integer(int64)",
        "exponent_of",
        "x",
        "r = 1024_int64\nif (abs(x) < tiny(x)) then\n  r = -1023_int64\n"
        "else if (abs(x) <= huge(x)) then\n  r = int(exponent(x), int64) - 1_int64\nend if",
    ),
    "mantissa": _helper("real(dp)", "mantissa", "x", "r = 2.0_dp * fraction(abs(x))"),
}
"""Operations that Fortran has no function for: a name, and its definition. NaN stays NaN in all."""

CONSTANTS: Mapping[str, str] = {
    "infinity": "transfer(9218868437227405312_int64, 1.0_dp)",
    "not_a_number": "transfer(9221120237041090560_int64, 1.0_dp)",
}
"""Values that have no literal."""

_STATEMENTS = """
    abstract allocatable allocate assign associate asynchronous backspace bind block call case character class close
    codimension common complex concurrent contains contiguous continue critical cycle data deallocate default deferred
    dimension do double elemental else elsewhere end endassociate endblock enddo endenum endfile endforall endfunction
    endif endinterface endmodule endprocedure endprogram endselect endsubmodule endsubroutine endtype endwhere entry
    enum enumerator equivalence error exit extends external final flush forall format function generic go goto if
    implicit import impure in include inout inquire integer intent interface intrinsic is kind lock logical memory
    module namelist non_overridable none nopass nullify only open operator optional out parameter pass pause pointer
    precision print private procedure program protected public pure read real recursive result return rewind rewrite
    save select selectcase selecttype sequence stop subroutine submodule sync target then to type unformatted unlock use
    value volatile wait where while write
"""
_INTRINSICS = """
    abs acos acosh asin asinh atan atan2 atanh cos cosh erf exp exponent fraction huge int log max merge min mod sign
    scale sin sinh sqrt tan tanh tiny transfer dp int64 real64 iso_fortran_env
"""
_OWN = "y p t h parameters unused default_parameters"

RESERVED = (*_STATEMENTS.split(), *_INTRINSICS.split(), *_OWN.split(), *CONSTANTS)
"""Words that are not names of values: those of statements, functions, and what parameters of procedures are called."""
