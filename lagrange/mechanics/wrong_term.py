"""Which term of a wrong equation of motion is wrong, in words.

The equation is compared with those that it may be meant to be: an Euler-Lagrange equation or a solved acceleration,
times a factor, or the combination of all that has its accelerations. Both are sorted by products of accelerations,
velocities and multipliers. The factor is that on which most of the coefficients agree, and the meant equation is the
one with the fewest terms that differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.laws import solve
from lagrange.evidence.operations import OutsideDomain
from lagrange.mechanics.equation_row import HELD, EquationRow, tape, unknowns_of, values_at
from lagrange.mechanics.motion_samples import MotionSample
from lagrange.mechanics.student_equations import spelled
from lagrange.statement.statement import Statement

Numbers = list[Any]

MOST_TERMS = 2_000
"""Terms of an expanded equation above which no term is named."""

NEAR = 0.5
"""An Euler-Lagrange equation is meant where at most so many terms differ for each product that agrees."""

LONGEST_FORMULA = 3_000
"""Operations of a solved acceleration above which it is not compared: expanding it would take seconds."""

BENT = 2
"""A factor that depends on the state counts as so many terms that differ."""

SINGULAR = 1e-12
"""Pivot, relative to its row, from which a mass matrix is not solved."""

LARGEST_FACTOR = 1000
"""Largest denominator of a factor that is told as a fraction."""


def wrong_term(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample]) -> str:
    """Return a sentence that names the first wrong term of an equation that does not hold."""
    label = f"{row.label[0].upper()}{row.label[1:]}"
    if not any(row.slopes.values()):
        return f"{label} does not hold, and contains no acceleration: it is no equation of motion."
    given = _Sorted.of(row.zero, row.statement, samples)
    if given is None:
        return f"{label} does not hold."
    meant = _nearest(given, _candidates(given, _stated_rows(derivation)))
    if meant is None or meant.differing_terms > NEAR * meant.agreeing:
        others = (*_combined(row, given, derivation), *_candidates(given, _solved_rows(derivation)))
        found = [one for one in (meant, _nearest(given, others)) if one is not None]
        meant = min(found, key=_rank, default=None)
    if meant is None or not meant.agreeing:
        return f"{label} does not hold, and no term of it is that of an equation of motion."
    return meant.sentence(row)


@dataclass(frozen=True, eq=False)
class _Sorted:
    """An equation by products of accelerations, velocities and multipliers, {product: coefficient}, and its values."""

    statement: Statement
    samples: Sequence[MotionSample]
    coefficients: Mapping[Any, Any]

    @classmethod
    def of(cls, zero: Any, statement: Statement, samples: Sequence[MotionSample]) -> _Sorted | None:
        """Return an equation sorted, None where it is too long or has no values at the samples."""
        kept = _by_product(zero, statement)
        if kept is None:
            return None
        usable = [one for one in samples if _values(list(kept.values()), statement, [one]) is not None]
        return cls(statement, usable, kept) if usable else None

    @cached_property
    def values(self) -> Mapping[Any, Numbers]:
        """The coefficients at the samples."""
        found = _values(list(self.coefficients.values()), self.statement, self.samples)
        return dict(zip(self.coefficients, found or [], strict=True))

    @cached_property
    def terms(self) -> Mapping[Any, list[Numbers]]:
        """The terms of each coefficient at the samples."""
        listed = [(product, one) for product, whole in self.coefficients.items() for one in sympy.Add.make_args(whole)]
        values = _values([term for _, term in listed], self.statement, self.samples)
        found: dict[Any, list[Numbers]] = {}
        for (product, _), value in zip(listed, values or [], strict=True):
            found.setdefault(product, []).append(value)
        return found

    def numbers(self, expression: Any) -> Numbers | None:
        """Return the values of another expression at the samples, None where it has none."""
        found = _values([expression], self.statement, self.samples)
        return None if found is None else found[0]


def _by_product(zero: Any, statement: Statement) -> dict[Any, Any] | None:
    """Return the coefficients of the products of an expanded sum, None where it has too many terms."""
    moving = (*list(statement.plain.values())[1::3], *unknowns_of(statement))
    terms = sympy.Add.make_args(sympy.expand(zero))
    if len(terms) > MOST_TERMS:
        return None
    found: dict[Any, Any] = {}
    for term in terms:
        coefficient, product = term.as_independent(*moving, as_Add=False)
        found[product] = found.get(product, 0) + coefficient
    return {product: value for product, value in found.items() if value != 0}


def _side(row: EquationRow, product: Any, there: Any) -> tuple[str, int]:
    """Return words for the side on which a term stands or belongs, and -1 for the right side, else 1.

    The sign turns a coefficient of `row.zero` into the one that was typed. A missing term belongs on the right side if
    the left one has nothing but accelerations, as in a solved equation.
    """
    right = _by_product(row.right, row.statement) or {}
    left = _by_product(row.zero + row.right, row.statement) or {}
    if not right:
        return "", 1
    if there == 0:
        solved = all(one.has(*unknowns_of(row.statement)) for one in left)
        return (" on the right side", -1) if solved else ("", 1)
    if product not in left and right.get(product) == -there:
        return " on the right side", -1
    return ("", 1) if product not in right else (" with all terms on the left", 1)


def _values(expressions: Sequence[Any], statement: Statement, samples: Sequence[MotionSample]) -> list[Numbers] | None:
    """Return the values of expressions at some states, None where one has none."""
    try:
        made = tape(expressions, statement)
        columns = [values_at(made, sample) for sample in samples]
    except OutsideDomain:
        return None
    return [list(row) for row in zip(*columns, strict=True)] if columns else None


@dataclass(frozen=True, eq=False)
class _Factor:
    """What an expected equation is multiplied by: its values at the samples, and the product that it was found on."""

    values: Numbers
    product: Any

    @property
    def constant(self) -> Fraction | None:
        """The factor as a short fraction, if it is the same at all states."""
        return _constant(self.values)


Candidate = tuple[str, _Sorted, _Factor]
"""An equation that may be meant: the name of its coordinate, and what it is multiplied by."""


def _nearest(given: _Sorted, candidates: Iterable[Candidate]) -> _Meant | None:
    """Return the candidate that an equation differs least from, None if there are none."""
    return min(
        (_Meant(name, given, expected, factor) for name, expected, factor in candidates), key=_rank, default=None
    )


def _candidates(given: _Sorted, rows: Sequence[tuple[str, Any]]) -> Iterator[Candidate]:
    """Yield equations that may be meant, by the coordinate they belong to, with every factor that one may have."""
    statement = given.statement
    for name, zero in rows:
        expected = _Sorted.of(zero.xreplace(statement.plain), statement, given.samples)
        if expected is None or len(expected.samples) < len(given.samples):
            continue
        for product in expected.coefficients:
            if product in given.coefficients:
                below = expected.values[product]
                if all(below):
                    ratio = [a / b for a, b in zip(given.values[product], below, strict=True)]
                    yield name, expected, _Factor(ratio, product)


def _combined(row: EquationRow, given: _Sorted, derivation: Derivation) -> Iterator[Candidate]:
    """Yield the sum of equations with constant weights that has the accelerations of the given one."""
    weights: list[Numbers] = []
    for sample in given.samples:
        try:
            slopes, _ = row.numbers(sample)
            weights.append(solve(sample.mass, [slopes[: len(sample.mass)]], SINGULAR)[0])
        except OutsideDomain:
            return
    constants = [_constant(list(column)) for column in zip(*weights, strict=True)]
    used = [i for i, weight in enumerate(constants) if weight != 0]
    stated = _stated_rows(derivation)
    if len(used) < 2 or None in constants or not stated:
        return
    zero = sympy.Add(*(_rational(constants[i] or Fraction(0)) * stated[i][1] for i in used))
    expected = _Sorted.of(zero.xreplace(given.statement.plain), given.statement, given.samples)
    if expected is not None and len(expected.samples) == len(given.samples):
        one = [sample.accelerations[0] * 0 + 1 for sample in given.samples]
        yield f"{listing(stated[i][0] for i in used)} together", expected, _Factor(one, None)


def _stated_rows(derivation: Derivation) -> list[tuple[str, Any]]:
    """Return the Euler-Lagrange equations by coordinate, none where they are too large to be written out."""
    try:
        laws = derivation.equations
    except StatementError:
        return []
    return [(name, law.lhs - law.rhs) for name, law in zip(derivation.statement.names, laws, strict=True)]


def _solved_rows(derivation: Derivation) -> list[tuple[str, Any]]:
    """Return the equations solved for each acceleration, none where they are too long to be compared."""
    statement = derivation.statement
    try:
        solved = list(derivation.accelerations.values())
    except StatementError:
        return []
    symbols = list(statement.plain.values())[2::3]
    rows = zip(statement.names, symbols, solved, strict=True)
    return [(name, symbol - one) for name, symbol, one in rows if one.count_ops() <= LONGEST_FORMULA]


class _Meant:
    """An equation that may be meant, times a factor, and where the given one differs from it."""

    def __init__(self, name: str, given: _Sorted, expected: _Sorted, factor: _Factor) -> None:
        self.name, self.expected, self.given, self.factor = name, expected, given, factor
        products = [*expected.coefficients, *(one for one in given.coefficients if one not in expected.coefficients)]
        self.differing = [one for one in products if not self._agrees(one)]
        self.agreeing = len(products) - len(self.differing)
        self.differing_terms = sum(map(self._terms, self.differing))

    @property
    def bent(self) -> bool:
        """Whether the factor depends on the state: equations are seldom multiplied by such a factor."""
        if self.factor.constant is not None:
            return False
        rows, places = (self.given, self.expected), list(self.given.statement.plain.values())[::3]
        return any(row.coefficients[self.factor.product].has(*places) for row in rows)

    def _terms(self, product: Any) -> int:
        """Return how many terms before a product are not those that are expected."""
        factor, left = self.factor.values, list(self.given.terms.get(product, []))
        missing = 0
        for term in self.expected.terms.get(product, []):
            wanted = [c * x for c, x in zip(factor, term, strict=True)]
            same = next((one for one in left if _same(one, wanted)), None)
            if same is None:
                missing += 1
            else:
                left.remove(same)
        return max(len(left), missing, 1)

    def _wanted(self, product: Any) -> Numbers:
        zero = [0] * len(self.factor.values)
        return [c * r for c, r in zip(self.factor.values, self.expected.values.get(product, zero), strict=True)]

    def _agrees(self, product: Any) -> bool:
        there = self.given.values.get(product, [0] * len(self.factor.values))
        return _same(there, self._wanted(product))

    @cached_property
    def multiple(self) -> Any:
        """The factor as an expression."""
        constant = self.factor.constant
        if constant is not None:
            return sympy.Rational(constant.numerator, constant.denominator)
        product = self.factor.product
        return sympy.cancel(self.given.coefficients[product] / self.expected.coefficients[product])

    def sentence(self, row: EquationRow) -> str:
        """Return what is wrong with the first product that differs."""
        product = self.differing[0]
        there = self.given.coefficients.get(product, sympy.S.Zero)
        wanted = sympy.expand(self.multiple * self.expected.coefficients.get(product, sympy.S.Zero))
        of = "" if self.name in row.label else f", that of {self.name},"
        extra = [one for one in self.differing if one not in self.expected.coefficients]
        if there == 0 and len(extra) == 1:
            instead = self.given.coefficients[extra[0]]
            side, sign = _side(row, extra[0], instead)
            return (
                f"In {row.label}{of}{side} the term {spelled(sign * instead * extra[0])} is wrong: it should be "
                f"{spelled(sign * wanted * product)}."
            )
        side, sign = _side(row, product, there)
        difference = _difference(product, sign * there, sign * wanted, self.given.numbers)
        return f"In {row.label}{of}{side} {difference}"


def _rank(meant: _Meant) -> tuple[Any, ...]:
    """Fewest differing terms first, then most agreeing products, then the simplest factor."""
    constant = meant.factor.constant
    simple = (1, -1).index(int(constant)) if constant in (1, -1) else 2 if constant is not None else 3
    accelerates = 0 if meant.factor.product in unknowns_of(meant.given.statement) else 1
    return meant.differing_terms + BENT * meant.bent, -meant.agreeing, simple, accelerates


def _difference(
    product: Any, there: Any, wanted: Any, numbers: Callable[[Any], Numbers | None], *, part: bool = False
) -> str:
    """Return how the coefficient of a product, or a part of it, differs from what it should be."""

    def text(coefficient: Any) -> str:
        return spelled(coefficient * product)

    def named(coefficient: Any) -> str:
        return f"the {'sum' if (coefficient * product).is_Add else 'term'} {text(coefficient)}"

    def known(coefficient: Any) -> str:
        return named(coefficient) if part or product == 1 else f"the term with {spelled(product)}"

    if there == 0:
        return f"{named(wanted)} is missing."
    if wanted == 0:
        return f"{named(there)} should not be there."
    ratio = _ratio(numbers(there), numbers(wanted))
    if ratio is not None:
        return _scaled(known(there), ratio, text(there), text(wanted))
    off = numbers(there - wanted)
    for summands in (sympy.Add.make_args, _opened):
        for one in summands(wanted):
            factor = _ratio(off, numbers(one))
            if factor == -1:
                return f"the term {text(one)} is missing."
            if factor is not None:
                return _scaled(f"the term {text(one)}", factor + 1, text(one * _rational(factor + 1)), text(one))
        for one in summands(there):
            if _ratio(off, numbers(one)) == 1:
                return f"the term {text(one)} should not be there."
        for one in summands(there):
            for other in summands(wanted):
                if one != other and _ratio(off, numbers(one - other)) == 1:
                    return f"the term {text(one)} is wrong: it should be {text(other)}."
    right = [one for one in sympy.Add.make_args(there) if one in sympy.Add.make_args(wanted)]
    if right:
        return _difference(product, there - sympy.Add(*right), wanted - sympy.Add(*right), numbers, part=True)
    if part or product == 1:
        return f"{known(there)} is wrong: it should be {text(wanted)}."
    return f"{known(there)} is wrong: it is {text(there)}, and should be {text(wanted)}."


def _opened(expression: Any) -> tuple[Any, ...]:
    """Return the terms of a sum whose sines and cosines of sums are written out."""
    found: tuple[Any, ...] = sympy.Add.make_args(sympy.expand(sympy.expand_trig(expression)))
    return found


def _scaled(what: str, ratio: Fraction, there: str, wanted: str) -> str:
    if ratio == -1:
        return f"{what} has the wrong sign: it is {there}, and should be {wanted}."
    return f"{what} has the wrong factor: it is {there}, {ratio} times what it should be, {wanted}."


def _ratio(above: Numbers | None, below: Numbers | None) -> Fraction | None:
    """Return the constant ratio of two expressions by their values, None where there is none."""
    if above is None or below is None or not all(below):
        return None
    return _constant([a / b for a, b in zip(above, below, strict=True)])


def _constant(values: Numbers) -> Fraction | None:
    """Return the short fraction that all values are, None where they are not."""
    found = Fraction(str(values[0])).limit_denominator(LARGEST_FACTOR)
    return found if _same(values, [values[0] * 0 + found.numerator] * len(values), found.denominator) else None


def _same(left: Numbers, right: Numbers, times: int = 1) -> bool:
    """Return whether times * left and right agree at all states."""
    return all(abs(times * a - b) <= HELD * (abs(times * a) + abs(b)) for a, b in zip(left, right, strict=True))


def _rational(value: Fraction) -> Any:
    return sympy.Rational(value.numerator, value.denominator)
