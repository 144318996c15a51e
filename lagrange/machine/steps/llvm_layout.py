"""The vectors of a step in memory, padded to whole blocks, and what is done with them block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.machine.kernel import llvm_calling
from lagrange.machine.kernel.llvm_calling import BLOCK
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import DriverState
from lagrange.procedure.step.memory import Layout
from lagrange.program.step import StepProgram

KIND, TRUTH = (f"<{BLOCK} x {kind}>" for kind in ("double", "i1"))
"""LLVM's types of a block of numbers, and of truths."""

UNROLLED_BLOCKS = 2
"""Up to this many blocks per vector are written out; longer vectors are looped over."""


def laid_out(step: StepProgram, dimension: int) -> Layout:
    """Return where the vectors of a step stand, in blocks."""
    return Layout(step, dimension, block=BLOCK, in_registers=llvm_calling.fit(dimension))


def blocks(e: Emitter, width: int) -> Iterator[str | int]:
    """Repeat the body of a for statement for the offset of each block, unrolled or in a loop of the machine."""
    if width <= UNROLLED_BLOCKS * BLOCK:
        yield from range(0, width, BLOCK)
    else:
        with e.loop(0, width, BLOCK) as i:
            yield i


def in_work(e: Emitter, place: int, offset: str | int) -> str:
    """Return the address of a block: `offset` doubles behind a place of the work array."""
    return e.address(e.address("%work", place), offset)


def keep_entries(e: Emitter, layout: Layout, values: Sequence[str], target: int) -> None:
    """Store numbers in registers as the blocks of a vector, filled up with zeros."""
    for begin in range(0, layout.width, BLOCK):
        block = "zeroinitializer"
        for lane, value in enumerate(values[begin : begin + BLOCK]):
            block = e.value(f"insertelement {KIND} {block}, double {value}, i64 {lane}")
        e.store(block, in_work(e, target, begin), KIND)


def total(e: Emitter, vector: str) -> str:
    """Return the sum of a block's entries, in a fixed order."""
    parts = [e.value(f"extractelement {KIND} {vector}, i64 {k}") for k in range(BLOCK)]
    left = e.value(f"fadd double {parts[0]}, {parts[1]}")
    right = e.value(f"fadd double {parts[2]}, {parts[3]}")
    return e.value(f"fadd double {left}, {right}")


def largest(e: Emitter, vector: str) -> str:
    """Return the largest of a block's entries, NaN if one is."""
    parts = [e.value(f"extractelement {KIND} {vector}, i64 {k}") for k in range(BLOCK)]
    return e.larger(e.larger(parts[0], parts[1]), e.larger(parts[2], parts[3]))


def in_floors(e: Emitter, offset: str | int) -> str:
    """Return the address of the block at an offset of the floors of the state."""
    return e.address(e.address("%reals", DriverState.FLOORS), offset)


def finite(e: Emitter, layout: Layout, vectors: Sequence[int]) -> str:
    """Return whether all entries are finite: 0 * x is 0 for these alone, and NaN for the others."""
    memory = e.reserve(KIND)
    e.store("zeroinitializer", memory, KIND)
    for vector in vectors:
        for offset in blocks(e, layout.width):
            value = e.load(in_work(e, layout.place(vector), offset), KIND)
            e.store(e.fma(value, "zeroinitializer", e.load(memory, KIND), KIND), memory, KIND)
    return e.value(f"fcmp oeq double {total(e, e.load(memory, KIND))}, {literal(0.0)}")


def splat(e: Emitter, scalar: str) -> str:
    """Return a number in every entry of a block."""
    return e.splat(scalar, KIND)
