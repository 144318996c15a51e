"""Reading of expressions from texts. Their size and structure are limited before they reach SymPy."""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cmp_to_key, partial
from itertools import pairwise
from typing import Any, NoReturn

import sympy
import sympy.assumptions.wrapper
import sympy.sets.setexpr
import sympy.tensor.tensor
from sympy.functions.elementary.piecewise import ExprCondPair

from lagrange.errors import SceneError
from lagrange.statement import lexer
from lagrange.statement.coordinate import t
from lagrange.statement.lexer import ALIASES, WORDS, Word

LARGEST_EXPONENT = 1000
MOST_BITS = 256
"""Most bits of an exact numerator or denominator: 77 digits."""
MOST_BRANCHES = 32
"""Most branches of a condition."""
MOST_ARGUMENTS = 16
"""Most arguments of min and max: SymPy compares them pair by pair."""
MOST_DOUBTFUL = 5
"""Most parts that may be complex in an expression that SymPy splits into real and imaginary part. Each can double the
work."""
MOST_COMPARED = 200
"""Most parts of the expressions in a comparison, an absolute value, a minimum or a maximum."""
CHUNK = 50
"""Number of terms that SymPy adds at once. The exact coefficients are checked after each chunk."""

_COMPARING = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.sinc, sympy.erf)
_SPLITTING = (sympy.Abs, sympy.sinh, sympy.cosh, sympy.tanh)
_NUMBER_FIRST = (sympy.Add, sympy.Mul)


class RefusalError(Exception):
    """Reason why an expression is refused. The reader adds the column."""


class Guard:
    """Checks every expression that is built while a text is read. Each distinct one is checked once."""

    def __init__(self) -> None:
        self.varies: dict[Any, bool] = {}

    def check(self, expression: Any) -> bool:
        """Check the expression and its parts, and return whether it depends on any name."""
        for node in parts_first(expression, self.varies):
            if not isinstance(node, sympy.Symbol):
                _check_node(node)
            self.varies[node] = isinstance(node, sympy.Symbol) or any(self.varies[part] for part in node.args)
        return self.varies[expression]

    def join(self, build: Callable[..., Any], parts: list[Any]) -> Any:
        """Return `build(*parts)` for sympy.Add or sympy.Mul, in chunks of which each is checked."""
        while len(parts) > CHUNK:
            parts = [build(*parts[i : i + CHUNK]) for i in range(0, len(parts), CHUNK)]
            for part in parts:
                self.check(part)
        return build(*parts)


def parts_first(expression: Any, known: Mapping[Any, Any]) -> Iterator[Any]:
    """Yield the distinct subexpressions that are not known yet, each after its own parts.

    The caller enters each one in `known` before it takes the next.
    """
    todo = [expression]
    while todo:
        node = todo[-1]
        fresh = [part for part in node.args if part not in known]
        if fresh:
            todo.extend(fresh)
            continue
        todo.pop()
        if node not in known:
            yield node


def replace(expression: Any, table: Mapping[Any, Any]) -> Any:
    """Return the expression with symbols replaced, in SymPy's order of terms, and nothing else evaluated.

    SymPy assumes that x(t) may be complex: evaluation with it would rewrite roots and absolute values.
    """
    done: dict[Any, Any] = dict(table)
    for node in parts_first(expression, done):
        args = [done[part] for part in node.args]
        done[node] = node if all(new is old for new, old in zip(args, node.args, strict=True)) else _rebuilt(node, args)
    return done[expression]


def _rebuilt(node: Any, args: list[Any]) -> Any:
    if isinstance(node, ExprCondPair):
        return node.func(*args)
    if isinstance(node, _NUMBER_FIRST):
        numbers = [arg for arg in args if isinstance(arg, sympy.Number)]
        others = [arg for arg in args if not isinstance(arg, sympy.Number)]
        args = numbers + sorted(others, key=cmp_to_key(sympy.Basic.compare))
    return node.func(*args, evaluate=False)


def check_power(base: Any, exponent: Any) -> None:
    """Raise RefusalError for a power whose exact value SymPy would take too long to compute."""
    _check_exponent(exponent)
    if isinstance(base, sympy.Rational) and isinstance(exponent, sympy.Number):
        bits = max(abs(base.p).bit_length(), base.q.bit_length())
        if bits > 1 and bits * abs(exponent) > 2 * MOST_BITS:
            raise RefusalError(
                f"{float(base):g}**{float(exponent):g} is too long for an exact number: write a decimal, such as "
                "1.5e100"
            )


def check_arguments(build: Any, arguments: list[Any]) -> None:
    """Raise RefusalError for arguments of a function that SymPy would take too long to evaluate or to analyse."""
    if build is sympy.exp and arguments[0].has(sympy.log):
        _check_exponent(arguments[0])  # exp(n*log(x)) becomes the power x**n
    if build in _COMPARING:
        check_compared(
            arguments, f"the {'argument' if len(arguments) == 1 else 'arguments'} of {build.__name__.lower()}"
        )
    if build in _SPLITTING and _doubtful(arguments[0]) > MOST_DOUBTFUL:
        raise RefusalError(
            f"the argument of {build.__name__.lower()} has more than {MOST_DOUBTFUL} parts that may be complex, "
            "such as roots and logarithms: write it with fewer"
        )


def check_compared(expressions: list[Any], what: str) -> None:
    """Raise RefusalError for long expressions to be compared: SymPy finds the sign over a common denominator."""
    size: dict[Any, int] = {}
    for expression in expressions:
        for node in parts_first(expression, size):
            size[node] = 1 + sum(size[part] for part in node.args)
    if sum(size[expression] for expression in expressions) > MOST_COMPARED:
        raise RefusalError(f"there are more than {MOST_COMPARED} parts in {what}: write something shorter")


def _doubtful(argument: Any) -> int:
    """Return the number of parts that may be complex to SymPy."""
    doubt: dict[Any, bool] = {}
    for node in parts_first(argument, doubt):
        doubt[node] = isinstance(node, sympy.Expr) and not node.is_extended_real
    return sum(doubt.values())


def _check_exponent(exponent: Any) -> None:
    for number in exponent.atoms(sympy.Number):
        if abs(number) > LARGEST_EXPONENT:
            raise RefusalError(f"the exponent {float(number):g} is out of bounds: at most {LARGEST_EXPONENT} in size")


def _check_node(node: Any) -> None:
    if isinstance(node, sympy.Rational):
        if max(abs(node.p).bit_length(), node.q.bit_length()) > MOST_BITS:
            raise RefusalError("an exact number here is longer than 77 digits: write a decimal, such as 1.5e100")
    elif isinstance(node, sympy.Float):
        _check_float(node)
    elif node in (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo):
        raise RefusalError("this has no finite value: check for a division by zero")
    elif node is sympy.I:
        raise RefusalError("this is not real: energies and forces are real")
    elif isinstance(node, sympy.Pow):
        _check_exponent(node.exp)
    elif isinstance(node, (sympy.Min, sympy.Max)) and len(node.args) > MOST_ARGUMENTS:
        raise RefusalError(f"min and max take at most {MOST_ARGUMENTS} arguments")


def _check_float(number: Any) -> None:
    if abs(number) > sys.float_info.max:
        raise RefusalError("a number here is too large for a floating-point number")
    if number != 0 and float(number) == 0.0:
        raise RefusalError("a number here is too small for a floating-point number")


MOST_CHAINED = 4
"""Most chained comparisons in a row that lead to the same value: SymPy makes 2**n clauses of n of them."""

_PREDEFINED = {"t": t, "pi": sympy.pi}

_DOUBLES: dict[str, Callable[..., float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "atan2": math.atan2,
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "sinh": math.sinh,
    "cosh": math.cosh,
    "tanh": math.tanh,
    "cot": lambda x: 1 / math.tan(x),
    "sec": lambda x: 1 / math.cos(x),
    "csc": lambda x: 1 / math.sin(x),
    "sinc": lambda x: math.sin(x) / x if x else 1.0,
    "asinh": math.asinh,
    "acosh": math.acosh,
    "atanh": math.atanh,
    "erf": math.erf,
    "heaviside": lambda x: 0.5 + math.copysign(0.5, x) if x else 0.5,
    "abs": abs,
    "sign": lambda x: math.copysign(1.0, x) if x else 0.0,
    "min": lambda *x: min(x),
    "max": lambda *x: max(x),
    "mod": lambda x, y: x % y,
}

_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
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
    known = {**names, **_PREDEFINED}
    lexer.scan(text, known)
    # built in real symbols: for q(t), which may be complex to SymPy, its questions on signs take long
    real = {name: value if value.is_real else sympy.Dummy(name, real=True) for name, value in known.items()}
    return replace(_Reader(text, real).read(), {real[name]: value for name, value in known.items()})


def read_number(text: str) -> float:
    """Return the value of a constant expression such as "pi/6". Raises SceneError with the column."""
    lexer.scan(text, {"pi"}, constant=True)
    return float(_Reader(text, {"pi": sympy.pi}).read().evalf(30))


def number_from_text(text: str) -> Any:
    """Return a decimal as a SymPy number: an exact fraction where that is short, else the nearest double.

    So 0.5 is printed as 1/2, and x**0.5 is a square root, while 9.81 stays 9.81.
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
class _Value:
    """Result of a part of the text: an expression, and its value as a double if it is constant, else None."""

    expression: Any
    double: float | None = None


_Join = Callable[[list[_Value]], _Value]
_Plan = tuple[list[ast.expr], _Join]


class _Reader:
    """Builds the expression of one scanned text, without recursion."""

    def __init__(self, text: str, names: Mapping[str, Any]) -> None:
        # parentheses let lines break, and shift columns so that ast's count from 0 is ours from 1
        self.source = "(" + text.replace("\t", " ").replace("\r", " ").replace("\n", " ") + ")"
        self.names = names
        self.guard = Guard()
        self.plans: dict[type[ast.expr], Callable[[Any], _Plan]] = {
            ast.Constant: self._constant,
            ast.Name: self._name,
            ast.UnaryOp: self._sign,
            ast.BinOp: self._operation,
            ast.Call: self._call,
            ast.IfExp: self._condition,
            ast.Compare: self._stray_comparison,
        }

    def read(self) -> Any:
        """Return the expression. The parts of each node are built before they are joined."""
        todo: list[tuple[ast.expr, int, _Join | None]] = [(self._parse(), 0, None)]
        done: list[_Value] = []
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
        return done[0].expression

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

    def _plan(self, node: ast.expr) -> _Plan:
        plan = self.plans.get(type(node))
        if plan is None:
            raise RefusalError(f"{type(node).__name__} cannot stand in an expression")
        return plan(node)

    def _checked(self, value: _Value) -> _Value:
        """Return the checked value. If SymPy evaluated it to an exact number, the double is taken from this number."""
        varies = self.guard.check(value.expression)
        if isinstance(value.expression, sympy.Number):
            return _Value(value.expression, float(value.expression))
        if varies:
            return _Value(value.expression)
        if value.double is None:
            raise RefusalError("the names cancel and leave a constant: write the constant")
        if not math.isfinite(value.double):
            raise RefusalError("this has no finite value")
        return value

    def _constant(self, node: ast.Constant) -> _Plan:
        if type(node.value) not in (int, float):
            raise RefusalError(f"a {type(node.value).__name__} cannot stand in an expression: write a real number")
        begin, end = self._place(node.col_offset), self._place(node.end_col_offset or 0)
        number = number_from_text(self.source[begin:end])
        return [], lambda _: _Value(number)

    def _name(self, node: ast.Name) -> _Plan:
        if node.id not in self.names:
            lexer.unknown_name(node.id, self.names, self._place(node.col_offset) - 1)
        expression = self.names[node.id]
        return [], lambda _: _Value(expression, math.pi if expression is sympy.pi else None)

    def _sign(self, node: ast.UnaryOp) -> _Plan:
        if isinstance(node.op, ast.UAdd):
            return [node.operand], lambda parts: parts[0]
        if isinstance(node.op, ast.USub):
            return [node.operand], _negative
        raise RefusalError(f"{type(node.op).__name__} cannot stand in an expression")

    def _operation(self, node: ast.BinOp) -> _Plan:
        if isinstance(node.op, (ast.Add, ast.Sub)):
            terms, straight = _spine(node, ast.Add, ast.Sub)
            return terms, partial(self._sum, straight)
        if isinstance(node.op, (ast.Mult, ast.Div)):
            factors, straight = _spine(node, ast.Mult, ast.Div)
            return factors, partial(self._product, straight)
        if isinstance(node.op, ast.Pow):
            return [node.left, node.right], _power
        raise RefusalError(f"{type(node.op).__name__} cannot stand in an expression")

    def _sum(self, straight: Sequence[bool], parts: list[_Value]) -> _Value:
        terms = [part if plus else _negative([part]) for part, plus in zip(parts, straight, strict=True)]
        return _Value(self.guard.join(sympy.Add, [term.expression for term in terms]), _constant(sum, terms))

    def _product(self, straight: Sequence[bool], parts: list[_Value]) -> _Value:
        factors = [part if times else _reciprocal(part) for part, times in zip(parts, straight, strict=True)]
        return _Value(
            self.guard.join(sympy.Mul, [factor.expression for factor in factors]), _constant(math.prod, factors)
        )

    def _call(self, node: ast.Call) -> _Plan:
        if not isinstance(node.func, ast.Name) or node.keywords:
            raise RefusalError("a function is called by its name, with its arguments in order, as in atan2(y, x)")
        word = WORDS.get(ALIASES.get(node.func.id, node.func.id))
        if word is None:
            raise RefusalError(f"{node.func.id!r} is no function here")
        _check_arity(word, len(node.args))
        return list(node.args), partial(_apply, word)

    def _condition(self, node: ast.IfExp) -> _Plan:
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


def _spine(node: ast.expr, forward: type[ast.operator], back: type[ast.operator]) -> tuple[list[ast.expr], list[bool]]:
    """Return the operands of a chain such as a - b + c, and for each True unless it is subtracted or divided by.

    Chains become one n-ary Add or Mul: joining them two by two takes quadratic time.
    """
    operands: list[ast.expr] = []
    straight: list[bool] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, (forward, back)):
        operands.append(node.right)
        straight.append(isinstance(node.op, forward))
        node = node.left
    return [node, *reversed(operands)], [True, *reversed(straight)]


def _constant(compute: Callable[[list[float]], float], parts: list[_Value]) -> float | None:
    doubles = [part.double for part in parts if part.double is not None]
    return compute(doubles) if len(doubles) == len(parts) else None


def _negative(parts: list[_Value]) -> _Value:
    part = parts[0]
    return _Value(-part.expression, None if part.double is None else -part.double)


def _reciprocal(part: _Value) -> _Value:
    if part.double == 0.0:
        raise RefusalError("this divides by zero")
    return _Value(1 / part.expression, None if part.double is None else 1 / part.double)


def _power(parts: list[_Value]) -> _Value:
    base, exponent = parts
    check_power(base.expression, exponent.expression)
    if base.double is None or exponent.double is None:
        return _Value(base.expression**exponent.expression)
    try:
        double = math.pow(base.double, exponent.double)
    except (ValueError, OverflowError):
        raise RefusalError(f"{base.double:g}**{exponent.double:g} has no finite real value") from None
    if double == 0.0 != base.double:
        raise RefusalError(f"{base.double:g}**{exponent.double:g} is too small for a floating-point number")
    return _Value(base.expression**exponent.expression, double)


def _check_arity(word: Word, count: int) -> None:
    if word.fewest <= count <= (MOST_ARGUMENTS if word.most is None else word.most):
        return
    if word.most is None:
        raise RefusalError(f"{word.name} takes {word.fewest} to {MOST_ARGUMENTS} arguments, not {count}")
    raise RefusalError(f"{word.name} takes {word.most} {'argument' if word.most == 1 else 'arguments'}, not {count}")


def _apply(word: Word, parts: list[_Value]) -> _Value:
    arguments = [part.expression for part in parts]
    double = _double(word, parts)
    check_arguments(word.build, arguments)
    if word.build is sympy.Abs and not arguments[0].is_extended_real:
        # SymPy would make the real part of the root out of abs(exp(sqrt(x)))
        return _Value(sympy.Abs(*arguments, evaluate=False), double)
    return _Value(word.build(*arguments), double)


def _double(word: Word, parts: list[_Value]) -> float | None:
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
    comparisons = [_COMPARISONS.get(type(op)) for op in test.ops]
    known = [comparison for comparison in comparisons if comparison is not None]
    if len(known) < len(comparisons):
        raise RefusalError("values compare with < <= > >= == != only")
    return known


def _branches(tests: list[list[Callable[[Any, Any], Any]]], parts: list[_Value]) -> _Value:
    """Join the parts of a condition, laid out by `_Reader._condition`, into a Piecewise."""
    pairs: list[tuple[Any, Any]] = []
    values: list[_Value] = []
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
    return _Value(expression, chosen[0] if chosen else None)
