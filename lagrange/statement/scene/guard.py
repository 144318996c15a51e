"""Refuse expressions of untrusted files that would overload SymPy: long texts and numbers, large powers, many parts.

This module also divides the text of an expression into tokens, and refuses characters and words that are not allowed.
"""

from __future__ import annotations

import keyword
import re
import sys
import unicodedata
from collections.abc import Callable
from functools import cmp_to_key
from typing import Any, NamedTuple, NoReturn

import sympy
import sympy.assumptions.wrapper
import sympy.sets.setexpr
import sympy.tensor.tensor
from sympy.functions.elementary.piecewise import ExprCondPair

from lagrange.errors import SceneError
from lagrange.statement.expression import parts_first
from lagrange.statement.vocabulary.letters import LETTER, NAME, WORD

LONGEST_EVALUATED = 10_000  # Largest number of characters of an expression
LONGEST_UNEVALUATED = 1_000_000
"""Largest number of characters of an unevaluated expression, on which SymPy does no work."""
LONGEST_NUMBER, LONGEST_UNEVALUATED_NUMBER = 100, 400
"""Largest number of characters of a number, and of a number in an unevaluated expression, which may have 1,000 bits."""

_TOKEN = re.compile(
    r"(?P<blank>[ \t\r\n]+)"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>[{LETTER}_][{LETTER}0-9_]*)"
    r"|(?P<operator>\*\*|//|<<|>>|:=|->|<=|>=|==|!=|[-+*/<>(),])"
)
_LETTER = re.compile(f"[{LETTER}0-9_.]")

_ALLOWED = "the operators are + - * / ** and the comparisons < <= > >= == !="
_REMEDIES = {
    "^": "write ** for a power",
    "//": "write / for a division",
    "%": "write the remainder out",
    ":=": "write the value itself; nothing is assigned here",
    "=": "an expression has a value and assigns nothing; for an equation or a comparison write ==",
    ".": "'.' belongs to a decimal such as 0.5; the velocity of x is x_dot",
    "!": "write a factorial out as a number",
    "[": "nothing is indexed here; give each thing a name of its own",
    "{": "group with ( and )",
    '"': "write names and numbers without quotation marks",
    "'": "write names and numbers without quotation marks",
    ";": "give one expression",
    "&": "write and between two conditions",
    "|": "write or between two conditions",
    "#": "comments belong outside the expression",
    **dict.fromkeys(("<<", ">>", "->"), _ALLOWED),
}
_CONSTANTS = ("True", "False", "None")


class SceneToken(NamedTuple):
    """Number, name, word or operator at an offset of a text. Words have a meaning in the grammar, such as `if`."""

    kind: str
    text: str
    offset: int


def refuse(reason: str, offset: int) -> NoReturn:
    """Raise a SceneError with a message `reason`, located at an offset (from 0) of the text."""
    raise SceneError(reason, column=offset + 1)


def tokens(text: str, *, unevaluated: bool = False) -> list[SceneToken]:
    """Return the tokens of a text, and a last one of kind "end". Raises SceneError if the text is not allowed.

    If `unevaluated` is true, the words True, False and None are allowed as well.
    """
    if not isinstance(text, str):
        raise SceneError(f"an expression must be a text such as '2*x', not {type(text).__name__}.")
    most = LONGEST_UNEVALUATED if unevaluated else LONGEST_EVALUATED
    if len(text) > most:
        refuse(f"the expression has {len(text)} characters, more than {most}: state it in parts.", most)
    if not text.strip():
        refuse("the expression is empty: write 0 if there is nothing.", 0)
    words = ("if", "else", "and", "or", "not", *(_CONSTANTS if unevaluated else ()))
    longest = LONGEST_UNEVALUATED_NUMBER if unevaluated else LONGEST_NUMBER
    listed: list[SceneToken] = []
    offset = 0
    while offset < len(text):
        match = _TOKEN.match(text, offset)
        if match is None:
            character = text[offset]
            if ord(character) > 126 or ord(character) < 32:
                refuse(_unknown_letter(character), offset)
            if character == "'" and offset and _LETTER.match(text[offset - 1]):
                refuse("a prime is not a derivative here: the velocity of x is x_dot, its acceleration x_ddot.", offset)
            refuse(f"{character!r} is not allowed in an expression: {_REMEDIES.get(character, _ALLOWED)}.", offset)
        token = SceneToken(str(match.lastgroup), match.group(), offset)
        offset = match.end()
        if token.kind == "number":
            _check_number(token, text[offset : offset + 1], longest)
        elif token.text in words:
            token = token._replace(kind="word")
        elif token.kind == "name":
            _check_name(token, text)
        elif token.text in _REMEDIES:
            refuse(f"{token.text!r} is not allowed in an expression: {_REMEDIES[token.text]}.", token.offset)
        if token.kind != "blank":
            listed.append(token)
    return [*listed, SceneToken("end", "", len(text.rstrip()))]


def _check_number(token: SceneToken, following: str, most: int) -> None:
    """Raise SceneError for a number token that is complex, has more than `most` characters, or starts with a zero.

    `following` is the character after the number, which must not be a letter.
    """
    number, offset = token.text, token.offset
    if following in ("j", "J"):
        refuse(f"{number[:20]}{following} is a complex number: energies and forces are real.", offset)
    if following and _LETTER.match(following):
        refuse(
            f"{number[:20]}{following} is not a number: write decimals such as 12.5 or 1.5e-3, and a product with "
            "*, as in 2*x.",
            offset,
        )
    if len(number) > most:
        refuse(f"a number of {len(number)} characters is longer than {most}: shorten it.", offset)
    if len(number) > 1 and number[0] == "0" and number.isdigit():
        refuse(f"{number[:20]} starts with a zero: write the number without it.", offset)


def _check_name(token: SceneToken, text: str) -> None:
    """Raise SceneError for a name that is a reserved word, has letters that are not allowed, or is malformed."""
    name, offset = token.text, token.offset
    if keyword.iskeyword(name):
        refuse(
            f"{name!r} is a reserved word: {'write a number' if name in _CONSTANTS else 'choose another name'}.", offset
        )
    word = WORD.match(text, offset)
    if word and word.group() != name:
        foreign = offset + len(name)
        refuse(f"{word.group()[:40]!r} cannot be a name: {_unknown_letter(text[foreign])}", foreign)
    if not NAME.fullmatch(name):
        refuse(
            f"{name[:40]!r} cannot be a name: a name starts with a letter, goes on with letters, digits and "
            "underscores, and has at most 64 characters.",
            offset,
        )


def _unknown_letter(character: str) -> str:
    name = unicodedata.name(character, "control character")
    return (
        f"the character U+{ord(character):04X} ({name}) is not allowed in an expression: write letters A to Z, a to z "
        "and Greek ones without accents, digits and + - * / **."
    )


LARGEST_EXPONENT = 1000
MOST_BITS = 256  # Largest number of bits of an exact numerator or denominator, which are 77 digits
MOST_BRANCHES = 32  # Largest number of branches of a condition
MOST_ARGUMENTS = 16  # Largest number of arguments of min and max, which SymPy compares pair by pair
MOST_DOUBTFUL = 5
"""Largest number of parts that may be complex in an expression that SymPy splits into real and imaginary part. Each of
these parts can double the work."""
MOST_COMPARED = 200
"""Largest number of parts of the expressions in a comparison, an absolute value, a minimum or a maximum."""
CHUNK = 50  # Number of terms that SymPy adds at once. Exact coefficients are checked after each addition.

FEW_PARTS, MANY_SHARED, MOST_PARTS = 100_000, 1_000, 5_000_000
"""Limits on the number of parts of an expression: a number that is always allowed, the number per distinct part, and
the largest number.

A shared part counts each time it occurs, since SymPy visits it each time, in 2 us. A file of 12 KB could otherwise keep
SymPy busy for ever. An energy of 500 links in Cartesian coordinates has 800 parts for each distinct part.
"""

_COMPARING = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.sinc, sympy.erf)
_SPLITTING = (sympy.Abs, sympy.sinh, sympy.cosh, sympy.tanh)
_NUMBER_FIRST = (sympy.Add, sympy.Mul)


class RefusalError(Exception):
    """Error: an expression is refused. Its message is the reason. The reader of the text adds the column."""


class Guard:
    """Check of the size and powers of every expression that is built while texts are read. Raises RefusalError.

    Each distinct subexpression is checked once. `varies` says if it contains a symbol, and `sizes` its number of parts.
    """

    def __init__(self) -> None:
        self.varies: dict[Any, bool] = {}
        self.sizes: dict[Any, int] = {}

    def check(self, expression: Any) -> bool:
        """Return True if an expression contains a symbol.

        Raises RefusalError if it has too many parts, or a part that is not real, not finite or beyond a limit.
        """
        for node in parts_first(expression, self.varies):
            if not isinstance(node, sympy.Symbol):
                _check_node(node)
            self.sizes[node] = 1 + sum(self.sizes[part] for part in node.args)
            if self.sizes[node] > FEW_PARTS and self.sizes[node] > min(MANY_SHARED * len(self.sizes), MOST_PARTS):
                raise RefusalError(f"this has {self.sizes[node]:.3g} parts, most of them shared: state fewer")
            self.varies[node] = isinstance(node, sympy.Symbol) or any(self.varies[part] for part in node.args)
            self.enter(node)
        return self.varies[expression]

    def enter(self, node: Any) -> None:
        """Do nothing. A subclass examines here each subexpression that passed the check."""

    def join(self, build: Callable[..., Any], parts: list[Any]) -> Any:
        """Return the sum or product of `parts`. `build` is sympy.Add or sympy.Mul.

        If there are more than `CHUNK` parts, groups of `CHUNK` parts are built and checked first.
        """
        while len(parts) > CHUNK:
            parts = [build(*parts[i : i + CHUNK]) for i in range(0, len(parts), CHUNK)]
            for part in parts:
                self.check(part)
        return build(*parts)


def replaced(expression: Any, done: dict[Any, Any]) -> Any:
    """Return the expression with its parts replaced. `done` maps parts to their replacements, and is extended.

    Terms are sorted as SymPy does, but not evaluated. With x(t), which SymPy assumes to be complex, evaluation would
    rewrite roots and absolute values.
    """
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
    """Raise RefusalError if SymPy would take too long to compute the exact value of `base` ** `exponent`."""
    _check_exponent(exponent)
    if isinstance(base, sympy.Rational) and isinstance(exponent, sympy.Number):
        bits = max(abs(base.p).bit_length(), base.q.bit_length())
        if bits > 1 and bits * abs(exponent) > 2 * MOST_BITS:
            raise RefusalError(
                f"{float(base):g}**{float(exponent):g} is too long for an exact number: write a decimal, such as "
                "1.5e100"
            )


def check_arguments(build: Any, arguments: list[Any]) -> None:
    """Raise RefusalError for arguments with which SymPy would take too long to evaluate the function `build`."""
    if build is sympy.exp and arguments[0].has(sympy.log):
        _check_exponent(arguments[0])  # exp(n*log(x)) becomes the power x**n
    if build in _COMPARING:
        check_compared(
            arguments, f"the {'argument' if len(arguments) == 1 else 'arguments'} of {build.__name__.lower()}"
        )
    if build in _SPLITTING:
        doubtful: dict[Any, bool] = {}  # Distinct subexpressions, and true for those that SymPy cannot prove to be real
        for node in parts_first(arguments[0], doubtful):
            doubtful[node] = isinstance(node, sympy.Expr) and not node.is_extended_real
        if sum(doubtful.values()) > MOST_DOUBTFUL:
            raise RefusalError(
                f"the argument of {build.__name__.lower()} has more than {MOST_DOUBTFUL} parts that may be complex, "
                "such as roots and logarithms: write it with fewer"
            )


def check_compared(expressions: list[Any], what: str) -> None:
    """Raise RefusalError if expressions, named `what`, are too long for SymPy to compare."""
    size: dict[Any, int] = {}
    for expression in expressions:
        for node in parts_first(expression, size):
            size[node] = 1 + sum(size[part] for part in node.args)
    if sum(size[expression] for expression in expressions) > MOST_COMPARED:
        raise RefusalError(f"there are more than {MOST_COMPARED} parts in {what}: write something shorter")


def _check_exponent(exponent: Any) -> None:
    for number in exponent.atoms(sympy.Number):
        if abs(number) > LARGEST_EXPONENT:
            raise RefusalError(f"the exponent {float(number):g} is out of bounds: at most {LARGEST_EXPONENT} in size")


def _check_node(node: Any) -> None:
    if isinstance(node, sympy.Rational):
        if max(abs(node.p).bit_length(), node.q.bit_length()) > MOST_BITS:
            raise RefusalError("an exact number here is longer than 77 digits: write a decimal, such as 1.5e100")
    elif isinstance(node, sympy.Float):
        if abs(node) > sys.float_info.max:
            raise RefusalError("a number here is too large for a floating-point number")
        if not node.is_zero and float(node) == 0.0:  # For SymPy 0.0 is not equal to 0
            raise RefusalError("a number here is too small for a floating-point number")
    elif node in (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo):
        raise RefusalError("this has no finite value: check for a division by zero")
    elif node is sympy.I:
        raise RefusalError("this is not real: energies and forces are real")
    elif isinstance(node, sympy.Pow):
        _check_exponent(node.exp)
    elif isinstance(node, (sympy.Min, sympy.Max)) and len(node.args) > MOST_ARGUMENTS:
        raise RefusalError(f"min and max take at most {MOST_ARGUMENTS} arguments")
