"""Data of a system for the scripts of a page, whether its motion is computed or recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.export.contents import module_of, wanted
from lagrange.export.target import find, missing_operation
from lagrange.machine.model import Model
from lagrange.show.figures.space import AZIMUTH, ELEVATION, spring
from lagrange.show.figures.style import NAMED_POINTS, point_look
from lagrange.show.notation.symbols import plain_text
from lagrange.show.notation.text import UnicodeNotation
from lagrange.show.units import energy_unit, length_unit, unit_of
from lagrange.statement.declare import ORIGIN
from lagrange.statement.statement import Statement, corners
from lagrange.trajectory.measures.sampling import fixed_points

TARGET = "javascript"

METHOD = "dop853"
"""Integration method with which a page computes the motion."""


ALWAYS = ("rhs", "energy", METHOD)
"""Quantities that every page exports; some systems add others."""

TOLERANCE = 1e-13
"""Relative and absolute tolerance of the steps. The double pendulum drifts by some 1e-12 in a minute; a picture takes
30 us."""

PAGE_STEPS = 5000
"""Largest number of steps between two recorded states; a pendulum takes one."""


@dataclass(frozen=True)
class MotionSource:
    """The exported JavaScript module of a system, its parameter values, and the names of its quantities, `contents`.

    `constrained` is true if the module also exports the projection onto the constraints.
    """

    text: str
    parameters: tuple[float, ...]
    contents: tuple[str, ...]
    constrained: bool

    @property
    def script(self) -> str:
        """The text of the module, followed by the call that passes its functions to the page.

        The call is part of the module, because no other script can import an inline module.
        """
        names = ["prepare", "STATE", "PREPARED", *self.contents]
        if self.constrained:
            names.append("projection")
        return f"{self.text}\nstartPage({{ {', '.join(names)} }});\n"


def contents(statement: Statement) -> tuple[str, ...]:
    """Return the names of the quantities that the exported module of a system computes."""
    optional = {"energies": not statement.lagrangian_alone, "positions": bool(statement.positions)}
    return (*ALWAYS, *(name for name, present in optional.items() if present))


def motion_source(model: Model, parameters: Mapping[Any, Any] | None) -> MotionSource:
    """Return the exported JavaScript module of a model. Raises StatementError for functions that JavaScript lacks."""
    target, asked = find(TARGET), contents(model.statement)
    module = module_of(model, wanted(target, model, asked, (), parameters), (), parameters)
    missing = missing_operation(target, module)
    if missing is not None:
        quantity, function = missing
        raise StatementError(
            f"a page of {model.statement.name} cannot be made: its {quantity} contains {function}, which JavaScript "
            "has no function for."
        )
    text = target.files(module)[f"{module.name}.mjs"]
    return MotionSource(str(text), module.values, asked, len(model.equations.constraints) > 0)


LONGEST_RUN, SHORTEST_RUN = 60.0, 1.0
"""Lengths of runs, in units of time, that play at one unit of time per second. Other runs play in `SHOWN` seconds."""
SHOWN = 20.0


ENERGIES = ("E", "T", "V")
"""Names of the energies in the order of the scripts: the conserved E first; T and V only if they were stated."""


def description(statement: Statement, rate: float, energies: Sequence[str], energy_letter: str) -> dict[str, Any]:
    """Return the data of a system for the scripts, as a dict for JSON: names, points, links, units.

    The view of space and the shape of springs are the same as in figures. `rate` is the time of the run per second on
    the screen, `energies` are the names of the energies to draw, and `energy_letter` is the letter of the first one.
    """
    notation = UnicodeNotation([*statement.names, *(symbol.name for symbol in statement.parameters)])
    entries = [(name, f"{name}{'_dot' * dots}", dots) for dots in (0, 1) for name in statement.names]
    return {
        "name": plain_text(statement.name),
        "states": [
            {"name": typed, "letter": _letter(notation.letter(name, 0), dots), "unit": unit_of(statement, typed)}
            for name, typed, dots in entries
        ],
        **_points(statement),
        "view": [math.radians(AZIMUTH), math.radians(ELEVATION)],
        "spring": spring(np.zeros(2), np.array([1.0, 0.0]), 1.0).T.round(4).tolist(),
        "rate": rate,
        "decimals": 4 if abs(rate) < 1 else 2,
        "energies": [energy_letter if name == "E" else name for name in energies],
        "energySize": 0.0,
        "zero": 0.0,
        "play": True,
        "unit": {"t": unit_of(statement, "t"), "length": length_unit(statement), "energy": energy_unit(statement)},
    }


def _letter(letter: str, dots: int) -> str:
    """Return the symbol of a coordinate for plots, or with `dots` the symbol of its velocity, such as dx/dt.

    A dot above the letter would be too small on a screen.
    """
    return f"d{letter}/dt" if dots else letter


def _points(statement: Statement) -> dict[str, Any]:
    """Return the data of the named points, as a dict for JSON.

    - `points` are their names, `dimension` is 2 or 3.
    - `links` are pairs of indices of points with a kind; the index after the last point is the origin.
    - `drawn` is the number of all points; the points of surfaces follow the named points.
    - `surfaces` has for each surface the index of its first point and the number of its points.
    - `colours` has a colour index for each point, null if the point is fixed.
    - `size` is a factor for the size of the points.
    - `corners` has true for each point that is not drawn.
    """
    names = list(statement.positions)
    dimension = max(map(len, statement.positions.values()), default=0)
    indices = {name: index for index, name in enumerate([*names, ORIGIN])}
    links = [[indices[link.start], indices[link.end], link.kind] for link in statement.links]
    sizes = [len(line) for line in statement.outlines.values()]
    firsts = np.cumsum([len(names), *sizes]).tolist()
    moving = moving_points(statement)
    several = len(moving) <= NAMED_POINTS
    numbers = {name: number if several else 0 for number, name in enumerate(moving)}
    return {
        "points": names,
        "colours": [numbers.get(name) for name in names],
        "corners": [name in corners(statement.links) for name in names],
        "size": point_look(len(moving))[1],
        "dimension": dimension,
        "links": links,
        "drawn": len(statement.drawn),
        "surfaces": [[first, size] for first, size in zip(firsts, sizes, strict=False)],
    }


def moving_points(statement: Statement) -> list[str]:
    """Return the names of the points that are neither fixed nor corners of shapes; each has a colour."""
    fixed, hidden = fixed_points(statement), corners(statement.links)
    return [name for name in statement.positions if not fixed[name] and name not in hidden]


def rate_of(t_end: float) -> float:
    """Return the speed of the page: time of the run per second, with the sign of `t_end`.

    It is 1, or for very short or long runs `t_end` / `SHOWN`, rounded to one digit.
    """
    length = abs(t_end)
    shown = 1.0 if SHORTEST_RUN <= length <= LONGEST_RUN else float(f"{length / SHOWN:.1g}")
    return math.copysign(shown, t_end)
