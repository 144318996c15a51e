"""What the measurements of ensembles have in common: members, their errors, and times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import process_time
from typing import Any

import measure
import numpy as np
from numpy.typing import NDArray
from taylor_systems import Case, reference

import lagrange as lg

Array = NDArray[np.float64]

SPANS = {
    "pendulum": 20.0,
    "henon-heiles": 50.0,
    "kepler": 20 * np.pi,
    "double": 5.0,
    "chain5": 2.0,
    "chain10": 1.0,
    "solar": 50_000.0,
}
"""The time at the end of each member."""

SPREAD, SAMPLED = 0.05, 16
"""Members start from states scaled by random numbers this near to 1; so many have a reference of 80 bits."""


def starts(case: Case, members: int) -> Array:
    """Return the initial states of members, (members, 2n)."""
    draw = np.random.default_rng(7)
    return np.array(case.start) * (1.0 + SPREAD * draw.uniform(-1.0, 1.0, (members, 1)))


def ours(case: Case, system: lg.System, y0: Array, **options: Any) -> Callable[[], lg.Ensemble]:
    """Return an ensemble on one thread."""
    names = system.compile().layout.names()
    initial = dict(zip(names, y0.T, strict=True))
    return partial(lg.ensemble, system, SPANS[case.name], initial, workers=1, **options)


best = partial(measure.best, least=0.0, clock=process_time)
"""The least processor seconds of one call of each, on all threads of this process."""


class Errors:
    """Errors of the first members of a case, against runs in 80-bit arithmetic."""

    def __init__(self, case: Case, system: lg.System, y0: Array) -> None:
        self.exact = reference(replace(case, t_end=SPANS[case.name]), system, y0[:SAMPLED])[0].astype(float)

    def of(self, ends: Array) -> float:
        """Return the root mean square of the largest errors, each relative to the largest entry of its state."""
        sizes = np.abs(self.exact).max(axis=1)
        return float(np.sqrt(np.mean((np.abs(ends[:SAMPLED] - self.exact).max(axis=1) / sizes) ** 2)))
