"""Formulas in lines of a bounded width: their sides, our own letters, and where a long sum is broken."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.pieces import POWER, PRODUCT, Notation
from lagrange.show.notation.sections import Formula, Grid, Partial, Product, Rate, ShownQuantity, Square, Sum, Transpose
from lagrange.show.notation.text import UnicodeNotation, width
from lagrange.statement.statement import Statement

WIDEST = 100
"""Columns of a line, in Unicode; as many letters of a formula fill a printed page."""
SHORT = 20
"""Operations up to which a formula is not measured: it fits into a line."""

MEANINGS = {
    "L": "Lagrangian",
    "T": "kinetic_energy",
    "V": "potential_energy",
    "D": "dissipation",
    "E": "energy",
    "Q": "force",
    "p": "momentum",
    "r": "position",
    "v": "velocity",
    "M": "mass_matrix",
    "h": "right_side",
    "G": "gradient",
    "phi": "constraint",
    "psi": "constraint",
}
"""What our letters stand for: the word that is written where a symbol of the statement looks like the letter."""


@dataclass(frozen=True)
class Line:
    """One line of a formula: its left side, if it stands on this line, and what is right of it.

    `goes_on` marks a line that goes on with the side above.
    """

    left: str
    right: str
    goes_on: bool = False


class SideWriter:
    """Writes sides of formulas in a notation, each in one line."""

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        multipliers = [one.multiplier.name for one in statement.constraints]
        given = [str(function.func.__name__) for function in statement.given]
        names = [*statement.names, *(symbol.name for symbol in statement.parameters), *multipliers, *given]
        self.notation = notation(names)
        self.setter = Typesetter(statement, self.notation)
        self.taken = frozenset((*self.setter.letters.values(), *map(self.notation.letter, given)))

    def side(self, side: Any) -> str:
        """Return one side of a formula in one line."""
        match side:
            case ShownQuantity():
                return self.quantity(side)
            case Square():
                return self.notation.raised(self.quantity(side.quantity), "2").text
            case Partial():
                return self.notation.partial(self.side(side.quantity), self.side(side.by))
            case Rate():
                return self.notation.rate(self.side(side.inside))
            case Transpose():
                return self.notation.transposed(self.quantity(side.quantity))
            case Product():
                return self.notation.joined([self.factor(factor) for factor in side.factors])
            case Sum():
                terms = [(negative, self.side(term)) for negative, term in side.terms]
                return self.notation.signs(terms) if terms else self.notation.number("0").text
            case Grid():
                rows = [[self.side(entry) for entry in row] for row in side.rows]
                return self.notation.vector(rows[0]) if side.vector else self.notation.matrix(rows)
        return self.setter.write(side)

    def factor(self, factor: Any) -> str:
        """Return a factor of a product of ours."""
        if isinstance(factor, sympy.Basic):
            return self.notation.grouped(self.setter.piece(self.setter.plainly(factor)), PRODUCT)
        return self.side(factor)

    def quantity(self, quantity: ShownQuantity) -> str:
        """Return a letter with its indices, or its word where a symbol of the statement looks the same."""
        spelled = self.notation.letter(quantity.letter, 0, quantity.indices)
        if spelled not in self.taken:
            return spelled
        return self.notation.script(quantity.letter, MEANINGS[quantity.letter], quantity.indices)


class LineWriter:
    """Writes formulas of a statement in a notation, on as many lines as they need."""

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        self.sides = SideWriter(statement, notation)
        self.notation = self.sides.notation
        self.setter = self.sides.setter
        self.ruler = self.sides if self.notation.in_one_line else SideWriter(statement, UnicodeNotation)

    def formula(self, row: Formula) -> list[Line]:
        """Return the lines of a formula, the last side broken where it is too wide."""
        *before, last = row.sides
        left = self.notation.equal([self.sides.side(side) for side in before])
        measured = left if self.ruler is self.sides else " = ".join(self.ruler.side(side) for side in before)
        if len(before) == 1 and isinstance(before[0], sympy.Expr) and self.apart(measured, last):
            first, *more = self.broken(before[0], WIDEST)
            lines = [Line("", first), *(Line("", line, goes_on=True) for line in more)]
            if isinstance(last, sympy.Expr) and width(self.ruler.side(last)) > SHORT // 2:
                first, *more = self.broken(last, WIDEST)
                right = [self.notation.equal(["", first]), *more]
                return [*lines, *(Line("", line, goes_on=True) for line in right)]
            whole = self.notation.equal([lines[-1].right, self.sides.side(last)])
            return [*lines[:-1], Line("", whole, goes_on=lines[-1].goes_on)]
        first, *more = self.broken(last, WIDEST - width(measured) - 3)
        return [Line(left, first), *(Line("", line, goes_on=True) for line in more)]

    def apart(self, left: str, last: Any) -> bool:
        """Return whether the last side stands below a left side: both are long, or the left one fills more lines."""
        right = width(self.ruler.side(last)) if isinstance(last, sympy.Expr) else 0
        return width(left) > WIDEST or (width(left) > WIDEST // 2 and width(left) + 3 + right > WIDEST)

    def broken(self, side: Any, room: int) -> list[str]:
        """Return a side on as many lines as it needs, the first of them with that much room."""
        if not isinstance(side, sympy.Expr):
            return [self.sides.side(side)]
        plain = self.setter.plainly(side)
        if plain.count_ops() <= SHORT or width(self.ruler.setter.piece(plain).text) <= room:
            return [self.setter.piece(plain).text]
        if plain.is_Add:
            return list(self.sum_lines(plain, room))
        return self.product_lines(plain, room)

    def sum_lines(self, total: Any, room: int) -> Iterator[str]:
        """Yield the lines of a sum; a term that is wider than a line has lines of its own."""
        line: list[tuple[bool, str]] = []
        first = True
        parts = self.setter.order.terms(list(total.args)) if total.is_Add else [total]
        measures = (text for _, text in self.ruler.setter.terms(total))
        for part, term, measured in zip(parts, self.setter.terms(total), measures, strict=True):
            wide = width(measured) + 3
            if line and wide > room:
                yield self.notation.signs(line, leading=first)
                room, line, first = WIDEST, [], False
            lines = self.product_lines(part, room, leading=first) if wide > WIDEST + 3 else []
            if len(lines) > 1:
                yield from lines
                room, first = WIDEST, False
                continue
            line.append(term)
            room -= wide
        if line:
            yield self.notation.signs(line, leading=first)

    def columns(self, factors: list[Any], number: int = 1) -> int:
        """Return the columns of one half of a fraction of two levels."""
        return width(self.ruler.setter.quotient(factors, [], sympy.Integer(number)).text)

    def product_lines(self, product: Any, room: int, *, leading: bool = True) -> list[str]:
        """Return the lines of a product with a long sum for a factor: the rest, and the sum in parentheses.

        The sum begins on a line of its own where the rest fills half of one. `leading` is as for signs.
        """
        negative, above, below, number = self.setter.parts(product)
        sums = [base for base, exponent in above if base.is_Add and exponent == 1]
        if not sums:
            return [self.setter.piece(product).text]
        longest = max(sums, key=lambda base: base.count_ops())
        rest = [(base, exponent) for base, exponent in above if base is not longest or exponent != 1]
        behind, one = "", self.notation.number("1")
        if self.notation.in_one_line:
            # A vulgar fraction behind the parenthesis would read as an exponent: with such, numbers stay in front.
            split = number.is_Rational and not self.notation.fractions_in_front
            divisor = self.setter.quotient(below, [], sympy.Integer(number.q if split else 1))
            number = sympy.Integer(number.p) if split else number
            behind = self.notation.fraction(one, divisor).text.removeprefix(one.text) if divisor != one else ""
            below = []
        front = self.setter.quotient(rest, below, number)
        closed = front.text if front.level == PRODUCT else self.notation.grouped(front, POWER)
        before = [] if front == one else [closed]
        over = number.p if number.is_Rational else 1
        front_width = 0 if self.notation.in_one_line else max(self.columns(rest, over), self.columns(below))
        apart = front_width > WIDEST // 2
        taken = 2 if apart or not before else front_width if front_width > WIDEST // 3 else WIDEST // 5
        first, *more = self.sum_lines(longest, (WIDEST if apart else room) - taken)
        inside = self.notation.opening + first
        if apart:
            start = [self.notation.signs([(negative, front.text)], leading=leading)]
            more = [self.notation.times + inside, *more]
        else:
            start = [self.notation.signs([(negative, self.notation.joined([*before, inside]))], leading=leading)]
        lines = [*start, *more]
        return [*lines[:-1], lines[-1] + self.notation.closing + behind]
