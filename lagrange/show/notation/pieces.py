"""Pieces of a formula: their text, how tightly they bind, and how a sum or a product of them is put together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

SUM, PRODUCT, FRACTION, POWER, ATOM = range(5)
"""How tightly a piece binds."""

CIRCULAR = frozenset(("sin", "cos", "tan", "cot", "sec", "csc", "sinh", "cosh", "tanh", "coth", "sech", "csch"))
"""Functions that a book writes without parentheses about a single symbol, and with an exponent behind their name."""


@dataclass(frozen=True)
class Piece:
    """A part of a formula.

    `closed` is another text of a function, with parentheses about its argument; a function without them has one.
    `call` marks a function that starts with its name. `simple` marks a symbol, a number, or a number times a symbol.
    """

    text: str
    level: int = ATOM
    closed: str = ""
    simple: bool = False
    call: bool = False


class Notation(ABC):
    """How formulas are spelled: plain text, Unicode, LaTeX or MathML."""

    opening, closing = "(", ")"
    """Parentheses whose inside is on several lines."""
    times = "* "
    """Sign of a product whose second factor begins on a line of its own."""
    in_one_line = False
    """Whether a fraction has a stroke, and its own spelling is as wide as it looks."""
    fractions_in_front = True
    """Whether constants stand as a fraction before what moves, (g/l) sin(theta), or all in one, g*sin(theta)/l."""

    def __init__(self, names: Sequence[str] = ()) -> None:
        """Take the names of all symbols, so that no two of them look the same."""
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
        """Return another spelling of one of our letters, where a user's symbol looks like it; `word` is its meaning."""

    @abstractmethod
    def number(self, digits: str, exponent: int | None = None) -> Piece:
        """Return a number without a sign, with a power of ten for its exponent."""

    @abstractmethod
    def constant(self, name: str) -> str:
        """Return the spelling of pi, e or infinity."""

    @abstractmethod
    def brackets(self, inside: str) -> str:
        """Return what is inside in parentheses."""

    @abstractmethod
    def joined(self, texts: Sequence[str]) -> str:
        """Return a product of texts that need no parentheses any more."""

    @abstractmethod
    def fraction(self, above: Piece, below: Piece) -> Piece:
        """Return above / below."""

    @abstractmethod
    def raised(self, base: str, exponent: str) -> Piece:
        """Return a power; the base needs no parentheses any more."""

    @abstractmethod
    def root(self, inside: Piece) -> Piece:
        """Return the square root."""

    @abstractmethod
    def function(self, name: str, arguments: Sequence[Piece], exponent: str = "") -> Piece:
        """Return a function's value, to a whole power where an exponent is given."""

    @abstractmethod
    def cases(self, rows: Sequence[tuple[str, str]]) -> Piece:
        """Return an expression in cases: values and conditions, the last of which may be empty."""

    @abstractmethod
    def comparison(self, left: str, relation: str, right: str) -> str:
        """Return a condition; the relation is one of <, <=, >, >=, =, !=."""

    @abstractmethod
    def text(self, words: str) -> str:
        """Return words inside a formula."""

    @abstractmethod
    def in_line(self, above: str, below: str) -> str:
        """Return a fraction of two numbers with a stroke, as exponents have it."""

    @abstractmethod
    def matrix(self, rows: Sequence[Sequence[str]]) -> str:
        """Return a matrix of texts."""

    @abstractmethod
    def transposed(self, matrix: str) -> str:
        """Return the transpose of a matrix that is a letter."""

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
        """Return a sum of texts, each with whether it is subtracted.

        With `leading` the first has no plus sign; without it the sum goes on from the line above.
        """

    def equal(self, sides: Sequence[str]) -> str:
        """Return sides with signs of equality between them."""
        return " = ".join(sides)

    def grouped(self, piece: Piece, level: int) -> str:
        """Return the text of a piece, in parentheses if it binds less tightly than asked for."""
        return piece.text if piece.level >= level else self.brackets(piece.text)

    def product(self, pieces: Sequence[Piece]) -> Piece:
        """Return the product. A function without parentheses stands before other functions, or last."""
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
    """What binds less tightly than this needs parentheses before another factor."""
