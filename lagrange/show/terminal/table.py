"""Small tables, and durations, as plain text."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(headings: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return an aligned table with numbers to the right, and a rule under the headings if there are any."""
    cells = [[*map(str, row)] for row in rows]
    widths = [max(map(len, column)) for column in zip(headings, *cells, strict=True)]
    right = _numeric(rows, len(headings))
    lines = [_line(line, widths, right) for line in ([*headings], *cells)]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]] if any(headings) else lines[1:])


def _line(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    padded = zip(cells, widths, right, strict=True)
    return "  ".join(cell.rjust(width) if flush else cell.ljust(width) for cell, width, flush in padded).rstrip()


def _numeric(rows: Sequence[Sequence[object]], columns: int) -> list[bool]:
    """Return for each column whether it holds only numbers."""
    return [bool(rows) and all(isinstance(row[j], (int, float)) for row in rows) for j in range(columns)]


def duration(seconds: float) -> str:
    """Return a time as text in seconds, milliseconds or microseconds."""
    for limit, factor, unit in ((1e-3, 1e6, "us"), (1.0, 1e3, "ms")):
        if seconds < limit:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds:.3g} s"
