"""Bounds that the user gives for sliders, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.statement.declare import state_rows
from lagrange.statement.expression import entries
from lagrange.statement.number import real_number
from lagrange.statement.parameters import label_of
from lagrange.statement.statement import Statement

PARAMETER, STATE = "parameter", "state"
"""Kinds of sliders: for a parameter, or for an entry of the initial state."""

EXAMPLE = (0.5, 2.0)
"""Example of bounds in an error message."""


@dataclass(frozen=True)
class Slider:
    """A value that a slider changes, with its bounds; `place` is its index in the parameters or in the initial state.

    `chosen` is true if the user chose it by name; `angle` is true if the value is in radians.
    """

    name: str
    kind: str
    place: int
    value: float
    low: float
    high: float
    unit: str
    chosen: bool
    angle: bool = False


def places(statement: Statement) -> dict[str, tuple[str, int]]:
    """Return the values that may have a slider, by name: kind and index of each parameter and entry of the state."""
    parameters = {p.name: (PARAMETER, place) for place, p in enumerate(statement.parameters)}
    return parameters | {name: (STATE, place) for place, name in enumerate(statement.state_names)}


def asked_bounds(statement: Statement, asked: Any) -> dict[str, tuple[float, float]]:
    """Return the bounds of the sliders that the user chose, by name, from a dict by symbol or name.

    Raises StatementError for a name that is not a parameter, coordinate or velocity, and for invalid bounds.
    """
    if asked is None:
        return {}
    if not isinstance(asked, Mapping):
        raise StatementError(
            f"{shown(asked)} says no sliders: give a dict from names to bounds, such as {{'l': {EXAMPLE}}}."
        )
    names = _names(statement)
    result: dict[str, tuple[float, float]] = {}
    for key, pair in asked.items():
        name = names.get(key)
        if name is None:
            known = list(places(statement))
            raise StatementError(
                f"there is no slider of {shown(label_of(key))}, which is no parameter, coordinate or velocity of "
                f"{statement.name}: they are {listing(known)}.{suggestion(label_of(key), known)}"
            )
        result[name] = _bounds(name, pair)
    return result


def _names(statement: Statement) -> dict[Any, str]:
    """Return the name of each value, by its symbol and by its name."""
    states = statement.state_names
    rows = {key: states[row] for key, row in state_rows(statement.coordinates).items()}
    return {**{key: p.name for p in statement.parameters for key in (p, p.name)}, **rows}


def _bounds(name: str, pair: Any) -> tuple[float, float]:
    listed = None if isinstance(pair, (str, bytes, Mapping, set, frozenset)) else entries(pair, f"the slider of {name}")
    if listed is None or len(listed) != 2:
        raise StatementError(
            f"the slider of {name} is {shown(pair)}: give its lower and its upper bound, such as {EXAMPLE}."
        )
    low, high = (real_number(one, f"a bound of the slider of {name}") for one in listed)
    if low == high:
        such = (-1.0, 1.0) if low == 0 else tuple(sorted((low / 2, low * 2)))
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}, and has no room to move: give a lower and an upper "
            f"bound, such as {such}."
        )
    if low > high:
        raise StatementError(
            f"the slider of {name} goes from {low:g} to {high:g}: give the lower bound first, ({high:g}, {low:g})."
        )
    return low, high
