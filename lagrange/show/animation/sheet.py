"""The record that every drawer of an animation reads: what stands still and what moves, in pixels and by colour number.

A frame drawn with Matplotlib and one drawn by a browser differ by their letters alone. y grows downwards.
"""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.show.figures.style import Style, colours
from lagrange.trajectory.trajectory import FloatArray

PAPER, INK, QUIET, GRID, KINETIC, POTENTIAL, FIRST = range(7)
"""Numbers of colours: paper, ink and the quiet ones of a style, two energies, and the first that tells lines apart."""

DOT, FIXED = "dot", "fixed"
"""Marks: a point that moves, and one that does not."""


def palette(style: Style, count: int) -> tuple[str, ...]:
    """Return the colours of a style by number, with as many to tell lines apart."""
    energies = style.colours[3], style.colours[4]
    return (style.paper, style.ink, style.quiet, style.grid, *energies, *colours(count, style.colours))


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line that stands still, through points (2, N)."""

    points: FloatArray
    colour: int
    width: float
    opacity: float = 1.0


@dataclass(frozen=True)
class Words:
    """A text at a point of its baseline; `anchor` is start, middle or end."""

    text: str
    x: float
    y: float
    size: float
    anchor: str = "start"
    colour: int = INK
    bold: bool = False


@dataclass(frozen=True)
class Mark:
    """A track with a dot or a square where it is."""

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
    """Curves over time: rows (R, S) of y in pixels, drawn as far as the time is, in a box left, top, right, bottom.

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

    `tail` is the length of a trail in samples, `unit` the factor of all sizes: 1 at a width of 640. `shadows` are pairs
    of a track and its shadow on the floor. The clock shows t, which goes from `span[0]` to `span[1]`, with a unit
    behind it.
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
    """How many colours tell lines apart."""

    @property
    def samples(self) -> int:
        """How many samples tracks and charts have, S."""
        return int(self.tracks.shape[2])

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return (self.samples - 1) // self.detail + 1

    def clock_text(self, t: float) -> str:
        """Return what the clock shows."""
        shown = f"{t:.{self.decimals}f}"
        shown = shown if float(shown) else shown.replace("-", "")
        return f"t = {shown.replace('-', '−')}{self.time_unit}"
