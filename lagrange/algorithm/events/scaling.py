"""The coefficients of an event function in units of the step, and what they tell of where it may vanish."""

from __future__ import annotations

import math
from typing import Any

from lagrange.algorithm.events.constants import LEAST_POWER, MODEST, ROUND_OFF, SMALLEST
from lagrange.algorithm.events.polynomial import PADDED, pad
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Real, Whole


class _Sums:
    """Adds up coefficients: their sizes, those of their derivative, and the value at the end of the step."""

    def __init__(self, p: Builder, first: Real) -> None:
        self.first = abs(first)
        self.others, self.rates = p.variable(0.0, "others"), p.variable(0.0, "rates")
        self.end = p.variable(first, "end")
        self.p = p

    def add(self, k: Whole, term: Real) -> None:
        """Add another coefficient."""
        size = abs(term).called("size")
        self.others.value = self.others.value + size
        self.rates.value = self.rates.value + self.p.real(k) * size
        self.end.value = self.end.value + term

    def results(self, noise: Real) -> tuple[Any, ...]:
        """Return the noise of the sum, the sizes of all but the first, those of the derivative, and the value at 1."""
        return noise + ROUND_OFF * self.total, self.others.value, self.rates.value, self.end.value

    @property
    def total(self) -> Real:
        """The sizes of all coefficients."""
        found: Real = self.first + self.others.value
        return found


RESULTS = REAL, REAL, REAL, REAL
"""Kinds of the results: the noise (infinite or NaN if an input is not finite), sums of sizes, the value at the end."""


def is_plain_step(h: Real, count: Whole) -> Flag:
    """Return true if powers of a step are far from overflow and underflow."""
    return (abs(h) > 1e-6) & (abs(h) < 1e6) & (count <= MODEST)


def is_plain(total: Real, noise: Real) -> Flag:
    """Return true if terms with a sum of sizes `total`, and their noise, are far from overflow and underflow."""
    return (total > 1e-100) & (total < 1e100) & (noise >= 0.0) & (noise < 1e100)


@shared
def scaled() -> Procedure:
    """Return the procedure that writes c[k] h**k over a power of two that prevents overflow, padded with zeros."""
    p = Builder("scaled", "Write coefficients in units of the step; return their noise, two sums and the end value.")
    coefficients, count = p.array("coefficients", read=True), p.given("count", WHOLE)
    h, noise, c = p.given("h", REAL), p.given("noise", REAL), p.array("c")
    c[0] = coefficients[0]
    sums, power = _Sums(p, coefficients[0]), p.variable(h, "power")
    with p.loop(1, count) as k:
        term = (coefficients[k] * power.value).called("term")
        c[k] = term
        sums.add(k, term)
        power.value = power.value * h
    pad(p, c, count, count)
    total = sums.total
    with p.when(~(is_plain_step(h, count) & is_plain(total, noise)), likely=False):
        p.leave(*p.call(scaled_far(), coefficients, count, h, noise, c))
    p.leave(*sums.results(noise))
    return p.finish(*RESULTS)


@shared
def split() -> Procedure:
    """Return the procedure that splits a number into a signed significand from 1 up to 2, and a power of two."""
    p = Builder("split", "Return a number as a size from 1 to 2, with its sign, and a power of two.", apart=True)
    x = p.given("x", REAL)
    tiny = abs(x) < SMALLEST
    y = p.choose(tiny, x * 2.0**54, x)
    zero = x.equals(0.0)
    fraction = p.operation("copysign", p.operation("mantissa", y), x)
    exponent = p.operation("exponent", y) - p.choose(tiny, p.whole(54), p.whole(0))
    p.leave(p.choose(zero, 0.0, fraction), p.choose(zero, p.whole(0), exponent))
    return p.finish(REAL, WHOLE)


@shared
def scaled_far() -> Procedure:
    """Return the procedure that does the same as `scaled` for numbers near overflow or underflow."""
    p = Builder("scaled_far", "Write coefficients in units of the step over a power of two.", apart=True)
    coefficients, count = p.array("coefficients", read=True), p.given("count", WHOLE)
    h, noise, c = p.given("h", REAL), p.given("noise", REAL), p.array("c")
    good = p.variable((abs(h) < math.inf) & (abs(noise) < math.inf), "good")
    with p.loop(0, count) as k:
        good.value = good.value & (abs(coefficients[k]) < math.inf)
    with p.when(~good.value):
        p.leave(math.inf, 0.0, 0.0, 0.0)
    exponents = p.reserve(PADDED, WHOLE, name="exponents")
    unit, unit_exponent = p.call(split(), h)
    blur, blur_exponent = p.call(split(), noise)
    top = p.variable(p.choose(blur.equals(0.0), p.whole(LEAST_POWER), blur_exponent), "top")
    power = p.variable(1.0, "power")
    with p.loop(0, count) as k:
        fraction, exponent = p.call(split(), coefficients[k])
        moved = exponent + k * unit_exponent
        c[k], exponents[k] = fraction * power.value, moved
        power.value = power.value * unit
        top.value = p.choose(c[k].equals(0.0), top.value, p.larger(top.value, moved))
    sums = _Sums(p, _lowered(p, c[0], exponents[0] - top.value))
    c[0] = sums.end.value
    with p.loop(1, count) as k:
        term = _lowered(p, c[k], exponents[k] - top.value)
        c[k] = term
        sums.add(k, term)
    p.leave(*sums.results(_lowered(p, blur, blur_exponent - top.value)))
    return p.finish(*RESULTS)


def _lowered(p: Builder, x: Real, exponent: Whole) -> Any:
    """Return a number times a power of two up to 1; a result far below the largest becomes zero."""
    far = exponent < -1000
    # The exponent of zero may be above that of the largest.
    bounded = p.smaller(p.larger(exponent, -1000), 0)
    return p.choose(far, 0.0, x * p.operation("two_to", bounded))
