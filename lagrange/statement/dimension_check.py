"""Whether every term of a statement has the dimension that it must have; the first one that has not is named.

Sizes that were not stated are found where they can be: all terms of a sum have one size, functions have arguments
without one, energies are energies. Those are linear equations for exponents, solved as they come. Then every term is
looked at again with all sizes known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError
from lagrange.statement.coordinate import name_of, t
from lagrange.statement.dimension import NONE, Exponents, Size, check_names, named, read_dimensions
from lagrange.statement.statement import Statement

ONE_SIZE = (sympy.Abs, sympy.Min, sympy.Max)
"""Functions whose value has the size of their arguments."""

MOST_PASSES = 20
"""Passes over a statement in which unknown sizes are found; each finds some, or is the last."""


@dataclass(frozen=True)
class CheckedPart:
    """An expression of a statement, what it is called, and the size it must have, None for any.

    With `per`, a coordinate, the size is that of the expression times the coordinate.
    """

    what: str
    expression: Any
    size: Size | None
    per: Any = None

    def wanted(self, known: Mapping[Any, Size]) -> Size | None:
        """Return the size that the expression must have, None for any or where that of the coordinate is not known."""
        if self.size is None or self.per is None:
            return self.size
        return self.size * known[self.per] ** Fraction(-1) if self.per in known else None


class WrongTermError(Exception):
    """A term whose size is not what it must be: as a "whole", in a "sum", under a "power", or in a "function"."""

    def __init__(self, term: Any, found: Size, wanted: Size, place: str, within: Any = None) -> None:
        super().__init__()
        self.term, self.found, self.wanted, self.place, self.within = term, found, wanted, place, within


def with_dimensions(statement: Statement, given: Mapping[Any, Any]) -> Statement:
    """Return the statement with the dimensions of its symbols. Raises StatementError with the first wrong term."""
    known = {"t": t, **dict(zip(statement.names, statement.coordinates, strict=True))}
    known |= {symbol.name: symbol for symbol in statement.parameters}
    known |= {name_of(function): function for function in statement.given}
    stated = read_dimensions(given, known)
    sizes = check_dimensions(_parts(statement, named("energy")), stated, statement.plain)
    check_names(given, known)
    return replace(statement, dimensions=MappingProxyType(sizes))


def _parts(statement: Statement, energy: Size) -> list[CheckedPart]:
    """Return every expression of a statement with the size that it must have; a force on q is energy over q."""
    alone = statement.potential == 0 and statement.kinetic == statement.lagrangian
    energies = {"the Lagrangian": statement.lagrangian}
    if not alone:
        energies = {"the kinetic energy": statement.kinetic, "the potential energy": statement.potential}
    parts = [CheckedPart(what, expression, energy) for what, expression in energies.items()]
    parts += [
        CheckedPart(f"the force on {name}", force, energy, q)
        for name, q, force in zip(statement.names, statement.coordinates, statement.forces, strict=True)
        if force != 0
    ]
    parts += [CheckedPart("the dissipation", statement.dissipation, energy * named("time") ** Fraction(-1))]
    parts += [CheckedPart(f"the constraint {one.name}", one.expression, None) for one in statement.constraints]
    for label, point in statement.positions.items():
        parts += [CheckedPart(f"the position of {label}", entry, named("length")) for entry in point]
    return parts


def check_dimensions(
    parts: Sequence[CheckedPart], sizes: Mapping[Any, Size], plain: Mapping[Any, Any]
) -> dict[Any, Size]:
    """Return the sizes of all symbols that are known or can be found; `plain` are the symbols of messages.

    Raises StatementError with the wrong term.
    """
    known = {t: named("second"), **sizes}
    _find(parts, known, whole=False)
    _find(parts, known, whole=True)
    # The units of the first part that has a size are those of the others with the same size.
    chosen: dict[Exponents, Size] = {}
    for part in parts:
        wanted = part.wanted(known)
        if wanted is not None:
            wanted = chosen.get(wanted.exponents, wanted)
        try:
            found = _Checker(known).check(part.expression, wanted)
        except WrongTermError as wrong:
            raise StatementError(_refusal(part, wrong, plain)) from None
        if found is not None and wanted is not None:
            chosen[wanted.exponents] = found
    return known


def _find(parts: Sequence[CheckedPart], known: dict[Any, Size], *, whole: bool) -> None:
    """Find sizes of symbols: from arguments of functions and sums alone, or also from what the parts must be."""
    for _ in range(MOST_PASSES):
        before = len(known)
        for part in parts:
            _Finder(known).visit(part.expression, part.wanted(known) if whole else None)
        if len(known) == before:
            return


def _refusal(part: CheckedPart, wrong: WrongTermError, plain: Mapping[Any, Any]) -> str:
    """Return what is wrong with a term, in plain symbols."""
    term = wrong.term.xreplace(plain)
    if wrong.found.exponents == wrong.wanted.exponents:
        return (
            f"{part.what} has the term {term} in other units than the terms it is compared with: state all symbols in "
            "units that fit together, such as kg, m and s, and angles in rad."
        )
    place = {"whole": "", "sum": "beside the other terms ", "power": "under a power that is no number "}
    where = place[wrong.place] if wrong.place in place else f"in {wrong.within.xreplace(plain)} "
    terms = sympy.Add.make_args(part.expression)
    outer = next((one for one in terms if wrong.term not in terms and one.has(wrong.term)), None)
    inside = (
        "" if outer is None or wrong.term.is_number or wrong.place == "function" else f", in {outer.xreplace(plain)}"
    )
    has = f"{part.what} has the term {term}{inside}, whose dimension is {wrong.found}"
    return f"{has}; {where}it should be {wrong.wanted}."


class _Sizes:
    """Sizes of expressions from those of their symbols; None where one is not known, and for zero."""

    def __init__(self, known: dict[Any, Size]) -> None:
        self.known = known

    def size(self, expression: Any) -> Size | None:
        """Return the size of an expression, that of the first known term for a sum."""
        if expression in self.known:
            return self.known[expression]
        if expression.is_number:
            return None if expression.is_zero else NONE
        if isinstance(expression, sympy.Derivative):
            return self._rate(expression)
        if expression.is_Mul:
            return self._product(expression.args)
        if expression.is_Pow:
            return self._power(*expression.args)
        if expression.is_Add or isinstance(expression, ONE_SIZE):
            return self._first(expression.args)
        if isinstance(expression, sympy.Piecewise):
            return self._first([pair.expr for pair in expression.args])
        if isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Subs)):
            return None
        return NONE

    def _first(self, terms: Sequence[Any]) -> Size | None:
        return next((size for size in map(self.size, terms) if size is not None), None)

    def _rate(self, derivative: Any) -> Size | None:
        base, by = self.size(derivative.expr), self._product(derivative.variables)
        return None if base is None or by is None else base * by ** Fraction(-1)

    def _product(self, factors: Sequence[Any]) -> Size | None:
        total = NONE
        for factor in factors:
            size = self.size(factor)
            if size is None:
                return None
            total = total * size
        return total

    def _power(self, base: Any, exponent: Any) -> Size | None:
        size, power = self.size(base), number_of(exponent)
        if size is None or power is None:
            return NONE if size is not None and not size.exponents else None
        return size**power


class _Finder(_Sizes):
    """Finds sizes that were not stated, from what they stand beside."""

    def visit(self, expression: Any, size: Size | None) -> None:
        """Go through an expression that has a size, or an unknown one."""
        if size is None:
            size = self.size(expression)
        if isinstance(expression, (sympy.Symbol, AppliedUndef)):
            if size is not None:
                self.known.setdefault(expression, Size(size.exponents, None if size.exponents else 0.0))
        elif isinstance(expression, sympy.Derivative):
            by = self._product(expression.variables)
            if size is not None and by is not None:
                self.visit(expression.expr, size * by)
        elif expression.is_Add or isinstance(expression, ONE_SIZE):
            for term in expression.args:
                self.visit(term, size)
        elif expression.is_Mul:
            self._factors(expression.args, size)
        elif expression.is_Pow:
            self._base(expression.base, expression.exp, size)
        else:
            for argument, wanted in inner_parts(expression, size):
                self.visit(argument, wanted)

    def _factors(self, factors: Sequence[Any], size: Size | None) -> None:
        """Find the size of the one factor whose size is not known, if there is just one."""
        unknown = [factor for factor in factors if self.size(factor) is None]
        for factor in factors:
            if factor not in unknown:
                self.visit(factor, None)
        if size is None or len(unknown) != 1:
            for factor in unknown:
                self.visit(factor, None)
            return
        others = self._product([factor for factor in factors if factor not in unknown])
        self.visit(unknown[0], None if others is None else size * others ** Fraction(-1))

    def _base(self, base: Any, exponent: Any, size: Size | None) -> None:
        power = number_of(exponent)
        self.visit(base, size ** (1 / power) if power and size is not None else None)
        if power is None:
            self.visit(exponent, NONE)


class _Checker(_Sizes):
    """Finds the term whose size is not what it must be."""

    def check(self, expression: Any, wanted: Size | None) -> Size | None:
        """Return the size of an expression. Raises WrongTermError for a part that does not fit."""
        if expression.is_Add or isinstance(expression, ONE_SIZE):
            return self._sum(expression, wanted)
        size = self._single(expression, wanted)
        if size is not None and wanted is not None and not size.fits(wanted):
            raise WrongTermError(expression, size, wanted, "whole")
        return size

    def _sum(self, expression: Any, wanted: Size | None) -> Size | None:
        """Return the size of a sum; of terms that differ, those that are not as wanted, or as most, are wrong."""
        sizes = [(term, self._inside(term, wanted)) for term in expression.args]
        found = [(term, size) for term, size in sizes if size is not None]
        if not found:
            return None
        if wanted is not None and any(size.fits(wanted) for _, size in found):
            right = wanted
        else:
            right = max((size for _, size in found), key=lambda size: sum(size.fits(other) for _, other in found))
        for term, size in found:
            if not size.fits(right):
                raise WrongTermError(term, size, right, "sum")
        if wanted is not None and not right.fits(wanted):
            raise WrongTermError(found[0][0], right, wanted, "whole")
        return next((size for _, size in found if size.factor is not None), right)

    def _inside(self, term: Any, wanted: Size | None) -> Size | None:
        """Return the size of a term, after its own parts; those are held to what is wanted only where they differ."""
        return self._single(term, wanted) if not (term.is_Add or isinstance(term, ONE_SIZE)) else self.check(term, None)

    def _single(self, expression: Any, wanted: Size | None) -> Size | None:
        if expression.is_Mul:
            return self._checked_product(expression, wanted)
        if expression.is_Pow:
            self._powered(expression.base, expression.exp, wanted)
            return self.size(expression)
        for argument, size in inner_parts(expression, wanted):
            self._argument(expression, argument, size)
        return self.size(expression)

    def _argument(self, expression: Any, argument: Any, size: Size | None) -> None:
        try:
            self.check(argument, size)
        except WrongTermError as wrong:
            if wrong.place != "whole":
                raise
            raise WrongTermError(wrong.term, wrong.found, wrong.wanted, "function", expression) from None

    def _checked_product(self, expression: Any, wanted: Size | None) -> Size | None:
        """Return the size of a product; a sum in it is looked at with the size that the other factors leave for it."""
        for factor in expression.args:
            others = self._product([one for one in expression.args if one is not factor])
            left = None if wanted is None or others is None else wanted * others ** Fraction(-1)
            if factor.is_Pow:
                self._powered(factor.base, factor.exp, left)
            else:
                self.check(factor, left if self._differs(factor) else None)
        return self.size(expression)

    def _powered(self, base: Any, exponent: Any, wanted: Size | None) -> None:
        """Check a power: what is wanted of it decides only between terms of the base that differ."""
        power = number_of(exponent)
        if power is None:
            self.check(exponent, NONE)
            size = self.size(base)
            if size is not None and size.exponents:
                raise WrongTermError(base, size, NONE, "power")
        self.check(base, wanted ** (1 / power) if power and wanted is not None and self._differs(base) else None)

    def _differs(self, expression: Any) -> bool:
        """Return whether an expression is a sum of terms with different sizes."""
        if not expression.is_Add:
            return False
        known = [size for size in map(self.size, expression.args) if size is not None]
        return any(not size.fits(known[0]) for size in known)


def number_of(exponent: Any) -> Fraction | None:
    """Return an exponent as a fraction, None for one that is no number."""
    if exponent.is_Rational:
        return Fraction(int(exponent.p), int(exponent.q))
    return Fraction(float(exponent)).limit_denominator(1000) if exponent.is_Float else None


def inner_parts(expression: Any, size: Size | None) -> Iterator[tuple[Any, Size | None]]:
    """Yield the arguments of a function, or the branches of a Piecewise, with the sizes that they must have."""
    if isinstance(expression, sympy.Piecewise):
        for pair in expression.args:
            yield pair.expr, size
            for condition in pair.cond.atoms(sympy.core.relational.Relational):
                yield condition.lhs - condition.rhs, None
    elif isinstance(expression, sympy.atan2):
        above, below = expression.args
        yield above - below, None
    elif isinstance(expression, (sympy.sign, sympy.Heaviside)):
        yield expression.args[0], None
    elif not isinstance(expression, (sympy.Symbol, AppliedUndef, sympy.Derivative, sympy.Subs)):
        for argument in expression.args:
            yield argument, NONE
