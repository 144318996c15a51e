"""Pieces of formulas: their texts, and how tightly they bind."""

from __future__ import annotations

from dataclasses import dataclass

SUM, PRODUCT, FRACTION, POWER, ATOM = range(5)
"""Precedence of a piece: how tightly it binds."""

CIRCULAR = frozenset(("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh", "coth", "sech", "csch"))
"""Functions with no parentheses around a single symbol, and with an exponent after their name: sin² θ."""


@dataclass(frozen=True)
class Piece:
    """A part of a formula.

    `closed` is an alternative text of a function, with parentheses around its argument, if `text` has none.
    `call` marks a function that starts with its name. `simple` marks a symbol, a number, or a number times a symbol.
    """

    text: str
    level: int = ATOM
    closed: str = ""
    simple: bool = False
    call: bool = False
