"""The operations of a program in mpmath, in the precision of a context."""

from collections.abc import Callable
from typing import Any

NAMED = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "sinh", "cosh", "tanh", "sign")
MORE = ("asinh", "acosh", "atanh", "erf")


def operations(context: Any) -> dict[str, Callable[..., Any]]:
    """Return all operations on numbers of mpmath or of a context; conditions are booleans."""
    return {
        "neg": lambda a: -a,
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "fma": lambda a, b, c: a * b + c,
        "power": context.power,
        "abs": abs,
        "min": min,
        "max": max,
        "less": lambda a, b: a < b,
        "less_equal": lambda a, b: a <= b,
        "equal": lambda a, b: a == b,
        "and": lambda a, b: a and b,
        "or": lambda a, b: a or b,
        "not": lambda a: not a,
        "select": lambda c, a, b: a if c else b,
        **{name: getattr(context, name) for name in (*NAMED, *MORE)},
    }
