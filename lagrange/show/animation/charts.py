"""Panels of an animation with a horizontal time axis: energies and coordinates."""

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
"""Most panels of coordinates; more coordinates share them, as a frame has no room for more."""

MOST_NAMED = 8
"""Most curves of a panel with names: colours do not distinguish more."""

_ROUND_OFF = 1e-6
"""Relative difference below which two energies look the same: a millionth."""

_GAP = 2.5
"""Ratio of the range of the energies to that with the least potential as zero from which the latter is drawn. The zero
of a potential is arbitrary, and curves that are far apart look like straight lines."""

WIDE = 0.6
"""Width of a letter of any kind, in parts of the font size."""


@dataclass(frozen=True)
class Area:
    """A part of the picture in pixels, with the scale factor of all sizes."""

    left: float
    top: float
    width: float
    height: float
    unit: float


@dataclass(frozen=True, eq=False)
class Panel:
    """Content of a chart: rows (R, S), their names and colours, and the heading."""

    heading: str
    rows: FloatArray
    names: tuple[str, ...]
    colours: tuple[int, ...]
    scale: float = 0.0
    """Size of the values: differences below its rounding noise are level."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A panel in pixels: its moving and its fixed parts."""

    chart: Chart
    strokes: tuple[Stroke, ...]
    words: tuple[Words, ...]


def energy_panel(motion: Motion) -> Panel | None:
    """Return the panel of the energies, with the energy of the equations in the text colour, or None without energies.

    That energy is v.p - L. In a rotating frame, for example, it is not the sum of the other two.
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
    """Return the panels of the coordinates, at most `MOST_PANELS`, with about the same number in each."""
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
    """Return a panel in an area; the time axis has numbers and a name if `time_label` is not empty."""
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
    """Return the heading of a panel in one line: its name, then the names of its curves in their colours.

    If both do not fit, only the names of the curves are written.
    """
    name = panel.heading
    wide = (len(name) + 1) * WIDE * 11 * u if name else 0.0
    if panel.names and x + wide + legend_width(panel.names, u) > right:
        name, wide = "", 0.0
    words = [Words(name, x, y, 11 * u)] if name else []
    x += wide
    return [*words, *legend(panel.names, panel.colours, x, y, u)]


def legend(names: tuple[str, ...], own: tuple[int, ...], x: float, y: float, u: float) -> list[Words]:
    """Return names in a line from x, each after a dot of its colour."""
    words = []
    for name, colour in zip(names, own, strict=False):
        words += [Words("●", x, y, 9 * u, colour=colour), Words(name, x + 11 * u, y, 11 * u)]
        x += legend_width((name,), u)
    return words


def legend_width(names: tuple[str, ...], u: float) -> float:
    """Return the width of such a line in pixels."""
    return sum(24 * u + WIDE * 11 * u * len(name) for name in names)
