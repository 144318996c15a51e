"""Compensated addition: the sum of two numbers and its rounding error.

Source: D. E. Knuth, The Art of Computer Programming, vol. 2, 3rd ed., 1997, 4.2.2, theorem B.
"""

from __future__ import annotations

from lagrange.procedure.values import Real


def compensated(y: Real, move: Real) -> tuple[Real, Real]:
    """Return the rounded sum and its exact rounding error: y + move = total + lost."""
    total = y + move
    back = total - y
    return total, (y - (total - back)) + (move - back)
