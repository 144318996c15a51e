"""Units of expressions as products of powers, some of them unknown, and the linear equations between units.

Terms of a sum have equal units, and arguments of functions are dimensionless. In logarithms these equations are linear.
Each equation is solved for one unknown when it is stated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

import sympy
from sympy.core.function import AppliedUndef

from lagrange.statement.coordinate import name_of, t
from lagrange.statement.expression import is_shorthand
from lagrange.statement.given.motion import table_range
from lagrange.statement.units.dimension import DIMENSIONLESS, SAME_FACTOR, Dimension, named

SAME_DIMENSION = (sympy.Abs, sympy.Min, sympy.Max)
"""Functions whose value has the dimension of their arguments."""


@dataclass(frozen=True)
class CheckedPart:
    """An expression of a statement, its name `what` in messages, and its required dimension and unit.

    `like` is the name of a quantity, such as "energy", or a symbol with the required dimension and unit, or None if any
    is right. If a symbol `per` is given, the requirement is on the expression times this symbol.
    """

    what: str
    expression: Any
    like: Any
    per: Any = None

    def wanted(self, known: Mapping[Any, Dimension]) -> Dimension | None:
        """Return the required dimension of the expression; None if any is right, or if it is not known yet."""
        whole = named(self.like) if isinstance(self.like, str) else known.get(self.like)
        if whole is None or self.per is None:
            return whole
        return whole * known[self.per] ** Fraction(-1) if self.per in known else None


def in_short(term: Any, plain: Mapping[Any, Any]) -> str:
    """Return a term as text for messages, in plain symbols, with tables by name, cut to 80 characters."""
    named_tables = term.replace(
        lambda node: table_range(node) is not None, lambda node: sympy.Function("table")(node.args[0].cond.args[0].lhs)
    )
    shorthands = {f: sympy.Symbol(name_of(f)) for f in term.atoms(AppliedUndef) if is_shorthand(f)}
    return str(named_tables.xreplace({**plain, **shorthands}))[:80]


def number_of(exponent: Any) -> Fraction | None:
    """Return an exponent of a power as a fraction, None if it is not a number."""
    if exponent.is_Rational:
        return Fraction(int(exponent.p), int(exponent.q))
    return Fraction(float(exponent)).limit_denominator(1000) if exponent.is_Float else None


def inner_parts(expression: Any, dimension: Dimension | None) -> Iterator[tuple[Any, Dimension | None]]:
    """Yield (argument of a function or branch of a Piecewise, its required dimension or None if any is right).

    `dimension` is the required dimension of the whole expression. The argument of a table is dimensionless.
    Quantities that are compared, such as both sides of a condition, are yielded as their difference.
    """
    if (table := table_range(expression)) is not None:
        yield table[0], DIMENSIONLESS
    elif isinstance(expression, sympy.Piecewise):
        for pair in expression.args:
            yield pair.expr, dimension
            for condition in pair.cond.atoms(sympy.core.relational.Relational):
                yield condition.lhs - condition.rhs, None
    elif isinstance(expression, sympy.atan2):
        above, below = expression.args
        yield above - below, None
    elif isinstance(expression, (sympy.sign, sympy.Heaviside)):
        yield expression.args[0], None
    elif not isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Derivative, sympy.Subs)):
        for argument in expression.args:
            yield argument, DIMENSIONLESS


def without_own_numbers(expression: Any, is_time: Callable[[Any], bool], is_ratio: Callable[[Any], bool]) -> Any:
    """Return an expression without parts that contain only numbers and t: the units of such numbers are not stated.

    Such terms are left out, and such factors are replaced by 1: `a*sin(2*t) + 0.1` becomes a, an event `x - 3` is x.
    Two kinds of such terms stay, because they need no unit: multiples of t beside terms that are times, as in `t - a`,
    and numbers beside ratios of quantities, as in `x/a - 1`. `is_time` and `is_ratio` return True for the terms beside
    them.
    """

    def without(node: Any) -> Any:
        if not node.is_Add:
            return sympy.S.One
        left = [term for term in node.args if not _own(term)]
        if any(map(is_time, left)):
            left += [term for term in node.args if is_multiple_of_time(term)]
        elif any(map(is_ratio, left)):
            left += [term for term in node.args if term.is_number]
        return sympy.Add(*left) if left else sympy.S.One

    return sympy.S.Zero if _own(expression) else expression.replace(_replaced, without)


def is_multiple_of_time(term: Any) -> bool:
    """Return True for a number times t."""
    return bool((term / t).is_number)


def _own(node: Any) -> bool:
    """Return True if a SymPy expression contains only numbers and t."""
    return node.free_symbols <= {t} and not node.has(AppliedUndef)


def _replaced(node: Any) -> bool:
    return node.is_Add or (isinstance(node, (sympy.Function, sympy.Piecewise)) and _own(node))


class UnitFactor(NamedTuple):
    """An unknown of the linear equations: the scale factor of the unit of `of`.

    `of` is a symbol, or a required quantity such as "energy".
    """

    of: Any


@dataclass(frozen=True)
class UnitProduct:
    """A unit as a product of powers of base dimensions, unknown symbols and unknown factors, without zero powers.

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
        """Return the product of this unit and a power of another one."""
        powers = dict(self.powers)
        for name, exponent in other.powers.items():
            powers[name] = powers.get(name, Fraction(0)) + power * exponent
        left = {name: exponent for name, exponent in powers.items() if exponent}
        return UnitProduct(left, self.logarithm + float(power) * other.logarithm)

    def unknown(self, kind: type) -> Any:
        """Return an unknown of this unit that is of class `kind`, a symbol or a `UnitFactor`; None if there is none."""
        return next((name for name in self.powers if isinstance(name, kind)), None)


class OtherUnitError(Exception):
    """Error: a term has another unit than required. `ratio` is the logarithm of the factor between both units.

    `within` is the function of whose argument the term is, or None.
    """

    def __init__(self, term: Any, ratio: float, within: Any) -> None:
        super().__init__()
        self.term, self.ratio, self.within = term, ratio, within


class UnitEquations:
    """Equations between units of expressions, and the values of the unknowns that they determine.

    `dimensions` are the known dimensions by symbol. If `strict`, a term in another unit raises OtherUnitError. Else
    contradictions are ignored: the first equation decides.
    """

    def __init__(self, dimensions: Mapping[Any, Dimension], *, strict: bool = False) -> None:
        self.dimensions, self.strict = dimensions, strict
        self.solved: dict[Any, UnitProduct] = {}
        self.units: dict[Any, UnitProduct | None] = {}

    def require(self, part: CheckedPart) -> None:
        """Add the equation that the expression of `part` has its required unit."""
        required = self._required(part)
        try:
            unit = self.unit(part.expression)
        except OtherUnitError as wrong:
            # In a reset such as u = u + t, the term u and the required unit count once: both are the unit of u.
            own_reset = part.like in part.expression.args
            if own_reset or not part.expression.is_Add or wrong.term not in part.expression.args:
                raise
            raise self._odd_term(wrong, part.expression.args, required) from None
        if unit is not None and required is not None:
            self._equate(sympy.Add.make_args(part.expression)[0], unit, required)

    def _required(self, part: CheckedPart) -> UnitProduct | None:
        """Return the unit that the expression of `part` must have; None if any is right."""
        if part.like is None:
            return None
        required = UnitProduct.of(named(part.like), part.like) if isinstance(part.like, str) else self.unit(part.like)
        over = UnitProduct() if part.per is None else self.unit(part.per)
        return None if required is None or over is None else required.times(over, Fraction(-1))

    def dimension(self, expression: Any) -> Dimension | None:
        """Return the dimension of an expression; None if it is undetermined, or if the expression is zero."""
        unit = self.unit(expression)
        unit = None if unit is None else self._reduced(unit)
        if unit is None or unit.unknown(sympy.Basic) is not None:
            return None
        exponents = {name: power for name, power in unit.powers.items() if isinstance(name, str)}
        return Dimension.of(exponents, None if unit.unknown(UnitFactor) is not None else unit.logarithm)

    def unit(self, expression: Any) -> UnitProduct | None:
        """Return the unit of an expression; None for zero, which fits every unit."""
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
        if expression.is_Pow:
            return self._power(expression.base, expression.exp)
        if expression.is_Add or isinstance(expression, SAME_DIMENSION):
            return self._common(expression.args)
        return self._function(expression)

    def _product(self, factors: Sequence[tuple[Any, Fraction]]) -> UnitProduct | None:
        """Return the unit of a product of powers; `factors` are pairs of base and exponent."""
        total = UnitProduct()
        for factor, power in factors:
            unit = self.unit(factor)
            if unit is None:
                return None
            total = total.times(unit, power)
        return total

    def _power(self, base: Any, exponent: Any) -> UnitProduct | None:
        power = number_of(exponent)
        if power is not None:
            return self._product([(base, power)])
        self._number(exponent)
        self._number(base)
        return UnitProduct()

    def _common(self, terms: Sequence[Any]) -> UnitProduct | None:
        """Add the equations that all terms have the same unit, and return this unit; None if all terms are zero."""
        first = None
        for term in terms:
            unit = self.unit(term)
            if first is not None and unit is not None:
                try:
                    self._equate(term, unit, first)
                except OtherUnitError as wrong:
                    raise self._odd_term(wrong, terms, None) from None
            first = unit if first is None else first
        return first

    def _odd_term(self, wrong: OtherUnitError, terms: Sequence[Any], required: UnitProduct | None) -> OtherUnitError:
        """Return the error for the one term of a sum whose unit differs from that of all others.

        `required` is the unit that the sum must have, if known. If there is no such term, the error is `wrong`, which
        names the first term whose unit differs from that of the first one. Terms of unknown unit do not count.
        """
        try:
            units = [(term, self.unit(term)) for term in terms]
        except OtherUnitError:  # a later term is wrong in itself
            return wrong
        known = [(term, self._reduced(unit)) for term, unit in (*units, (None, required)) if unit is not None]
        logarithms = [
            (term, unit.logarithm) for term, unit in known if all(isinstance(name, str) for name in unit.powers)
        ]
        for term, logarithm in logarithms:
            others = [other for another, other in logarithms if another is not term]
            agree = len(others) > 1 and max(others) - min(others) <= SAME_FACTOR
            if term is not None and agree and abs(logarithm - others[0]) > SAME_FACTOR:
                return OtherUnitError(term, logarithm - others[0], None)
        return wrong

    def _function(self, expression: Any) -> UnitProduct | None:
        """Return the unit of a function or a Piecewise."""
        for argument, dimension in inner_parts(expression, None):
            if dimension is None:
                self.unit(argument)
            else:
                self._number(argument, expression)
        if isinstance(expression, sympy.Piecewise) and table_range(expression) is None:
            return self._common([pair.expr for pair in expression.args])
        return UnitProduct()

    def _number(self, expression: Any, within: Any = None) -> None:
        """Add the equation that an expression, such as the argument of the function `within`, is dimensionless."""
        unit = self.unit(expression)
        if unit is not None:
            self._equate(sympy.Add.make_args(expression)[0], unit, UnitProduct(), within)

    def _reduced(self, unit: UnitProduct) -> UnitProduct:
        """Return a unit in which each unknown with a determined value is replaced by this value."""
        while (known := next((name for name in unit.powers if name in self.solved), None)) is not None:
            power = unit.powers[known]
            unit = unit.times(UnitProduct({known: power}), Fraction(-1)).times(self.solved[known], power)
        return unit

    def _equate(self, term: Any, unit: UnitProduct, other: UnitProduct, within: Any = None) -> None:
        """Add the equation that two units are equal, and solve it for one of its unknowns.

        Without unknowns, units that differ raise OtherUnitError if the check is strict. The error names `term`, and the
        function `within` that has it in its argument.
        """
        ratio = self._reduced(unit.times(other, Fraction(-1)))
        unknown = ratio.unknown(sympy.Basic)
        if unknown is None and ratio.unknown(str) is None:
            unknown = ratio.unknown(UnitFactor)
            if unknown is None and self.strict and abs(ratio.logarithm) > SAME_FACTOR:
                raise OtherUnitError(term, ratio.logarithm, within)
        if unknown is not None:
            power = ratio.powers[unknown]
            rest = ratio.times(UnitProduct({unknown: power}), Fraction(-1))
            self.solved[unknown] = UnitProduct().times(rest, -1 / power)
