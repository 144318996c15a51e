"""The sliders of a notebook: those that are asked for, each with the value at which it starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lagrange.errors import StatementError, listing
from lagrange.show.sliders import PARAMETER, Slider, asked_bounds, places
from lagrange.show.units import unit_of
from lagrange.statement.statement import Statement

MOST_SLIDERS = 12
"""More sliders than this are no longer a picture that somebody plays with."""


def explored_sliders(statement: Statement, given: Any, named: Mapping[str, Any]) -> list[Slider]:
    """Return the sliders, first those of a dict by symbol or name, then those that were given by keyword.

    Raises StatementError for a name that is no parameter, coordinate or velocity, and for what are no bounds.
    """
    bounds = asked_bounds(statement, given) | asked_bounds(statement, named)
    known = places(statement)
    if not bounds:
        raise StatementError(
            f"no slider was asked for: give bounds such as explore({next(iter(known))}=(0, 2)), of {listing(known)}."
        )
    if len(bounds) > MOST_SLIDERS:
        raise StatementError(f"{len(bounds)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    found = []
    for name, (low, high) in bounds.items():
        kind, place = known[name]
        value = statement.initial[place] if kind != PARAMETER else statement.defaults.get(statement.parameters[place])
        start = (low + high) / 2 if value is None else min(max(value, low), high)
        found.append(Slider(name, kind, place, start, low, high, unit_of(statement, name), chosen=True))
    return found
