"""The series of a large system in loops: one body for all orders, vectors side by side in rows of memory.

    i32 jet(double t, double scale, ptr y, ptr p, ptr c, ptr rows, i64 order)

as in `taylor_unrolled`, but for any order. A row holds q, v and what is watched, and behind them every operand that a
later order reads. Each order has two phases: the sums over lower orders for all vectors at once, in a loop that loads
and multiplies and adds and nothing else; then the short chain of values that depend on one another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate

from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import element, number
from lagrange.machine.series.llvm_factored import FactoredStage
from lagrange.machine.series.llvm_jet import (
    SIGNATURE,
    OrderZero,
    Shuffle,
    VectorConstants,
    constant_vector,
    known_numbers,
    load_exactly,
    lower_triangles,
    right_sides,
    store_exactly,
)
from lagrange.machine.series.llvm_layout import Slots
from lagrange.machine.series.llvm_rules import VectorArithmetic, VectorName, coefficient, divided
from lagrange.procedure.linear.inverse import invert, padded, work_size
from lagrange.procedure.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.program.elimination import is_factored

TILE = 16
"""How many sums run in one loop: their totals stay in registers."""

WRITTEN_OUT = 32
"""Up to this dimension the product with the inverse of the mass matrix is written out."""


class LoopedJet:
    """Emits the function."""

    def __init__(self, packing: Packing, table: VectorConstants, layout: TaylorLayout, slots: Slots) -> None:
        self.packing, self.table, self.layout, self.slots = packing, table, layout, slots
        self.origin = OrderZero(packing, layout.padded)
        self.e: Emitter = self.origin.e
        self.do = VectorArithmetic(self.e)
        self.shuffle = Shuffle(self.e)
        self.x: dict[Chunk, VectorName] = {}
        self.gathered: dict[Operand, VectorName] = {}
        self.totals: dict[tuple[Chunk, int], VectorName] = {}
        self.splats: dict[tuple[str, int], str] = {}
        self.row = self.previous = self.k = self.rank = ""
        self.parts: tuple[str, ...] = ()
        self.shares: tuple[str, ...] = ()

    def function(self) -> str:
        """Return the IR."""
        e, packing = self.e, self.packing
        self.write_first()
        self.inverses = self.invert()
        self.reciprocals = {operand: self.one_over(operand) for operand in self.divisors()}
        refined = any(stage.plan.moving for stage in packing.stages)
        self.start_guess()
        # Order 1 is computed twice, the second time from the velocities found first: see `UnrolledJet.refined`.
        with e.loop(0 if refined else 1, e.value("add nsw i64 %order, 1")) as iteration:
            begun = e.value(f"icmp ne i64 {iteration}, 0")
            self.begin(e.value(f"select i1 {begun}, i64 {iteration}, i64 1"))
            self.sum_up()
            for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
                self.x[chunk] = self.share(self.before(rate), len(chunk.values))
            self.fill(packing.before)
            for place, stage in enumerate(packing.stages):
                guesses = self.guesses(stage)
                self.know(place, guesses)
                self.fill(stage.trial)
                found = [
                    self.do.add(value, guess, len(chunk.values))
                    for chunk, value, guess in zip(stage.unknowns, self.solved(place), guesses, strict=True)
                ]
                self.keep_guess(stage, found, begun)
                self.know(place, found)
                self.fill(stage.found)
            self.write()
        e.do(f"ret i32 {self.origin.body.status()}")
        return e.function(SIGNATURE)

    def know(self, place: int, found: Sequence[VectorName]) -> None:
        """Enter the unknowns of a stage, and drop what was gathered with others in their place."""
        depth = self.packing.program.depth
        self.gathered = {
            operand: vector
            for operand, vector in self.gathered.items()
            if all(value == ZERO_LANE or depth[value] <= place for value in operand.values)
        }
        self.x.update(zip(self.packing.stages[place].unknowns, found, strict=True))

    def start_guess(self) -> None:
        """Begin with unknowns of zero, where order 1 is computed twice."""
        for chunk in (chunk for stage in self.packing.stages if stage.plan.moving for chunk in stage.unknowns):
            self.e.store(number(0.0, len(chunk.values)), self.guess_at(chunk), element(len(chunk.values)))

    def guess_at(self, chunk: Chunk) -> str:
        """Return where the guess of some unknowns stands."""
        return self.origin.body.scratch(f"guess {chunk.values[0]}", element(len(chunk.values)), 1)

    def guesses(self, stage: PackedStage) -> list[VectorName]:
        """Return the unknowns from which those of this iteration are corrected: zero but in the second iteration."""
        if not stage.plan.moving:
            return [None] * len(stage.unknowns)
        return [self.e.load(self.guess_at(chunk), element(len(chunk.values))) for chunk in stage.unknowns]

    def keep_guess(self, stage: PackedStage, found: Sequence[VectorName], begun: str) -> None:
        """Keep the unknowns of the first iteration for the second, and none after it."""
        for chunk, value in zip(stage.unknowns, found, strict=True) if stage.plan.moving else ():
            lanes = len(chunk.values)
            kind, zero = element(lanes), number(0.0, lanes)
            kept = self.e.value(f"select i1 {begun}, {kind} {zero}, {kind} {value or zero}")
            self.e.store(kept, self.guess_at(chunk), kind)

    def write_first(self) -> None:
        """Store order 0: the state, what is watched, and every operand lane by lane."""
        e, layout = self.e, self.layout
        for i in range(layout.dimension):
            e.put(self.origin.values[i], "%rows", i)
        for i, watched in enumerate(self.packing.program.watched):
            value = None if watched is None else self.origin.values[watched]
            e.put(value or literal(0.0), "%rows", layout.watched_at + i)
        for operand, place in self.slots.places.items():
            for lane, slot in enumerate(operand.values):
                known = None if operand.ranked else self.origin.values.get(slot)
                e.put(known or literal(0.0), "%rows", place + lane)

    def divisors(self) -> list[Operand]:
        """Return the operands that something is divided by."""
        found = []
        for chunk in self.packing.computed:
            if chunk.op in ("div", "against"):
                found.append(chunk.args[1])
            elif chunk.op in ("inverse", "power"):
                found.append(chunk.args[0])
            elif chunk.op == "sqrt":
                found.append(chunk.whole)
        return list(dict.fromkeys(found))

    def one_over(self, operand: Operand) -> str:
        """Return one over an operand at order 0."""
        lanes = len(operand.values)
        return self.e.value(f"fdiv {element(lanes)} {number(1.0, lanes)}, {self.first(operand)}")

    def begin(self, k: str) -> None:
        """Set up what depends on the order alone."""
        e, width = self.e, self.layout.width
        self.k = k
        self.row = e.address("%rows", e.value(f"mul nsw i64 {k}, {width}"))
        self.previous = e.address(self.row, -width)
        self.rank = e.value(f"sitofp i64 {k} to double")
        high = e.real("fdiv", literal(1.0), self.rank)
        # What 1 - k high leaves over is exact, and its share is the part of 1 / k that rounding lost.
        left = e.fma(e.value(f"fneg double {self.rank}"), high, literal(1.0))
        self.parts = (high, e.real("fmul", left, high))
        self.shares = tuple(e.real("fmul", "%scale", part) for part in self.parts)

    def sum_up(self) -> None:
        """Emit the sums over lower orders, some vectors at a time."""
        wanted = [(chunk, which) for chunk in self.packing.computed for which in range(len(chunk.sums))]
        for begin in range(0, len(wanted), TILE):
            self.sum_tile(wanted[begin : begin + TILE])

    def sum_tile(self, wanted: Sequence[tuple[Chunk, int]]) -> None:
        """Emit some sums in one loop."""
        e, width = self.e, self.layout.width
        kinds = [element(len(chunk.values)) for chunk, _ in wanted]
        zeros = [number(0.0, len(chunk.values)) for chunk, _ in wanted]
        with e.carry(1, self.k, list(zip(kinds, zeros, strict=True))) as loop:
            lower = e.address("%rows", e.value(f"mul nsw i64 {loop.index}, {width}"))
            upper = e.address(
                "%rows", e.value(f"mul nsw i64 {e.value(f'sub nsw i64 {self.k}, {loop.index}')}, {width}")
            )
            loaded: dict[tuple[str, Operand], str] = {}

            def read(row: str, operand: Operand) -> str:
                if (row, operand) not in loaded:
                    loaded[row, operand] = self.read(row, operand)
                return loaded[row, operand]

            loop.following = []
            for (chunk, which), kind, total in zip(wanted, kinds, loop.values, strict=True):
                a, b = chunk.sums[which]
                loop.following.append(e.fma(read(lower, a), read(upper, b), total, kind))
        self.totals.update(zip(wanted, loop.values, strict=True))

    def read(self, row: str, operand: Operand) -> str:
        """Return an operand from a row of memory."""
        return self.e.load(self.e.address(row, self.slots.places[operand]), element(len(operand.values)))

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Emit the coefficients of some chunks."""
        for chunk in chunks:
            self.x[chunk] = coefficient(self, chunk)

    def now(self, operand: Operand) -> VectorName:
        """Return an operand at the order at hand."""
        if operand not in self.gathered:
            vector = self.shuffle.operand(self.packing, operand, self.x.__getitem__)
            if operand.ranked:
                lanes = len(operand.values)
                vector = self.do.scale(vector, self.splat(self.rank, lanes), lanes)
            self.gathered[operand] = vector
        return self.gathered[operand]

    def before(self, operand: Operand) -> VectorName:
        """Return an operand at the order before."""
        return self.read(self.previous, operand)

    def first(self, operand: Operand) -> VectorName:
        """Return an operand at order 0."""
        return self.read("%rows", operand)

    def total(self, chunk: Chunk, which: int) -> VectorName:
        """Return a sum over 0 < j < k."""
        return self.totals[chunk, which]

    def over(self, operand: Operand) -> str:
        """Return one over an operand at order 0."""
        return self.reciprocals[operand]

    def numbers(self, chunk: Chunk, which: int) -> list[float] | None:
        """Return a coefficient of each lane where all are known now, else None."""
        return known_numbers(self.table, chunk, which)

    def constant(self, chunk: Chunk, which: int) -> str:
        """Return a coefficient as a vector."""
        return constant_vector(self.e, self.table, chunk.coefficients[which])

    def splat(self, value: str, lanes: int) -> str:
        """Return a number in every lane, made once."""
        key = (value, lanes)
        if key not in self.splats:
            self.splats[key] = self.e.splat(value, element(lanes))
        return self.splats[key]

    def share(self, x: VectorName, lanes: int) -> VectorName:
        """Return x scale / k."""
        high, low = (self.splat(share, lanes) for share in self.shares)
        return divided(self.do, x, high, low, lanes)

    def part(self, x: VectorName, lanes: int) -> VectorName:
        """Return x / k."""
        high, low = (self.splat(part, lanes) for part in self.parts)
        return divided(self.do, x, high, low, lanes)

    def start(self, lanes: int) -> VectorName:
        """Return the coefficient of time."""
        first = self.e.value(f"icmp eq i64 {self.k}, 1")
        return self.splat(self.e.choose(first, "%scale", literal(0.0)), lanes)

    def invert(self) -> list[str | FactoredStage]:
        """Find the inverse of the matrix of each stage, or its factors, and return the addresses.

        The inverse of a diagonal matrix is a vector.
        """
        found: list[str | FactoredStage] = []
        given, triangles = 0, iter(self.origin.triangles)
        behind = self.e.address("%rows", self.row_count()) if self.layout.scratch else ""
        for stage in self.packing.stages:
            plan = stage.plan
            if not plan.moving:
                found.append(self.e.address("%c", given) if given else "%c")
                given += plan.size if plan.diagonal else plan.size**2
            elif plan.diagonal:
                found.append(self.divisions(plan, triangles))
            elif is_factored(plan):
                entries = [lower for _, lower in lower_triangles(plan, triangles)]
                factors = FactoredStage(self.origin.body, plan, entries, behind)
                found.append(factors)
                behind = factors.end
            else:
                found.append(behind)
                behind = self.inverted(plan, triangles, behind)
        return found

    def row_count(self) -> str:
        """Return where the rows end."""
        return self.e.value(f"mul nsw i64 {self.e.value('add nsw i64 %order, 1')}, {self.layout.width}")

    def divisions(self, plan: SolvePlan, triangles: Iterator[str]) -> str:
        """Return the address of one over each entry of a diagonal matrix."""
        e, memory = self.e, self.e.reserve("double", padded(plan.size))
        for block, entry in lower_triangles(plan, triangles):
            value = e.real("fdiv", literal(1.0), entry[0, 0])
            self.origin.body.singular.append(e.real("fcmp oeq", entry[0, 0], literal(0.0)))
            e.put(value, memory, block[0])
        return memory

    def inverted(self, plan: SolvePlan, triangles: Iterator[str], inverse: str) -> str:
        """Write the inverse of a matrix to an address, and return what is behind it and behind its work."""
        e, n = self.e, plan.size
        matrix = e.address(inverse, padded(n) ** 2)
        work = e.address(matrix, n * n)
        placed = {}
        for block, lower in lower_triangles(plan, triangles):
            pairs = ((sorted((block[i], block[j])), value) for (i, j), value in lower.items())
            placed.update({(second, first): value for (first, second), value in pairs})
        for j in range(n):
            for i in range(j, n):
                e.put(placed.get((i, j), literal(0.0)), matrix, j * n + i)
        arguments = f"i64 {n}, i64 {padded(n)}, ptr {matrix}, ptr {inverse}, ptr {work}"
        body = self.origin.body
        body.singular.append(e.value(f"call i1 @{body.name_of(invert.form())}({arguments})"))
        return "" if len(self.packing.stages) == 1 else e.address(work, work_size(n))

    def solved(self, place: int) -> list[VectorName]:
        """Return the unknowns of a stage: v[k] = M0^-1 (f[k-1] scale / k - p^[k])."""
        stage, e = self.packing.stages[place], self.e
        right, inverse = right_sides(self, stage), self.inverses[place]
        if stage.plan.diagonal:
            return self.divided(stage, str(inverse), right)
        memory = self.origin.body.scratch("right", "double", padded(stage.plan.size))
        at = 0
        for chunk, vector in zip(stage.unknowns, right, strict=True):
            store_exactly(e, vector, len(chunk.values), chunk.count, e.address(memory, at))
            at += chunk.count
        if isinstance(inverse, str):
            return self.product(stage, inverse, memory)
        inverse.solve(memory)
        starts = accumulate((chunk.count for chunk in stage.unknowns), initial=0)
        return [
            load_exactly(self.shuffle, e.address(memory, start), len(chunk.values), chunk.count)
            for start, chunk in zip(starts, stage.unknowns, strict=False)
        ]

    def divided(self, stage: PackedStage, inverses: str, right: Sequence[VectorName]) -> list[VectorName]:
        """Return each entry times the inverse of its mass."""
        found: list[VectorName] = []
        place = 0
        for chunk, vector in zip(stage.unknowns, right, strict=True):
            lanes = len(chunk.values)
            inverse = load_exactly(self.shuffle, self.e.address(inverses, place), lanes, chunk.count)
            found.append(self.do.fma(vector, inverse, None, lanes))
            place += chunk.count
        return found

    def product(self, stage: PackedStage, inverse: str, right: str) -> list[VectorName]:
        """Return the product of the inverse with a vector in memory."""
        e, n, chunks = self.e, stage.plan.size, stage.unknowns
        stride = padded(n) if stage.plan.moving else n
        starts = [sum(chunk.count for chunk in chunks[:i]) for i in range(len(chunks))]

        def column(j: str | int) -> list[str]:
            base = e.address(inverse, j * stride if isinstance(j, int) else e.value(f"mul nsw i64 {j}, {stride}"))
            return [
                load_exactly(self.shuffle, e.address(base, at), len(chunk.values), chunk.count)
                for at, chunk in zip(starts, chunks, strict=True)
            ]

        kinds = [element(len(chunk.values)) for chunk in chunks]
        if n > WRITTEN_OUT:
            zeros = [number(0.0, len(chunk.values)) for chunk in chunks]
            with e.carry(0, n, list(zip(kinds, zeros, strict=True))) as loop:
                entry = e.get(right, loop.index)
                loop.following = [
                    e.fma(part, e.splat(entry, kind), total, kind)
                    for part, chunk, total, kind in zip(column(loop.index), chunks, loop.values, kinds, strict=True)
                ]
            return list(loop.values)
        totals: list[list[VectorName]] = [[None, None] for _ in chunks]
        for j in range(n):
            entry = e.get(right, j)
            for i, (part, chunk) in enumerate(zip(column(j), chunks, strict=True)):
                lanes = len(chunk.values)
                totals[i][j % 2] = self.do.fma(part, e.splat(entry, element(lanes)), totals[i][j % 2], lanes)
        return [self.do.add(a, b, len(chunk.values)) for (a, b), chunk in zip(totals, chunks, strict=True)]

    def write(self) -> None:
        """Store the row."""
        e, packing = self.e, self.packing
        place = 0
        for chunk in packing.state:
            store_exactly(e, self.now(chunk.whole), len(chunk.values), chunk.count, e.address(self.row, place))
            place += chunk.count
        for i, watched in enumerate(packing.program.watched):
            value = None if watched is None else self.now(Operand((watched,)))
            e.put(value or literal(0.0), self.row, self.layout.watched_at + i)
        for operand in dict.fromkeys([*packing.summed, *packing.delayed, *packing.rates]):
            lanes = len(operand.values)
            e.store(
                self.now(operand) or number(0.0, lanes),
                e.address(self.row, self.slots.places[operand]),
                element(lanes),
            )
