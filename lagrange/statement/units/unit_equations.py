"""Unit equations of expressions: terms of a sum have equal units, and arguments of functions are dimensionless.

A unit is a product of powers, some of them unknown. In logarithms the equations are linear. Each equation is solved for
one unknown when it is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

import sympy
from sympy.core.function import AppliedUndef

from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import is_shorthand
from lagrange.statement.given.motion import table_range
from lagrange.statement.units.dimension import Dimension, named

SAME_DIMENSION = (sympy.Abs, sympy.Min, sympy.Max)
"""Functions whose value has the dimension of their arguments."""


@dataclass(frozen=True)
class CheckedPart:
    """Expression of a statement, its name `what` in messages, and its required dimension and unit.

    `like` is the name of a quantity, such as "energy", or a symbol with the required dimension and unit, or None if any
    dimension is accepted. If there is a symbol `per`, the requirement is on the expression times this symbol.
    """

    what: str
    expression: Any
    like: Any
    per: Any = None


def in_short(term: Any, plain: Mapping[Any, Any]) -> str:
    """Return a term as text for messages, at most 80 characters, in plain symbols, with table(t) for a table over t."""
    named_tables = term.replace(
        lambda node: table_range(node) is not None, lambda node: sympy.Function("table")(node.args[0].cond.args[0].lhs)
    )
    shorthands = {f: sympy.Symbol(name_of(f)) for f in term.atoms(AppliedUndef) if is_shorthand(f)}
    return str(named_tables.xreplace({**plain, **shorthands}))[:80]


def number_of(exponent: Any) -> Fraction | None:
    """Return an exponent of a power as a fraction. None if it is not a number."""
    if exponent.is_Rational:
        return Fraction(int(exponent.p), int(exponent.q))
    return Fraction(float(exponent)).limit_denominator(1000) if exponent.is_Float else None


def inner_parts(expression: Any, required: UnitProduct | None) -> Iterator[tuple[Any, UnitProduct | None]]:
    """Yield (part, required unit) for the arguments of a function, or the branches and conditions of a Piecewise.

    None means that any unit is accepted. `required` is the required unit of the whole expression. The argument of a
    table is a number. Quantities that are compared, such as both sides of a condition, are yielded as their difference.
    """
    if (table := table_range(expression)) is not None:
        yield table[0], UnitProduct()
    elif isinstance(expression, sympy.Piecewise):
        for pair in expression.args:
            yield pair.expr, required
            for condition in pair.cond.atoms(sympy.core.relational.Relational):
                yield condition.lhs - condition.rhs, None
    elif isinstance(expression, sympy.atan2):
        above, below = expression.args
        yield above - below, None
    elif isinstance(expression, (sympy.sign, sympy.Heaviside)):
        yield expression.args[0], None
    elif not isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Derivative, sympy.Subs)):
        for argument in expression.args:
            yield argument, UnitProduct()


class UnitFactor(NamedTuple):
    """Unknown scale factor of the unit of a symbol `of`, or of a required quantity `of`, such as "energy"."""

    of: Any


@dataclass(frozen=True)
class UnitProduct:
    """Unit as a product of powers of base dimensions, unknown symbols and unknown factors, without zero powers.

    `powers` has the exponent of each base dimension by name, of each symbol whose dimension is unknown, and of each
    `UnitFactor`. `logarithm` is the natural logarithm of the known factor.
    """

    powers: Mapping[Any, Fraction] = field(default_factory=dict)
    logarithm: float = 0.0

    @classmethod
    def of(cls, dimension: Dimension, owner: Any) -> UnitProduct:
        """Return the unit of a dimension. If its factor is not known, it is the unknown `UnitFactor` of `owner`."""
        powers: dict[Any, Fraction] = dict(dimension.exponents)
        if dimension.factor is None and powers:
            powers[UnitFactor(owner)] = Fraction(1)
        return cls(powers, dimension.factor or 0.0)

    def times(self, other: UnitProduct, power: Fraction = Fraction(1)) -> UnitProduct:
        """Return the product of this unit and a power of the unit `other`."""
        powers = dict(self.powers)
        for name, exponent in other.powers.items():
            powers[name] = powers.get(name, Fraction(0)) + power * exponent
        left = {name: exponent for name, exponent in powers.items() if exponent}
        return UnitProduct(left, self.logarithm + float(power) * other.logarithm)

    def unknown(self, kind: type) -> Any:
        """Return an unknown of this unit that is of class `kind`, a symbol or a `UnitFactor`. None if there is none."""
        return next((name for name in self.powers if isinstance(name, kind)), None)


class UnitEquations:
    """Equations between units of expressions, and the values of the unknowns that follow from them.

    `dimensions` are the known dimensions by symbol, and `parts` the expressions. Contradictions are ignored here: the
    first equation decides.
    """

    def __init__(self, dimensions: Mapping[Any, Dimension], parts: Sequence[CheckedPart] = ()) -> None:
        self.dimensions = dimensions
        self.solved: dict[Any, UnitProduct] = {}
        self.units: dict[Any, UnitProduct | None] = {}
        for part in parts:
            self.unit(part.expression)
        for part in parts:
            unit, required = self.unit(part.expression), self.required(part)
            if unit is not None and required is not None:
                self._equate(unit, required)

    def required(self, part: CheckedPart) -> UnitProduct | None:
        """Return the unit that the expression of `part` must have. None if any unit is accepted."""
        if part.like is None:
            return None
        required = UnitProduct.of(named(part.like), part.like) if isinstance(part.like, str) else self.unit(part.like)
        over = UnitProduct() if part.per is None else self.unit(part.per)
        return None if required is None or over is None else required.times(over, Fraction(-1))

    def dimension(self, expression: Any) -> Dimension | None:
        """Return the dimension of an expression. None if it is undetermined, or if the expression is zero."""
        unit = self.unit(expression)
        return None if unit is None else self.dimension_of_unit(unit)

    def dimension_of_unit(self, unit: UnitProduct) -> Dimension | None:
        """Return the dimension of a unit. None if it is undetermined."""
        unit = self.reduced(unit)
        if unit.unknown(sympy.Basic) is not None:
            return None
        exponents = {name: power for name, power in unit.powers.items() if isinstance(name, str)}
        return Dimension.of(exponents, None if unit.unknown(UnitFactor) is not None else unit.logarithm)

    def unit(self, expression: Any) -> UnitProduct | None:
        """Return the unit of an expression. None for zero, which fits every unit."""
        if expression not in self.units:
            self.units[expression] = self._unit(expression)
        return self.units[expression]

    def _unit(self, expression: Any) -> UnitProduct | None:
        if expression in self.dimensions:
            return UnitProduct.of(self.dimensions[expression], expression)
        if isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Subs)):
            return UnitProduct({expression: Fraction(1)})
        if expression.is_number:
            return None if expression.is_zero else UnitProduct()
        if isinstance(expression, sympy.Derivative):
            return self._product([(expression.expr, Fraction(1)), *((by, Fraction(-1)) for by in expression.variables)])
        if expression.is_Mul:
            return self._product([(factor, Fraction(1)) for factor in expression.args])
        if expression.is_Pow and (power := number_of(expression.exp)) is not None:
            return self._product([(expression.base, power)])
        if expression.is_Pow:
            self._number(expression.exp)
            self._number(expression.base)
            return UnitProduct()
        if expression.is_Add or isinstance(expression, SAME_DIMENSION):
            return self._common(expression.args)
        return self._function(expression)

    def _product(self, factors: Sequence[tuple[Any, Fraction]]) -> UnitProduct | None:
        """Return the unit of a product of powers. `factors` are pairs (base, exponent)."""
        total = UnitProduct()
        for factor, power in factors:
            unit = self.unit(factor)
            if unit is None:
                return None
            total = total.times(unit, power)
        return total

    def _common(self, terms: Sequence[Any]) -> UnitProduct | None:
        """Add the equations that all terms have the same unit, and return this unit. None if all terms are zero."""
        first = None
        for unit in map(self.unit, terms):
            if first is not None and unit is not None:
                self._equate(unit, first)
            first = unit if first is None else first
        return first

    def _function(self, expression: Any) -> UnitProduct | None:
        """Return the unit of a function or a Piecewise, and add the equations of its arguments."""
        for argument, required in inner_parts(expression, None):
            if required is None:
                self.unit(argument)
            else:
                self._number(argument)
        if isinstance(expression, sympy.Piecewise) and table_range(expression) is None:
            return self._common([pair.expr for pair in expression.args])
        return UnitProduct()

    def _number(self, expression: Any) -> None:
        """Add the equation that an expression, such as the argument of a function, is dimensionless."""
        unit = self.unit(expression)
        if unit is not None:
            self._equate(unit, UnitProduct())

    def reduced(self, unit: UnitProduct) -> UnitProduct:
        """Return a unit in which each unknown with a determined value is replaced by this value."""
        while (known := next((name for name in unit.powers if name in self.solved), None)) is not None:
            power = unit.powers[known]
            unit = unit.times(UnitProduct({known: power}), Fraction(-1)).times(self.solved[known], power)
        return unit

    def _equate(self, unit: UnitProduct, other: UnitProduct) -> None:
        """Add the equation that two units are equal, and solve it for one of its unknowns."""
        ratio = self.reduced(unit.times(other, Fraction(-1)))
        unknown = ratio.unknown(sympy.Basic)
        if unknown is None and ratio.unknown(str) is None:
            unknown = ratio.unknown(UnitFactor)
        if unknown is not None:
            power = ratio.powers[unknown]
            rest = ratio.times(UnitProduct({unknown: power}), Fraction(-1))
            self.solved[unknown] = UnitProduct().times(rest, -1 / power)
