"""The series of a system in a loop over orders, with like values adjacent in memory.

Each order has two phases. First come the sums over lower orders, some vectors at a time, in a loop that only multiplies
and adds. Then come the values that depend on one another, a chunk of like values at a time. Values of the present order
and of order 0 are in local arrays of the procedure. Values that later orders read are in a row of the work array.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.series.image import ALIGNED, NOWHERE, ChunkLane, Image, ScatteredLane, arguments
from lagrange.algorithm.series.jet import LoopJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.algorithm.series.rules import Term, coefficient, less
from lagrange.algorithm.series.systems import Diagonal, InverseInMemory, system_size
from lagrange.algorithm.series.value import divisor
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.values import Memory, Whole

Piece = tuple[Chunk, int, int, int]
"""A part of the sums of a chunk: the chunk, the index of the pair of factors, the first lane, and the number of lanes.
"""

SHORTEST_RUN = 4
"""Least length of a run of adjacent values that is copied in a loop, which compilers vectorize."""

TILE = 48
"""Largest number of sums in one loop, so that their totals stay in registers."""


def looped_layout(packing: Packing) -> tuple[TaylorLayout, Image]:
    """Return the layout of a series without watched values, and the layout of the values at one order."""
    program = packing.program
    image = Image(packing, 10 * program.dimension)
    scratch = whole_blocks(sum(system_size(stage.plan) for stage in program.stages), ALIGNED)
    return replace(TaylorLayout.of(program, image.width, scratch=scratch, by_rows=True), watched=0), image


class LoopedJet(LoopJet):
    """Builder of the procedure that computes a series in a loop over orders."""

    def __init__(self, packing: Packing, numbers: SeriesNumbers) -> None:
        layout, self.image = looped_layout(packing)
        super().__init__(packing, numbers, layout)
        self.parts: dict[tuple[str, int], Memory] = {}
        self.arrays: dict[str, Memory] = {}
        self.vectors: dict[tuple[int, ...], int] = {}
        """Index of a chunk's coefficients among the stored constants, by their indices in the table."""
        self.sums: dict[tuple[Chunk, int], int] = {}
        """Index of each sum among the totals, by chunk and pair of factors."""
        self.divisors: dict[Operand, int] = {}
        """Index of the reciprocal of each divisor among the reciprocals at order 0."""
        self.current: dict[Operand, None] = {}
        """Operands that have been gathered to vectors at the present order."""
        self.solutions: list[tuple[Memory, Memory, Memory | None]] = []

    def build(self) -> Procedure:
        """Return the procedure that computes the series."""
        p, packing = self.p, self.packing
        self.begin()
        self.lay_out()
        self.write_first()
        guesses = [p.reserve(stage.plan.size, name="guess") if stage.plan.moving else None for stage in packing.stages]
        for stage, guess in zip(packing.stages, guesses, strict=True):
            self.clear(guess, stage.plan.size)
        with self.each_order() as iteration:
            self.sum_up()
            self.find_coordinates()
            self.fill(packing.before)
            for place, (stage, guess) in enumerate(zip(packing.stages, guesses, strict=True)):
                self.know(place, stage, guess)
                self.fill(stage.trial)
                solution = self.solved_in_memory(place, stage, guess)
                self.know(place, stage, solution)
                if guess is not None:
                    weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
                    with p.each(stage.plan.size, width=1) as i:
                        guess[i] = solution[i] * weight
                self.fill(stage.found)
            self.write()
        p.leave(self.singular)
        return p.finish(FLAG)

    def clear(self, memory: Memory | None, count: int) -> None:
        """Write `count` zeros to memory."""
        if memory is not None:
            with self.p.each(count, width=1) as i:
                memory[i] = 0.0

    # --- memory

    def lay_out(self) -> None:
        """Reserve local arrays. Write the constants, the values of order 0 and the reciprocals of divisors."""
        p, program = self.p, self.program
        chunks = self.packing.computed
        end = 0
        for chunk in chunks:
            for which in range(len(chunk.sums)):
                self.sums[chunk, which] = end
                end += len(chunk.values)
        constants: dict[tuple[int, ...], None] = {}
        for chunk in chunks:
            if not self.is_scattered(chunk):
                constants |= {c: None for c in chunk.coefficients if self.common(c) is None}
        self.arrays = {"now": p.reserve(self.image.size, name="now"), "first": p.reserve(self.image.size, name="first")}
        self.arrays["totals"] = p.reserve(max(end, 1), name="totals")
        size = sum(map(len, constants))
        self.arrays["constants"] = p.reserve(max(size, 1), name="factors")
        place = 0
        for vector in constants:
            self.vectors[vector] = place
            for c in vector:
                self.arrays["constants"][place] = self.constants[c]
                place += 1
        first, zero = self.arrays["first"], p.real(0.0)
        self.clear(first, self.image.width)
        for at, value in self.image.filled().items():
            if value in self.origin or at >= self.image.width:
                first[at] = self.origin.get(value, zero)
        self.find_divisors(chunks)
        if program.stages:
            self.prepare_systems()

    def find_divisors(self, chunks: Iterable[Chunk]) -> None:
        """Write the reciprocals of the values at order 0 by which chunks are divided."""
        wanted = dict.fromkeys(operand for chunk in chunks if (operand := divisor(chunk)) is not None)
        self.arrays["reciprocals"] = self.p.reserve(max(sum(len(o.values) for o in wanted), 1), name="reciprocals")
        place = 0
        for operand in wanted:
            self.divisors[operand] = place
            target, source = self.part_of("reciprocals", place), self.part_of("first", self.image.places[operand])
            with self.p.each(len(operand.values), width=1) as i:
                target[i] = 1.0 / source[i]
            place += len(operand.values)

    def prepare_systems(self) -> None:
        """Reserve a right-hand side and a solution for each stage. Write the inverses of diagonal matrices."""
        p = self.p
        for system, stage in zip(self.systems, self.program.stages, strict=True):
            n = stage.plan.size
            inverse = None
            if isinstance(system, Diagonal):
                inverse = p.reserve(n, name="inverse")
                for i, x in system.reciprocals.items():
                    inverse[i] = x
            self.solutions.append((p.reserve(n, name="right"), p.reserve(n, name="solution"), inverse))

    def part_of(self, array: str, place: int) -> Memory:
        """Return the part of a named array from index `place` on.

        Values of the present order that later orders read are in the row, not in the array "now".
        """
        return self.arrays["row" if array == "now" and place < self.image.width else array].at(place)

    def array_of(self, place: int) -> Memory:
        """Return the array that contains the present order's value with index `place`."""
        return self.arrays["row" if place < self.image.width else "now"]

    def common(self, places: Sequence[int]) -> float | None:
        """Return the number that all constants with the indices `places` equal, if known at compile time; else None."""
        known = dict.fromkeys(self.program.numbers[place] for place in places)
        return next(iter(known)) if len(known) == 1 else None

    # --- orders

    def set_order(self, k: Whole) -> None:
        """Compute the numbers that depend on the order k alone."""
        width = self.layout.width
        self.arrays["row"], self.arrays["previous"] = self.rows.at(k * width), self.rows.at((k - 1) * width)
        super().set_order(k)
        self.current = {}

    def sum_up(self) -> None:
        """Compute the sums over lower orders."""
        tile: list[Piece] = []
        for piece in self.pieces():
            if sum(size for *_, size in (*tile, piece)) > TILE:
                self.sum_tile(tile)
                tile = []
            tile.append(piece)
        self.sum_tile(tile)

    def pieces(self) -> Iterator[Piece]:
        """Yield the sums in pieces of at most `TILE` sums."""
        for chunk, which in self.sums:
            size = len(chunk.values)
            for begin in range(0, size, TILE):
                yield chunk, which, begin, min(TILE, size - begin)

    def sum_tile(self, pieces: Sequence[Piece]) -> None:
        """Compute the sums of `pieces` in one loop over the lower orders."""
        width = self.layout.width
        for chunk, which, begin, size in pieces:
            self.clear(self.part_of("totals", self.sums[chunk, which] + begin), size)
        if pieces:
            with self.p.loop(1, self.k) as j:
                lower, upper = self.rows.at(j * width), self.rows.at((self.k - j) * width)
                for piece in pieces:
                    self.add_product(piece, lower, upper)

    def add_product(self, piece: Piece, lower: Memory, upper: Memory) -> None:
        """Add to each sum of a piece the product of the factors in the rows `lower` (first) and `upper` (second)."""
        chunk, which, begin, size = piece
        a, b = (self.image.places[operand] + begin for operand in chunk.sums[which])
        total, left, right = self.part_of("totals", self.sums[chunk, which] + begin), lower.at(a), upper.at(b)
        with self.p.each(size, width=1) as i:
            total[i] = self.p.fma(left[i], right[i], total[i])

    def find_coordinates(self) -> None:
        """Compute the coordinates from their rates of change."""
        for chunk, rate in zip(self.packing.coordinates, self.packing.rates, strict=True):
            target = self.part_of("now", chunk.values[0])
            source = self.part_of("previous", self.image.places[rate])
            with self.p.each(chunk.count, width=1) as i:
                target[i] = self.share(source[i])

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the coefficients of chunks at the present order."""
        for chunk in chunks:
            if chunk.op == "constant":
                self.clear(self.part_of("now", self.image.places[chunk.whole]), len(chunk.values))
                continue
            if self.is_scattered(chunk):
                self.combine(chunk)
                continue
            for operand in arguments(chunk) if chunk.op != "along" else chunk.args[:1]:
                self.gather(operand)
            target = self.part_of("now", self.image.places[chunk.whole])
            with self.p.each(len(chunk.values), width=1) as i:
                target[i] = coefficient(ChunkLane(self, chunk, i))
            self.current[chunk.whole] = None

    def is_scattered(self, chunk: Chunk) -> bool:
        """Return True if a chunk adds values that are not adjacent, and no later order reads it as a vector."""
        places = self.image.places
        apart = [operand for operand in chunk.args if operand in self.image.gathered]
        return chunk.op == "linear" and any(places[operand] >= self.image.width for operand in apart)

    def combine(self, chunk: Chunk) -> None:
        """Compute a chunk of linear combinations value by value: gathering their terms to vectors costs more."""
        begin = self.image.places[chunk.whole]
        target = self.array_of(begin)
        known: dict[int, Term] = {}
        for lane, value in enumerate(chunk.values):
            if value not in known:
                known[value] = coefficient(ScatteredLane(self, chunk, lane))
            target[begin + lane] = known[value]

    def gather(self, operand: Operand) -> None:
        """Gather the values of an operand to a vector, unless it was done at this order."""
        image = self.image
        if operand not in image.gathered or operand in self.current:
            return
        self.current[operand] = None
        place = image.places[operand]
        if operand.ranked:
            plain = Operand(operand.values)
            self.gather(plain)
            source, target = self.part_of("now", image.places[plain]), self.part_of("now", place)
            with self.p.each(len(operand.values), width=1) as i:
                target[i] = source[i] * self.rank
            return
        for lane, home, count in image.runs(operand):
            self.copy_run(home, place + lane, count)

    def copy_run(self, home: int, place: int, count: int) -> None:
        """Copy `count` adjacent values from index `home` to index `place`; for `NOWHERE` as home write a zero."""
        if home == NOWHERE:
            self.array_of(place)[place] = 0.0
        elif count < SHORTEST_RUN:
            for k in range(count):
                self.array_of(place + k)[place + k] = self.array_of(home + k)[home + k]
        else:
            self.p.copy(self.part_of("now", home), self.part_of("now", place), count, width=1, spill=False)

    def know(self, place: int, stage: PackedStage, found: Memory | None) -> None:
        """Set the unknowns of stage `place` to `found`. Drop operands that were gathered with their earlier values."""
        depth, begin = self.program.depth, 0
        self.current = {
            operand: None
            for operand in self.current
            if all(value == ZERO_LANE or depth[value] <= place for value in operand.values)
        }
        if found is None:
            return
        for chunk in stage.unknowns:
            target, source = self.part_of("now", self.image.homes[chunk.values[0]]), found.at(begin)
            with self.p.each(chunk.count, width=1) as i:
                target[i] = source[i]
            begin += chunk.count

    def solved_in_memory(self, place: int, stage: PackedStage, guess: Memory | None) -> Memory:
        """Return memory with the unknowns of stage number `place`: the solution of its system, plus `guess` if any."""
        p, (right, solution, inverse) = self.p, self.solutions[place]
        begin = 0
        for chunk, force, momentum in zip(stage.unknowns, stage.right, stage.left, strict=True):
            self.right_side(chunk, force, momentum, right.at(begin))
            begin += chunk.count
        system, n = self.systems[place], stage.plan.size
        if inverse is not None:
            with p.each(n, width=1) as i:
                solution[i] = right[i] * inverse[i]
        elif isinstance(system, InverseInMemory):
            system.multiply(right, solution)
        else:
            for place_of, x in enumerate(system.solve([(k,) for k in range(n)], [right[k] for k in range(n)])):
                solution[place_of] = p.real(0.0) if x is None else x
        if guess is not None:
            with p.each(n, width=1) as i:
                solution[i] = solution[i] + guess[i]
        return solution

    def right_side(self, chunk: Chunk, force: Operand | None, momentum: Operand | None, right: Memory) -> None:
        """Write the right-hand side of a stage for one chunk of unknowns, f[k-1] * scale / k - p^[k].

        `force` is the operand f, and `momentum` the operand p^, the momentum with trial values. None means zero.
        """
        places = self.image.places
        if momentum is not None:
            self.gather(momentum)
        before = None if force is None else self.part_of("previous", places[force])
        known = None if momentum is None else self.part_of("now", places[momentum])
        with self.p.each(chunk.count, width=1) as i:
            rate = None if before is None else self.share(before[i])
            found = less(rate, None if known is None else known[i])
            right[i] = 0.0 if found is None else found

    def write_first(self) -> None:
        """Write the values of order 0 to their rows."""
        rows, first = self.rows, self.arrays["first"]
        with self.p.each(self.layout.width, width=1) as i:
            rows[i] = first[i]

    def write(self) -> None:
        """Write the rest of the row of the present order."""
        for operand in self.image.places:
            if self.image.places[operand] < self.image.width:
                self.gather(operand)
