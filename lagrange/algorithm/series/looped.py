"""The series of a system in a loop over orders, with like values adjacent in memory.

Each order has two phases. First come the sums over lower orders, some vectors at a time, in a loop that only multiplies
and adds. Then come the values that depend on one another, a chunk of like values at a time. Values of the present order
and of order 0 are in local arrays of the procedure. Values that later orders read are in a row of the work array.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from lagrange.algorithm.blocks import whole_blocks
from lagrange.algorithm.series.jets import LoopJet
from lagrange.algorithm.series.numbers import SeriesNumbers
from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.algorithm.series.rules import ChunkAt, Term, coefficient, less
from lagrange.algorithm.series.systems import Diagonal, InverseInMemory, system_size
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.values import Memory, Real, Whole

Piece = tuple[Chunk, int, int, int]
"""A part of the sums of a chunk: the chunk, the index of the pair of factors, the first lane, and the number of lanes.
"""

SHORTEST_RUN = 4
"""Least length of a run of adjacent values that is copied in a loop, which compilers vectorize."""

TILE = 48
"""Largest number of sums in one loop, so that their totals stay in registers."""


ALIGNED = 8
"""Alignment of vectors in the work array, in doubles, for the fastest reads."""


NOWHERE = -1
"""Index of a value whose index is not chosen yet."""


class Image:
    """Memory layout of the series values of one order: the state, those that later orders read, all others.

    Later orders read only the first `width` numbers, which are stored as a row. Rows begin at index `first` of
    an aligned array. An operand is a vector of values that a rule reads. If its values are adjacent and in
    order, it is read where they are. Otherwise it is in `gathered`: its values are copied one by one.
    """

    def __init__(self, packing: Packing, first: int) -> None:
        self.packing, self.first = packing, first
        states = range(packing.program.states)
        self.homes: dict[int, int] = {i: i for i in states}
        """Index in memory of each value."""
        self.repeated: dict[int, int] = {i: i for i in states}
        """The value at each index of a home."""
        self.places: dict[Operand, int] = {}
        self.gathered: dict[Operand, None] = {}
        self.end = len(states)
        self.place_homes(dict.fromkeys((*packing.summed, *packing.delayed)))
        kept = dict.fromkeys((*packing.summed, *packing.delayed, *packing.rates))
        for operand in kept:
            self.place(operand)
        self.width = whole_blocks(self.end, ALIGNED)
        self.end = self.width
        self.place_homes(None)
        for operand in dict.fromkeys((*kept, *read(packing))):
            self.place(operand)
        self.size = whole_blocks(self.end, ALIGNED)

    def place_homes(self, operands: dict[Operand, None] | None) -> None:
        """Choose memory indices for the values of those chunks that have none yet.

        A chunk is a vector of values that one rule computes. Only chunks that are in `operands` get indices;
        all get them if `operands` is None.
        """
        unknowns = [chunk for chunk in self.packing.unknowns if chunk.values[0] not in self.homes]
        for chunk in (*self.packing.computed, *unknowns):
            if chunk.values[0] not in self.homes and (operands is None or chunk.whole in operands):
                begin = self.room(len(chunk.values))
                for lane, value in enumerate(chunk.values):
                    self.homes.setdefault(value, begin + lane)
                    self.repeated[begin + lane] = value
                self.places[chunk.whole] = begin

    def room(self, lanes: int) -> int:
        """Reserve the indices of a vector of `lanes` values, and return the first one."""
        begin = whole_blocks(self.end + self.first, min(lanes, ALIGNED)) - self.first
        self.end = begin + lanes
        return begin

    def place(self, operand: Operand) -> None:
        """Choose the memory index of an operand, a vector of values that a rule reads.

        It is that of its first value if the values are adjacent and in order already, else a new index.
        """
        if operand in self.places:
            return
        begin = self.homes.get(operand.values[0], NOWHERE)
        if not operand.ranked and next(self.runs(operand)) == (0, begin, len(operand.values)) and begin != NOWHERE:
            self.places[operand] = begin
        else:
            self.places[operand] = self.room(len(operand.values))
            self.gathered[operand] = None

    def runs(self, operand: Operand) -> Iterator[tuple[int, int, int]]:
        """Yield the parts of an operand that are adjacent in memory, as (first lane, memory index, length).

        A lane that is zero is a part of its own, with the index `NOWHERE`.
        """
        values, lane = operand.values, 0
        while lane < len(values):
            begin, count = self.homes.get(values[lane], NOWHERE), 1
            while begin != NOWHERE and values[lane : lane + count + 1][count:] == (self.repeated.get(begin + count),):
                count += 1
            yield lane, begin, count
            lane += count

    def filled(self) -> dict[int, int]:
        """Return {index in memory: index of a series value} for all memory that holds coefficients of order 0.

        These are the row of all values, and copies of operands that rules of higher orders read at order 0.
        """
        values_at = {index: value for index, value in self.repeated.items() if index < self.width}
        initial = dict.fromkeys(self.packing.initial)
        for operand, begin in self.places.items():
            if not operand.ranked and (begin < self.width or operand in initial):
                entries = enumerate(operand.values, begin)
                values_at |= {index: value for index, value in entries if value != ZERO_LANE}
        return values_at


def read(packing: Packing) -> Iterator[Operand]:
    """Return the operands that rules and linear systems of a series read at their own order, or at order 0."""
    for chunk in packing.computed:
        yield from arguments(chunk)
        if chunk.sums:
            yield chunk.whole
    for stage in packing.stages:
        yield from (operand for operand in stage.left if operand is not None)


def arguments(chunk: Chunk) -> tuple[Operand, ...]:
    """Return the arguments that the rule of a chunk reads at its own order, or at order 0."""
    return () if chunk.op == "integral" else chunk.args


class LoopedJet(LoopJet):
    """Builder of the procedure that computes a series in a loop over orders."""

    def __init__(self, packing: Packing, numbers: SeriesNumbers) -> None:
        program = packing.program
        self.image = Image(packing, 10 * program.dimension)
        scratch = whole_blocks(sum(system_size(stage.plan) for stage in program.stages), ALIGNED)
        layout = TaylorLayout.of(program, self.image.width, scratch=scratch, by_rows=True)
        super().__init__(packing, numbers, replace(layout, watched=0))
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
            for stage_number, (stage, guess) in enumerate(zip(packing.stages, guesses, strict=True)):
                self.know(stage_number, stage, guess)
                self.fill(stage.trial)
                solution = self.solved_in_memory(stage_number, stage, guess)
                self.know(stage_number, stage, solution)
                if guess is not None:
                    weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
                    with p.each(stage.plan.size, width=1) as i:
                        guess[i] = solution[i] * weight
                self.fill(stage.found)
            self.write()
        p.leave(self.singular)
        return p.finish(FLAG)

    def clear(self, memory: Memory | None, count: int) -> None:
        """Add a loop that writes `count` zeros to memory; nothing if `memory` is None."""
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
            for number in range(len(chunk.sums)):
                self.sums[chunk, number] = end
                end += len(chunk.values)
        constants: dict[tuple[int, ...], None] = {}
        for chunk in chunks:
            if not self.is_scattered(chunk):
                constants |= {c: None for c in chunk.coefficients if self.common(c) is None}
        self.arrays = {"now": p.reserve(self.image.size, name="now"), "first": p.reserve(self.image.size, name="first")}
        self.arrays["totals"] = p.reserve(max(end, 1), name="totals")
        size = sum(map(len, constants))
        self.arrays["constants"] = p.reserve(max(size, 1), name="factors")
        index = 0
        for vector in constants:
            self.vectors[vector] = index
            for c in vector:
                self.arrays["constants"][index] = self.constants[c]
                index += 1
        first, zero = self.arrays["first"], p.real(0.0)
        self.clear(first, self.image.width)
        for at, value in self.image.filled().items():
            if value in self.origin or at >= self.image.width:
                first[at] = self.origin.get(value, zero)
        self.find_divisors(chunks)
        if program.stages:
            self.prepare_systems()

    def find_divisors(self, chunks: Iterable[Chunk]) -> None:
        """Add loops that write the reciprocals of all divisors of `chunks` to the array "reciprocals".

        A divisor in the rule of a chunk is a vector of series values, read at order 0. The index of its first
        reciprocal is stored in `divisors`.
        """
        divisors = [operand for operand in dict.fromkeys(chunk.divisor for chunk in chunks) if operand is not None]
        self.arrays["reciprocals"] = self.p.reserve(max(sum(len(o.values) for o in divisors), 1), name="reciprocals")
        index = 0
        for operand in divisors:
            self.divisors[operand] = index
            target, source = self.part_of("reciprocals", index), self.part_of("first", self.image.places[operand])
            with self.p.each(len(operand.values), width=1) as i:
                target[i] = 1.0 / source[i]
            index += len(operand.values)

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

    def part_of(self, array: str, index: int) -> Memory:
        """Return the part from `index` on of the local array with the name `array`.

        For "now", values that later orders read are in the row of the present order instead.
        """
        return self.arrays["row" if array == "now" and index < self.image.width else array].at(index)

    def array_of(self, index: int) -> Memory:
        """Return the array that has the value with this memory index at the present order: the row, or "now".

        Values that later orders read are in the row of the order, all others in the local array "now".
        """
        return self.arrays["row" if index < self.image.width else "now"]

    # --- orders

    def set_order(self, k: Whole) -> None:
        """Set k as the present order: compute 1 / k, and find the rows of this and the previous order."""
        width = self.layout.width
        self.arrays["row"], self.arrays["previous"] = self.rows.at(k * width), self.rows.at((k - 1) * width)
        super().set_order(k)
        self.current = {}

    def sum_up(self) -> None:
        """Compute all sums of products of lower orders that the rules of the present order read."""
        tile: list[Piece] = []
        for piece in self.pieces():
            if sum(size for *_, size in (*tile, piece)) > TILE:
                self.sum_tile(tile)
                tile = []
            tile.append(piece)
        self.sum_tile(tile)

    def pieces(self) -> Iterator[Piece]:
        """Yield all sums over lower orders, in pieces of at most `TILE` adjacent sums.

        A piece is a tuple: its chunk, the number of the sum in the chunk's rule, the first lane, and the number
        of lanes.
        """
        for chunk, number in self.sums:
            size = len(chunk.values)
            for begin in range(0, size, TILE):
                yield chunk, number, begin, min(TILE, size - begin)

    def sum_tile(self, pieces: Sequence[Piece]) -> None:
        """Compute the sums of `pieces` in one loop over the lower orders."""
        width = self.layout.width
        for chunk, number, begin, size in pieces:
            self.clear(self.part_of("totals", self.sums[chunk, number] + begin), size)
        if pieces:
            with self.p.loop(1, self.k) as j:
                lower, upper = self.rows.at(j * width), self.rows.at((self.k - j) * width)
                for piece in pieces:
                    self.add_product(piece, lower, upper)

    def add_product(self, piece: Piece, lower: Memory, upper: Memory) -> None:
        """Add the product x[j] y[k-j] to each sum of a piece, for one j.

        `lower` is the row of coefficients of order j, and `upper` that of order k - j.
        """
        chunk, number, begin, size = piece
        a, b = (self.image.places[operand] + begin for operand in chunk.sums[number])
        total, left, right = self.part_of("totals", self.sums[chunk, number] + begin), lower.at(a), upper.at(b)
        with self.p.each(size, width=1) as i:
            total[i] = self.p.fma(left[i], right[i], total[i])

    def find_coordinates(self) -> None:
        """Compute the coefficients of the coordinates from those of dq/dt at the previous order."""
        for chunk, rate in zip(self.packing.coordinates, self.packing.rates, strict=True):
            target = self.part_of("now", chunk.values[0])
            source = self.part_of("previous", self.image.places[rate])
            with self.p.each(chunk.count, width=1) as i:
                target[i] = self.share(source[i])

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
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
        """Return True if a chunk is a linear combination of values that are not adjacent in memory.

        If a later order reads the terms as a vector, they are gathered anyway, and the result is False.
        """
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
        """Copy the values of an operand at the present order to adjacent memory, if not done yet."""
        image = self.image
        if operand not in image.gathered or operand in self.current:
            return
        self.current[operand] = None
        index = image.places[operand]
        if operand.ranked:
            plain = Operand(operand.values)
            self.gather(plain)
            source, target = self.part_of("now", image.places[plain]), self.part_of("now", index)
            with self.p.each(len(operand.values), width=1) as i:
                target[i] = source[i] * self.rank
            return
        for lane, home, count in image.runs(operand):
            self.copy_run(home, index + lane, count)

    def copy_run(self, home: int, index: int, count: int) -> None:
        """Copy `count` adjacent values of the present order from memory index `home` to `index`.

        If `home` is `NOWHERE`, write a zero to `index`.
        """
        if home == NOWHERE:
            self.array_of(index)[index] = 0.0
        elif count < SHORTEST_RUN:
            for k in range(count):
                self.array_of(index + k)[index + k] = self.array_of(home + k)[home + k]
        else:
            self.p.copy(self.part_of("now", home), self.part_of("now", index), count, width=1, spill=False)

    def know(self, stage_number: int, stage: PackedStage, solution: Memory | None) -> None:
        """Set the present coefficients of the unknowns of a linear system to those in the memory `solution`.

        If `solution` is None they are left as they are. `stage` is the system, and `stage_number` its number.
        Operands that were gathered with earlier values are dropped.
        """
        begin = 0
        self.current = {operand: None for operand in self.current if self.is_known(operand, stage_number)}
        if solution is None:
            return
        for chunk in stage.unknowns:
            target, source = self.part_of("now", self.image.homes[chunk.values[0]]), solution.at(begin)
            with self.p.each(chunk.count, width=1) as i:
                target[i] = source[i]
            begin += chunk.count

    def solved_in_memory(self, stage_number: int, stage: PackedStage, guess: Memory | None) -> Memory:
        """Add code that solves a linear system at the present order, and return memory with its unknowns.

        These are the solution, plus the unknowns in `guess` if it is not None: those that the first iteration
        for order 1 found. `stage` is the system, and `stage_number` its number.
        """
        p, (right, solution, inverse) = self.p, self.solutions[stage_number]
        begin = 0
        for chunk, force, momentum in zip(stage.unknowns, stage.right, stage.left, strict=True):
            self.right_side(chunk, force, momentum, right.at(begin))
            begin += chunk.count
        system, n = self.systems[stage_number], stage.plan.size
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
        """Write the right-hand side of a linear system for one chunk of unknowns: f[k-1] * scale / k - p^[k].

        `force` is the operand f, and `momentum` the operand p^, the momentum with trial values of the unknowns.
        None means zero. `right` is the memory to write to.
        """
        places = self.image.places
        if momentum is not None:
            self.gather(momentum)
        before = None if force is None else self.part_of("previous", places[force])
        known = None if momentum is None else self.part_of("now", places[momentum])
        with self.p.each(chunk.count, width=1) as i:
            rate = None if before is None else self.share(before[i])
            total = less(rate, None if known is None else known[i])
            right[i] = 0.0 if total is None else total

    def write_first(self) -> None:
        """Write the values of order 0 that later orders read to the first row."""
        rows, first = self.rows, self.arrays["first"]
        with self.p.each(self.layout.width, width=1) as i:
            rows[i] = first[i]

    def write(self) -> None:
        """Complete the row of the present order: add copies of operands whose values are not adjacent."""
        for operand in self.image.places:
            if self.image.places[operand] < self.image.width:
                self.gather(operand)


class ChunkLane(ChunkAt):
    """Reads the inputs of a chunk's rule for the value in one lane, number i, from memory."""

    series: LoopedJet

    def __init__(self, series: LoopedJet, chunk: Chunk, i: Whole) -> None:
        super().__init__(series, chunk)
        self.i = i

    def read(self, array: str, index: int) -> Real:
        """Return this lane's entry of a vector that begins at `index` of the local array named `array`."""
        number: Real = self.series.part_of(array, index)[self.i]
        return number

    def now(self, number: int) -> Term:
        """Return argument `number` of the rule at the present order, for the value in this lane."""
        return self.read("now", self.series.image.places[self.operand(number)])

    def before(self, number: int) -> Term:
        """Return argument `number` of the rule at the previous order, for the value in this lane."""
        return self.read("previous", self.series.image.places[self.operand(number)])

    def first(self, number: int) -> Real:
        """Return argument `number` of the rule at order 0 in this lane; OWN is the value that it computes."""
        return self.read("first", self.series.image.places[self.operand(number)])

    def total(self, number: int) -> Term:
        """Return sum `number` of the rule, of x[j] y[k-j] over 0 < j < k, for the value in this lane."""
        return self.read("totals", self.series.sums[self.chunk, number])

    def over(self, number: int) -> Real:
        """Return 1 / argument `number` at order 0, or 1 / the computed value itself for OWN, in this lane."""
        return self.read("reciprocals", self.series.divisors[self.operand(number)])

    def constant(self, number: int) -> Real:
        """Return constant factor number `number` of the rule, for the value in this lane."""
        known = self.known(number)
        if known is not None:
            return self.p.real(known)
        return self.read("constants", self.series.vectors[self.chunk.coefficients[number]])


class ScatteredLane(ChunkLane):
    """Inputs of one lane of a linear combination whose terms are not adjacent in memory."""

    def __init__(self, series: LoopedJet, chunk: Chunk, lane: int) -> None:
        super().__init__(series, chunk, series.k)
        self.lane = lane

    def now(self, number: int) -> Term:
        """Return argument `number` of the rule at the present order, for the value in this lane."""
        home = self.series.image.homes[self.chunk.args[number].values[self.lane]]
        return self.series.array_of(home)[home]

    def known(self, number: int) -> float | None:
        """Return coefficient `number` of the rule if it is known at compile time, else None."""
        return self.series.common((self.chunk.coefficients[number][self.lane],))

    def constant(self, number: int) -> Real:
        """Return constant factor number `number` of the rule, for the value in this lane."""
        return self.series.constants[self.chunk.coefficients[number][self.lane]]
