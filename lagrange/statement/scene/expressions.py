"""Reading of expressions from texts. Their size and structure are limited before they reach SymPy."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Any, NoReturn

import sympy

from lagrange.errors import SceneError
from lagrange.statement.coordinate import multiplier, t
from lagrange.statement.scene import lexer
from lagrange.statement.scene.guard import (
    MOST_ARGUMENTS,
    MOST_BRANCHES,
    Guard,
    RefusalError,
    check_arguments,
    check_compared,
    check_power,
    replaced,
)
from lagrange.statement.vocabulary.elementary import ELEMENTARY
from lagrange.statement.vocabulary.words import ALIASES, WORDS, FunctionWord

MOST_CHAINED = 4
"""Most chained comparisons in a row that lead to the same value: SymPy makes 2**n clauses of n of them."""

PREDEFINED_VALUES = {"t": t, "pi": sympy.pi}

_DOUBLES: dict[str, Callable[..., float]] = {
    **{one.name: one.of_float for one in ELEMENTARY.values()},
    "atan2": math.atan2,
    "sqrt": math.sqrt,
    "cot": lambda x: 1 / math.tan(x),
    "sec": lambda x: 1 / math.cos(x),
    "csc": lambda x: 1 / math.sin(x),
    "sinc": lambda x: math.sin(x) / x if x else 1.0,
    "heaviside": lambda x, middle=0.5: 0.5 + math.copysign(0.5, x) if x else middle,
    "abs": abs,
    "sign": lambda x: math.copysign(1.0, x) if x else 0.0,
    "min": lambda *x: min(x),
    "max": lambda *x: max(x),
    "mod": lambda x, y: x % y,
}

COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: sympy.Lt,
    ast.LtE: sympy.Le,
    ast.Gt: sympy.Gt,
    ast.GtE: sympy.Ge,
    ast.Eq: sympy.Eq,
    ast.NotEq: sympy.Ne,
}


def read_expression(text: str, names: Mapping[str, Any]) -> Any:
    """Return the SymPy expression that a text states in the given names, `t` and `pi`.

    `names` maps identifiers to SymPy objects. The text may hold numbers, + - * / **, the functions of
    `lexer.WORDS`, and conditions such as `a if x < 0 else b`. Raises SceneError with the column.
    """
    return Expressions(names).read(text)


class Expressions:
    """Reader of the expressions of one file: its names, its shared definitions, and the checks of all of them.

    `names` maps identifiers to SymPy objects, `calls` has names of functions of coordinates that are not written out.
    """

    def __init__(self, names: Mapping[str, Any], calls: Collection[str] = ()) -> None:
        known = {**names, **PREDEFINED_VALUES}
        # built in real symbols: for q(t), which may be complex to SymPy, its questions on signs take long
        self.names = {name: value if value.is_real else sympy.Dummy(name, real=True) for name, value in known.items()}
        self.calls = calls
        self.guard = Guard()
        self.constants = {"pi": math.pi}
        self._done = {self.names[name]: value for name, value in known.items()}

    def define(self, name: str, text: str) -> None:
        """Enter the name of the expression that a text states, for the texts that follow."""
        value = self.built(text)
        self.names[name] = value.expression
        if value.double is not None:
            self.constants[name] = value.double

    def enter(self, name: str, expression: Any) -> None:
        """Enter the name of an expression that is not stated by a text, such as a table."""
        self.names[name] = sympy.Dummy(name, real=True)
        self._done[self.names[name]] = expression

    def read(self, text: str) -> Any:
        """Return the expression that a text states. Raises SceneError with the column."""
        return replaced(self.built(text).expression, self._done)

    def built(self, text: str) -> ParsedValue:
        """Return the value of a text in the names of this reader, where functions of time are real symbols."""
        lexer.scan(text, self.names, calls=self.calls)
        return Reader(text, self.names, self.guard, self.constants, self.calls).read()


def read_number(text: str) -> float:
    """Return the value of a constant expression such as "pi/6". Raises SceneError with the column."""
    lexer.scan(text, {"pi"}, constant=True)
    return float(Reader(text, {"pi": sympy.pi}, Guard(), {"pi": math.pi}).read().expression.evalf(30))


def number_from_text(text: str) -> Any:
    """Return the SymPy number of a decimal text: a fraction if the decimal equals a short one, else the nearest double.

    0.5 becomes 1/2, so x**0.5 is a square root. 9.81 stays 9.81. Raises RefusalError for a number that has no double.
    """
    if text.isdigit():
        return sympy.Integer(int(text))
    value = float(text)
    if math.isinf(value):
        raise RefusalError(f"{text[:40]} is too large for a floating-point number")
    if value == 0.0 and text.lower().partition("e")[0].strip("0."):
        raise RefusalError(f"{text[:40]} is too small for a floating-point number")
    exact = Fraction(value)
    # the cheap tests first: Fraction(text) writes out as many digits as the exponent of the text says
    if exact.denominator <= 16 and exact.numerator < 10**6 and (value == 0.0 or exact == Fraction(text)):
        return sympy.Rational(exact.numerator, exact.denominator)
    return sympy.Float(value)


@dataclass(frozen=True)
class ParsedValue:
    """Result of a part of the text: an expression, and its value as a double if it is constant, else None."""

    expression: Any
    double: float | None = None


Join = Callable[[list[ParsedValue]], ParsedValue]
Plan = tuple[list[ast.expr], Join]
"""Parts of a node of Python's syntax tree, and the function that joins their values."""


class Reader:
    """Builds the expression of one scanned text, without recursion."""

    def __init__(
        self,
        text: str,
        names: Mapping[str, Any],
        guard: Guard,
        constants: Mapping[str, float],
        calls: Collection[str] = (),
    ) -> None:
        # parentheses let lines break, and shift columns so that ast's count from 0 is ours from 1
        self.source = "(" + text.replace("\t", " ").replace("\r", " ").replace("\n", " ") + ")"
        self.names = names
        self.guard = guard
        self.constants = constants
        self.calls = calls
        self.plans: dict[type[ast.expr], Callable[[Any], Plan]] = {
            ast.Constant: self._constant,
            ast.Name: self._name,
            ast.UnaryOp: self._sign,
            ast.BinOp: self._operation,
            ast.Call: self._call,
            ast.IfExp: self._condition,
            ast.Compare: self._stray_comparison,
        }

    def read(self) -> ParsedValue:
        """Return the expression, and its value as a double if it is constant. Parts are built first."""
        todo: list[tuple[ast.expr, int, Join | None]] = [(self._parse(), 0, None)]
        done: list[ParsedValue] = []
        while todo:
            node, count, join = todo.pop()
            try:
                if join is None:
                    parts, join = self._plan(node)
                    todo.append((node, len(parts), join))
                    todo.extend((part, 0, None) for part in reversed(parts))
                else:
                    split = len(done) - count
                    done[split:] = [self._checked(join(done[split:]))]
            except SceneError:
                raise
            except RefusalError as refusal:
                raise SceneError(f"{refusal}.", column=self._place(node.col_offset)) from None
            except (ValueError, ArithmeticError, TypeError, RecursionError):
                raise SceneError("this part has no finite real value.", column=self._place(node.col_offset)) from None
        return done[0]

    def _parse(self) -> ast.expr:
        try:
            return ast.parse(self.source, mode="eval").body
        except SyntaxError as error:
            raise SceneError(
                f"this is not an expression ({error.msg}).", column=max((error.offset or 2) - 1, 1)
            ) from None
        except (RecursionError, MemoryError):
            raise SceneError(
                "the expression is too long: state it in parts, or group it with parentheses.", column=1
            ) from None

    def _place(self, offset: int) -> int:
        """Return the index of the character at an offset of ast, which counts bytes: a Greek letter has two."""
        return offset if self.source.isascii() else len(self.source.encode()[:offset].decode())

    def _plan(self, node: ast.expr) -> Plan:
        plan = self.plans.get(type(node))
        if plan is None:
            raise RefusalError(f"{type(node).__name__} cannot stand in an expression")
        return plan(node)

    def _checked(self, value: ParsedValue) -> ParsedValue:
        """Return the checked value. If SymPy evaluated it to an exact number, the double is taken from this number."""
        varies = self.guard.check(value.expression)
        if isinstance(value.expression, sympy.Number):
            return ParsedValue(value.expression, float(value.expression))
        if varies:
            return ParsedValue(value.expression)
        if value.double is None:
            raise RefusalError("the names cancel and leave a constant: write the constant")
        if not math.isfinite(value.double):
            raise RefusalError("this has no finite value")
        return value

    def _constant(self, node: ast.Constant) -> Plan:
        if type(node.value) not in (int, float):
            raise RefusalError(f"a {type(node.value).__name__} cannot stand in an expression: write a real number")
        begin, end = self._place(node.col_offset), self._place(node.end_col_offset or 0)
        number = number_from_text(self.source[begin:end])
        return [], lambda _: ParsedValue(number)

    def _name(self, node: ast.Name) -> Plan:
        if node.id not in self.names:
            lexer.unknown_name(node.id, self.names, self._place(node.col_offset) - 1)
        expression = self.names[node.id]
        return [], lambda _: ParsedValue(expression, self.constants.get(node.id))

    def _sign(self, node: ast.UnaryOp) -> Plan:
        if isinstance(node.op, ast.UAdd):
            return [node.operand], lambda parts: parts[0]
        if isinstance(node.op, ast.USub):
            return [node.operand], _negative
        raise RefusalError(f"{type(node.op).__name__} cannot stand in an expression")

    def _operation(self, node: ast.BinOp) -> Plan:
        if isinstance(node.op, (ast.Add, ast.Sub)):
            terms, straight = spine(node, ast.Add, ast.Sub)
            return terms, partial(self._sum, straight)
        if isinstance(node.op, (ast.Mult, ast.Div)):
            factors, straight = spine(node, ast.Mult, ast.Div)
            return factors, partial(self._product, straight)
        if isinstance(node.op, ast.Pow):
            return [node.left, node.right], _power
        raise RefusalError(f"{type(node.op).__name__} cannot stand in an expression")

    def _sum(self, straight: Sequence[bool], parts: list[ParsedValue]) -> ParsedValue:
        terms = [part if plus else _negative([part]) for part, plus in zip(parts, straight, strict=True)]
        return ParsedValue(self.guard.join(sympy.Add, [term.expression for term in terms]), _constant(sum, terms))

    def _product(self, straight: Sequence[bool], parts: list[ParsedValue]) -> ParsedValue:
        factors = [part if times else _reciprocal(part) for part, times in zip(parts, straight, strict=True)]
        return ParsedValue(
            self.guard.join(sympy.Mul, [factor.expression for factor in factors]), _constant(math.prod, factors)
        )

    def _call(self, node: ast.Call) -> Plan:
        if not isinstance(node.func, ast.Name) or node.keywords:
            raise RefusalError("a function is called by its name, with its arguments in order, as in atan2(y, x)")
        if node.func.id in self.calls:
            return self._other_call(node.func.id, node.args)
        word = WORDS.get(ALIASES.get(node.func.id, node.func.id))
        if word is None:
            raise RefusalError(f"{node.func.id!r} is not a function here")
        _check_arity(word, len(node.args))
        return list(node.args), partial(self._apply, word)

    def _other_call(self, name: str, arguments: list[ast.expr]) -> Plan:
        """Plan the call of a multiplier, or of a function of coordinates that is not written out."""
        if name == lexer.MULTIPLIER:
            match arguments:
                case [ast.Name(id=constraint)]:
                    symbol = multiplier(constraint)
                    return [], lambda _: ParsedValue(symbol)
            raise RefusalError("multiplier takes the name of a constraint, as in multiplier(rod)")
        if not arguments:
            raise RefusalError(f"{name} has no arguments: write them, as in {name}(x)")
        return list(arguments), lambda parts: ParsedValue(sympy.Function(name)(*(part.expression for part in parts)))

    def _apply(self, word: FunctionWord, parts: list[ParsedValue]) -> ParsedValue:
        arguments = [part.expression for part in parts]
        double = _double(word, parts)
        check_arguments(word.build, arguments)
        if word.build is sympy.Abs and not arguments[0].is_extended_real:
            # SymPy would make the real part of the root out of abs(exp(sqrt(x)))
            return ParsedValue(sympy.Abs(*arguments, evaluate=False), double)
        return ParsedValue(word.build(*arguments), double)

    def _condition(self, node: ast.IfExp) -> Plan:
        """Plan `a if x < 0 else b if x < 1 else c`: of each branch the compared terms and the value, then the last."""
        tests: list[ast.Compare] = []
        parts: list[ast.expr] = []
        last: ast.expr = node
        while isinstance(last, ast.IfExp):
            if not isinstance(last.test, ast.Compare):
                raise RefusalError("a condition compares two values: write it as in a if x < 0 else b")
            tests.append(last.test)
            parts += [last.test.left, *last.test.comparators, last.body]
            last = last.orelse
        if len(tests) > MOST_BRANCHES:
            raise RefusalError(f"a condition has at most {MOST_BRANCHES} branches")
        return [*parts, last], partial(_branches, [_comparisons(test) for test in tests])

    def _stray_comparison(self, node: ast.Compare) -> NoReturn:
        raise RefusalError("a comparison has no value of its own: write a condition as in a if x < 0 else b")


def spine(
    node: ast.expr,
    forward: type[ast.operator],
    back: type[ast.operator],
    stop: Callable[[ast.expr], Any] = lambda _: None,
) -> tuple[list[ast.expr], list[bool]]:
    """Return the operands of a chain such as a - b + c, and for each True unless it is subtracted or divided by.

    A chain also ends at a node for which `stop` returns a value: that node is its first operand.
    Chains become one n-ary Add or Mul: joining them two by two takes quadratic time.
    """
    operands: list[ast.expr] = []
    straight: list[bool] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, (forward, back)) and stop(node) is None:
        operands.append(node.right)
        straight.append(isinstance(node.op, forward))
        node = node.left
    return [node, *reversed(operands)], [True, *reversed(straight)]


def _constant(compute: Callable[[list[float]], float], parts: list[ParsedValue]) -> float | None:
    doubles = [part.double for part in parts if part.double is not None]
    return compute(doubles) if len(doubles) == len(parts) else None


def _negative(parts: list[ParsedValue]) -> ParsedValue:
    part = parts[0]
    return ParsedValue(-part.expression, None if part.double is None else -part.double)


def _reciprocal(part: ParsedValue) -> ParsedValue:
    if part.double == 0.0:
        raise RefusalError("this divides by zero")
    return ParsedValue(1 / part.expression, None if part.double is None else 1 / part.double)


def _power(parts: list[ParsedValue]) -> ParsedValue:
    base, exponent = parts
    check_power(base.expression, exponent.expression)
    if base.double is None or exponent.double is None:
        return ParsedValue(base.expression**exponent.expression)
    try:
        double = math.pow(base.double, exponent.double)
    except (ValueError, OverflowError):
        raise RefusalError(f"{base.double:g}**{exponent.double:g} has no finite real value") from None
    if double == 0.0 != base.double:
        raise RefusalError(f"{base.double:g}**{exponent.double:g} is too small for a floating-point number")
    return ParsedValue(base.expression**exponent.expression, double)


def _check_arity(word: FunctionWord, count: int) -> None:
    if word.fewest <= count <= (MOST_ARGUMENTS if word.most is None else word.most):
        return
    if word.most is None:
        raise RefusalError(f"{word.name} takes {word.fewest} to {MOST_ARGUMENTS} arguments, not {count}")
    raise RefusalError(f"{word.name} takes {word.most} {'argument' if word.most == 1 else 'arguments'}, not {count}")


def _double(word: FunctionWord, parts: list[ParsedValue]) -> float | None:
    doubles = [part.double for part in parts if part.double is not None]
    if len(doubles) < len(parts):
        return None
    call = f"{word.name}({', '.join(f'{x:g}' for x in doubles)})"
    try:
        double = _DOUBLES[word.name](*doubles)
    except (ValueError, OverflowError):
        raise RefusalError(f"{call} has no finite real value") from None
    if word.name == "exp" and double == 0.0:
        raise RefusalError(f"{call} is too small for a floating-point number")
    return double


def _comparisons(test: ast.Compare) -> list[Callable[[Any, Any], Any]]:
    comparisons = [COMPARISONS.get(type(op)) for op in test.ops]
    known = [comparison for comparison in comparisons if comparison is not None]
    if len(known) < len(comparisons):
        raise RefusalError("values compare with < <= > >= == != only")
    return known


def _branches(tests: list[list[Callable[[Any, Any], Any]]], parts: list[ParsedValue]) -> ParsedValue:
    """Join the parts of a condition, laid out by `_Reader._condition`, into a Piecewise."""
    pairs: list[tuple[Any, Any]] = []
    values: list[ParsedValue] = []
    start = chained = 0
    for comparisons in tests:
        terms = [part.expression for part in parts[start : start + len(comparisons) + 1]]
        if any(term.has(sympy.Piecewise) for term in terms):
            raise RefusalError("a condition cannot compare a value that has conditions itself")
        check_compared(terms, "the compared values")
        relations = [compare(a, b) for compare, (a, b) in zip(comparisons, pairwise(terms), strict=True)]
        value = parts[start + len(terms)]
        chained = (chained if values and value.expression == values[-1].expression else 0) + (len(terms) > 2)
        if chained > MOST_CHAINED:
            raise RefusalError(f"more than {MOST_CHAINED} chained comparisons in a row lead to the same value")
        values.append(value)
        pairs.append((value.expression, sympy.And(*relations)))
        start += len(terms) + 1
    last = parts[-1]
    expression = sympy.Piecewise(*pairs, (last.expression, True))
    chosen = [value.double for value in [*values, last] if value.expression == expression]
    return ParsedValue(expression, chosen[0] if chosen else None)
