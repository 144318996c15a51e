"""Data for the scripts of a page, besides the functions: names, positions, bounds and initial values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lagrange.equations.structure import Structure
from lagrange.page.motion import MOST_STEPS, TOLERANCE, MotionSource
from lagrange.show.figures.space import AZIMUTH, ELEVATION, spring
from lagrange.show.notation.names import plain_text
from lagrange.show.notation.text import UnicodeNotation
from lagrange.show.sliders import Slider
from lagrange.show.units import length_unit, unit_of
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import Statement
from lagrange.trajectory.measures.points import fixed_points

LONGEST_RUN, SHORTEST_RUN = 60.0, 1.0
"""Lengths of runs, in units of time, that play at one unit of time per second. Other runs play in `SHOWN` seconds."""
SHOWN = 20.0


def description(
    statement: Statement,
    structure: Structure,
    motion: MotionSource,
    initial: Sequence[float],
    sliders: Sequence[Slider],
) -> dict[str, Any]:
    """Return the data of a page as a dict for JSON; the view of space and the shape of springs are those of figures."""
    begin, end = statement.span
    return {
        "name": plain_text(statement.name),
        "states": _states(statement),
        "parameters": list(motion.parameters),
        "initial": list(initial),
        "sliders": [
            {"kind": slider.kind, "place": slider.place, "value": slider.value, "angle": slider.angle}
            for slider in sliders
        ],
        **_points(statement),
        "view": [math.radians(AZIMUTH), math.radians(ELEVATION)],
        "spring": spring(np.zeros(2), np.array([1.0, 0.0]), 1.0).T.round(4).tolist(),
        "tolerance": TOLERANCE,
        "most_steps": MOST_STEPS,
        "t_end": statement.run.t_end,
        "rate": rate(statement.run.t_end),
        "span": [begin if math.isfinite(begin) else None, end if math.isfinite(end) else None],
        "kept": structure.energy_kept is True,
        "unit": {"t": unit_of(statement, "t"), "length": length_unit(statement)},
    }


def _states(statement: Statement) -> list[dict[str, str]]:
    """Return for each entry of the state its ASCII name, its name with Greek letters and dots, and its unit."""
    notation = UnicodeNotation([*statement.names, *(symbol.name for symbol in statement.parameters)])
    entries = [(name, f"{name}{'_dot' * dots}", dots) for dots in (0, 1) for name in statement.names]
    return [
        {"name": typed, "letter": notation.letter(name, dots), "unit": unit_of(statement, typed)}
        for name, typed, dots in entries
    ]


def _points(statement: Statement) -> dict[str, Any]:
    """Return the named points, their dimension, and the links by the indices of their ends; the last is the origin.

    `colours` has the index of the colour of each point, null for fixed points.
    """
    names = list(statement.positions)
    dimension = max(map(len, statement.positions.values()), default=0)
    places = {name: place for place, name in enumerate([*names, ORIGIN])}
    links = [[places[link.start], places[link.end], link.kind] for link in statement.links]
    numbers = {name: number for number, name in enumerate(moving_points(statement))}
    return {
        "points": names,
        "colours": [numbers.get(name) for name in names],
        "dimension": dimension,
        "links": links,
    }


def moving_points(statement: Statement) -> list[str]:
    """Return the names of the points that are not fixed; each has a colour."""
    fixed = fixed_points(statement)
    return [name for name in statement.positions if not fixed[name]]


def rate(t_end: float) -> float:
    """Return the units of time that play in a second: 1, or for very short or long runs `t_end` / `SHOWN`, rounded."""
    length = abs(t_end)
    shown = 1.0 if SHORTEST_RUN <= length <= LONGEST_RUN else float(f"{length / SHOWN:.1g}")
    return math.copysign(shown, t_end)
