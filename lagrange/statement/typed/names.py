"""Symbols of a system as people type them: m_1 for m1, θ̈₁ or thetaddot1 for theta1_ddot, and mgl for m*g*l."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

from lagrange.statement.lexer import ALIASES, FUNCTIONS, GREEK

RATES = ("", "_dot", "_ddot")
"""Endings of a coordinate, its velocity and its acceleration in the strict notation."""

SPELLINGS = (("",), ("dot",), ("ddot", "dotdot", "doubledot"))
"""Endings that people type for the same three, without underscores."""

LONGEST_SPLIT = 64
"""Characters of a word that is taken for a product of several symbols."""

MOST_SPLITS = 4
"""Products that one word may stand for, of which each is tried."""

SIMILAR = 0.8
"""Least similarity, from 0 to 1, of a name that a hint offers."""

SHORTEST_HINT = 4
"""Characters of the shortest name that a hint offers."""

FUNCTION_SPELLINGS = {"arcsin": "asin", "arccos": "acos", "arctan": "atan", "sgn": "sign", "H": "heaviside"}
"""Names of functions that people type, and the strict ones."""


_DERIVATIVE = re.compile(r"_?(?:d?dot)+$")


@dataclass(frozen=True)
class Piece:
    """One symbol or function within a word: its strict name, and what it is.

    `kind` is "symbol", "function", "e" (Euler's number) or "pi". `base` is the coordinate or given function whose
    derivative of order `order` the symbol is, or "" where it is neither. `moves` is true for what changes in time.
    """

    name: str
    kind: str = "symbol"
    base: str = ""
    order: int = 0
    moves: bool = False


class Names:
    """The symbols of one system, by every spelling that is understood.

    `names` are all strict names of the system; a coordinate or given function X has X_dot among them too. `multipliers`
    maps the other spellings of a multiplier to its strict name.
    """

    def __init__(self, names: Iterable[str], multipliers: dict[str, str]) -> None:
        self.names = list(names)
        self.bases = [name for name in self.names if f"{name}_dot" in self.names]
        self.spellings: dict[str, Piece] = {}
        for base in self.bases:
            for order, ending in enumerate(RATES):
                if base + ending in self.names:
                    piece = Piece(base + ending, base=base, order=order, moves=True)
                    for spelling in _spellings(base, order):
                        self.spellings[spelling] = piece
        for spelling, name in multipliers.items():
            self.spellings[canonical(spelling)] = Piece(name, moves=True)
        derivatives = {base + ending for base in self.bases for ending in RATES}
        self.spellings |= {canonical(name): Piece(name) for name in self.names if name not in derivatives}
        self.exact = {piece.name: piece for piece in self.spellings.values()}
        self.exact |= {name: Piece(name) for name in self.names if name not in self.exact}
        self.words = {name: Piece(ALIASES.get(name, name), "function") for name in FUNCTIONS}
        self.words |= {name: Piece(strict, "function") for name, strict in FUNCTION_SPELLINGS.items()}
        self.words |= {"pi": Piece("pi", "pi"), "t": Piece("t", moves=True), "e": Piece("e", "e")}

    def readings(self, word: str) -> list[list[Piece]]:
        """Return what a word may stand for, the likeliest first: one symbol, or the factors of a product."""
        if word in self.exact:
            return [[self.exact[word]], *self._differential(word)]
        key = canonical(word)
        whole = self.spellings.get(key) or self.words.get(word)
        if whole is not None:
            return [[whole], *self._differential(word)]
        return self._splits(key)

    def _differential(self, word: str) -> list[list[Piece]]:
        """Return d*theta for dtheta where the system has a symbol d: both are tried."""
        return self._splits(canonical(word)) if word.startswith("d") and "d" in self.exact and word != "d" else []

    def _splits(self, key: str) -> list[list[Piece]]:
        """Return the products of known symbols whose names in a row make a word, those of fewest factors first.

        Of two products with the same factors the first has the longer names. A factor ends where no digit follows.
        """
        if len(key) > LONGEST_SPLIT:
            return []
        best: list[list[list[Piece]]] = [[] for _ in range(len(key) + 1)]
        best[len(key)] = [[]]
        for begin in range(len(key) - 1, -1, -1):
            found: list[list[Piece]] = []
            for end in range(len(key), begin, -1):
                piece = self._whole.get(key[begin:end])
                if piece is None or not best[end] or key[end : end + 1].isdigit():
                    continue
                found += [[piece, *rest] for rest in best[end]]
            best[begin] = sorted(found, key=len)[:MOST_SPLITS]
        return best[0]

    @cached_property
    def _whole(self) -> dict[str, Piece]:
        """Every spelling that may be a factor within a word. The letter e is none: too many words have it."""
        return {key: piece for key, piece in self.words.items() if piece.kind != "e"} | self.spellings

    def derivative(self, piece: Piece, order: int) -> Piece | None:
        """Return the derivative of a coordinate or given function, None where the system has none of this order."""
        total = piece.order + order
        if not piece.base or total >= len(RATES):
            return None
        return self.exact.get(piece.base + RATES[total])

    def hint(self, word: str) -> str:
        """Return a sentence on what may be meant by an unknown word, "" where nothing is likely.

        Only coordinates and parameters are offered, never another derivative. No short name is, since a word that
        begins with it may be a product.
        """
        power = re.fullmatch(r"([A-Za-z]+)([0-9]+)", word)
        if power and self.readings(power.group(1)):
            return f" For a power write {power.group(1)}^{power.group(2)}."
        known = [name for name in self.names if len(name) >= SHORTEST_HINT and not name.endswith(RATES[1:])]
        close = get_close_matches(_DERIVATIVE.sub("", word)[:80], known, n=1, cutoff=SIMILAR)
        return f" Did you mean {close[0]!r}?" if close else ""


def canonical(name: str) -> str:
    """Return a name without underscores, its Greek letters spelled out: theta_1, θ₁ and theta1 are one."""
    return "".join(GREEK.get(mark, mark) for mark in name if mark != "_" and mark not in "[] ")


def _spellings(base: str, order: int) -> list[str]:
    """Return the spellings of a derivative of a coordinate, without underscores: theta1dot, thetadot1, dtheta1."""
    key = canonical(base)
    head = key.rstrip("0123456789")
    index = key[len(head) :]
    parts = canonical(base.split("_", maxsplit=1)[0])
    found = {key + ending for ending in SPELLINGS[order]} | {head + ending + index for ending in SPELLINGS[order]}
    found |= {parts + ending + key[len(parts) :] for ending in SPELLINGS[order]}
    if order:
        found.add("d" * order + key)
    return sorted(found)
