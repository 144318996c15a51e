"""Numbers of an equation that stand for others: decimals rounded from exact numbers, and values of parameters."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any

import sympy

from lagrange.errors import StatementError, counted, listing
from lagrange.evidence.laws import solve_dense
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.grading.motion_samples import SINGULAR, MotionSample
from lagrange.mechanics.grading.student_equations import HELD, EquationRow, StudentEquation, row_of
from lagrange.mechanics.grading.term_difference import constant_of

# Fewest significant digits of a rounded number that is right: 9.81 and 0.667 are, 9.8 and 0.67 are not
FEWEST_DIGITS = 3
# Largest number of operations of an equation whose decimals are examined; each costs a derivative
LONGEST_ROUNDED = 400
_DECIMAL = re.compile(r"(?<![\w.])[0-9]*\.[0-9]+(?:e[+-]?[0-9]+)?(?!\w)")


def with_exact_numbers(row: EquationRow, samples: Sequence[MotionSample]) -> StudentEquation | None:
    """Return an equation with exact numbers in place of decimals, if it then holds at all samples; else None.

    Its `note` is a sentence on these numbers. The exact numbers replace decimals that are rounded from them and have
    enough digits: 0.667 becomes 2/3. A number that was cut off, such as 0.666, remains. SymPy multiplies the decimals
    in a product. The result is assumed to be as precise as the most precise decimal of the equation.
    """
    equation = row.equation
    typed = [Decimal(text) for text in _DECIMAL.findall(equation.read)]
    decimals = sorted(row.zero.atoms(sympy.Float), key=str)
    if not typed or not 0 < len(decimals) < len(samples) or row.zero.count_ops() > LONGEST_ROUNDED:
        return None
    if any(number and not TINY <= abs(float(number)) <= 1 / TINY for number in (*typed, *decimals)):
        return None
    typed.sort(key=_unit)  # the most precise ones first
    try:
        exact = _exact_numbers(row, decimals, samples)
        corrected = equation.with_numbers(exact)
        holds = row_of(corrected, row.statement).holds(samples)
    except (OutsideDomain, StatementError):
        return None
    sources = {x: next((y for y in typed if float(y) == abs(float(x))), typed[0]) for x in exact}
    errors = {x: (exact[x] / x - 1) / _unit(source) for x, source in sources.items()}  # in units of the last digit
    if not holds or any(not HELD - 0.5 < error < 1 - HELD for error in errors.values()):
        return None
    cut = next((x for x, error in errors.items() if error > 0.5 + HELD), None)
    if cut is not None:
        rounded = f"{abs(float(exact[cut])):.{len(sources[cut].as_tuple().digits)}g}"
        number = _text(abs(exact[cut]), FEWEST_DIGITS)
        return replace(equation, note=f"{abs(float(cut)):.15g} is not {number} rounded: {rounded}.")
    digits = min(len(source.as_tuple().digits) for source in sources.values())
    note = listing(f"{abs(float(x)):.15g} stands for {_text(abs(value), digits)}" for x, value in exact.items())
    if digits < FEWEST_DIGITS:
        advice = f"give at least {FEWEST_DIGITS}, or the exact number."
        return replace(equation, note=f"To {counted(digits, 'digit')} {note}: {advice}")
    label = f"{equation.label[0].upper()}{equation.label[1:]}"
    return replace(corrected, note=f"{label} is right to {digits} digits: {note}.")


TINY = 1e-300
"""Decimals below this size, and above its inverse, are not taken for rounded numbers.

Their digits, or those of their products, are not those of doubles.
"""


def _unit(number: Decimal) -> float:
    """Return one unit in the last digit of a decimal, relative to the decimal."""
    return 10.0 ** int(number.as_tuple().exponent) / float(number) if number else 1.0


def _text(value: Any, digits: int) -> str:
    """Return a number as a fraction, or as a decimal with `digits` digits.

    It is a decimal if it is not rational, or if its fraction is long, such as 981/100.
    """
    return str(value) if value.is_Rational and value.q not in (10, 100, 1000) else f"{float(value):.{digits + 3}g}"


def _exact_numbers(row: EquationRow, decimals: Sequence[Any], samples: Sequence[MotionSample]) -> dict[Any, Any]:
    """Return {decimal: exact number}, by one step of Newton's method with as many samples as there are decimals.

    Decimals that are exact are left out. If the equation determines them only up to a common factor, the last decimals
    stay as they are. Raises OutsideDomain if no number is determined.
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
        changed = [(x, y, constant_of([y])) for x, y in values if abs(y - float(x)) > HELD * abs(float(x))]
        return {x: sympy.Float(str(y), 30) if f is None else sympy.Rational(f) for x, y, f in changed}
    raise OutsideDomain("no decimal is determined")


LARGEST_COUNT = 4  # Integers up to this, and halves of integers, may be exponents and factors of right equations


def with_parameters(
    rows: Sequence[EquationRow], choices: Sequence[Sequence[MotionSample]]
) -> tuple[Sequence[EquationRow], str]:
    """Return wrong equations with parameters in place of their values, such as g for 9.81, and a sentence on these.

    A value counts if no equation contains its parameter. The rows are unchanged, and the sentence is empty, if there is
    no such value, or if all equations then hold at one of the `choices` of samples.
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
