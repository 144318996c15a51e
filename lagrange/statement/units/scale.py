"""Scales of units as linear forms: the logarithms of their factors, some of which are unknown.

The unit of a product has the sum of the logarithms of its factors. Terms that are added must have equal scales.
These are linear equations in the unknown logarithms; each is solved for one unknown when it is stated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

SAME_FACTOR = 1e-9
"""Largest difference of logarithms of equal factors: factors of units have some twelve digits."""


@dataclass(frozen=True)
class Scale:
    """The logarithm of a factor: a constant plus multiples of unknowns, without zero multiples."""

    constant: float = 0.0
    unknowns: Mapping[Any, Fraction] = field(default_factory=dict)

    @classmethod
    def of_unknown(cls, unknown: Any) -> Scale:
        """Return the scale that equals an unknown."""
        return cls(0.0, {unknown: Fraction(1)})

    def plus(self, other: Scale, times: Fraction = Fraction(1)) -> Scale:
        """Return the sum of this scale and a multiple of another one."""
        unknowns = dict(self.unknowns)
        for unknown, coefficient in other.unknowns.items():
            unknowns[unknown] = unknowns.get(unknown, Fraction(0)) + times * coefficient
        left = {unknown: coefficient for unknown, coefficient in unknowns.items() if coefficient}
        return Scale(self.constant + float(times) * other.constant, left)

    def minus(self, other: Scale) -> Scale:
        """Return the difference of two scales."""
        return self.plus(other, Fraction(-1))


class ScaleEquations:
    """Equations between scales; `solved` has the unknowns that they determine."""

    def __init__(self) -> None:
        self.solved: dict[Any, Scale] = {}

    def reduced(self, scale: Scale) -> Scale:
        """Return a scale with its determined unknowns replaced."""
        while True:
            known = next((unknown for unknown in scale.unknowns if unknown in self.solved), None)
            if known is None:
                return scale
            coefficient = scale.unknowns[known]
            scale = scale.plus(self.solved[known].minus(Scale.of_unknown(known)), coefficient)

    def equate(self, one: Scale, other: Scale) -> float | None:
        """State that two scales are equal. Return None, or the logarithm of their ratio if they contradict."""
        difference = self.reduced(one.minus(other))
        if not difference.unknowns:
            return None if abs(difference.constant) <= SAME_FACTOR else difference.constant
        unknown, coefficient = next(iter(difference.unknowns.items()))
        rest = difference.plus(Scale.of_unknown(unknown), -coefficient)
        self.solved[unknown] = Scale().plus(rest, -1 / coefficient)
        return None
