"""Compensated addition: the sum of two numbers and its rounding error.

Source: D. E. Knuth, The Art of Computer Programming, vol. 2, 3rd ed., 1997, 4.2.2, theorem B.
"""

from __future__ import annotations

from typing import Any

from lagrange.procedure.front.decorators import inline


@inline
def compensated(y: Any, move: Any) -> tuple[Any, Any]:
    """Return the rounded sum of two reals, and its exact rounding error: (total, lost) with y + move = total + lost."""
    total = y + move
    back = total - y
    return total, (y - (total - back)) + (move - back)
