"""The rules of a series: the coefficient of a value at order k, from lower orders and from its arguments.

`ChunkAt` reads the inputs of a rule. A number or vector is None if it is exactly zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lagrange.algorithm.series.packing import Chunk, Operand
from lagrange.procedure.builder import Builder
from lagrange.program.series import OWN

Term = Any
"""A real, or several as a vector; None means zero."""


class ChunkAt:
    """Reads the inputs of the rule of a chunk (a vector of like values), at the present order k of a builder.

    `series` is the builder. In the methods `number` is that of an argument, of a sum or of a coefficient
    of the rule. As an argument, `OWN` stands for the chunk itself. `share(x)` is scale * x / k, with the unit
    of time as scale, and `part(x)` is x / k.
    """

    def __init__(self, series: Any, chunk: Chunk) -> None:
        self.series, self.chunk = series, chunk
        self.p: Builder = series.p
        self.share, self.part = series.share, series.part

    def operand(self, number: int) -> Operand:
        """Return the operand that is argument `number`, or the chunk itself for OWN."""
        return self.chunk.whole if number == OWN else self.chunk.args[number]

    def now(self, number: int) -> Term:
        """Return argument `number` at the present order."""
        return self.series.now(self.operand(number))

    def before(self, number: int) -> Term:
        """Return argument `number` at the previous order."""
        return self.series.before(self.operand(number))

    def first(self, number: int) -> Term:
        """Return argument `number` at order 0, or the chunk itself for OWN."""
        first = self.series.first(self.operand(number))
        return self.p.real(0.0) if first is None else first

    def total(self, number: int) -> Term:
        """Return sum `number` of `Chunk.sums`, a sum of x[j] y[k-j] over 0 < j < k."""
        return self.series.total(self.chunk, number)

    def over(self, number: int) -> Term:
        """Return the reciprocal at order 0 of argument `number`, or of the chunk itself for OWN."""
        return self.series.over(self.operand(number))

    def known(self, number: int) -> float | None:
        """Return constant `number` of the rule if known at compile time and equal in all lanes, else None."""
        coefficient: float | None = self.series.common(self.chunk.coefficients[number])
        return coefficient

    def constant(self, number: int) -> Term:
        """Return the constant factor number `number` of the rule, as a number or vector."""
        return self.series.constant(self.chunk.coefficients[number])


def fma(p: Builder, a: Term, b: Term, total: Term) -> Term:
    """Return a * b + total."""
    if a is None or b is None:
        return total
    return a * b if total is None else p.fma(a, b, total)


def less(a: Term, b: Term) -> Term:
    """Return a - b."""
    if b is None:
        return a
    return -b if a is None else a - b


def plus(a: Term, b: Term) -> Term:
    """Return a + b."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def scaled(at: ChunkAt, x: Term, number: int = 0) -> Term:
    """Return x times coefficient `number` of the rule."""
    known = at.known(number)
    if x is None or known == 1.0:
        return x
    return -x if known == -1.0 else x * at.constant(number)


def coefficient(at: ChunkAt) -> Term:
    """Return the Taylor coefficients of a chunk of values at the present order, computed by its rule."""
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
    """Return (left - b[k] * u[0]) / b[0], the coefficient u[k] of a quotient; b is argument `number`."""
    last = at.now(number)
    if last is not None:
        left = fma(at.p, -last, at.first(OWN), left)
    return None if left is None else left * at.over(number)


def _sqrt(at: ChunkAt) -> Term:
    left = less(at.now(0), at.total(0))
    coefficient = None if left is None else left * (at.over(OWN) * 0.5)
    return _flat(at, at.first(OWN), coefficient)


def _flat(at: ChunkAt, zeroed: Term, coefficient: Term) -> Term:
    """Return the coefficient of a root or power: `coefficient`, unless its divisor at order 0, `zeroed`, is zero.

    If it is zero, the coefficient is 0 while the coefficients of the argument are zero, else NaN.
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
