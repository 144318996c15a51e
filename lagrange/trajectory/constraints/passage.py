"""Whether a run passed a configuration where constraints become dependent in steps that rounding decided.

Two motions may cross there: a parallelogram linkage goes on as one, or with crossed rods. A step that leads over the
crossing follows the motion that is smooth. Short steps towards it do not: a violation e of the constraints, as rounding
and the tolerance leave it, separates the two by sqrt(e), and decides which of them is followed.
"""

from __future__ import annotations

import math

import numpy as np

from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.singular import Singular, least_regular, scales
from lagrange.trajectory.constraints.residuals import residuals_of

SHORT_STEP = 0.1
"""A step below this part of the mean is looked at: on the way to a crossing steps shrink to 1e-2 to 1e-4 of it."""

FIRST_STEPS = 3
"""Steps at the start that are left out: they are short because the step size is sought."""

SURELY_FAR = 1e2
"""Units change the least singular value of rows by less than this factor, once rows are as long as at the start."""

MANY_STEPS = 10_000
"""From this many steps on the shortest is looked at in any case: it costs nothing beside them."""

CLOSE = 3.0
"""Constraints are dependent for a run where their least singular value, relative to the start, is below this times the
root of rtol. Runs of four methods over crossings had 1e-6 to 5e-5 at rtol = 1e-9."""

MOST_PLACES = 16
"""So many places of short steps are looked at, those with the shortest: each costs some 50 us."""


def dependent_passage(
    model: Model, times: FloatArray, states: FloatArray, parameters: FloatArray, rtol: float
) -> tuple[int, Singular] | None:
    """Return the row of times (S+1,) and states (S+1, 2n) where constraints are dependent, and which of them.

    It is the first row before short steps at which they are so. None if there is no such row.
    """
    count = len(times) - 1 - FIRST_STEPS
    if count < 2 or not rtol:
        return None
    # The last step is left out as well: it is as long as is left.
    sizes = np.abs(np.diff(times[FIRST_STEPS:-1]))
    if count < MANY_STEPS and sizes.min() * count > SHORT_STEP * abs(times[-1] - times[FIRST_STEPS]):
        return None
    residuals, bound = residuals_of(model), CLOSE * math.sqrt(rtol)
    independent = [residuals.names.index(name) for name in model.equations.constraints.names]
    first = residuals.gradient(times[0], states[0], parameters)[independent]
    near = SURELY_FAR * bound * _least(first, first)
    for row in _short_steps(sizes):
        here = residuals.gradient(times[row], states[row], parameters)[independent]
        if _least(here, first) > near:
            continue
        unit = np.eye(first.shape[1])
        found = least_regular(unit, here, scales(unit, first))
        if found is not None and found.motion is None and found.regularity <= bound:
            return row, found
    return None


def _short_steps(sizes: FloatArray) -> list[int]:
    """Return the rows before the shortest step of each series of short steps, in order; `sizes` lacks the first."""
    short = np.flatnonzero(sizes <= SHORT_STEP * sizes.mean())
    if not len(short):
        return [FIRST_STEPS + int(np.argmin(sizes))]
    series = np.split(short, np.flatnonzero(np.diff(short) > 1) + 1)
    least = [int(one[np.argmin(sizes[one])]) for one in series]
    return [FIRST_STEPS + place for place in sorted(sorted(least, key=lambda place: float(sizes[place]))[:MOST_PLACES])]


def _least(rows: FloatArray, first: FloatArray) -> float:
    """Return the least singular value of rows, in units of the lengths of those at the start."""
    sizes = np.sqrt((first**2).sum(axis=1))
    return float(np.linalg.svd(rows / np.where(sizes > 0, sizes, 1.0)[:, None], compute_uv=False)[-1])
