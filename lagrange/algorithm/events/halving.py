"""Bernstein coefficients of a polynomial, whose signs bound its number of roots, and their subdivision."""

from __future__ import annotations

from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, magnitude, quotient

PASSES_AT_ONCE = 4
"""Passes of a triangle of sums that are done in one loop, so that each number is read and written once for all."""


@inline
def sign_of(x: float, doubt: float) -> int:
    """Return 1, -1, or 0 for a size up to `doubt`."""
    return 1 if x > doubt else -1 if x < -doubt else 0


@procedure(apart=True)
def bernstein(c: In, count: int, b: Out) -> None:
    """Write the Bernstein coefficients on [0, 1] of a polynomial.

    Those of s**k of degree n are the forward differences of the rank k over the binomial coefficient of n and k.
    Pass i adds to each number from i + 1 on the one before it.
    """
    weight = 1.0
    for k in range(count):
        b[k] = c[k] * weight
        weight *= float(k + 1) / float(count - 1 - k)
    rest = count - 1 - quotient(count - 1, PASSES_AT_ONCE) * PASSES_AT_ONCE
    for first in range(rest):
        before = b[first]
        for place in range(first + 1, count):
            given = b[place]
            b[place] = given + before
            before = given
    for first in range(rest, count - 1, PASSES_AT_ONCE):
        add_four_times(b[first:], count - first)


@inline
def add_four_times(b: Out, count: int) -> None:
    """Add to each number the one before it, in four passes; pass i begins at index i + 1."""
    first1, first2, first3 = b[1] + b[0], b[2] + b[1], b[3] + b[2]
    second2, second3 = first2 + first1, first3 + first2
    w, x, y, z = b[3], first3, second3, second3 + second2
    b[1], b[2], b[3] = first1, second2, z
    for place in range(PASSES_AT_ONCE, count):
        number = b[place]
        once = number + w
        twice = once + x
        thrice = twice + y
        b[place] = thrice + z
        w, x, y, z = number, once, twice, thrice


@procedure
def signs(b: In, count: int, first: int, doubt: float) -> tuple[bool, int, float]:
    """Return True if coefficients allow at most one sign change, their last sign, and their largest size.

    `first` is the sign of the first one, as decided for the interval before: round-off must not decide it twice.
    """
    now, before, changes = first, first, 0
    size = abs(b[0])
    for j in range(1, count):
        x = b[j]
        sign = sign_of(x, doubt)
        size = magnitude(size, x)
        if sign != now:
            changes += 1
            before = now
            now = sign
    # From one side through zero to the other is one passage; from zero and back to it is zero or two.
    through = changes == 2 and before == 0 and now == -first
    return changes < 2 or through, now, size


@procedure(apart=True)
def halve(b: Out, count: int, left: Out) -> None:
    """Replace Bernstein coefficients by those of the right half, and write those of the left half, by de Casteljau."""
    for done in range(1, count):
        left[done - 1] = b[0]
        for j in range(count - done):
            b[j] = (b[j] + b[j + 1]) * 0.5
    left[count - 1] = b[0]
