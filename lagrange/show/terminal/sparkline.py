"""A run at a glance on a terminal: its first coordinates over time, drawn with the dots of Braille letters."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

from lagrange.show.terminal.languages import terminal_style

if TYPE_CHECKING:
    from lagrange.show.solution import Solution

MOST_CURVES, ROWS = 2, 2
"""Coordinates that are drawn, and lines of text for each: with four dots a line a curve has eight levels."""

LEAST_WIDTH, MOST_WIDTH = 40, 100
"""Columns of a terminal: with fewer nothing is drawn, with more no more are used."""

SAMPLES = 16
"""Times for each column of dots, of which the least and the largest value are drawn: a fast motion is a band."""

_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""What each dot adds to the number of a Braille letter: the left column from above, then the right one."""

_BLANK = 0x2800


def sketch(solution: Solution) -> str:
    """Return the first coordinates of a run over time, with their largest and least values.

    Empty where standard output is no terminal that has Unicode, or too narrow, and where there is nothing to draw.
    """
    columns = min(shutil.get_terminal_size().columns - 1, MOST_WIDTH)
    if terminal_style() != "unicode" or columns < LEAST_WIDTH or not len(solution.t):
        return ""
    first, last = float(solution.t[0]), float(solution.t[-1])
    names = solution.names[: min(MOST_CURVES, len(solution.names) // 2)]
    label = min(max(map(len, names)), 12)
    width = columns - label - 12
    count = 2 * width * SAMPLES
    if first == last:
        return ""
    states = solution.at([first + (last - first) * i / (count - 1) for i in range(count)])
    lines = []
    for name, row in zip(names, states[: len(names)].tolist(), strict=True):
        if not all(map(isfinite, row)):
            return ""
        pieces = [row[i : i + SAMPLES] for i in range(0, count, SAMPLES)]
        drawn = curve([(min(piece), max(piece)) for piece in pieces], ROWS)
        values = [f"{max(row):.4g}", *[""] * (ROWS - 2), f"{min(row):.4g}"]
        heads = [name[:label], *[""] * (ROWS - 1)]
        lines += [f"{head:{label}} {value:>10} {text}" for head, value, text in zip(heads, values, drawn, strict=True)]
    ends = f"t = {first:.6g}", f"{last:.6g}"
    return "\n".join([*lines, f"{'':{label + 12}}{ends[0]}{ends[1]:>{max(1, width - len(ends[0]))}}"])


def curve(bands: Sequence[tuple[float, float]], rows: int) -> list[str]:
    """Return lines of Braille letters, the highest first; each band from low to high is one of two columns of a letter.

    Neighbours touch, so that a steep curve has no gaps. A constant stands in the middle.
    """
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    levels = 4 * rows
    flat = high - low <= 1e-9 * max(abs(low), abs(high))

    def level(value: float) -> int:
        return levels // 2 if flat else min(levels - 1, int((high - value) / (high - low) * levels))

    letters = [[_BLANK] * (len(bands) // 2) for _ in range(rows)]
    before: tuple[int, int] | None = None
    for place, band in enumerate(bands[: 2 * (len(bands) // 2)]):
        top, bottom = level(band[1]), level(band[0])
        if before is not None:
            top, bottom = min(top, before[1] + 1), max(bottom, before[0] - 1)
        before = level(band[1]), level(band[0])
        for dot in range(max(top, 0), min(bottom, levels - 1) + 1):
            letters[dot // 4][place // 2] |= _BITS[place % 2][dot % 4]
    return ["".join(map(chr, line)) for line in letters]
