"""A solved acceleration whose denominator is wrong, while its numerator is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError
from lagrange.mechanics.equation_row import EquationRow
from lagrange.mechanics.motion_samples import MotionSample
from lagrange.mechanics.simplification import simplest
from lagrange.mechanics.term_difference import Write, summands

LONGEST = 300
"""Operations of a solved acceleration up to which its denominator is compared."""

LONGEST_QUOTIENT = 6
"""Operations of the quotient of two numerators that are the same but for a factor."""


def wrong_denominator(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if a solved equation is right with another denominator on its right side, "" otherwise.

    At least one term of the denominator has to be right: otherwise the numerator may be meant as well.
    """
    names, unknowns = row.statement.names, list(row.slopes)
    place = next((k for k, slope in enumerate(row.slopes.values()) if slope != 0), len(names))
    if place >= len(names) or row.zero + row.right != unknowns[place]:
        return ""
    above, below = sympy.fraction(row.right)
    typed = next((factor for factor in sympy.Mul.make_args(below) if factor.is_Add), below)
    if not typed.free_symbols:
        return ""
    try:
        solved = list(derivation.accelerations.values())[place].xreplace(row.statement.plain)
    except StatementError:
        return ""
    if solved.count_ops() + row.right.count_ops() > LONGEST:
        return ""
    numerator, denominator = sympy.fraction(sympy.together(solved))
    quotient = simplest(above * typed / below / numerator)
    if quotient.count_ops() > LONGEST_QUOTIENT:
        return ""
    wanted = sympy.Add(*summands(quotient * denominator))
    if not set(summands(typed)) & set(sympy.Add.make_args(wanted)):
        return ""
    right = above * typed / below / wanted
    if not replace(row, zero=unknowns[place] - right, rest=-right, right=right).holds(samples):
        return ""
    of = "" if names[place] in row.label else f", that of {names[place]},"
    return f"In {row.label}{of} the denominator {write(typed)} is wrong: it should be {write(wanted)}."
