"""Panels of an animation with time to the right: energies and coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from lagrange.show.animation.axis import Axis, around
from lagrange.show.animation.motion import Motion
from lagrange.show.animation.sheet import FIRST, GRID, INK, KINETIC, POTENTIAL, QUIET, Chart, Stroke, Words
from lagrange.show.notation.text import UnicodeNotation
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

MOST_PANELS = 6
"""More coordinates than this share panels: a frame has room for no more."""

MOST_NAMED = 8
"""A panel names its curves if there are no more: others would not be told apart by their colours."""

_ROUND_OFF = 1e-6
"""Energies that differ by less than this part of them look the same: a pixel of a million."""

_GAP = 2.5
"""Where the energies extend over so many times as much as with the least potential for zero, that is their zero: the
zero of a potential is arbitrary, and curves far apart are seen as straight lines."""

WIDE = 0.6
"""The width of a mark of text, in parts of its size, for letters of any kind."""


@dataclass(frozen=True)
class Area:
    """A part of the picture in pixels, with the factor of all sizes."""

    left: float
    top: float
    width: float
    height: float
    unit: float


@dataclass(frozen=True, eq=False)
class Panel:
    """What a chart shows: rows (R, S), their names and colours, and the heading."""

    heading: str
    rows: FloatArray
    names: tuple[str, ...]
    colours: tuple[int, ...]
    scale: float = 0.0
    """A size of the values: what differs by its round-off is level."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A panel as what moves in it and what stands still around it."""

    chart: Chart
    strokes: tuple[Stroke, ...]
    words: tuple[Words, ...]


def energy_panel(motion: Motion) -> Panel | None:
    """Return the energies, that of the equations in ink, or None where there are none.

    It is v.p - L, which need not be the sum of the other two: not in a frame that turns.
    """
    if not motion.energies:
        return None
    names = tuple(motion.energies)
    if len(names) == 1:
        return Panel("energy", np.array([motion.energies[names[0]]]), (), (INK,), motion.scale)
    kinetic, potential, energy = motion.energies.values()
    least = float(potential.min())
    rows = np.array([kinetic, potential, energy])
    shifted = rows - [[0.0], [least], [least]]
    low = np.ptp(rows) > _GAP * np.ptp(shifted)
    scale = float(np.abs([kinetic, potential]).max())
    total = bool(np.abs(kinetic + potential - energy).max() <= _ROUND_OFF * scale)
    named = "kinetic", "potential", "total" if total else "v·p − L, which is not their sum"
    heading = "energy above the least potential:" if low else "energy:"
    return Panel(heading, shifted if low else rows, named, (KINETIC, POTENTIAL, INK))


def coordinate_panels(statement: Statement, motion: Motion) -> list[Panel]:
    """Return the coordinates, at most `MOST_PANELS` panels of as many each."""
    names = statement.names
    spelled = UnicodeNotation(names)
    letters = [with_unit(spelled.letter(name), unit_of(statement, name)) for name in names]
    together = ceil(len(names) / MOST_PANELS)
    panels = []
    for begin in range(0, len(names), together):
        chosen = slice(begin, begin + together)
        rows = motion.states[: len(names)][chosen]
        own = tuple(FIRST + (k if together > 1 else begin) for k in range(len(rows)))
        if len(rows) == 1:
            panels.append(Panel(letters[begin], rows, (), own))
        elif len(rows) <= MOST_NAMED:
            panels.append(Panel("", rows, tuple(letters[chosen]), own))
        else:
            panels.append(Panel(f"{letters[begin]} to {letters[begin + len(rows) - 1]}", rows, (), own))
    return panels


def drawn(panel: Panel, t: FloatArray, area: Area, *, time_label: str) -> Drawn:
    """Return a panel in an area; the time axis is named, and has numbers, if there is a label for it."""
    u = area.unit
    top, bottom = area.top + 18 * u, area.top + area.height - (30 * u if time_label else 6 * u)
    left, right = area.left + 48 * u, area.left + area.width - 14 * u
    first, last = (float(t[0]), float(t[-1])) if len(t) > 1 else (float(t[0]) - 0.5, float(t[0]) + 0.5)
    across, up = (
        Axis(min(first, last), max(first, last), left, right),
        Axis(*around(panel.rows, 0.08, panel.scale), bottom, top),
    )
    strokes = [Stroke(np.array([[left, left, right], [top, bottom, bottom]]), QUIET, 0.8 * u)]
    words = []
    for value, label in across.ticks(round((right - left) / (70 * u))):
        x = float(across.place(value))
        strokes.append(Stroke(np.array([[x, x], [top, bottom]]), GRID, 0.7 * u))
        if time_label:
            words.append(Words(label, x, bottom + 13 * u, 10 * u, "middle"))
    if time_label:
        words.append(Words(time_label, right, bottom + 26 * u, 10 * u, "end"))
    for value, label in up.ticks(max(2, round((bottom - top) / (30 * u)))):
        y = float(up.place(value))
        strokes.append(Stroke(np.array([[left, right], [y, y]]), GRID, 0.7 * u))
        words.append(Words(label, left - 5 * u, y + 3.5 * u, 10 * u, "end"))
    words += heading(panel, left, right, area.top + 11 * u, u)
    box = left, top, right, bottom
    rows = up.place(panel.rows)
    ends = float(across.place(float(t[0]))), float(across.place(float(t[-1])))
    return Drawn(Chart(rows, panel.colours, box, *ends), (*strokes[1:], strokes[0]), tuple(words))


def heading(panel: Panel, x: float, right: float, y: float, u: float) -> list[Words]:
    """Return the heading of a panel in one line: its name, then those of its curves in their colours.

    Where there is no room for both the names of the curves stand alone.
    """
    name = panel.heading
    wide = (len(name) + 1) * WIDE * 11 * u if name else 0.0
    if panel.names and x + wide + legend_width(panel.names, u) > right:
        name, wide = "", 0.0
    words = [Words(name, x, y, 11 * u)] if name else []
    x += wide
    return [*words, *legend(panel.names, panel.colours, x, y, u)]


def legend(names: tuple[str, ...], own: tuple[int, ...], x: float, y: float, u: float) -> list[Words]:
    """Return names in a line from x, each behind a dot of its colour."""
    words = []
    for name, colour in zip(names, own, strict=False):
        words += [Words("●", x, y, 9 * u, colour=colour), Words(name, x + 11 * u, y, 11 * u)]
        x += legend_width((name,), u)
    return words


def legend_width(names: tuple[str, ...], u: float) -> float:
    """Return how many pixels such a line takes."""
    return sum(24 * u + WIDE * 11 * u * len(name) for name in names)
