"""Record from which every renderer draws an animation: fixed and moving parts, in pixels and by colour index.

A frame drawn with Matplotlib and one drawn by a browser differ only in their letters. y grows downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.show.figures.style import Style, colours
from lagrange.trajectory.trajectory import FloatArray

PAPER, INK, QUIET, GRID, KINETIC, POTENTIAL, FIRST = range(7)
"""Colour indices: background, text, pale text and grid of a style, two energies, and the first colour of lines."""

DOT, FIXED = "dot", "fixed"
"""Kinds of marks: a moving point, and a fixed one."""


def palette(style: Style, count: int) -> tuple[str, ...]:
    """Return the colours of a style by index, with `count` colours of lines."""
    energies = style.colours[3], style.colours[4]
    return (style.paper, style.ink, style.quiet, style.grid, *energies, *colours(count, style.colours))


@dataclass(frozen=True, eq=False)
class Stroke:
    """A fixed line through points (2, N)."""

    points: FloatArray
    colour: int
    width: float
    opacity: float = 1.0


@dataclass(frozen=True)
class Words:
    """A text; its anchor (start, middle or end) is at a point on its baseline."""

    text: str
    x: float
    y: float
    size: float
    anchor: str = "start"
    colour: int = INK
    bold: bool = False


@dataclass(frozen=True)
class Mark:
    """A track, with a dot or a square at its present position."""

    track: int
    colour: int
    kind: str


@dataclass(frozen=True)
class Joint:
    """A rod or a spring between two tracks."""

    start: int
    end: int
    kind: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over time: rows (R, S) of y in pixels, drawn up to the present, in a box left, top, right, bottom.

    `first` and `last` are x of the first and the last sample.
    """

    rows: FloatArray
    colours: tuple[int, ...]
    box: tuple[float, float, float, float]
    first: float
    last: float


@dataclass(frozen=True, eq=False)
class Sheet:
    """An animation in pixels: tracks (P, 2, S) of S samples, of which every `detail`-th is a frame.

    `tail` is the length of a trail in samples, `unit` the scale factor of all sizes: 1 at a width of 640. `shadows` are
    pairs of a track and its shadow on the floor. The clock shows t, from `span[0]` to `span[1]`, followed by a unit.
    """

    size: tuple[int, int]
    unit: float
    detail: int
    strokes: tuple[Stroke, ...]
    words: tuple[Words, ...]
    clock: Words
    span: tuple[float, float]
    decimals: int
    time_unit: str
    tracks: FloatArray
    marks: tuple[Mark, ...]
    joints: tuple[Joint, ...]
    trails: tuple[tuple[int, int], ...]
    shadows: tuple[tuple[int, int], ...]
    tail: int
    charts: tuple[Chart, ...]
    lines: int
    """Number of colours that distinguish lines."""

    @property
    def samples(self) -> int:
        """Number of samples of tracks and charts, S."""
        return int(self.tracks.shape[2])

    @property
    def frames(self) -> int:
        """Number of frames."""
        return (self.samples - 1) // self.detail + 1

    def clock_text(self, t: float) -> str:
        """Return the text of the clock."""
        shown = f"{t:.{self.decimals}f}"
        shown = shown if float(shown) else shown.replace("-", "")
        return f"t = {shown.replace('-', '−')}{self.time_unit}"
