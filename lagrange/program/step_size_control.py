"""Numbers of step size control that a method may choose: safety factor, growth limits, exponent, PI control."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Control:
    """Step size control: h is multiplied by safety * norm**(-1/exponent) * previous norm**memory, within bounds.

    `exponent` is the power of h to which the error norm is proportional. The factor of h is at least `least` and at
    most `most`. With `damped`, the step has two error vectors, and the norm is that of DOP853: e5 / sqrt((e5 + 0.01 e3)
    dim), where e5 and e3 are their sums of squares. If the factor is between 1 and `hold`, h is unchanged, so that the
    matrix of the step can be reused.
    """

    exponent: int
    damped: bool = False
    memory: float = 0.0
    safety: float = 0.9
    least: float = 0.2
    most: float = 10.0
    hold: float = 1.0
