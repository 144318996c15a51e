"""Whole blocks: machines compute several numbers at once, and arrays have room for whole blocks."""

from __future__ import annotations


def whole_blocks(count: int, block: int) -> int:
    """Return the least multiple of `block` that is at least `count`."""
    return -(-count // block) * block
