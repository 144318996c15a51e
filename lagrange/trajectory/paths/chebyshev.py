"""A function on a step as a polynomial: sampled at Chebyshev's points, and the step halved until it is one.

The coefficients of Chebyshev's polynomials show how far a function is resolved: its last ones are at round-off then.
Source: L. N. Trefethen, Approximation Theory and Approximation Practice, 2013, chapters 3, 4 and 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lagrange.trajectory.trajectory import FloatArray

EPSILON = 2.0**-52

DEGREE = 16
"""The degree at which a function is resolved, or its step halved; a path of a degree up to this is exact."""

DENSE_ROUND_OFF = 64 * EPSILON
"""Times how much a function varies on a step: what the weights of a dense output make of rounding. Those of DOP853
leave 5e-14 where the state moves by 1 (a pendulum, h = 1)."""

DEEPEST = 50
"""Halvings, at most: what is narrower is a single place, a jump or a pole."""

MOST_HALVINGS = 5000
"""Halvings of one step, together: some hundreds of roots. What is not resolved then is noise between two steps."""

LARGEST_NOISE = 1e-8
"""Noise above this part of a function is taken for the function itself."""

TINY = 64 * 2.0**-1074
"""Some spacings of the smallest doubles."""

POLE_LEVELS = 26
"""A function that grows by a thousand over so many halvings has a pole; a jump stays as it is, a pole doubles."""


@dataclass(frozen=True, eq=False)
class LocalPolynomial:
    """A part of a step, from `start` over `width`, in units of the step.

    `coefficients` are powers of the time since its start in units of its width; `noise` is by how much they may be
    wrong. None stands for a part in which the function has no value, or a pole.
    """

    start: float
    width: float
    coefficients: FloatArray | None
    noise: float


@lru_cache(maxsize=8)
def nodes(degree: int = DEGREE) -> FloatArray:
    """Return the points (degree + 1,) in [0, 1], both ends among them."""
    return np.asarray(np.sin(np.pi * np.arange(degree + 1) / (2 * degree)) ** 2)


@lru_cache(maxsize=8)
def to_chebyshev(degree: int = DEGREE) -> FloatArray:
    """Return the matrix from values at the nodes to the coefficients of Chebyshev's polynomials on [0, 1]."""
    ranks = np.arange(degree + 1)
    halves = np.where((ranks == 0) | (ranks == degree), 0.5, 1.0)
    signs = (-1.0) ** ranks
    angles = np.cos(np.pi * (np.outer(ranks, ranks) % (2 * degree)) / degree)
    return np.asarray(2 / degree * (halves * signs)[:, None] * angles * halves)


@lru_cache(maxsize=8)
def _to_powers(degree: int) -> FloatArray:
    """Return the matrix from coefficients of Chebyshev's polynomials on [0, 1] to those of powers."""
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


def evaluate(chebyshev: FloatArray, s: FloatArray) -> FloatArray:
    """Return functions (..., degree + 1) at places s (K,) in [0, 1], (..., K)."""
    ranks = np.arange(chebyshev.shape[-1])
    angles = 2 * np.arcsin(np.sqrt(s))
    return np.asarray(chebyshev @ ((-1.0) ** ranks[:, None] * np.cos(np.outer(ranks, angles))))


def certain(chebyshev: FloatArray, noise: FloatArray) -> NDArray[np.bool_]:
    """Return which functions (..., degree + 1) are certain to keep their sign, as far as their coefficients show.

    What is not resolved yet is taken for eight times the last coefficients.
    """
    sizes = np.abs(chebyshev)
    others = sizes[..., 1:].sum(axis=-1) + 8 * sizes[..., -2:].max(axis=-1) + 4 * noise
    return np.asarray(sizes[..., 0] > 1.001 * others)


def local_polynomials(
    g: Callable[[FloatArray], FloatArray], values: FloatArray, noise: float, *, smooth: bool = False
) -> Iterator[LocalPolynomial]:
    """Yield the parts of a step in order on which g is resolved, or certain to keep its sign.

    `g` takes places (K,) in [0, 1], `values` are those at the nodes of the whole step. Where g has no value the parts
    end. `smooth` leaves out the coefficients below the noise, for derivatives where g starts.
    """
    stack = [(0.0, 0, values, math.inf, 0.0)]
    halvings = 0
    while stack:
        start, depth, found, before, above = stack.pop()
        width, finite = 0.5**depth, bool(np.isfinite(found).all())
        chebyshev = to_chebyshev() @ np.where(np.isfinite(found), found, 0.0)
        tail = float(np.abs(chebyshev[-2:]).max())
        # What halving does not make smaller is noise that was not known of: so the number of parts stays small.
        grain = 8 * tail if tail > before / 4 and tail <= LARGEST_NOISE * _size(found) else TINY
        least = noise if smooth and start == 0 else 0.0
        piece = _polynomial(start, width, chebyshev, _size(found), noise + grain, least) if finite else None
        if piece is not None:
            yield piece
        elif depth < DEEPEST and halvings < MOST_HALVINGS:
            halvings += 1
            above = _size(found) if depth == DEEPEST - POLE_LEVELS else above
            for begin in (start + width / 2, start):
                stack.append((begin, depth + 1, g(begin + width / 2 * nodes()), tail, above))
        elif not finite or (depth == DEEPEST and _size(found) > 1e3 * above):
            yield LocalPolynomial(start, width, None, noise)
            return
        else:
            yield LocalPolynomial(start, width, np.array([found[0], found[-1] - found[0]]), noise)


def _polynomial(
    start: float, width: float, chebyshev: FloatArray, size: float, noise: float, least: float = 0.0
) -> LocalPolynomial | None:
    """Return a part if it is resolved or leaves no doubt of its sign, which is all it keeps then.

    Coefficients below round-off or the `least` are left out, and counted as noise; so are those beyond, which at a kink
    fall so slowly that they add up to the last one times some degrees.
    """
    sizes = np.abs(chebyshev)
    floor = noise + 8 * EPSILON * size
    if max(sizes[-2:]) <= floor:
        found = powers(chebyshev, max(EPSILON * size, least))
        left = float(sizes[len(found) :].sum() + 4 * DEGREE * sizes[-2:].max())
        return LocalPolynomial(start, width, found, noise + left)
    if certain(chebyshev, np.asarray(noise)):
        return LocalPolynomial(start, width, chebyshev[:1], noise)
    return None


def powers(chebyshev: FloatArray, least: float) -> FloatArray:
    """Return the coefficients of powers (k,), without the last of Chebyshev's that are below the least."""
    above = np.flatnonzero(np.abs(chebyshev) > least)
    count = int(above[-1]) + 1 if len(above) else 1
    return np.asarray(_to_powers(len(chebyshev) - 1)[:count, :count] @ chebyshev[:count])


def _size(values: FloatArray) -> float:
    """Return the largest finite size, 0 if there is none."""
    sizes = np.abs(values[np.isfinite(values)])
    return float(sizes.max(initial=0.0))
