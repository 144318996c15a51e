"""Recurrences of Taylor coefficients: the coefficient of a value at order k from lower orders and from its arguments.

`ChunkAt` reads the inputs of a rule. A number or vector is None if it is exactly zero. A vector is gathered from
entries of several values; with one entry it is a real number.

The operands of the sums over lower orders are in rows, one row of coefficients for each order. If `paired`, an odd
order and the next order are summed together, over the orders before both: each number that is read from memory then
serves two sums. The products with the odd order itself are added at the even order. A loop computes several sums, whose
totals stay in registers. Sums with a common factor are adjacent, and read this factor once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, groupby
from typing import Any, NamedTuple

from lagrange.algorithm.constants import whole_blocks
from lagrange.algorithm.series.packing import ZERO_LANE, Chunk, Operand, Packing
from lagrange.procedure.builder import Builder
from lagrange.procedure.values import Entries, Flag, Memory, Real, Variable, Whole
from lagrange.program.series import OWN

Term = Any
"""Value in generated code: a real, a vector of reals, or None for a value that is exactly zero."""


class ChunkAt:
    """Reads the inputs of the rule of a chunk (values with one rule) at the present order k of a builder.

    `series` is the builder. In the methods, `number` is the index of an argument, of a sum or of a coefficient of
    the rule. `OWN` as an argument is the value that the rule computes. `share(x)` is scale * x / k, with the unit
    of time as scale, and `part(x)` is x / k.
    """

    def __init__(self, series: Any, chunk: Chunk) -> None:
        self.series, self.chunk = series, chunk
        self.p: Builder = series.p
        self.share, self.part = series.share, series.part

    def operand(self, number: int) -> Operand:
        """Return the operand that is argument `number` of the rule; for `OWN` the values that the rule computes."""
        return self.chunk.whole if number == OWN else self.chunk.args[number]

    def now(self, number: int) -> Term:
        """Return the Taylor coefficients of argument `number` of the rule at the present order."""
        return self.series.now(self.operand(number))

    def before(self, number: int) -> Term:
        """Return the Taylor coefficients of argument `number` of the rule at the previous order."""
        return self.series.before(self.operand(number))

    def first(self, number: int) -> Term:
        """Return argument `number` of the rule at order 0. For `OWN` return the values that the rule computes."""
        first = self.series.first(self.operand(number))
        return self.p.real(0.0) if first is None else first

    def total(self, number: int) -> Term:
        """Return sum `number` of `Chunk.sums`, a sum of x[j] y[k-j] over 0 < j < k."""
        return self.series.total(self.chunk, number)

    def over(self, number: int) -> Term:
        """Return 1 / argument `number` of the rule at order 0; for `OWN` 1 / the values that the rule computes."""
        return self.series.over(self.operand(number))

    def known(self, number: int) -> float | None:
        """Return constant `number` of the rule if known at compile time and equal in all lanes, else None."""
        coefficient: float | None = self.series.common(self.chunk.coefficients[number])
        return coefficient

    def constant(self, number: int) -> Term:
        """Return the constant factor number `number` of the rule, as a number or vector."""
        return self.series.constant(self.chunk.coefficients[number])


def fma(p: Builder, a: Term, b: Term, total: Term) -> Term:
    """Return a * b + total, where None means zero."""
    if a is None or b is None:
        return total
    return a * b if total is None else p.fma(a, b, total)


def less(a: Term, b: Term) -> Term:
    """Return a - b, where None means zero."""
    if b is None:
        return a
    return -b if a is None else a - b


def plus(a: Term, b: Term) -> Term:
    """Return a + b, where None means zero."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def scaled(at: ChunkAt, x: Term, number: int = 0) -> Term:
    """Return x times coefficient `number` of the rule; None for zero."""
    known = at.known(number)
    if x is None or known == 1.0:
        return x
    return -x if known == -1.0 else x * at.constant(number)


def coefficient(at: ChunkAt) -> Term:
    """Return the Taylor coefficients of a chunk's values at the present order, by the rule of the chunk.

    `at` reads the inputs of the rule. None means zero.
    """
    return _RULES[at.chunk.op](at)


def _linear(at: ChunkAt) -> Term:
    total: Term = None
    for number in range(len(at.chunk.args)):
        x, known = at.now(number), at.known(number)
        if x is None:
            continue
        if total is None:
            total = scaled(at, x, number)
        elif known == 1.0:
            total = total + x
        elif known == -1.0:
            total = total - x
        else:
            total = at.p.fma(x, at.constant(number), total)
    return total


def _mul(at: ChunkAt) -> Term:
    # The argument that is computed last is the first in a chunk, and is added last.
    a, b = at.now(0), at.now(1)
    total = at.total(0)
    if b is not None:
        total = fma(at.p, at.first(0), b, total)
    return total if a is None else fma(at.p, a, at.first(1), total)


def _square(at: ChunkAt) -> Term:
    a, total = at.now(0), at.total(0)
    return total if a is None else fma(at.p, a, at.first(0) * 2.0, total)


def _divided(at: ChunkAt, left: Term, number: int) -> Term:
    """Return u[k] = (left - b[k] * u[0]) / b[0], the coefficient of order k of a quotient u.

    u is the value that the rule computes, and b is its argument `number`, the divisor.
    """
    last = at.now(number)
    if last is not None:
        left = fma(at.p, -last, at.first(OWN), left)
    return None if left is None else left * at.over(number)


def _sqrt(at: ChunkAt) -> Term:
    left = less(at.now(0), at.total(0))
    coefficient = None if left is None else left * (at.over(OWN) * 0.5)
    return _flat(at, at.first(OWN), coefficient)


def _flat(at: ChunkAt, zeroed: Term, coefficient: Term) -> Term:
    """Return the coefficient of a root or power, also if its divisor at order 0 is zero.

    `coefficient` is the result for a nonzero divisor, and `zeroed` is the divisor. If the divisor is zero, the
    result is 0 if the argument's coefficient of the present order is zero, else NaN.
    """
    p, now = at.p, at.now(0)
    still = p.true if now is None else now.equals(0.0)
    dead = p.choose(still, 0.0, p.real(float("nan")))
    return p.choose(zeroed.equals(0.0), dead, p.real(0.0) if coefficient is None else coefficient)


def _power(at: ChunkAt) -> Term:
    """Return the coefficient of the power u = a**e at the present order k, where a is the argument.

    a[0] u[k] = (e + 1) / k * (sum of j a[j] u[k-j]) - (sum of a[j] u[k-j]) + e a[k] u[0], with sums over 0 < j
    < k.
    """
    known = at.known(0)
    exponent = at.constant(0)
    above = exponent + 1.0 if known is None else at.p.real(known + 1.0)
    ranked = at.part(at.total(0))
    left = less(None if ranked is None else ranked * above, at.total(1))
    now = at.now(0)
    if now is not None:
        left = fma(at.p, now, at.first(OWN) * exponent, left)
    coefficient = None if left is None else left * at.over(0)
    return coefficient if known is not None and known < 0 else _flat(at, at.first(0), coefficient)


def _along(at: ChunkAt) -> Term:
    total, now = at.part(at.total(0)), at.now(0)
    if now is not None:
        total = fma(at.p, now, at.first(1), total)
    return scaled(at, total)


def _against(at: ChunkAt) -> Term:
    left = less(at.now(0), at.part(at.total(0)))
    return None if left is None else left * at.over(1)


def _choose(at: ChunkAt) -> Term:
    first, second = (at.p.real(0.0) if (x := at.now(number)) is None else x for number in range(2))
    return at.p.choose(~at.constant(0).equals(0.0), first, second)


_RULES: Mapping[str, Callable[[ChunkAt], Term]] = {
    "time": lambda at: at.series.start(),
    "constant": lambda at: None,
    "linear": _linear,
    "mul": _mul,
    "square": _square,
    "div": lambda at: _divided(at, less(at.now(0), at.total(0)), 1),
    "inverse": lambda at: _divided(at, less(None, at.total(0)), 0),
    "sqrt": _sqrt,
    "power": _power,
    "integral": lambda at: scaled(at, at.share(at.before(0))),
    "along": _along,
    "against": _against,
    "choose": _choose,
}


LARGEST_STORED_BLOCK = 8
"""Bound of the number of entries that one instruction stores, when the first entries of a vector are written to memory.
The bound is the vector's length if that is larger. The remaining entries are stored in ever smaller blocks, each with
the bound divided by a power of two.
"""


def width(x: Real | Entries) -> int:
    """Return the number of entries of a number or vector."""
    return x.width if isinstance(x, Entries) else 1


def joined(p: Builder, parts_of: Sequence[tuple[Term, int]]) -> Term:
    """Return a vector with one entry for each of `parts_of`, the pairs (value, index of an entry in the value).

    A value of None is zero. If all values are None, the result is None.
    """
    if all(x is None for x, _ in parts_of):
        return None
    terms = [(p.real(0.0), 0) if x is None else (x, entry) for x, entry in parts_of]
    parts = {x.ref: x for x, _ in terms}
    if len(parts) == 1 and [entry for _, entry in terms] == list(range(width(terms[0][0]))):
        return terms[0][0]
    begin, starts = 0, {}
    for ref, x in parts.items():
        starts[ref] = begin
        begin += width(x)
    return p.permuted(list(parts.values()), [starts[x.ref] + entry for x, entry in terms])


def gathered(p: Builder, packing: Packing, operand: Operand, x: Callable[[Chunk], Term]) -> Term:
    """Return an operand as a vector, gathered from the chunks that contain its values.

    `x` is a function that returns the coefficients of a chunk. For a `ranked` operand the result is not yet
    multiplied by the order.
    """
    homes = [None if value == ZERO_LANE else packing.place[value] for value in operand.values]
    if homes[0] is not None and homes[0][0].values == operand.values:
        return x(homes[0][0])
    return joined(p, [(None, 0) if home is None else (x(home[0]), home[1]) for home in homes])


def wide(p: Builder, x: Term, size: int) -> Real | Entries:
    """Return x as a vector of `size` entries. A number is repeated, and None gives zeros."""
    value = p.real(0.0) if x is None else x
    return p.broadcast(value, size) if size > width(value) else value


def entries(memory: Memory, index: int, size: int) -> Term:
    """Return `size` adjacent entries of an array, from index `index` on, as a number or vector."""
    return memory[index] if size == 1 else memory.entries(index, size)


def put(p: Builder, memory: Memory, index: int, x: Term, size: int, count: int) -> None:
    """Write the first `count` of the `size` entries of x to an array, from index `index` on.

    x is a vector, a number for all entries, or None for zeros.
    """
    value: Term = wide(p, x, size)
    lane, part = 0, max(LARGEST_STORED_BLOCK, size)
    while lane < count:
        while part > count - lane:
            part //= 2
        piece = value if part == size else p.permuted([value], range(lane, lane + part))
        if part == 1:
            memory[index + lane] = piece
        else:
            memory.put(index + lane, piece)
        lane += part


Pair = tuple[Operand, Operand]
"""The factors x and y of a sum of x[j] y[k-j] over 0 < j < k."""

TILE = 24
"""Largest number of sums that one loop computes: their accumulators take 24 of 32 vector registers; the others hold
factors.
"""


class OrderSum(NamedTuple):
    """A vector of sums of x[j] y[k-j] over 0 < j < k. Its totals are adjacent in memory, from index `place` on.

    `pair` are the factors (x, y) as the rule names them. The same factors are also named by their use: `lower` is
    read at order j, and `upper` at order k - j. Exchanging them does not change the sum. Sums with the same `upper`
    factor are adjacent, and read it once.
    """

    place: int
    pair: Pair
    lower: Operand
    upper: Operand

    @property
    def lanes(self) -> int:
        """Number of sums in the vector."""
        return len(self.lower.values)


def read_later(packing: Packing) -> tuple[Operand, ...]:
    """Return the operands that are stored at each order, because later orders read them.

    They are the factors of sums, the operands of the next order (integrands and forces) and dq/dt. With several
    lanes, operands that rules of higher orders read at order 0 are also stored.
    """
    computed = packing.computed
    summed = [operand for chunk in computed for pair in chunk.sums for operand in pair]
    integrands = [chunk.args[0] for chunk in computed if chunk.op == "integral"]
    forces = [force for stage in packing.stages for force in stage.right if force is not None]
    initial = [operand for chunk in computed for operand in (*chunk.args, chunk.whole) if chunk.sums]
    return (*summed, *integrands, *forces, *packing.rates, *(initial if packing.lanes > 1 else ()))


class Row:
    """Layout of the memory row of one order: indices of the state, the watched functions and stored operands.

    `places` has the index of each operand that later orders read, and `size` is the length of a row.
    """

    def __init__(self, packing: Packing, watched_at: int) -> None:
        self.places: dict[Operand, int] = {}
        begin = 0
        for chunk in packing.state:
            if chunk.count == len(chunk.values):
                self.places[chunk.whole] = begin
            begin += chunk.count
        self.size = watched_at + len(packing.program.watched)
        for operand in read_later(packing):
            if operand not in self.places:
                lanes = len(operand.values)
                self.places[operand] = whole_blocks(self.size, lanes)
                self.size = self.places[operand] + lanes
        self.size = whole_blocks(self.size, packing.lanes)


class StoredOperands(NamedTuple):
    """Memory of the operands that later orders read: a row of coefficients for each order.

    `memory` has the rows, each of `width` reals, and `places` is the index of each operand in a row.
    """

    memory: Memory
    width: int
    places: Mapping[Operand, int]

    def row(self, order: Whole | int) -> Memory:
        """Return the row of memory that has the coefficients of an order."""
        return self.memory.at(order * self.width)

    def read(self, row: Memory, operand: Operand) -> Term:
        """Return the coefficients of an operand, read from a row."""
        return entries(row, self.places[operand], len(operand.values))


class OrderSums:
    """Builds the code for all sums of x[j] y[k-j] over 0 < j < k that rules read at an order k.

    `pairs` are the factors (x, y), which are in the memory `stored`. `tile` is the largest number of sums that one loop
    computes. With `paired` an odd order and the next are summed together. The products of a sum are added in the same
    order with and without `paired`.
    """

    def __init__(
        self, p: Builder, pairs: Iterable[Pair], stored: StoredOperands, tile: int = TILE, *, paired: bool = True
    ) -> None:
        self.p, self.stored, self.tile, self.paired = p, stored, tile, paired
        different, places = dict.fromkeys(pairs), stored.places
        uses = Counter(kept for pair in different for kept in pair)
        known = [(pair, sorted(pair, key=lambda kept: (uses[kept], -places[kept]))) for pair in different]
        known.sort(key=lambda item: (places[item[1][1]], places[item[1][0]]))
        lanes = [len(factors[0].values) for _, factors in known]
        starts = accumulate(lanes, initial=0)
        self.sums = [OrderSum(index, pair, *factors) for index, (pair, factors) in zip(starts, known, strict=False)]
        self.size = sum(lanes)
        if not paired:
            return
        self.totals = p.reserve(2 * self.size + 1, name="totals")
        with p.each(2 * self.size, width=1) as i:
            self.totals[i] = 0.0

    def at(self, k: Whole) -> Mapping[Pair, Term]:
        """Add the code for all sums at an order k, and return them by pair of factors (x, y).

        Each sum is the sum of x[j] y[k-j] over 0 < j < k. The sums at order k - 1 must have been computed before.
        """
        p, totals = self.p, None
        even = (k - k // 2 * 2).equals(0)
        if self.paired:
            with p.when(~even & (k > 2)):
                for tile in self.tiles(self.tile // 2):
                    self.sum_two(tile, k)
            totals = self.totals.at(p.choose(even, p.whole(self.size), 0))
        return {pair: total for tile in self.tiles(self.tile) for pair, total in self.completed(tile, totals, k, even)}

    def tiles(self, size: int) -> Iterator[Sequence[OrderSum]]:
        """Yield the vectors of sums in groups of at most `size` vectors; one loop computes a group."""
        tile: list[OrderSum] = []
        for _, group in groupby(self.sums, key=lambda order_sum: order_sum.upper):
            members = list(group)
            if tile and len(tile) + len(members) > size:
                yield tile
                tile = []
            while len(members) > size:
                yield members[:size]
                members = members[size:]
            tile += members
        if tile:
            yield tile

    def sum_two(self, sums: Sequence[OrderSum], k: Whole) -> None:
        """Write the sums of x[j] y[k-j] over 0 < j < k at an odd order k, and most of each sum at order k + 1.

        The sums at order k + 1 lack the products with coefficients of order k, which are not known yet.
        """
        p = self.p
        first, second = ([p.variable(wide(p, None, order_sum.lanes)) for order_sum in sums] for _ in range(2))
        row = self.stored.row
        factors = self.factors(sums, row(k - 1))
        self.add(sums, first, row(1), factors)
        before = {kept: p.variable(x) for kept, x in factors.items()}
        with p.loop(2, k) as j:
            factors = self.factors(sums, row(k - j))
            self.add(sums, first, row(j), factors)
            self.add(sums, second, row(j), {kept: variable.value for kept, variable in before.items()})
            for kept, x in factors.items():
                before[kept].value = x
        for order_sum, total, following in zip(sums, first, second, strict=True):
            put(p, self.totals, order_sum.place, total.value, order_sum.lanes, order_sum.lanes)
            put(p, self.totals, self.size + order_sum.place, following.value, order_sum.lanes, order_sum.lanes)

    def completed(
        self, sums: Sequence[OrderSum], totals: Memory | None, k: Whole, even: Flag
    ) -> Iterator[tuple[Pair, Term]]:
        """Return pairs (factors, sum) for the vectors of sums `sums` at order k.

        The memory `totals` has the partial sums of `sum_two`. At an `even` order the products with order k - 1 are
        added to them, in loops of one iteration or none. With branches instead of these loops the outer solar system
        takes 1.08 times as long. If `totals` is None all products are added, in the same order.
        """
        p, variables = self.p, []
        for order_sum in sums:
            begun = None if totals is None else entries(totals, order_sum.place, order_sum.lanes)
            variables.append(p.variable(wide(p, begun, order_sum.lanes)))
        before = None if totals is None else k - p.whole(even)
        end = p.whole(even & (k > 2)) + 1
        for first, stop in ((end if before is None else before, k), (1, end)):
            with p.loop(first, stop) as j:
                self.add(sums, variables, self.stored.row(j), self.factors(sums, self.stored.row(k - j)))
        return ((order_sum.pair, total.value) for order_sum, total in zip(sums, variables, strict=True))

    def factors(self, sums: Sequence[OrderSum], row: Memory) -> dict[Operand, Term]:
        """Return the coefficients of the factor `upper` of each sum, read from a row, each factor once."""
        return {kept: self.stored.read(row, kept) for kept in dict.fromkeys(order_sum.upper for order_sum in sums)}

    def add(
        self, sums: Sequence[OrderSum], totals: Sequence[Variable], row: Memory, factors: Mapping[Operand, Term]
    ) -> None:
        """Add to the totals of `sums` the products of their two factors.

        The factors `lower` are read from `row`; the factors `upper` are in `factors`.
        """
        for order_sum, total in zip(sums, totals, strict=True):
            lower = self.stored.read(row, order_sum.lower)
            total.value = self.p.fma(lower, factors[order_sum.upper], total.value)


class SumsAtUse(OrderSums):
    """Builds the code for sums over lower orders where a rule first reads them, a group at a time.

    `pairs` are the pairs of factors of the sums, in the order in which rules read the sums. One loop computes the
    group of sums that are read next, so that their totals stay in registers. Each order is summed separately.
    """

    def __init__(self, p: Builder, pairs: Iterable[Pair], stored: StoredOperands, tile: int) -> None:
        self.used = {pair: index for index, pair in enumerate(dict.fromkeys(pairs))}
        super().__init__(p, self.used, stored, tile, paired=False)
        self.sums.sort(key=lambda order_sum: self.used[order_sum.pair])

    def at(self, k: Whole) -> Mapping[Pair, Term]:
        """Return the sums at an order k by pair of factors (x, y). The code of a sum is added at its first lookup."""
        return _Tiles(self, k)

    def tile_of(self, pair: Pair, k: Whole) -> dict[Pair, Term]:
        """Add the code for a group of sums, with the sum of a `pair`, at an order k. Return the sums by pair."""
        first = self.used[pair] // self.tile * self.tile
        sums = self.sums[first : first + self.tile]
        totals = [self.p.variable(wide(self.p, None, order_sum.lanes)) for order_sum in sums]
        with self.p.loop(1, k) as j:
            self.add(sums, totals, self.stored.row(j), self.factors(sums, self.stored.row(k - j)))
        return {order_sum.pair: total.value for order_sum, total in zip(sums, totals, strict=True)}


class _Tiles(dict[Pair, Term]):
    """The sums at one order, by pair of factors. The code of a sum and its group is added at the first lookup."""

    def __init__(self, sums: SumsAtUse, k: Whole) -> None:
        super().__init__()
        self.sums, self.k = sums, k

    def __missing__(self, pair: Pair) -> Term:
        self.update(self.sums.tile_of(pair, self.k))
        return self[pair]
