"""The tokens of an expression in a scene file, with the limits on its length."""

from __future__ import annotations

import keyword
import re
import unicodedata
from typing import NamedTuple, NoReturn

from lagrange.errors import SceneError
from lagrange.statement.vocabulary.letters import LETTER, NAME, WORD

LONGEST_EVALUATED = 10_000  # Largest number of characters of an expression
LONGEST_UNEVALUATED = 1_000_000
"""Largest number of characters of an unevaluated expression, on which SymPy does no work."""
LONGEST_NUMBER, LONGEST_UNEVALUATED_NUMBER = 100, 400
"""Largest number of characters of a number; in unevaluated expressions those of 1,000 bits, and a few more."""

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
    "&": "chain comparisons, as in 0 < x < 1",
    "|": "nest conditions, as in a if x < 0 else b",
    "#": "comments belong outside the expression",
    **dict.fromkeys(("<<", ">>", "->"), _ALLOWED),
}
_RESERVED = {
    "and": "chain comparisons, as in 0 < x < 1",
    "or": "nest conditions, as in a if x < 0 else b",
    "not": "turn the comparison round",
    "True": "write a number",
    "False": "write a number",
    "None": "write a number",
}


class SceneToken(NamedTuple):
    """A number, name, word or operator at an offset of a text. Words have a meaning in the grammar, such as `if`."""

    kind: str
    text: str
    offset: int


def refuse(reason: str, offset: int) -> NoReturn:
    """Raise a SceneError that points at this offset (from 0) of the text."""
    raise SceneError(reason, column=offset + 1)


def tokens(text: str, *, unevaluated: bool = False) -> list[SceneToken]:
    """Return the tokens of a text, and a last one of kind "end". Raises SceneError if the text is not allowed.

    If `unevaluated` is true, and, or, not, True, False and None are allowed as well.
    """
    if not isinstance(text, str):
        raise SceneError(f"an expression must be a text such as '2*x', not {type(text).__name__}.")
    most = LONGEST_UNEVALUATED if unevaluated else LONGEST_EVALUATED
    if len(text) > most:
        refuse(f"the expression has {len(text)} characters, more than {most}: state it in parts.", most)
    if not text.strip():
        refuse("the expression is empty: write 0 if there is nothing.", 0)
    words = ("if", "else", *(_RESERVED if unevaluated else ()))
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

    `following` is the character after it; a letter there is refused.
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
        refuse(f"{name!r} is a reserved word: {_RESERVED.get(name, 'choose another name')}.", offset)
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
