"""Equations whose multipliers are multiples of those of a system: another sign, or constraints times a factor.

Such equations are right: a multiplier is what its equations make of it. But only the forces of the constraints may
differ. A wrong weight, say, is no other multiplier, though on a table both change the same equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from lagrange.evidence.laws import solve
from lagrange.evidence.operations import OutsideDomain
from lagrange.mechanics.equation_row import HELD, EquationRow
from lagrange.mechanics.motion_samples import MotionSample
from lagrange.mechanics.term_difference import LARGEST_FACTOR
from lagrange.mechanics.wrong_term import SINGULAR


def multiples_of_multipliers(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> list[list[Any]] | None:
    """Return how many times each multiplier of some equations is that of the system, at each sample.

    None where the equations do not hold with any multiples, the same in all of them.
    """
    try:
        found = [_multiples(rows, sample) for sample in samples]
    except OutsideDomain:
        return None
    return [one for one in found if one] if all(found) else None


def told_of(multiples: Sequence[Sequence[Any]]) -> str:
    """Return how the multipliers of right equations differ from those of the system, as a sentence."""
    every = [one for row in multiples for one in row]
    ratio = Fraction(str(every[0])).limit_denominator(LARGEST_FACTOR)
    if any(abs(one * ratio.denominator - ratio.numerator) > HELD * (1 + abs(ratio.numerator)) for one in every):
        return " Their multipliers are multiples of those of the system."
    if ratio == -1:
        return " The multipliers have the opposite sign."
    return f" Their multipliers are {ratio} times those of the system."


def _multiples(rows: Sequence[EquationRow], sample: MotionSample) -> list[Any]:
    """Return the multiples at a sample, in the order of the constraints; empty where there are none."""
    n = len(sample.mass)
    found: list[Any] = [None] * len(sample.multipliers)
    for row in rows:
        slopes, rest = row.numbers(sample)
        weights = solve(sample.mass, [slopes[:n]], SINGULAR)[0]
        exerted = [sum(w * x for w, x in zip(weights, line, strict=True)) for line in sample.gradient]
        terms = [slope * a for slope, a in zip(slopes, sample.accelerations, strict=False)]
        terms += [-part * multiplier for part, multiplier in zip(exerted, sample.multipliers, strict=True)]
        if abs(sum(terms) + rest) > HELD * (sum(map(abs, terms)) + abs(rest)):
            return []  # other terms than those of multipliers are wrong
        size = max(map(abs, exerted), default=0)
        for j, (part, slope) in enumerate(zip(exerted, slopes[n:], strict=True)):
            none = abs(part) <= HELD * size
            if none != (slope == 0):
                return []
            if none:
                continue
            multiple = -part / slope
            if found[j] is not None and abs(multiple - found[j]) > HELD * (abs(multiple) + abs(found[j])):
                return []
            found[j] = multiple
    return [one for one in found if one is not None]
