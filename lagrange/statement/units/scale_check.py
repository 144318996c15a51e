"""Check that the units of a statement fit together: every expression must have the required scale.

Dimensions have been checked before. The scale of an expression is the logarithm of the factor of its unit. Symbols
without a stated unit have unknown scales, and so have energies, positions and constraints. A force on q has the
scale of an energy over q, and a dissipation that of an energy over time. Terms of a sum have equal scales, and
arguments of functions have the scale of a number.

The scale of a unit is a linear form: logarithms of factors, some of them unknown. Equations between scales are linear,
and each is solved for one unknown when it is stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError
from lagrange.statement.coordinate import name_of
from lagrange.statement.given.motion import table_range
from lagrange.statement.parameters import label_of
from lagrange.statement.units.checked_part import SAME_DIMENSION, CheckedPart, in_short, inner_parts, number_of
from lagrange.statement.units.dimension import BASE, SAME_FACTOR, Dimension, named, read_dimension, units_in


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


class OtherUnitError(Exception):
    """A term in another unit than required; `ratio` is the logarithm of its unit over the required one."""

    def __init__(self, term: Any, ratio: float) -> None:
        super().__init__()
        self.term, self.ratio = term, ratio


def with_scales(
    parts: Sequence[CheckedPart], dimensions: Mapping[Any, Dimension], plain: Mapping[Any, Any]
) -> dict[Any, Dimension]:
    """Return the dimensions with the factors of units that follow from the stated ones.

    `plain` maps functions to symbols for messages. Raises StatementError for a term in another unit than required, and
    for a symbol whose unit would not be a product of the stated base units.
    """
    scales = _UnitScales(dimensions)
    for part in parts:
        try:
            scales.check(part)
        except OtherUnitError as wrong:
            raise StatementError(
                f"{part.what} has the term {in_short(wrong.term, plain)} in other units than the terms it is compared "
                f"with, {_factor(wrong.ratio)} times theirs: {_remedy(parts, dimensions, wrong.term)}"
            ) from None
    completed = {symbol: scales.completed(symbol, dimension) for symbol, dimension in dimensions.items()}
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
    scales = _UnitScales(others)
    try:
        for part in parts:
            scales.check(part)
    except OtherUnitError:
        return ""
    factor = scales.completed(symbol, others[symbol]).factor
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


class _UnitScales:
    """Scales of expressions, each found once, and the equations that follow from sums and functions."""

    def __init__(self, dimensions: Mapping[Any, Dimension]) -> None:
        self.dimensions = dimensions
        self.equations = ScaleEquations()
        self.known: dict[Any, Scale | None] = {}

    def check(self, part: CheckedPart) -> None:
        """Equate the scale of an expression with the required one. Raises OtherUnitError for a contradiction."""
        scale = self.scale(part.expression)
        if scale is None:
            return
        if part.like is None:
            return
        required = Scale.of_unknown(part.like) if isinstance(part.like, str) else self.scale(part.like)
        if part.per is not None:
            over = self.scale(part.per)
            required = None if required is None or over is None else required.minus(over)
        if required is not None:
            self._equate(sympy.Add.make_args(part.expression)[0], scale, required)

    def completed(self, symbol: Any, dimension: Dimension) -> Dimension:
        """Return the dimension of a symbol with the factor of its unit, None if that is not determined."""
        scale = self.scale(symbol)
        reduced = None if scale is None else self.equations.reduced(scale)
        factor = None if reduced is None or reduced.unknowns else reduced.constant
        return Dimension(dimension.exponents, factor, dimension.unit)

    def scale(self, expression: Any) -> Scale | None:
        """Return the scale of an expression, None for zero, which fits every scale."""
        if expression not in self.known:
            self.known[expression] = self._scale(expression)
        return self.known[expression]

    def _scale(self, expression: Any) -> Scale | None:
        if isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Subs)):
            return self._symbol(expression)
        if expression.is_number:
            return None if expression.is_zero else Scale()
        if isinstance(expression, sympy.Derivative):
            return self._sum([(expression.expr, Fraction(1)), *((by, Fraction(-1)) for by in expression.variables)])
        if expression.is_Mul:
            return self._sum([(factor, Fraction(1)) for factor in expression.args])
        if expression.is_Pow:
            return self._power(expression.base, expression.exp)
        if expression.is_Add or isinstance(expression, SAME_DIMENSION):
            return self._equal(expression.args)
        return self._function(expression)

    def _symbol(self, symbol: Any) -> Scale:
        dimension = self.dimensions.get(symbol)
        if dimension is None or (dimension.factor is None and dimension.exponents):
            return Scale.of_unknown(symbol)
        return Scale(dimension.factor or 0.0)

    def _sum(self, factors: Sequence[tuple[Any, Fraction]]) -> Scale | None:
        """Return the scale of a product of powers."""
        total = Scale()
        for factor, power in factors:
            scale = self.scale(factor)
            if scale is None:
                return None
            total = total.plus(scale, power)
        return total

    def _power(self, base: Any, exponent: Any) -> Scale | None:
        power = number_of(exponent)
        if power is not None:
            return self._sum([(base, power)])
        self._number(exponent)
        self._number(base)
        return Scale()

    def _equal(self, terms: Sequence[Any]) -> Scale | None:
        """Return the common scale of terms, after equating their scales; None if all terms are zero."""
        first = None
        for term in terms:
            scale = self.scale(term)
            if first is not None and scale is not None:
                self._equate(term, scale, first)
            first = scale if first is None else first
        return first

    def _function(self, expression: Any) -> Scale | None:
        """Return the scale of a function or a Piecewise."""
        for argument, dimension in inner_parts(expression, None):
            if dimension is None:
                self.scale(argument)
            else:
                self._number(argument)
        if isinstance(expression, sympy.Piecewise) and table_range(expression) is None:
            return self._equal([pair.expr for pair in expression.args])
        return Scale()

    def _number(self, expression: Any) -> None:
        """Equate the scale of an expression with that of a number."""
        scale = self.scale(expression)
        if scale is not None:
            self._equate(sympy.Add.make_args(expression)[0], scale, Scale())

    def _equate(self, term: Any, one: Scale, other: Scale) -> None:
        ratio = self.equations.equate(one, other)
        if ratio is not None:
            raise OtherUnitError(term, ratio)


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
