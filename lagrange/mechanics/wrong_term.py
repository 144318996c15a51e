"""The term of a wrong equation of motion that is wrong, in words; common slips among the causes."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.laws import solve
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.plain_form import simplest
from lagrange.mechanics.small import small
from lagrange.mechanics.student_equations import EquationRow, StudentEquation, row_of, tape, unknowns_of, values_at
from lagrange.mechanics.term_difference import (
    WRONG,
    Difference,
    Numbers,
    Write,
    constant_of,
    difference_of,
    ratio_of,
    same,
    spread,
    summands,
)
from lagrange.statement.statement import Statement

LONGEST_SLIP = 400
"""Operations of all equations together up to which slips are tried: each one is a few evaluations more."""

MOST_SYMBOLS = 12
"""Symbols of a system up to which slips are tried."""

SIGNS_TRIED = 12
"""Random values at which a sign is looked at."""

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

Slip = tuple[str, Mapping[Any, Any]]
"""A sentence, and what each symbol or function of the equations is replaced by to undo the slip."""


def slip_of(
    equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample], *, alone: bool
) -> str:
    """Return a sentence on the one slip without which all equations would be right, "" where none is found.

    `alone` is true if one term is wrong: no factor and no direction of a coordinate is told then, since the term is.
    """
    if sum(int(one.zero.count_ops()) for one in equations) > LONGEST_SLIP:
        return ""
    if len(statement.names) + len(statement.parameters) > MOST_SYMBOLS:
        return ""
    for sentence, table in _slips(equations, statement, alone=alone):
        if _all_hold([replace(one, zero=one.zero.xreplace(table)) for one in equations], statement, samples):
            return sentence
    return _small_angles(equations, statement)


def _all_hold(equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample]) -> bool:
    try:
        return all(row_of(one, statement).holds(samples) for one in equations)
    except StatementError:
        return False


def _small_angles(equations: Sequence[StudentEquation], statement: Statement) -> str:
    """Return a sentence if the equations are those of small motions about the coordinates' zero."""
    moving = set(statement.plain.values())
    if any(sympy.diff(one.zero, x, y) != 0 for one in equations for x in moving for y in moving if x.name <= y.name):
        return ""
    try:
        linear = small(statement, None, 2)
        held = _all_hold(equations, linear, motion_samples(linear, 2))
    except StatementError:
        return ""
    return "These are the equations for small motions: the exact ones are asked for." if held else ""


def _has_direction(parameter: Any, statement: Statement) -> bool:
    """Return whether a parameter may be counted in two directions, as g and a force but no mass, length or stiffness.

    It is a factor of terms of the potential or of forces, of either sign, and does not stand in the kinetic energy.
    """
    if statement.kinetic.has(parameter):
        return False
    slopes = [sympy.diff(one, parameter) for one in (statement.potential, *statement.forces)]
    if any(slope.has(parameter) for slope in slopes):
        return False
    if any(slope != 0 for slope in slopes[1:]):
        return True
    below = sympy.fraction(sympy.together(slopes[0]))[1]
    return not below.has(*statement.coordinates) and slopes[0] != 0 and not _has_one_sign(slopes[0])


def _has_one_sign(expression: Any) -> bool:
    """Return whether an expression has the same sign at random values of what stands in it."""
    dice = random.Random(1)
    leaves = sorted(expression.atoms(sympy.Symbol, AppliedUndef, sympy.Derivative), key=str)
    values = (
        sympy.N(expression.xreplace({x: sympy.Float(dice.choice((-1, 1)) * dice.uniform(0.3, 3)) for x in leaves}))
        for _ in range(SIGNS_TRIED)
    )
    signs = {value > 0 for value in values if value.is_real}
    return len(signs) < 2


def _slips(equations: Sequence[StudentEquation], statement: Statement, *, alone: bool) -> Iterator[Slip]:
    """Yield the slips that may be in equations, the commonest first."""
    found = {symbol for one in equations for symbol in one.zero.free_symbols}
    parameters = [p for p in statement.parameters if p in found]
    plain = list(statement.plain.values())
    coordinates = [tuple(plain[i : i + 3]) for i in range(0, len(plain), 3)]
    for p in (p for p in parameters if _has_direction(p, statement)):
        yield f"All is right with -{p} in place of {p}: check the direction in which {p} is counted.", {p: -p}
    for q, v, a in coordinates if not alone else ():
        turned = {q: -q, v: -v, a: -a}
        yield f"All is right for -{q} in place of {q}: check the direction in which {q} is counted.", turned
    circular = sorted({f for one in equations for f in one.zero.atoms(*_CIRCULAR)}, key=str)
    if circular:
        swapped = {f: sympy.cos(f.args[0]) if f.func is sympy.sin else sympy.sin(f.args[0]) for f in circular}
        yield "All is right with sine and cosine exchanged.", swapped
        degrees = {f: f.func(f.args[0] * 180 / sympy.pi) for f in circular}
        yield "All is right with angles in radians: they are in degrees here.", degrees
        for q, v, a in coordinates:
            if any(f.has(q) for f in circular):
                quarter = {q: sympy.pi / 2 - q, v: -v, a: -a}
                yield f"All is right if {q} is counted from the other axis, as pi/2 - {q}.", quarter
                yield f"All is right if {q} is counted from the opposite direction, as {q} + pi.", {q: q + sympy.pi}
    for factor, word in ((2, "2*"), (sympy.Rational(1, 2), "1/2*")):
        for p in parameters if not alone else ():
            yield f"All is right with {word}{p} in place of {p}.", {p: factor * p}
        for q, v, a in coordinates:
            yield f"All is right for {word}{q} in place of {q}.", {q: factor * q, v: factor * v, a: factor * a}


LONGEST_SOLVED = 300
"""Operations of a solved acceleration up to which its denominator is compared."""

LONGEST_QUOTIENT = 6
"""Operations of the quotient of two numerators that are the same but for a factor."""


def wrong_denominator(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence if a solved equation is right with another denominator on its right side, "" otherwise.

    At least one term of the denominator has to be right: otherwise the numerator may be meant as well.
    """
    names, unknowns = row.statement.names, list(row.slopes)
    place = next((k for k, slope in enumerate(row.slopes.values()) if slope != 0), len(names))
    if place >= len(names) or row.zero + row.right != unknowns[place]:
        return ""
    above, below = sympy.fraction(row.right)
    typed = next((factor for factor in sympy.Mul.make_args(below) if factor.is_Add), below)
    if not typed.free_symbols:
        return ""
    try:
        solved = list(derivation.accelerations.values())[place].xreplace(row.statement.plain)
    except StatementError:
        return ""
    if solved.count_ops() + row.right.count_ops() > LONGEST_SOLVED:
        return ""
    numerator, denominator = sympy.fraction(sympy.together(solved))
    quotient = simplest(above * typed / below / numerator)
    if quotient.count_ops() > LONGEST_QUOTIENT:
        return ""
    wanted = sympy.Add(*summands(quotient * denominator))
    if not set(summands(typed)) & set(sympy.Add.make_args(wanted)):
        return ""
    right = above * typed / below / wanted
    if not replace(row, zero=unknowns[place] - right, rest=-right, right=right).holds(samples):
        return ""
    of = "" if names[place] in row.label else f", that of {names[place]},"
    return f"In {row.label}{of} the denominator {write(typed)} is wrong: it should be {write(wanted)}."


NEAR = 0.5
"""An Euler-Lagrange equation is meant where at most so many terms differ for each product that agrees."""

LONGEST_FORMULA = 3_000
"""Operations of a solved acceleration above which it is not compared: expanding it would take seconds."""

BENT = 2
"""A factor that depends on the state counts as so many terms that differ; so does what an equation is solved for."""

SINGULAR = 1e-12
"""Pivot, relative to its row, from which a mass matrix is not solved."""


@dataclass(frozen=True)
class WrongTerm:
    """What is wrong with an equation, as a sentence. `alone` is true if nothing but one term of it differs."""

    sentence: str
    alone: bool = False


def wrong_term(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> WrongTerm:
    """Return which term of an equation that does not hold is wrong. `write` returns the text of an expression."""
    label = f"{row.label[0].upper()}{row.label[1:]}"
    if not any(row.slopes.values()) and not any(sample.first_order for sample in samples):
        return WrongTerm(f"{label} does not hold, and contains no acceleration: it is no equation of motion.")
    denominator = wrong_denominator(row, derivation, samples, write)
    if denominator:
        return WrongTerm(denominator, alone=True)
    given = _Sorted.of(row.zero, row.statement, samples, _solved_for(row, samples[0]))
    if given is None:
        return WrongTerm(f"{label} does not hold.")
    meant = _nearest(given, _candidates(given, _stated_rows(derivation)))
    if meant is None or meant.differing_terms > NEAR * meant.agreeing:
        others = (*_combined(row, given, derivation), *_candidates(given, _solved_rows(derivation)))
        found = [one for one in (meant, _nearest(given, others)) if one is not None]
        meant = min(found, key=lambda one: _rank(one)[:3], default=None)
    if meant is None or not meant.agreeing:
        return WrongTerm(f"{label} does not hold, and no term of it is that of an equation of motion.")
    return WrongTerm(_sentence(meant, row, write), alone=meant.differing_terms == 1)


def _sentence(meant: _Meant, row: EquationRow, write: Write) -> str:
    """Return what is wrong with the first product that differs, with the signs as they were typed."""
    product, found = meant.finding()
    side, sign = _side(row, product, found)
    of = "" if meant.name in row.label else f", that of {meant.name},"
    return f"In {row.label}{of}{side} {found.told(product, sign, write)}"


@dataclass(frozen=True, eq=False)
class _Sorted:
    """An equation by products of accelerations, velocities and multipliers, {product: coefficient}, and its values."""

    statement: Statement
    samples: Sequence[MotionSample]
    coefficients: Mapping[Any, Any]
    solved: frozenset[Any] = frozenset()

    @classmethod
    def of(
        cls, zero: Any, statement: Statement, samples: Sequence[MotionSample], solved: frozenset[Any] = frozenset()
    ) -> _Sorted | None:
        """Return an equation sorted, None where it is too long or has no values at the samples.

        `solved` are the accelerations that an equation was solved for.
        """
        kept = _by_product(zero, statement)
        if kept is None:
            return None
        usable = [one for one in samples if _values(list(kept.values()), statement, [one]) is not None]
        return cls(statement, usable, kept, solved) if usable else None

    @cached_property
    def values(self) -> Mapping[Any, Numbers]:
        """The coefficients at the samples."""
        found = _values(list(self.coefficients.values()), self.statement, self.samples)
        return dict(zip(self.coefficients, found or [], strict=True))

    @cached_property
    def terms(self) -> Mapping[Any, list[Numbers]]:
        """The terms of each coefficient at the samples."""
        listed = [(product, one) for product, whole in self.coefficients.items() for one in summands(whole)]
        values = _values([term for _, term in listed], self.statement, self.samples)
        found: dict[Any, list[Numbers]] = {}
        for (product, _), value in zip(listed, values or [], strict=True):
            found.setdefault(product, []).append(value)
        return found

    def numbers(self, expression: Any) -> Numbers | None:
        """Return the values of another expression at the samples, None where it has none."""
        found = _values([expression], self.statement, self.samples)
        return None if found is None else found[0]


def _leading(sample: MotionSample, statement: Statement) -> list[Any]:
    """Return the unknowns of the equations: accelerations, multipliers, and velocities that are of first order."""
    velocities = list(statement.plain.values())[1::3]
    return [*unknowns_of(statement), *(velocities[i] for i in sample.first_order)]


def _solved_for(row: EquationRow, sample: MotionSample) -> frozenset[Any]:
    """Return the unknowns that are all of the left side, with numbers for factors; none for another equation."""
    leading = _leading(sample, row.statement)
    left = _by_product(row.zero + row.right, row.statement) or {}
    solved = row.right != 0 and all(x in leading and c.is_Rational for x, c in left.items())
    return frozenset(left) if solved and not row.right.has(*left) else frozenset()


def _by_product(zero: Any, statement: Statement) -> dict[Any, Any] | None:
    """Return the coefficients of the products of a sum, None where it has too many terms.

    Only sums that contain velocities, accelerations or multipliers are multiplied out. The others stay as they were
    typed.
    """
    moving = (*list(statement.plain.values())[1::3], *unknowns_of(statement))
    terms = spread(zero, lambda factor: factor.has(*moving))
    if terms is None:
        return None
    found: dict[Any, Any] = {}
    for term in terms:
        coefficient, product = term.as_independent(*moving, as_Add=False)
        found[product] = found.get(product, 0) + coefficient
    return {product: value for product, value in found.items() if value != 0}


def _side(row: EquationRow, product: Any, found: Difference) -> tuple[str, int]:
    """Return words for the side on which a term stands or belongs, and -1 for the right side, else 1.

    The sign turns a coefficient of `row.zero` into the one that was typed. A missing term belongs on the right side if
    the left one has nothing but accelerations, as in a solved equation.
    """
    right = _by_product(row.right, row.statement) or {}
    left = _by_product(row.zero + row.right, row.statement) or {}
    if not right:
        return "", 1
    if found.there == 0:
        if product.has(*unknowns_of(row.statement)) and left:
            return "", 1
        solved = all(one.has(*unknowns_of(row.statement)) for one in left)
        return (" on the right side", -1) if solved or (product in right and product not in left) else ("", 1)
    there = summands(found.there)
    if product not in left or any(-term in summands(right.get(product, sympy.S.Zero)) for term in there):
        return " on the right side", -1
    stands = product not in right or any(term in summands(left[product]) for term in there)
    return ("", 1) if stands else (" with all terms on the left", 1)


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
        return constant_of(self.values)


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
    """Yield the sum of equations with constant weights that has the accelerations of the given one, times factors."""
    weights: list[Numbers] = []
    for sample in given.samples:
        try:
            slopes, _ = row.numbers(sample)
            weights.append(solve(sample.mass, [slopes[: len(sample.mass)]], SINGULAR)[0])
        except OutsideDomain:
            return
    first = next((i for i, weight in enumerate(weights[0]) if weight != 0), None)
    if first is None or any(not row[first] for row in weights):
        return
    constants = [constant_of([row[i] / row[first] for row in weights]) for i in range(len(weights[0]))]
    used = [i for i, weight in enumerate(constants) if weight != 0]
    stated = _stated_rows(derivation)
    if len(used) < 2 or None in constants or not stated:
        return
    zero = sympy.Add(*(_rational(constants[i] or Fraction(0)) * stated[i][1] for i in used))
    yield from _candidates(given, [(f"{listing(stated[i][0] for i in used)} together", zero)])


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
        agreeing = [one for one in products if one not in self.differing]
        self.agreeing = len(agreeing)
        self.agreeing_terms = sum(len(given.terms.get(one, [])) for one in agreeing)
        self.differing_terms = sum(map(self._terms, self.differing))

    @property
    def bent(self) -> bool:
        """Whether the factor depends on the state: equations are seldom multiplied by such a factor."""
        if self.factor.constant is not None:
            return False
        return bool(self._quotient.has(*list(self.given.statement.plain.values())[::3]))

    def _terms(self, product: Any) -> int:
        """Return how many terms before a product are not those that are expected, 1 for a sum times a constant."""
        there = self.given.values.get(product)
        if there is not None and ratio_of(there, self._wanted(product)) is not None:
            return 1
        factor, left = self.factor.values, list(self.given.terms.get(product, []))
        missing = 0
        for term in self.expected.terms.get(product, []):
            wanted = [c * x for c, x in zip(factor, term, strict=True)]
            match = next((one for one in left if same(one, wanted)), None)
            if match is None:
                missing += 1
            else:
                left.remove(match)
        return max(len(left), missing, 1)

    def _wanted(self, product: Any) -> Numbers:
        zero = [0] * len(self.factor.values)
        return [c * r for c, r in zip(self.factor.values, self.expected.values.get(product, zero), strict=True)]

    def _agrees(self, product: Any) -> bool:
        there = self.given.values.get(product, [0] * len(self.factor.values))
        return same(there, self._wanted(product))

    @cached_property
    def multiple(self) -> Any:
        """The factor as an expression."""
        constant = self.factor.constant
        if constant is not None:
            return sympy.Rational(constant.numerator, constant.denominator)
        return simplest(self._quotient)

    @property
    def _quotient(self) -> Any:
        """The factor before it is simplified."""
        product = self.factor.product
        return self.given.coefficients[product] / self.expected.coefficients[product]

    @cached_property
    def length(self) -> int:
        """Number of operations of the factor, 0 for a constant."""
        return 0 if self.factor.constant is not None else int(self._quotient.count_ops())

    def finding(self) -> tuple[Any, Difference]:
        """Return the first product that differs, and how its coefficient does."""
        product = self.differing[0]
        there = self.given.coefficients.get(product, sympy.S.Zero)
        wanted = self.multiple * self.expected.coefficients.get(product, sympy.S.Zero)
        wanted = wanted if self.factor.constant is not None else simplest(wanted)
        extra = [one for one in self.differing if one not in self.expected.coefficients]
        if there == 0 and len(extra) == 1:
            return extra[0], Difference(WRONG, self.given.coefficients[extra[0]], wanted * product / extra[0])
        return product, difference_of(there, wanted, self.given.numbers)


def _rank(meant: _Meant) -> tuple[Any, ...]:
    """Fewest differing terms first, then most agreeing ones, then the simplest factor."""
    constant = meant.factor.constant
    simple = (1, -1).index(int(constant)) if constant in (1, -1) else 2 if constant is not None else 3
    leading = _leading(meant.given.samples[0], meant.given.statement)
    accelerates = 0 if meant.factor.product in leading else 1
    doubts = BENT * (meant.bent + (not meant.given.solved.isdisjoint(meant.differing)))
    return meant.differing_terms + doubts, -meant.agreeing_terms, simple, accelerates, meant.length


def _rational(value: Fraction) -> Any:
    return sympy.Rational(value.numerator, value.denominator)
