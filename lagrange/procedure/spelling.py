"""Spelling of operators and constants in languages: the common forms, and those that a language defines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from lagrange.procedure.form import FLAG, WHOLE, Kind

ATOM = 10
"""Binding strength of a name or a call; operators have lower numbers."""


class Operator(NamedTuple):
    """Binding strength of an operator, its text, and the least binding strength of operands without parentheses.

    Empty `operands` means that no operand needs parentheses.
    """

    binds: int
    text: str
    operands: tuple[int, ...] = ()

    def applied(self, operand: Callable[[int, int], str], args: Sequence[int]) -> str:
        """Return the text of the operation. `operand(arg, least)` is the text of an argument with its parentheses."""
        least = self.operands or (0,) * len(args)
        return self.text.format(*(operand(arg, one) for arg, one in zip(args, least, strict=True)))


def call(text: str) -> Operator:
    """Return an operation that is a call, whose arguments need no parentheses."""
    return Operator(ATOM, text)


OPERATORS: Mapping[str, Operator] = {
    "or": Operator(2, "{0} || {1}", (2, 3)),
    "and": Operator(3, "{0} && {1}", (3, 4)),
    "equal": Operator(5, "{0} == {1}", (6, 6)),
    "less": Operator(5, "{0} < {1}", (6, 6)),
    "less_equal": Operator(5, "{0} <= {1}", (6, 6)),
    "add": Operator(6, "{0} + {1}", (6, 7)),
    "sub": Operator(6, "{0} - {1}", (6, 7)),
    "fma": Operator(6, "{0} * {1} + {2}", (7, 8, 7)),
    "fnma": Operator(6, "{2} - {0} * {1}", (7, 8, 6)),
    "mul": Operator(7, "{0} * {1}", (7, 8)),
    "div": Operator(7, "{0} / {1}", (7, 8)),
    "neg": Operator(8, "-{0}", (9,)),
    "not": Operator(8, "!{0}", (9,)),
}
"""The operators that most languages share. A conditional expression has a lower binding strength, 1."""

WORDS: Mapping[str, Operator] = {
    "or": Operator(2, "{0} or {1}", (2, 3)),
    "and": Operator(3, "{0} and {1}", (3, 4)),
    "not": Operator(4, "not {0}", (4,)),
}
"""Logical operators of languages that use words for them."""


@dataclass(frozen=True)
class Literals:
    """Spelling of constants in a language: infinity, NaN, and the two flags.

    `signed` is the binding strength of a number with a sign. `whole` and `finite` print an integer and a finite double.
    """

    infinity: str
    nan: str
    flags: tuple[str, str] = ("false", "true")
    signed: int = 8
    whole: Callable[[int], str] = str
    finite: Callable[[float], str] = repr

    def real(self, value: float) -> str:
        """Return a double with all its digits."""
        if math.isfinite(value):
            return self.finite(value)
        return self.nan if math.isnan(value) else f"{'-' * (value < 0)}{self.infinity}"

    def spelled(self, kind: Kind, data: Any) -> tuple[int, str]:
        """Return the binding strength of a constant, and its text."""
        if kind is FLAG:
            return ATOM, self.flags[bool(data)]
        text = self.whole(data) if kind is WHOLE else self.real(data)
        return (self.signed if text.startswith("-") else ATOM), text
