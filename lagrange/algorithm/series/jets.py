"""Builders of the procedure that computes the Taylor coefficients of a state: without loops, or in a loop over orders.

A builder makes the procedure

    jet(t, scale, y, prepared, constants, rows, order) -> True if a matrix is singular

It writes the Taylor coefficients of q and v at the state y, times scale**k, to row k of `rows`, for k from 0 to the
order. `prepared` are the numbers that depend on parameters alone. Values with the same rule are adjacent, in chunks of
a length known at compile time, so that a compiler turns each chunk into vectors.

`WrittenJet` is for a small system: each coefficient is a value of the procedure. `ByOrderJet` loops over orders: it
stores each vector that later orders read in a row of memory. Straight-line code computes the values of the present
order from the sums over lower orders.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from functools import reduce
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.kernel.body import SOURCE
from lagrange.algorithm.series.linear_systems import ALL, Diagonal, Inverse, LinearSystem, moving_system, system_size
from lagrange.algorithm.series.numbers import ALONE, SeriesNumbers, Start
from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, PackedStage, Packing
from lagrange.algorithm.series.rules import (
    TILE,
    ChunkAt,
    OrderSums,
    Pair,
    Row,
    StoredOperands,
    Term,
    coefficient,
    fma,
    gathered,
    joined,
    less,
    plus,
    put,
    wide,
    width,
)
from lagrange.algorithm.taylor.memory import LOWEST_ORDER, TaylorLayout
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.values import Flag, Real, Whole
from lagrange.program.elimination import LARGEST_IN_LINE
from lagrange.program.series import SeriesProgram

NAME = "taylor_jet"
"""Name of the procedure that computes the series, in printed code."""

ANGLES_AT_ONCE = 8
"""Number of angles whose sines and cosines are computed at once, in code with vectors."""


class JetBuilder:
    """Base class of builders of the procedure that computes the Taylor series at a state, order after order.

    `origin` has the values at order 0, by the index of the series value, and `x` the coefficients of each chunk
    (vector of values) at the present order. Inverses of mass matrices are written out up to the size `largest`.
    """

    def __init__(self, packing: Packing, numbers: SeriesNumbers, layout: TaylorLayout, largest: int) -> None:
        self.packing, self.numbers, self.layout, self.largest = packing, numbers, layout, largest
        self.program: SeriesProgram = packing.program
        self.p = p = Builder(NAME, "Write the Taylor coefficients of a state. Return True if a matrix is singular.")
        self.t, self.scale = p.given("t", REAL), p.given("scale", REAL)
        self.y, self.prepared = p.array("y", read=True), p.array("prepared", read=True)
        p.array("constants", read=True)
        self.rows = p.array("rows", room=WIDEST_VECTOR)
        self.order: Whole = p.given("order", WHOLE)
        self.constants: list[Real] = []
        self.origin: dict[int, Any] = {}
        self.x: dict[Chunk, Term] = {}
        self.systems: list[LinearSystem] = []
        self.singular: Flag = p.false

    def begin(self) -> None:
        """Add the code for constants, values of order 0, and inverses or factors of the mass matrices."""
        program, p = self.program, self.p
        self.constants = [self.numbers.constant(self.prepared, index) for index in range(len(program.numbers))]
        self.joined: dict[tuple[int, ...], Term] = {}
        """Coefficients joined to vectors, by their indices in the table."""
        self.reciprocals: dict[Operand, Term] = {}
        """Reciprocals of the values at order 0, by operand that is the divisor of a rule."""
        style = ALONE if self.packing.lanes > 1 else SOURCE
        start = Start(p, self.numbers, self.prepared, self.constants, self.t, self.y, self.layout.padded, style)
        start.run_moving(ANGLES_AT_ONCE if self.packing.lanes > 1 else 1)
        values = [start.value(ref) for ref in program.start.outputs]
        self.origin = dict(zip(program.started, values, strict=False))
        for i in range(program.states):
            self.origin.setdefault(i, self.y[i])
        # The memory for matrices follows the rows of Taylor coefficients.
        triangles, memory = iter(values[len(program.started) :]), self.rows.at((self.order + 1) * self.layout.width)
        flags = [start.failed]
        for stage, known in zip(program.stages, self.numbers.systems(p, self.prepared), strict=True):
            if known is None:
                known, singular = moving_system(p, stage.plan, triangles, memory, self.largest)
                memory = memory.at(size) if (size := system_size(stage.plan, self.largest)) else memory
                flags += singular
            self.systems.append(known)
        self.singular = reduce(lambda a, b: a | b, flags)

    def constant(self, indices: tuple[int, ...]) -> Term:
        """Return the constants of the series program with these `indices`, as one number or vector."""
        if indices not in self.joined:
            self.joined[indices] = self.numbers.vector(self.prepared, indices, self.constants)
        return self.joined[indices]

    def common(self, indices: Sequence[int]) -> float | None:
        """Return the number that all constants with these `indices` equal, if known at compile time; else None."""
        known = dict.fromkeys(self.program.numbers[index] for index in indices)
        return next(iter(known)) if len(known) == 1 else None

    def is_known(self, operand: Operand, stage_number: int) -> bool:
        """Return True if an operand is known before linear system `stage_number`, from 0 on, is solved."""
        depth = self.program.depth
        return all(value == ZERO_LANE or depth[value] <= stage_number for value in operand.values)

    def fill(self, chunks: Sequence[Chunk]) -> None:
        """Compute the Taylor coefficients of `chunks` at the present order, each by the rule of its chunk."""
        for chunk in chunks:
            x = coefficient(ChunkAt(self, chunk))
            self.x[chunk] = None if x is None else wide(self.p, x, len(chunk.values))

    def at_zero(self, operand: Operand) -> Term:
        """Return the values of an operand at order 0, as a number or vector; None if all of them are zero."""
        zero = (None, 0)
        return joined(self.p, [zero if value == ZERO_LANE else (self.origin.get(value), 0) for value in operand.values])


def divided(jet: JetBuilder, x: Term, high: Term, low: Term) -> Term:
    """Return the vector x divided by an order k, and possibly multiplied by the time scale, rounded once.

    `high` and `low` are two doubles whose sum is 1 / k or scale / k. The result is x * (high + low). The rounded
    reciprocal alone has an error of the same sign at every step, and these errors would add up. `low` is None if it
    is negligible.
    """
    if x is None:
        return None
    return x * high if low is None else jet.p.fma(x, high, x * low)


def solved(jet: Any, stage_number: int, stage: PackedStage, guesses: Sequence[Term]) -> list[Term]:
    """Return the coefficients of a linear system's unknowns at the present order k, one vector for each chunk.

    The system is linear in the unknowns. So any trial values `guesses` of them give the exact solution, guesses +
    M0^-1 (f[k-1] * scale / k - p[k]). M0 is the matrix of the system at order 0. f are the forces. p are the momenta,
    which are computed with the guesses as unknowns. `jet` is the builder, `stage` the system and `stage_number` its
    number.
    """
    right = []
    for force, momentum in zip(stage.right, stage.left, strict=True):
        rate = None if force is None else jet.share(jet.before(force))
        right.append(less(rate, None if momentum is None else jet.now(momentum)))
    solution = jet.systems[stage_number].solve(stage.rows, right)
    return [plus(x, guess) for x, guess in zip(solution, guesses, strict=True)]


HIGHEST_EXACT_ORDER = 10
"""Highest order at which division by the order is rounded once. Coefficients of higher orders contribute so little to a
step that the bias of their rounding is negligible.
"""

PART, LATEST = 4, 2
"""`PART`: number of products in each partial sum. The products of a partial sum wait for one another. In one chain, a
sum of order 26 waits longer than all other operations of that order take: eight members of a pendulum took 154 ns, with
partial sums 128 ns. `LATEST`: number of products that are added last, because they wait for the previous order.
"""


class WrittenJet(JetBuilder):
    """Builder of a procedure without loops that computes a series up to an order from `lowest` to `highest`.

    The order is an argument of the procedure.
    """

    def __init__(
        self,
        packing: Packing,
        numbers: SeriesNumbers,
        highest: int,
        *,
        lowest: int = LOWEST_ORDER,
        layout: TaylorLayout | None = None,
    ) -> None:
        largest = ALL if packing.lanes > 1 else LARGEST_IN_LINE
        if layout is None:
            program, scratch = packing.program, sum(system_size(stage.plan) for stage in packing.program.stages)
            layout = TaylorLayout.of(program, scratch=scratch, chains=True, observes=len(program.watched) > 0)
        super().__init__(packing, numbers, layout, largest)
        self.lowest, self.highest, self.k = lowest, highest, 0
        self.orders: list[dict[Chunk, Term]] = [{}]
        """The coefficients of chunks by order. The entry of order 0 is empty, because `origin` has these values."""
        self.operands: dict[tuple[Operand, int], Term] = {}
        self.totals: dict[tuple[Chunk, int, int], Term] = {}
        self.shares: dict[tuple[float, int], Term] = {}

    def build(self) -> Procedure:
        """Return the procedure that computes the series without a loop."""
        self.begin()
        self.write()
        for k in range(1, self.highest + 1):
            self.add_order(k)
        self.p.leave(self.singular)
        return self.p.finish(FLAG)

    def add_order(self, k: int) -> None:
        """Add the code of order k: coefficients of all values, and the row that is written.

        At the highest order, values after the last linear system are computed for event functions only.
        """
        packing, self.k, self.x = self.packing, k, {}
        self.orders.append(self.x)
        for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
            self.x[chunk] = self.share(self.before(rate))
        self.fill(packing.before)
        for stage_number, stage in enumerate(packing.stages):
            guesses: list[Term] = [None] * len(stage.unknowns)
            # The unknowns of order 1 are corrected by the residual of dp/dt = f: they carry most of a step's rounding
            # error. Corrected accelerations of chains of 10 and 20 links are two to three times as accurate.
            for _ in range(2 if k == 1 and stage.plan.moving else 1):
                self.know(stage_number, guesses)
                self.fill(stage.trial)
                guesses = solved(self, stage_number, stage, guesses)
            self.know(stage_number, guesses)
            last = stage is packing.stages[-1]
            if last and not self.program.watched:
                self.end_order()
            if k < self.highest or self.program.watched or not last:
                self.fill(stage.found)
        if self.program.watched:
            self.end_order()

    def end_order(self) -> None:
        """Add code that writes the row of the present order and returns if it is the last requested order."""
        self.write()
        if self.lowest <= self.k < self.highest:
            with self.p.when(self.order.equals(self.k)):
                self.p.leave(self.singular)

    def know(self, stage_number: int, values: Sequence[Term]) -> None:
        """Set the present coefficients of the unknowns of linear system `stage_number` to `values`.

        Operands that were gathered with earlier values of the unknowns are dropped.
        """
        for key in [key for key in self.operands if key[1] == self.k and not self.is_known(key[0], stage_number)]:
            del self.operands[key]
        self.x |= zip(self.packing.stages[stage_number].unknowns, values, strict=True)

    def write(self) -> None:
        """Write the row of Taylor coefficients of the present order to memory.

        Zeros are written too, because other runs use the same memory.
        """
        index = self.k * self.layout.width
        watched_at = index + self.layout.watched_at
        for chunk in self.packing.state:
            put(self.p, self.rows, index, self.now(chunk.whole), len(chunk.values), chunk.count)
            index += chunk.count
        for i, watched in enumerate(self.program.watched, watched_at):
            put(self.p, self.rows, i, None if watched is None else self.now(Operand((watched,))), 1, 1)

    def now(self, operand: Operand) -> Term:
        """Return the Taylor coefficients of an operand, a vector of series values, at the present order."""
        return self.at(operand, self.k)

    def before(self, operand: Operand) -> Term:
        """Return the Taylor coefficients of an operand, a vector of series values, at the previous order."""
        return self.at(operand, self.k - 1)

    def first(self, operand: Operand) -> Term:
        """Return an operand, a vector of series values, at order 0."""
        return self.at(operand, 0)

    def at(self, operand: Operand, k: int) -> Term:
        """Return the Taylor coefficients of an operand, a vector of series values, at order k."""
        key = operand, k
        if key in self.operands:
            return self.operands[key]
        if k == 0:
            coefficient = self.at_zero(operand)
        else:
            coefficient = gathered(self.p, self.packing, operand, self.orders[k].__getitem__)
            if operand.ranked and coefficient is not None and k > 1:
                coefficient = coefficient * float(k)
        self.operands[key] = coefficient
        return coefficient

    def over(self, operand: Operand) -> Term:
        """Return the reciprocals at order 0 of an operand, a vector of series values."""
        if operand not in self.reciprocals:
            first = self.first(operand)
            self.reciprocals[operand] = 1.0 / (self.p.real(0.0) if first is None else first)
        return self.reciprocals[operand]

    def share(self, x: Term) -> Term:
        """Return scale * x / k: the coefficient of order k of a value, from its derivative's coefficient x."""
        if x is None:
            return None
        high, low = reciprocal(self.k)
        small = self.scaled(low, width(x)) if low and self.k <= HIGHEST_EXACT_ORDER else None
        return divided(self, x, self.scaled(high, width(x)), small)

    def scaled(self, factor: float, lanes: int) -> Term:
        """Return the unit of time (`scale`) times `factor`, repeated in each lane.

        The product is exact, because the scale is a power of two.
        """
        if (factor, lanes) not in self.shares:
            single = self.scale if factor == 1.0 else self.scale * factor
            if lanes > 1:
                single = self.p.broadcast(self.scaled(factor, 1), lanes)
            self.shares[factor, lanes] = single
        return self.shares[factor, lanes]

    def start(self) -> Term:
        """Return the present Taylor coefficient of the time itself: the scale of time at order 1, else 0."""
        return self.scale if self.k == 1 else None

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the present order of the series."""
        high, low = reciprocal(self.k)
        return divided(self, x, self.p.real(high), self.p.real(low) if low and self.k <= HIGHEST_EXACT_ORDER else None)

    def total(self, chunk: Chunk, number: int) -> Term:
        """Return sum `number` of the rule of a chunk: the sum of x[j] y[k-j] over 0 < j < k at the present order k.

        Its code is added once at each order.
        """
        key = chunk, number, self.k
        if key not in self.totals:
            self.totals[key] = self.summed(*chunk.sums[number])
        return self.totals[key]

    def summed(self, a: Operand, b: Operand) -> Term:
        """Return the sum of a[j] b[k-j] over 0 < j < k, for Taylor coefficients of two operands at order k."""
        k, p = self.k, self.p
        pairs = sorted(range(1, k), key=lambda j: (max(j, k - j), j))
        if a != b:
            return self.products(a, b, pairs)
        total = self.products(a, b, [j for j in pairs if 2 * j < k])
        total = plus(total, total)
        middle = self.at(a, k // 2)
        return fma(p, middle, middle, total) if k % 2 == 0 else total

    def products(self, a: Operand, b: Operand, pairs: Sequence[int]) -> Term:
        """Return the sum of a[j] * b[k-j] over the orders j in `pairs`, at the present order k.

        It is added up in partial sums of about `PART` products. a and b are operands, vectors of series values.
        """
        k, p = self.k, self.p
        parts: list[Term] = [None] * max(len(pairs) // PART, 1)
        early = len(pairs) - LATEST
        for index, j in enumerate(pairs):
            if index == early:
                parts = [reduce(plus, parts)]
            lane = index % len(parts)
            parts[lane] = fma(p, self.at(a, j), self.at(b, k - j), parts[lane])
        return reduce(plus, parts)


def reciprocal(k: int) -> tuple[float, float]:
    """Return 1 / k as a pair of doubles, whose sum is accurate to twice the digits."""
    high = 1.0 / k
    return high, float(Fraction(1, k) - Fraction(high))


LARGEST_INVERSE = 12
"""Largest inverse of a mass matrix that is written out. Lanes already hold members, so inner loops do not vectorize."""


def by_order_layout(packing: Packing, width: int = 0, **parts: Any) -> TaylorLayout:
    """Return the memory layout of a series computed in a loop over orders, with rows of the length `width`.

    By default (0) a row has space for the state and the event functions only. `parts` are values of other fields of
    `TaylorLayout`, by name.
    """
    scratch = sum(system_size(stage.plan, LARGEST_INVERSE) for stage in packing.program.stages)
    return TaylorLayout.of(packing.program, width, scratch=scratch, **parts)


def run_layout(packing: Packing, width: int = 0) -> TaylorLayout:
    """Return the layout of a series in a loop over orders for exported code and for ensemble members.

    Steps are summed row by row, and events are only reported. By default (0) the length `width` of a row has space
    for the state and the event functions only.
    """
    return by_order_layout(packing, width, by_rows=True, observes=len(packing.program.watched) > 0)


class ByOrderJet(JetBuilder):
    """Builder of the procedure that computes the Taylor coefficients in a loop over orders k.

    `tile` is the largest number of sums over lower orders that one loop computes. With `paired` the sums of an odd
    order and of the next order are computed together.
    """

    def __init__(
        self,
        packing: Packing,
        numbers: SeriesNumbers,
        layout: TaylorLayout | None = None,
        *,
        tile: int = TILE,
        paired: bool = True,
    ) -> None:
        if layout is None:
            layout = run_layout(packing, Row(packing, packing.program.states).size)
        super().__init__(packing, numbers, layout, LARGEST_INVERSE)
        self.k: Whole = self.order
        self.rank = self.time = self.high = self.low = self.scale
        self.shares = self.scale, self.scale
        self.tile, self.paired = tile, paired
        self.operands: dict[Operand, Term] = {}
        """Vector of coefficients of each operand that was already gathered at the present order."""
        self.sums: Mapping[Pair, Term] = {}
        """Sums over lower orders that rules at the present order read, by pair of factors."""
        self.row = self.stored_row = self.previous = self.rows

    def build(self) -> Procedure:
        """Return the procedure that computes the series for all lanes."""
        p, packing = self.p, self.packing
        self.begin()
        for operand in dict.fromkeys(chunk.divisor for chunk in packing.computed):
            if operand is not None:
                self.reciprocals[operand] = 1.0 / self.at_zero(operand)
        for system, stage in zip(self.systems, packing.stages, strict=True):
            if isinstance(system, (Diagonal, Inverse)):
                # The entries are gathered to vectors before the loop over orders.
                system.read(stage.rows)
        self.stored = self.storage()
        sums = self.order_sums()
        self.write_state(self.at_zero)
        for operand, index in self.stored.places.items():
            # The row of order 0 has zeros for operands that are multiplied by their order.
            lanes = len(operand.values)
            put(p, self.stored.memory, index, None if operand.ranked else self.at_zero(operand), lanes, lanes)
        guesses = [
            [p.variable(wide(p, None, len(chunk.values))) for chunk in stage.unknowns] if stage.plan.moving else None
            for stage in packing.stages
        ]
        with self.each_order() as iteration:
            self.sums = sums.at(self.k)
            for chunk, rate in zip(packing.coordinates, packing.rates, strict=True):
                self.x[chunk] = self.share(self.before(rate))
            self.fill(packing.before)
            for stage_number, (stage, guess) in enumerate(zip(packing.stages, guesses, strict=True)):
                self.solve(stage_number, stage, guess, iteration)
            self.write()
        p.leave(self.singular)
        return p.finish(FLAG)

    def storage(self) -> StoredOperands:
        """Return the memory of the operands that later orders read: the caller's rows."""
        return StoredOperands(self.rows, self.layout.width, Row(self.packing, self.layout.watched_at).places)

    def order_sums(self) -> OrderSums:
        """Return the builder of the code for the sums over lower orders."""
        pairs = (pair for chunk in self.packing.computed for pair in chunk.sums)
        return OrderSums(self.p, pairs, self.stored, self.tile, paired=self.paired)

    @contextmanager
    def each_order(self) -> Iterator[Whole]:
        """Add a loop over the orders from 1 on. The body of the `with` statement adds the code of one order.

        With a mass matrix that depends on the state an iteration 0 is added before: it computes order 1 once, and
        iteration 1 computes it again with this result as the guess of the unknowns.
        """
        p, moving = self.p, any(stage.plan.moving for stage in self.packing.stages)
        if moving:
            p.note("Order 1 is computed twice, the second time with the result of the first as a guess.")
        with p.loop(0 if moving else 1, self.order + 1) as iteration:
            self.set_order(p.operation("max", iteration, 1) if moving else iteration)
            yield iteration

    def set_order(self, k: Whole) -> None:
        """Set k as the present order: find its row and the previous row, and compute 1 / k and scale / k.

        Both quotients are sums of two doubles.
        """
        p = self.p
        self.stored_row, self.previous = self.stored.row(k), self.stored.row(k - 1)
        self.row = self.stored_row if self.stored.memory is self.rows else self.rows.at(k * self.layout.width)
        self.k, self.rank = k, p.real(k)
        self.high = 1.0 / self.rank
        p.note("1 - k * high is exact. Times `high`, it is the rounding error of 1 / k.")
        self.low = p.fma(-self.rank, self.high, 1.0) * self.high
        self.shares = self.high * self.scale, self.low * self.scale
        self.time = p.choose(k.equals(1), self.scale, 0.0)

    def start(self) -> Term:
        """Return the present Taylor coefficient of the time itself: the scale of time at order 1, else 0."""
        return self.time

    def share(self, x: Term) -> Term:
        """Return scale * x / k: the coefficient of order k of a value, from its derivative's coefficient x."""
        return divided(self, x, *self.shares)

    def part(self, x: Term) -> Term:
        """Return x / k, where k is the present order of the series."""
        return divided(self, x, self.high, self.low)

    def know(self, stage_number: int, values: Sequence[Term]) -> None:
        """Set the present coefficients of the unknowns of linear system `stage_number` to `values`.

        Operands that were gathered with earlier values of the unknowns are dropped.
        """
        self.operands = {operand: x for operand, x in self.operands.items() if self.is_known(operand, stage_number)}
        self.x |= zip(self.packing.stages[stage_number].unknowns, values, strict=True)

    def solve(self, stage_number: int, stage: PackedStage, guess: Sequence[Any] | None, iteration: Whole) -> None:
        """Compute the unknowns of a linear system at the present order, then the values that depend on them.

        `stage` is the system, and `stage_number` its number. If order 1 is computed in two iterations, `guess` has
        variables with the unknowns of the first iteration; otherwise it is None. `iteration` is the number of the
        present iteration.
        """
        p = self.p
        guesses = [None if guess is None else variable.value for variable in guess or [None] * len(stage.unknowns)]
        self.know(stage_number, guesses)
        self.fill(stage.trial)
        solution = solved(self, stage_number, stage, guesses)
        values = [wide(p, x, len(chunk.values)) for chunk, x in zip(stage.unknowns, solution, strict=True)]
        if guess is not None:
            weight = p.choose(iteration.equals(0), p.real(1.0), 0.0)
            for variable, x in zip(guess, values, strict=True):
                variable.value = x * weight
        self.know(stage_number, values)
        self.fill(stage.found)

    def write(self) -> None:
        """Write the row of Taylor coefficients of the present order to memory."""
        self.write_state(self.now)
        for operand, index in self.stored.places.items():
            lanes = len(operand.values)
            put(self.p, self.stored_row, index, self.now(operand), lanes, lanes)

    def write_state(self, x: Any) -> None:
        """Write coefficients of the state and of the event functions to a row of memory.

        `x` is a function that returns the coefficients of an operand: `at_zero` for the row of order 0, or `now` for
        the row of the present order. Parts of the state that this row already has, as stored operands, are left out.
        """
        begin, row = 0, self.rows if x == self.at_zero else self.row
        for chunk in self.packing.state:
            if self.stored.memory is not self.rows or self.stored.places.get(chunk.whole) != begin:
                put(self.p, row, begin, x(chunk.whole), len(chunk.values), chunk.count)
            begin += chunk.count
        for index, number in enumerate(self.program.watched, self.layout.watched_at):
            put(self.p, row, index, None if number is None else x(Operand((number,))), 1, 1)

    def now(self, operand: Operand) -> Term:
        """Return the Taylor coefficients of an operand, a vector of series values, at the present order."""
        if operand not in self.operands:
            x = gathered(self.p, self.packing, operand, self.x.__getitem__)
            self.operands[operand] = x * self.rank if operand.ranked and x is not None else x
        return self.operands[operand]

    def before(self, operand: Operand) -> Term:
        """Return the Taylor coefficients of an operand, a vector of series values, at the previous order."""
        return self.stored.read(self.previous, operand)

    def first(self, operand: Operand) -> Term:
        """Return an operand, a vector of series values, at order 0."""
        if self.packing.lanes > 1 and operand in self.stored.places:
            return self.stored.read(self.stored.memory, operand)
        return self.at_zero(operand)

    def over(self, operand: Operand) -> Term:
        """Return the reciprocals at order 0 of an operand, a vector of series values."""
        return self.reciprocals[operand]

    def total(self, chunk: Chunk, number: int) -> Term:
        """Return sum `number` of the rule of a chunk: the sum of x[j] y[k-j] over 0 < j < k at the present order k."""
        return self.sums[chunk.sums[number]]
