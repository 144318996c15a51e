"""What written-out and looped jets share: operands gathered from chunks, constants, and order 0."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.sine_cosine import call_sine_and_cosine, sine_and_cosine
from lagrange.machine.llvm.spelling import element, number
from lagrange.machine.series.llvm_rules import Orders, VectorName, vector_literal
from lagrange.machine.series.llvm_start import LlvmStart, angles
from lagrange.procedure.operations import ANGLES
from lagrange.procedure.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.program.program import Instruction, Program

SIGNATURE = (
    "define i32 @jet(double %t, double %scale, ptr noalias readonly %y, ptr noalias readonly %p, "
    "ptr noalias readonly %c, ptr noalias %rows, i64 %order) #0"
)


ANGLES_AT_ONCE = 8
"""Number of angles whose sines and cosines are computed at once."""

INLINE_ANGLES = 256
"""Up to this many angles their sines and cosines are written out; beyond it they are a function.

20,000 cosines were 76 million characters of IR, which take two minutes to compile.
"""


def shares_wide_angles(program: Program) -> bool:
    """Return whether the sines and cosines of several angles at once are a function of the module."""
    return len(angles(program)) > INLINE_ANGLES


class VectorConstants:
    """Vectors of constants: which entries of the table of constants are where in memory, from `begin` on."""

    def __init__(self, known: Sequence[float | None], begin: int) -> None:
        self.known = known
        self.places: dict[tuple[int, ...], int] = {}
        self.size = begin

    def place(self, lanes: tuple[int, ...]) -> int:
        """Return where the vector of some entries stands."""
        if lanes not in self.places:
            self.places[lanes] = self.size
            self.size += len(lanes)
        return self.places[lanes]

    @property
    def order(self) -> list[int]:
        """The place in the table of constants of each entry."""
        return [place for lanes in self.places for place in lanes]


class Shuffle:
    """Gathers vectors from others."""

    def __init__(self, e: Emitter) -> None:
        self.e = e

    def gather(self, lanes: Sequence[tuple[VectorName, int, int]]) -> VectorName:
        """Return a vector whose lanes are (vector, its width, lane in it); a missing vector gives zero."""
        sources = {vector: width for vector, width, _ in lanes if vector is not None}
        if not sources:
            return None
        count = len(lanes)
        if count == 1:
            return self.lane(*lanes[0])
        total = ""
        filled: set[int] = set()
        for source, width in sources.items():
            here = {i: lane for i, (vector, _, lane) in enumerate(lanes) if vector == source}
            part = self._moved(source, width, here, count)
            total = self._merged(total, part, set(here), count) if total else part
            filled |= set(here)
        return total if len(filled) == count else self._merged(number(0.0, count), total, filled, count)

    def operand(self, packing: Packing, operand: Operand, x: Callable[[Chunk], VectorName]) -> VectorName:
        """Return an operand as it is, not times its order, from the vectors of its values' chunks."""
        homes = [None if value == ZERO_LANE else packing.place[value] for value in operand.values]
        if homes[0] is not None and homes[0][0].values == operand.values:
            return x(homes[0][0])
        return self.gather(
            [(None, 1, 0) if home is None else (x(home[0]), len(home[0].values), home[1]) for home in homes]
        )

    def lane(self, vector: VectorName, width: int, lane: int) -> VectorName:
        """Return one entry of a vector."""
        if vector is None or width == 1:
            return vector
        return self.e.value(f"extractelement {element(width)} {vector}, i64 {lane}")

    def _moved(self, source: str, width: int, here: dict[int, int], count: int) -> str:
        """Return a vector with lanes of the source where they are wanted."""
        kind = element(count)
        if width == 1:
            if len(here) == count:
                return self.e.splat(source, kind)
            total = "poison"
            for i in here:
                total = self.e.value(f"insertelement {kind} {total}, double {source}, i64 {i}")
            return total
        if width == count and all(i == lane for i, lane in here.items()):
            return source
        mask = ", ".join(f"i32 {here[i]}" if i in here else "i32 poison" for i in range(count))
        return self.e.value(
            f"shufflevector {element(width)} {source}, {element(width)} poison, <{count} x i32> <{mask}>"
        )

    def _merged(self, a: str, b: str, chosen: set[int], count: int) -> str:
        """Return a with some lanes from b."""
        mask = ", ".join(f"i32 {count + i if i in chosen else i}" for i in range(count))
        return self.e.value(f"shufflevector {element(count)} {a}, {element(count)} {b}, <{count} x i32> <{mask}>")


class OrderZero:
    """Order 0 of a jet, as scalars, by the program that computes it.

    What rounding lost of the state stands `padded` numbers behind it.
    """

    def __init__(self, packing: Packing, padded: int) -> None:
        self.packing = packing
        program = packing.program
        self.body = LlvmStart(program.start)
        self.e: Emitter = self.body.e
        for i, (op, _, place, *_) in enumerate(program.start.instructions):
            if op == "state":
                size = 2 * program.dimension
                self.body.give(i, self.e.get("%y", place if place < size else padded + place - size))
        early = self.early()
        self.body.run(early)
        done = set(early)
        there = done.union(self.body.there)
        self.find_angles([ref for ref in angles(program.start) if ref in there])
        rest = range(program.start.hoisted, len(program.start.instructions))
        self.body.run([i for i in rest if i not in done])
        outputs = [self.body.ref(ref) for ref in program.start.outputs]
        self.values = dict(zip(program.started, outputs, strict=False))
        self.triangles = outputs[len(program.started) :]
        for i in range(2 * program.dimension):
            if i not in self.values:
                self.values[i] = self.e.get("%y", i)

    def early(self) -> list[int]:
        """Return what the angles are computed from, but for those that come from other angles."""
        program = self.packing.program.start
        count = len(program.instructions)
        late, needed = bytearray(count), bytearray(count)
        for i, (op, args, *_) in enumerate(program.instructions):
            late[i] = op in ANGLES or any(late[arg] for arg in args)
        for ref in angles(self.packing.program.start):
            needed[ref] = not late[ref]
        for i in range(count - 1, program.hoisted - 1, -1):
            for arg in program.instructions[i].args if needed[i] else ():
                needed[arg] = True
        return [i for i in range(program.hoisted, count) if needed[i]]

    def find_angles(self, wanted: Sequence[int]) -> None:
        """Emit the sines and cosines of several angles at once, in vectors."""
        e, shuffle = self.e, Shuffle(self.e)
        called = shares_wide_angles(self.packing.program.start)
        moving = [ref for ref in wanted if ref >= self.packing.program.start.hoisted]
        while len(moving) > 1:
            width = min(ANGLES_AT_ONCE, 1 << (len(moving) - 1).bit_length())
            taken, moving = moving[:width], moving[width:]
            padded = taken + [taken[-1]] * (width - len(taken))
            vector = shuffle.gather([(self.body.ref(ref), 1, 0) for ref in padded])
            make = call_sine_and_cosine if called and width == ANGLES_AT_ONCE else sine_and_cosine
            for op, found in zip(ANGLES, make(e, str(vector), width), strict=True):
                for lane, ref in enumerate(taken):
                    place = self.body.by_code.get(Instruction(op, (ref,)))
                    if place is not None:
                        self.body.give(place, e.value(f"extractelement {element(width)} {found}, i64 {lane}"))

    def vector(self, operand: Operand) -> VectorName:
        """Return an operand at order 0."""
        lanes: list[VectorName] = [None if value == ZERO_LANE else self.values[value] for value in operand.values]
        return Shuffle(self.e).gather([(lane, 1, 0) for lane in lanes])


def lower_triangles(
    plan: SolvePlan, entries: Iterator[str]
) -> list[tuple[tuple[int, ...], dict[tuple[int, int], str]]]:
    """Return each block of unknowns with the entries of its lower triangle, taken from those of all stages."""
    place = {unknown: (number, i) for number, block in enumerate(plan.blocks) for i, unknown in enumerate(block)}
    found: list[dict[tuple[int, int], str]] = [{} for _ in plan.blocks]
    for row, column in plan.triangle:
        number, i = place[row]
        found[number][i, place[column][1]] = next(entries)
    return list(zip(plan.blocks, found, strict=True))


def right_sides(jet: Orders, stage: PackedStage) -> list[VectorName]:
    """Return what a stage solves for, f[k-1] scale / k - p^[k] for each chunk of unknowns."""
    found = []
    for chunk, force, momentum in zip(stage.unknowns, stage.right, stage.left, strict=True):
        lanes = len(chunk.values)
        rate = None if force is None else jet.share(jet.before(force), lanes)
        found.append(jet.do.less(rate, None if momentum is None else jet.now(momentum), lanes))
    return found


def constant_vector(e: Emitter, table: VectorConstants, lanes: tuple[int, ...]) -> str:
    """Return a vector of constants, as a literal where all are known."""
    known = [table.known[place] for place in lanes]
    if all(value is not None for value in known):
        return vector_literal([value for value in known if value is not None])
    return e.load(e.address("%c", table.place(lanes)), element(len(lanes)))


def known_numbers(table: VectorConstants, chunk: Chunk, which: int) -> list[float] | None:
    """Return a coefficient of each lane where all are known now, else None."""
    known = [table.known[place] for place in chunk.coefficients[which]]
    return None if any(value is None for value in known) else [value for value in known if value is not None]


def vector_parts(count: int) -> list[tuple[int, int]]:
    """Return (first lane, width) of the powers of two that a number of lanes falls into."""
    found, place = [], 0
    for width in (8, 4, 2, 1):
        while count - place >= width:
            found.append((place, width))
            place += width
    return found


def store_exactly(e: Emitter, vector: VectorName, width: int, count: int, target: str) -> None:
    """Store the first lanes of a vector and nothing else."""
    if vector is None:
        vector = number(0.0, width)
    for place, size in vector_parts(count):
        part = vector
        if size != width:
            mask = ", ".join(f"i32 {place + i}" for i in range(size))
            kind = element(width)
            part = (
                e.value(f"extractelement {kind} {vector}, i64 {place}")
                if size == 1
                else e.value(f"shufflevector {kind} {vector}, {kind} poison, <{size} x i32> <{mask}>")
            )
        e.store(part, e.address(target, place), element(size))


def load_exactly(shuffle: Shuffle, source: str, lanes: int, count: int) -> str:
    """Return a vector of which only the first entries are read from memory; the others repeat the last."""
    e = shuffle.e
    if count == lanes:
        return e.load(source, element(lanes))
    found: list[tuple[VectorName, int, int]] = []
    for place, width in vector_parts(count):
        part = e.load(e.address(source, place), element(width))
        found += [(part, width, lane) for lane in range(width)]
    vector = shuffle.gather(found + [found[-1]] * (lanes - count))
    return vector or number(0.0, lanes)
