"""Formulas against compiled numbers, at random states: what is shown to people is what runs."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Sequence

import numpy as np

from lagrange.errors import FAULT, RunError
from lagrange.evidence.sample import SAMPLE_KINDS, Point, Sampler
from lagrange.statement.statement import Statement

POINTS = 2
"""States at which a formula is compared: a wrong one is right at a random state with probability zero."""

MOST_DRAWS = 16
"""Random states that are tried: a formula may have no value at some."""

LARGEST_ERROR = 1e-8
"""Relative to the largest number compared. Terms that cancel cost doubles some digits; a wrong term costs all."""


def compared(
    what: str, statement: Statement, values: Callable[[Point], tuple[Sequence[float], Sequence[complex]]]
) -> None:
    """Compare formulas with compiled numbers; `values` gives both at a point. Raises RunError where they differ.

    States at which one of them has no value are passed over.
    """
    sampler, done = Sampler(statement, seed=0), 0
    for attempt in range(MOST_DRAWS):
        point = sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt)
        done += agrees(what, statement, point, values)
        if done == POINTS:
            return


def agrees(
    what: str,
    statement: Statement,
    point: Point,
    values: Callable[[Point], tuple[Sequence[float], Sequence[complex]]],
) -> bool:
    """Return whether both have values at a point; raises RunError where these differ."""
    try:
        compiled, formulas = values(point)
    except RunError:
        return False
    if not all(map(cmath.isfinite, (*compiled, *formulas))):
        return False
    off = np.abs(np.asarray(formulas) - np.asarray(compiled))
    scale = max(1e-300, *map(abs, compiled), *map(abs, formulas))
    if off.max() > LARGEST_ERROR * scale:
        worst = int(off.argmax())
        raise RunError(
            f"{what} of {statement.name} is wrong: a formula gives {formulas[worst]:.15g} where {compiled[worst]:.15g} "
            f"is compiled, at {point.describe(statement.names)}. {FAULT}"
        )
    return True
