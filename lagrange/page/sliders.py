"""The sliders of a page: which values may be changed, and between which bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from lagrange.errors import RunError, StatementError, listing, shown, suggestion
from lagrange.machine.model import Model
from lagrange.show.units import unit_of
from lagrange.statement.declare import state_rows
from lagrange.statement.expression import entries
from lagrange.statement.number import real_number
from lagrange.statement.statement import Statement

PARAMETER, STATE = "parameter", "state"
"""What a slider changes: a parameter, or an entry of the initial state."""

NICE = (1.0, 2.0, 3.0, 5.0, 10.0)
"""First digits of a bound that is not stated."""

LEAST, MOST = 0.1, 3.0
"""A parameter goes from a tenth to three times its value: to zero it would often leave a system without inertia."""

SHARE = 0.9
"""A coordinate that does not start at zero goes up and down by this part of its value, and so keeps its sign."""


@dataclass(frozen=True)
class Slider:
    """A value that readers may change: the entry at a place of the parameters or of the initial state.

    `chosen` are those that were asked for by name; `angle` says that the value is in radians.
    """

    name: str
    kind: str
    place: int
    value: float
    low: float
    high: float
    unit: str
    chosen: bool
    angle: bool


def sliders(
    model: Model, parameters: tuple[float, ...], initial: tuple[float, ...], asked: Mapping[Any, Any] | None
) -> tuple[Slider, ...]:
    """Return a slider for each parameter and each entry of the initial state, those that were asked for first.

    `asked` maps symbols or names to bounds (low, high). Raises StatementError for what is no value of the system, and
    for bounds that do not hold the value.
    """
    statement = model.statement
    bounds = _asked(statement, asked)
    every = [*_parameters(statement, parameters), *_states(model, parameters, initial)]
    found = {one.name: one for one in every}
    for name, (low, high) in bounds.items():
        one = found[name]
        if not low <= one.value <= high:
            raise StatementError(
                f"the slider of {name} goes from {low:g} to {high:g}, and {name} is {one.value:g}: give bounds that "
                "hold it, or another value."
            )
        found[name] = Slider(name, one.kind, one.place, one.value, low, high, one.unit, chosen=True, angle=one.angle)
    return (*(found[name] for name in bounds), *(one for one in found.values() if not one.chosen))


def _asked(statement: Statement, asked: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds that were asked for, by name."""
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        raise StatementError(f"sliders is {shown(asked)}: give a dict from names to bounds, such as {{'l': (0.5, 2)}}.")
    names = _names(statement)
    found: dict[str, tuple[float, float]] = {}
    for key, pair in asked.items():
        name = names.get(key)
        if name is None:
            known = list(dict.fromkeys(names.values()))
            given = key if isinstance(key, str) else str(key) if isinstance(key, sympy.Basic) else shown(key)
            raise StatementError(
                f"there is no slider of {shown(given)}, which is no parameter, coordinate or velocity of "
                f"{statement.name}: they are {listing(known)}.{suggestion(given, known)}"
            )
        found[name] = _bounds(name, pair)
    return found


def _names(statement: Statement) -> dict[Any, str]:
    """Return the name of each value, by its symbol and by its name."""
    states = statement.state_names
    rows = {key: states[row] for key, row in state_rows(statement.coordinates).items()}
    return {**{key: p.name for p in statement.parameters for key in (p, p.name)}, **rows}


def _bounds(name: str, pair: Any) -> tuple[float, float]:
    listed = None if isinstance(pair, str) else entries(pair, f"the slider of {name}")
    if listed is None or len(listed) != 2:
        raise StatementError(f"the slider of {name} is {shown(pair)}: give its bounds (low, high), such as (0.5, 2).")
    low, high = (real_number(one, f"a bound of the slider of {name}") for one in listed)
    if not low < high:
        raise StatementError(f"the slider of {name} goes from {low:g} to {high:g}: give the lower bound first.")
    return low, high


def _parameters(statement: Statement, values: tuple[float, ...]) -> Iterator[Slider]:
    for place, (symbol, value) in enumerate(zip(statement.parameters, values, strict=True)):
        low, high = parameter_bounds(value)
        unit = unit_of(statement, symbol.name)
        yield Slider(symbol.name, PARAMETER, place, value, low, high, unit, chosen=False, angle=False)


def parameter_bounds(value: float) -> tuple[float, float]:
    """Return the bounds of a parameter: a tenth to three times its value, and of zero 0 to 1."""
    if value == 0:
        return 0.0, 1.0
    low, high = sorted((math.copysign(nice(LEAST * abs(value)), value), math.copysign(nice(MOST * abs(value)), value)))
    return low, high


def nice(size: float) -> float:
    """Return a number above zero with one digit, such as 0.3, that is not below a size but for rounding."""
    if not math.isfinite(1 / size):
        return size
    unit = 10.0 ** math.floor(math.log10(size))
    first = next(one for one in NICE if size <= one * unit * (1 + 1e-9))
    return float(f"{first * unit:.1g}")


def _states(model: Model, parameters: tuple[float, ...], initial: tuple[float, ...]) -> Iterator[Slider]:
    statement = model.statement
    n = len(statement.names)
    circular = angles(statement)
    rates = _rates(model, parameters, initial)
    free = [abs(value) for q, value in zip(statement.coordinates, initial, strict=False) if q not in circular]
    usual = max(free, default=0.0) or 1.0
    for place, (q, name) in enumerate(zip(statement.coordinates, statement.names, strict=True)):
        value, angle = initial[place], q in circular
        half = math.pi if angle else nice(usual) if value == 0 else SHARE * abs(value)
        middle = 2 * math.pi * round(value / (2 * math.pi)) if angle else value
        unit = unit_of(statement, name)
        yield Slider(name, STATE, place, value, middle - half, middle + half, unit, chosen=False, angle=angle)
        speed, name = initial[n + place], f"{name}_dot"
        length = 1.0 if angle else usual
        most = nice(2 * abs(speed) or math.sqrt(abs(rates[place]) * length) or usual)
        unit = unit_of(statement, name)
        yield Slider(name, STATE, n + place, speed, -most, most, unit, chosen=False, angle=False)


def _rates(model: Model, parameters: tuple[float, ...], initial: tuple[float, ...]) -> list[float]:
    """Return the initial accelerations, by which a velocity that starts at zero becomes as large as it does.

    Where they have no value they count as zero: the page itself says that its start has none.
    """
    n = len(model.statement.names)
    try:
        rates = model.rhs(0.0, np.array(initial), dict(zip(model.statement.parameters, parameters, strict=True)))[n:]
    except RunError:
        return [0.0] * n
    return [float(one) if math.isfinite(one) else 0.0 for one in rates]


def angles(statement: Statement) -> frozenset[Any]:
    """Return the coordinates that are angles: they stand in a sine or cosine, times a number and no parameter."""
    stated = [statement.kinetic, statement.potential, *(one.expression for one in statement.constraints)]
    stated += [entry for point in statement.positions.values() for entry in point]
    found = set()
    for formula in stated:
        for circular in formula.atoms(sympy.sin, sympy.cos):
            inside = circular.args[0]
            found |= {q for q in statement.coordinates if inside.has(q) and inside.diff(q).is_number}
    return frozenset(found)
