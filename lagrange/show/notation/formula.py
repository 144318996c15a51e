"""Formulas as a book prints them, in any notation: order, signs, fractions and roots are decided here, once."""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.show.notation.book_order import BookOrder
from lagrange.show.notation.pieces import ATOM, PRODUCT, SUM, Notation, Piece
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary import WORDS

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
LARGEST_WHOLE = 10**6
"""Decimals up to here that are whole numbers are printed as such."""


class Typesetter:
    """Writes expressions of a statement in a notation; velocities are letters with a dot, or with _dot behind them."""

    def __init__(self, statement: Statement, notation: Notation) -> None:
        self.notation = notation
        self.order = BookOrder(statement)
        self.plain = statement.plain
        self.letters: dict[Any, str] = {t: notation.letter("t")}
        for symbol in (*statement.parameters, *(one.multiplier for one in statement.constraints)):
            self.letters[symbol] = notation.letter(symbol.name)
        for place, symbol in enumerate(self.plain.values()):
            self.letters[symbol] = notation.letter(statement.names[place // 3], place % 3)

    def write(self, expression: Any) -> str:
        """Return the text of an expression in q(t) and its derivatives, or in plain symbols."""
        return self.piece(self.plainly(expression)).text

    def plainly(self, expression: Any) -> Any:
        """Return the expression in plain symbols."""
        return expression.xreplace(self.plain)

    def terms(self, expression: Any) -> list[tuple[bool, str]]:
        """Return the terms of an expression in plain symbols, in order, each with whether it is subtracted."""
        parts = self.order.terms(list(expression.args)) if expression.is_Add else [expression]
        found = []
        for part in parts:
            negative, piece = self.signed(part)
            found.append((negative, self.notation.grouped(piece, PRODUCT)))
        return found

    def piece(self, node: Any) -> Piece:
        """Return an expression in plain symbols as a piece."""
        if node.is_Add:
            return Piece(self.notation.signs(self.terms(node)), SUM)
        negative, piece = self.signed(node)
        return Piece(self.notation.signs([(True, self.notation.grouped(piece, PRODUCT))]), SUM) if negative else piece

    def signed(self, node: Any) -> tuple[bool, Piece]:
        """Return whether a term is subtracted, and the rest of it."""
        if node.is_Add:
            return False, self.piece(node)
        sign, above, below, number = self.parts(node)
        return sign, self.quotient(above, below, number)

    def parts(self, node: Any) -> tuple[bool, list[Any], list[Any], Any]:
        """Return a term as (negative, factors above, factors below, number); sums have the sign that a book gives them.

        Factors are pairs of a base and a positive exponent.
        """
        number, factors = self.under_one_root(node)
        above: list[Any] = []
        below: list[Any] = []
        for factor in sorted(factors, key=self.order.factor):
            base, exponent = _base_and_exponent(factor)
            if base.is_Add and exponent.is_Integer and self.order.turned(base):
                base, number = -base, -number if exponent.is_odd else number
            if base != 1:
                side, power = (below, -exponent) if exponent.is_negative else (above, exponent)
                side.append((base, power))
        return bool(number.is_negative), above, below, abs(number)

    def under_one_root(self, product: Any) -> tuple[Any, list[Any]]:
        """Return the number before a product, and its factors, with several square roots of constants as one.

        SymPy writes the frequency sqrt(2*g/(3*(R - r))) as sqrt(6)*sqrt(g)*sqrt(1/(R - r))/3.
        """
        number, rest = product.as_coeff_Mul()
        factors = list(sympy.Mul.make_args(rest))
        roots = [x for x in factors if x.is_Pow and abs(x.exp) == sympy.S.Half and not self.order.moves(x.base)]
        if len(roots) < 2 or not all(x.base.is_Rational or x.base.free_symbols for x in roots):
            return number, factors
        inside = sympy.Mul(*(x.base ** (2 * x.exp) for x in roots))
        factor = inside.as_coeff_Mul()[0]
        if number.is_Rational and factor.is_Rational and (factor * number**2).q < factor.q * number.q**2:
            inside, number = inside * number**2, sympy.sign(number)  # sqrt(6)/3 is the root of 2/3
        others = [x for x in factors if x not in roots]
        return number, [*others, sympy.Pow(inside, sympy.S.Half, evaluate=False)]

    def quotient(self, above: list[Any], below: list[Any], number: Any) -> Piece:
        """Return number * above / below, with constants in a fraction in front where the notation has it so."""
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
            fixed, moving = moving, []
        front = self.over(self.factors(top, fixed), self.factors(bottom, below))
        return self.notation.product([front, *map(self.power, moving)]) if moving else front

    def over(self, above: list[Piece], below: list[Piece]) -> Piece:
        """Return the quotient of two products; of none above it is one."""
        top = self.notation.product(above or [self.number(sympy.S.One)])
        return self.notation.fraction(top, self.notation.product(below)) if below else top

    def factors(self, number: Any, pairs: list[Any]) -> list[Piece]:
        """Return the pieces of a product, without a one in front of others."""
        return [*([] if number == 1 else [self.number(number)]), *map(self.power, pairs)]

    def power(self, pair: tuple[Any, Any]) -> Piece:
        """Return base**exponent, the exponent positive or a symbol."""
        base, exponent = pair
        if exponent == 1:
            return self.atom(base)
        if exponent == sympy.S.Half:
            return self.notation.root(self.piece(base))
        written = str(exponent) if exponent.is_Integer else self.piece(exponent).text
        known = isinstance(base, sympy.Function) and not isinstance(base, (AppliedUndef, sympy.Piecewise))
        if known and exponent.is_Integer:
            return self.function(base, written)
        shown = self.piece(base)
        inside = shown.closed or self.notation.grouped(shown, ATOM)
        return self.notation.raised(inside, written if exponent.is_Integer else self.exponent(exponent))

    def exponent(self, exponent: Any) -> str:
        """Return an exponent; a fraction stands in one line."""
        if exponent.is_Rational:
            one, other = (self.number(sympy.Integer(abs(part))).text for part in (exponent.p, exponent.q))
            return self.notation.in_line(one, other)
        return self.piece(exponent).text

    def atom(self, node: Any) -> Piece:
        """Return what is no sum, no product and no power."""
        if node in self.letters:
            return Piece(self.letters[node], simple=True)
        if node.is_Add or node.is_Mul or node.is_Pow:
            return self.piece(node)
        if node.is_Number and node.is_finite:
            return self.number(node)
        if node.is_NumberSymbol or node in (sympy.oo, sympy.zoo, sympy.nan, sympy.I):
            names = {sympy.pi: "pi", sympy.E: "e", sympy.oo: "infinity", sympy.I: "i"}
            return Piece(self.notation.constant(names.get(node, str(node))), simple=True)
        if node.is_Symbol:
            return Piece(self.notation.letter(node.name), simple=True)
        if isinstance(node, sympy.Piecewise):
            return self.notation.cases([(self.piece(value).text, self.condition(when)) for value, when in node.args])
        if isinstance(node, (sympy.Derivative, sympy.Subs)):
            return self.derivative(node)
        return self.function(node)

    def function(self, node: Any, exponent: str = "") -> Piece:
        """Return a function's value; a given function of time alone is a letter."""
        if isinstance(node, AppliedUndef) and node.args == (t,):
            return Piece(self.notation.letter(node.func.__name__), simple=True)
        name = NAMES.get(node.func, node.func.__name__)
        return self.notation.function(name, [self.piece(part) for part in node.args], exponent)

    def derivative(self, node: Any) -> Piece:
        """Return the derivative of a function of time as a letter with dots, of any other function with primes."""
        inner, place = (node.expr, node.point[0]) if isinstance(node, sympy.Subs) else (node, None)
        function, (variable, times) = inner.expr, inner.variable_count[0]
        simple = len(inner.variable_count) == 1 and isinstance(function, AppliedUndef) and len(function.args) == 1
        if simple and function.args == (t,) and times <= 2 and place is None:
            return Piece(self.notation.letter(function.func.__name__, int(times)), simple=True)
        if simple and function.args == (variable,):
            argument = self.piece(variable if place is None else place)
            return self.notation.function(function.func.__name__ + "'" * int(times), [argument])
        return self.notation.function("derivative", [self.piece(part) for part in (function, *inner.variables)])

    def condition(self, when: Any) -> str:
        """Return a condition; the one that always holds is empty."""
        if when == sympy.true:
            return ""
        if when.func in JOINED:
            return self.notation.text(JOINED[when.func]).join(
                self.notation.brackets(self.condition(part)) for part in sorted(when.args, key=str)
            )
        if when.func not in RELATIONS:
            return self.notation.text("not ") + self.notation.brackets(self.condition(when.args[0]))
        return self.notation.comparison(self.piece(when.lhs).text, RELATIONS[when.func], self.piece(when.rhs).text)

    def number(self, number: Any) -> Piece:
        """Return a number that is not negative."""
        if number.is_Rational:
            top, bottom = self.notation.number(str(number.p)), self.notation.number(str(number.q))
            return top if number.q == 1 else self.notation.fraction(top, bottom)
        value = float(number)
        if value == int(value) and value < LARGEST_WHOLE:
            return self.notation.number(str(int(value)))
        digits, _, exponent = repr(value).partition("e")
        return self.notation.number(digits.removesuffix(".0"), int(exponent) if exponent else None)


def _base_and_exponent(factor: Any) -> tuple[Any, Any]:
    """Return a factor as a power; exp(x) is a function, not a power of e, and i is a number, not a root."""
    if isinstance(factor, sympy.exp) or factor is sympy.I:
        return factor, sympy.S.One
    base, exponent = factor.as_base_exp()
    if exponent.is_Rational and base.is_Rational and base.p == 1 and base != 1:
        return sympy.Integer(base.q), -exponent
    return base, exponent
