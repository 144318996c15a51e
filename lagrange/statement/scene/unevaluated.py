"""Read the unevaluated expressions of scene files that programs write: SymPy objects exactly as the text states them.

The expressions are not expanded and not sorted, so that a system is read back symbol for symbol. Besides, SymPy might
take too long to evaluate an expression from an untrusted file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import sympy
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And

from lagrange.statement.scene.expressions import (
    COMPARISONS,
    CONDITIONS,
    MULTIPLIER,
    NO_VALUE,
    PREDEFINED_VALUES,
    Branch,
    Expressions,
    ParsedValue,
    Reader,
    check_arity,
    condition_of,
    term_of,
)
from lagrange.statement.scene.guard import Guard, RefusalError, check_arguments, check_power, refuse
from lagrange.statement.vocabulary.functions import SYMPY_CLASSES, FunctionWord

SUM, PRODUCT, FLOAT = "sum", "product", "float"
"""Functions that only unevaluated texts may call: a nested sum, a nested product and a number in binary."""

MOST_EXPONENT, MOST_PRECISION = 2000, 1000
"""Largest exponent of two, and largest number of bits, of a number in the notation float(mantissa, exponent, bits)."""


class UnevaluatedGuard(Guard):
    """Check of unevaluated expressions, which SymPy evaluates later, when symbols or functions in them are replaced.

    It refuses powers of constants that are computed from several numbers, such as (9**9)**9. It also refuses functions
    that SymPy would take too long to evaluate after the replacement. `replaced` are these symbols and functions.
    `branched` has the checked subexpressions that contain a Piecewise.
    """

    def __init__(self, replaced: Iterable[Any]) -> None:
        super().__init__()
        self.branched: set[Any] = set()
        self._replaced = set(replaced)
        self._computed: set[Any] = set()

    def enter(self, node: Any) -> None:
        """Record three properties of a checked subexpression, on which later checks depend.

        The properties are: it contains a Piecewise, it contains a symbol or function that is replaced before SymPy
        evaluates the expression, and it is a constant computed from several numbers. Raises RefusalError for a
        subexpression that SymPy would later take too long to evaluate.
        """
        if isinstance(node, sympy.Piecewise) or any(part in self.branched for part in node.args):
            self.branched.add(node)
        if any(part in self._replaced for part in node.args):
            self._replaced.add(node)
            if type(node) in SYMPY_CLASSES and not isinstance(node, sympy.Piecewise):
                check_arguments(type(node), list(node.args))
        if self.varies[node]:
            return
        computed = any(part in self._computed for part in node.args)
        if isinstance(node, sympy.Pow) and computed and node.exp != -1:
            raise RefusalError("a power of a constant that is computed from several numbers: write the constant")
        numbers = sum(isinstance(part, sympy.Number) for part in node.args)
        joined = numbers > 1 and isinstance(node, (sympy.Add, sympy.Mul))
        if computed or joined or (numbers == 2 and isinstance(node, sympy.Pow) and node.exp.is_Integer):
            self._computed.add(node)


class UnevaluatedExpressions(Expressions):
    """Reader of the unevaluated expressions of one file.

    `names` maps identifiers to SymPy objects. `replaced` are the objects among them that other expressions replace
    before SymPy evaluates, such as given functions. `calls` names functions of coordinates without a formula.
    """

    def __init__(self, names: Mapping[str, Any], replaced: Iterable[Any] = (), calls: Collection[str] = ()) -> None:
        self.names = {**names, **PREDEFINED_VALUES}
        self.calls = frozenset((MULTIPLIER, SUM, PRODUCT, FLOAT, *calls))
        self.guard = UnevaluatedGuard(replaced)
        self.constants = {}

    def enter(self, name: str, expression: Any) -> None:
        """Define a name for an expression that is not given as text, such as a table."""
        self.names[name] = expression

    def read(self, text: str) -> Any:
        """Return the expression in a text. Raises SceneError with the column."""
        expression = self.built(text).expression
        if not isinstance(expression, sympy.Expr):
            refuse(f"{NO_VALUE}.", 0)
        return expression

    def built(self, text: str) -> ParsedValue:
        """Return the parsed value of a text, which may be a condition."""
        return UnevaluatedReader(text, self.names, self.guard, self.constants, self.calls).read()


class UnevaluatedReader(Reader):
    """Parser of one text as an unevaluated expression.

    `a/b` of whole numbers is a fraction, `1/x` a power, and `x - 2*y` has the term `-2*y`.
    """

    unevaluated = True
    guard: UnevaluatedGuard

    def atom(self) -> ParsedValue:
        """Read a number, a name, a call, an expression in parentheses, True or False."""
        if self.at("True", "False", kind="word"):
            return ParsedValue(sympy.true if self.take().text == "True" else sympy.false)
        return super().atom()

    def _checked(self, value: ParsedValue) -> ParsedValue:
        self.guard.check(value.expression)
        return value

    def _number(self, text: str) -> ParsedValue:
        if text.isdigit():
            return ParsedValue(sympy.Integer(int(text)), literal=True)
        return ParsedValue(sympy.Float(float(text)))

    def _summed(self, straight: Sequence[bool], parts: Sequence[ParsedValue]) -> ParsedValue:
        terms = map(term_of, parts)
        signed = (term if plus else _negated(term) for term, plus in zip(terms, straight, strict=True))
        return ParsedValue(sympy.Add(*signed, evaluate=False))

    def _multiplied(self, negative: bool, straight: Sequence[bool], parts: Sequence[ParsedValue]) -> ParsedValue:
        first, *terms = map(term_of, parts)
        divisors = [not times for times in straight[1:]]
        if divisors and divisors[0] and parts[0].literal and parts[1].literal and terms[0]:
            first, terms, divisors = sympy.Rational(first, terms[0]), terms[1:], divisors[1:]
        elif divisors == [True] and first == 1 and parts[0].literal and not negative:
            return ParsedValue(_power(terms[0], sympy.S.NegativeOne))
        factors = [_power(x, sympy.S.NegativeOne) if below else x for x, below in zip(terms, divisors, strict=True)]
        product = sympy.Mul(first, *factors, evaluate=False) if factors else first
        return ParsedValue(_negated(product) if negative else product)

    def _raised(self, base: ParsedValue, exponent: ParsedValue) -> ParsedValue:
        return ParsedValue(_power(term_of(base), term_of(exponent)))

    def _applied(self, word: FunctionWord, parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return the function `word` of the parsed arguments `parts`, unevaluated. exp(1) is the constant E."""
        check_arity(word, len(parts))
        arguments = list(map(term_of, parts))
        if word.build is sympy.exp and parts[0].literal and arguments == [1]:
            return ParsedValue(sympy.E)
        options = {"evaluate": False} if word.build in SYMPY_CLASSES or word.build is sympy.sqrt else {}
        return ParsedValue(word.build(*arguments, **options))

    def _other_call(self, name: str, parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return the value of a call: a binary number, a nested sum or product, or a function without a formula."""
        arguments = list(map(term_of, parts))
        if name == FLOAT:
            return ParsedValue(_binary_number(arguments))
        if name in (SUM, PRODUCT):
            build = sympy.Add if name == SUM else sympy.Mul
            return ParsedValue(build(*arguments, evaluate=False))
        return ParsedValue(sympy.Function(name)(*arguments))

    def _branches(self, branches: Sequence[Branch], last: ParsedValue | None) -> ParsedValue:
        """Return a Piecewise of `branches`, which are pairs of value and condition, and of `last`, the value otherwise.

        If the values are conditions themselves, the result is an ITE.
        """
        conditions = [condition_of(condition) for _, condition in branches]
        if any(condition in self.guard.branched for condition in conditions):  # SymPy would rewrite it
            raise RefusalError("a condition cannot compare a value that has conditions itself")
        first = branches[0][0].expression
        if isinstance(first, CONDITIONS):
            if last is None or len(branches) > 1:
                raise RefusalError("a condition that depends on another has the form a if b else c")
            return ParsedValue(ITE(conditions[0], first, condition_of(last), evaluate=False))
        values = [term_of(value) for value, _ in branches]
        pairs = [ExprCondPair(value, condition) for value, condition in zip(values, conditions, strict=True)]
        pairs += [] if last is None else [ExprCondPair(term_of(last), sympy.true)]
        return ParsedValue(sympy.Piecewise(*pairs, evaluate=False))

    def _condition(self, build: Any, parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return And, Or or Not (`build`) of the conditions `parts`, unevaluated."""
        return ParsedValue(build(*map(condition_of, parts), evaluate=False))

    def _compared(self, signs: Sequence[str], parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return the comparison of parts by `signs`, such as "<". A chain 0 < x < 1 becomes And(0 < x, x < 1)."""
        pairs = zip(signs, pairwise(map(term_of, parts)), strict=True)
        relations = [COMPARISONS[sign](left, right, evaluate=False) for sign, (left, right) in pairs]
        return ParsedValue(relations[0] if len(relations) == 1 else And(*relations, evaluate=False))


def _negated(term: Any) -> Any:
    """Return minus a term. If the term begins with a number, the sign of that number changes."""
    if isinstance(term, sympy.Number):
        return -term
    if isinstance(term, sympy.Mul):
        first, *rest = term.args
        if isinstance(first, sympy.Number):
            return sympy.Mul(-first, *rest, evaluate=False)
        return sympy.Mul(sympy.S.NegativeOne, *term.args, evaluate=False)
    return sympy.Mul(sympy.S.NegativeOne, term, evaluate=False)


def _power(base: Any, exponent: Any) -> Any:
    check_power(base, exponent)
    if base == 0 and exponent.is_negative:
        raise RefusalError("a denominator is zero")
    return sympy.Pow(base, exponent, evaluate=False)


def _binary_number(numbers: Sequence[Any]) -> Any:
    """Return mantissa * 2**exponent as a SymPy number. `numbers` are mantissa, exponent and precision in bits."""
    if len(numbers) != 3 or not all(isinstance(number, sympy.Integer) for number in numbers):
        raise RefusalError("float takes three whole numbers: mantissa, exponent of two, and bits")
    mantissa, exponent, precision = map(int, numbers)
    if not (abs(exponent) <= MOST_EXPONENT and 0 < precision <= MOST_PRECISION):
        raise RefusalError(
            f"a number with the exponent {exponent} and {precision} bits is out of bounds: the exponent is at most "
            f"{MOST_EXPONENT} in size, and the bits are 1 to {MOST_PRECISION}"
        )
    return sympy.Float(sympy.Integer(mantissa) * sympy.Integer(2) ** exponent, precision=precision)
