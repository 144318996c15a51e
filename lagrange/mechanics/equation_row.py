"""One equation of motion taken apart: its coefficients of accelerations and multipliers, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy

from lagrange.errors import StatementError, listing
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.precise import Precise
from lagrange.evidence.sample import Point
from lagrange.mechanics.identity import vanishes_in_symbols as vanishes
from lagrange.mechanics.motion_samples import MotionSample
from lagrange.mechanics.student_equations import StudentEquation
from lagrange.statement.statement import Statement

DIGITS = 40
"""Digits of the values; the motion is known to some 30 of them."""

ZERO = 1e-12
"""An acceleration counts as zero below this part of the largest one, or of 1."""

HELD = 1e-14
"""Residual, relative to the terms, up to which an equation holds: numbers in it may be results of some 50 operations on
doubles. A term of another size would have to be smaller than that at every state."""


@dataclass(frozen=True, eq=False)
class EquationRow:
    """zero = sum of slopes[z] * z over the unknowns z, plus rest; all in the plain symbols of the statement.

    `right` is the right side as it was typed, whose terms have the other sign in `zero`.
    """

    statement: Statement
    label: str
    zero: Any
    slopes: Mapping[Any, Any]
    rest: Any
    right: Any = sympy.S.Zero

    @cached_property
    def _tape(self) -> Precise:
        return tape([*self.slopes.values(), self.rest, *self._parts], self.statement)

    @property
    def _parts(self) -> tuple[Any, ...]:
        """The terms of an equation without accelerations, such as a constraint: rounding is relative to their sizes."""
        return () if any(self.slopes.values()) else sympy.Add.make_args(self.rest)

    @property
    def switches(self) -> tuple[Any, ...]:
        """The conditions, Abs, sign, Min and Max in the equation, in the user's symbols."""
        return self._tape.switches

    def ways(self, point: Point) -> tuple[int | None, ...]:
        """Return the outcome of each switch at a point. Raises OutsideDomain."""
        return self._tape.inspect(point.q, point.v, point.t, point.parameters).outcomes

    def with_symbols(self, table: Mapping[Any, Any]) -> EquationRow:
        """Return the equation with a multiple of a multiplier in place of each that a table has."""
        slopes = {
            symbol: slope * sympy.diff(table.get(symbol, symbol), symbol) for symbol, slope in self.slopes.items()
        }
        zero, right = (one.xreplace(table) for one in (self.zero, self.right))
        return EquationRow(self.statement, self.label, zero, slopes, self.rest, right)

    def numbers(self, sample: MotionSample) -> tuple[list[Any], Any]:
        """Return the coefficients and the rest at a state. Raises OutsideDomain."""
        values = values_at(self._tape, sample)
        return values[: len(self.slopes)], values[len(self.slopes)]

    def leading(self, sample: MotionSample) -> list[Any]:
        """Return the coefficients of accelerations and multipliers at a state, of a first-order equation of its rate.

        Raises OutsideDomain.
        """
        if any(self.slopes.values()) or not sample.first_order:
            return self.numbers(sample)[0]
        velocities = list(self.statement.plain.values())[1::3]
        slopes = values_at(tape([sympy.diff(self.zero, v) for v in velocities], self.statement), sample)
        return [*slopes, *[0] * len(sample.multipliers)]

    def residual(self, sample: MotionSample) -> tuple[Any, Any]:
        """Return what the equation leaves for the motion, and the size of its terms."""
        values, count = values_at(self._tape, sample), len(self.slopes)
        slopes, rest, parts = values[:count], values[count], values[count + 1 :]
        solved = [*sample.accelerations, *sample.multipliers]
        terms = [slope * x for slope, x in zip(slopes, solved, strict=True)]
        # An acceleration that is zero is known to as many digits as the others are, and not to more.
        floor = ZERO * (1 + max(map(abs, solved))) * sum(map(abs, slopes))
        return sum(terms) + rest, sum(map(abs, terms)) + max(abs(rest), sum(map(abs, parts))) + floor

    def holds(self, samples: Sequence[MotionSample]) -> bool:
        """Return whether the motion satisfies the equation at all states where it has a value."""
        found = []
        for sample in samples:
            try:
                found.append(self.residual(sample))
            except OutsideDomain:
                continue
        return bool(found) and all(abs(left) <= HELD * size for left, size in found)


def unknowns_of(statement: Statement) -> list[Any]:
    """Return the accelerations in plain symbols, and the multipliers."""
    return [*list(statement.plain.values())[2::3], *(one.multiplier for one in statement.constraints)]


def row_of(equation: StudentEquation, statement: Statement) -> EquationRow:
    """Return an equation taken apart. Raises StatementError where it is not linear in accelerations and multipliers."""
    unknowns = unknowns_of(statement)
    found = [symbol for symbol in unknowns if equation.zero.has(symbol)]
    slopes = {symbol: sympy.diff(equation.zero, symbol) if symbol in found else sympy.S.Zero for symbol in unknowns}
    bent = [symbol for symbol in found if any(not vanishes(sympy.diff(slopes[symbol], other)) for other in found)]
    if bent:
        raise StatementError(
            f"{equation.label} is not linear in {listing(map(str, bent))}: equations of motion are compared as linear "
            "equations for the accelerations. Solve it for them, or clear what stands around them."
        )
    nothing = dict.fromkeys(found, sympy.S.Zero)
    slopes = {symbol: slope.xreplace(nothing) for symbol, slope in slopes.items()}
    rest = equation.zero.xreplace(nothing)
    return EquationRow(statement, equation.label, equation.zero, slopes, rest, equation.right)


def tape(expressions: Sequence[Any], statement: Statement) -> Precise:
    """Return expressions in plain symbols, ready to be evaluated. Raises OutsideDomain for numbers without a value."""
    stated = {symbol: leaf for leaf, symbol in statement.plain.items()}
    return Precise([expression.xreplace(stated) for expression in expressions], statement, DIGITS)


def values_at(expressions: Precise, sample: MotionSample) -> list[Any]:
    """Return the values at a state. Raises OutsideDomain."""
    point, number = sample.point, expressions.context.mpf
    return expressions(point.q, point.v, point.t, {p: number(x) for p, x in point.parameters.items()})
