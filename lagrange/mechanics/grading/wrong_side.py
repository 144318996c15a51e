"""Wrong parts of an equation that are more than a term: a denominator, the factor of a side, a typed momentum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError
from lagrange.mechanics.grading.motion_samples import MotionSample
from lagrange.mechanics.grading.student_equations import EquationRow, StudentEquation, along_motion, row_of
from lagrange.mechanics.grading.term_difference import Write, summands
from lagrange.mechanics.plain_form import simplest
from lagrange.statement.coordinate import t


def wrong_part(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence on the only wrong part of an equation if that is more than a term, else ""."""
    return (
        _wrong_denominator(row, derivation, samples, write)
        or _wrong_factor(row, derivation, samples, write)
        or _wrong_momentum(row, derivation, samples, write)
    )


def place_of(name: str, row: EquationRow) -> str:
    """Return the begin of a sentence about an equation, with the name of its coordinate unless the label has it."""
    return f"In {row.label}" + ("" if name in row.label else f", that of {name},")


LONGEST_SOLVED = 300
"""Largest number of operations in a solved acceleration and its right side for which denominators are compared."""

LONGEST_QUOTIENT = 6
"""Largest number of operations in the quotient of two numerators for which it counts as a common factor."""


def _wrong_denominator(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if only the denominator of a solved equation's right side is wrong, else "".

    At least one term of the typed denominator has to be right, or the whole numerator. Otherwise the numerator may be
    the wrong part.
    """
    above, below = sympy.fraction(sympy.factor_terms(row.right))
    typed = next((factor for factor in sympy.Mul.make_args(below) if factor.is_Add), below)
    for name, acceleration, solved in _solutions(row, derivation) if typed.free_symbols else ():
        numerator, denominator = sympy.fraction(sympy.together(solved))
        quotient = simplest(above * typed / below / numerator)
        if quotient.count_ops() > LONGEST_QUOTIENT:
            continue
        expected = sympy.Add(*summands(quotient * denominator))
        same = quotient in (1, -1) and (typed.is_Add or above.is_Add)
        if sympy.expand(expected + typed) == 0:
            continue  # the right side has the wrong sign
        if not same and not set(summands(typed)) & set(sympy.Add.make_args(expected)):
            continue
        if _holds(row, acceleration, above * typed / below / expected, samples):
            return f"{place_of(name, row)} the denominator {write(typed)} is wrong: it should be {write(expected)}."
    return ""


def _wrong_factor(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if the right side of a solved equation is a constant or a denominator times the right one.

    It is "" otherwise. A side with one term is left to the search for a wrong term.
    """
    typed = summands(row.right)
    state = {*row.statement.plain.values(), t}
    for name, acceleration, solved in _solutions(row, derivation) if len(typed) > 1 else ():
        denominator = sympy.fraction(sympy.together(solved))[1]
        for term in summands(solved):
            factor = sympy.cancel(typed[0] / term)
            if factor == 0 or (factor.free_symbols & state and not (factor / denominator).is_number):
                continue
            if _holds(row, acceleration, row.right / factor, samples):
                return f"{place_of(name, row)} the right side {_told_factor(factor, write)}"
    return ""


def _told_factor(factor: Any, write: Write) -> str:
    """Return the end of a sentence on a side that is a factor times the right one."""
    if factor == -1:
        return "has the wrong sign: it is -1 times what it should be."
    above, below = sympy.fraction(factor)
    if above.free_symbols:
        return f"has the wrong denominator: it should be divided by {write(factor)}."
    if factor.free_symbols and above == 1:
        return f"has the wrong denominator: it should be multiplied by {write(below)}."
    return f"has the wrong factor: it is {write(factor)} times what it should be."


def _holds(row: EquationRow, acceleration: Any, right: Any, samples: Sequence[MotionSample]) -> bool:
    """Return True if the equation acceleration = right holds at all samples."""
    return row_of(StudentEquation(row.label, acceleration - right, right), row.statement).holds(samples)


def _wrong_momentum(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if only an expression under a typed d/dt is wrong, else ""."""
    for typed in row.differentiated:
        for name, expected in _momenta(derivation, typed):
            change = along_motion(expected - typed, row.statement)
            for sign in (1, -1):  # on the left side, or on the right
                corrected = row_of(StudentEquation(row.label, row.zero + sign * change), row.statement)
                if corrected.holds(samples):
                    told = f"the term d/dt({write(typed)}) is wrong: it should be d/dt({write(expected)})."
                    return f"{place_of(name, row)} {told}"
    return ""


def _momenta(derivation: Derivation, typed: Any) -> Iterator[tuple[str, Any]]:
    """Yield (name of a coordinate, its momentum times a constant) that may be meant by a typed expression."""
    statement = derivation.statement
    try:
        momenta = [p.xreplace(statement.plain) for p in derivation.momenta.values()]
    except StatementError:
        return
    ones = dict.fromkeys((*statement.plain.values(), t), sympy.S.One)
    for name, momentum in zip(statement.names, momenta, strict=True):
        if momentum == 0 or momentum.count_ops() > LONGEST_SOLVED:
            continue
        factor = sympy.cancel(typed / momentum).xreplace(ones)
        sign = sympy.Integer(-1 if factor.could_extract_minus_sign() else 1)
        for constant in dict.fromkeys((sign, factor)):
            if constant.is_finite is not False and constant != 0:
                yield name, sympy.Mul(constant, momentum) if momentum.is_Mul else constant * momentum


def _solutions(row: EquationRow, derivation: Derivation) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, acceleration and right solution of an equation with an acceleration alone on its left side.

    The solution is free of other accelerations, or that of one equation of motion. One that is too long is left out.
    """
    names, unknowns = row.statement.names, list(row.slopes)
    left = row.zero + row.right
    if left not in unknowns[: len(names)] or row.right.has(left):
        return
    place = unknowns.index(left)
    several = row.right.has(*unknowns)
    try:
        law = derivation.equations[place]
        zero = (law.lhs - law.rhs).xreplace(row.statement.plain)
        solved = left - zero / sympy.diff(zero, left) if several else list(derivation.accelerations.values())[place]
    except StatementError:
        return
    solved = sympy.expand(solved) if several else solved.xreplace(row.statement.plain)
    if solved.count_ops() + row.right.count_ops() <= LONGEST_SOLVED:
        yield names[place], left, solved
