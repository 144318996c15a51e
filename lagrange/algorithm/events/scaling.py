"""Coefficients of an event function in units of the step, scaled against overflow, and sums of their magnitudes."""

from __future__ import annotations

import math

from lagrange.algorithm.events.constants import LEAST_POWER, MODEST, POLYNOMIAL_NOISE, SMALLEST
from lagrange.algorithm.events.polynomial import PADDED, pad
from lagrange.procedure.front.plain import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, exponent, mantissa, two_to, unlikely, wholes

Sums = tuple[float, float, float, float]
"""Noise of a sum of terms (infinite or NaN if an input is not finite); sum of magnitudes of all terms but the first;
sum of magnitudes of the derivative's terms; value at the end of the step.
"""


@inline
def is_plain_step(h: float, count: int) -> bool:
    """Return True if the powers of a step length h below the power `count` are far from over- and underflow."""
    return abs(h) > 1e-6 and abs(h) < 1e6 and count <= MODEST


@inline
def is_plain(total: float, noise: float) -> bool:
    """Return True if terms with a sum of magnitudes `total`, and their noise, are far from overflow and underflow."""
    return total > 1e-100 and total < 1e100 and noise >= 0.0 and noise < 1e100


@inline
def write_terms(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k of a polynomial on a step to c, and return their `Sums`.

    These are the noise of the polynomial's values, the sum of magnitudes of all terms but the first, that of
    the derivative's terms, and the value at the end of the step.
    """
    first = coefficients[0]
    c[0] = first
    others, rates, end, power = 0.0, 0.0, first, h
    for k in range(1, count):
        term = coefficients[k] * power
        c[k] = term
        size = abs(term)
        others += size
        rates += float(k) * size
        end += term
        power *= h
    return noise + POLYNOMIAL_NOISE * (abs(first) + others), others, rates, end


@procedure
def scaled(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k of a polynomial to c, padded with zeros. Return their `Sums`.

    These are the noise of the polynomial's values, the sum of magnitudes of all terms but the first, that of
    the derivative's terms, and the value at the end of the step. If the terms may overflow or underflow, they
    and their noise are divided by a power of two.
    """
    total_noise, others, rates, end = write_terms(coefficients, count, h, noise, c)
    pad(c, count, count)
    if unlikely(not (is_plain_step(h, count) and is_plain(abs(c[0]) + others, noise))):
        return scaled_far(coefficients, count, h, noise, c)
    return total_noise, others, rates, end


@procedure(apart=True)
def split(x: float) -> tuple[float, int]:
    """Return a number as a signed significand of magnitude 1 to 2, and an exponent of two; 0 and 0 for zero."""
    is_tiny = abs(x) < SMALLEST
    y = x * 2.0**54 if is_tiny else x
    significand = math.copysign(mantissa(y), x)
    power = exponent(y) - (54 if is_tiny else 0)
    return 0.0 if x == 0.0 else significand, 0 if x == 0.0 else power


@procedure(apart=True)
def scaled_far(coefficients: In, count: int, h: float, noise: float, c: Out) -> Sums:
    """Write the terms coefficients[k] * h**k, near overflow or underflow, to c, divided by a power of two.

    Return their `Sums`: the noise of the polynomial's values, the sum of magnitudes of all terms but the first,
    that of the derivative's terms, and the value at the end of the step. All of them are divided by the same
    power.
    """
    is_finite = abs(h) < math.inf and abs(noise) < math.inf
    for k in range(count):
        size = abs(coefficients[k])
        is_finite = is_finite and size < math.inf
    if not is_finite:
        return math.inf, 0.0, 0.0, 0.0
    exponents = wholes(PADDED)
    unit, unit_exponent = split(h)
    noise_part, noise_exponent = split(noise)
    top = LEAST_POWER if noise_part == 0.0 else noise_exponent
    power = 1.0
    for k in range(count):
        fraction, exponent = split(coefficients[k])
        term, moved = fraction * power, exponent + k * unit_exponent
        c[k], exponents[k] = term, moved
        power *= unit
        top = top if term == 0.0 else max(top, moved)
    for k in range(count):
        c[k] = lowered(c[k], exponents[k] - top)
    return write_terms(c, count, 1.0, lowered(noise_part, noise_exponent - top), c)


@inline
def lowered(x: float, power: int) -> float:
    """Return x * 2**min(power, 0), or 0 for a power below -1000."""
    # The exponent of zero may exceed that of the largest term.
    return 0.0 if power < -1000 else x * two_to(min(max(power, -1000), 0))
