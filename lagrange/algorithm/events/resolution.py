"""The polynomial of a function on a step, from samples at Chebyshev points, if these resolve the function."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lagrange.algorithm.events.chebyshev import DEGREE, to_chebyshev, to_powers
from lagrange.algorithm.events.constants import CERTAINTY, EPSILON, LARGEST_NOISE, TAIL, TINY
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, fma, larger, magnitude, unlikely, unrolled

Reals = tuple[float, ...]


@inline
def weighted(terms: Sequence[float], weights: Sequence[float]) -> float:
    """Return the sum of products of terms and weights. Weights without a term are ignored."""
    total = terms[0] * weights[0]
    for term, weight in zip(terms[1:], weights[1:], strict=False):
        total = fma(term, weight, total)
    return total


@inline
def transform(values: Reals) -> Reals:
    """Return the Chebyshev coefficients of a function from its `values` at the nodes.

    Polynomials of even degree are symmetric about the middle, polynomials of odd degree antisymmetric. So half
    of the products suffice.
    """
    degree = len(values) - 1
    middle = degree // 2
    sums = (*(values[k] + values[degree - k] for k in range(middle)), values[middle])
    differences = tuple(values[k] - values[degree - k] for k in range(middle))
    rows = enumerate(to_chebyshev(degree).tolist())
    return tuple(weighted(differences if rank % 2 else sums, row) for rank, row in rows)


@inline
def keeps_sign(coefficients: Reals, noise: float) -> bool:
    """Return True if the Chebyshev coefficients of a function prove that it keeps its sign.

    The unresolved part is estimated as `TAIL` times the last coefficients.
    """
    variation = abs(coefficients[1])
    for coefficient in coefficients[2:]:
        variation = variation + abs(coefficient)
    variation = variation + TAIL * magnitude(coefficients[-2], coefficients[-1]) + 4.0 * noise
    return abs(coefficients[0]) > CERTAINTY * variation


@inline
def largest(values: Reals) -> float:
    """Return the largest magnitude of the values, NaN if one of them is NaN."""
    size = values[0]
    for number in values[1:]:
        size = magnitude(size, number)
    return size


@procedure(apart=True)
def chebyshev(values: In, out: Out) -> float:
    """Write the Chebyshev coefficients of a function to `out`, from its `values` at the nodes.

    Return the largest magnitude of the values.
    """
    numbers = tuple(values[k] for k in unrolled(DEGREE + 1))
    for k, coefficient in enumerate(transform(numbers)):
        out[k] = coefficient
    return largest(numbers)


@procedure
def local_polynomial(
    chebyshev: In, size: float, noise: float, before: float, least: float, powers: Out
) -> tuple[int, float, float]:
    """Write the coefficients of the polynomial that resolves a function on a part of a step to `powers`.

    Return the number of coefficients, their error, and the size of the last `chebyshev` ones. `chebyshev` are the
    Chebyshev coefficients of the function, `size` is its largest sampled magnitude, and `noise` its rounding
    error. The number is 0 if the function is not resolved, and 1 if only its sign is certain. Coefficients
    below rounding, or below `least`, are omitted and counted as noise. The coefficients beyond the degree are
    noise as well: at a kink they decrease so slowly that their sum is several times the last one. The last
    coefficients are also noise if halving the interval did not reduce them clearly; `before` is their size
    before that.
    """
    coefficients = tuple(chebyshev[k] for k in unrolled(DEGREE + 1))
    tail = magnitude(coefficients[-2], coefficients[-1])
    is_grain = tail > before * 0.25 and tail <= LARGEST_NOISE * size
    error = noise + (8.0 * tail if is_grain else TINY)
    if unlikely(not size < math.inf):
        return 0, error, tail
    if unlikely(not tail <= error + 8 * EPSILON * size):
        if keeps_sign(coefficients, error):
            powers[0] = coefficients[0]
            return 1, error, tail
        return 0, error, tail
    floor = larger(EPSILON * size, least)
    count, left = 1, 0.0
    for k, coefficient in enumerate(coefficients):
        count = k + 1 if abs(coefficient) > floor else count
    for k, coefficient in enumerate(coefficients):
        left = left + (0.0 if count > k else abs(coefficient))
    kept = tuple(coefficient if count > k else 0.0 for k, coefficient in enumerate(coefficients))
    for power, row in enumerate(to_powers(DEGREE).tolist()):
        powers[power] = weighted(kept[power:], row[power:])
    return count, error + (left + 4.0 * DEGREE * tail), tail
