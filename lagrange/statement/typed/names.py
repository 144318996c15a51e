"""Find the symbols of a system in typed words: m_1 is m1, θ̈₁ and thetaddot1 are theta1_ddot, and mgl is m*g*l."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from lagrange.statement.typed.tokens import Token
from lagrange.statement.vocabulary.functions import ALIASES, FUNCTION_NAMES
from lagrange.statement.vocabulary.letters import GREEK

RATES = ("", "_dot", "_ddot")  # Suffixes of a coordinate, its velocity and its acceleration in the strict notation

# Suffixes that people type in place of those in `RATES`, by the order of the derivative, without underscores
SPELLINGS = (("",), ("dot",), ("ddot", "dotdot", "doubledot"))
LONGEST_SPLIT = 64  # Largest number of characters of a word that is tried as a product of several symbols
MOST_SPLITS = 4  # Largest number of products that one word may mean. Each is tried.
SIMILAR = 0.8  # Least similarity, from 0 to 1, of a name that a hint suggests
SHORTEST_HINT = 4  # Least number of characters of a name that a hint suggests

FUNCTION_SPELLINGS = {"arcsin": "asin", "arccos": "acos", "arctan": "atan", "sgn": "sign"}
FUNCTION_SPELLINGS |= {"sen": "sin", "arcsen": "asin", "arctg": "atan"}
FUNCTION_SPELLINGS |= {name.capitalize(): name for name in ("sin", "cos", "tan", "cot", "sqrt", "exp")}
"""Other names of functions that people type, with the names in the strict notation."""


_LENGTH, _AXIS = re.compile(r"l_?[0-9]*"), re.compile(r"[xyz]_?[0-9]*")
_DERIVATIVE = re.compile(r"_?(?:d?dot)+$")


@dataclass(frozen=True)
class Piece:
    """Symbol or function within a typed word, with its name in the strict notation of scene files.

    `kind` is "symbol", "function", "e" (Euler's number), "pi" or "condition". If the symbol is a coordinate, a given
    function, or a derivative of one, `base` is this function and `order` the order of the derivative. For other symbols
    `base` is "". `moves` is true if the symbol changes in time.
    """

    name: str
    kind: str = "symbol"
    base: str = ""
    order: int = 0
    moves: bool = False


class Names:
    """Symbols of one system, by all accepted spellings.

    `names` are the names in the strict notation of scene files. For a coordinate or given function X they include
    X_dot. `others` maps other spellings of a multiplier or of a rate of a rotation to its strict name. `defined` are
    the names that the answer defines.
    """

    def __init__(self, names: Iterable[str], others: Mapping[str, str], defined: Collection[str] = ()) -> None:
        self.names = list(names)
        self.bases = [name for name in self.names if f"{name}_dot" in self.names]
        pieces = {
            base + ending: Piece(base + ending, base=base, order=order, moves=True)
            for base in self.bases
            for order, ending in enumerate(RATES)
        }
        self.exact = {name: pieces.get(name) or Piece(name, moves=name in others.values()) for name in self.names}
        self.spellings: dict[str, Piece] = {}
        short = [letter for letter in "dp" if letter not in self.exact]
        twice = [letter for letter in "dD" if not {letter, f"{letter}2"} & self.exact.keys()]
        for spelling, name in [*self._usual(defined), *zip(self.bases, self.bases, strict=True), *others.items()]:
            joined = spelling not in defined  # False for a name of the answer: dV/dx is not a quotient of rates
            for order in range(len(RATES)):
                piece = self.derivative(self.exact[name], order) if order else self.exact[name]
                if piece is not None:
                    self.spellings |= dict.fromkeys(_spellings(spelling, order, short, twice, joined=joined), piece)
        self.spellings |= {canonical(name): piece for name, piece in self.exact.items() if not piece.base}
        rates = [(f"{base}_{'t' * order}", base + RATES[order]) for base in self.bases for order in (1, 2)]
        self.exact = {typed: self.exact[name] for typed, name in rates if name in self.exact} | self.exact
        self.words = {name: Piece(ALIASES.get(name, name), "function") for name in FUNCTION_NAMES}
        self.words |= {name: Piece(strict, "function") for name, strict in FUNCTION_SPELLINGS.items()}
        self.words |= {"Piecewise": Piece("Piecewise", "function"), "True": Piece("True", "condition")}
        self.words |= {"pi": Piece("pi", "pi"), "t": Piece("t", moves=True), "e": Piece("e", "e")}
        # Symbols that may be factors within a word. The letter e is left out, since too many words contain it.
        self._factors = {key: piece for key, piece in self.words.items() if piece.kind != "e"} | self.spellings
        self._readings: dict[str, list[list[Piece]]] = {}

    def _usual(self, defined: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield (spelling, name) for spellings of textbooks: ell for l, v_x and a_x for the derivatives of x.

        A Greek coordinate may have a capital letter. If v is a parameter, the word vx is a product. If v is one of the
        names `defined` in the answer, vx is not a product.
        """
        for name in self.names:
            if _LENGTH.fullmatch(name) and "ell" not in self.names:
                yield f"ell{name[1:]}", name
        for base in self.bases:
            if base.rstrip("_0123456789") in GREEK.values() and base.capitalize() not in self.names:
                yield base.capitalize(), base
        for letter, ending in (("v", "_dot"), ("a", "_ddot")):
            if letter not in self.names or letter in defined:
                pairs = ((letter + base, base + ending) for base in self.bases if _AXIS.fullmatch(base))
                yield from (pair for pair in pairs if pair[1] in self.exact)

    def readings(self, word: str) -> list[list[Piece]]:
        """Return the readings of a word, the likeliest first: lists of one symbol, or of the factors of a product."""
        if word not in self._readings:
            spelled = "".join(GREEK.get(mark, mark) for mark in word)
            whole = self.exact.get(word) or self.exact.get(spelled)
            whole = whole or self.spellings.get(canonical(word)) or self.words.get(word)
            divided = whole is None or (word.startswith("d") and "d" in self.exact and word != "d")  # d*theta
            self._readings[word] = ([[whole]] if whole else []) + (self._splits(word) if divided else [])
        return self._readings[word]

    def _splits(self, word: str) -> list[list[Piece]]:
        """Return the products of known symbols whose joined names are the word. Products of fewer factors come first.

        Of products with equal numbers of factors, the one with the longer first name comes first. No factor begins with
        a digit or a subscript: m_g is not the product of m and g. The time does not follow a derivative: theta_dott is
        a typing error.
        """
        key = canonical(word)
        subscripts = {len(canonical(word[:i])) for i, mark in enumerate(word) if mark == "_"}
        if len(key) > LONGEST_SPLIT:
            return []
        best: list[list[list[Piece]]] = [[] for _ in range(len(key) + 1)]
        best[len(key)] = [[]]
        for begin in range(len(key) - 1, -1, -1):
            products: list[list[Piece]] = []
            for end in range(len(key), begin, -1):
                piece = self._factors.get(key[begin:end])
                if piece is None or not best[end] or key[end : end + 1].isdigit() or end in subscripts:
                    continue
                times = piece.order and key[end:] == "t"
                products += [] if times else [[piece, *rest] for rest in best[end]]
            best[begin] = sorted(products, key=len)[:MOST_SPLITS]
        return best[0]

    def order(self, tokens: Sequence[Token]) -> int:
        """Return the highest order of time derivatives in a formula. A d/dt of an expression counts as order 2."""
        orders = [2 if token.kind in ("rate", "operator") else max(token.order, token.primes) for token in tokens]
        words = (reading for token in tokens if token.kind == "word" for reading in self.readings(token.text))
        return max([*orders, *(piece.order for reading in words for piece in reading)], default=0)

    def derivative(self, piece: Piece, order: int) -> Piece | None:
        """Return the derivative of order `order` of a coordinate or given function. Return None if there is none."""
        total = piece.order + order
        if not piece.base or total >= len(RATES):
            return None
        return self.exact.get(piece.base + RATES[total])

    def hint(self, word: str) -> str:
        """Return a sentence on the likely meaning of an unknown word, or "".

        It suggests only coordinates and parameters, not derivatives. It suggests no short name, since a word that
        begins with a short name may be a product.
        """
        power = re.fullmatch(r"([A-Za-z]+)([2-9])", word)
        if power and self.readings(power.group(1)):
            return f" For a power write {power.group(1)}^{power.group(2)}."
        known = [name for name in self.names if len(name) >= SHORTEST_HINT and not name.endswith(RATES[1:])]
        close = get_close_matches(_DERIVATIVE.sub("", word)[:80], known, n=1, cutoff=SIMILAR)
        return f" Did you mean {close[0]!r}?" if close else ""


def canonical(name: str) -> str:
    """Return a name without underscores and with Greek letters spelled out: theta1 for theta_1, θ₁ and theta1."""
    return "".join(GREEK.get(mark, mark) for mark in name if mark != "_" and mark not in "[] ")


def _spellings(base: str, order: int, short: Iterable[str], twice: Iterable[str], *, joined: bool) -> list[str]:
    """Return spellings of the derivative `order` of a coordinate `base`, without underscores: theta1dot, thetadot1.

    `short` are letters that mean a derivative, as in theta1d and theta1p. `twice` are letters that mean a second one,
    as in D2theta1. If `joined` is true, dtheta1 is a derivative as well.
    """
    endings = [*SPELLINGS[order], *(letter * order for letter in short)]
    key = canonical(base)
    heads = {key, key.rstrip("0123456789"), canonical(base.split("_", maxsplit=1)[0])}
    spellings = {head + ending + key[len(head) :] for head in heads for ending in endings}
    if order:
        power = "" if order == 1 else str(order)
        spellings.add(f"d{power}{key}dt{power}")  # dtheta_dt and d2theta_dt2
    if order and joined:
        spellings.add("d" * order + key)
    if order > 1:
        spellings |= {f"{letter}{order}{key}" for letter in twice}
    return sorted(spellings)
