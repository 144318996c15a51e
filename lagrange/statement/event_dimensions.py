"""Dimensions and units in the events of a run: terms that are added, and values that resets set."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from lagrange.statement.checked_part import CheckedPart
from lagrange.statement.dimension_check import check_dimensions, dimension_of, multiplier_dimensions
from lagrange.statement.own_numbers import without_own_numbers
from lagrange.statement.statement import Statement


def check_event_dimensions(place: int, zero: Any, resets: Sequence[tuple[Any, Any]], statement: Statement) -> None:
    """Refuse an event, or a reset of it, with a term in another dimension or unit than those beside it.

    `zero` is the expression of event number `place`, `resets` are pairs of a symbol and the value that it is set to.
    """
    if statement.dimensions:
        _check(place, zero, tuple(resets), statement)


@lru_cache(maxsize=64)
def _check(place: int, zero: Any, resets: tuple[tuple[Any, Any], ...], statement: Statement) -> None:
    parts = [CheckedPart(f"event {place}", without_own_numbers(zero), None)]
    parts += [
        CheckedPart(f"the reset of event {place}", without_own_numbers(value), symbol) for symbol, value in resets
    ]
    known = dict(statement.dimensions) | dict(multiplier_dimensions(statement, statement.dimensions))
    known |= {symbol: one for symbol, _ in resets if (one := dimension_of(symbol, known)) is not None}
    check_dimensions(parts, known, statement.plain)
