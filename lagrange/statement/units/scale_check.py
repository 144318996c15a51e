"""Check that the units of a statement fit together: terms of a sum have equal factors of their units.

Dimensions have been checked before. Symbols without a stated unit have unknown factors, and so have energies, positions
and constraints. A force on q has the unit of an energy over q, and a dissipation that of an energy over time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError
from lagrange.statement.coordinate import name_of
from lagrange.statement.parameters import label_of
from lagrange.statement.units.checked_part import CheckedPart, in_short
from lagrange.statement.units.dimension import BASE, SAME_FACTOR, Dimension, named, read_dimension, units_in
from lagrange.statement.units.unit_equations import OtherUnitError, UnitEquations

COHERENT = {"mass": "kg", "length": "m", "time": "s"}
"""Base units of N, J, W and other units of the SI."""

DERIVED = ("N", "N*m", "N/m", "N*s/m", "W")
"""Derived units that a remedy writes in place of products of kg, m and s."""

LARGEST = 700.0
"""Largest logarithm of a factor that is printed as a number: doubles overflow at 709."""

FIT = "state all symbols in units that fit together, such as kg, m and s, and angles in rad."
"""The remedy for units that do not fit together."""

MOST_TRIED = 12
"""Most symbols of which another unit is tried as a remedy. Each takes the time of one check."""

MOST_REMEDIES, MOST_NAMED = 2, 4
"""Most remedies, and most stated units, that a message lists."""


def with_scales(
    parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], plain: Mapping[Any, Any]
) -> dict[Any, Dimension]:
    """Return the dimensions with the factors of units that follow from the stated ones.

    `plain` maps functions to symbols for messages. Raises StatementError for a term in another unit than required, and
    for a symbol whose unit would not be a product of the stated base units.
    """
    equations = UnitEquations(dimensions, strict=True)
    for part in parts:
        try:
            equations.require(part)
        except OtherUnitError as wrong:
            raise StatementError(
                f"{part.what} has the term {in_short(wrong.term, plain)} in other units than the terms it is compared "
                f"with, {_factor(wrong.ratio)} times theirs: {_remedy(parts, dimensions, wrong.term)}"
            ) from None
    completed = {symbol: _completed(equations, symbol, dimension) for symbol, dimension in dimensions.items()}
    _check_found([dimension for dimension in dimensions.values() if dimension.unit], completed)
    return completed


def _remedy(parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], term: Any) -> str:
    """Return the remedy for a term in another unit: symbols and the units to state them in. Each alone mends it."""
    stated = [symbol for symbol, dimension in dimensions.items() if dimension.unit]
    # Symbols of the term first: one of them is more often the wrong one.
    stated.sort(key=lambda symbol: not term.has(symbol))
    mended = [
        f"{label_of(symbol)} in {unit} instead of {dimensions[symbol].unit}"
        for symbol in stated[:MOST_TRIED]
        if (unit := _fitting_unit(parts, dimensions, symbol))
    ]
    if mended:
        return f"state {', or '.join(mended[:MOST_REMEDIES])}."
    units = ", ".join(f"{label_of(symbol)} in {dimensions[symbol].unit}" for symbol in stated[:MOST_NAMED])
    return f"{FIT} Stated are {units}."


def _fitting_unit(parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], symbol: Any) -> str:
    """Return the unit of a symbol that fits the units of all other symbols, or an empty text."""
    others = {**dimensions, symbol: Dimension(dimensions[symbol].exponents)}
    equations = UnitEquations(others, strict=True)
    try:
        for part in parts:
            equations.require(part)
    except OtherUnitError:
        return ""
    factor = _completed(equations, symbol, others[symbol]).factor
    exponents = dimensions[symbol].exponents
    if not exponents:
        return "rad"
    derived = next((unit for unit in DERIVED if Dimension(exponents, factor).fits(read_dimension(unit, unit))), "")
    if factor is not None and derived:
        return derived
    bases = _base_units([dimension for dimension in others.values() if dimension.unit])
    if factor is None or not all(name in bases for name, _ in exponents):
        return ""
    away, text = min(((abs(factor - scale), text) for scale, text in _made(bases, dimensions[symbol])))
    return text if away <= SAME_FACTOR else ""


def _completed(equations: UnitEquations, symbol: Any, dimension: Dimension) -> Dimension:
    """Return the dimension of a symbol with the factor of its unit, None if that is not determined."""
    found = equations.dimension(symbol)
    return replace(dimension, factor=None if found is None else found.factor)


def _factor(logarithm: float) -> str:
    """Return a factor as text."""
    if abs(logarithm) < LARGEST:
        return f"{math.exp(logarithm):.6g}"
    return f"10**{logarithm / math.log(10):.0f}"


def _check_found(stated: Sequence[Dimension], found: Mapping[Any, Dimension]) -> None:
    """Raise StatementError for an inferred unit that is not a product of powers of the stated base units."""
    bases = _base_units(stated)
    for symbol, dimension in found.items():
        factor = dimension.factor
        if dimension.unit or factor is None or not all(name in bases for name, _ in dimension.exponents):
            continue
        away, text = min(
            ((factor - scale, text) for scale, text in _made(bases, dimension)), key=lambda one: abs(one[0])
        )
        if abs(away) > SAME_FACTOR:
            name = name_of(symbol) if isinstance(symbol, AppliedUndef) else symbol
            raise StatementError(
                f"no unit was stated for {name}, and the one that follows from its terms is "
                f"{_factor(away)} {text}: state the unit of {name}, or {FIT}"
            )


def _base_units(stated: Sequence[Dimension]) -> dict[str, dict[str, tuple[float, Fraction]]]:
    """Return {base dimension: {unit: (logarithm of its factor, power)}} for the base units in the stated units.

    The power is that of the base dimension in the unit, such as -1 for Hz. Derived units such as N and J contribute kg,
    m and s.
    """
    bases: dict[str, dict[str, tuple[float, Fraction]]] = {"time": {"s": (0.0, Fraction(1))}}
    for name in (name for dimension in stated for name in units_in(dimension.unit)):
        measure = named(name)
        if len(measure.exponents) == 1 and measure.factor is not None:
            ((base, power),) = measure.exponents
            bases.setdefault(base, {})[name] = measure.factor, power
            continue
        for base, _ in measure.exponents:
            if base in COHERENT:
                bases.setdefault(base, {})[COHERENT[base]] = named(COHERENT[base]).factor or 0.0, Fraction(1)
    return {base: units for base, units in bases.items() if base in BASE}


def _made(
    bases: Mapping[str, Mapping[str, tuple[float, Fraction]]], dimension: Dimension
) -> Iterator[tuple[float, str]]:
    """Yield (scale, text) of each unit of a dimension that is a product of powers of base units."""
    for choice in product(*(bases[base].items() for base, _ in dimension.exponents)):
        pairs = zip(choice, dimension.exponents, strict=True)
        powers = [(text, factor, power / of_unit) for (text, (factor, of_unit)), (_, power) in pairs]
        scale = math.fsum(factor * float(power) for _, factor, power in powers)
        above = [_powered(text, power) for text, _, power in powers if power > 0]
        below = [f"/{_powered(text, -power)}" for text, _, power in powers if power < 0]
        yield scale, ("*".join(above) or "1") + "".join(below)


def _powered(text: str, power: Fraction) -> str:
    """Return a positive power of a unit as a user types it."""
    return text if power == 1 else f"{text}**{power}" if power.denominator == 1 else f"{text}**({power})"
