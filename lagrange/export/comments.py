"""Text for comments: plain ASCII, in lines of a width."""

from __future__ import annotations

import textwrap
import unicodedata

from lagrange.export.identifiers import spelled_letter

TOGETHER, KEPT = "\N{NO-BREAK SPACE}", "\x1f"
"""Character for a space without a line break, and its replacement while lines are broken."""


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
