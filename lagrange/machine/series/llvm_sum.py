"""The sum of a Taylor series on a step, and its derivative, in machine code."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.spelling import number
from lagrange.machine.series.llvm_step_size import StepSize

TILE = 16
"""How many vectors of the state are summed in one loop."""

Placed = list[tuple[int, str]]
"""Vectors with their places in the state."""


def increments(e: Emitter, size: StepSize, s: str) -> Placed:
    """Return the sums of x[k] s**k over k > 0: four chains in s**4, which take a quarter of the time of one."""
    kind = size.kind
    square = e.real("fmul", s, s)
    s1, s2, s4 = (e.splat(power, kind) for power in (s, square, e.real("fmul", square, square)))
    found = []
    for place in range(0, size.layout.padded, size.layout.lanes):
        chains = [_horner(e, size, first, place, s4) for first in (1, 2, 3, 4)]
        odd = e.fma(s2, chains[2], chains[0], kind)
        even = e.fma(s2, chains[3], chains[1], kind)
        found.append((place, e.fma(s1, odd, e.value(f"fmul {kind} {s2}, {even}"), kind)))
    return found


def _horner(e: Emitter, size: StepSize, first: int, place: int, s4: str) -> str:
    """Return the sum of x[k] s**(k - first) over k = first, first + 4, ..."""
    orders = range(first, size.layout.order + 1, 4)
    total = size.entries(size.row(orders[-1]), place)
    for k in reversed(orders[:-1]):
        total = e.fma(total, s4, size.entries(size.row(k), place), size.kind)
    return total


def derivatives(e: Emitter, size: StepSize, s: str) -> Placed:
    """Return the sums of k x[k] s**(k - 1), by Horner's rule for a polynomial and its derivative.

    Only vectors with velocities in them are summed: what the equations say about coordinates is no news.
    """
    kind, factor = size.kind, e.splat(s, size.kind)
    found = []
    for place in size.with_velocities():
        total = size.entries(size.row(size.layout.order), place)
        slope = number(0.0, size.layout.lanes)
        for k in range(size.layout.order - 1, 0, -1):
            slope = e.fma(slope, factor, total, kind)
            total = e.fma(total, factor, size.entries(size.row(k), place), kind)
        found.append((place, e.fma(slope, factor, total, kind)))
    return found


def looped(e: Emitter, size: StepSize, s: str) -> tuple[Placed, Placed]:
    """Return the sums and their derivatives for any order: one chain for each vector, some vectors at a time."""
    kind, factor = size.kind, e.splat(s, size.kind)
    sums: Placed = []
    slopes: Placed = []
    places = list(range(0, size.layout.padded, size.layout.lanes))
    moving = size.with_velocities()
    for begin in range(0, len(places), TILE):
        tile = places[begin : begin + TILE]
        steep = [place for place in tile if place in moving]
        carried = [(kind, number(0.0, size.layout.lanes))] * (len(tile) + len(steep))
        with e.carry(0, size.order, carried) as loop:
            k = e.value(f"sub nsw i64 {size.order}, {loop.index}")
            row = e.address(size.rows, e.value(f"mul nsw i64 {k}, {size.layout.width}"))
            partial = {
                place: e.value(f"fadd {kind} {total}, {size.entries(row, place)}")
                for place, total in zip(tile, loop.values, strict=False)
            }
            loop.following = [e.value(f"fmul {kind} {partial[place]}, {factor}") for place in tile]
            loop.following += [
                e.fma(slope, factor, partial[place], kind)
                for place, slope in zip(steep, loop.values[len(tile) :], strict=True)
            ]
        sums += zip(tile, loop.values, strict=False)
        slopes += zip(steep, loop.values[len(tile) :], strict=True)
    return sums, slopes
