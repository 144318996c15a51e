"""A function on a step as a polynomial, where its values at Chebyshev's points tell it to round-off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

from lagrange.algorithm.events.chebyshev import DEGREE, to_chebyshev, to_powers
from lagrange.algorithm.events.constants import CERTAINTY, EPSILON, LARGEST_NOISE, TAIL, TINY
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real


def transform(p: Builder, values: Sequence[Real]) -> list[Real]:
    """Return Chebyshev coefficients from the values at the nodes.

    Polynomials of even rank are even about the middle, the others odd: half of the products.
    """
    degree = len(values) - 1
    matrix, middle = to_chebyshev(degree).tolist(), degree // 2
    sums = [values[k] + values[degree - k] for k in range(middle)] + [values[middle]]
    differences = [values[k] - values[degree - k] for k in range(middle)]
    found = []
    for rank, row in enumerate(matrix):
        terms = differences if rank % 2 else sums
        total = terms[0] * row[0]
        for term, weight in zip(terms[1:], row[1:], strict=False):
            total = p.fma(term, weight, total)
        found.append(total)
    return found


def keeps_sign(p: Builder, coefficients: Sequence[Real], noise: Real) -> Flag:
    """Return true if the Chebyshev coefficients of a function show that it keeps its sign.

    The unresolved part is estimated as eight times the last coefficients.
    """
    others = abs(coefficients[1])
    for one in coefficients[2:]:
        others = others + abs(one)
    others = others + TAIL * p.magnitude(coefficients[-2], coefficients[-1]) + 4.0 * noise
    found: Flag = abs(coefficients[0]) > CERTAINTY * others
    return found


@shared
def chebyshev() -> Procedure:
    """Return the procedure that writes Chebyshev coefficients from values of a function, and returns the largest."""
    p = Builder("chebyshev", "Write Chebyshev coefficients; return the size of the values.", apart=True)
    values, out = p.array("values", read=True), p.array("out")
    found = [values[k] for k in range(DEGREE + 1)]
    for k, one in enumerate(transform(p, found)):
        out[k] = one
    p.leave(reduce(p.magnitude, found))
    return p.finish(REAL)


@shared
def local_polynomial() -> Procedure:
    """Return the procedure that writes a resolved function as a polynomial in powers, or its sign if that is certain.

    Coefficients below round-off, or below `least`, are left out and counted as noise. So are those beyond the degree:
    at a kink they fall so slowly that their sum is the last one times some degrees. Last coefficients that halving did
    not make smaller than `before` are noise too. It returns the number of coefficients (0 if the function is not
    resolved), their error, and the size of the last coefficients.
    """
    p = Builder("local_polynomial", "Write a function as powers; return their number and noise.", apart=True)
    given, size = p.array("given", read=True), p.given("size", REAL)
    noise, before, least = (p.given(name, REAL) for name in ("noise", "before", "least"))
    powers = p.array("powers")
    coefficients = [given[k] for k in range(DEGREE + 1)]
    tail = p.magnitude(coefficients[-2], coefficients[-1]).called("tail")
    grain = (tail > before * 0.25) & (tail <= LARGEST_NOISE * size)
    blur = (noise + p.choose(grain, 8.0 * tail, TINY)).called("blur")
    p.leave_if(~(size < math.inf), 0, blur, tail, likely=False)
    with p.when(~(tail <= blur + 8 * EPSILON * size), likely=False):
        with p.when(keeps_sign(p, coefficients, blur)):
            powers[0] = coefficients[0]
            p.leave(1, blur, tail)
        p.leave(0, blur, tail)
    floor = p.larger(EPSILON * size, least)
    count, left = p.variable(1, "count"), p.variable(0.0, "left")
    for k, one in enumerate(coefficients):
        count.value = p.choose(abs(one) > floor, p.whole(k + 1), count.value)
    kept = []
    for k, one in enumerate(coefficients):
        within = count.value > k
        left.value = left.value + p.choose(within, 0.0, abs(one))
        kept.append(p.choose(within, one, 0.0))
    write_powers(p, kept, powers)
    p.leave(count.value, blur + (left.value + 4.0 * DEGREE * tail), tail)
    return p.finish(WHOLE, REAL, REAL)


def write_powers(p: Builder, coefficients: Sequence[Real], powers: Memory) -> None:
    """Write the coefficients of powers of a polynomial."""
    for power, row in enumerate(to_powers(len(coefficients) - 1).tolist()):
        total = coefficients[power] * row[power]
        for one, weight in zip(coefficients[power + 1 :], row[power + 1 :], strict=True):
            total = p.fma(one, weight, total)
        powers[power] = total
