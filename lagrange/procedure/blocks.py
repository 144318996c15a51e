"""Whole blocks: machines compute on some numbers at once, and arrays have room for the last of them."""

from __future__ import annotations


def whole_blocks(count: int, block: int) -> int:
    """Return the least multiple of a block that is not below a count."""
    return -(-count // block) * block
