"""Short vectors of a series, gathered from entries of several values. A vector with one entry is a real."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, Packing
from lagrange.algorithm.series.rules import Term
from lagrange.procedure.builder import Builder
from lagrange.procedure.values import Entries, Memory, Real

LARGEST_STORED_BLOCK = 8
"""Largest block by which incomplete vectors are stored. Blocks are powers of two, the largest first."""


def width(x: Real | Entries) -> int:
    """Return the number of entries of a value."""
    return x.width if isinstance(x, Entries) else 1


def joined(p: Builder, parts_of: Sequence[tuple[Term, int]]) -> Term:
    """Return a vector of entries, each given as (value, index in the value); a value None is zero."""
    if all(x is None for x, _ in parts_of):
        return None
    given = [(p.real(0.0), 0) if x is None else (x, place) for x, place in parts_of]
    parts = {x.ref: x for x, _ in given}
    if len(parts) == 1 and [place for _, place in given] == list(range(width(given[0][0]))):
        return given[0][0]
    begin, starts = 0, {}
    for ref, x in parts.items():
        starts[ref] = begin
        begin += width(x)
    return p.permuted(list(parts.values()), [starts[x.ref] + place for x, place in given])


def gathered(p: Builder, packing: Packing, operand: Operand, x: Callable[[Chunk], Term]) -> Term:
    """Return an operand as a vector, gathered from the chunks that contain its entries.

    For a `ranked` operand, the factor (its order) is not included.
    """
    homes = [None if value == ZERO_LANE else packing.place[value] for value in operand.values]
    if homes[0] is not None and homes[0][0].values == operand.values:
        return x(homes[0][0])
    return joined(p, [(None, 0) if home is None else (x(home[0]), home[1]) for home in homes])


def of_width(p: Builder, x: Term, size: int) -> Term:
    """Return the first `size` entries of a value; None stands for zero."""
    return None if x is None else wide(p, x, size)


def wide(p: Builder, x: Term, size: int) -> Real | Entries:
    """Return a value of `size` entries, which is zero if it is None."""
    found = p.real(0.0) if x is None else x
    return p.broadcast(found, size) if size > width(found) else found


def entries(memory: Memory, place: int, size: int) -> Term:
    """Return `size` adjacent entries of an array, from index `place` on, as a value."""
    return memory[place] if size == 1 else memory.entries(place, size)


def put(p: Builder, memory: Memory, place: int, x: Term, size: int, count: int) -> None:
    """Write the first `count` entries of a value of `size` entries, and nothing else."""
    whole: Term = wide(p, x, size)
    lane, part = 0, LARGEST_STORED_BLOCK
    while lane < count:
        while part > count - lane:
            part //= 2
        piece = whole if part == size else p.permuted([whole], range(lane, lane + part))
        if part == 1:
            memory[place + lane] = piece
        else:
            memory.put(place + lane, piece)
        lane += part
