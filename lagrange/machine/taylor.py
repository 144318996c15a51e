"""What the Taylor drivers of all machines agree on: the numbers they read, the order, and how steps are tried."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lagrange.machine.arithmetic import FLOATS
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.program.series import SeriesProgram

FARTHEST = 10.0
"""The series is computed in a time scaled by a power of two near the last step, so that its coefficients neither
overflow nor vanish whatever the units are; a step that differs from the scale by more than 2**10 is computed anew."""

NEAREST = 1.5
"""The first step of a run is computed anew if it differs from the scale by more than 2**1.5."""

ROWS_SEEN = 6
GUARD = 0.25
"""The step follows the last two rows, and the four before them as a guard: from rest every other coefficient is zero,
and the last that is not may be small by chance. Row k of a series of radius r shows r tolerance**(1/k); what it shows
of r may be exceeded by a quarter of a binary digit, for the rows of an entire function fall faster and faster."""

LONGER, SHORTER = 20.0, -40.0
"""Powers of two by which the scale changes where the last coefficients are zero, and where one has overflowed."""

SHORTEST = 1e-280
"""The shortest scale of time that is tried."""

TRIES = 120
"""How often a step is computed anew with another scale of time before the coefficients count as infinite."""

LOWEST, HIGHEST = 4, 32
"""The orders to choose from."""


@dataclass(frozen=True)
class Cost:
    """What a step of order p costs, in nanoseconds or so: fixed + each p + pairs p**2."""

    fixed: float
    each: float
    pairs: float


NEARLY = 1.07
"""The lowest order within this factor of the least cost is taken: the cost is flat there, and lower orders compile
sooner, keep further from the radius of convergence and round less."""


def best_order(cost: Cost, tolerance: float) -> int:
    """Return the order p at which the cost of a step over its length, which goes like tolerance**(1/p), is least."""
    prices = {
        p: (cost.fixed + cost.each * p + cost.pairs * p * p) * math.exp(-math.log(tolerance) / p)
        for p in range(LOWEST, HIGHEST + 1)
    }
    return min(p for p, price in prices.items() if price <= NEARLY * min(prices.values()))


def constants(program: SeriesProgram, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the table of constants, and the inverse (n, n) of a constant mass matrix, else an empty array.

    Raises SingularMassMatrix.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.constants, 0.0, [0.0] * (2 * program.dimension), list(parameters))
    table, rest = np.array(values[: len(program.numbers)], dtype=float), values[len(program.numbers) :]
    if not program.constant_mass:
        return table, np.empty((0, 0))
    whole = np.zeros((program.dimension, program.dimension))
    for block in program.blocks:
        count = len(block) * (len(block) + 1) // 2
        whole[np.ix_(block, block)] = inverse(len(block), rest[:count])
        rest = rest[count:]
    return table, whole


def inverse(n: int, triangle: list[float]) -> FloatArray:
    """Return the inverse (n, n) of a symmetric matrix from its lower triangle by rows. Raises SingularMassMatrix."""
    full = np.zeros((n, n))
    full[np.tril_indices(n)] = triangle
    full = full + np.tril(full, -1).T
    diagonal = np.abs(np.diag(full))
    units = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)
    try:
        found = np.linalg.inv(full * units[:, None] * units)
    except np.linalg.LinAlgError as error:
        raise SingularMassMatrix from error
    if not np.isfinite(found).all() or np.abs(found).max() * np.finfo(float).eps > 1 / 64:
        raise SingularMassMatrix
    return np.asarray(found * units[:, None] * units)
