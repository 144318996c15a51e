"""Text for a terminal: tables, durations, lines wrapped to its width, and the style of derivations that it supports."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from typing import TextIO


def duration(seconds: float) -> str:
    """Return a time as text in seconds, milliseconds or microseconds."""
    for limit, factor, unit in ((1e-3, 1e6, "us"), (1.0, 1e3, "ms")):
        if seconds < limit:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds:.3g} s"


LEAST_WIDTH = 40
"""Width of a terminal in columns below which lines are not wrapped, because wrapping would not help."""

USUAL_WIDTH = 100  # Width in columns of tables for an output that is not a terminal
_FIRST_COLUMN = re.compile(r"\s*\S+(?: \S+)*\s{2,}")  # Matches the first column of a table row


def fitted(text: str, stream: TextIO | None) -> str:
    """Return text for a stream: wrapped to the width of a terminal, unchanged for a pipe or a file."""
    if stream is None or not stream.isatty():
        return text
    columns = shutil.get_terminal_size().columns
    return text if columns < LEAST_WIDTH else "\n".join(_broken(line, columns) for line in text.split("\n"))


def columns_of_output() -> int:
    """Return the width in columns of a terminal at standard output, or `USUAL_WIDTH`."""
    terminal = sys.stdout is not None and sys.stdout.isatty()
    return shutil.get_terminal_size().columns if terminal else USUAL_WIDTH


def _broken(line: str, columns: int) -> str:
    """Return a line broken to at most `columns` characters. A longer word stays whole; a line of dashes is cut off."""
    if len(line) <= columns:
        return line
    if not line.strip(" -"):
        return line[:columns].rstrip()
    match = _FIRST_COLUMN.match(line)
    begin = match.end() if match and match.end() <= columns // 2 else len(line) - len(line.lstrip()) + 2
    head, rest = (line[:begin], line[begin:]) if match and match.end() == begin else ("", line)
    parts = textwrap.wrap(
        rest,
        columns,
        initial_indent=" " * len(head),
        subsequent_indent=" " * begin,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )
    return "\n".join([head + parts[0][len(head) :], *parts[1:]])


DETAILS = ("full", "short")
FORMATS = ("text", "unicode", "latex", "markdown", "html")
ABOVE = ("title", "author", "date", "problem")
"""Levels of detail of a derivation, its formats, and the texts that may be above it."""


def terminal_style() -> str:
    """Return "unicode" if standard output is a terminal that supports Unicode, else "text", which is plain ASCII."""
    stream = sys.stdout
    if stream is None or not stream.isatty():
        return "text"
    return "unicode" if (stream.encoding or "").lower().replace("-", "").startswith("utf") else "text"
