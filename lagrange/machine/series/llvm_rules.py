"""The rules of a series over vectors of values: the coefficients of one order from those before.

A jet says where coefficients come from: `now` and `first` give an operand at the order at hand and at order 0, `total`
a sum over the orders between. None stands for a vector that is exactly zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Protocol

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.spelling import element, number
from lagrange.procedure.series.packing import Chunk, Operand

VectorName = str | None


class Orders(Protocol):
    """What the rules ask of a jet."""

    e: Emitter
    do: VectorArithmetic

    def now(self, operand: Operand) -> VectorName:
        """Return an operand at the order at hand."""

    def before(self, operand: Operand) -> VectorName:
        """Return an operand at the order before."""

    def first(self, operand: Operand) -> VectorName:
        """Return an operand at order 0."""

    def total(self, chunk: Chunk, which: int) -> VectorName:
        """Return the sum over 0 < j < k of the chunk's pair of that number."""

    def over(self, operand: Operand) -> str:
        """Return one over an operand at order 0."""

    def numbers(self, chunk: Chunk, which: int) -> Sequence[float] | None:
        """Return a coefficient of each lane where all are known now, else None."""

    def constant(self, chunk: Chunk, which: int) -> str:
        """Return a coefficient as a vector."""

    def share(self, x: VectorName, lanes: int) -> VectorName:
        """Return x scale / k."""

    def part(self, x: VectorName, lanes: int) -> VectorName:
        """Return x / k."""

    def start(self, lanes: int) -> VectorName:
        """Return the coefficient of time: the scale at k = 1, else 0."""


class VectorArithmetic:
    """Operations on vectors that may be exactly zero."""

    def __init__(self, e: Emitter) -> None:
        self.e = e

    def scale(self, a: VectorName, factor: str, lanes: int) -> VectorName:
        """Return a times a number."""
        if a is None or factor == number(1.0, lanes):
            return a
        if factor == number(-1.0, lanes):
            return self.e.value(f"fneg {element(lanes)} {a}")
        return self.e.value(f"fmul {element(lanes)} {a}, {factor}")

    def fma(self, a: VectorName, b: VectorName, total: VectorName, lanes: int) -> VectorName:
        """Return a b + total."""
        if a is None or b is None:
            return total
        kind = element(lanes)
        return self.e.value(f"fmul {kind} {a}, {b}") if total is None else self.e.fma(a, b, total, kind)

    def less(self, a: VectorName, b: VectorName, lanes: int) -> VectorName:
        """Return a - b."""
        kind = element(lanes)
        if b is None:
            return a
        return self.e.value(f"fneg {kind} {b}") if a is None else self.e.value(f"fsub {kind} {a}, {b}")

    def add(self, a: VectorName, b: VectorName, lanes: int) -> VectorName:
        """Return a + b."""
        if a is None or b is None:
            return b if a is None else a
        return self.e.value(f"fadd {element(lanes)} {a}, {b}")


def divided(do: VectorArithmetic, x: VectorName, high: str, low: str, lanes: int) -> VectorName:
    """Return x (high + low), rounded once.

    The rounded reciprocal of an order has an error of the same sign at every step, so errors would grow with time.
    Random rounding errors grow with its square root.
    """
    return x if x is None else do.fma(x, high, do.scale(x, low, lanes), lanes)


def reciprocal(k: int) -> tuple[float, float]:
    """Return 1 / k as the sum of two doubles."""
    high = 1.0 / k
    return high, float(Fraction(1, k) - Fraction(high))


def coefficient(jet: Orders, chunk: Chunk) -> VectorName:
    """Return the coefficients of a chunk at the order at hand."""
    return _RULES[chunk.op](jet, chunk, len(chunk.values))


def _linear(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    total: VectorName = None
    for which, operand in enumerate(chunk.args):
        x, known = jet.now(operand), jet.numbers(chunk, which)
        if x is None:
            continue
        signs = set(known or ())
        if total is None:
            total = jet.do.scale(x, jet.constant(chunk, which), lanes)
        elif signs == {1.0}:
            total = jet.do.add(total, x, lanes)
        elif signs == {-1.0}:
            total = jet.do.less(total, x, lanes)
        else:
            total = jet.do.fma(x, jet.constant(chunk, which), total, lanes)
    return total


def _mul(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    # The argument that is known last comes first in a chunk, and is added last.
    a, b = chunk.args
    total = jet.do.fma(jet.first(a), jet.now(b), jet.total(chunk, 0), lanes)
    return jet.do.fma(jet.now(a), jet.first(b), total, lanes)


def _square(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    (a,) = chunk.args
    twice = jet.do.scale(jet.first(a), number(2.0, lanes), lanes)
    return jet.do.fma(jet.now(a), twice, jet.total(chunk, 0), lanes)


def _div(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    a, b = chunk.args
    left = jet.do.less(jet.now(a), jet.total(chunk, 0), lanes)
    return _divided(jet, chunk, lanes, left, b)


def _inverse(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    left = jet.do.less(None, jet.total(chunk, 0), lanes)
    return _divided(jet, chunk, lanes, left, chunk.args[0])


def _divided(jet: Orders, chunk: Chunk, lanes: int, left: VectorName, b: Operand) -> VectorName:
    """Return (left - b[k] u[0]) / b[0]."""
    last = jet.now(b)
    if last is not None:
        minus = jet.e.value(f"fneg {element(lanes)} {last}")
        left = jet.do.fma(minus, jet.first(chunk.whole), left, lanes)
    return jet.do.scale(left, jet.over(b), lanes)


def _sqrt(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    left = jet.do.less(jet.now(chunk.args[0]), jet.total(chunk, 0), lanes)
    half = jet.do.scale(jet.over(chunk.whole), number(0.5, lanes), lanes)
    return _flat(jet, chunk, chunk.whole, jet.do.scale(left, half or number(0.0, lanes), lanes))


def _flat(jet: Orders, chunk: Chunk, zeroed: Operand, found: VectorName) -> VectorName:
    """Return what was found for a root, or where it begins at zero: zero while its argument stays zero, else NaN."""
    (a,) = chunk.args
    e, lanes = jet.e, len(chunk.values)
    kind = element(lanes)
    truth = "i1" if lanes == 1 else f"<{lanes} x i1>"
    zero, undefined = number(0.0, lanes), number(float("nan"), lanes)
    dead = e.value(f"fcmp oeq {kind} {jet.first(zeroed)}, {zero}")
    still = e.value(f"fcmp oeq {kind} {jet.now(a) or zero}, {zero}")
    value = e.value(f"select {truth} {still}, {kind} {zero}, {kind} {undefined}")
    return e.value(f"select {truth} {dead}, {kind} {value}, {kind} {found or zero}")


def _power(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    """a[0] u[k] = (e + 1) / k sum of j a[j] u[k-j] - sum of a[j] u[k-j] + e a[k] u[0]."""
    (a,) = chunk.args
    e, kind = jet.e, element(lanes)
    exponent = jet.constant(chunk, 0)
    known = jet.numbers(chunk, 0)
    if known is None:
        above = e.value(f"fadd {kind} {exponent}, {number(1.0, lanes)}")
    else:
        above = vector_literal([value + 1.0 for value in known])
    ranked = jet.do.scale(jet.part(jet.total(chunk, 0), lanes), above, lanes)
    left = jet.do.less(ranked, jet.total(chunk, 1), lanes)
    slope = jet.do.scale(jet.first(chunk.whole), exponent, lanes)
    left = jet.do.fma(jet.now(a), slope, left, lanes)
    total = jet.do.scale(left, jet.over(a), lanes)
    return total if known is not None and max(known) < 0 else _flat(jet, chunk, a, total)


def _integral(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    w = jet.share(jet.before(chunk.args[0]), lanes)
    return jet.do.scale(w, jet.constant(chunk, 0), lanes)


def _along(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    a, w = chunk.args
    total = jet.part(jet.total(chunk, 0), lanes)
    total = jet.do.fma(jet.now(a), jet.first(w), total, lanes)
    return jet.do.scale(total, jet.constant(chunk, 0), lanes)


def _against(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    a, w = chunk.args
    total = jet.part(jet.total(chunk, 0), lanes)
    return jet.do.scale(jet.do.less(jet.now(a), total, lanes), jet.over(w), lanes)


def _choose(jet: Orders, chunk: Chunk, lanes: int) -> VectorName:
    e, kind = jet.e, element(lanes)
    one, other = (jet.now(arg) or number(0.0, lanes) for arg in chunk.args)
    truth = "i1" if lanes == 1 else f"<{lanes} x i1>"
    holds = e.value(f"fcmp une {kind} {jet.constant(chunk, 0)}, {number(0.0, lanes)}")
    return e.value(f"select {truth} {holds}, {kind} {one}, {kind} {other}")


def vector_literal(values: Sequence[float]) -> str:
    """Return a constant vector, or a constant for one lane."""
    if len(values) == 1:
        return literal(values[0])
    return "<" + ", ".join(f"double {literal(value)}" for value in values) + ">"


_RULES: dict[str, Callable[[Orders, Chunk, int], VectorName]] = {
    "time": lambda jet, chunk, lanes: jet.start(lanes),
    "constant": lambda jet, chunk, lanes: None,
    "linear": _linear,
    "mul": _mul,
    "square": _square,
    "div": _div,
    "inverse": _inverse,
    "sqrt": _sqrt,
    "power": _power,
    "integral": _integral,
    "along": _along,
    "against": _against,
    "choose": _choose,
}
