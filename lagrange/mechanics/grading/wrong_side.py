"""Wrong parts of an equation that are not terms: a denominator, the factor of a side, a momentum under d/dt."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import combinations
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.laws import solve_dense
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.grading.budget import check_budget
from lagrange.mechanics.grading.motion_samples import SINGULAR, MotionSample
from lagrange.mechanics.grading.one_change import Change
from lagrange.mechanics.grading.student_equations import (
    EquationRow,
    StudentEquation,
    along_motion,
    row_of,
    tape,
    values_at,
)
from lagrange.mechanics.grading.term_difference import MISSING, WRONG, Write, expanded, summands
from lagrange.statement.coordinate import constraint_of, t
from lagrange.statement.rotation import shorthands
from lagrange.statement.statement import Statement


def rate_symbols(statement: Statement) -> dict[Any, Any]:
    """Return {function of time: symbol} for the entries and rates of rotations, and for their derivatives."""
    rates = {f: sympy.Symbol(name, real=True) for name, f in shorthands(statement.rotations).items()}
    return rates | {f.diff(t): sympy.Symbol(f"{symbol}_dot", real=True) for f, symbol in rates.items()}


@lru_cache(maxsize=1)
def right_terms(derivation: Derivation) -> list[Any]:
    """Return the terms of the right equations, in plain symbols.

    They are the equations of motion, the constraints, the time derivatives of the constraints, and the masses. Rates of
    rotations stay symbols. Equations that are too large to write out are omitted.
    """
    statement = derivation.statement
    rates = rate_symbols(statement)
    zeros = [constraint.expression.xreplace(statement.plain) for constraint in statement.constraints]
    zeros += [along_motion(zero, statement) for zero in zeros]
    zeros += [along_motion(zero, statement) for zero in zeros[len(statement.constraints) :]]
    with suppress(StatementError):
        laws = [(law.lhs - law.rhs).xreplace(rates).xreplace(statement.plain) for law in derivation.equations]
        zeros = laws + zeros + [entry.xreplace(statement.plain) for entry in derivation.mass_matrix]
    parts = [summands(zero) for zero in zeros]
    sums = [_sharing(terms, p) for terms in parts if len(terms) <= MOST_SHARED for p in statement.parameters]
    terms = [term for zero in zeros for term in (*sympy.Add.make_args(zero), *expanded(zero))]
    return terms + [one for one in sums if one.has(sympy.Add)]


def _sharing(terms: Sequence[Any], parameter: Any) -> Any:
    """Return the sum of all terms that contain one parameter, such as a spring's stiffness, in factored form."""
    return sympy.factor_terms(sympy.Add(*(term for term in terms if term.has(parameter))))


@lru_cache(maxsize=1)
def right_denominators(derivation: Derivation) -> list[Any]:
    """Return the denominators of the accelerations, in plain symbols, except those too large to write out."""
    statement = derivation.statement
    if statement.constraints or statement.rotations:
        return []
    with suppress(StatementError):
        solved = [a for a in derivation.accelerations.values() if a.count_ops() <= LONGEST_SOLVED]
        below = [sympy.fraction(sympy.together(a.xreplace(statement.plain)))[1] for a in solved]
        return list(dict.fromkeys(below))
    return []


def told_change(change: Change, row: EquationRow, sample: MotionSample, write: Write) -> str:
    """Return a sentence on the only wrong term of an equation, with its sign as it was typed."""
    place, difference = change.place, change.difference
    start = place_of(_meant(change.row, sample), row)
    if place.below:
        return f"{start} the denominator {write(place.whole)} is wrong: it should be {write(change.corrected)}."
    side, other = (row.sides[k] for k in (place.side, 1 - place.side))
    right = " on the right side" if place.side and other != 0 else ""
    solved = place.side and other in list(row.slopes)[: len(sample.accelerations)]
    if solved and difference.there == side and (side.is_Add or (side.has(sympy.Add) and difference.ratio == -1)):
        factor = sympy.cancel(difference.there / difference.wanted)
        if factor.count_ops() <= LONGEST_FACTOR:
            return f"{start} the right side {_told_factor(factor, write)}"
    if difference.kind == WRONG and not place.path:
        (above, below), (other, right_below) = map(sympy.fraction, (difference.there, difference.wanted))
        if below.is_Add and above == other:
            return f"{start} the denominator {write(below)} is wrong: it should be {write(right_below)}."
    ending = difference.told(place.around, 1, write)
    name = next((constraint_of(x) for x in difference.wanted.free_symbols if constraint_of(x) is not None), None)
    if difference.kind == MISSING and name is not None:
        ending = ending.replace(" is missing.", f", the force of the constraint {name}, is missing.")
    return f"{start}{right} {ending}"


def _meant(row: EquationRow, sample: MotionSample) -> str:
    """Return the coordinate or coordinates whose equation of motion `row` is, or the name of its constraint, or ""."""
    names, unknowns, plain = row.statement.names, list(row.slopes), list(row.statement.plain.values())
    still = not any(row.slopes.values()) and not sample.first_order
    slopes = row.leading(sample)
    along = values_at(tape([sympy.diff(row.zero, q) for q in plain[::3]], row.statement), sample) if still else slopes
    for constraint, line in zip(row.statement.constraints, sample.gradient, strict=False):
        if not any(slopes[len(names) :]) and _parallel(along[: len(names)], line):
            return f"the constraint {constraint.name}"
    left = row.sides[0].as_coeff_Mul()[1]
    if left in unknowns[: len(names)] or (sample.first_order and left in plain[1::3]):
        return names[plain.index(left) // 3]
    if row.statement.rotations or not any(slopes[: len(names)]):
        return ""
    try:
        weights = solve_dense(sample.mass, slopes[: len(names)], SINGULAR)
    except OutsideDomain:
        return ""
    used = [name for name, w in zip(names, weights, strict=True) if abs(w) > SINGULAR * max(map(abs, weights))]
    return used[0] if len(used) == 1 else f"{listing(used)} together" if len(used) == 2 else ""


def place_of(name: str, row: EquationRow) -> str:
    """Return the beginning of a sentence about an equation, with its coordinate `name` unless the label contains it."""
    return f"In {row.label}" + ("" if not name or name in row.label else f", that of {name},")


def _parallel(left: Sequence[Any], right: Sequence[Any]) -> bool:
    """Return True if two vectors that are not zero have the same or opposite directions."""
    size = max(map(abs, left)) * max(map(abs, right))
    pairs = combinations(zip(left, right, strict=True), 2)
    return size > 0 and all(abs(a * d - b * c) <= SINGULAR * size for (a, b), (c, d) in pairs)


MOST_SHARED = 20
"""Largest number of terms of an equation whose partial sums are tried as right terms, too."""

LONGEST_SOLVED = 300
"""Largest number of operations in a solved acceleration and its right side for which denominators are compared."""

LONGEST_FACTOR = 12
"""Largest number of operations of a factor of a side that a message quotes."""


def _told_factor(factor: Any, write: Write) -> str:
    """Return the end of a sentence on a side of an equation that differs from the right one by a factor."""
    if factor == -1:
        return "has the wrong sign: it is -1 times what it should be."
    above, below = sympy.fraction(factor)
    if above.free_symbols:
        return f"has the wrong denominator: it should be divided by {write(factor)}."
    if factor.free_symbols and above == 1:
        return f"has the wrong denominator: it should be multiplied by {write(below)}."
    return f"has the wrong factor: it is {write(factor)} times what it should be."


def wrong_momentum(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if only an expression under a typed d/dt is wrong; else ""."""
    for typed in dict.fromkeys(row.differentiated):
        check_budget()
        for name, expected in _momenta(derivation, typed):
            change = along_motion(expected - typed, row.statement)
            for sign in (1, -1):  # on the left side, or on the right
                corrected = row_of(StudentEquation(row.label, row.zero + sign * change), row.statement)
                if corrected.holds(samples):
                    sentence = f"the term d/dt({write(typed)}) is wrong: it should be d/dt({write(expected)})."
                    return f"{place_of(name, row)} {sentence}"
    return ""


def _momenta(derivation: Derivation, typed: Any) -> Iterator[tuple[str, Any]]:
    """Yield (coordinate's name, constant times its momentum) for momenta that a `typed` expression may mean."""
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
