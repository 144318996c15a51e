"""Chebyshev polynomials on [0, 1]: sampling points, and the matrices from samples to coefficients.

Source: L. N. Trefethen, Approximation Theory and Approximation Practice, 2013, chapters 2 and 3.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEGREE = 16
"""Degree of the polynomial of an event function on a step. If it does not resolve the function, the step is halved. A
path of at most this degree is represented exactly.
"""

COARSE = 8
"""Degree at which many steps are sampled first. It suffices to prove that most functions keep their sign."""


@lru_cache(maxsize=8)
def nodes(degree: int = DEGREE) -> FloatArray:
    """Return the sampling points (degree + 1,) in [0, 1], including both ends."""
    return np.asarray(np.sin(np.pi * np.arange(degree + 1) / (2 * degree)) ** 2)


@lru_cache(maxsize=8)
def to_chebyshev(degree: int = DEGREE) -> FloatArray:
    """Return the matrix from values at the nodes to coefficients of Chebyshev's polynomials on [0, 1]."""
    ranks = np.arange(degree + 1)
    halves = np.where((ranks == 0) | (ranks == degree), 0.5, 1.0)
    signs = (-1.0) ** ranks
    angles = np.cos(np.pi * (np.outer(ranks, ranks) % (2 * degree)) / degree)
    return np.asarray(2 / degree * (halves * signs)[:, None] * angles * halves)


@lru_cache(maxsize=8)
def to_powers(degree: int = DEGREE) -> FloatArray:
    """Return the matrix from coefficients of Chebyshev's polynomials on [0, 1] to coefficients of powers."""
    columns: list[list[int]] = [[1], [-1, 2]]
    while len(columns) <= degree:
        last, before = columns[-1], [*columns[-2], 0, 0]
        columns.append(
            [
                2 * (2 * low - high) - old
                for low, high, old in zip([0, *last], [*last, 0], before[: len(last) + 1], strict=True)
            ]
        )
    matrix = np.zeros((degree + 1, degree + 1))
    for rank, column in enumerate(columns[: degree + 1]):
        matrix[: len(column), rank] = column
    return matrix
