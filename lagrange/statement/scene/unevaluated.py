"""Reading of unevaluated expressions: SymPy objects exactly as a text states them, nothing expanded or sorted.

Files that programs write contain such texts, so that a system is read back symbol for symbol. Evaluation by SymPy
might also take too long for the expressions of a stranger.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import sympy
from sympy.core.relational import Relational
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import ITE, And, BooleanAtom, BooleanFunction, Not, Or

from lagrange.statement.scene import lexer
from lagrange.statement.scene.expressions import COMPARISONS, PREDEFINED_VALUES, ParsedValue, Plan, Reader, spine
from lagrange.statement.scene.guard import Guard, RefusalError, check_arguments, check_power
from lagrange.statement.vocabulary.words import SYMPY_CLASSES, FunctionWord

MOST_EXPONENT, MOST_PRECISION = 2000, 1000
"""Limits on the exponent of two, and on the bits, of a number in the notation float(mantissa, exponent, bits)."""

_CONDITIONS = (Relational, BooleanFunction, BooleanAtom)


class UnevaluatedGuard(Guard):
    """A guard of expressions that SymPy evaluates later, where their `replaced` leaves are replaced by others.

    It refuses powers of constants that are computed from several numbers, such as (9**9)**9, and functions of replaced
    leaves that SymPy would take too long to evaluate. `branched` are the parts that contain a Piecewise.
    """

    def __init__(self, replaced: Iterable[Any]) -> None:
        super().__init__()
        self.branched: set[Any] = set()
        self._replaced = set(replaced)
        self._computed: set[Any] = set()

    def enter(self, node: Any) -> None:
        """Note a constant that is computed from several numbers. Raises RefusalError for a node that takes too long."""
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


class UnevaluatedExpressions:
    """Reader of the unevaluated expressions of one file; `replaced` are the leaves that `UnevaluatedGuard` watches."""

    def __init__(self, names: Mapping[str, Any], replaced: Iterable[Any] = (), calls: Collection[str] = ()) -> None:
        self.names = {**names, **PREDEFINED_VALUES}
        self.calls = lexer.UNEVALUATED_CALLS.union(calls)
        self.guard = UnevaluatedGuard(replaced)

    def define(self, name: str, text: str) -> None:
        """Enter the name of the expression or condition that a text states, for the texts that follow."""
        self.names[name] = self.built(text).expression

    def enter(self, name: str, expression: Any) -> None:
        """Enter the name of an expression that is not stated by a text, such as a table."""
        self.names[name] = expression

    def read(self, text: str) -> Any:
        """Return the expression that a text states. Raises SceneError with the column."""
        expression = self.built(text).expression
        if not isinstance(expression, sympy.Expr):
            lexer.refuse("this is a condition, which has no value: write a if condition else b.", 0)
        return expression

    def built(self, text: str) -> ParsedValue:
        """Return the value of a text."""
        lexer.scan(text, self.names, calls=self.calls, unevaluated=True)
        return UnevaluatedReader(text, self.names, self.guard, {}, self.calls).read()


class UnevaluatedReader(Reader):
    """Builds one expression. `a/b` of whole numbers is a fraction, `1/x` a power, and `x - 2*y` has the term `-2*y`."""

    def __init__(
        self,
        text: str,
        names: Mapping[str, Any],
        guard: UnevaluatedGuard,
        constants: Mapping[str, float],
        calls: Collection[str] = (),
    ) -> None:
        super().__init__(text, names, guard, constants, calls)
        self.branched = guard.branched
        self.plans |= {ast.BoolOp: self._logic, ast.Compare: self._comparison}

    def _checked(self, value: ParsedValue) -> ParsedValue:
        self.guard.check(value.expression)
        return value

    def _constant(self, node: ast.Constant) -> Plan:
        if isinstance(node.value, bool):
            truth = sympy.true if node.value else sympy.false
            return [], lambda _: ParsedValue(truth)
        if type(node.value) not in (int, float):
            raise RefusalError("write a real number here")
        number = sympy.Integer(node.value) if isinstance(node.value, int) else sympy.Float(node.value)
        return [], lambda _: ParsedValue(number)

    def _sign(self, node: ast.UnaryOp) -> Plan:
        if isinstance(node.op, ast.Not):
            return [node.operand], lambda parts: ParsedValue(Not(_condition_of(parts[0]), evaluate=False))
        if isinstance(node.op, ast.USub):
            return [node.operand], lambda parts: ParsedValue(_negated(_term_of(parts[0])))
        return super()._sign(node)

    def _operation(self, node: ast.BinOp) -> Plan:
        if isinstance(node.op, (ast.Add, ast.Sub)):
            terms, straight = spine(node, ast.Add, ast.Sub)
            return terms, partial(_sum, straight)
        if isinstance(node.op, ast.Pow):
            return [node.left, node.right], lambda parts: ParsedValue(_power(*map(_term_of, parts)))
        if not isinstance(node.op, (ast.Mult, ast.Div)):
            return super()._operation(node)
        if ratio := _ratio(node):
            return [], lambda _: ParsedValue(ratio)
        if isinstance(node.op, ast.Div) and isinstance(node.left, ast.Constant) and node.left.value == 1:
            return [node.right], lambda parts: ParsedValue(_power(_term_of(parts[0]), sympy.S.NegativeOne))
        factors, straight = spine(node, ast.Mult, ast.Div, stop=_ratio)
        negative = isinstance(factors[0], ast.UnaryOp) and isinstance(factors[0].op, ast.USub)
        if isinstance(factors[0], ast.UnaryOp):
            factors[0] = factors[0].operand
        return factors, partial(_product, straight, negative)

    def _call(self, node: ast.Call) -> Plan:
        match node:
            case ast.Call(func=ast.Name(id="exp"), args=[ast.Constant(value=1)], keywords=[]):
                return [], lambda _: ParsedValue(sympy.E)
        return super()._call(node)

    def _other_call(self, name: str, arguments: list[ast.expr]) -> Plan:
        if name == lexer.FLOAT:
            number = _binary_number(arguments)
            return [], lambda _: ParsedValue(number)
        if name in (lexer.SUM, lexer.PRODUCT):
            build = sympy.Add if name == lexer.SUM else sympy.Mul
            return list(arguments), lambda parts: ParsedValue(build(*map(_term_of, parts), evaluate=False))
        return super()._other_call(name, arguments)

    def _apply(self, word: FunctionWord, parts: list[ParsedValue]) -> ParsedValue:
        arguments = [_term_of(part) for part in parts]
        options = {"evaluate": False} if word.build in SYMPY_CLASSES or word.build is sympy.sqrt else {}
        return ParsedValue(word.build(*arguments, **options))

    def _condition(self, node: ast.IfExp) -> Plan:
        """Plan `a if x < 0 else b`: value and condition of each branch, then the last value, which None leaves out."""
        parts: list[ast.expr] = []
        last: ast.expr = node
        while isinstance(last, ast.IfExp):
            parts += [last.body, last.test]
            last = last.orelse
        if not (isinstance(last, ast.Constant) and last.value is None):
            parts.append(last)
        return parts, self._branches

    def _branches(self, parts: list[ParsedValue]) -> ParsedValue:
        """Join values and conditions, laid out by `_condition`, into a Piecewise, or into ITE for values of logic."""
        count = len(parts) // 2
        conditions = [_condition_of(part) for part in parts[1 : 2 * count : 2]]
        if any(condition in self.branched for condition in conditions):  # SymPy would rewrite it
            raise RefusalError("a condition cannot compare a value that has conditions itself")
        if isinstance(parts[0].expression, _CONDITIONS):
            if len(parts) != 3:
                raise RefusalError("a condition that depends on another has the form a if b else c")
            return ParsedValue(ITE(conditions[0], parts[0].expression, _condition_of(parts[2]), evaluate=False))
        values = [_term_of(part) for part in parts[: 2 * count : 2]]
        pairs = [ExprCondPair(value, condition) for value, condition in zip(values, conditions, strict=True)]
        if len(parts) % 2:
            pairs.append(ExprCondPair(_term_of(parts[-1]), sympy.true))
        return ParsedValue(sympy.Piecewise(*pairs, evaluate=False))

    def _logic(self, node: ast.BoolOp) -> Plan:
        build = And if isinstance(node.op, ast.And) else Or
        return list(node.values), lambda parts: ParsedValue(build(*map(_condition_of, parts), evaluate=False))

    def _comparison(self, node: ast.Compare) -> Plan:
        """Plan a comparison, or a chain such as 0 < x < 1, which is the conjunction of its relations."""
        comparisons: list[Any] = [COMPARISONS.get(type(op)) for op in node.ops]

        def join(parts: list[ParsedValue]) -> ParsedValue:
            relations = []
            for compare, (left, right) in zip(comparisons, pairwise(map(_term_of, parts)), strict=True):
                if compare is None:
                    raise RefusalError("values compare with < <= > >= == != only")
                relations.append(compare(left, right, evaluate=False))
            return ParsedValue(relations[0] if len(relations) == 1 else And(*relations, evaluate=False))

        return [node.left, *node.comparators], join


def _term_of(value: ParsedValue) -> Any:
    if not isinstance(value.expression, sympy.Expr):
        raise RefusalError("a condition cannot stand where a number is expected: write a if condition else b")
    return value.expression


def _condition_of(value: ParsedValue) -> Any:
    if not isinstance(value.expression, _CONDITIONS):
        raise RefusalError("a condition compares two values: write it as in a if x < 0 else b")
    return value.expression


def _ratio(node: ast.expr) -> Any:
    """Return the fraction that a node such as 1/2 or -3/4 states, None for any other node."""
    match node:
        case ast.BinOp(op=ast.Div(), left=ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(above)))):
            above = -above
        case ast.BinOp(op=ast.Div(), left=ast.Constant(value=int(above))):
            pass
        case _:
            return None
    match node.right:
        case ast.Constant(value=int(below)) if below:
            return sympy.Rational(above, below)
    return None


def _negated(term: Any) -> Any:
    """Return minus a term: with the other sign of the number, or of the number at the head of a product."""
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
        raise RefusalError("this divides by zero")
    return sympy.Pow(base, exponent, evaluate=False)


def _sum(straight: Sequence[bool], parts: list[ParsedValue]) -> ParsedValue:
    terms = [_term_of(part) if plus else _negated(_term_of(part)) for part, plus in zip(parts, straight, strict=True)]
    return ParsedValue(sympy.Add(*terms, evaluate=False))


def _product(straight: Sequence[bool], negative: bool, parts: list[ParsedValue]) -> ParsedValue:
    terms = map(_term_of, parts)
    factors = [x if times else _power(x, sympy.S.NegativeOne) for x, times in zip(terms, straight, strict=True)]
    product = sympy.Mul(*factors, evaluate=False)
    return ParsedValue(_negated(product) if negative else product)


def _binary_number(arguments: list[ast.expr]) -> Any:
    """Return the number mantissa * 2**exponent of that many bits."""
    numbers: list[int] = []
    for argument in arguments:
        match argument:
            case ast.Constant(value=int(number)):
                numbers.append(number)
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(number))):
                numbers.append(-number)
    if len(numbers) != 3 or len(arguments) != 3:
        raise RefusalError("float takes three whole numbers: mantissa, exponent of two, and bits")
    mantissa, exponent, precision = numbers
    if not (abs(exponent) <= MOST_EXPONENT and 0 < precision <= MOST_PRECISION):
        raise RefusalError(f"a number with the exponent {exponent} and {precision} bits is out of bounds")
    return sympy.Float(sympy.Integer(mantissa) * sympy.Integer(2) ** exponent, precision=precision)
