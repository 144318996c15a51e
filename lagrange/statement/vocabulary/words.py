"""The functions that an expression may contain: their names in texts, and their SymPy classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.statement.expression import modulo
from lagrange.statement.vocabulary.elementary import ELEMENTARY


@dataclass(frozen=True)
class FunctionWord:
    """A function: its name in texts, its constructor in SymPy, and the fewest and most arguments (None: no limit)."""

    name: str
    build: Callable[..., Any]
    fewest: int
    most: int | None


WORDS: dict[str, FunctionWord] = {
    word.name: word
    for word in (
        *(FunctionWord(elementary.name, elementary.symbolic, 1, 1) for elementary in ELEMENTARY.values()),
        FunctionWord("atan2", sympy.atan2, 2, 2),
        FunctionWord("sqrt", sympy.sqrt, 1, 1),
        FunctionWord("cot", sympy.cot, 1, 1),
        FunctionWord("sec", sympy.sec, 1, 1),
        FunctionWord("csc", sympy.csc, 1, 1),
        FunctionWord("sinc", sympy.sinc, 1, 1),
        FunctionWord("heaviside", sympy.Heaviside, 1, 2),
        FunctionWord("abs", sympy.Abs, 1, 1),
        FunctionWord("sign", sympy.sign, 1, 1),
        FunctionWord("min", sympy.Min, 1, None),
        FunctionWord("max", sympy.Max, 1, None),
        FunctionWord("mod", modulo, 2, 2),
    )
}

ALIASES = {"Abs": "abs", "Min": "min", "Max": "max", "ln": "log", "Heaviside": "heaviside", "Mod": "mod"}
"""Other spellings of functions in texts."""

FUNCTIONS = frozenset((*WORDS, *ALIASES))  # Names of functions in every spelling

SYMPY_CLASSES: frozenset[Any] = frozenset(
    word.build for word in WORDS.values() if isinstance(word.build, type)
) | frozenset((sympy.Piecewise,))
"""SymPy function classes that an energy may contain."""
