"""The series of a small system written out: every coefficient of every order is a value of its own.

    i32 jet(double t, double scale, ptr y, ptr p, ptr c, ptr rows, i64 order)

writes the coefficients of q, v and what is watched, times scale**k, to row k of `rows` for k from 0 to the order; `y`
is the state, `p` the prepared parameters of the start, `c` the constants (see `lagrange.machine.series.llvm_driver`).
It returns 1 if the mass matrix is singular, else 0. Sums over lower orders start with the oldest coefficients, so that
the processor can work on them while the newest are still on their way.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import element, number
from lagrange.machine.series.llvm_jet import (
    SIGNATURE,
    OrderZero,
    Shuffle,
    VectorConstants,
    constant_vector,
    known_numbers,
    lower_triangles,
    right_sides,
    store_exactly,
)
from lagrange.machine.series.llvm_rules import VectorArithmetic, VectorName, coefficient, divided, reciprocal
from lagrange.procedure.linear.ldl import factor_size, invert_dense
from lagrange.procedure.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.procedure.taylor.memory import TaylorLayout
from lagrange.program.elimination import elimination

EXACT = 10
"""Up to this order a division by the order is rounded once.

A later coefficient contributes so little to a step that the bias of its rounding is negligible.
"""


class UnrolledJet:
    """Emits the function. `x` has the coefficients of each chunk, by chunk and order; k is the order at hand."""

    def __init__(self, packing: Packing, table: VectorConstants, layout: TaylorLayout, order: int) -> None:
        self.packing, self.table, self.order, self.width = packing, table, order, layout.width
        self.origin = OrderZero(packing, layout.padded)
        self.e: Emitter = self.origin.e
        self.do = VectorArithmetic(self.e)
        self.shuffle = Shuffle(self.e)
        self.k = 0
        self.x: dict[tuple[Chunk, int], VectorName] = {}
        self.gathered: dict[tuple[Operand, int], VectorName] = {}
        self.totals: dict[tuple[Chunk, int, int], VectorName] = {}
        self.initial: dict[Operand, VectorName] = {}
        self.reciprocals: dict[Operand, str] = {}
        self.constants: dict[tuple[int, ...], str] = {}
        self.shares: dict[tuple[float, int], str] = {}
        self.inverses: list[list[dict[int, VectorName]]] = []

    def function(self) -> str:
        """Return the IR."""
        packing, program = self.packing, self.packing.program
        self.invert()
        self.write()
        for k in range(1, self.order + 1):
            self.k = k
            for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
                self.x[chunk, self.k] = self.share(self.before(rate), len(chunk.values))
            self.fill(packing.before)
            for place, stage in enumerate(packing.stages):
                self.know(place, [None] * len(stage.unknowns))
                self.fill(stage.trial)
                found = self.solved(place)
                if k == 1 and stage.plan.moving:
                    found = self.refined(place, found)
                self.know(place, found)
                if self.k < self.order or program.watched or stage is not packing.stages[-1]:
                    self.fill(stage.found)
            self.write()
        self.e.do(f"ret i32 {self.origin.body.status()}")
        return self.e.function(SIGNATURE)

    def refined(self, place: int, found: Sequence[VectorName]) -> list[VectorName]:
        """Correct the unknowns of order 1 by the residual of dp/dt = f.

        They carry most of a step's rounding, which is mostly that of the mass matrix. For chains of 10 and 20 links the
        corrected accelerations are two to three times as accurate.
        """
        self.know(place, found)
        stage = self.packing.stages[place]
        self.fill(stage.trial)
        return [
            self.do.add(value, correction, len(chunk.values))
            for chunk, value, correction in zip(stage.unknowns, found, self.solved(place), strict=True)
        ]

    def know(self, place: int, found: Sequence[VectorName]) -> None:
        """Enter the unknowns of a stage, and drop what was gathered with others in their place."""
        depth = self.packing.program.depth
        for key in [key for key in self.gathered if key[1] == self.k]:
            if any(value != ZERO_LANE and depth[value] > place for value in key[0].values):
                del self.gathered[key]
        for chunk, value in zip(self.packing.stages[place].unknowns, found, strict=True):
            self.x[chunk, self.k] = value

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Emit the coefficients of some chunks at the order at hand."""
        for chunk in chunks:
            self.x[chunk, self.k] = coefficient(self, chunk)

    def at(self, operand: Operand, k: int) -> VectorName:
        """Return an operand at an order."""
        if k == 0:
            return self.first(operand)
        key = (operand, k)
        if key not in self.gathered:
            vector = self.shuffle.operand(self.packing, operand, lambda chunk: self.x[chunk, k])
            if operand.ranked and k > 1:
                lanes = len(operand.values)
                vector = self.do.scale(vector, number(float(k), lanes), lanes)
            self.gathered[key] = vector
        return self.gathered[key]

    def now(self, operand: Operand) -> VectorName:
        """Return an operand at the order at hand."""
        return self.at(operand, self.k)

    def before(self, operand: Operand) -> VectorName:
        """Return an operand at the order before."""
        return self.at(operand, self.k - 1)

    def first(self, operand: Operand) -> VectorName:
        """Return an operand at order 0."""
        if operand not in self.initial:
            self.initial[operand] = self.origin.vector(operand)
        return self.initial[operand]

    def total(self, chunk: Chunk, which: int) -> VectorName:
        """Return the sum over 0 < j < k, once for each order, the oldest coefficients first."""
        key = (chunk, which, self.k)
        if key not in self.totals:
            self.totals[key] = self._total(*chunk.sums[which])
        return self.totals[key]

    def _total(self, a: Operand, b: Operand) -> VectorName:
        k, lanes = self.k, len(a.values)
        order = sorted(range(1, k), key=lambda j: (max(j, k - j), j))
        total: VectorName = None
        if a != b:
            for j in order:
                total = self.do.fma(self.at(a, j), self.at(b, k - j), total, lanes)
            return total
        for j in order:
            if 2 * j < k:
                total = self.do.fma(self.at(a, j), self.at(a, k - j), total, lanes)
        double = self.do.add(total, total, lanes)
        return self.do.fma(self.at(a, k // 2), self.at(a, k // 2), double, lanes) if k % 2 == 0 else double

    def over(self, operand: Operand) -> str:
        """Return one over an operand at order 0."""
        if operand not in self.reciprocals:
            lanes = len(operand.values)
            first = self.first(operand) or number(0.0, lanes)
            self.reciprocals[operand] = self.e.value(f"fdiv {element(lanes)} {number(1.0, lanes)}, {first}")
        return self.reciprocals[operand]

    def numbers(self, chunk: Chunk, which: int) -> list[float] | None:
        """Return a coefficient of each lane where all are known now, else None."""
        return known_numbers(self.table, chunk, which)

    def constant(self, chunk: Chunk, which: int) -> str:
        """Return a coefficient as a vector, read once."""
        lanes = chunk.coefficients[which]
        if lanes not in self.constants:
            self.constants[lanes] = constant_vector(self.e, self.table, lanes)
        return self.constants[lanes]

    def share(self, x: VectorName, lanes: int) -> VectorName:
        """Return x scale / k."""
        high, low = reciprocal(self.k)
        return self.times(
            x, self.scales(high, lanes), self.scales(low, lanes) if low and self.k <= EXACT else None, lanes
        )

    def part(self, x: VectorName, lanes: int) -> VectorName:
        """Return x / k."""
        high, low = reciprocal(self.k)
        exact = low and self.k <= EXACT
        return self.times(x, number(high, lanes), number(low, lanes) if exact else None, lanes)

    def times(self, x: VectorName, high: str, low: str | None, lanes: int) -> VectorName:
        """Return x times a number that is the sum of two."""
        return self.do.scale(x, high, lanes) if low is None else divided(self.do, x, high, low, lanes)

    def scales(self, factor: float, lanes: int) -> str:
        """Return the scale times a number in every lane; the scale is a power of two, so that this is exact."""
        key = (factor, lanes)
        if key not in self.shares:
            if lanes == 1:
                self.shares[key] = "%scale" if factor == 1.0 else self.e.real("fmul", "%scale", literal(factor))
            else:
                self.shares[key] = self.e.splat(self.scales(factor, 1), element(lanes))
        return self.shares[key]

    def start(self, lanes: int) -> VectorName:
        """Return the coefficient of time."""
        return self.scales(1.0, lanes) if self.k == 1 else None

    def solved(self, place: int) -> list[VectorName]:
        """Return the unknowns of a stage: v[k] = M0^-1 (f[k-1] scale / k - p^[k])."""
        stage, inverse = self.packing.stages[place], self.inverses[place]
        plan = stage.plan
        if plan.diagonal and not plan.moving:
            return self.lightest(stage, inverse)
        right = zip(right_sides(self, stage), stage.unknowns, strict=True)
        entries = [(vector, len(chunk.values), lane) for vector, chunk in right for lane in range(chunk.count)]
        found = []
        for chunk, columns in zip(stage.unknowns, inverse, strict=True):
            lanes, total = len(chunk.values), None
            for j, column in columns.items():
                single = self.shuffle.lane(*entries[j])
                splat = None if single is None else self.e.splat(single, element(lanes))
                total = self.do.fma(column, splat, total, lanes)
            found.append(total)
        return found

    def lightest(self, stage: PackedStage, columns: Sequence[dict[int, VectorName]]) -> list[VectorName]:
        """Return v[k] = f[k-1] scale / k m for a constant diagonal mass matrix."""
        found = []
        for i, (chunk, force) in enumerate(zip(stage.unknowns, stage.right, strict=True)):
            lanes = len(chunk.values)
            inverse = columns[i][-1] or number(0.0, lanes)
            found.append(
                None if force is None else self.do.scale(self.share(self.before(force), lanes), inverse, lanes)
            )
        return found

    def invert(self) -> None:
        """Find the inverse of the matrix of each stage, as the columns that each chunk of unknowns needs."""
        begin, triangles = 0, iter(self.origin.triangles)
        for stage in self.packing.stages:
            plan, rows = stage.plan, {value: i for i, value in enumerate(self.unknowns_of(stage))}
            entries = self.inverted(plan, triangles) if plan.moving else self.loaded(plan, begin)
            begin += 0 if plan.moving else plan.size if plan.diagonal else plan.size**2
            self.inverses.append([])
            for chunk in stage.unknowns:
                wanted = [rows[value] for value in chunk.values]
                if plan.diagonal and not plan.moving:
                    alone: list[tuple[VectorName, int, int]] = [(entries[i, i], 1, 0) for i in wanted]
                    self.inverses[-1].append({-1: self.shuffle.gather(alone)})
                    continue
                columns: dict[int, VectorName] = {}
                for j in range(plan.size):
                    lanes: list[tuple[VectorName, int, int]] = [(entries.get((i, j)), 1, 0) for i in wanted]
                    if any(lane[0] is not None for lane in lanes):
                        columns[j] = self.shuffle.gather(lanes)
                self.inverses[-1].append(columns)

    @staticmethod
    def unknowns_of(stage: PackedStage) -> list[int]:
        """Return the unknowns of a stage, one by one."""
        return [value for chunk in stage.unknowns for value in chunk.values[: chunk.count]]

    def loaded(self, plan: SolvePlan, begin: int) -> dict[tuple[int, int], str]:
        """Read the inverse of a constant matrix, which stands before the constants."""
        places = [(i, j) for block in plan.blocks for i in block for j in block]
        n = 0 if plan.diagonal else plan.size
        return {(i, j): self.e.get("%c", begin + j * n + i) for i, j in places}

    def inverted(self, plan: SolvePlan, triangles: Iterator[str]) -> dict[tuple[int, int], str]:
        """Emit the inverse of every block, with pivoting where a pivot cannot be trusted."""
        found = {}
        for block, lower in lower_triangles(plan, triangles):
            for (i, j), value in self.inverse_of(len(block), lower, plan.negative(block)).items():
                found[block[i], block[j]] = value
        return found

    def inverse_of(
        self, n: int, lower: dict[tuple[int, int], str], negative: tuple[int, ...]
    ) -> dict[tuple[int, int], str]:
        """Return the entries of the inverse of a symmetric matrix."""
        e, body = self.e, self.origin.body
        plan = elimination(n, frozenset(lower), negative)
        rows, trusted = body.factor(plan, lower)
        table = dict(zip(plan.places, rows, strict=True))
        unit = [[literal(float(i == j)) for i in range(n)] for j in range(n)]
        columns = [body.solve(plan, lambda i, j: table[i, j], right) for right in unit]
        places = [(i, j) for j in range(n) for i in range(j, n)]
        name, before = e.fresh("pivot"), e.block
        e.do(f"br i1 {trusted}, label %{name}.join, label %{name}.cold, !prof !0")
        e.label(f"{name}.cold")
        memory, result = body.scratch("matrix", "double", n * n), body.scratch("inverse", "double", n * n)
        work = body.scratch("work", "double", factor_size(n))
        for j in range(n):
            for i in range(j, n):
                e.put(lower.get((i, j), literal(0.0)), memory, j * n + i)
        solver = body.name_of(invert_dense.form())
        singular = e.value(f"call i1 @{solver}(i64 {n}, ptr {memory}, ptr {result}, ptr {work})")
        slow = [e.get(result, j * n + i) for i, j in places]
        cold = e.block
        e.jump(f"{name}.join")
        e.label(f"{name}.join")
        body.singular.append(e.value(f"phi i1 [ false, %{before} ], [ {singular}, %{cold} ]"))
        found = {}
        for (i, j), there in zip(places, slow, strict=True):
            value = e.value(f"phi double [ {columns[j][i]}, %{before} ], [ {there}, %{cold} ]")
            found[i, j] = found[j, i] = value
        return found

    def write(self) -> None:
        """Store the row; what is zero is stored too, for the memory serves many runs."""
        packing, e = self.packing, self.e
        place = self.k * self.width
        for chunk in packing.state:
            store_exactly(e, self.now(chunk.whole), len(chunk.values), chunk.count, e.address("%rows", place))
            place += chunk.count
        place = (self.k + 1) * self.width - len(packing.program.watched)
        for i, watched in enumerate(packing.program.watched):
            value = None if watched is None else self.now(Operand((watched,)))
            e.put(value or literal(0.0), "%rows", place + i)
