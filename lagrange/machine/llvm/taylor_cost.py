"""What a step of a Taylor series costs, in cycles or so: it decides between forms, and the order."""

from __future__ import annotations

from lagrange.machine.llvm.packing import Packing
from lagrange.machine.taylor import Cost

LARGE = 40
"""Chunks from which a series is computed in loops: written out, its code no longer fits the processor's cache, and its
compilation takes more than a quarter of a second."""


def is_large(packing: Packing) -> bool:
    """Return whether a series is better computed in loops."""
    return len(packing.configuration) + len(packing.trial) + len(packing.velocity) > LARGE


def jet_cost(packing: Packing, *, looped: bool) -> Cost:
    """Return the cost of a series."""
    chunks = len(packing.configuration) + len(packing.trial) + len(packing.velocity)
    sums = sum(len(chunk.sums) for chunk in packing.computed)
    n = packing.program.dimension
    solve = 0.0 if packing.program.diagonal else n * n / 8
    inversion = 0.0 if packing.program.constant_mass or packing.program.diagonal else n**3 / 8
    return Cost(
        fixed=200.0 + 2.0 * len(packing.program.start.instructions) + inversion,
        each=12.0 + 3.0 * chunks + solve + (40.0 if looped else 0.0),
        pairs=1.0 * sums,
    )
