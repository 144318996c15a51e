"""Text that is as wide as the terminal: longer lines go on below, under the column in which they began."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import TextIO

LEAST_WIDTH = 40
"""Columns below which lines stay as they are: broken, they would be no easier to read."""

_FIRST_COLUMN = re.compile(r"\s*\S+(?: \S+)*\s{2,}")
"""What stands before the second column of a table."""


def fitted(text: str, stream: TextIO | None) -> str:
    """Return text for a stream: on a terminal no wider than that, in a pipe or a file each line as it is."""
    if stream is None or not stream.isatty():
        return text
    columns = shutil.get_terminal_size().columns
    return text if columns < LEAST_WIDTH else "\n".join(_broken(line, columns) for line in text.split("\n"))


def _broken(line: str, columns: int) -> str:
    """Return a line in lines of at most so many columns, but for words that are longer. Rules of dashes are cut."""
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
