"""Comparison of a formula with compiled numbers at random states, until enough states had values."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import TypeVar

import numpy as np

from lagrange.errors import FAULT, RunError
from lagrange.evidence.sample import SAMPLE_KINDS, SampleKind, SamplePoint, Sampler
from lagrange.statement.statement import Statement

MOST_DRAWS = 16
"""Largest number of random states tried, since a formula may have no value at some."""

ALL_KINDS = (*SAMPLE_KINDS[1:4], SAMPLE_KINDS[0])
"""Kinds of random states, used in turn: those of order one come first."""

NEAR_INITIAL = (SAMPLE_KINDS[3],)
"""States near the initial one, where a formula may hold that holds on one branch alone."""

PLACES = 2
"""Number of random states at which a formula is compared. A wrong formula agrees at one with probability zero."""

LARGEST_ERROR = 1e-8
"""Largest difference, relative to the largest number compared. Cancellation costs some digits, a wrong term all."""

Place = TypeVar("Place")
Value = TypeVar("Value")


def random_points(
    statement: Statement, seed: int, draws: int = MOST_DRAWS, kinds: Sequence[SampleKind] = ALL_KINDS
) -> Iterator[SamplePoint]:
    """Yield `draws` random points: states with times and parameters, of each kind in turn.

    The same `seed` gives the same points.
    """
    sampler = Sampler(statement, seed)
    return (sampler.point(kinds[attempt % len(kinds)], attempt) for attempt in range(draws))


def usable(samples: Iterable[Place], value: Callable[[Place], Value | None]) -> Iterator[Value]:
    """Yield the values of a function at samples; a sample where the value is None is skipped."""
    return (result for result in map(value, samples) if result is not None)


def holds(samples: Iterable[Place], judge: Callable[[Place], bool | None], count: int) -> bool | None:
    """Return True if `judge` is true at `count` samples, False after a False, None if too few samples have a value."""
    count_so_far = 0
    for verdict in islice(usable(samples, judge), count):
        if not verdict:
            return False
        count_so_far += 1
    return True if count_so_far == count else None


Values = Callable[[SamplePoint], tuple[Sequence[float], Sequence[complex]]]
"""Function that returns compiled numbers and the values of their formulas at a point."""


def compared(what: str, statement: Statement, values: Values) -> None:
    """Compare values of formulas with compiled numbers at random states.

    `values(point)` returns the compiled numbers and those of the formulas. Raises RunError if they differ; its
    message begins with `what`. A state at which a formula or a compiled number has no value is skipped.
    """
    holds(random_points(statement, seed=0), lambda point: agrees(what, statement, point, values), PLACES)


def agrees(what: str, statement: Statement, point: SamplePoint, values: Values) -> bool | None:
    """Return True if compiled numbers and values of formulas agree at a point; None if one has no value there.

    `values(point)` returns both. Raises RunError if they differ; its message begins with `what`.
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
