"""The wrong term of an equation of motion, named in a sentence, or a common slip (a sign, degrees) that explains it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.expansion import small
from lagrange.mechanics.grading.budget import check_budget
from lagrange.mechanics.grading.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.grading.one_change import evaluated, one_change
from lagrange.mechanics.grading.student_equations import EquationRow, StudentEquation, row_of
from lagrange.mechanics.grading.term_difference import (
    EXTRA,
    MISSING,
    SCALED,
    WRONG,
    Difference,
    Numbers,
    Write,
    same,
    summands,
)
from lagrange.mechanics.grading.wrong_side import (
    place_of,
    rate_symbols,
    right_denominators,
    right_terms,
    told_change,
    wrong_momentum,
)
from lagrange.mechanics.plain_form import simplest
from lagrange.statement.statement import Statement

LONGEST_SLIP = 400
"""Largest number of operations in all equations together for which slips are tried; each slip costs evaluations."""

MOST_SYMBOLS = 12
"""Largest number of coordinates and parameters for which slips are tried."""

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

Slip = tuple[str, Mapping[Any, Any]]
"""A sentence, and the substitution {symbol or function: replacement} that undoes the slip."""


def slip_of(rows: Sequence[EquationRow], samples: Sequence[MotionSample], *, alone: bool) -> str:
    """Return a sentence on the single slip whose correction makes all equations right, or "".

    `alone` is true if exactly one term is wrong. The message then names that term, so factors and directions of
    coordinates are not tried. Raises BudgetSpent if the time is up.
    """
    statement, zeros = rows[0].statement, [row.zero for row in rows]
    if sum(int(zero.count_ops()) for zero in zeros) > LONGEST_SLIP:
        return ""
    if len(statement.names) + len(statement.parameters) > MOST_SYMBOLS:
        return ""
    for sentence, table in _slips(zeros, statement, alone=alone):
        check_budget()
        if _all_hold([zero.xreplace(table) for zero in zeros], statement, samples):
            return sentence
    return _small_angles(zeros, statement)


def _all_hold(zeros: Sequence[Any], statement: Statement, samples: Sequence[MotionSample]) -> bool:
    try:
        return all(row_of(StudentEquation("", zero), statement).holds(samples) for zero in zeros)
    except StatementError:
        return False


def _small_angles(zeros: Sequence[Any], statement: Statement) -> str:
    """Return a sentence if the equations are right after linearization about zero coordinates, else "".

    `zeros` are the equations as expressions that are zero.
    """
    moving = set(statement.plain.values())
    if any(part.has(*moving) for zero in zeros for part in zero.atoms(sympy.Function, sympy.Pow)):
        return ""
    pairs = [(x, y) for x in moving for y in moving if x.name <= y.name]
    if any(sympy.diff(zero, x, y) != 0 for zero in zeros for x, y in pairs):
        return ""
    try:
        linear = small(statement, None, 2)
        right = _all_hold(zeros, linear, motion_samples(linear, 2))
    except StatementError:
        return ""
    return "These are the equations for small motions: the exact ones are asked for." if right else ""


def _has_direction(parameter: Any, statement: Statement) -> bool:
    """Return True if a parameter has a direction, such as g or a force, unlike a mass, length or stiffness.

    Such a parameter is a factor of forces, or of terms of the potential with either sign. The kinetic energy does not
    contain it. Coefficients of drag and friction have no direction. A magnetic field, whose forces do no work, has one.
    """
    if statement.kinetic.has(parameter):
        return False
    slopes = [sympy.diff(term, parameter) for term in (statement.potential, *statement.forces)]
    if any(slope.has(parameter) for slope in slopes):
        return False
    if any(slope != 0 for slope in slopes[1:]):
        power = sum(slope * v for slope, v in zip(slopes[1:], statement.velocities, strict=True))
        return sympy.expand(power) == 0 or not any(slope.has(*statement.velocities) for slope in slopes[1:])
    slope = slopes[0].xreplace(statement.plain)
    below = sympy.fraction(sympy.together(slope))[1]
    return not (below.has(*statement.plain.values()) or slope.is_nonnegative or slope.is_nonpositive)


def _slips(zeros: Sequence[Any], statement: Statement, *, alone: bool) -> Iterator[Slip]:
    """Yield slips that the equations may contain, the most common first."""
    used = {symbol for zero in zeros for symbol in zero.free_symbols}
    parameters = [p for p in statement.parameters if p in used]
    plain = list(statement.plain.values())
    coordinates = [tuple(plain[i : i + 3]) for i in range(0, len(plain), 3)]
    for p in (p for p in parameters if _has_direction(p, statement)):
        yield f"All is right with -{p} in place of {p}: check the direction in which {p} is counted.", {p: -p}
    for q, v, a in coordinates if not alone else ():
        turned = {q: -q, v: -v, a: -a}
        yield f"All is right for -{q} in place of {q}: check the direction in which {q} is counted.", turned
    circular = sorted({f for zero in zeros for f in zero.atoms(*_CIRCULAR)}, key=str)
    if circular:
        swapped = {f: sympy.cos(f.args[0]) if f.func is sympy.sin else sympy.sin(f.args[0]) for f in circular}
        yield "All is right with sine and cosine exchanged.", swapped
        degrees = {f: f.func(f.args[0] * 180 / sympy.pi) for f in circular}
        yield "All is right with angles in radians: they are in degrees here.", degrees
        for q, v, a in coordinates:
            if any(f.has(q) for f in circular):
                quarter = {q: sympy.pi / 2 - q, v: -v, a: -a}
                yield f"All is right if {q} is counted from the other axis, as pi/2 - {q}.", quarter
                yield f"All is right if {q} is counted from the opposite direction, as {q} + pi.", {q: q + sympy.pi}
    for factor, word in ((2, "2*"), (sympy.Rational(1, 2), "1/2*")):
        for p in parameters if not alone else ():
            yield f"All is right with {word}{p} in place of {p}.", {p: factor * p}
        for q, v, a in coordinates:
            if alone and not any(f.has(q) for f in circular):
                continue  # a factor of one linear term is told already
            yield f"All is right for {word}{q} in place of {q}.", {q: factor * q, v: factor * v, a: factor * a}


LONGEST_FORMULA = 3_000
"""Largest number of operations in a solved acceleration that is compared: expanding a longer one takes seconds."""

LONGEST_RATIO = 60
"""Largest number of operations of two terms whose ratio is simplified."""

MOST_MATCHED = 60
"""Largest number of terms of an equation that are matched one by one with those of a right equation."""


@dataclass(frozen=True)
class WrongTerm:
    """A sentence on the error of an equation. `alone` is true if exactly one term of the equation is wrong.

    `cost` is the cost of the change of this term, infinite if several are wrong.
    """

    sentence: str
    alone: bool = False
    cost: float = math.inf


def wrong_term(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> WrongTerm:
    """Return the wrong term of an equation that does not hold. `write` turns an expression into text.

    Raises BudgetSpent if the time is up.
    """
    check_budget()
    label = f"{row.label[0].upper()}{row.label[1:]}"
    constraints = row.statement.constraints
    part = wrong_momentum(row, derivation, samples, write)
    if part:
        return WrongTerm(part, alone=True, cost=0.0)
    change = one_change(row, samples, right_terms(derivation), right_denominators(derivation))
    if change is not None:
        return WrongTerm(told_change(change, row, samples[0], write), alone=True, cost=change.cost)
    still = not any(row.slopes.values()) and not any(sample.first_order for sample in samples)
    if still and not constraints:
        name = row.statement.names[0]
        return WrongTerm(
            f"{label} does not hold, and contains no acceleration such as {name}'' or {name}_ddot: it is not an "
            "equation of motion."
        )
    if still:
        listed = [
            f"{constraint.name}, {write(constraint.expression.xreplace(row.statement.plain))} = 0"
            for constraint in constraints
        ]
        which = "the constraint is" if len(listed) == 1 else "the constraints are"
        return WrongTerm(f"{label} does not hold and is not a constraint: {which} {listing(listed)}.")
    first = _first_of_several(row, derivation, samples, write)
    return WrongTerm(first or f"{label} does not hold, and no term of it is that of an equation of motion.")


def _first_of_several(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence on the first of several wrong terms, "" if the equation resembles no right one.

    The terms are compared with those of each right equation, multiplied by a factor for which at least one term agrees.
    """
    typed = [(k, term) for k in (0, 1) for term in summands(row.sides[k]) if term != 0]
    best: tuple[int, float] = (0, 0.0)
    sentence = ""
    for name, zero in _right_rows(row, derivation):
        right = summands(zero)
        if len(typed) + len(right) > MOST_MATCHED:
            continue
        try:
            values = evaluated([term if k == 0 else -term for k, term in typed], row.statement, samples)
            expected = evaluated(right, row.statement, samples)
        except OutsideDomain:
            continue
        anchors = range(1 if row.sides[0] in row.slopes else len(typed))  # the left side of a solved equation is right
        for i, j in product(anchors, range(len(right))):
            factor = typed[i][1] / right[j] * (-1) ** typed[i][0]
            if factor.has(*row.slopes) or not all(expected[j]):
                continue
            scale = [a / b for a, b in zip(values[i], expected[j], strict=True)]
            left, lacking = _unmatched(values, [[c * x for c, x in zip(scale, line, strict=True)] for line in expected])
            rank = (len(typed) - len(left), -float(factor.count_ops()))
            if rank > best:
                best = rank
                sentence = _told(name, row, [typed[k] for k in left], [factor * right[k] for k in lacking], write)
    return sentence


def _right_rows(row: EquationRow, derivation: Derivation) -> list[tuple[str, Any]]:
    """Return (coordinate name, left - right side) of the equations of motion, solved for accelerations if `row` is."""
    statement, rates = derivation.statement, rate_symbols(derivation.statement)
    rows: list[tuple[str, Any]] = []
    with suppress(StatementError):
        accelerations = list(statement.plain.values())[2::3]
        if row.sides[0] in accelerations and not row.right.has(*accelerations) and not statement.constraints:
            solved = zip(statement.names, accelerations, derivation.accelerations.values(), strict=True)
            rows += [(name, left - right) for name, left, right in solved if right.count_ops() <= LONGEST_FORMULA]
        else:
            zeros = [law.lhs - law.rhs for law in derivation.equations]
            rows += zip(statement.names, zeros, strict=False)
    return [(name, zero.xreplace(rates).xreplace(statement.plain)) for name, zero in rows]


def _unmatched(left: Sequence[Numbers], right: Sequence[Numbers]) -> tuple[list[int], list[int]]:
    """Return the indices of the entries of `left` that are not in `right`, and of those of `right` not in `left`."""
    kept, open_right = [], list(range(len(right)))
    for i, values in enumerate(left):
        match = next((j for j in open_right if same(values, right[j])), None)
        if match is None:
            kept.append(i)
        else:
            open_right.remove(match)
    return kept, open_right


def _told(name: str, row: EquationRow, typed: Sequence[tuple[int, Any]], lacking: Sequence[Any], write: Write) -> str:
    """Return a sentence on the first wrong term, with the right term in `lacking` that resembles it most.

    `typed` are the wrong terms as (side, term); `name` is the coordinate of the equation.
    """
    if not typed:
        return f"{place_of(name, row)} {Difference(MISSING, sympy.S.Zero, lacking[0]).told(sympy.S.One, 1, write)}"
    side, term = typed[0]
    words = " on the right side" if side and row.sides[0] != 0 else ""
    if not lacking:
        return f"{place_of(name, row)}{words} {Difference(EXTRA, term, sympy.S.Zero).told(sympy.S.One, 1, write)}"
    factors = set(term.as_powers_dict())
    nearest = max(lacking, key=lambda other: len(factors & set(other.as_powers_dict())))
    wanted = simplest(nearest if side == 0 else -nearest)
    ratio = sympy.cancel(term / wanted) if term.count_ops() + wanted.count_ops() <= LONGEST_RATIO else sympy.nan
    kind = SCALED if ratio.is_Rational else WRONG
    difference = Difference(kind, term, wanted, Fraction(ratio.p, ratio.q) if kind == SCALED else Fraction(1))
    return f"{place_of(name, row)}{words} {difference.told(sympy.S.One, 1, write)}"
