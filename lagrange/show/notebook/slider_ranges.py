"""The sliders that are asked for: a parameter or an initial value each, its range and where it starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.show.rows import row_label
from lagrange.show.units import unit_of
from lagrange.statement.number import real_number
from lagrange.statement.statement import Statement

MOST_SLIDERS = 12
"""More sliders than this are no longer a picture that somebody plays with."""


@dataclass(frozen=True)
class Slider:
    """One slider: the name of a parameter, a coordinate or a velocity, its ends, and the value at which it starts."""

    name: str
    low: float
    high: float
    value: float
    parameter: bool
    unit: str


def slider_ranges(statement: Statement, given: Any, named: Mapping[str, Any]) -> list[Slider]:
    """Return the sliders, first those of a dict by symbol or name, then those that were given by keyword.

    Raises StatementError for a name that is no parameter, coordinate or velocity, and for what is no range.
    """
    if given is not None and not isinstance(given, Mapping):
        raise StatementError(f"{shown(given)} are no ranges: give a dict such as {{l: (0.5, 2)}}, or l=(0.5, 2).")
    wanted = {row_label(key): value for key, value in (given or {}).items()} | dict(named)
    starts = _starts(statement)
    if not wanted:
        raise StatementError(
            f"no slider was asked for: give ranges such as explore({next(iter(starts))}=(0, 2)), of {listing(starts)}."
        )
    if len(wanted) > MOST_SLIDERS:
        raise StatementError(f"{len(wanted)} sliders were asked for, and there is room for {MOST_SLIDERS}.")
    parameters = {symbol.name for symbol in statement.parameters}
    found = []
    for name, ends in wanted.items():
        if name not in starts:
            raise StatementError(
                f"{shown(name)} is no parameter, no coordinate and no velocity of {statement.name}, so that there is "
                f"nothing to slide; they are {listing(starts)}.{suggestion(name, starts)}"
            )
        low, high = _ends(name, ends)
        value = starts[name]
        start = (low + high) / 2 if value is None else min(max(value, low), high)
        found.append(Slider(name, low, high, start, name in parameters, unit_of(statement, name)))
    return found


def _starts(statement: Statement) -> dict[str, float | None]:
    """Return what may have a slider, with its value in the statement, None where it has none."""
    values: dict[str, float | None] = {p.name: statement.defaults.get(p) for p in statement.parameters}
    return values | dict(zip(statement.state_names, statement.initial, strict=True))


def _ends(name: str, ends: Any) -> tuple[float, float]:
    if not isinstance(ends, Sequence) or isinstance(ends, str) or len(ends) != 2:
        raise StatementError(f"the range of {name} is {shown(ends)}: give its two ends, such as (0.5, 2).")
    low, high = (real_number(end, f"an end of the range of {name}") for end in ends)
    if not low < high:
        raise StatementError(f"the range of {name} goes from {low:g} to {high:g}: give the smaller end first.")
    return low, high
