"""Lines of source text that are short enough."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

LONGEST = 120
"""Characters of a statement where a language has no limit of its own."""


def continued(line: str, room: int = LONGEST, mark: str = "") -> list[str]:
    """Return a statement on lines of so many characters, broken at spaces; those that go on end with a mark."""
    indent, lines = " " * (len(line) - len(line.lstrip()) + 4), []
    while len(line) > room:
        cut = line.rfind(" ", len(indent), room - len(mark))
        if cut < 0:
            break
        lines.append(f"{line[:cut]} {mark}".rstrip())
        line = indent + line[cut + 1 :]
    return [*lines, line]


def number_lines(values: Iterable[str], indent: str, width: int = 110) -> list[str]:
    """Return literals on lines of a width, each with a comma behind it."""
    text = textwrap.wrap(" ".join(f"{value}," for value in values), width - len(indent), break_long_words=False)
    return [f"{indent}{line}" for line in text]
