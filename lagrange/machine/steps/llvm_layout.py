"""The vectors of a step in memory, padded to whole blocks, and what is done with them block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from lagrange.graph.node import Node
from lagrange.machine.kernel import llvm_calling
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import spell
from lagrange.machine.state import DriverState
from lagrange.procedure.step.memory import Layout
from lagrange.program.actions import Combination
from lagrange.program.step import StepProgram

BLOCK = 4
"""Doubles that are loaded and stored at once."""

KIND = f"<{BLOCK} x double>"
TRUTH = f"<{BLOCK} x i1>"
"""LLVM's type of a block of numbers."""

UNROLLED_BLOCKS = 2
"""Up to this many blocks per vector are written out; longer vectors are looped over."""


def laid_out(step: StepProgram, dimension: int) -> Layout:
    """Return where the vectors of a step stand, in blocks."""
    return Layout(step, dimension, block=BLOCK, in_registers=llvm_calling.fit(dimension))


class Scalars:
    """The numbers of a step, made of t and h, emitted once each, in blocks as well.

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
        for op, args, place, value, *_ in program.instructions:
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


def combine(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, target: int) -> None:
    """Store a linear combination of vectors at an offset of the work array."""
    for offset in blocks(e, layout.width):
        value = combined(e, layout, scalars, combination, offset)
        e.store(value or "zeroinitializer", in_work(e, target, offset), KIND)


def combined(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination, offset: str | int) -> str:
    """Return a block of a linear combination of vectors, the empty string where there is nothing to combine."""
    one, total = layout.step.graph.one, ""
    for vector, coefficient in sorted(combination, key=lambda term: term[1] is not one):
        value = _block(e, layout, scalars, vector, offset)
        if coefficient is one:
            total = value if not total else e.value(f"fadd {KIND} {total}, {value}")
            continue
        factor = scalars.splat(e, coefficient)
        total = e.fma(factor, value, total, KIND) if total else e.value(f"fmul {KIND} {factor}, {value}")
    return total


def entries(e: Emitter, layout: Layout, scalars: Scalars, combination: Combination) -> list[str]:
    """Return the numbers of a linear combination, each in a register of its own.

    What was computed last is added last and number by number, so that nothing waits for what it does not need.
    """
    one = layout.step.graph.one
    known = [term for term in combination if term[0] in scalars.entries]
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


def _block(e: Emitter, layout: Layout, scalars: Scalars, vector: int, offset: str | int) -> str:
    """Return a block of a vector, from registers where it is there."""
    return scalars.fresh.get((vector, offset)) or e.load(in_work(e, layout.place(vector), offset), KIND)


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
