"""Format of CSV files: rows, and cells of numbers and texts."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import BinaryIO

_ROWS_AT_ONCE = 4096
"""Rows written in one call: one line at a time takes longer."""


def write_rows(file: BinaryIO, names: Sequence[str], columns: Sequence[Iterable[object]]) -> None:
    """Write columns under their names as CSV. Numbers round-trip."""
    lines = _lines(names, columns)
    while block := list(islice(lines, _ROWS_AT_ONCE)):
        file.write("".join(block).encode())


def cell(value: object) -> str:
    """Return a CSV cell (RFC 4180) of a number or a text. A number is written so that it round-trips.

    A text that starts with ``= + - @`` or a control character gets an apostrophe in front, because spreadsheets would
    run it as a formula.
    """
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return repr(float(value))
    text = str(value)
    if text.lstrip(" ").startswith(("=", "+", "-", "@", "\t", "\r", "\n")):
        text = "'" + text
    quoted = not text or any(mark in text for mark in ',"\r\n')
    return '"' + text.replace('"', '""') + '"' if quoted else text


def _lines(names: Sequence[str], columns: Sequence[Iterable[object]]) -> Iterator[str]:
    yield ",".join(map(cell, names)) + "\n"
    for row in zip(*columns, strict=True):
        yield ",".join(map(cell, row)) + "\n"
