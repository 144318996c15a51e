"""Binary logarithms and powers of two of a few digits, which is what the size of a step needs."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.series.constants import ZERO

LOG2 = (-1.6531240060861732, 1.9941811995403236, -0.33474901889029146)
EXP2 = (1.0, 0.703601177393781, 0.24203533019053836)
"""Polynomials for the binary logarithm on [1, 2], good to 0.007, and the power of two on [-1/2, 1/2], good to 0.002: a
step size needs no more than two digits, and the C library's functions would take a tenth of a small step."""

LEAST = 1023 + int(ZERO) << 52
"""The bits of 2**`ZERO`: a ratio below this is that, for its logarithm is taken."""


def logarithm(e: Emitter, x: str) -> str:
    """Return log2 of a number that is not negative, bounded below; infinity gives 1024, and NaN itself."""
    bits = e.value(f"bitcast double {x} to i64")
    bits = e.value(f"call i64 @llvm.umax.i64(i64 {bits}, i64 {LEAST})")
    biased = e.value(f"lshr i64 {bits}, 52")
    exponent = e.value(f"sitofp i64 {e.value(f'sub i64 {biased}, 1023')} to double")
    mantissa = e.value(f"or i64 {e.value(f'and i64 {bits}, {2**52 - 1}')}, {1023 << 52}")
    m = e.value(f"bitcast i64 {mantissa} to double")
    total = e.real("fadd", exponent, polynomial(e, m, LOG2))
    return e.choose(e.real("fcmp uno", x, x), x, total)


def polynomial(e: Emitter, x: str, coefficients: tuple[float, ...]) -> str:
    """Return the polynomial's value."""
    total = literal(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = e.fma(total, x, literal(coefficient))
    return total


def rounded(e: Emitter, x: str) -> str:
    """Return the integer nearest to a number of modest size."""
    big = literal(1.5 * 2.0**52)
    return e.real("fsub", e.real("fadd", x, big), big)


def power_of_two(e: Emitter, whole: str) -> str:
    """Return 2 to a whole number within the range of doubles."""
    biased = e.value(f"add i64 {e.value(f'fptosi double {whole} to i64')}, 1023")
    return e.value(f"bitcast i64 {e.value(f'shl i64 {biased}, 52')} to double")
