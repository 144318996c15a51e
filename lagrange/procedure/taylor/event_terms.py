"""Terms of a watched function's series on a step. Their sums usually decide that it has one zero, or none."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.events.constants import ROUND_OFF, SURELY
from lagrange.procedure.events.halving import sign_of
from lagrange.procedure.events.polynomial import approach, inverse_cubic, pad
from lagrange.procedure.events.scaling import is_plain, is_plain_step
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.watching import TERM_SUMS
from lagrange.procedure.values import Real

REST, RATES, END, SLOPE, LATE = range(len(TERM_SUMS))

LEAST_COUNT = 3
"""Least number of coefficients of a series; shorter ones are padded with zeros."""


class _Chain:
    """Sums of every other term from an order on. Two such chains hide the latency of additions."""

    def __init__(self, p: Builder, k: int, power: Real, square: Real, end: Any, slope: Any) -> None:
        self.p, self.square, self.first = p, square, k
        self.number, self.power, self.end = p.variable(float(k)), p.variable(power), p.variable(end)
        self.rest, self.rates, self.slope = p.variable(0.0), p.variable(0.0), p.variable(slope)

    def add(self, coefficient: Real) -> tuple[Real, Real]:
        """Add the next term; return the term, and the term times its order."""
        term: Real = coefficient * self.power.value
        rate: Real = self.number.value * term
        self.rest.value = self.rest.value + abs(term)
        self.rates.value = self.rates.value + abs(rate)
        self.end.value, self.slope.value = self.end.value + term, self.slope.value + rate
        self.power.value = self.power.value * self.square
        self.number.value = self.number.value + 2.0
        return term, rate


@shared
def event_terms() -> Procedure:
    """Return the procedure that writes the terms x[k] s**k of a watched function, k times each, and `TERM_SUMS`.

    The coefficients are read from rows that are `width` apart.
    """
    p = Builder("event_terms", "Write the terms of something that is watched on a step, and their sums.")
    rows, width, order = p.array("rows", read=True), p.given("width", WHOLE), p.given("order", WHOLE)
    s = p.given("s", REAL)
    c, slopes, sums = p.array("c"), p.array("slopes"), p.array("sums")
    start, slope, square, pairs = rows[0], rows[width] * s, s * s, (order - 1) // 2
    c[0], c[1], slopes[0] = start, slope, slope
    even, odd = _Chain(p, 2, square, square, start, 0.0), _Chain(p, 3, square * s, square, slope, slope)
    with p.loop(0, pairs) as j:
        for chain in (even, odd):
            k = j * 2 + chain.first
            c[k], slopes[k - 1] = chain.add(rows[k * width])
    with p.loop(pairs * 2 + 2, order + 1) as k:
        c[k], slopes[k - 1] = even.add(rows[k * width])
    pad(p, c, order + 1, order + 1)
    pad(p, slopes, order, order + 1)
    late = p.magnitude(c[order - 1], c[order])
    totals = (getattr(even, name).value + getattr(odd, name).value for name in ("rest", "rates", "end", "slope"))
    for place, value in enumerate((*totals, late)):
        sums[place] = value
    return p.finish()


@shared
def only_zero() -> Procedure:
    """Return the procedure that decides from the sums of terms whether a watched function has a zero on the step.

    The result is 0 if the function surely keeps its sign, and 1 or -1 if it surely changes to this sign, once. It is 2
    if that is undecided: the slope may change its sign, or a value at an end is within its noise.
    """
    p = Builder("only_zero", "Return the sign that a series takes on, once, on a step; 0 for none, 2 if unknown.")
    s, order, sign = p.given("s", REAL), p.given("order", WHOLE), p.given("sign", WHOLE)
    noise, terms, sums = p.given("noise", REAL), p.array("terms", read=True), p.array("sums", read=True)
    start, slope, rest, rates, end = terms[0], terms[1], sums[REST], sums[RATES], sums[END]
    rate, side = abs(slope), p.real(sign)
    total = abs(start) + rate + rest
    # The linear part outweighs the rest at both ends, and is between its end values in the middle.
    least = p.fma(ROUND_OFF, total, rest + noise) * SURELY
    clear = (side * start > least) & (side * (start + slope) > least)
    p.leave_if(clear, 0)
    doubt = noise + ROUND_OFF * total
    monotonic = 2.0 * rate > SURELY * (rate + rates)
    plain = is_plain_step(s, order + 1) & is_plain(total, noise)
    there = sign_of(p, end, doubt)
    decided = plain & monotonic & ~sign.equals(0) & sign_of(p, start, doubt).equals(sign) & ~there.equals(0)
    p.leave(p.choose(decided, p.choose(there.equals(sign), p.whole(0), there), p.whole(2)))
    return p.finish(WHOLE)


@shared
def only_passage() -> Procedure:
    """Return the procedure that finds the zero in 0 to 1 of a polynomial that changes to a sign exactly once."""
    p = Builder("only_passage", "Return where terms add up to a sign for the only time between 0 and 1.")
    c, slopes, sums = (p.array(name, read=True) for name in ("terms", "slopes", "sums"))
    order, sign = p.given("order", WHOLE), p.given("sign", WHOLE)
    count, side = p.variable(order + 1, "count"), p.real(sign)
    with p.repeat(lambda: (count.value > LEAST_COUNT) & c[count.value - 1].equals(0.0)):
        count.value = count.value - 1
    ends = p.constant(0.0, REAL), p.constant(1.0, REAL)
    values, rates = (side * c[0], side * sums[END]), (side * slopes[0], side * sums[SLOPE])
    start = inverse_cubic(p, ends, values, rates)
    p.leave(p.call(approach(), c, slopes, count.value, *ends, start, sign))
    return p.finish(REAL)


@shared
def read_column() -> Procedure:
    """Return the procedure that copies the series of a watched function from rows, `width` apart, on first use.

    `counts` has the number of its coefficients up to the last nonzero one, or 0 before the copy. The result is whether
    the series is finite.
    """
    p = Builder("read_column", "Copy a series from the rows, once; return whether it is finite.", apart=True)
    rows, width, order = p.array("rows", read=True), p.given("width", WHOLE), p.given("order", WHOLE)
    c, counts = p.array("c"), p.array("counts", WHOLE)
    p.leave_if(~counts[0].equals(0), p.true)
    total, used = p.variable(0.0), p.variable(order + 1, "used")
    with p.loop(0, order + 1) as k:
        value = rows[k * width]
        c[k] = value
        total.value = total.value + value * 0.0
    with p.repeat(lambda: (used.value > LEAST_COUNT) & c[used.value - 1].equals(0.0)):
        used.value = used.value - 1
    counts[0] = used.value
    p.leave(total.value.equals(0.0))
    return p.finish(FLAG)
