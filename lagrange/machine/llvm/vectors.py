"""The vectors of a step in memory, padded to whole blocks, and what is done with them block by block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.graph.node import Node
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import spell
from lagrange.program.lower import lower
from lagrange.program.step import Combination, StepProgram

BLOCK = 4
KIND = f"<{BLOCK} x double>"
UNROLLED_BLOCKS = 2
"""Up to this many blocks per vector are written out; longer vectors are looped over."""


class Layout:
    """Where each vector of a step stands in the work array."""

    def __init__(self, step: StepProgram, dimension: int) -> None:
        self.step = step
        self.dimension = dimension
        self.length = dimension // 2 if step.partitioned else dimension
        self.width = -(-self.length // BLOCK) * BLOCK
        self.vectors = step.states + len(step.calls)
        self.new = self.vectors
        self.errors = self.new + step.states
        first_buffer = (self.errors + len(step.errors)) * self.width
        self.argument = first_buffer
        self.result = first_buffer + 2 * (dimension + BLOCK)
        self.size = self.result + 2 * (dimension + BLOCK)

    def place(self, vector: int) -> int:
        """Return the offset of a vector."""
        return vector * self.width


class Scalars:
    """The numbers of a step, made of t and h, emitted once each."""

    def __init__(self, e: Emitter, step: StepProgram, nodes: Sequence[Node]) -> None:
        wanted = list(dict.fromkeys(nodes))
        program = lower("scalars", wanted, (len(wanted),), [step.h], step.time, [])
        values: list[str] = []
        for op, args, data in program.instructions:
            if op == "time":
                values.append("%t")
            elif op == "state":
                values.append("%h")
            elif op == "constant":
                values.append(literal(data))
            else:
                values.append(spell(e, op, [values[arg] for arg in args], 1))
        self.names = {node: values[ref] for node, ref in zip(wanted, program.outputs, strict=True)}
        self.splats: dict[Node, str] = {}

    def splat(self, e: Emitter, node: Node) -> str:
        """Return a number in every entry of a block."""
        if node not in self.splats:
            self.splats[node] = splat(e, self.names[node])
        return self.splats[node]


def blocks(e: Emitter, layout: Layout) -> Iterator[str | int]:
    """Repeat the body of a for statement for the offset of each block, unrolled or in a loop of the machine."""
    if layout.width <= UNROLLED_BLOCKS * BLOCK:
        yield from range(0, layout.width, BLOCK)
    else:
        with e.loop(0, layout.width, BLOCK) as i:
            yield i


def in_work(e: Emitter, place: int, offset: str | int) -> str:
    """Return the address of a block: `offset` doubles behind a place of the work array."""
    return e.address(e.address("%work", place), offset)


def combine(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, target: int) -> None:
    """Store a linear combination of vectors at an offset of the work array."""
    one = combination[0][1].graph.one if combination else None
    splats = {i: scalars.splat(e, c) for i, c in combination if c is not one}
    for offset in blocks(e, layout):
        total = ""
        for vector, coefficient in sorted(combination, key=lambda term: term[1] is not one):
            value = e.load(in_work(e, layout.place(vector), offset), KIND)
            if coefficient is one:
                total = value if not total else e.value(f"fadd {KIND} {total}, {value}")
            elif not total:
                total = e.value(f"fmul {KIND} {splats[vector]}, {value}")
            else:
                total = e.fma(splats[vector], value, total, KIND)
        e.store(total or "zeroinitializer", in_work(e, target, offset), KIND)


def total(e: Emitter, vector: str) -> str:
    """Return the sum of a block's entries, in a fixed order."""
    parts = [e.value(f"extractelement {KIND} {vector}, i64 {k}") for k in range(BLOCK)]
    left = e.value(f"fadd double {parts[0]}, {parts[1]}")
    right = e.value(f"fadd double {parts[2]}, {parts[3]}")
    return e.value(f"fadd double {left}, {right}")


def finite(e: Emitter, layout: Layout, vectors: Sequence[int]) -> str:
    """Return whether all entries are finite: 0 * x is 0 for these alone, and NaN for the others."""
    memory = e.reserve(KIND)
    e.store("zeroinitializer", memory, KIND)
    for vector in vectors:
        for offset in blocks(e, layout):
            value = e.load(in_work(e, layout.place(vector), offset), KIND)
            e.store(e.fma(value, "zeroinitializer", e.load(memory, KIND), KIND), memory, KIND)
    return e.value(f"fcmp oeq double {total(e, e.load(memory, KIND))}, {literal(0.0)}")


def splat(e: Emitter, scalar: str) -> str:
    """Return a number in every entry of a block."""
    one = e.value(f"insertelement {KIND} poison, double {scalar}, i64 0")
    return e.value(f"shufflevector {KIND} {one}, {KIND} poison, <{BLOCK} x i32> zeroinitializer")
