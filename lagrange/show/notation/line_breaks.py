"""Write the formulas of a derivation in any notation, and break formulas that are wider than a page into lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.sections import (
    ExpressionRows,
    Formula,
    Partial,
    Product,
    Rate,
    ShownQuantity,
    SignedTerms,
    Transpose,
)
from lagrange.show.notation.text import (
    POWER,
    PRODUCT,
    Notation,
    PrintedWidth,
    width,
)
from lagrange.statement.statement import Statement

WIDEST = 100  # Width of a line in columns of Unicode text; a formula of this width also fills a printed page
SHORT = 20  # A formula with at most this number of operations fits into a line; its width is not measured

MEANINGS = {
    "L": "Lagrangian",
    "T": "kinetic_energy",
    "V": "potential_energy",
    "D": "dissipation",
    "E": "energy",
    "J": "jacobi_integral",
    "Q": "force",
    "p": "momentum",
    "r": "position",
    "v": "velocity",
    "M": "mass_matrix",
    "h": "right_side",
    "G": "gradient",
    "f": "constraint",
}
"""Word for each letter of mechanics. It replaces the letter if a symbol of the system is spelled like the letter."""


@dataclass(frozen=True)
class FormulaLine:
    """One line of a printed formula: the text `left`, an equals sign, and the text `right`.

    `left` is the left side of the formula, and empty for a line without left side. `goes_on` is true for a line that
    continues the right side of the line above.
    """

    left: str
    right: str
    goes_on: bool = False


def _lines(left: str, texts: Sequence[str]) -> list[FormulaLine]:
    """Return the lines of a formula with the left side `left`, whose right side is broken into `texts`."""
    first, *more = texts
    return [FormulaLine(left, first), *(FormulaLine("", line, goes_on=True) for line in more)]


class SideWriter:
    """Writes one side of a formula, left or right of an equals sign, as one line of text in a notation."""

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        multipliers = [constraint.multiplier.name for constraint in statement.constraints]
        function_names = [str(function.func.__name__) for function in statement.given]
        names = [*statement.names, *(symbol.name for symbol in statement.parameters), *multipliers, *function_names]
        self.notation = notation(names)
        self.setter = Typesetter(statement, self.notation)
        self.taken = frozenset((*self.setter.letters.values(), *map(self.notation.letter, function_names)))

    def side(self, side: Any) -> str:
        """Return the text of one side of a formula, a SymPy expression or an object such as `Partial`, on one line."""
        match side:
            case ShownQuantity():
                return self.quantity(side)
            case Partial():
                return self.notation.partial(self.side(side.quantity), self.side(side.by))
            case Rate():
                return self.notation.time_derivative.format(self.side(side.inside))
            case Transpose():
                return self.notation.transpose.format(self.side(side.matrix))
            case Product():
                return self.notation.joined([self.factor(factor) for factor in side.factors])
            case SignedTerms():
                terms = [(negative, self.side(term)) for negative, term in side.terms]
                return self.notation.signs(terms) if terms else self.notation.number("0").text
            case ExpressionRows():
                rows = [[self.side(entry) for entry in row] for row in side.rows]
                if side.vector:
                    return self.notation.brackets(self.notation.comma.join(rows[0]))
                return self.notation.matrix(rows)
        return self.setter.write(side)

    def factor(self, factor: Any) -> str:
        """Return the text of a factor, an expression or a quantity, of a `Product`; a sum is in parentheses."""
        if isinstance(factor, sympy.Basic):
            return self.notation.grouped(self.setter.piece(self.setter.plainly(factor)), PRODUCT)
        return self.side(factor)

    def quantity(self, quantity: ShownQuantity) -> str:
        """Return a quantity's letter with indices; its word if a symbol of the system is spelled like the letter."""
        spelled = self.notation.letter(quantity.letter, 0, quantity.indices)
        if spelled in self.taken:
            spelled = self.notation.script(quantity.letter, MEANINGS[quantity.letter], quantity.indices)
        return self.notation.raised(spelled, "2").text if quantity.squared else spelled


class LineWriter:
    """Writes formulas of a statement in a notation, and breaks wide formulas into lines.

    `printed` writes the text whose width is measured. For LaTeX and MathML this is another text, which is as wide as
    the printed formula.
    """

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        self.sides = SideWriter(statement, notation)
        self.notation = self.sides.notation
        self.setter = self.sides.setter
        self.printed = self.sides if self.notation.in_one_line else SideWriter(statement, PrintedWidth)

    def formula(self, row: Formula) -> list[FormulaLine]:
        """Return the lines of the formula `row`.

        A formula a = b = c has two right sides. The second one begins on a new line, or is left out if it has the same
        text as the first one.
        """
        *before, last = row.sides
        if len(before) == 2 and isinstance(before[1], sympy.Expr):
            if self.sides.side(before[1]) == self.sides.side(last):
                return self.formula(Formula((before[0], last)))
            start = " " * width(self.printed.side(before[0]))
            return [*self.formula(Formula(tuple(before))), *_lines(start, self.broken(last, WIDEST - len(start) - 3))]
        equals = self.notation.equals
        left = equals.join(self.sides.side(side) for side in before)
        measured = left if self.printed is self.sides else " = ".join(self.printed.side(side) for side in before)
        if len(before) == 1 and isinstance(before[0], sympy.Expr) and self.apart(measured, last):
            lines = _lines("", self.broken(before[0], WIDEST))
            if isinstance(last, sympy.Expr) and width(self.printed.side(last)) > SHORT // 2:
                first, *more = self.broken(last, WIDEST)
                return [*lines, *(FormulaLine("", line, goes_on=True) for line in (equals + first, *more))]
            whole = lines[-1].right + equals + self.sides.side(last)
            return [*lines[:-1], FormulaLine("", whole, goes_on=lines[-1].goes_on)]
        return _lines(left, self.broken(last, WIDEST - width(measured) - 3))

    def beside(self, rows: Sequence[Formula]) -> Iterator[list[Formula]]:
        """Yield the formulas `rows` in groups; the formulas of a group fit side by side into one line."""
        group: list[Formula] = []
        room = 0
        for row in rows:
            measured = " = ".join(self.printed.side(side) for side in row.sides)
            wide = max(map(width, measured.split("\n"))) + SHORT // 2
            if group and wide > room:
                yield group
                group = []
            room = (room if group else WIDEST) - wide
            group.append(row)
        if group:
            yield group

    def apart(self, left: str, last: Any) -> bool:
        """Return True if the right side `last` of an equation is printed on its own line, below the left side.

        It is if it does not fit into one line with the printed left side, `left`.
        """
        right = width(self.printed.side(last)) if isinstance(last, sympy.Expr) else 0
        return width(left) > WIDEST or (width(left) > WIDEST // 2 and width(left) + 3 + right > WIDEST)

    def broken(self, side: Any, room: int) -> list[str]:
        """Return a side of a formula as lines; the first line has at most `room` columns."""
        if not isinstance(side, sympy.Expr):
            return [self.sides.side(side)]
        plain = self.setter.plainly(side)
        if plain.count_ops() <= SHORT or width(self.printed.setter.piece(plain).text) <= room:
            return [self.setter.piece(plain).text]
        if plain.is_Add:
            return list(self.sum_lines(plain, room))
        return self.product_lines(plain, room)

    def sum_lines(self, total: Any, room: int) -> Iterator[str]:
        """Yield the lines of the sum `total`; the first line has at most `room` columns.

        A term that is wider than a line starts on a new line and is broken.
        """
        line: list[tuple[bool, str]] = []
        first = True
        parts = self.setter.ordered(total)
        measures = (text for _, text in self.printed.setter.terms(total))
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

    def product_lines(self, product: Any, room: int, *, leading: bool = True) -> list[str]:
        """Return the lines of a product with a long sum as a factor: the other factors, then the sum in parentheses.

        The first line has at most `room` columns. The sum begins on a new line if the other factors fill half of a
        line. With `leading` the product begins a side of the formula, and a positive product has no plus sign.
        """
        negative, above, below, number = self.setter.parts(product)
        sums = [base for base, exponent in above if base.is_Add and exponent == 1]
        if not sums:
            return [self.setter.piece(product).text]
        longest = max(sums, key=lambda base: base.count_ops())
        rest = [(base, exponent) for base, exponent in above if base is not longest or exponent != 1]
        suffix, unit = "", self.notation.number("1")
        if self.notation.in_one_line:
            # A fraction such as ½ after the parenthesis would look like an exponent: then numbers stay in front.
            split = number.is_Rational and not self.notation.fractions_in_front
            divisor = self.setter.quotient(below, [], sympy.Integer(number.q if split else 1))
            number = sympy.Integer(number.p) if split else number
            suffix = self.notation.fraction(unit, divisor).text.removeprefix(unit.text) if divisor != unit else ""
            below = []
        front = self.setter.quotient(rest, below, number)
        closed = front.text if front.level == PRODUCT else self.notation.grouped(front, POWER)
        before = [] if front == unit else [closed]
        front_width = 0 if self.notation.in_one_line else width(self.printed.setter.quotient(rest, below, number).text)
        separate = front_width > WIDEST // 2
        used = 2 if separate or not before else front_width if front_width > WIDEST // 3 else WIDEST // 5
        first, *more = self.sum_lines(longest, (WIDEST if separate else room) - used)
        inside = self.notation.opening + first
        if separate:
            start = [self.notation.signs([(negative, front.text)], leading=leading)]
            more = [self.notation.times + inside, *more]
        else:
            start = [self.notation.signs([(negative, self.notation.joined([*before, inside]))], leading=leading)]
        lines = [*start, *more]
        return [*lines[:-1], lines[-1] + self.notation.closing + suffix]
