"""Binary logarithms and powers of two to a few digits, which suffice for the size of a step."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.taylor.constants import LARGEST_STEP_EXPONENT, ZERO
from lagrange.procedure.values import Real

LOG2 = (-1.6531240060861732, 1.9941811995403236, -0.33474901889029146)
EXP2 = (1.0, 0.703601177393781, 0.24203533019053836)
"""Polynomials for the binary logarithm on [1, 2], good to 0.007, and the power of two on [-1/2, 1/2], good to 0.002. A
step size needs only two digits, and the C library's functions would take a tenth of a small step."""


@shared
def logarithm() -> Procedure:
    """Return the binary logarithm of a nonnegative number, at least `ZERO`; that of infinity is 1024."""
    p = Builder("logarithm", "Return the binary logarithm, to two digits; NaN for NaN.")
    x: Real = p.given("x", REAL)
    bounded = p.magnitude(x, 2.0**ZERO)
    exponent = p.real(p.operation("exponent", bounded))
    found = exponent + _polynomial(p, p.operation("mantissa", bounded), LOG2)
    p.leave(p.choose(x.equals(x), found, x))
    return p.finish(REAL)


@shared
def power() -> Procedure:
    """Return a power of two, and its exponent rounded to a whole number, both at most 2**`LARGEST_STEP_EXPONENT`."""
    p = Builder("power", "Return 2**x to two digits, and the whole number next to x, bounded above.")
    x: Real = p.given("x", REAL)
    whole = p.operation("round", x)
    fraction = _polynomial(p, x - whole, EXP2)
    bounded = p.smaller(whole, LARGEST_STEP_EXPONENT)
    p.leave(fraction * p.operation("two_to", p.whole(bounded)), bounded)
    return p.finish(REAL, REAL)


def _polynomial(p: Builder, x: Real, coefficients: Sequence[float]) -> Real:
    """Return a polynomial's value, by Horner's rule."""
    total = p.real(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = p.fma(total, x, coefficient)
    return total
