"""Tables of all functions that expressions may contain: their names, and how Python, NumPy and mpmath compute them.

They are the elementary functions, min, max, abs and conditions. All stages read these tables. Names in SymPy, in
Python's `math`, in NumPy, in mpmath and in C follow from the name of an elementary function. If the function is missing
in a language, or has another name, the file of that language says so. Square roots and cube roots are not in the
tables, since they are powers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from mpmath import libmp

from lagrange.statement.expression import modulo

Rule = Callable[..., Any]  # Formula as a callable that uses Python's operators, so that it works with nodes of a graph


@dataclass(frozen=True)
class Elementary:
    """Elementary function y = f(a) of one number.

    Its derivative is either `sign` / `slope(a)` or `derivative(y, a)`. Taylor coefficients follow from the derivative,
    unless `lagrange.program.recurrence` has a rule for the function. The function is `odd`, `even` or neither. `exact`
    is a pair (argument, value) of whole numbers. `pole` is the value at zero if it is infinite. `size` is the scale of
    values in tests for zero: "bounded" means 1, since no value is larger, and "unit" means at least 1, as for an angle
    or a logarithm. `spread` is the cause of lost digits: a "periodic" argument, or a "growing" value. `everywhere` is
    true if the function is defined for all numbers.
    """

    name: str
    slope: Rule | None = None
    derivative: Rule | None = None
    sign: int = 1
    odd: bool = False
    even: bool = False
    exact: tuple[int, int] = (0, 0)
    pole: float = math.nan
    size: str = ""
    spread: str = ""
    everywhere: bool = True

    @property
    def partial(self) -> Rule:
        """Derivative of this function, as a callable of its value y and its argument a."""
        if self.slope is None:
            assert self.derivative is not None
            return self.derivative
        slope, sign = self.slope, self.sign
        return lambda y, a: sign / slope(a)

    @cached_property
    def symbolic(self) -> Any:
        """This function in SymPy, such as sympy.sin."""
        return getattr(sympy, self.name)

    @cached_property
    def of_float(self) -> Callable[[float], float]:
        """The function for Python floats. It raises an exception if there is no finite value."""
        function: Callable[[float], float] = getattr(math, self.name)
        return function

    @cached_property
    def of_array(self) -> Callable[..., Any]:
        """The function for numbers and arrays: NumPy's function, or the function for floats applied to each entry."""
        return getattr(np, self.array_name, self._each)

    @property
    def array_name(self) -> str:
        """Name of this function in NumPy, such as "arcsin" for asin, if NumPy has the function."""
        return f"arc{self.name[1:]}" if self.name.startswith("a") else self.name

    def _each(self, a: Any) -> Any:
        """Return the values of this function for a number, or for each entry of an array of any shape."""
        return np.array([self.of_float(x) for x in np.ravel(a).tolist()]).reshape(np.shape(a))[()]

    @cached_property
    def precise(self) -> Callable[..., Any]:
        """The function in mpmath. Its arguments are a raw number of mpmath and a precision in bits."""
        function: Callable[..., Any] = getattr(libmp, f"mpf_{self.name}")
        return function


def _call(name: str) -> Rule:
    return lambda a: a.graph.call(name, a)


def _root(a: Any) -> Any:
    return a ** Fraction(1, 2)


ELEMENTARY: Mapping[str, Elementary] = {
    function.name: function
    for function in (
        Elementary("sin", derivative=lambda y, a: _call("cos")(a), odd=True, size="bounded", spread="periodic"),
        Elementary(
            "cos", derivative=lambda y, a: -_call("sin")(a), even=True, exact=(0, 1), size="bounded", spread="periodic"
        ),
        Elementary("tan", derivative=lambda y, a: 1 + y**2, odd=True, size="unit", spread="periodic"),
        Elementary("asin", slope=lambda a: _root(1 - a**2), odd=True, size="unit", everywhere=False),
        Elementary("acos", slope=lambda a: _root(1 - a**2), sign=-1, exact=(1, 0), size="unit", everywhere=False),
        Elementary("atan", slope=lambda a: 1 + a**2, odd=True, size="unit"),
        Elementary("exp", derivative=lambda y, a: y, exact=(0, 1), spread="growing"),
        Elementary("log", slope=lambda a: a, exact=(1, 0), pole=-math.inf, size="unit", everywhere=False),
        Elementary("sinh", derivative=lambda y, a: _call("cosh")(a), odd=True, size="unit", spread="growing"),
        Elementary("cosh", derivative=lambda y, a: _call("sinh")(a), even=True, exact=(0, 1), spread="growing"),
        Elementary("tanh", derivative=lambda y, a: 1 - y**2, odd=True, size="bounded", spread="growing"),
        Elementary("asinh", slope=lambda a: _root(1 + a**2), odd=True, size="unit"),
        Elementary("acosh", slope=lambda a: _root(a**2 - 1), exact=(1, 0), size="unit", everywhere=False),
        Elementary("atanh", slope=lambda a: 1 - a**2, odd=True, size="unit", everywhere=False),
        Elementary(
            "erf",
            derivative=lambda y, a: 2 * _call("exp")(-(a**2)) / _root(a.graph.call("pi")),
            odd=True,
            size="bounded",
        ),
    )
}
"""Elementary functions of one number, by name."""


# --- functions of nodes


@dataclass(frozen=True)
class Function:
    """Function that nodes of a graph may call: its name, number of arguments `arity` (None: any) and derivative rules.

    `partials` has one rule for each argument, which returns the derivative from the function's value and its arguments.
    min and max have no such rules, since they equal one of their two arguments. Instead `first` returns the condition
    that the result is the first argument. The derivative is that of the chosen argument. So an infinite derivative of
    the other argument has no effect.
    """

    name: str
    arity: int | None
    partials: tuple[Rule, ...] = ()
    first: Rule | None = None


FUNCTIONS: dict[str, Function] = {
    function.name: function
    for function in (
        *(Function(elementary.name, 1, (elementary.partial,)) for elementary in ELEMENTARY.values()),
        Function("atan2", 2, (lambda y, a, b: b / (a**2 + b**2), lambda y, a, b: -a / (a**2 + b**2))),
        Function("abs", 1, (lambda y, a: a.graph.call("sign", a),)),
        Function("sign", 1, (lambda y, a: a.graph.zero,)),
        Function("min", 2, first=lambda a, b: a.graph.call("less_equal", a, b)),
        Function("max", 2, first=lambda a, b: a.graph.call("less_equal", b, a)),
        Function("pow", 2, (lambda y, a, b: b * a ** (b - 1), lambda y, a, b: y * a.graph.call("log", a))),
        Function("pi", 0),
        Function("e", 0),
        Function("nan", 0),
        Function("less", 2),
        Function("less_equal", 2),
        Function("equal", 2),
        Function("and", 2),
        Function("or", 2),
        Function("not", 1),
        Function("piecewise", None),
    )
}

CONDITIONS = frozenset(("less", "less_equal", "equal", "and", "or", "not"))
"""Functions whose value is true or false."""

ODD = frozenset(("sign", *(elementary.name for elementary in ELEMENTARY.values() if elementary.odd)))
EVEN = frozenset(("abs", *(elementary.name for elementary in ELEMENTARY.values() if elementary.even)))

EXACT: dict[tuple[Any, ...], int] = {
    (elementary.name, elementary.exact[0]): elementary.exact[1] for elementary in ELEMENTARY.values()
}
"""Exact values, used to fold constants: {(function, argument): value}."""

FOLDS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "sign": lambda a: (a > 0) - (a < 0),
    "min": min,
    "max": max,
}
"""Functions that map exact numbers to exact numbers, used to fold constants."""


# --- functions in texts


@dataclass(frozen=True)
class FunctionWord:
    """Function that texts may contain: its `name`, and its constructor `build` in SymPy.

    It has `fewest` to `most` arguments (None: any number). `of_floats` computes its value for Python floats.
    """

    name: str
    build: Callable[..., Any]
    fewest: int
    most: int | None
    of_floats: Callable[..., float]


WORDS: dict[str, FunctionWord] = {
    word.name: word
    for word in (
        *(FunctionWord(each.name, each.symbolic, 1, 1, each.of_float) for each in ELEMENTARY.values()),
        FunctionWord("atan2", sympy.atan2, 2, 2, math.atan2),
        FunctionWord("sqrt", sympy.sqrt, 1, 1, math.sqrt),
        FunctionWord("cot", sympy.cot, 1, 1, lambda x: 1 / math.tan(x)),
        FunctionWord("sec", sympy.sec, 1, 1, lambda x: 1 / math.cos(x)),
        FunctionWord("csc", sympy.csc, 1, 1, lambda x: 1 / math.sin(x)),
        FunctionWord("sinc", sympy.sinc, 1, 1, lambda x: math.sin(x) / x if x else 1.0),
        FunctionWord(
            "heaviside", sympy.Heaviside, 1, 2, lambda x, middle=0.5: 0.5 + math.copysign(0.5, x) if x else middle
        ),
        FunctionWord("abs", sympy.Abs, 1, 1, abs),
        FunctionWord("sign", sympy.sign, 1, 1, lambda x: math.copysign(1.0, x) if x else 0.0),
        FunctionWord("min", sympy.Min, 1, None, lambda *x: min(x)),
        FunctionWord("max", sympy.Max, 1, None, lambda *x: max(x)),
        FunctionWord("mod", modulo, 2, 2, lambda x, y: x % y),
    )
}

ALIASES = {"Abs": "abs", "Min": "min", "Max": "max", "ln": "log", "Heaviside": "heaviside", "Mod": "mod"}
"""Other spellings of functions in texts, with the names in `WORDS`."""

FUNCTION_NAMES = frozenset((*WORDS, *ALIASES))  # Names of functions in every spelling

NAME_OF_CLASS: Mapping[Any, str] = {word.build: name for name, word in WORDS.items() if isinstance(word.build, type)}
"""Names of functions in texts, by SymPy class."""

SYMPY_CLASSES = frozenset((*NAME_OF_CLASS, sympy.Piecewise))  # SymPy classes of functions that an energy may contain
