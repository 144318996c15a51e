"""Sizes of arrays in whole blocks: machines compute several numbers at once."""

from __future__ import annotations


def whole_blocks(count: int, block: int) -> int:
    """Return the least multiple of `block` that is at least `count`."""
    return -(-count // block) * block
