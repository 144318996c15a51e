"""Names and sentences on paper: what a person called things, in LaTeX, Markdown and plain text.

Nothing is printed as it came: LaTeX and Markdown are languages, and a name or a title must not speak them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from lagrange.statement.letters import GREEK as LETTERS

GREEK = frozenset((*LETTERS.values(), "Pi"))
"""Names that LaTeX has a letter for. Not pi, which is a number wherever it is printed."""

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
"""What is in brackets is an index: lambda[rod] is the multiplier of the constraint rod."""

_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>()#+\-.!|$~&@:])")


@dataclass(frozen=True)
class Letter:
    """A symbol in LaTeX: a letter or an upright word, and its indices, which may be empty."""

    head: str
    index: str = ""

    def __str__(self) -> str:
        return self.head + self._below()

    def dotted(self, times: int) -> str:
        """Return the first or second time derivative, the dots above the letter alone."""
        return f"\\{'d' * times}ot{{{self.head}}}{self._below()}"

    def _below(self) -> str:
        return f"_{{{self.index}}}" if self.index else ""


def letters(names: Iterable[str]) -> dict[str, Letter]:
    """Return the LaTeX of each name: theta1, m_bob and lambda[rod] get an index, and two names never look the same."""
    found: dict[str, Letter] = {}
    for name in names:
        letter = _letter(name)
        found[name] = letter if letter not in found.values() else Letter(_upright(name))
    return found


def latex_text(sentence: str) -> str:
    """Return a sentence for LaTeX's text mode, every mark as itself."""
    return "".join(_LATEX.get(mark, mark) for mark in plain_text(sentence))


def markdown_text(sentence: str) -> str:
    """Return a sentence for Markdown, every mark as itself."""
    return _MARKDOWN.sub(r"\\\1", plain_text(sentence))


def plain_text(sentence: str) -> str:
    """Return a sentence on one line, without the control characters that a terminal would obey."""
    return "".join(mark for mark in " ".join(sentence.split()) if mark.isprintable())


def _letter(name: str) -> Letter:
    head, *indices = [part for part in name.translate(_BRACKETS).split("_") if part]
    letters, digits = _split_digits(head)
    below = [digits, *(_index(part) for part in indices)]
    return Letter(word(letters), ", ".join(part for part in below if part))


def _index(part: str) -> str:
    letters, digits = _split_digits(part)
    return (word(letters) if letters else "") + digits


def _split_digits(text: str) -> tuple[str, str]:
    letters = text.rstrip("0123456789")
    return letters, text[len(letters) :]


def word(name: str) -> str:
    """Return a word without digits: a letter, Greek or not, or upright."""
    name = LETTERS.get(name, name)
    if name in GREEK:
        return f"\\{name}"
    return name if len(name) == 1 else _upright(name)


def _upright(word: str) -> str:
    word = "".join(LETTERS.get(mark, mark) for mark in word)
    return "\\mathrm{" + word.replace("_", "\\_") + "}"
