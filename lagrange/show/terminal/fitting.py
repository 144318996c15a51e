"""Text that fits the width of the terminal: longer lines are wrapped under the column in which they began."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import TextIO

LEAST_WIDTH = 40
"""Width in columns below which lines are not wrapped: it would not make them easier to read."""

_FIRST_COLUMN = re.compile(r"\s*\S+(?: \S+)*\s{2,}")
"""Matches the first column of a table row."""


def fitted(text: str, stream: TextIO | None) -> str:
    """Return text for a stream: wrapped to the width of a terminal, unchanged for a pipe or a file."""
    if stream is None or not stream.isatty():
        return text
    columns = shutil.get_terminal_size().columns
    return text if columns < LEAST_WIDTH else "\n".join(_broken(line, columns) for line in text.split("\n"))


def _broken(line: str, columns: int) -> str:
    """Wrap a line to at most `columns` characters. A longer word stays whole; a rule of dashes is cut off."""
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
