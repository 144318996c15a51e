"""The tokens of an expression in a scene file, with the limits on its length and depth."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass
from typing import NoReturn

from lagrange.errors import SceneError, listing, suggestion
from lagrange.statement.vocabulary.letters import LETTER, NAME, WORD
from lagrange.statement.vocabulary.words import FUNCTIONS, WORDS

LONGEST = 10_000
"""Most characters of an expression."""
LONGEST_UNEVALUATED = 1_000_000
"""Most characters of an unevaluated expression, on which SymPy does no work."""
DEEPEST = 64
"""Most levels of nested parentheses, signs, powers and conditions."""
LONGEST_CHAIN = 2_200
"""Most terms and factors in a row. They nest in the tree of Python's parser, which fails beyond a depth of some
2900 in Python 3.11."""
LONGEST_NUMBER, LONGEST_UNEVALUATED_NUMBER = 100, 400
"""Most characters of a number; in unevaluated expressions those of 1,000 bits, and a few more."""

MULTIPLIER, SUM, PRODUCT, FLOAT = "multiplier", "sum", "product", "float"
"""Calls beside those of functions: `multiplier(rod)` in scenes, the others in unevaluated expressions.

A name before a parenthesis is always a call, so these names stay free for parameters.
"""
CALLS, UNEVALUATED_CALLS = frozenset((MULTIPLIER,)), frozenset((MULTIPLIER, SUM, PRODUCT, FLOAT))

_TOKEN = re.compile(
    r"(?P<blank>[ \t\r\n]+)"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>[{LETTER}_][{LETTER}0-9_]*)"
    r"|(?P<operator>\*\*|//|<<|>>|:=|->|<=|>=|==|!=|[-+*/<>(),])"
)
_LETTER = re.compile(f"[{LETTER}0-9_.]")
_CALL = re.compile(r"[ \t\r\n]*\(")

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
    "&": "chain comparisons, as in 0 < x < 1",
    "|": "nest conditions, as in a if x < 0 else b",
    "#": "comments belong outside the expression",
}
_RESERVED = {
    "and": "chain comparisons, as in 0 < x < 1",
    "or": "nest conditions, as in a if x < 0 else b",
    "not": "turn the comparison round",
    "True": "write a number",
    "False": "write a number",
    "None": "write a number",
}


def refuse(reason: str, offset: int) -> NoReturn:
    """Raise a SceneError that points at this offset (from 0) of the text."""
    raise SceneError(reason, column=offset + 1)


def scan(
    text: str,
    names: Collection[str],
    *,
    constant: bool = False,
    calls: Collection[str] = (),
    unevaluated: bool = False,
) -> None:
    """Check a text token by token against the known names; raises SceneError with the column.

    `constant` says that the text is to be a number, which changes the remedy for an unknown name. `calls` are names of
    calls beside the functions. An `unevaluated` text may be longer, and may contain and, or, not, True, False and None.
    """
    if not isinstance(text, str):
        raise SceneError(f"an expression is a text such as '2*x', not {type(text).__name__}.")
    most = LONGEST_UNEVALUATED if unevaluated else LONGEST
    if len(text) > most:
        refuse(f"the expression has {len(text)} characters, more than {most}: state it in parts.", most)
    if not text.strip():
        refuse("the expression is empty: write 0 if there is nothing.", 0)
    checker = _TokenChecker(text, names, constant, calls, unevaluated)
    offset = 0
    while offset < len(text):
        match = _TOKEN.match(text, offset)
        if match is None:
            _refuse_character(text, offset)
        checker.take(match)
        offset = match.end()
    checker.finish()


def unknown_name(name: str, names: Collection[str], offset: int, *, constant: bool = False) -> NoReturn:
    """Raise SceneError for an undeclared name; with `constant` the text may contain no names at all."""
    if constant:
        refuse(f"{name!r} cannot stand in a constant: write numbers, pi and functions only.", offset)
    refuse(f"{name!r} is not declared: add it to [parameters] or coordinates.{suggestion(name, names)}", offset)


@dataclass
class _Level:
    """A pair of parentheses: the offset of its start, and counters of the nesting without parentheses inside it."""

    offset: int
    call: str  # name of the function before it, empty if there is none
    tight: int = 0  # signs and powers whose operand is still open
    conditions: int = 0
    waiting: int = 0  # number of `if` without their `else` so far
    terms: int = 0
    factors: int = 0  # of the last term


class _TokenChecker:
    """Checks tokens one by one: values and operators alternate, parentheses match, and nesting is limited."""

    def __init__(
        self, text: str, names: Collection[str], constant: bool, calls: Collection[str], unevaluated: bool
    ) -> None:
        self.text = text
        self.names = names
        self.constant = constant
        self.calls = calls
        self.unevaluated = unevaluated
        self.levels = [_Level(0, call="")]
        self.depth = 0
        self.chain = 0
        self.valued = False  # the last token ended a value, so an operator must follow
        self.called = ""  # name of a function, if that was the last token

    def take(self, match: re.Match[str]) -> None:
        """Check the next token."""
        kind, token, offset = match.lastgroup, match.group(), match.start()
        if kind == "number":
            self._number(token, offset)
        elif kind == "name":
            self._name(token, offset)
        elif kind == "operator":
            self._operator(token, offset)
        if self.depth > DEEPEST:
            refuse(f"the expression is nested more than {DEEPEST} deep: state it in parts.", offset)
        if self.chain > LONGEST_CHAIN:
            refuse(
                f"more than {LONGEST_CHAIN} terms or factors follow each other: group them with parentheses.", offset
            )

    def finish(self) -> None:
        """Check that the text is complete."""
        if not self.valued:
            refuse("the expression ends where a value is expected.", len(self.text.rstrip()))
        self._complete(self.levels[-1])
        if len(self.levels) > 1:
            refuse("'(' is never closed: add ')'.", self.levels[-1].offset)

    def _number(self, token: str, offset: int) -> None:
        self._value(token, offset)
        following = self.text[offset + len(token) : offset + len(token) + 1]
        if following in ("j", "J"):
            refuse(f"{token[:20]}{following} is a complex number: energies and forces are real.", offset)
        if following and _LETTER.match(following):
            refuse(
                f"{token[:20]}{following} is not a number: write decimals such as 12.5 or 1.5e-3, and a product with "
                "*, as in 2*x.",
                offset,
            )
        most = LONGEST_UNEVALUATED_NUMBER if self.unevaluated else LONGEST_NUMBER
        if len(token) > most:
            refuse(f"a number of {len(token)} characters is longer than {most}: shorten it.", offset)
        if len(token) > 1 and token[0] == "0" and token.isdigit():
            refuse(f"{token[:20]} starts with a zero: write the number without it.", offset)

    def _name(self, token: str, offset: int) -> None:
        if token in ("if", "else"):
            self._condition(token, offset)
            return
        if self.unevaluated and token in _RESERVED:
            self._logic(token, offset)
            return
        if keyword.iskeyword(token):
            remedy = _RESERVED.get(token, "choose another name")
            refuse(f"{token!r} is a reserved word: {remedy}.", offset)
        word = WORD.match(self.text, offset)
        if word and word.group() != token:
            foreign = offset + len(token)
            refuse(f"{word.group()[:40]!r} cannot be a name: {_unknown_letter(self.text[foreign])}", foreign)
        if not NAME.fullmatch(token):
            refuse(
                f"{token[:40]!r} cannot be a name: a name starts with a letter, goes on with letters, digits and "
                "underscores, and has at most 64 characters.",
                offset,
            )
        self._value(token, offset)
        if _CALL.match(self.text, offset + len(token)):
            self._call(token, offset)
        elif token not in self.names and self.levels[-1].call != MULTIPLIER:
            if token in FUNCTIONS:
                refuse(f"{token!r} is a function: write {token}(...).", offset)
            unknown_name(token, self.names, offset, constant=self.constant)

    def _call(self, token: str, offset: int) -> None:
        if token not in FUNCTIONS and token not in self.calls:
            if token in self.names:
                refuse(f"{token!r} is not a function: write a product with *, as in {token}*(...).", offset)
            refuse(
                f"{token!r} is not a function here; the functions are {listing(WORDS)}.{suggestion(token, FUNCTIONS)}",
                offset,
            )
        self.valued, self.called = False, token

    def _logic(self, token: str, offset: int) -> None:
        """Check and, or, not, or a constant of logic."""
        if token in ("and", "or"):
            self._after_value(token, offset)
            self._end_tight(self.levels[-1])
            self._end_chain(self.levels[-1])
        elif token == "not":
            if self.valued:
                refuse("an operator is missing before 'not'.", offset)
            self._tighten()
        else:
            self._value(token, offset)

    def _value(self, token: str, offset: int) -> None:
        if self.valued:
            refuse(f"an operator is missing before {token[:40]!r}: write a product with *, as in 2*x.", offset)
        self.valued = True

    def _condition(self, token: str, offset: int) -> None:
        self._after_value(token, offset)
        level = self.levels[-1]
        self._end_tight(level)
        self._end_chain(level)
        if token == "if":
            level.conditions += 1
            level.waiting += 1
            self.depth += 1
        elif level.waiting:
            level.waiting -= 1
        else:
            refuse("'else' has no 'if': write a condition as in a if x < 0 else b.", offset)

    def _operator(self, token: str, offset: int) -> None:
        if token == "(":
            self._open(offset)
        elif token == ")":
            self._close(offset)
        elif token in _REMEDIES:
            refuse(f"{token!r} cannot stand in an expression: {_REMEDIES[token]}.", offset)
        elif token in ("<<", ">>", "->"):
            refuse(f"{token!r} cannot stand in an expression: {_ALLOWED}.", offset)
        elif token == ",":
            self._comma(offset)
        elif token in ("+", "-") and not self.valued:
            self._tighten()
        else:
            self._after_value(token, offset)
            if token == "**":
                self._tighten()
            else:
                self._end_tight(self.levels[-1])
                self._lengthen(token)

    def _after_value(self, token: str, offset: int) -> None:
        if not self.valued:
            refuse(f"a value is missing before {token!r}.", offset)
        self.valued = False

    def _lengthen(self, token: str) -> None:
        level = self.levels[-1]
        if token in ("*", "/"):
            level.factors += 1
            self.chain += 1
        elif token in ("+", "-"):
            level.terms += 1
            self.chain += 1 - level.factors
            level.factors = 0
        else:
            self._end_chain(level)

    def _end_chain(self, level: _Level) -> None:
        self.chain -= level.terms + level.factors
        level.terms = level.factors = 0

    def _tighten(self) -> None:
        self.levels[-1].tight += 1
        self.depth += 1

    def _complete(self, level: _Level) -> None:
        if level.waiting:
            refuse("an 'if' has no 'else': write a condition as in a if x < 0 else b.", level.offset)

    def _end_tight(self, level: _Level) -> None:
        self.depth -= level.tight
        level.tight = 0

    def _open(self, offset: int) -> None:
        if self.valued:
            refuse("an operator is missing before '(': write a product with *, as in 2*(x + y).", offset)
        self.levels.append(_Level(offset, call=self.called))
        self.called = ""
        self.depth += 1

    def _close(self, offset: int) -> None:
        if len(self.levels) == 1:
            refuse("')' closes nothing: remove it, or add '(' before.", offset)
        self._after_value(")", offset)
        level = self.levels.pop()
        self._complete(level)
        self._end_chain(level)
        self.depth -= level.tight + level.conditions + 1
        self.valued = True

    def _comma(self, offset: int) -> None:
        level = self.levels[-1]
        if not level.call:
            refuse("',' separates the arguments of a function only: write decimals with a point, as in 9.81.", offset)
        self._after_value(",", offset)
        self._complete(level)
        self._end_chain(level)
        self.depth -= level.tight + level.conditions
        level.tight = level.conditions = 0


_ALLOWED = "the operators are + - * / ** and the comparisons < <= > >= == !="


def _refuse_character(text: str, offset: int) -> NoReturn:
    character = text[offset]
    if ord(character) > 126 or ord(character) < 32:
        refuse(_unknown_letter(character), offset)
    if character == "'" and offset and _LETTER.match(text[offset - 1]):
        refuse("a prime is no derivative here: the velocity of x is x_dot, its acceleration x_ddot.", offset)
    refuse(f"{character!r} cannot stand in an expression: {_REMEDIES.get(character, _ALLOWED)}.", offset)


def _unknown_letter(character: str) -> str:
    name = unicodedata.name(character, "control character")
    return (
        f"the character U+{ord(character):04X} ({name}) cannot stand in an expression: write letters A to Z, a to z "
        "and Greek ones without accents, digits and + - * / **."
    )
