"""Helpers and reserved words of exported Python, where it differs from the Python run by this package."""

from __future__ import annotations

import keyword
from collections.abc import Mapping

from lagrange.machine.python_source import OPERATORS
from lagrange.statement.elementary import ELEMENTARY

_TOTAL = (
    "def _total(function, x, pole=nan):",
    '    """Return a function of x: NaN outside of its domain, infinite where it overflows, `pole` at 0."""',
    "    try:",
    "        return function(x)",
    "    except OverflowError:",
    "        return inf if x > 0.0 or function is math.cosh else -inf",
    "    except ValueError:",
    "        return pole if x == 0.0 else nan",
)


def _of_total(name: str, rest: str = "") -> tuple[str, ...]:
    return (f"def _{name}(x):", f"    return _total(math.{name}, x{rest})")


HELPERS: Mapping[str, tuple[str, ...]] = {
    "total": _TOTAL,
    **{name: _of_total(name) for name in (*ELEMENTARY, "sqrt")},
    **{name: (f"_{name} = math.{name}",) for name in ("atan", "atan2", "tanh", "asinh", "erf", "copysign")},
    "log": _of_total("log", ", -inf"),
    "atanh": (
        "def _atanh(x):",
        "    return math.copysign(inf, x) if abs(x) == 1.0 else _total(math.atanh, x)",
    ),
    "div": (
        "def _div(a, b):",
        "    if b:",
        "        return a / b",
        "    if a == 0.0 or a != a:",
        "        return nan",
        "    return math.copysign(inf, a) * math.copysign(1.0, b)",
    ),
    "power": (
        "def _power(a, b):",
        "    try:",
        "        return math.pow(a, b)",
        "    except OverflowError:",
        "        return -inf if a < 0.0 and math.fmod(b, 2.0) in (1.0, -1.0) else inf",
        "    except ValueError:",
        "        if a != 0.0:",
        "            return nan",
        "        return math.copysign(inf, a) if math.fmod(b, 2.0) in (1.0, -1.0) else inf",
    ),
    "min": ("def _min(a, b):", "    return a if a < b or a != a else b"),
    "max": ("def _max(a, b):", "    return a if a > b or a != a else b"),
    "magnitude": ("def _magnitude(a, b):", "    return _max(abs(a), abs(b))"),
    "sign": ("def _sign(x):", "    return 1.0 if x > 0.0 else -1.0 if x < 0.0 else x"),
    "round": (
        "def _round(x):",
        "    return math.copysign(float(round(x)), x) if x - x == 0.0 else x",
    ),
    "quotient": ("def _quotient(a, b):", "    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)"),
    "two_to": ("def _two_to(k):", "    return math.ldexp(1.0, k)"),
    "exponent": (
        "def _exponent(x):",
        "    if not abs(x) < inf:",
        "        return 1024",
        "    return max(math.frexp(x)[1] - 1, -1023) if x else -1023",
    ),
    "mantissa": ("def _mantissa(x):", "    return 2.0 * math.frexp(abs(x))[0]"),
}
"""Operations defined in the file. They return NaN or infinity, as machine code does, where Python raises an error."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("sqrt", "sin", "cos", "tan", "asin", "acos", "exp", "sinh", "cosh", "acosh"), ("total",)),
    **dict.fromkeys(("log", "atanh"), ("total",)),
    "magnitude": ("max",),
}
"""The helpers that others use."""

_RESERVED = "abs float int range math np numpy sys nan inf SimpleNamespace test main y p out t h parameters "
RESERVED = (
    *keyword.kwlist,
    *_RESERVED.split(),
)
"""Words that are not names of values."""

_FILES = (
    "abc array ast asyncio base64 bisect bz2 calendar code codecs collections contextlib copy csv ctypes "
    "dataclasses datetime decimal enum fractions functools gc gzip hashlib heapq inspect io itertools json "
    "keyword locale logging math numbers numpy operator os pathlib pickle platform posixpath queue random re "
    "secrets select shutil signal site socket stat statistics string struct subprocess symbol sys tempfile "
    "test textwrap threading time token tokenize traceback types typing unittest uuid warnings weakref zlib "
)
FILES = (
    *keyword.kwlist,
    *_FILES.split(),
)
"""Names that no module of a user's may have, since NumPy would import it instead of its own."""


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of helpers and of those that they use."""
    wanted = {op for op in ops if op not in OPERATORS}
    wanted |= {one for op in wanted for one in NEEDS.get(op, ())}
    lines = []
    for op in HELPERS:
        if op in wanted:
            lines += [*HELPERS[op], "", ""]
    return lines
