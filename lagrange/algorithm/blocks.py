"""Array sizes that are whole blocks, because machines compute several numbers at once."""

from __future__ import annotations

WIDEST_VECTOR = 8
"""Number of doubles in the widest vectors of processors. That many numbers, steps or members are computed at once."""


def whole_blocks(count: int, block: int) -> int:
    """Return the least multiple of `block` that is at least `count`."""
    return -(-count // block) * block
