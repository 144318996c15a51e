"""Plain procedures that use every construct of the front end."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated

from lagrange.procedure.form import REAL, Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    Readable,
    WholesOut,
    Writable,
    clear,
    each,
    fma,
    larger,
    likely,
    magnitude,
    operation,
    quotient,
    reals,
    record,
    unrolled,
    wholes,
)

InBlocks = Annotated[Readable[float], Array(REAL, read=True, room=4)]
OutBlocks = Annotated[Writable[float], Array(REAL, room=4)]


@record
class Counter:
    """A record with a counter."""

    total: float
    count: int


@dataclass(frozen=True)
class Pair:
    """Two arrays of the same length."""

    source: InBlocks
    target: OutBlocks
    length: int


@dataclass(frozen=True)
class Weights:
    """Static values, known when a procedure is built."""

    numbers: tuple[float, ...]

    @inline
    def applied(self, x: float) -> float:
        total = 0.0
        for power, weight in enumerate(self.numbers):
            total = weight if power == 0 else total + weight * x
        return total


@procedure
def gathered(n: int, pair: Pair, counter: Counter) -> tuple[float, float, float]:
    """Return reductions over a part of an array."""
    total, most, least = 0.5, -1.0, 1.0
    size = squares = 0.0
    for i in each(pair.length):
        x = pair.source[i]
        total += x
        most = max(most, x)
        least = min(least, x)
        size = magnitude(size, x)
        squares = fma(x, x, squares)
        pair.target[i] = x * 2.0 if x < 0.0 else x
    counter.total += total + squares
    counter.count = n
    return most, least, size


@procedure
def several(n: int, a: In, out: Out) -> tuple[float, int]:
    """Return sums from a tuple that a loop and a branch assign again."""
    sums: tuple[float, ...] = (a[0], 0.5, -1.0)
    last = 0.0, 0
    for i in range(1, n):
        sums = tuple(fma(total, 0.5, a[i]) for total in (sums[1], sums[2], sums[0]))
        if a[i] > 0.0:
            last = a[i], i
    for i in each(n):
        powers = tuple(a[i] for _ in range(3))
        for k in range(3):
            powers = tuple(power * 0.5 + a[k] for power in powers)
        out[i] = powers[0] + powers[2]
    first, _, _ = sums
    _, second, _ = sums
    third, _ = sums[2] + second, sums[1] + first
    return first + second + third * 4.0 + last[0], last[1]


@inline
def clipped(x: float, bound: float) -> float:
    if x > bound:
        return bound
    if x < -bound:
        return -bound
    return x


@inline
def below(n: int) -> Iterator[int]:
    yield from range(n)


@inline
def alternate(n: int) -> Iterator[int]:
    for k in below(quotient(n + 1, 2)):
        i = 2 * k
        if i != 2:
            yield i


@procedure
def spliced(n: int, x: float, a: Out, *, weights: Weights, twice: bool = False) -> float:
    """Use inlined functions."""
    total = 0.0
    for i in alternate(n):
        a[i] = clipped(a[i], 1.5)
        total = total + a[i]
    if twice:
        total = 2.0 * total

    def shifted(value: float) -> float:
        return value + x

    def halved(value: float) -> float:
        return shifted(value) * 0.5

    first, second = halved(total), shifted(0.5)
    return weights.applied(first) + second


@procedure
def by_name(x: float, pair: Pair, *, ops: tuple[str, ...]) -> float:
    """Apply operations by name, replace a field of a bundle, and read values by key."""
    later = replace(pair, source=pair.source[1:])
    values = dict(zip(ops, [operation(op, x, later.source[k]) for k, op in enumerate(ops)], strict=True))
    total: float = operation("neg", 1.0)
    for op in reversed(ops):
        total = total - values[op]
    return total


@procedure
def scratch(n: int, a: In, out: Out) -> int:
    """Use local arrays and a local record, which is set to zero."""
    work, places, kept = reals(4), wholes(4), Counter()
    kept.count = n
    clear(kept)
    for i in unrolled(4):
        work[i] = a[i] + float(i)
        places[i] = 3 - i
    work[1:3] = a[:2]
    for j in range(4):
        out[j] = work[places[j]]
        kept.count += 1
    out[4:6] = 0.25
    last = out[n:]
    last[0], out[0] = out[0], last[0]
    return kept.count


@procedure(work=lambda size: Array(REAL, size, room=4), tail=lambda with_tail: Array(REAL) if with_tail else None)
def sized(work: Out, tail: Out | None, x: float, *, size: int, with_tail: bool) -> float:
    """Take parameters whose types depend on static values."""
    for i in each(size, width=4, spill=False):
        work[i] = x
    if tail is not None:
        tail[0] = work[size - 1]
    return work[0]


@procedure
def applied(function: Callable[[float, In], float], x: float, a: In) -> float:
    """Call a function parameter."""
    y = function(x, a)
    return function(y, a[1:]) if likely(y > 0.0) else y


@procedure
def caller(n: int, a: InBlocks, out: OutBlocks, marks: WholesOut) -> float:
    """Call other procedures."""
    total, last = several(n, a, out)
    if last < 0:
        return -1.0
    marks[0] = last
    pair = Pair(a, out, n)
    kept = Counter()
    kept.total = 0.5
    most, _, size = gathered(n, pair, kept)
    return larger(most, size) + kept.total + total
