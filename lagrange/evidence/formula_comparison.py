"""Verify formulas of an analysis, such as a linearization, against numbers of the compiled model at random states."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Sequence

import numpy as np

from lagrange.errors import FAULT, RunError
from lagrange.statement.random_states import SamplePoint, holds, random_points
from lagrange.statement.statement import Statement

PLACES = 2
"""Number of random states at which a formula is compared. A wrong formula agrees at a state only by chance."""

LARGEST_ERROR = 1e-8
"""Largest accepted difference, relative to the largest number. Cancellation makes correct formulas differ by less."""


Values = Callable[[SamplePoint], tuple[Sequence[float], Sequence[complex]]]
"""Function that returns compiled numbers, and the values of their formulas, at a point."""


def compared(what: str, statement: Statement, values: Values) -> None:
    """Compare values of formulas with compiled numbers at random states.

    `values(point)` returns both lists. A state at which one of them has no value is skipped. Raises RunError if they
    differ; its message begins with `what`.
    """
    holds(random_points(statement, seed=0), lambda point: agrees(what, statement, point, values), PLACES)


def agrees(what: str, statement: Statement, point: SamplePoint, values: Values) -> bool | None:
    """Return True if compiled numbers and values of formulas agree at a point; None if any of them has no value.

    `values(point)` returns both lists. Raises RunError if they differ; its message begins with `what`.
    """
    try:
        compiled, formulas = values(point)
    except RunError:
        return None
    if not all(map(cmath.isfinite, (*compiled, *formulas))):
        return None
    off = np.abs(np.asarray(formulas) - np.asarray(compiled))
    scale = max(1e-300, *map(abs, compiled), *map(abs, formulas))
    if off.max() > LARGEST_ERROR * scale:
        worst = int(off.argmax())
        raise RunError(
            f"{what} of {statement.name} is wrong: a formula gives {formulas[worst]:.15g} where {compiled[worst]:.15g} "
            f"is compiled, at {point.describe(statement.names)}. {FAULT}"
        )
    return True
