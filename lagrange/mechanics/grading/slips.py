"""Find one slip that explains all wrong equations of an answer, and numbers typed in place of exact ones or symbols.

Slips are a wrong sign or factor 2 or 1/2 of a symbol in all equations, degrees in place of radians, small angles, or a
wrong definition. Numbers are decimals rounded from exact numbers, and values of parameters.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from typing import Any

import sympy

from lagrange.errors import StatementError, capitalized, counted, listing
from lagrange.evidence.differences import solve_dense
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.expansion import small
from lagrange.mechanics.grading.motion_samples import SINGULAR, MotionSample, motion_samples
from lagrange.mechanics.grading.student_equations import (
    DIGITS,
    LARGEST_RESIDUAL,
    EquationRow,
    StudentEquation,
    abbreviations,
    row_of,
    unknowns_of,
)
from lagrange.mechanics.grading.term_difference import Write, constant_of
from lagrange.mechanics.grading.time_limit import BudgetSpent, check_budget, check_size, is_spent
from lagrange.mechanics.plain_form import time_derivative
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from lagrange.statement.typed.names import RATES

LONGEST_SLIP = 400  # Largest number of operations, in all equations together, for which slips are tried
MOST_SYMBOLS = 12  # Largest number of coordinates and parameters for which slips are tried
LONGEST_DEFINITION = 40  # Largest number of operations of a definition whose corrections are tried
CLOSE = 1e-20  # Largest residual, at the first sample, with which a corrected definition is examined at all samples
FACTORS = {sympy.Integer(2): "2*", sympy.S.Half: "1/2*"}
"""Factors that students forget or add, and their text in a message"""

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

# A sentence, and the substitution {symbol or function: replacement} that undoes the slip
Slip = tuple[str, Mapping[Any, Any]]


def slip_of(rows: Sequence[EquationRow], choices: Sequence[Sequence[MotionSample]], *, common: bool) -> str:
    """Return a sentence on the single slip whose correction makes all equations correct, or "".

    If `common` is true, common slips such as degrees in place of radians are tried, else signs and factors of symbols.
    `choices` has several lists of the same samples, with different multipliers. Equations are correct if they hold at
    all samples of one list. The result is also "" if the equations are too long, or the time is up.
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
    """Return True if all equations `zeros` = 0 hold at all samples of one of the lists of samples, `choices`."""
    with suppress(StatementError):
        rows = [row_of(StudentEquation(zero), statement) for zero in zeros]
        return any(all(row.holds(samples) for row in rows) for samples in choices)
    return False


def _small_angles(zeros: Sequence[Any], statement: Statement) -> str:
    """Return a sentence if the equations `zeros` = 0 are those of small motions about zero coordinates, else "".

    The result is "" for a system with rotations, because the entries of a quaternion cannot all be zero.
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
    """Return True if the sign of a parameter depends on a choice of direction, as for g or an applied force.

    The energies and forces are linear in such a parameter, and the kinetic energy does not contain it. In the potential
    its coefficient has both signs. In forces its coefficient does not depend on velocities, unlike a drag coefficient,
    or the forces do no work, as those of a magnetic field.
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
    """Yield common slips that the equations `zeros` = 0 may contain, such as degrees, the most common first.

    `parameters` are the parameters in the equations.
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
    """Yield slips in the sign, direction, or factor 2 or 1/2 of a symbol, which may also be errors of one term.

    `parameters` are the parameters in the equations.
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
    """Yield slips of a factor 2 or 1/2 in one of the coordinates (q, v, a), with its velocity and acceleration."""
    for factor, text in FACTORS.items():
        for q, v, a in coordinates:
            yield f"All is right for {text}{q} in place of {q}.", {q: factor * q, v: factor * v, a: factor * a}


def _coordinates(statement: Statement) -> list[tuple[Any, ...]]:
    """Return the symbols (coordinate, velocity, acceleration) for each coordinate."""
    plain = iter(statement.plain.values())
    return [*zip(plain, plain, plain, strict=True)]


def wrong_definition(rows: Sequence[EquationRow], samples: Sequence[MotionSample], write: Write, *, alone: bool) -> str:
    """Return a sentence on a definition in the answer whose correction makes all equations correct, or "".

    Corrections are those of `_variants`, the shortest first. A constant is replaced by constants only. `alone` is true
    if one wrong term explains the error, too. Then the square and the root of the definition are not tried.
    """
    statement, sample, point = rows[0].statement, samples[0], samples[0].point
    coordinates = list(statement.plain.values())
    # The numbers of all symbols at the first sample.
    motion = (x for each in zip(point.q, point.v, sample.accelerations, strict=True) for x in each)
    multipliers = (constraint.multiplier for constraint in statement.constraints)
    symbols_at = (*coordinates, *multipliers, *point.parameters, t)
    values = (*motion, *sample.multipliers, *point.parameters.values(), point.t)
    numbers = {symbol: sympy.Float(x, DIGITS) for symbol, x in zip(symbols_at, values, strict=True)}
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


def _variants(expression: Any, symbols: Sequence[Any]) -> Iterator[Any]:
    """Yield expressions that a student may have meant by `expression`: each corrects one slip.

    Slips are a wrong sign, symbol, factor or power, a quotient upside down, a missing or superfluous square root or
    number, and a sine in place of a cosine. The yielded expressions may contain the `symbols`.
    """
    yield from (-expression, 1 / expression, expression**2, sympy.sqrt(expression))
    yield from (expression * factor for p in symbols for factor in (p, 1 / p))
    yield from _changed_parts(expression, symbols)


def _changed_parts(expression: Any, symbols: Sequence[Any]) -> Iterator[Any]:
    """Yield expressions that differ from `expression` by one slip in a part of it, such as a term or a factor."""
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


FEWEST_DIGITS = 3  # Least number of significant digits of a rounded number: 9.81 is accepted, 9.8 is not
LONGEST_ROUNDED = 400  # Largest number of operations of an equation whose decimals are examined
_DECIMAL = re.compile(r"(?<![\w.])[0-9]*\.[0-9]+(?:e[+-]?[0-9]+)?(?!\w)")


def with_exact_numbers(row: EquationRow, samples: Sequence[MotionSample]) -> StudentEquation | None:
    """Return an equation with exact numbers in place of decimals, if it then holds at all samples; else None.

    The equation's `note` is a sentence on these numbers. A decimal is replaced if it is rounded from the exact number
    and has enough digits: 0.667 becomes 2/3. A decimal that was cut off, such as 0.666, remains. SymPy multiplies the
    decimals in a product, so such a number counts as precise as the most precise decimal of the equation.
    """
    equation = row.equation
    typed = [Decimal(text) for text in _DECIMAL.findall(equation.read)]
    decimals = sorted(row.zero.atoms(sympy.Float), key=str)
    if not typed or not 0 < len(decimals) < len(samples) or row.zero.count_ops() > LONGEST_ROUNDED:
        return None
    if any(number and not TINY <= abs(float(number)) <= 1 / TINY for number in (*typed, *decimals)):
        return None
    typed.sort(key=_unit)  # most precise first
    try:
        exact = _exact_numbers(row, decimals, samples)
        corrected = equation.with_numbers(exact)
        holds = row_of(corrected, row.statement).holds(samples)
    except (OutsideDomain, StatementError):
        return None
    sources = {x: next((y for y in typed if float(y) == abs(float(x))), typed[0]) for x in exact}
    errors = {x: (exact[x] / x - 1) / _unit(source) for x, source in sources.items()}  # in units of the last digit
    if not holds or any(not LARGEST_RESIDUAL - 0.5 < error < 1 - LARGEST_RESIDUAL for error in errors.values()):
        return None
    cut = next((x for x, error in errors.items() if error > 0.5 + LARGEST_RESIDUAL), None)
    if cut is not None:
        rounded = f"{abs(float(exact[cut])):.{len(sources[cut].as_tuple().digits)}g}"
        number = _text(abs(exact[cut]), FEWEST_DIGITS)
        return replace(equation, note=f"{abs(float(cut)):.15g} is not {number} rounded: {rounded}.")
    digits = min(len(source.as_tuple().digits) for source in sources.values())
    note = listing(f"{abs(float(x)):.15g} stands for {_text(abs(value), digits)}" for x, value in exact.items())
    if digits < FEWEST_DIGITS:
        advice = f"give at least {FEWEST_DIGITS}, or the exact number."
        return replace(equation, note=f"To {counted(digits, 'digit')} {note}: {advice}")
    return replace(corrected, note=f"{capitalized(equation.label)} is right to {digits} digits: {note}.")


TINY = 1e-300
"""Smallest decimal in an equation that is examined for rounding; the largest is 1/TINY. Products of decimals beyond
these limits may leave the range of doubles."""


def _unit(number: Decimal) -> float:
    """Return one unit in the last digit of a decimal, relative to the decimal: 0.01/9.81 for 9.81; 1 for zero."""
    return 10.0 ** int(number.as_tuple().exponent) / float(number) if number else 1.0


def _text(value: Any, digits: int) -> str:
    """Return the text of a number: a fraction, or a decimal with `digits` + 3 digits.

    A decimal is returned if the number is not rational, or is a decimal fraction such as 981/100.
    """
    return str(value) if value.is_Rational and value.q not in (10, 100, 1000) else f"{float(value):.{digits + 3}g}"


def _exact_numbers(row: EquationRow, decimals: Sequence[Any], samples: Sequence[MotionSample]) -> dict[Any, Any]:
    """Return {decimal: exact number}, where the exact numbers are those with which an equation holds at the samples.

    One step of Newton's method finds them, at as many samples as there are decimals. Exact decimals are left out. If
    they are determined only up to a factor, the last ones stay unchanged. Raises OutsideDomain if none is determined.
    """
    names = {number: sympy.Dummy(real=True) for number in decimals}
    opened, typed = row.zero.xreplace(names), {name: number for number, name in names.items()}
    slopes = [row.with_zero(sympy.diff(opened, name).xreplace(typed)) for name in typed]
    columns = [[slope.residual(sample)[0] for sample in samples] for slope in slopes]
    residuals = [row.residual(sample)[0] for sample in samples]
    for count in range(len(decimals), 0, -1):
        lines = [list(line) for line in zip(*columns[:count], strict=True)]
        try:
            steps = solve_dense(lines[:count], residuals[:count], SINGULAR)
        except OutsideDomain:
            continue
        values = [(x, float(x) - step) for x, step in zip(decimals, steps, strict=False)]
        changed = [(x, y, constant_of([y])) for x, y in values if abs(y - float(x)) > LARGEST_RESIDUAL * abs(float(x))]
        return {x: sympy.Float(str(y), 30) if f is None else sympy.Rational(f) for x, y, f in changed}
    raise OutsideDomain("no decimal is determined")


LARGEST_COUNT = 4  # Integers and half-integers up to this number are exponents or factors, not values of parameters


def with_parameters(
    rows: Sequence[EquationRow], choices: Sequence[Sequence[MotionSample]]
) -> tuple[Sequence[EquationRow], str]:
    """Return wrong equations with parameters in place of their values, such as g for 9.81, and a sentence on these.

    A value is replaced if no equation contains its parameter. If there is no such value, or if all equations would then
    hold at all samples of one of the `choices`, the equations are returned unchanged, and the sentence is "".
    """
    statement = rows[0].statement
    absent = {float(x): p for p, x in statement.defaults.items() if not any(row.zero.has(p) for row in rows)}
    numbers = {abs(number) for row in rows for number in row.zero.atoms(sympy.Number)}
    numbers = {x for x in numbers if float(x) in absent and (x > LARGEST_COUNT or 2 * x % 1 != 0)}
    places = {sign * x: sign * absent[float(x)] for x in numbers for sign in (1, -1)}
    changed = [row_of(row.equation.with_numbers(places), statement) for row in rows]
    if not numbers or any(all(row.holds(chosen) for row in changed) for chosen in choices):
        return rows, ""
    return changed, f"Write {listing(sorted(f'{absent[float(x)]} for {float(x):.6g}' for x in numbers))}. "
