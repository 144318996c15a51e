"""Bernstein coefficients of a polynomial, and their subdivision. Their signs bound the number of roots."""

from __future__ import annotations

from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, magnitude, quotient

PASSES_AT_ONCE = 4
"""Number of passes over a triangle of sums that one loop does, so that each number is read and written once for all."""


@inline
def sign_of(x: float, noise: float) -> int:
    """Return the sign of a number, 1 or -1, or 0 if its size is at most `noise`."""
    return 1 if x > noise else -1 if x < -noise else 0


@procedure(apart=True)
def bernstein(c: In, count: int, b: Out) -> None:
    """Write the Bernstein coefficients on [0, 1] of a polynomial to b; c has its coefficients by powers.

    The coefficients are first divided by binomial coefficients, then summed in count - 1 passes. Pass i, from 0
    on, adds to each number from index i + 1 on the number before it.
    """
    weight = 1.0
    for k in range(count):
        b[k] = c[k] * weight
        weight *= float(k + 1) / float(count - 1 - k)
    remainder = count - 1 - quotient(count - 1, PASSES_AT_ONCE) * PASSES_AT_ONCE
    for first in range(remainder):
        before = b[first]
        for index in range(first + 1, count):
            value = b[index]
            b[index] = value + before
            before = value
    for first in range(remainder, count - 1, PASSES_AT_ONCE):
        add_four_times(b[first:], count - first)


@inline
def add_four_times(b: Out, count: int) -> None:
    """Make four passes of running sums over the `count` numbers in b, in place.

    Pass i = 0, 1, 2, 3 does b[j] = b[j] + b[j - 1] for j from i + 1 on. One loop does all four.
    """
    first1, first2, first3 = b[1] + b[0], b[2] + b[1], b[3] + b[2]
    second2, second3 = first2 + first1, first3 + first2
    w, x, y, z = b[3], first3, second3, second3 + second2
    b[1], b[2], b[3] = first1, second2, z
    for index in range(PASSES_AT_ONCE, count):
        number = b[index]
        once = number + w
        twice = once + x
        thrice = twice + y
        b[index] = thrice + z
        w, x, y, z = number, once, twice, thrice


@procedure
def signs(b: In, count: int, first: int, noise: float) -> tuple[bool, int, float]:
    """Return whether Bernstein coefficients b have at most one sign change, their last sign and largest size.

    `first` is the sign of the first coefficient, as decided for the previous interval: rounding must not decide
    it twice. A coefficient of size up to `noise` has no sign.
    """
    now, before, changes = first, first, 0
    size = abs(b[0])
    for j in range(1, count):
        x = b[j]
        sign = sign_of(x, noise)
        size = magnitude(size, x)
        if sign != now:
            changes += 1
            before = now
            now = sign
    # A change of sign through zero is one crossing. Values that reach zero and return are zero or two.
    through = changes == 2 and before == 0 and now == -first
    return changes < 2 or through, now, size


@procedure(apart=True)
def halve(b: Out, count: int, left: Out) -> None:
    """Replace Bernstein coefficients b by those of the right half; write those of the left half to `left`.

    This is de Casteljau's algorithm.
    """
    for done in range(1, count):
        left[done - 1] = b[0]
        for j in range(count - done):
            b[j] = (b[j] + b[j + 1]) * 0.5
    left[count - 1] = b[0]
