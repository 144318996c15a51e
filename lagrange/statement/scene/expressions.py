"""Read an expression of a scene file, such as "m*g*l*cos(theta)", into SymPy. Texts may come from strangers.

Size and structure of a text are limited before it reaches SymPy, and no code is run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, pairwise
from operator import itemgetter
from typing import Any, ClassVar, NoReturn

import sympy
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanAtom, BooleanFunction

from lagrange.errors import SceneError, listing, suggestion
from lagrange.statement.coordinate import multiplier, t
from lagrange.statement.scene.guard import (
    MOST_ARGUMENTS,
    MOST_BRANCHES,
    Guard,
    RefusalError,
    SceneToken,
    check_arguments,
    check_compared,
    check_power,
    refuse,
    replaced,
    tokens,
)
from lagrange.statement.vocabulary.functions import ALIASES, FUNCTION_NAMES, WORDS, FunctionWord

DEEPEST_NESTING = 64  # Largest number of levels of nested parentheses, signs and powers
MOST_JOINED = 64  # Largest number of comparisons in a condition with and, or, not. SymPy compares them in pairs.

MULTIPLIER = "multiplier"
"""Function that returns the multiplier of a constraint in texts: multiplier(rod).

A name before a parenthesis is always a call, so a parameter may have the same name.
"""

NO_VALUE = "a comparison has no value of its own: write a condition as in a if x < 0 else b"

PREDEFINED_VALUES = {"t": t, "pi": sympy.pi}

CONDITIONS = (Relational, BooleanFunction, BooleanAtom)  # SymPy classes of conditions

COMPARISONS: dict[str, Callable[..., Any]] = {
    "<": sympy.Lt,
    "<=": sympy.Le,
    ">": sympy.Gt,
    ">=": sympy.Ge,
    "==": sympy.Eq,
    "!=": sympy.Ne,
}


def read_expression(text: str, names: Mapping[str, Any]) -> Any:
    """Return the SymPy expression of `text`. Raises SceneError with the column.

    `names` maps identifiers to SymPy objects; `t` and `pi` are known as well. The text may have numbers, + - * / **,
    the functions of `WORDS`, and conditions such as `a if x < 0 else b`.
    """
    return Expressions(names).read(text)


def read_number(text: str) -> float:
    """Return the value of a constant expression such as "pi/6". Raises SceneError with the column."""
    value = Reader(text, {"pi": sympy.pi}, Guard(), {"pi": math.pi}, constant=True).read()
    return float(value.expression.evalf(30))


def number_from_text(text: str) -> Any:
    """Return a decimal text as a SymPy number: a fraction if the decimal equals a short one, else the nearest double.

    0.5 becomes 1/2, so x**0.5 is a square root. 9.81 remains a decimal. Raises RefusalError for a number beyond the
    range of doubles.
    """
    if text.isdigit():
        return sympy.Integer(int(text))
    value = float(text)
    if math.isinf(value):
        raise RefusalError(f"{text[:40]} is too large for a floating-point number")
    if value == 0.0 and text.lower().partition("e")[0].strip("0."):
        raise RefusalError(f"{text[:40]} is too small for a floating-point number")
    exact = Fraction(value)
    # Cheap tests come first, since Fraction(text) can have as many digits as the exponent in the text
    if exact.denominator <= 16 and exact.numerator < 10**6 and (value == 0.0 or exact == Fraction(text)):
        return sympy.Rational(exact.numerator, exact.denominator)
    return sympy.Float(value)


@dataclass(frozen=True)
class ParsedValue:
    """Part of a text after parsing: its expression, and its value `double` if it is constant, else None.

    `literal` is true for a number without a sign.
    """

    expression: Any
    double: float | None = None
    literal: bool = False


Branch = tuple[ParsedValue, ParsedValue]  # A value, and the condition under which it is chosen


class Reader:
    """Recursive-descent parser of one text. Each part is built and checked after the parts inside it.

    SymPy evaluates the parts. The value of a constant is computed as a double, too. `names` maps identifiers to SymPy
    objects, and `constants` some of them to doubles. `calls` are functions that texts may call besides those of
    `WORDS`. `constant` is true if the text must be a number, which changes the remedy for an unknown name.
    """

    unevaluated: ClassVar[bool] = False

    def __init__(
        self,
        text: str,
        names: Mapping[str, Any],
        guard: Guard,
        constants: Mapping[str, float],
        calls: Collection[str] = (),
        *,
        constant: bool = False,
    ) -> None:
        self.names, self.guard, self.constants, self.calls, self.constant = names, guard, constants, calls, constant
        self.tokens = tokens(text, unevaluated=self.unevaluated)
        self.place = self.depth = 0

    def read(self) -> ParsedValue:
        """Return the parsed value of the whole text. Raises SceneError unless the text is one expression."""
        try:
            value = self.expression()
        except RecursionError:
            refuse("the expression is nested too deeply to be read here: state it in parts.", 0)
        if self.token.kind != "end":
            self.refuse_more(self.token)
        if not self.unevaluated and not isinstance(value.expression, sympy.Expr):
            refuse(f"{NO_VALUE}.", self.tokens[0].offset)
        return value

    @property
    def token(self) -> SceneToken:
        """Token at the current position in the text."""
        return self.tokens[self.place]

    def take(self) -> SceneToken:
        """Return the token at the current position, and move to the next token."""
        self.place += 1
        return self.tokens[self.place - 1]

    def at(self, *texts: str, kind: str = "operator") -> bool:
        """Return True if the current token has the kind `kind` and one of the `texts`."""
        return self.token.kind == kind and self.token.text in texts

    @contextmanager
    def deeper(self) -> Iterator[None]:
        """Context manager of one more level of nesting. Raises SceneError beyond `DEEPEST_NESTING` levels."""
        self.depth += 1
        if self.depth > DEEPEST_NESTING:
            refuse(f"the expression is nested more than {DEEPEST_NESTING} deep: state it in parts.", self.token.offset)
        yield
        self.depth -= 1

    def built(self, start: int, build: Callable[..., ParsedValue], *parts: Any) -> ParsedValue:
        """Return `build(*parts)`, a parsed part of the text, after the check of its size and value.

        A RefusalError becomes a SceneError at the offset `start` in the text.
        """
        try:
            return self._checked(build(*parts))
        except RefusalError as refusal:
            refuse(f"{refusal}.", start)
        except SceneError:
            raise
        except (ValueError, ArithmeticError, TypeError, RecursionError):
            refuse("this part has no finite real value.", start)

    def expression(self) -> ParsedValue:
        """Read a value, or values with conditions: a if x < 0 else b if x < 1 else c."""
        start, branches = self.token.offset, list[Branch]()
        value: ParsedValue | None = self.logic()
        while value is not None and self.at("if", kind="word"):
            where = self.take().offset
            branches.append((value, self.logic()))
            if not self.at("else", kind="word"):
                refuse("an 'if' has no 'else': write a condition as in a if x < 0 else b.", where)
            self.take()
            if self.at("None", kind="word"):
                self.take()
                value = None
            else:
                value = self.logic()
        if value is None or branches:
            return self.built(start, self._branches, branches, value)
        return value

    def logic(self) -> ParsedValue:
        """Read a value, or a condition with the words and, or, not."""
        return self.joined("or", sympy.Or, lambda: self.joined("and", sympy.And, self.negation))

    def joined(self, word: str, build: Any, read: Callable[[], ParsedValue]) -> ParsedValue:
        """Read one or more conditions with a `word` between them. `read` reads one condition.

        `build` is SymPy's And or Or, which joins several conditions. A single condition or value is returned unchanged.
        """
        start, parts = self.token.offset, [read()]
        while self.at(word, kind="word"):
            self.take()
            parts.append(read())
        return self.built(start, self._condition, build, parts) if len(parts) > 1 else parts[0]

    def negation(self) -> ParsedValue:
        """Read a value or a comparison, or a condition after the word not."""
        start = self.token.offset
        if not self.at("not", kind="word"):
            return self.comparison()
        with self.deeper():
            self.take()
            return self.built(start, self._condition, sympy.Not, [self.negation()])

    def comparison(self) -> ParsedValue:
        """Read a value, or a comparison of several values, such as 0 < x < 1."""
        start, parts, signs = self.token.offset, [self.sum()], list[str]()
        while self.at(*COMPARISONS):
            signs.append(self.take().text)
            parts.append(self.sum())
        return self.built(start, self._compared, signs, parts) if signs else parts[0]

    def sum(self) -> ParsedValue:
        """Read a chain of terms such as a - b + c, and build one sum. Adding term by term would take quadratic time."""
        start, parts, straight = self.token.offset, [self.product()], [True]
        while self.at("+", "-"):
            straight.append(self.take().text == "+")
            parts.append(self.product())
        return self.built(start, self._summed, straight, parts) if len(parts) > 1 else parts[0]

    def product(self) -> ParsedValue:
        """Read a chain of factors such as -a*b/c. A sign before the chain belongs to its first factor."""
        start, negative = self.token.offset, self.at("-")
        if self.at("+", "-"):
            with self.deeper():
                self.take()
                parts = [self.factor()]
        else:
            parts = [self.power()]
        straight = [True]
        while self.at("*", "/"):
            straight.append(self.take().text == "*")
            parts.append(self.factor())
        if len(parts) == 1 and not negative:
            return parts[0]
        return self.built(start, self._multiplied, negative, straight, parts)

    def factor(self) -> ParsedValue:
        """Read a power, or a factor with a sign."""
        start, negative = self.token.offset, self.at("-")
        if not self.at("+", "-"):
            return self.power()
        with self.deeper():
            self.take()
            inner = self.factor()
        return self.built(start, self._multiplied, negative, [True], [inner]) if negative else inner

    def power(self) -> ParsedValue:
        """Read an atom (a number, a name, a call or an expression in parentheses), or a power of an atom."""
        start, base = self.token.offset, self.atom()
        if not self.at("**"):
            return base
        with self.deeper():
            self.take()
            exponent = self.factor()
        return self.built(start, self._raised, base, exponent)

    def atom(self) -> ParsedValue:
        """Read a number, a name, a call, or an expression in parentheses."""
        token = self.token
        if token.kind == "number":
            self.take()
            return self.built(token.offset, self._number, token.text)
        if token.kind == "name":
            self.take()
            return self.call(token) if self.at("(") else self.named(token)
        if self.at("("):
            return self.in_parentheses()[0]
        if token.kind == "end":
            refuse("the expression ends where a value is expected.", token.offset)
        raise SceneError(f"a value is missing before {token.text!r}.", column=token.offset + 1)

    def in_parentheses(self, *, several: bool = False) -> list[ParsedValue]:
        """Read the value in parentheses at the current token, or if `several` is true, values between commas."""
        with self.deeper():
            opened = self.take()
            values = [self.expression()]
            while several and self.at(","):
                self.take()
                values.append(self.expression())
        if self.token.kind == "end":
            refuse("'(' is never closed: add ')'.", opened.offset)
        if not self.at(")"):
            self.refuse_more(self.token)
        self.take()
        return values

    def named(self, token: SceneToken) -> ParsedValue:
        """Return the value of the symbol or definition whose name is the text of `token`."""
        name = token.text
        if name in self.names:
            return self.built(token.offset, ParsedValue, self.names[name], self.constants.get(name))
        if name in FUNCTION_NAMES:
            refuse(f"{name!r} is a function: write {name}(...).", token.offset)
        if self.constant:
            refuse(f"{name!r} is not allowed in a constant: write numbers, pi and functions only.", token.offset)
        reason = f"{name!r} is not declared: add it to [parameters] or coordinates.{suggestion(name, self.names)}"
        raise SceneError(reason, column=token.offset + 1)

    def call(self, token: SceneToken) -> ParsedValue:
        """Read the arguments of a function call, and return its value. The name of the function was read as `token`."""
        name = token.text
        if name == MULTIPLIER and name in self.calls:
            return self.multiplier(token)
        if name in self.calls:
            return self.built(token.offset, self._other_call, name, self.in_parentheses(several=True))
        if name in FUNCTION_NAMES:
            word = WORDS[ALIASES.get(name, name)]
            return self.built(token.offset, self._applied, word, self.in_parentheses(several=True))
        if name in self.names:
            refuse(f"{name!r} is not a function: write a product with *, as in {name}*(...).", token.offset)
        reason = (
            f"{name!r} is not a function here; the functions are {listing(WORDS)}.{suggestion(name, FUNCTION_NAMES)}"
        )
        raise SceneError(reason, column=token.offset + 1)

    def multiplier(self, token: SceneToken) -> ParsedValue:
        """Read the name of a constraint in parentheses, and return its multiplier. `token` is the word before them."""
        _, name, closing = self.take(), self.take(), self.token
        if name.kind != "name" or closing.text != ")":
            refuse("multiplier takes the name of a constraint, as in multiplier(rod).", token.offset)
        self.take()
        return self.built(token.offset, ParsedValue, multiplier(name.text))

    def refuse_more(self, token: SceneToken) -> NoReturn:
        """Raise SceneError for a token that follows a complete value."""
        text = token.text
        reason = f"an operator is missing before {text[:40]!r}"
        if token.kind in ("number", "name"):
            reason += ": write a product with *, as in 2*x."
        elif text == "(":
            reason += ": write a product with *, as in 2*(x + y)."
        elif text == ")":
            reason = "')' closes nothing: remove it, or add '(' before."
        elif text == ",":
            reason = "',' separates the arguments of a function only: write decimals with a point, as in 9.81."
        elif text == "else":
            reason = "'else' has no 'if': write a condition as in a if x < 0 else b."
        refuse(reason if reason.endswith(".") else f"{reason}.", token.offset)

    def _checked(self, value: ParsedValue) -> ParsedValue:
        """Return a parsed part of the text after the check of its size.

        A part without symbols must have a finite value. If SymPy evaluated the part to an exact number, its value as a
        double is computed from this number.
        """
        varies = self.guard.check(value.expression)
        if isinstance(value.expression, sympy.Number):
            return ParsedValue(value.expression, float(value.expression))
        if varies or not isinstance(value.expression, sympy.Expr):
            return ParsedValue(value.expression)
        if value.double is None:
            raise RefusalError("the names cancel and leave a constant: write the constant")
        if not math.isfinite(value.double):
            raise RefusalError("this has no finite value")
        return value

    def _number(self, text: str) -> ParsedValue:
        return ParsedValue(number_from_text(text))

    def _summed(self, straight: Sequence[bool], parts: Sequence[ParsedValue]) -> ParsedValue:
        terms = [term_of(part) if plus else -term_of(part) for part, plus in zip(parts, straight, strict=True)]
        total = None
        if (doubles := _doubles(parts)) is not None:
            total = sum(x if plus else -x for x, plus in zip(doubles, straight, strict=True))
        return ParsedValue(self.guard.join(sympy.Add, terms), total)

    def _multiplied(self, negative: bool, straight: Sequence[bool], parts: Sequence[ParsedValue]) -> ParsedValue:
        first, *others = map(term_of, parts)
        if any(part.double == 0.0 for part, times in zip(parts, straight, strict=True) if not times):
            raise RefusalError("a denominator is zero")
        factors = [-first if negative else first]
        factors += [x if times else 1 / x for x, times in zip(others, straight[1:], strict=True)]
        whole = None
        if (doubles := _doubles(parts)) is not None:
            whole = math.prod(x if times else 1 / x for x, times in zip(doubles, straight, strict=True))
            whole = -whole if negative else whole
        return ParsedValue(self.guard.join(sympy.Mul, factors), whole)

    def _raised(self, base: ParsedValue, exponent: ParsedValue) -> ParsedValue:
        check_power(term_of(base), term_of(exponent))
        if base.double is None or exponent.double is None:
            return ParsedValue(base.expression**exponent.expression)
        try:
            double = math.pow(base.double, exponent.double)
        except (ValueError, OverflowError):
            raise RefusalError(f"{base.double:g}**{exponent.double:g} has no finite real value") from None
        if double == 0.0 != base.double:
            raise RefusalError(f"{base.double:g}**{exponent.double:g} is too small for a floating-point number")
        return ParsedValue(base.expression**exponent.expression, double)

    def _applied(self, word: FunctionWord, parts: Sequence[ParsedValue]) -> ParsedValue:
        check_arity(word, len(parts))
        arguments = list(map(term_of, parts))
        double = _double(word, parts)
        check_arguments(word.build, arguments)
        if word.build is sympy.Abs and not arguments[0].is_extended_real:
            # SymPy would rewrite abs(exp(sqrt(x))) with the real part of the root
            return ParsedValue(sympy.Abs(*arguments, evaluate=False), double)
        return ParsedValue(word.build(*arguments), double)

    def _other_call(self, name: str, parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return the call of a function of coordinates without a formula, such as U(r), with the arguments `parts`."""
        return ParsedValue(sympy.Function(name)(*map(term_of, parts)))

    def _compared(self, signs: Sequence[str], parts: Sequence[ParsedValue]) -> ParsedValue:
        terms = list(map(term_of, parts))
        if any(term.has(sympy.Piecewise) for term in terms):
            raise RefusalError("a condition cannot compare a value that has conditions itself")
        check_compared(terms, "the compared values")
        relations = [COMPARISONS[sign](a, b) for sign, (a, b) in zip(signs, pairwise(terms), strict=True)]
        return ParsedValue(sympy.And(*relations))

    def _condition(self, build: Any, parts: Sequence[ParsedValue]) -> ParsedValue:
        """Return And, Or or Not (`build`) of the conditions `parts`."""
        return ParsedValue(_joined(build, map(condition_of, parts)))

    def _branches(self, branches: Sequence[Branch], last: ParsedValue | None) -> ParsedValue:
        if len(branches) > MOST_BRANCHES or last is None:
            raise RefusalError(f"a condition has at most {MOST_BRANCHES} branches")
        chosen = [value.double for value in (*(value for value, _ in branches), last)]
        pairs = [(term_of(value), condition_of(condition)) for value, condition in branches]
        pairs.append((term_of(last), sympy.true))
        # SymPy would distribute the conditions of branches with the same value, in exponential time
        groups = groupby(pairs, key=itemgetter(0))
        expression = sympy.Piecewise(*((value, _joined(sympy.Or, (c for _, c in group))) for value, group in groups))
        doubles = [double for double, (value, _) in zip(chosen, pairs, strict=True) if value == expression]
        return ParsedValue(expression, doubles[0] if doubles else None)


def condition_of(value: ParsedValue) -> Any:
    """Return the condition in a parsed part. Raises RefusalError for a number or an expression."""
    if not isinstance(value.expression, CONDITIONS):
        raise RefusalError("a condition compares two values: write it as in a if x < 0 else b")
    return value.expression


def term_of(value: ParsedValue) -> Any:
    """Return the expression of a parsed part. Raises RefusalError for a condition, which has no value."""
    if not isinstance(value.expression, sympy.Expr):
        raise RefusalError(NO_VALUE)
    return value.expression


def _joined(build: Any, conditions: Iterable[Any]) -> Any:
    """Return And, Or or Not (`build`) of conditions. Raises RefusalError if they have too many comparisons."""
    listed = list(conditions)
    if sum(len(condition.atoms(Relational)) for condition in listed) > MOST_JOINED:
        raise RefusalError(f"a condition has more than {MOST_JOINED} comparisons: state fewer")
    return build(*listed)


def _doubles(parts: Sequence[ParsedValue]) -> list[float] | None:
    """Return the values of parsed parts as doubles, or None if a part is not constant."""
    doubles = [part.double for part in parts if part.double is not None]
    return doubles if len(doubles) == len(parts) else None


def check_arity(word: FunctionWord, count: int) -> None:
    """Raise RefusalError if the function `word` does not take `count` arguments."""
    if word.fewest <= count <= (MOST_ARGUMENTS if word.most is None else word.most):
        return
    if word.most is None:
        raise RefusalError(f"{word.name} takes {word.fewest} to {MOST_ARGUMENTS} arguments, not {count}")
    raise RefusalError(f"{word.name} takes {word.most} {'argument' if word.most == 1 else 'arguments'}, not {count}")


def _double(word: FunctionWord, parts: Sequence[ParsedValue]) -> float | None:
    """Return the value of a function of constant arguments as a double. None if an argument is not constant.

    `word` is the function, and `parts` are its parsed arguments. Raises RefusalError for a value that is not finite and
    real.
    """
    doubles = _doubles(parts)
    if doubles is None:
        return None
    call = f"{word.name}({', '.join(f'{x:g}' for x in doubles)})"
    try:
        double = word.of_floats(*doubles)
    except (ValueError, OverflowError):
        raise RefusalError(f"{call} has no finite real value") from None
    if word.name == "exp" and double == 0.0:
        raise RefusalError(f"{call} is too small for a floating-point number")
    return double


class Expressions:
    """Reader of the expressions of one file, which share names, definitions and limits.

    `names` maps identifiers to SymPy objects. `calls` has the names of functions of coordinates without a formula.
    """

    def __init__(self, names: Mapping[str, Any], calls: Collection[str] = ()) -> None:
        known = {**names, **PREDEFINED_VALUES}
        # SymPy tests signs quickly for real symbols, and slowly for q(t), which may be complex.
        self.names = {name: value if value.is_real else sympy.Dummy(name, real=True) for name, value in known.items()}
        self.calls = calls
        self.guard = Guard()
        self.constants = {"pi": math.pi}
        self._done = {self.names[name]: value for name, value in known.items()}

    def define(self, name: str, text: str) -> None:
        """Define a name for the expression in a text. Later texts may use the name."""
        value = self.built(text)
        self.names[name] = value.expression
        if value.double is not None:
            self.constants[name] = value.double

    def enter(self, name: str, expression: Any) -> None:
        """Define a name for an expression that is not given as text, such as a table. Later texts may use the name."""
        self.names[name] = sympy.Dummy(name, real=True)
        self._done[self.names[name]] = expression

    def read(self, text: str) -> Any:
        """Return the expression in a text. Raises SceneError with the column."""
        return replaced(self.built(text).expression, self._done)

    def built(self, text: str) -> ParsedValue:
        """Return the parsed value of a text, in which real symbols replace the functions of time."""
        return Reader(text, self.names, self.guard, self.constants, self.calls).read()
