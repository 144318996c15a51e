"""The functions that an expression may contain: their names in texts, and their SymPy classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.statement.elementary import ELEMENTARY
from lagrange.statement.expression import modulo


@dataclass(frozen=True)
class Word:
    """A function: its name in texts, its constructor in SymPy, and the fewest and most arguments (None: no limit)."""

    name: str
    build: Callable[..., Any]
    fewest: int
    most: int | None


WORDS: dict[str, Word] = {
    word.name: word
    for word in (
        *(Word(one.name, one.symbolic, 1, 1) for one in ELEMENTARY.values()),
        Word("atan2", sympy.atan2, 2, 2),
        Word("sqrt", sympy.sqrt, 1, 1),
        Word("cot", sympy.cot, 1, 1),
        Word("sec", sympy.sec, 1, 1),
        Word("csc", sympy.csc, 1, 1),
        Word("sinc", sympy.sinc, 1, 1),
        Word("heaviside", sympy.Heaviside, 1, 2),
        Word("abs", sympy.Abs, 1, 1),
        Word("sign", sympy.sign, 1, 1),
        Word("min", sympy.Min, 1, None),
        Word("max", sympy.Max, 1, None),
        Word("mod", modulo, 2, 2),
    )
}

ALIASES = {"Abs": "abs", "Min": "min", "Max": "max", "ln": "log", "Heaviside": "heaviside", "Mod": "mod"}
"""Other spellings of functions in texts."""

FUNCTIONS = frozenset((*WORDS, *ALIASES))
"""Names of functions in every spelling."""

SYMPY_CLASSES: frozenset[Any] = frozenset(
    word.build for word in WORDS.values() if isinstance(word.build, type)
) | frozenset((sympy.Piecewise,))
"""SymPy function classes that an energy may contain."""
