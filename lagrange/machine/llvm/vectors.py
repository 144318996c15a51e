"""The vectors of a step in memory, padded to whole blocks, and what is done with them block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from lagrange.graph.node import Node
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import spell
from lagrange.machine.newton import HISTORY
from lagrange.program.actions import Combination, Damp, Solve
from lagrange.program.lower import lower
from lagrange.program.step import StepProgram

BLOCK = 4
KIND = f"<{BLOCK} x double>"
UNROLLED_BLOCKS = 2
"""Up to this many blocks per vector are written out; longer vectors are looped over."""


class Layout:
    """Where each vector of a step stands in the work array, and behind them what its solves and its starter keep."""

    def __init__(self, step: StepProgram, dimension: int) -> None:
        self.step = step
        self.dimension = dimension
        self.length = dimension // 2 if step.partitioned else dimension
        self.width = -(-self.length // BLOCK) * BLOCK
        self.vectors = step.vectors
        self.new = self.vectors
        self.errors = self.new + step.states
        first_buffer = (self.errors + len(step.errors)) * self.width
        self.argument = first_buffer
        self.result = first_buffer + 2 * (dimension + BLOCK)
        end = self.result + 2 * (dimension + BLOCK)
        self.flags = -(-end // BLOCK) * BLOCK
        """Where the driver keeps whether the state one step back is known."""
        end = self.flags + BLOCK
        self.solves: list[Newton] = []
        for i, solve in enumerate(step.solves):
            damped = [damp for damp in step.damps if damp.of == i]
            self.solves.append(Newton(end, i, solve, damped, self.length, dimension, step.control is not None))
            end = self.solves[-1].end
        self.end = end
        """Where the vectors of the starter stand, if there is one."""
        self.starting: Layout = self if step.starter is None else Layout(step.starter, dimension)
        self.size: int = end if step.starter is None else end + self.starting.size

    def place(self, vector: int) -> int:
        """Return the offset of a vector."""
        return vector * self.width


class Newton:
    """What one solve keeps in the work array, from `start`: flags, vectors of all unknowns, and matrices.

    Vectors of unknowns are as wide as `count` padded vectors. The matrices are the inverse of the Newton matrix with
    the other sign and those that damp, by columns of that width; the law's derivative (2n, 2n) by rows; and room for
    a matrix that is being inverted, by rows `stride` apart.
    """

    FLAGS = 12
    MATRIX_STEP, DERIVATIVE, RATE, NOISE, KNOWN, SOLVED, OLD_STEP, TRIED_STEP, AGE = range(9)

    def __init__(
        self, start: int, index: int, solve: Solve, damped: list[Damp], length: int, dimension: int, adaptive: bool
    ) -> None:
        self.index, self.solve, self.damped, self.adaptive = index, solve, damped, adaptive
        self.length = length
        self.width = -(-length // BLOCK) * BLOCK
        self.unknowns = solve.count * length
        self.all = solve.count * self.width
        self.stride = -(-self.unknowns // BLOCK) * BLOCK
        self.flags = start
        self.residual = start + self.FLAGS
        self.weights = self.residual + self.all
        self.history = self.weights + self.all
        self.sizes = self.history + (1 if adaptive else HISTORY) * self.all
        self.places = self.sizes + self.all
        self.inverse = self.places + 2 * self.width
        self.dampers = self.inverse + self.unknowns * self.all
        self.derivative = self.dampers + len(damped) * length * self.width
        self.matrix = -(-(self.derivative + dimension * dimension) // BLOCK) * BLOCK
        self.pivots = self.matrix + self.unknowns * self.stride
        self.end = self.pivots + 3 * self.stride

    def damper(self, damp: Damp) -> int:
        """Return the offset of the matrix that damps."""
        return self.dampers + self.damped.index(damp) * self.length * self.width


class Scalars:
    """The numbers of a step, made of t, h and the ratio of steps, emitted once each, in blocks as well.

    `fresh` has the blocks of vectors that are in registers already, by vector and offset: what has just been computed
    comes back from memory some 5 cycles later.
    """

    def __init__(
        self, e: Emitter, step: StepProgram, combinations: Iterable[Combination], nodes: Iterable[Node] = ()
    ) -> None:
        factors = [coefficient for combination in combinations for _, coefficient in combination]
        wanted = list(dict.fromkeys([*factors, *nodes, step.graph.one]))
        program = lower("scalars", wanted, (len(wanted),), [step.h, step.ratio], step.time, [])
        values: list[str] = []
        for op, args, data in program.instructions:
            if op == "time":
                values.append("%t")
            elif op == "state":
                values.append("%h" if data == 0 else "%ratio")
            elif op == "constant":
                values.append(literal(data))
            else:
                values.append(spell(e, op, [values[arg] for arg in args], 1))
        self.names = {node: values[ref] for node, ref in zip(wanted, program.outputs, strict=True)}
        self.splats: dict[Node, str] = {}
        self.fresh: dict[tuple[int, str | int], str] = {}
        for node in factors:
            if node is not step.graph.one:
                self.splat(e, node)

    def splat(self, e: Emitter, node: Node) -> str:
        """Return a number in every entry of a block."""
        if node not in self.splats:
            self.splats[node] = splat(e, self.names[node])
        return self.splats[node]


def blocks(e: Emitter, width: int) -> Iterator[str | int]:
    """Repeat the body of a for statement for the offset of each block, unrolled or in a loop of the machine."""
    if width <= UNROLLED_BLOCKS * BLOCK:
        yield from range(0, width, BLOCK)
    else:
        with e.loop(0, width, BLOCK) as i:
            yield i


def pieces(length: int) -> Iterator[tuple[int, int]]:
    """Yield (first, width) of the blocks of a vector and of the pieces of two and one that are left."""
    begin = 0
    for width in (BLOCK, 2, 1):
        while begin + width <= length:
            yield begin, width
            begin += width


def in_work(e: Emitter, place: int, offset: str | int) -> str:
    """Return the address of a block: `offset` doubles behind a place of the work array."""
    return e.address(e.address("%work", place), offset)


def combine(
    e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, target: int, *, sizes: bool = False
) -> None:
    """Store a linear combination of vectors at an offset of the work array, or with `sizes` that of their sizes."""
    one = layout.step.graph.one
    factors = {i: scalars.splat(e, c) for i, c in combination if c is not one}
    if sizes:
        factors = {i: e.fabs(factor, KIND) for i, factor in factors.items()}
    for offset in blocks(e, layout.width):
        total = ""
        for vector, coefficient in sorted(combination, key=lambda term: term[1] is not one):
            known = scalars.fresh.get((vector, offset))
            value = known or e.load(in_work(e, layout.place(vector), offset), KIND)
            value = e.fabs(value, KIND) if sizes else value
            if coefficient is one:
                total = value if not total else e.value(f"fadd {KIND} {total}, {value}")
            elif not total:
                total = e.value(f"fmul {KIND} {factors[vector]}, {value}")
            else:
                total = e.fma(factors[vector], value, total, KIND)
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
        for offset in blocks(e, layout.width):
            value = e.load(in_work(e, layout.place(vector), offset), KIND)
            e.store(e.fma(value, "zeroinitializer", e.load(memory, KIND), KIND), memory, KIND)
    return e.value(f"fcmp oeq double {total(e, e.load(memory, KIND))}, {literal(0.0)}")


def splat(e: Emitter, scalar: str) -> str:
    """Return a number in every entry of a block."""
    one = e.value(f"insertelement {KIND} poison, double {scalar}, i64 0")
    return e.value(f"shufflevector {KIND} {one}, {KIND} poison, <{BLOCK} x i32> zeroinitializer")
