"""A function on a step as polynomials: sampled at Chebyshev points of subintervals, halved until it is resolved.

A function is resolved if its last Chebyshev coefficients are at round-off.
Source: L. N. Trefethen, Approximation Theory and Approximation Practice, 2013, chapters 3, 4 and 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.events.chebyshev import DEGREE, nodes, to_chebyshev, to_powers
from lagrange.algorithm.events.constants import CERTAINTY, EPSILON, LARGEST_NOISE, TAIL, TINY
from lagrange.trajectory.trajectory import FloatArray

DEEPEST = 50
"""Largest number of halvings of a subinterval; a narrower one is a point, a jump or a pole."""

MOST_HALVINGS = 5000
"""Largest total number of halvings of one step, for some hundreds of roots. The unresolved rest is noise."""

POLE_LEVELS = 26
"""A function that grows by a factor of 1000 over this many halvings has a pole.

A jump stays constant under halving, a pole doubles.
"""


@dataclass(frozen=True, eq=False)
class LocalPolynomial:
    """A polynomial on a part of a step, from `start` over `width`, in units of the step.

    `coefficients` are those of powers of the time since its start in units of its width; `noise` bounds their error.
    They are None on a part where the function has no value, or a pole. At a `jump` the part is a point, before and
    after which the function has different signs.
    """

    start: float
    width: float
    coefficients: FloatArray | None
    noise: float
    jump: bool = False


def evaluate(chebyshev: FloatArray, s: FloatArray) -> FloatArray:
    """Return functions (..., degree + 1) at places s (K,) in [0, 1], (..., K)."""
    ranks = np.arange(chebyshev.shape[-1])
    angles = 2 * np.arcsin(np.sqrt(s))
    return np.asarray(chebyshev @ ((-1.0) ** ranks[:, None] * np.cos(np.outer(ranks, angles))))


def certain(chebyshev: FloatArray, noise: FloatArray) -> NDArray[np.bool_]:
    """Return which functions (..., degree + 1) certainly keep their sign, judged by their coefficients.

    The truncated part is taken as eight times the last coefficients.
    """
    sizes = np.abs(chebyshev)
    others = sizes[..., 1:].sum(axis=-1) + TAIL * sizes[..., -2:].max(axis=-1) + 4 * noise
    return np.asarray(sizes[..., 0] > CERTAINTY * others)


def local_polynomials(
    g: Callable[[FloatArray], FloatArray], values: FloatArray, noise: float, *, smooth: bool = False
) -> Iterator[LocalPolynomial]:
    """Yield the parts of a step in order on which g is resolved, or certainly keeps its sign.

    `g` takes places (K,) in [0, 1]; `values` are those at the nodes of the whole step. The parts end where g has no
    value. `smooth` omits coefficients below the noise, for derivatives at the start of g.
    """
    stack = [(0.0, 0, values, math.inf, 0.0)]
    halvings = 0
    while stack:
        start, depth, found, before, above = stack.pop()
        width, finite = 0.5**depth, bool(np.isfinite(found).all())
        chebyshev = to_chebyshev() @ np.where(np.isfinite(found), found, 0.0)
        tail = float(np.abs(chebyshev[-2:]).max())
        # A remainder that halving does not reduce is noise; this bounds the number of parts.
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
            jump = depth == DEEPEST and found[0] * found[-1] < 0 and min(abs(found[[0, -1]])) > noise
            yield LocalPolynomial(start, width, np.array([found[0], found[-1] - found[0]]), noise, bool(jump))


def _polynomial(
    start: float, width: float, chebyshev: FloatArray, size: float, noise: float, least: float = 0.0
) -> LocalPolynomial | None:
    """Return a part if it is resolved, or if its sign is certain; then only the first coefficient is kept.

    Coefficients below round-off or the `least` are omitted and counted as noise. So is the truncated part: at a kink
    the coefficients fall so slowly that it is the last one times some degrees.
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
    """Return the coefficients of powers (k,), without trailing Chebyshev coefficients below the least."""
    above = np.flatnonzero(np.abs(chebyshev) > least)
    count = int(above[-1]) + 1 if len(above) else 1
    return np.asarray(to_powers(len(chebyshev) - 1)[:count, :count] @ chebyshev[:count])


def _size(values: FloatArray) -> float:
    """Return the largest finite size, or 0 without finite values."""
    sizes = np.abs(values[np.isfinite(values)])
    return float(sizes.max(initial=0.0))
