"""Text for comments: plain ASCII, in lines of a width."""

from __future__ import annotations

import textwrap
import unicodedata

from lagrange.export.identifiers import spelled_letter

TOGETHER, KEPT = "\N{NO-BREAK SPACE}", "\x1f"
"""Stands for a space at which no line is broken; and what it is while lines are broken."""


def plain(text: str) -> str:
    """Return a text in ASCII without what could end a comment: Greek letters by name, others as they look alike."""
    spelled = "".join(map(spelled_letter, text))
    ascii_only = unicodedata.normalize("NFKD", spelled).encode("ascii", "replace").decode("ascii")
    printable = "".join(letter if letter.isprintable() else " " for letter in ascii_only)
    return printable.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def wrapped(text: str, width: int) -> list[str]:
    """Return a text in lines of a width, at least one; a line that goes on is indented."""
    told = KEPT.join(map(plain, text.split(TOGETHER)))
    lines = textwrap.wrap(told, width, subsequent_indent="  ", break_long_words=False)
    return [line.replace(KEPT, " ") for line in lines] or [""]


def commented(text: str, mark: str, width: int = 110) -> list[str]:
    """Return a text as lines of comment behind a mark, such as "//"."""
    return [f"{mark} {line}".rstrip() for line in wrapped(text, width - len(mark) - 1)]
