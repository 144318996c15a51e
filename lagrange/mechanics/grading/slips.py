"""Slips that explain all faults of an answer at once: a sign, degrees, small angles, or a wrong definition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import sympy

from lagrange.errors import StatementError
from lagrange.mechanics.expansion import small
from lagrange.mechanics.grading.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.grading.student_equations import (
    DIGITS,
    EquationRow,
    StudentEquation,
    abbreviations,
    row_of,
    unknowns_of,
)
from lagrange.mechanics.grading.term_difference import BudgetSpent, Write, check_budget, check_size, is_spent
from lagrange.mechanics.plain_form import time_derivative
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.statement.typed.names import RATES

# Largest number of operations in all equations together for which slips are tried; each slip costs evaluations
LONGEST_SLIP = 400
MOST_SYMBOLS = 12  # Largest number of coordinates and parameters for which slips are tried
LONGEST_DEFINITION = 40  # Largest number of operations of a definition whose corrections are tried
CLOSE = 1e-20  # Residual of an equation below which a corrected definition is examined at all samples
FACTORS = {sympy.Integer(2): "2*", sympy.S.Half: "1/2*"}  # Wrong factors, and their text in a message

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

# A sentence, and the substitution {symbol or function: replacement} that undoes the slip
Slip = tuple[str, Mapping[Any, Any]]


def slip_of(rows: Sequence[EquationRow], choices: Sequence[Sequence[MotionSample]], *, common: bool) -> str:
    """Return a sentence on the single slip whose correction makes all equations right, or "".

    They are right if they hold at all samples of one of the `choices`. With `common` the slips are those of `_slips`,
    such as degrees, else those of `_factors`. The result is also "" if the equations are too long, or the time is up.
    """
    statement, zeros = rows[0].statement, [row.zero for row in rows]
    if sum(int(zero.count_ops()) for zero in zeros) > LONGEST_SLIP:
        return ""
    if len(statement.names) + len(statement.parameters) > MOST_SYMBOLS:
        return ""
    parameters = [p for p in statement.parameters if any(zero.has(p) for zero in zeros)]
    with suppress(BudgetSpent):
        check_size(*zeros)
        slips = _slips(zeros, parameters, statement) if common else _factors(parameters, statement)
        for sentence, table in slips:
            check_budget()
            if _all_hold([zero.xreplace(table) for zero in zeros], statement, *choices):
                return sentence
        return _small_angles(zeros, statement) if common else ""
    return ""


def _all_hold(zeros: Sequence[Any], statement: Statement, *choices: Sequence[MotionSample]) -> bool:
    """Return True if equations, as expressions that are zero, hold at all samples of one of the `choices`."""
    with suppress(StatementError):
        rows = [row_of(StudentEquation(zero), statement) for zero in zeros]
        return any(all(row.holds(samples) for row in rows) for samples in choices)
    return False


def _small_angles(zeros: Sequence[Any], statement: Statement) -> str:
    """Return a sentence if the equations are right after linearization about zero coordinates, else "".

    `zeros` are the equations as expressions that are zero. A system with rotations gives "", because the entries of a
    quaternion cannot all be zero.
    """
    moving = set(statement.plain.values())
    if statement.rotations or any(
        part.has(*moving) for zero in zeros for part in zero.atoms(sympy.Function, sympy.Pow)
    ):
        return ""
    pairs = [(x, y) for x in moving for y in moving if x.name <= y.name]
    if any(sympy.diff(zero, x, y) != 0 for zero in zeros for x, y in pairs):
        return ""
    with suppress(StatementError):
        linear = small(statement, None, 2)
        if _all_hold(zeros, linear, motion_samples(linear, 2)):
            return "These are the equations for small motions: the exact ones are asked for."
    return ""


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


def _slips(zeros: Sequence[Any], parameters: Sequence[Any], statement: Statement) -> Iterator[Slip]:
    """Yield common slips that the equations may contain, the most common first.

    `zeros` are the equations as expressions that are zero, and `parameters` those that they contain.
    """
    for p in parameters:
        if _has_direction(p, statement):
            yield f"All is right with -{p} in place of {p}: check the direction in which {p} is counted.", {p: -p}
    circular = sorted({f for zero in zeros for f in zero.atoms(*_CIRCULAR)}, key=str)
    if not circular:
        return
    swapped = {f: sympy.cos(f.args[0]) if f.func is sympy.sin else sympy.sin(f.args[0]) for f in circular}
    yield "All is right with sine and cosine exchanged.", swapped
    degrees = {f: f.func(f.args[0] * 180 / sympy.pi) for f in circular}
    yield "All is right with angles in radians: they are in degrees here.", degrees
    angles = [rates for rates in _coordinates(statement) if any(f.has(rates[0]) for f in circular)]
    for q, v, a in angles:
        quarter = {q: sympy.pi / 2 - q, v: -v, a: -a}
        yield f"All is right if {q} is counted from the other axis, as pi/2 - {q}.", quarter
        yield f"All is right if {q} is counted from the opposite direction, as {q} + pi.", {q: q + sympy.pi}
    yield from _multiples(angles)


def _factors(parameters: Sequence[Any], statement: Statement) -> Iterator[Slip]:
    """Yield slips that one wrong term may explain, too: opposite signs and directions, and factors 2 and 1/2.

    `parameters` are those that the equations contain.
    """
    for p in parameters:
        if not statement.kinetic.has(p):
            yield f"All is right with -{p} in place of {p}: the terms with {p} have the wrong sign.", {p: -p}
    for q, v, a in _coordinates(statement):
        turned = {q: -q, v: -v, a: -a}
        yield f"All is right for -{q} in place of {q}: check the direction in which {q} is counted.", turned
    for factor, text in FACTORS.items():
        for p in parameters:
            yield f"All is right with {text}{p} in place of {p}.", {p: factor * p}
    yield from _multiples(_coordinates(statement))


def _multiples(coordinates: Sequence[tuple[Any, ...]]) -> Iterator[Slip]:
    """Yield the slips of a factor 2 or 1/2 of each coordinate, listed as (coordinate, velocity, acceleration)."""
    for factor, text in FACTORS.items():
        for q, v, a in coordinates:
            yield f"All is right for {text}{q} in place of {q}.", {q: factor * q, v: factor * v, a: factor * a}


def _coordinates(statement: Statement) -> list[tuple[Any, ...]]:
    """Return (coordinate, velocity, acceleration) of each coordinate, in plain symbols."""
    plain = iter(statement.plain.values())
    return [*zip(plain, plain, plain, strict=True)]


def wrong_definition(rows: Sequence[EquationRow], samples: Sequence[MotionSample], write: Write, *, alone: bool) -> str:
    """Return a sentence on the definition whose correction makes all equations right, or "".

    Corrections are those of `_variants`, the shortest ones first. A constant is replaced by constants only. `alone` is
    true if one wrong term explains the fault, too. Then the square and the root of the definition are not tried.
    """
    statement, numbers = rows[0].statement, _numbers_at(samples[0], rows[0].statement)
    coordinates = list(statement.plain.values())
    meanings = {symbol: value for row in rows for symbol, value in row.equation.meanings.items()}
    for symbol, value in meanings.items():
        rates = [rate for rate in (sympy.Symbol(symbol.name + end, real=True) for end in RATES[1:]) if rate in meanings]
        used = any(side.has(symbol, *rates) for row in rows for side in row.sides)
        if not used or value.count_ops() > LONGEST_DEFINITION or symbol.name.endswith(RATES[1:]):
            continue
        known = {other: x for other, x in meanings.items() if other not in (symbol, *rates)}
        zeros = [row.equation.zero.xreplace(known).xreplace(abbreviations(statement)) for row in rows]
        residuals = [zero.xreplace(numbers) for zero in zeros]
        symbols = [*statement.parameters, *(coordinates if value.has(*coordinates) else ())]
        powers = {value**2, sympy.sqrt(value)} if alone else set()
        variants = {variant for variant in _variants(value, symbols) if variant.free_symbols} - {value} - powers
        for variant in sorted(variants, key=lambda x: (x.count_ops(), str(x))):
            if is_spent():
                return ""
            table = {symbol: variant}
            for lower, rate in pairwise((symbol, *rates)):
                table[rate] = time_derivative(table[lower], statement.plain)
            at_sample = {changed: x.xreplace(numbers) for changed, x in table.items()}
            if any(abs(sympy.N(residual.xreplace(at_sample))) > CLOSE for residual in residuals):
                continue
            if _all_hold([zero.xreplace(table) for zero in zeros], statement, samples):
                what = "equation" if value.has(*unknowns_of(statement)) else "definition"
                return f"The {what} {symbol} = {write(value)} is wrong: it should be {write(variant)}."
    return ""


def _numbers_at(sample: MotionSample, statement: Statement) -> dict[Any, Any]:
    """Return {symbol: number} at a sample, for the plain symbols, multipliers and parameters of a statement, and t."""
    point = sample.point
    motion = (x for each in zip(point.q, point.v, sample.accelerations, strict=True) for x in each)
    multipliers = (constraint.multiplier for constraint in statement.constraints)
    symbols = (*statement.plain.values(), *multipliers, *point.parameters, t)
    values = (*motion, *sample.multipliers, *point.parameters.values(), point.t)
    return {symbol: sympy.Float(x, DIGITS) for symbol, x in zip(symbols, values, strict=True)}


def _variants(expression: Any, symbols: Sequence[Any]) -> Iterator[Any]:
    """Yield expressions that differ from `expression` by one slip.

    Slips are a wrong sign, symbol, factor or power, a quotient upside down, a missing or superfluous square root or
    number, and a sine in place of a cosine.
    """
    yield from (-expression, 1 / expression, expression**2, sympy.sqrt(expression))
    yield from (expression * factor for p in symbols for factor in (p, 1 / p))
    yield from _changed_parts(expression, symbols)


def _changed_parts(expression: Any, symbols: Sequence[Any]) -> Iterator[Any]:
    """Yield expressions that differ from `expression` by one slip in one of its parts."""
    if expression.is_Symbol:
        yield from (expression**2, 1 / expression, *symbols)
        yield from (expression * p**power for p in symbols for power in (1, -1))
    elif expression.is_Number:
        yield from (sympy.S.One, 1 / expression)
    elif isinstance(expression, (sympy.sin, sympy.cos)):
        yield (sympy.cos if isinstance(expression, sympy.sin) else sympy.sin)(expression.args[0])
    elif expression.is_Pow:
        yield from (expression.base, (1 / expression.base) ** expression.exp)
        yield from ((expression.base * number) ** expression.exp for number in (2, 4, sympy.S.Half, sympy.S.One / 4))
        yield from (part**expression.exp for part in _changed_parts(expression.base, symbols))
        return
    for i, part in enumerate(expression.args):
        rest = expression.func(*expression.args[:i], *expression.args[i + 1 :]) if len(expression.args) > 1 else 0
        if expression.is_Add:
            yield from (rest - part, rest + 2 * part, rest + part / 2)
            yield from (rest + part * p**power for p in symbols for power in (1, -1))
        elif expression.is_Mul:
            yield rest
        for changed in _changed_parts(part, symbols):
            yield expression.func(*expression.args[:i], changed, *expression.args[i + 1 :])
