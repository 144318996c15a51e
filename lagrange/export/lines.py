"""Break lines of source text that are too long."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

LONGEST = 120
"""Default limit of characters per line, for languages without a limit."""


def continued(line: str, room: int = LONGEST, mark: str = "") -> list[str]:
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
    """Return literals on lines of a width, each followed by `end`, a comma."""
    text = textwrap.wrap(" ".join(f"{value}{end}" for value in values), width - len(indent), break_long_words=False)
    return [f"{indent}{line}" for line in text]
