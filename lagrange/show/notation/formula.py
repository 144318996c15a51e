"""Formulas with the conventions of textbooks, in any notation, broken into lines of limited width."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.show.notation.book_order import BookOrder
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
from lagrange.show.notation.text import ATOM, POWER, PRODUCT, SUM, FormulaPiece, Notation, PrintedWidth, width
from lagrange.statement.coordinate import RATE, name_of, t
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.words import WORDS

NAMES = {word.build: name for name, word in WORDS.items()}
RELATIONS = {
    sympy.StrictLessThan: "<",
    sympy.LessThan: "<=",
    sympy.StrictGreaterThan: ">",
    sympy.GreaterThan: ">=",
    sympy.Equality: "=",
    sympy.Unequality: "!=",
}
JOINED = {sympy.And: " and ", sympy.Or: " or "}
LARGEST_WHOLE = 10**6  # Largest whole number that is printed without decimals if it was stated as a decimal


class Typesetter:
    """Writes expressions of a statement in a notation; a velocity has a dot, or in plain text the suffix _dot."""

    def __init__(self, statement: Statement, notation: Notation) -> None:
        self.notation = notation
        self.order = BookOrder(statement)
        self.plain = statement.plain
        self._signed: dict[Any, tuple[bool, FormulaPiece]] = {}
        self.letters: dict[Any, str] = {t: notation.letter("t")}
        for symbol in (*statement.parameters, *(constraint.multiplier for constraint in statement.constraints)):
            self.letters[symbol] = notation.letter(symbol.name)
        for index, symbol in enumerate(self.plain.values()):
            name, order = statement.names[index // 3], index % 3
            rate = getattr(statement.coordinates[index // 3].func, RATE, None)
            if rate is not None and order:
                name, order = name_of(rate), order - 1
            self.letters[symbol] = notation.letter(name, order)
        for entry in chain(*statement.entries):
            self.letters[entry] = notation.letter(name_of(entry))

    def write(self, expression: Any) -> str:
        """Return the text of an expression in q(t) and its derivatives, or in plain symbols."""
        return self.piece(self.plainly(expression)).text

    def plainly(self, expression: Any) -> Any:
        """Return the expression with q(t) and its derivatives replaced by plain symbols."""
        return expression.xreplace(self.plain)

    def terms(self, expression: Any) -> list[tuple[bool, str]]:
        """Return the ordered terms of an expression in plain symbols: pairs (True if subtracted, text)."""
        signed = map(self.signed, self.ordered(expression))
        return [(negative, self.notation.grouped(piece, PRODUCT)) for negative, piece in signed]

    def ordered(self, expression: Any) -> list[Any]:
        """Return the terms of an expression in plain symbols, in the order of textbooks."""
        return self.order.terms(sympy.Add.make_args(expression), lambda term: self.signed(term)[0])

    def piece(self, node: Any) -> FormulaPiece:
        """Return the text of an expression in plain symbols, with the precedence of its outermost operation."""
        if node.is_Add or self.signed(node)[0]:
            return FormulaPiece(self.notation.signs(self.terms(node)), SUM)
        return self.signed(node)[1]

    def signed(self, node: Any) -> tuple[bool, FormulaPiece]:
        """Return True if a term is subtracted, and the text of the term without its sign, from a cache."""
        if node not in self._signed:
            if node.is_Add:
                self._signed[node] = False, self.piece(node)
            else:
                sign, above, below, number = self.parts(node)
                self._signed[node] = sign, self.quotient(above, below, number)
        return self._signed[node]

    def parts(self, node: Any) -> tuple[bool, list[Any], list[Any], Any]:
        """Return a term as (negative, factors of the numerator, factors of the denominator, number).

        Factors are pairs of a base and a positive exponent. Sums among them have the signs of textbooks.
        """
        number, factors = self.under_one_root(node)
        above: list[Any] = []
        below: list[Any] = []
        for factor in sorted(factors, key=self.order.factor):
            base, exponent = _base_and_exponent(factor)
            if exponent.is_Integer:
                sign, base = self.order.oriented(base)
                number *= sign**exponent
            if base != 1:
                side, power = (below, -exponent) if exponent.is_negative else (above, exponent)
                side.append((base, power))
        for index, (base, power) in enumerate(above):
            if number.is_negative and power == 1 and self.order.reversible(base, node):
                above[index], number = (-base, power), -number
        return bool(number.is_negative), above, below, abs(number)

    def under_one_root(self, product: Any) -> tuple[Any, list[Any]]:
        """Return the number before a product, and its factors. Square roots of constants are joined to one root.

        SymPy writes the frequency sqrt(2*g/(3*(R - r))) as sqrt(6)*sqrt(g)*sqrt(1/(R - r))/3.
        """
        number, rest = product.as_coeff_Mul()
        factors = list(sympy.Mul.make_args(rest))
        roots = [x for x in factors if x.is_Pow and abs(x.exp) == sympy.S.Half and not self.order.moves(x.base)]
        if len(roots) < 2:
            return number, factors
        inside = sympy.Mul(*(x.base ** (2 * x.exp) for x in roots))
        factor = inside.as_coeff_Mul()[0]
        if number.is_Rational and factor.is_Rational and (factor * number**2).q < factor.q * number.q**2:
            inside, number = inside * number**2, sympy.sign(number)  # sqrt(6)/3 is the root of 2/3
        outside = [x for x in factors if x not in roots]
        return number, [*outside, sympy.Pow(inside, sympy.S.Half, evaluate=False)]

    def quotient(self, above: list[Any], below: list[Any], number: Any) -> FormulaPiece:
        """Return the text of number * above / below; `above` and `below` are lists of (base, exponent).

        In some notations constants are a separate fraction in front, as in (g/l) sin(theta).
        """
        top, bottom = (
            (sympy.Integer(number.p), sympy.Integer(number.q)) if number.is_Rational else (number, sympy.S.One)
        )
        constant = not any(self.order.moves(base) or self.order.moves(exponent) for base, exponent in below)
        if not self.notation.fractions_in_front or not constant or (bottom == 1 and not below):
            return self.over(self.factors(top, above), self.factors(bottom, below))
        fixed = [pair for pair in above if below and not self.order.follows(sympy.Pow(*pair))]
        moving = [pair for pair in above if pair not in fixed]
        if top == 1 and not fixed and len(moving) == 1 and moving[0][0].is_Symbol and below:
            fixed, moving = moving, []
        if len(moving) == 1 and moving[0][0].is_Add and not fixed and below and top == 1:
            divided = any(power.exp.could_extract_minus_sign() for power in moving[0][0].atoms(sympy.Pow))
            fixed, moving = (fixed, moving) if divided and not self.notation.in_one_line else (moving, [])
        front = self.over(self.factors(top, fixed), self.factors(bottom, below))
        return self.notation.product([front, *map(self.power, moving)]) if moving else front

    def over(self, above: list[FormulaPiece], below: list[FormulaPiece]) -> FormulaPiece:
        """Return the text of a quotient of two products; `above` and `below` are their factors. No factors mean 1."""
        top = self.notation.product(above or [self.number(sympy.S.One)])
        return self.notation.fraction(top, self.notation.product(below)) if below else top

    def factors(self, number: Any, pairs: list[Any]) -> list[FormulaPiece]:
        """Return the texts of the factors of a product; a number 1 in front of other factors is left out.

        `pairs` are pairs of a base and a positive exponent.
        """
        return [*([] if number == 1 else [self.number(number)]), *map(self.power, pairs)]

    def power(self, pair: tuple[Any, Any]) -> FormulaPiece:
        """Return the text of a power, given as (base, exponent); the exponent is positive or a symbol."""
        base, exponent = pair
        if exponent == 1:
            return self.atom(base)
        if exponent == sympy.S.Half:
            return self.notation.root(self.piece(base))
        written = str(exponent) if exponent.is_Integer else self.piece(exponent).text
        named = isinstance(base, sympy.Function) and not isinstance(base, (AppliedUndef, sympy.Piecewise))
        if named and exponent.is_Integer:
            return self.function(base, written)
        shown = self.piece(base)
        inside = shown.closed or self.notation.grouped(shown, ATOM)
        if exponent.is_Rational and not exponent.is_Integer:  # a fraction in an exponent is written on one line
            numerator, denominator = (self.number(sympy.Integer(abs(part))).text for part in (exponent.p, exponent.q))
            written = self.notation.slashed.format(numerator, denominator)
        return self.notation.raised(inside, written)

    def atom(self, node: Any) -> FormulaPiece:
        """Return the text of an expression that is not a sum, a product or a power."""
        if node in self.letters:
            return FormulaPiece(self.letters[node], simple=True)
        if node.is_Add or node.is_Mul or node.is_Pow:
            return self.piece(node)
        if node.is_Number and node.is_finite:
            return self.number(node)
        if node.is_NumberSymbol or node in (sympy.oo, sympy.zoo, sympy.nan, sympy.I):
            names = {sympy.pi: "pi", sympy.E: "e", sympy.oo: "infinity", sympy.I: "i"}
            return FormulaPiece(self.notation.constant(names.get(node, str(node))), simple=True)
        if node.is_Symbol:
            return FormulaPiece(self.notation.letter(node.name), simple=True)
        if isinstance(node, sympy.Piecewise):
            return self.notation.cases([(self.piece(value).text, self.condition(when)) for value, when in node.args])
        if isinstance(node, (sympy.Derivative, sympy.Subs)):
            return self.derivative(node)
        return self.function(node)

    def function(self, node: Any, exponent: str = "") -> FormulaPiece:
        """Return the text of a function, raised to `exponent`.

        A given function of time without another argument is written as a letter.
        """
        if isinstance(node, AppliedUndef) and node.args == (t,):
            return FormulaPiece(self.notation.letter(node.func.__name__), simple=True)
        name = NAMES.get(node.func, node.func.__name__)
        return self.notation.function(name, [self.piece(part) for part in node.args], exponent)

    def derivative(self, node: Any) -> FormulaPiece:
        """Return the text of a derivative: a letter with dots for a function of time, primes for any other function."""
        inner, point = (node.expr, node.point[0]) if isinstance(node, sympy.Subs) else (node, None)
        function, (variable, times) = inner.expr, inner.variable_count[0]
        simple = len(inner.variable_count) == 1 and isinstance(function, AppliedUndef) and len(function.args) == 1
        if simple and function.args == (t,) and times <= 2 and point is None:
            return FormulaPiece(self.notation.letter(function.func.__name__, int(times)), simple=True)
        if simple and function.args == (variable,):
            argument = self.piece(variable if point is None else point)
            return self.notation.function(function.func.__name__ + "'" * int(times), [argument])
        return self.notation.function("derivative", [self.piece(part) for part in (function, *inner.variables)])

    def condition(self, when: Any) -> str:
        """Return the text of a condition; empty if it always holds."""
        if when == sympy.true:
            return ""
        if when.func in JOINED:
            return self.notation.words.format(JOINED[when.func]).join(
                self.notation.brackets(self.condition(part)) for part in sorted(when.args, key=str)
            )
        if when.func not in RELATIONS:
            return self.notation.words.format("not ") + self.notation.brackets(self.condition(when.args[0]))
        sign, left, right = RELATIONS[when.func], self.piece(when.lhs).text, self.piece(when.rhs).text
        return self.notation.relation.format(left, self.notation.relations.get(sign, sign), right)

    def number(self, number: Any) -> FormulaPiece:
        """Return the text of a number that is not negative."""
        if number.is_Rational:
            top, bottom = self.notation.number(str(number.p)), self.notation.number(str(number.q))
            return top if number.q == 1 else self.notation.fraction(top, bottom)
        value = float(number)
        if value == int(value) and value < LARGEST_WHOLE:
            return self.notation.number(str(int(value)))
        digits, _, exponent = repr(value).partition("e")
        return self.notation.number(digits.removesuffix(".0"), int(exponent) if exponent else None)


def _base_and_exponent(factor: Any) -> tuple[Any, Any]:
    """Return a factor as (base, exponent). exp(x) is not a power of e, and the imaginary unit is not a root."""
    if isinstance(factor, sympy.exp) or factor is sympy.I:
        return factor, sympy.S.One
    base, exponent = factor.as_base_exp()
    if exponent.is_Rational and base.is_Rational and base.p == 1 and base != 1:
        return sympy.Integer(base.q), -exponent
    return base, exponent


WIDEST = 100  # Width of a line in columns of Unicode text; a formula of this width also fills a printed page
SHORT = 20  # Largest number of operations of a formula that fits into a line without being measured

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
"""Words for the letters of mechanics, written if a symbol of the statement looks like the letter."""


@dataclass(frozen=True)
class FormulaLine:
    """One line of a formula: the text `right`, and before it `left`, the left side of the formula.

    `left` is blank for a line that does not begin with the left side. `goes_on` is true for a line that continues the
    right side of the line above.
    """

    left: str
    right: str
    goes_on: bool = False


def _lines(left: str, texts: Sequence[str]) -> list[FormulaLine]:
    """Return the lines of a formula whose right side is broken into `texts`."""
    first, *more = texts
    return [FormulaLine(left, first), *(FormulaLine("", line, goes_on=True) for line in more)]


class SideWriter:
    """Writes sides of formulas in a notation, each on one line."""

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        multipliers = [constraint.multiplier.name for constraint in statement.constraints]
        function_names = [str(function.func.__name__) for function in statement.given]
        names = [*statement.names, *(symbol.name for symbol in statement.parameters), *multipliers, *function_names]
        self.notation = notation(names)
        self.setter = Typesetter(statement, self.notation)
        self.taken = frozenset((*self.setter.letters.values(), *map(self.notation.letter, function_names)))

    def side(self, side: Any) -> str:
        """Return the text of one side of a formula, on one line."""
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
        """Return the text of a factor of a `Product`."""
        if isinstance(factor, sympy.Basic):
            return self.notation.grouped(self.setter.piece(self.setter.plainly(factor)), PRODUCT)
        return self.side(factor)

    def quantity(self, quantity: ShownQuantity) -> str:
        """Return a quantity's letter with indices, or its word if a symbol of the statement looks like the letter."""
        spelled = self.notation.letter(quantity.letter, 0, quantity.indices)
        if spelled in self.taken:
            spelled = self.notation.script(quantity.letter, MEANINGS[quantity.letter], quantity.indices)
        return self.notation.raised(spelled, "2").text if quantity.squared else spelled


class LineWriter:
    """Writes formulas of a statement in a notation, on as many lines as necessary."""

    def __init__(self, statement: Statement, notation: Callable[[Sequence[str]], Notation]) -> None:
        self.sides = SideWriter(statement, notation)
        self.notation = self.sides.notation
        self.setter = self.sides.setter
        self.ruler = self.sides if self.notation.in_one_line else SideWriter(statement, PrintedWidth)

    def formula(self, row: Formula) -> list[FormulaLine]:
        """Return the lines of a formula, broken where it is wide.

        A formula may have two right sides: the second begins on a new line, or is left out if it has the text of the
        first.
        """
        *before, last = row.sides
        if len(before) == 2 and isinstance(before[1], sympy.Expr):
            if self.sides.side(before[1]) == self.sides.side(last):
                return self.formula(Formula((before[0], last)))
            start = " " * width(self.ruler.side(before[0]))
            return [*self.formula(Formula(tuple(before))), *_lines(start, self.broken(last, WIDEST - len(start) - 3))]
        equals = self.notation.equals
        left = equals.join(self.sides.side(side) for side in before)
        measured = left if self.ruler is self.sides else " = ".join(self.ruler.side(side) for side in before)
        if len(before) == 1 and isinstance(before[0], sympy.Expr) and self.apart(measured, last):
            lines = _lines("", self.broken(before[0], WIDEST))
            if isinstance(last, sympy.Expr) and width(self.ruler.side(last)) > SHORT // 2:
                first, *more = self.broken(last, WIDEST)
                return [*lines, *(FormulaLine("", line, goes_on=True) for line in (equals + first, *more))]
            whole = lines[-1].right + equals + self.sides.side(last)
            return [*lines[:-1], FormulaLine("", whole, goes_on=lines[-1].goes_on)]
        return _lines(left, self.broken(last, WIDEST - width(measured) - 3))

    def beside(self, rows: Sequence[Formula]) -> Iterator[list[Formula]]:
        """Yield formulas in groups that fit side by side into one line each."""
        group: list[Formula] = []
        room = 0
        for row in rows:
            measured = " = ".join(self.ruler.side(side) for side in row.sides)
            wide = max(map(width, measured.split("\n"))) + SHORT // 2
            if group and wide > room:
                yield group
                group = []
            room = (room if group else WIDEST) - wide
            group.append(row)
        if group:
            yield group

    def apart(self, left: str, last: Any) -> bool:
        """Return True if the last side is printed below the left side, because they do not fit into one line."""
        right = width(self.ruler.side(last)) if isinstance(last, sympy.Expr) else 0
        return width(left) > WIDEST or (width(left) > WIDEST // 2 and width(left) + 3 + right > WIDEST)

    def broken(self, side: Any, room: int) -> list[str]:
        """Return a side of a formula as lines; the first line has at most `room` columns."""
        if not isinstance(side, sympy.Expr):
            return [self.sides.side(side)]
        plain = self.setter.plainly(side)
        if plain.count_ops() <= SHORT or width(self.ruler.setter.piece(plain).text) <= room:
            return [self.setter.piece(plain).text]
        if plain.is_Add:
            return list(self.sum_lines(plain, room))
        return self.product_lines(plain, room)

    def sum_lines(self, total: Any, room: int) -> Iterator[str]:
        """Yield the lines of a sum. A term that is wider than a line starts on a new line and is broken."""
        line: list[tuple[bool, str]] = []
        first = True
        parts = self.setter.ordered(total)
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

    def product_lines(self, product: Any, room: int, *, leading: bool = True) -> list[str]:
        """Return the lines of a product with a long sum as a factor: the other factors, and the sum in parentheses.

        The sum begins on a new line if the other factors fill half of a line. `leading` is true if the product begins a
        side of the formula, and has no plus sign.
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
        front_width = 0 if self.notation.in_one_line else width(self.ruler.setter.quotient(rest, below, number).text)
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
