"""Tokens of a typed formula: words, numbers, signs and LaTeX commands, each with its place in the text.

Nothing is looked up here: whether a word is a symbol of the system is for `typed.names` to say.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from lagrange.statement.typed.latex import (
    COMMAND_SIGNS,
    DERIVATIVES,
    FRACTIONS,
    FUNCTION_COMMANDS,
    LETTER_COMMANDS,
    SPACES,
    WORD_GROUPS,
)

DOTS = {"\N{COMBINING DOT ABOVE}": 1, "\N{COMBINING DIAERESIS}": 2}
"""Combining marks above a letter, and the order of the time derivative that each stands for."""

PRIMES = {"'": 1, "’": 1, "‘": 1, "′": 1, "´": 1, "`": 1, '"': 2, "″": 2, "”": 2, "“": 2}
"""Marks after a letter that stand for derivatives, and their order."""

SIGNS = {
    **{mark: mark for mark in "+-*/^=()[]{}|,"},
    **dict.fromkeys("\u2212\u2013\u2014\u2010\u2011\u2012", "-"),
    **dict.fromkeys("·⋅×∗•", "*"),
    **dict.fromkeys("÷∕⁄", "/"),
    "√": "sqrt",
}
"""Signs of a formula, and what each means."""

GREEK_VARIANTS = {"ϕ": "phi", "ϑ": "theta", "ϵ": "epsilon", "ϱ": "rho", "µ": "mu", "π": "pi", "ℓ": "ell", "ς": "sigma"}
"""Letters that look like those of a name but are other characters."""

_NUMBER = re.compile(r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+(?![A-Za-z0-9_]))?")
_COMMAND = re.compile(r"\\([A-Za-z]+|.)", re.DOTALL)
_BLANK = re.compile(r"[\s~&$\u00a0\u2009\u200b\u2061\u2062\u2063]+")
_GROUP = re.compile(r"\s*\{\s*([^{}]*?)\s*\}")
_INDEX = re.compile(r"\s*_\s*(?:\{((?:[^{}]|\{[^{}]*\})*)\}|\\([A-Za-z]+)|([A-Za-z0-9]))")
_INDEX_COMMAND = re.compile(rf"\\(?:{'|'.join(WORD_GROUPS)})(?![A-Za-z])|[{{}}\\]")
_PLAIN_INDEX = re.compile(r"_([0-9]+|[A-Za-z][A-Za-z0-9]*)")
_BRACKETED = re.compile(r"\[([A-Za-z][A-Za-z0-9_]*)\]")
_RATE = re.compile(r"\.(d{1,2}ot)\b")
_SUPERSCRIPT = re.compile(r"([⁺⁻]?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)")
_SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉ₐₑₕᵢⱼₖₗₘₙₒₚᵣₛₜᵤᵥₓ", "0123456789aehijklmnoprstuvx", strict=True))


@dataclass(frozen=True)
class Token:
    """One piece of a formula: its kind, its meaning, and the part text[begin:end] that it was made from.

    Kinds: "word", "number", "sign", "power" (a superscript), "prime" (text is the order), "index" (a subscript that
    follows a mark), "dots" (a LaTeX command for a derivative; text is the order), "fraction", "fault" (text is a
    sentence). `order` is the number of dots on the first letter of a word, `primes` that of marks after it. `spaced`
    is true where a blank stands before the token.
    """

    kind: str
    text: str
    begin: int
    end: int
    order: int = 0
    spaced: bool = False
    primes: int = 0

    def is_sign(self, *signs: str) -> bool:
        """Return whether the token is one of these signs."""
        return self.kind == "sign" and self.text in signs


def tokens_of(text: str, begin: int, end: int) -> list[Token]:
    """Return the tokens of text[begin:end]. A character that cannot be read becomes a token of kind "fault"."""
    return _Scanner(text, end).scan(begin)


class _Scanner:
    """Goes once through a text, from left to right."""

    def __init__(self, text: str, end: int) -> None:
        self.text, self.end = text[:end], end
        self.found: list[Token] = []
        self.spaced = False

    def scan(self, place: int) -> list[Token]:
        """Return all tokens from a place on."""
        while place < self.end:
            blank = _BLANK.match(self.text, place)
            if blank:
                self.spaced, place = True, blank.end()
                continue
            place = self._token(place)
        return self.found

    def _add(self, kind: str, text: str, begin: int, end: int, order: int = 0) -> int:
        self.found.append(Token(kind, text, begin, end, order, self.spaced))
        self.spaced = False
        return end

    def _token(self, place: int) -> int:
        """Add the token that begins at a place, and return the place after it."""
        mark = self.text[place]
        number = _NUMBER.match(self.text, place)
        if number:
            return self._add("number", number.group().removesuffix("."), place, number.end())
        superscript = _SUPERSCRIPT.match(self.text, place)
        if superscript:
            sign = "-" if superscript.group(1) == "⁻" else ""
            digits = unicodedata.normalize("NFKC", superscript.group(2))
            return self._add("power", sign + digits, place, superscript.end())
        if mark == "\\":
            return self._command(place)
        if self.text.startswith("**", place):
            return self._add("sign", "^", place, place + 2)
        if self.text.startswith("==", place):
            return self._add("sign", "=", place, place + 2)
        if mark in PRIMES:
            return self._add("prime", str(PRIMES[mark]), place, place + 1)
        if mark in SIGNS:
            return self._add("sign", SIGNS[mark], place, place + 1)
        if mark == "_" or mark in _SUBSCRIPTS:
            index, after = self._index(place)
            if index:
                return self._add("index", index, place, after)
        if _letter(mark):
            return self._word(place)
        vulgar = unicodedata.normalize("NFKC", mark)
        if "⁄" in vulgar:
            return self._add("number", "/".join(vulgar.split("⁄")), place, place + 1)
        return self._add("fault", f"the character {_named(mark)} cannot stand in an equation", place, place + 1)

    def _word(self, place: int) -> int:
        """Add a word: letters, digits and an index. A letter with dots begins a word of its own."""
        begin, spelled, order = place, "", 0
        while place < self.end:
            mark = self.text[place]
            if not (_letter(mark) or (mark.isascii() and mark.isdigit())):
                break
            letter, dots, after = _dotted(self.text, place, self.end)
            if dots and spelled:
                break
            spelled, order, place = spelled + letter, order or dots, after
            index, place = self._indices(place)
            spelled += index
            if place < self.end and self.text[place] in DOTS and not order:
                order, place = DOTS[self.text[place]], place + 1
        bracketed = _BRACKETED.match(self.text, place) if spelled in ("lambda", "λ") else None
        if bracketed:
            spelled, place = f"{spelled}_{bracketed.group(1)}", bracketed.end()
        rate = _RATE.match(self.text, place)
        if rate:
            order, place = order + len(rate.group(1)) - 2, rate.end()
        return self._add("word", spelled, begin, place, order)

    def _indices(self, place: int) -> tuple[str, int]:
        """Return all subscripts in a row at a place, and the place after them: _1_dot has two."""
        found = ""
        while True:
            index, after = self._index(place)
            if not index:
                return found, place
            found, place = found + index, after

    def _index(self, place: int) -> tuple[str, int]:
        """Return the subscript at a place, "" if there is none, and the place after it."""
        after = place
        while after < self.end and self.text[after] in _SUBSCRIPTS:
            after += 1
        if after > place:
            return "".join(_SUBSCRIPTS[mark] for mark in self.text[place:after]), after
        plain = _PLAIN_INDEX.match(self.text, place)
        if plain:
            return "_" + plain.group(1), plain.end()
        index = _INDEX.match(self.text, place)
        if index is None:
            return "", place
        inside = _INDEX_COMMAND.sub("", next(group for group in index.groups() if group is not None))
        return "_" + re.sub(r"[\s,]+", "_", inside.strip()), index.end()

    def _command(self, place: int) -> int:
        """Add what a LaTeX command stands for."""
        match = _COMMAND.match(self.text, place)
        if match is None:
            return self._add("fault", "a backslash stands at the end", place, place + 1)
        name, after = match.group(1), match.end()
        if name in SPACES or name.isspace() or name in ",;:!>":
            self.spaced = True
            return after
        if name in COMMAND_SIGNS:
            sign = COMMAND_SIGNS[name]
            return self._add("prime", "1", place, after) if sign == "'" else self._add("sign", sign, place, after)
        if name in "{}|":
            return self._add("sign", {"{": "(", "}": ")", "|": "|"}[name], place, after)
        if name in FRACTIONS:
            return self._add("fraction", name, place, after)
        if name in DERIVATIVES:
            return self._add("dots", str(DERIVATIVES[name]), place, after)
        if name in WORD_GROUPS:
            group = _GROUP.match(self.text, after)
            if group and group.group(1):
                index, end = self._indices(group.end())
                return self._add("word", group.group(1).replace("\\_", "_").replace(" ", "_") + index, place, end)
        if name in LETTER_COMMANDS or name in FUNCTION_COMMANDS:
            index, end = self._indices(after) if name in LETTER_COMMANDS else ("", after)
            word = LETTER_COMMANDS.get(name) or FUNCTION_COMMANDS[name]
            return self._add("word", word + index, place, end)
        return self._add("fault", f"the LaTeX command {_named(name[:30])} is not known here", place, after)


def _letter(mark: str) -> bool:
    """Return whether a character begins a word: a letter of any alphabet, so that a message names words whole."""
    return mark.isalpha()


def _dotted(text: str, place: int, end: int) -> tuple[str, int, int]:
    """Return the letter at a place as a name spells it, the dots on it, and the place after it."""
    begin, place = place, place + 1
    while place < end and unicodedata.combining(text[place]):
        place += 1
    base, *marks = list(unicodedata.normalize("NFD", text[begin:place]))
    if any(mark not in DOTS for mark in marks):
        return text[begin:place], 0, place
    return GREEK_VARIANTS.get(base, base), sum(DOTS[mark] for mark in marks), place


def _named(mark: str) -> str:
    """Return a character or a command as a message names it: control characters never reach a terminal."""
    if len(mark) > 1 or (mark.isascii() and mark.isalpha()):
        return f"\\{mark}"
    code = f"U+{ord(mark):04X}"
    return (
        f"{mark!r}"
        if mark.isprintable() and mark.isascii()
        else f"{code} ({unicodedata.name(mark, 'control character')})"
    )
