"""Write SymPy expressions as textbooks do, in any notation: the order of factors and terms, signs, and fractions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, cached_property
from itertools import chain
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.show.notation.text import ATOM, PRODUCT, SUM, FormulaPiece, Notation, index_parts
from lagrange.statement.coordinate import RATE, name_of, t
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.functions import NAME_OF_CLASS

LETTERS = ("G", "m M mu", "I J Theta", "g", "", "l L R r a b d h s w length radius", "omega Omega nu")
"""Classes of parameters, by the usual meaning of their letters, in the order in which a product prints them. The
classes are Newton's constant, masses, moments of inertia, gravity, others, lengths, rates. Textbooks print m g l, m l^2
omega^2, and G m1 m2. Parameters of one class have the order of the statement."""
OTHERS = LETTERS.index("")
CLASS_OF = {letter: rank for rank, letters in enumerate(LETTERS) for letter in letters.split()}
PARAMETER, MULTIPLIER, POSITION, VELOCITY, ACCELERATION, FUNCTION = range(6)
GRAVITY = (PARAMETER, LETTERS.index("g"))
MASS = (PARAMETER, LETTERS.index("m M mu"))
LAST = (POSITION, 0, 1_000_000)
"""Rank of time, and of symbols that are not in the statement, in the order of the symbols in a product or sum. They
follow the coordinates."""

Key = tuple[Any, ...]


class BookOrder:
    """Sort keys for the factors and terms of a statement's formulas, as textbooks order them.

    Formulas have a SymPy symbol in place of each coordinate q(t) and its derivatives. `rank` maps each symbol to its
    place in the order: the kind of symbol, the class of its letter, its index in the statement. Kinds are parameter,
    multiplier, position, velocity and acceleration, in this order.
    """

    def __init__(self, statement: Statement) -> None:
        plain = list(statement.plain.values())
        self.rank: dict[Any, tuple[int, int, int]] = {}
        stated = [*statement.defaults, *sorted(statement.without_values, key=_natural)]
        for index, parameter in enumerate(stated):
            head, _ = index_parts(parameter.name)
            self.rank[parameter] = (PARAMETER, CLASS_OF.get(head, OTHERS), index)
        for index, constraint in enumerate(statement.constraints):
            self.rank[constraint.multiplier] = (MULTIPLIER, 0, index)
        for index, symbol in enumerate(plain):
            self.rank[symbol] = (POSITION + index % 3, 0, index // 3)
        self.typed: frozenset[Any] = frozenset()
        """Sums and products that a student typed in an answer; their signs are kept, like those of the statement."""
        self._statement = statement
        self.factor = cache(self._key)  # the same factors occur often

    @cached_property
    def sums(self) -> frozenset[Any]:
        """The sums that the statement contains. Formulas keep the signs that the author chose in these sums."""
        statement = self._statement
        stated = [statement.lagrangian, statement.dissipation, *statement.forces]
        stated += [constraint.expression for constraint in statement.constraints]
        stated += [entry for point in statement.positions.values() for entry in point]
        return frozenset(node for part in stated for node in part.xreplace(statement.plain).atoms(sympy.Add))

    def symbols(self, expression: Any) -> list[tuple[int, int, int]]:
        """Return the ranks of the symbols in an expression, in ascending order.

        A rank is (kind of the symbol, such as parameter or velocity; class of its letter; its index in the statement).
        Time and unknown symbols rank after the coordinates.
        """
        return sorted(self.rank.get(symbol, LAST) for symbol in expression.free_symbols)

    def moves(self, expression: Any) -> bool:
        """Return True if an expression contains a symbol that is not a parameter, and so may vary in time."""
        return any(rank[0] != PARAMETER for rank in self.symbols(expression))

    def follows(self, factor: Any) -> bool:
        """Return True if a factor is printed after a fraction of constants, like sin(theta) in (g/l) sin(theta).

        Such a factor is a function, or contains a symbol that is not a parameter.
        """
        return self.moves(factor) or bool(self.factor(factor)[0] >= ACCELERATION)

    def _key(self, factor: Any) -> Key:
        """Return a sort key of a factor, which orders the factors of a product as textbooks do.

        Constants come first, then powers of symbols, sums, and functions.
        """
        base, exponent = factor.as_base_exp()
        if function := given_function(base):
            return (ACCELERATION, 1, base.derivative_count if base.is_Derivative else 0, 0, function)
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
        """Return the sort key of a term: accelerations come first, then velocities, then all other terms.

        Among the others, squares and products of coordinates come first, as in x^2 + y^2 - l^2. Constants follow, as in
        l + x and m1 + m2 sin(theta)^2. Terms with the acceleration of gravity g, then functions of time alone, come
        last.
        """
        ranks = self.symbols(term)
        highest = max((rank[0] for rank in ranks), default=PARAMETER)
        indices = [rank[2] for rank in ranks if rank[0] == highest for _ in range(self._power(term, rank))]
        degree = self._degree(term) if highest == VELOCITY else 0
        last = self._last(ranks) if highest <= POSITION else 0
        return (-max(highest, POSITION), degree, last, self._place(term, highest), indices, ranks)

    def _last(self, ranks: list[tuple[int, int, int]]) -> int:
        """Return a part of a term's sort key, from the ranks of its symbols in ascending order.

        The value is 2 for a function of time alone, which is printed last. It is 1 for a product with the acceleration
        of gravity g, and 0 for any other term.
        """
        if ranks and ranks[-1] == LAST and not any(rank[0] == POSITION for rank in ranks if rank != LAST):
            return 2
        return int(len(ranks) > 1 and any(rank[:2] == GRAVITY for rank in ranks))

    def _degree(self, term: Any) -> int:
        """Return a part of a term's sort key that depends on its velocities.

        The value is 1 for a product of several velocities, 2 for a single velocity to the first power, and 0 for all
        other terms, such as squares. A term with sums as factors has the largest value of their terms.
        """
        factors = term.as_powers_dict()
        powers = [e for base, e in factors.items() if self.rank.get(base, LAST)[0] == VELOCITY]
        if not powers:
            sums = (base.args for base, e in factors.items() if base.is_Add and e == 1)
            return max((self._degree(part) for parts in sums for part in parts), default=0)
        return 1 if len(powers) > 1 else 2 if powers == [1] else 0

    def _power(self, term: Any, rank: tuple[int, int, int]) -> int:
        """Return the exponent of the symbol with the rank `rank` in the product `term`, 1 if it does not occur in it.

        Exponents sort x^2 before x y, and x y before y^2.
        """
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

    def terms(self, parts: Iterable[Any], subtracted: Callable[[Any], bool]) -> list[Any]:
        """Return the terms `parts` of a sum in the order of textbooks.

        A positive term comes first, unless the sum begins with accelerations. A subtracted constant comes last, as in
        x + y - l. `subtracted` returns True for a term with a minus sign.
        """
        ordered = sorted(parts, key=self.term)
        if not subtracted(ordered[0]) or self.term(ordered[0])[0] == -ACCELERATION:
            return ordered
        if not self.moves(ordered[0]):
            ordered.sort(key=lambda part: not self.moves(part))
        first = next((part for part in ordered if not subtracted(part)), ordered[0])
        ordered.remove(first)
        return [first, *ordered]

    def is_reversible(self, total: Any, term: Any) -> bool:
        """Return True if the minus sign of a term may be moved into its factor `total`: -(m1 - m2)*g is (m2 - m1)*g.

        `total` must be a difference of two masses, or another difference of constants that does not occur in the
        statement. A stated difference such as R - r is usually positive, and is kept. A term that a user typed is not
        changed.
        """
        if not total.is_Add or len(total.args) != 2 or sum(map(_is_negative, total.args)) != 1 or self.moves(total):
            return False
        masses = all(rank[:2] == MASS for rank in self.symbols(total))
        return (masses or total not in self.sums) and term not in self.typed

    def turned(self, total: Any) -> bool:
        """Return True if the sum `total`, in parentheses, is written as -(...) with all signs reversed.

        A sum of the statement keeps its signs if it has a positive term. Any other sum is written so that most of its
        terms are positive. If half of its terms are positive, the first term is made positive.
        """
        negative = sum(map(_is_negative, total.args))
        if negative == len(total.args):
            return True
        preferred = self._preferred(total)
        if preferred is not None:
            return bool(preferred != total)
        if 2 * negative != len(total.args):
            return 2 * negative > len(total.args)
        return _is_negative(min(total.args, key=self.term))

    def oriented(self, factor: Any) -> tuple[int, Any]:
        """Return a sign, 1 or -1, and a factor with the signs of textbooks; their product is `factor`.

        SymPy changes cos(a - b) and sin(a - b) to cos(b - a) and -sin(b - a). If the user typed only a - b, this change
        is undone.
        """
        if factor.is_Add:
            return (-1, -factor) if self.turned(factor) else (1, factor)
        argument = factor.args[0] if factor.is_Function else factor
        if not argument.is_Add or self._preferred(argument) in (None, argument):
            return 1, factor
        sign = {factor: 1, -factor: -1}.get(factor.func(-argument, *factor.args[1:]))
        return (1, factor) if sign is None else (sign, factor.func(-argument, evaluate=False))

    def _preferred(self, total: Any) -> Any:
        """Return `total`, a sum, or its negative: the one that the user typed, else the one in the statement.

        Return None if both or neither occur.
        """
        for sums in (self.typed, self.sums):
            if (total in sums) != (-total in sums):
                return total if total in sums else -total
        return None


def given_function(node: Any) -> str:
    """Return the name of the known function of time that `node` is, such as X(t), or of which it is a derivative.

    The result is "" for any other expression.
    """
    function = node.expr if isinstance(node, sympy.Derivative) else node
    return str(function.func.__name__) if isinstance(function, AppliedUndef) and function.args == (t,) else ""


def _natural(parameter: Any) -> list[tuple[int, str]]:
    """Return a key that sorts parameters by name with numbers in numerical order: m2 comes before m10."""
    head, parts = index_parts(parameter.name)
    return [(int(part) if part.isdigit() else 0, part) for part in (head, *parts)]


def _is_negative(term: Any) -> bool:
    return bool(term.as_coeff_Mul()[0].is_negative)


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
    """Writes SymPy expressions of a statement in a notation, as text in the order of textbooks.

    Expressions that its methods take have a SymPy symbol in place of each coordinate q(t) and each of its derivatives,
    unless a method says otherwise.
    """

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
        """Return the text of an expression, in which coordinates are functions q(t) or symbols in their place."""
        return self.piece(self.plainly(expression)).text

    def plainly(self, expression: Any) -> Any:
        """Return the expression with a SymPy symbol in place of each coordinate q(t) and each of its derivatives."""
        return expression.xreplace(self.plain)

    def terms(self, expression: Any) -> list[tuple[bool, str]]:
        """Return the terms of a sum as pairs (True if subtracted, text without sign), in the order of textbooks.

        The sum has SymPy symbols in place of coordinates q(t) and their derivatives.
        """
        signed = map(self.signed, self.ordered(expression))
        return [(negative, self.notation.grouped(piece, PRODUCT)) for negative, piece in signed]

    def ordered(self, expression: Any) -> list[Any]:
        """Return the terms of a sum in the order of textbooks, as SymPy expressions.

        The sum has SymPy symbols in place of coordinates q(t) and their derivatives.
        """
        return self.order.terms(sympy.Add.make_args(expression), lambda term: self.signed(term)[0])

    def piece(self, node: Any) -> FormulaPiece:
        """Return the text of the expression `node`, with the precedence of its outermost operation.

        The expression has SymPy symbols in place of coordinates q(t) and their derivatives.
        """
        if node.is_Add or self.signed(node)[0]:
            return FormulaPiece(self.notation.signs(self.terms(node)), SUM)
        return self.signed(node)[1]

    def signed(self, node: Any) -> tuple[bool, FormulaPiece]:
        """Return (True if the term `node` has a minus sign, text of the term without its sign).

        Results are cached.
        """
        if node not in self._signed:
            if node.is_Add:
                self._signed[node] = False, self.piece(node)
            else:
                sign, above, below, number = self.parts(node)
                self._signed[node] = sign, self.quotient(above, below, number)
        return self._signed[node]

    def parts(self, node: Any) -> tuple[bool, list[Any], list[Any], Any]:
        """Split the term `node`, such as -2*x/3, into (True if subtracted, numerator, denominator, number).

        Numerator and denominator are lists of pairs of a base and a positive exponent, in the order of textbooks. The
        number is the absolute value of the numerical factor: 2/3.
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
            if number.is_negative and power == 1 and self.order.is_reversible(base, node):
                above[index], number = (-base, power), -number
        return bool(number.is_negative), above, below, abs(number)

    def under_one_root(self, product: Any) -> tuple[Any, list[Any]]:
        """Return the numerical factor of a product and a list of its other factors, with one square root of constants.

        SymPy writes the frequency sqrt(2*g/(3*(R - r))) as sqrt(6)*sqrt(g)*sqrt(1/(R - r))/3. The result is then 1, and
        a list with the first form.
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
        """Return the text of the product of `number` and the factors `above`, divided by the factors `below`.

        A factor is a pair (base, exponent). If the notation has `fractions_in_front`, constants are a separate
        fraction, as in (g/l) sin(theta).
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
        """Return the texts of the factors of a product: `number`, unless it is 1, and the powers `pairs`.

        A pair is (base, positive exponent).
        """
        return [*([] if number == 1 else [self.number(number)]), *map(self.power, pairs)]

    def power(self, pair: tuple[Any, Any]) -> FormulaPiece:
        """Return the text of the power `pair`, (base, exponent). The exponent is a positive number or an expression."""
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
        """Return the text of the expression `node`, such as a symbol, a number, a function or a derivative.

        A sum, a product or a power gets the text that `piece` returns.
        """
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
        """Return the text of the function `node` with its arguments, raised to `exponent` unless that is empty.

        A known function of time alone, such as X(t), is written as a letter.
        """
        if isinstance(node, AppliedUndef) and node.args == (t,):
            return FormulaPiece(self.notation.letter(node.func.__name__), simple=True)
        name = NAME_OF_CLASS.get(node.func, node.func.__name__)
        return self.notation.function(name, [self.piece(part) for part in node.args], exponent)

    def derivative(self, node: Any) -> FormulaPiece:
        """Return the text of the derivative `node`: dots over a function of time, primes after any other function."""
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
        """Return the text of `when`, the condition of a value in a piecewise expression; empty if it always holds."""
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
    """Return a factor as a pair (base, exponent). exp(x) and the imaginary unit have the exponent 1."""
    if isinstance(factor, sympy.exp) or factor is sympy.I:
        return factor, sympy.S.One
    base, exponent = factor.as_base_exp()
    if exponent.is_Rational and base.is_Rational and base.p == 1 and base != 1:
        return sympy.Integer(base.q), -exponent
    return base, exponent
