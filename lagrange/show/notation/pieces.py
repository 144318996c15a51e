"""Pieces of formulas, and the order of factors and terms in textbooks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sympy import Add, Derivative
from sympy.core.function import AppliedUndef

from lagrange.show.notation.names import index_parts
from lagrange.statement.coordinate import t

if TYPE_CHECKING:
    from lagrange.statement.statement import Statement


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


LETTERS = ("G", "m M mu", "I J Theta", "g", "", "l L R r a b d h s w length radius", "omega Omega nu")
"""Parameters by the usual meaning of their letters: masses, moments of inertia, gravity, others, lengths, rates.

Textbooks print m g l, m l^2 omega^2, and G m1 m2 with G first. In the same class the order is that of the statement.
"""
OTHERS = LETTERS.index("")
CLASS_OF = {letter: place for place, letters in enumerate(LETTERS) for letter in letters.split()}
PARAMETER, MULTIPLIER, POSITION, VELOCITY, ACCELERATION, FUNCTION = range(6)
LAST = (POSITION, 0, 1_000_000)
"""Rank of time and of symbols that are not in the statement: after the coordinates."""

Key = tuple[Any, ...]


class BookOrder:
    """Sorts factors and terms of the formulas of a statement, in its plain symbols."""

    def __init__(self, statement: Statement) -> None:
        plain = list(statement.plain.values())
        self.rank: dict[Any, tuple[int, int, int]] = {}
        others = [p for p in statement.parameters if p not in statement.defaults]
        stated = [*statement.defaults, *sorted(others, key=_natural)]
        for place, parameter in enumerate(stated):
            head, _ = index_parts(parameter.name)
            self.rank[parameter] = (PARAMETER, CLASS_OF.get(head, OTHERS), place)
        for place, one in enumerate(statement.constraints):
            self.rank[one.multiplier] = (MULTIPLIER, 0, place)
        for place, symbol in enumerate(plain):
            self.rank[symbol] = (POSITION + place % 3, 0, place // 3)
        self.sums = self._stated_sums(statement)

    def _stated_sums(self, statement: Statement) -> frozenset[Any]:
        """Return the sums of the statement: their signs are kept as the author chose them."""
        stated = [statement.lagrangian, statement.dissipation, *statement.forces]
        stated += [one.expression for one in statement.constraints]
        stated += [entry for point in statement.positions.values() for entry in point]
        found = (node for expression in stated for node in expression.xreplace(statement.plain).atoms(Add))
        return frozenset(found)

    def symbols(self, expression: Any) -> list[tuple[int, int, int]]:
        """Return the ranks of the symbols in an expression, sorted; time and unknown symbols rank with positions."""
        return sorted(self.rank.get(symbol, LAST) for symbol in expression.free_symbols)

    def moves(self, expression: Any) -> bool:
        """Return True if an expression contains other symbols than parameters."""
        return any(rank[0] != PARAMETER for rank in self.symbols(expression))

    def follows(self, factor: Any) -> bool:
        """Return True if a factor follows a fraction of constants: it is a function or contains variables."""
        return self.moves(factor) or bool(self.factor(factor)[0] >= ACCELERATION)

    def factor(self, factor: Any) -> Key:
        """Return the sort key of a factor."""
        base, exponent = factor.as_base_exp()
        if given := given_function(base):
            return (ACCELERATION, 1, base.derivative_count if base.is_Derivative else 0, 0, given)
        ranks = self.symbols(factor)
        if base.is_Add and exponent.is_Integer:
            highest = max((rank[0] for rank in ranks), default=PARAMETER)
            first = next((rank for rank in ranks if rank[0] == min(highest, POSITION)), (highest, 0, 0))
            return (highest, *first[1:], 0, str(base))
        if base.is_Symbol and not exponent.free_symbols and (exponent.is_Integer or not self.moves(base)):
            return (*self.rank.get(base, LAST), 1, base.name)
        if not ranks:
            return (PARAMETER, -1, 0, 0, str(base))
        moving = [rank for rank in ranks if rank[0] != PARAMETER]
        lead = (moving or ranks)[0]
        kind = {"sin": 0, "cos": 1}.get(type(base).__name__, 2)
        root = base.is_Symbol or base.is_Add
        return (FUNCTION, 0 if root else 1 + lead[0], lead[2], kind, str(base))

    def term(self, term: Any) -> Key:
        """Return the sort key of a term: accelerations come first, then velocities, then the rest.

        In the rest squares and products of coordinates come first, as in x^2 + y^2 - l^2, then constants, as in l + x
        and m1 + m2 sin(theta)^2.
        """
        ranks = self.symbols(term)
        highest = max((rank[0] for rank in ranks), default=PARAMETER)
        places = [rank[2] for rank in ranks if rank[0] == highest for _ in range(self._power(term, rank))]
        return (-max(highest, POSITION), self._place(term, highest), places, ranks)

    def _power(self, term: Any, rank: tuple[int, int, int]) -> int:
        """Return the degree of a symbol in a product, so that x^2 comes before x y, and x y before y^2."""
        powers = term.as_powers_dict()
        return next((int(e) for base, e in powers.items() if self.rank.get(base) == rank and e.is_Integer and e > 0), 1)

    def _place(self, term: Any, highest: int) -> int:
        if highest > POSITION:
            return 0
        _, rest = term.as_coeff_Mul()
        degree = 0
        for factor in rest.as_ordered_factors() if rest.is_Mul else [rest]:
            base, exponent = factor.as_base_exp()
            if self.moves(base) or self.moves(exponent):
                if not base.is_Symbol or not exponent.is_Integer:
                    return 3
                degree += int(exponent)
        return 1 if degree == 0 else 2 if degree == 1 else 0

    def terms(self, parts: list[Any]) -> list[Any]:
        """Return the terms of a sum in order, a positive one first unless the sum begins with accelerations."""
        ordered = sorted(parts, key=self.term)
        positive = [part for part in ordered if not _negative(part)]
        if _negative(ordered[0]) and positive and self.term(ordered[0])[0] != -ACCELERATION:
            ordered.remove(positive[0])
            ordered.insert(0, positive[0])
        return ordered

    def turned(self, total: Any) -> bool:
        """Return True if a sum in parentheses is better written as its negative.

        This is so if most terms are negative. For one half the sign is that of the statement, else the first term is
        positive.
        """
        negative = sum(map(_negative, total.args))
        if 2 * negative != len(total.args):
            return 2 * negative > len(total.args)
        if (total in self.sums) != (-total in self.sums):
            return total not in self.sums
        return _negative(min(total.args, key=self.term))


def given_function(node: Any) -> str:
    """Return the name of a function of time, or of its derivative; an empty text for any other expression."""
    function = node.expr if isinstance(node, Derivative) else node
    return str(function.func.__name__) if isinstance(function, AppliedUndef) and function.args == (t,) else ""


def _natural(parameter: Any) -> list[tuple[int, str]]:
    """Return the sort key of a name: m2 comes before m10."""
    head, parts = index_parts(parameter.name)
    return [(int(part) if part.isdigit() else 0, part) for part in (head, *parts)]


def _negative(term: Any) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)
