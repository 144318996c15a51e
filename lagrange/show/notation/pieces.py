"""Pieces of formulas, and what a notation says about each kind of piece."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
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


class Notation(ABC):
    """Spelling of formulas: in plain text, Unicode, LaTeX or MathML."""

    opening, closing = "(", ")"
    """Parentheses around several lines."""
    times = "* "
    """Sign of a product whose second factor begins on a new line."""
    in_one_line = False
    """True if fractions are written with a stroke, so that the width of the text is the width of the formula."""
    fractions_in_front = True
    """True if constants are a separate fraction in front, (g/l) sin(theta); false for one fraction, g*sin(theta)/l."""

    def __init__(self, names: Sequence[str] = ()) -> None:
        """Store the names of all symbols, so that no two of them look the same."""
        self.literal: frozenset[str] = frozenset()
        seen: dict[str, str] = {}
        for name in names:
            seen.setdefault(self.letter(name), name)
        self.literal = frozenset(name for name in names if seen[self.letter(name)] != name)

    @abstractmethod
    def letter(self, name: str, dots: int = 0, indices: Sequence[str] = ()) -> str:
        """Return the spelling of a name, with dots for time derivatives, and further names as indices."""

    @abstractmethod
    def script(self, letter: str, word: str, indices: Sequence[str] = ()) -> str:
        """Return another spelling of a letter such as L or T if a user's symbol looks like it; `word` names it."""

    @abstractmethod
    def number(self, digits: str, exponent: int | None = None) -> Piece:
        """Return a number without a sign, with a power of ten for its exponent."""

    @abstractmethod
    def constant(self, name: str) -> str:
        """Return the spelling of pi, e or infinity."""

    @abstractmethod
    def brackets(self, inside: str) -> str:
        """Return a text in parentheses."""

    @abstractmethod
    def joined(self, texts: Sequence[str]) -> str:
        """Return the product of texts that already have the necessary parentheses."""

    @abstractmethod
    def fraction(self, above: Piece, below: Piece) -> Piece:
        """Return above / below."""

    @abstractmethod
    def raised(self, base: str, exponent: str) -> Piece:
        """Return a power; the base already has the necessary parentheses."""

    @abstractmethod
    def root(self, inside: Piece) -> Piece:
        """Return the square root."""

    @abstractmethod
    def function(self, name: str, arguments: Sequence[Piece], exponent: str = "") -> Piece:
        """Return the value of a function, raised to a whole number if an exponent is given."""

    @abstractmethod
    def cases(self, rows: Sequence[tuple[str, str]]) -> Piece:
        """Return an expression by cases: pairs of value and condition; the last condition may be empty."""

    @abstractmethod
    def comparison(self, left: str, relation: str, right: str) -> str:
        """Return a condition; the relation is one of <, <=, >, >=, =, !=."""

    @abstractmethod
    def text(self, words: str) -> str:
        """Return words inside a formula."""

    @abstractmethod
    def in_line(self, above: str, below: str) -> str:
        """Return a fraction of two numbers with a stroke, for exponents."""

    @abstractmethod
    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix of texts."""

    @abstractmethod
    def transposed(self, matrix: str) -> str:
        """Return the transpose of a matrix, which is a letter."""

    @abstractmethod
    def vector(self, entries: Sequence[str]) -> str:
        """Return a vector in one line."""

    @abstractmethod
    def partial(self, above: str, below: str) -> str:
        """Return the partial derivative of one letter by another."""

    @abstractmethod
    def rate(self, inside: str) -> str:
        """Return d/dt of a partial derivative."""

    @abstractmethod
    def signs(self, terms: Sequence[tuple[bool, str]], *, leading: bool = True) -> str:
        """Return a sum of texts, each with True if it is subtracted.

        With `leading` the first has no plus sign; without it the sum continues the line above.
        """

    def equal(self, sides: Sequence[str]) -> str:
        """Return sides with signs of equality between them."""
        return " = ".join(sides)

    def grouped(self, piece: Piece, level: int) -> str:
        """Return the text of a piece, in parentheses if its precedence is below `level`."""
        return piece.text if piece.level >= level else self.brackets(piece.text)

    def product(self, pieces: Sequence[Piece]) -> Piece:
        """Return the product. A function without parentheses comes last, or before other functions."""
        if len(pieces) == 1:
            return pieces[0]
        texts = []
        for place, piece in enumerate(pieces):
            last = place == len(pieces) - 1
            text = self.grouped(piece, FRACTION if last else self.level_inside_product)
            if piece.closed and not last and not pieces[place + 1].call:
                text = piece.closed
            texts.append(text)
        simple = len(pieces) == 2 and pieces[0].text[:1].isdigit() and pieces[1].simple
        return Piece(self.joined(texts), PRODUCT, simple=simple)

    level_inside_product = FRACTION
    """Least precedence of a factor without parentheses before another factor."""
