"""Lines of source text: breaks in long ones, and comments in plain ASCII."""

from __future__ import annotations

import textwrap
import unicodedata
from collections.abc import Iterable

from lagrange.export.identifiers import spelled_letter

TEXT_WIDTH = 110
"""Largest length of a line of comment, or of the head of a function, in exported files."""


DEFAULT_LINE_LENGTH = 120
"""Default limit of characters per line, for languages without a limit."""


def continued(line: str, room: int = DEFAULT_LINE_LENGTH, mark: str = "") -> list[str]:
    """Return a statement as lines of at most `room` characters, broken at spaces; all but the last end with `mark`."""
    indent, lines = " " * (len(line) - len(line.lstrip()) + 4), []
    while len(line) > room:
        cut = line.rfind(" ", len(indent), room - len(mark))
        if cut < 0:
            break
        lines.append(f"{line[:cut]} {mark}".rstrip())
        line = indent + line[cut + 1 :]
    return [*lines, line]


def number_lines(values: Iterable[str], indent: str, width: int = 110, end: str = ",") -> list[str]:
    """Return literals on lines of a width. `end` is the comma that follows each literal."""
    text = textwrap.wrap(" ".join(f"{value}{end}" for value in values), width - len(indent), break_long_words=False)
    return [f"{indent}{line}" for line in text]


TOGETHER, KEPT = "\N{NO-BREAK SPACE}", "\x1f"
"""A space at which no line is broken, and the character that replaces it while lines are broken."""


def plain(text: str) -> str:
    """Return a text in ASCII without the end mark of a comment; Greek letters are spelled by name."""
    spelled = "".join(map(spelled_letter, text))
    ascii_only = unicodedata.normalize("NFKD", spelled).encode("ascii", "replace").decode("ascii")
    printable = "".join(letter if letter.isprintable() else " " for letter in ascii_only)
    return printable.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def wrapped(text: str, width: int) -> list[str]:
    """Return a text in lines of a width, at least one; a line that goes on is indented."""
    ascii_text = KEPT.join(map(plain, text.split(TOGETHER)))
    lines = textwrap.wrap(ascii_text, width, subsequent_indent="  ", break_long_words=False)
    return [line.replace(KEPT, " ") for line in lines] or [""]


def commented(text: str, mark: str, width: int = 110) -> list[str]:
    """Return a text as comment lines that begin with a mark, such as "//"."""
    return [f"{mark} {line}".rstrip() for line in wrapped(text, width - len(mark) - 1)]
