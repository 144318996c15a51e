"""The vectors of a step in memory, padded to whole blocks, and what is done with them block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from lagrange.graph.node import Node
from lagrange.machine.kernel import llvm_calling
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import number, spell
from lagrange.machine.steps.newton_constants import HISTORY
from lagrange.program.actions import Combination, Damp, Solve, in_doubles, parts
from lagrange.program.step import StepProgram

BLOCK = 4
"""Doubles that are loaded and stored at once."""

KIND, TRUTH, PLACES = (f"<{BLOCK} x {kind}>" for kind in ("double", "i1", "i64"))
"""LLVM's types of a block of numbers, of truths, and of places."""

UNROLLED_BLOCKS = 2
"""Up to this many blocks per vector are written out; longer vectors are looped over."""


class Layout:
    """Where each vector of a step stands in the work array, and behind them what its solves and its starter keep.

    A step is `alone` if it is not the starter of another.
    """

    def __init__(self, step: StepProgram, dimension: int, *, alone: bool = True) -> None:
        self.step = step
        self.dimension = dimension
        self.length = dimension // 2 if step.partitioned else dimension
        self.width = -(-self.length // BLOCK) * BLOCK
        self.in_registers = llvm_calling.fit(dimension)
        """Whether the law takes and gives numbers in registers."""
        self.keeps_entries = self.in_registers and alone and step.starter is None and not step.exact
        """Whether the state stands in memory of single numbers as well, which LLVM makes registers of."""
        self.vectors = step.vectors
        self.new = self.vectors
        self.errors = self.new + step.states
        first_buffer = (self.errors + len(step.errors)) * self.width
        self.argument = first_buffer
        self.result = first_buffer + 2 * (dimension + BLOCK)
        end = self.result + 2 * (dimension + BLOCK)
        self.flags = -(-end // BLOCK) * BLOCK
        """Where the driver keeps whether the state one step back is known, and behind it whether the trial gives it."""
        end = self.flags + BLOCK
        self.solves: list[Newton] = []
        for i, solve in enumerate(step.solves):
            damped = [damp for damp in step.damps if damp.of == i]
            self.solves.append(Newton(end, i, solve, damped, self.length, dimension, step.control is not None))
            end = self.solves[-1].end
        self.lost = end
        """Where stands what rounding has taken from each state, and behind that what the trial step loses."""
        end += 2 * step.states * self.width if step.exact else 0
        self.end = end
        """Where the vectors of the starter stand, if there is one."""
        self.starting: Layout = self if step.starter is None else Layout(step.starter, dimension, alone=False)
        self.size: int = end if step.starter is None else end + self.starting.size

    def place(self, vector: int) -> int:
        """Return the offset of a vector."""
        return vector * self.width


class Newton:
    """What one solve keeps in the work array, from `start`: flags, vectors of all unknowns, and matrices.

    Vectors of unknowns are as wide as `count` padded vectors. The matrices are the inverse of the Newton matrix with
    the other sign and those that damp, by columns of that width; the law's derivative (2n, 2n) by columns; and room for
    a matrix that is being inverted, by rows `stride` apart.
    """

    FLAGS = 3 * BLOCK
    """Room for the flags, in whole blocks."""
    MATRIX_STEP, DERIVATIVE, RATE, NOISE, KNOWN, SOLVED, OLD_STEP, TRIED_STEP, AGE, ORDER = range(10)

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
    comes back from memory some 5 cycles later. `entries` has the single numbers of such vectors, and `state` is where
    those of the state are kept, if they are.
    """

    def __init__(
        self, e: Emitter, step: StepProgram, combinations: Iterable[Combination], nodes: Iterable[Node] = ()
    ) -> None:
        factors = [coefficient for combination in combinations for _, coefficient in combination]
        wanted = list(dict.fromkeys([*factors, *nodes, step.graph.one]))
        program = step.scalars(wanted)
        values: list[str] = []
        for op, args, place, value, _ in program.instructions:
            if op == "time":
                values.append("%t")
            elif op == "state":
                values.append(f"%{program.inputs[place].name}")
            elif op == "constant":
                values.append(literal(value))
            else:
                values.append(spell(e, op, [values[arg] for arg in args], 1))
        self.names = {node: values[ref] for node, ref in zip(wanted, program.outputs, strict=True)}
        self.splats: dict[Node, str] = {}
        self.fresh: dict[tuple[int, str | int], str] = {}
        self.entries: dict[int, list[str]] = {}
        self.state = ""
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


def in_work(e: Emitter, place: int, offset: str | int) -> str:
    """Return the address of a block: `offset` doubles behind a place of the work array."""
    return e.address(e.address("%work", place), offset)


def combine(
    e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, target: int, *, sizes: bool = False
) -> None:
    """Store a linear combination of vectors at an offset of the work array, or with `sizes` that of their sizes."""
    for offset in blocks(e, layout.width):
        value = combined(e, layout, scalars, combination, offset, sizes=sizes)
        e.store(value or "zeroinitializer", in_work(e, target, offset), KIND)


def combined(
    e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, offset: str | int, *, sizes: bool = False
) -> str:
    """Return a block of a linear combination of vectors, or with `sizes` of that of their sizes.

    It is the empty string where there is nothing to combine.
    """
    if layout.step.exact and not sizes:
        return _combined_exactly(e, layout, scalars, combination, offset)
    return _plain_sum(e, layout, scalars, combination, offset, sizes=sizes)


def _plain_sum(
    e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, offset: str | int, *, sizes: bool
) -> str:
    """Return a block of the sum of vectors times their numbers, or of the sizes of both."""
    one, total = layout.step.graph.one, ""
    for vector, coefficient in sorted(combination, key=lambda term: term[1] is not one):
        value = _block(e, layout, scalars, vector, offset)
        value = e.fabs(value, KIND) if sizes else value
        if coefficient is one:
            total = value if not total else e.value(f"fadd {KIND} {total}, {value}")
            continue
        factor = scalars.splat(e, coefficient)
        factor = e.fabs(factor, KIND) if sizes else factor
        total = e.fma(factor, value, total, KIND) if total else e.value(f"fmul {KIND} {factor}, {value}")
    return total


def entries(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination) -> list[str]:
    """Return the numbers of a linear combination, each in a register of its own.

    What was computed last is added last and number by number, so that nothing waits for what it does not need.
    """
    one = layout.step.graph.one
    known = [] if layout.step.exact else [term for term in combination if term[0] in scalars.entries]
    last = max(known, default=None, key=lambda term: term[0])
    before = tuple(term for term in combination if term is not last)
    totals = _apart(e, layout, scalars, before) if last is None or before else []
    if last is None:
        return totals
    values, coefficient = scalars.entries[last[0]], last[1]
    if coefficient is one:
        return [e.real("fadd", a, b) for a, b in zip(totals, values, strict=True)] if totals else values
    factor = scalars.names[coefficient]
    if not totals:
        return [e.real("fmul", factor, value) for value in values]
    return [e.fma(factor, value, sum_) for value, sum_ in zip(values, totals, strict=True)]


def _apart(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination) -> list[str]:
    """Return the numbers of a combination that are computed in blocks, or read where it is one vector."""
    if len(combination) == 1 and combination[0][1] is layout.step.graph.one:
        vector = combination[0][0]
        if scalars.state and vector < layout.step.states:
            return [e.get(scalars.state, vector * layout.length + i) for i in range(layout.length)]
        return [e.get("%work", layout.place(vector) + i) for i in range(layout.length)]
    made = {offset: combined(e, layout, scalars, combination, offset) for offset in range(0, layout.width, BLOCK)}
    return [e.value(f"extractelement {KIND} {made[i // BLOCK * BLOCK]}, i64 {i % BLOCK}") for i in range(layout.length)]


def keep_entries(e: Emitter, layout: Layout, values: Sequence[str], target: int) -> dict[int, str]:
    """Store numbers in registers as the blocks of a vector, filled up with zeros, and return the blocks."""
    made = {}
    for begin in range(0, layout.width, BLOCK):
        block = "zeroinitializer"
        for lane, value in enumerate(values[begin : begin + BLOCK]):
            block = e.value(f"insertelement {KIND} {block}, double {value}, i64 {lane}")
        e.store(block, in_work(e, target, begin), KIND)
        made[begin] = block
    return made


def _combined_exactly(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, offset: str | int) -> str:
    """Return a block of a linear combination: h multiplies its factors, in two doubles each, at once."""
    plain, scaled = parts(combination, layout.step.h)
    total = _plain_sum(e, layout, scalars, plain, offset, sizes=False)
    if not scaled:
        return total
    sums = ["", ""]
    for vector, factor in scaled:
        value = _block(e, layout, scalars, vector, offset)
        for i, part in enumerate(in_doubles(factor)):
            if part:
                constant = number(part, BLOCK)
                product = f"fmul {KIND} {constant}, {value}"
                sums[i] = e.fma(constant, value, sums[i], KIND) if sums[i] else e.value(product)
    slope = e.value(f"fadd {KIND} {sums[0]}, {sums[1]}") if sums[1] else sums[0]
    h = splat(e, "%h")
    return e.fma(h, slope, total, KIND) if total else e.value(f"fmul {KIND} {h}, {slope}")


def _block(e: Emitter, layout: Layout, scalars: Scalars, vector: int, offset: str | int) -> str:
    """Return a block of a vector, from registers where it is there."""
    return scalars.fresh.get((vector, offset)) or e.load(in_work(e, layout.place(vector), offset), KIND)


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
    return e.splat(scalar, KIND)


def unit_block(e: Emitter, row: str, offset: str | int) -> str:
    """Return the block at an offset of the vector that is 1 at a row and 0 elsewhere."""
    one, zero = splat(e, literal(1.0)), "zeroinitializer"
    return e.value(f"select {TRUTH} {lane_is(e, row, offset)}, {KIND} {one}, {KIND} {zero}")


def lane_is(e: Emitter, row: str, offset: str | int) -> str:
    """Return which entry of the block at an offset is that of a row."""
    return _compare_lanes(e, "eq", row, offset)


def _compare_lanes(e: Emitter, how: str, row: str | int, offset: str | int) -> str:
    """Return how a row compares with that of each entry of the block at an offset."""
    lane = e.value(f"sub nsw i64 {row}, {offset}")
    first = e.value(f"insertelement {PLACES} poison, i64 {lane}, i64 0")
    lanes = e.value(f"shufflevector {PLACES} {first}, {PLACES} poison, <{BLOCK} x i32> zeroinitializer")
    return e.value(f"icmp {how} {PLACES} {lanes}, <{', '.join(f'i64 {i}' for i in range(BLOCK))}>")


def cut_block(e: Emitter, block: str, length: int, offset: str | int) -> str:
    """Return a block at an offset with zeros behind the end of a vector."""
    if length % BLOCK == 0:
        return block
    inside = _compare_lanes(e, "sgt", length, offset)
    return e.value(f"select {TRUTH} {inside}, {KIND} {block}, {KIND} zeroinitializer")
