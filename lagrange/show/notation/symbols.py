"""Names and sentences of the user in LaTeX, Markdown and plain text, with special characters escaped.

LaTeX and Markdown have commands: a name or a title must not be read as a command.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from lagrange.statement.vocabulary.letters import GREEK as LETTERS

UNICODE_GREEK = {name: letter for letter, name in LETTERS.items()} | {"Pi": "Π"}
"""Greek letters by name, for names that are letters in LaTeX. "pi" is missing: it is always printed as the number."""

GREEK = frozenset(UNICODE_GREEK)

_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{mark: "\\" + mark for mark in "{}$&#_%"},
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    **{letter: f"\\ensuremath{{\\{name}}}" for letter, name in LETTERS.items()},
}
_BRACKETS = str.maketrans("[]", "__")
"""Translation of brackets to underscores. Brackets enclose an index, as in lambda[rod], the multiplier of the
constraint rod."""

_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>()#+\-.!|$~&@:])")


@dataclass(frozen=True)
class Letter:
    """A symbol in LaTeX: `head`, a letter or an upright word, and `index`, which may be empty."""

    head: str
    index: str = ""

    def __str__(self) -> str:
        return self.head + self._below()

    def dotted(self, times: int) -> str:
        """Return the time derivative of order `times`, 1 or 2: the letter with dots above it, and its index."""
        return f"\\{'d' * times}ot{{{self.head}}}{self._below()}"

    def _below(self) -> str:
        return f"_{{{self.index}}}" if self.index else ""


def index_parts(name: str) -> tuple[str, list[str]]:
    """Return a name as a letter or word and a list of its indices.

    theta1 has the index 1, m_bob has bob, and lambda[rod] has rod.
    """
    head, *indices = [part for part in name.translate(_BRACKETS).split("_") if part]
    letters, digits = _split_digits(head)
    return letters, [part for part in (digits, *indices) if part]


def letters(names: Iterable[str]) -> dict[str, Letter]:
    """Return a dict from each name to its symbol in LaTeX; different names have different symbols."""
    result: dict[str, Letter] = {}
    for name in names:
        letter = letter_of(name)
        result[name] = letter if letter not in result.values() else letter_of(name, literal=True)
    return result


def letter_of(name: str, *, literal: bool = False) -> Letter:
    """Return the symbol of a name in LaTeX: theta1, m_bob and lambda[rod] have an index.

    With `literal` the whole name is written as one upright word.
    """
    if literal:
        return Letter(upright(name))
    head, parts = index_parts(name)
    return Letter(word(head), ", ".join(index_word(part) for part in parts))


def latex_text(sentence: str) -> str:
    """Return a sentence for LaTeX's text mode, with special characters escaped."""
    return "".join(_LATEX.get(mark, mark) for mark in plain_text(sentence))


def markdown_text(sentence: str) -> str:
    """Return a sentence for Markdown, with special characters escaped."""
    return _MARKDOWN.sub(r"\\\1", plain_text(sentence))


def plain_text(sentence: str) -> str:
    """Return a sentence on one line, without control characters of a terminal."""
    return "".join(mark for mark in " ".join(sentence.split()) if mark.isprintable())


def index_word(name: str) -> str:
    """Return the LaTeX of an index by its name, such as theta1: a letter or a word, followed by its digits."""
    letters, digits = _split_digits(name)
    return (word(letters) if letters else "") + digits


def _split_digits(text: str) -> tuple[str, str]:
    letters = text.rstrip("0123456789")
    return letters, text[len(letters) :]


def word(name: str) -> str:
    """Return the LaTeX of a name that has no digits: a Latin or Greek letter, or a word in upright letters."""
    name = LETTERS.get(name, name)
    if name in GREEK:
        return f"\\{name}"
    return name if len(name) == 1 else upright(name)


def upright(word: str) -> str:
    """Return a word in LaTeX, in upright letters."""
    word = latin(word)
    return "\\mathrm{" + word.replace("_", "\\_") + "}"


def latin(name: str) -> str:
    """Return a name with its Greek letters spelled out: θ1 becomes theta1."""
    return "".join(LETTERS.get(mark, mark) for mark in name)
