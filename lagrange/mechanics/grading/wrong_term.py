"""Name the wrong term of an equation of motion in a sentence, or the common slip (a sign, degrees) that explains it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.expansion import small
from lagrange.mechanics.grading.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.grading.one_change import one_change
from lagrange.mechanics.grading.student_equations import (
    EquationRow,
    StudentEquation,
    row_of,
    tape,
    unknowns_of,
    values_at,
)
from lagrange.mechanics.grading.term_difference import (
    EXTRA,
    MISSING,
    WRONG,
    Difference,
    Numbers,
    Write,
    constant_of,
    difference_of,
    ratio_of,
    same,
    scaled_product,
    spread,
    summands,
)
from lagrange.mechanics.grading.wrong_side import place_of, right_denominators, right_terms, told_change, wrong_momentum
from lagrange.mechanics.plain_form import simplest
from lagrange.statement.coordinate import constraint_of
from lagrange.statement.statement import Statement

LONGEST_SLIP = 400
"""Largest number of operations in all equations together for which slips are tried; each slip costs evaluations."""

MOST_SYMBOLS = 12
"""Largest number of coordinates and parameters for which slips are tried."""

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

Slip = tuple[str, Mapping[Any, Any]]
"""A sentence, and the substitution {symbol or function: replacement} that undoes the slip."""


def slip_of(
    equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample], *, alone: bool
) -> str:
    """Return a sentence on the single slip whose correction makes all equations right, or "".

    `alone` is true if exactly one term is wrong. The message then names that term, so factors and directions of
    coordinates are not tried.
    """
    if sum(int(equation.zero.count_ops()) for equation in equations) > LONGEST_SLIP:
        return ""
    if len(statement.names) + len(statement.parameters) > MOST_SYMBOLS:
        return ""
    for sentence, table in _slips(equations, statement, alone=alone):
        corrected = [replace(equation, zero=equation.zero.xreplace(table)) for equation in equations]
        if _all_hold(corrected, statement, samples):
            return sentence
    return _small_angles(equations, statement)


def _all_hold(equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample]) -> bool:
    try:
        return all(row_of(equation, statement).holds(samples) for equation in equations)
    except StatementError:
        return False


def _small_angles(equations: Sequence[StudentEquation], statement: Statement) -> str:
    """Return a sentence if the equations are those linearised about the zero of all coordinates, else ""."""
    moving = set(statement.plain.values())
    bent = (part for equation in equations for part in equation.zero.atoms(sympy.Function, sympy.Pow))
    if any(part.has(*moving) for part in bent):
        return ""
    pairs = [(x, y) for x in moving for y in moving if x.name <= y.name]
    if any(sympy.diff(equation.zero, x, y) != 0 for equation in equations for x, y in pairs):
        return ""
    try:
        linear = small(statement, None, 2)
        right = _all_hold(equations, linear, motion_samples(linear, 2))
    except StatementError:
        return ""
    return "These are the equations for small motions: the exact ones are asked for." if right else ""


def _has_direction(parameter: Any, statement: Statement) -> bool:
    """Return True if a parameter has a direction, such as g or a force, unlike a mass, length or stiffness.

    Such a parameter is a factor of forces, or of terms of the potential with either sign. The kinetic energy does not
    contain it. Coefficients of drag and friction have no direction, unlike a magnetic field, whose forces do no work.
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


def _slips(equations: Sequence[StudentEquation], statement: Statement, *, alone: bool) -> Iterator[Slip]:
    """Yield slips that the equations may contain, the most common first."""
    used = {symbol for equation in equations for symbol in equation.zero.free_symbols}
    parameters = [p for p in statement.parameters if p in used]
    plain = list(statement.plain.values())
    coordinates = [tuple(plain[i : i + 3]) for i in range(0, len(plain), 3)]
    for p in (p for p in parameters if _has_direction(p, statement)):
        yield f"All is right with -{p} in place of {p}: check the direction in which {p} is counted.", {p: -p}
    for q, v, a in coordinates if not alone else ():
        turned = {q: -q, v: -v, a: -a}
        yield f"All is right for -{q} in place of {q}: check the direction in which {q} is counted.", turned
    circular = sorted({f for equation in equations for f in equation.zero.atoms(*_CIRCULAR)}, key=str)
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


NEAR = 0.5
"""Largest ratio of differing terms to agreeing products at which an Euler-Lagrange equation counts as intended."""

LONGEST_FORMULA = 3_000
"""Largest number of operations in a solved acceleration that is compared: expanding a longer one takes seconds."""

LONGEST_FACTOR = 60
"""Largest number of operations of a factor that is simplified before its symbols are looked at."""

HIGHEST_POWER = 12
"""Largest exponent in such a factor: to factor x**729 + 1 takes SymPy seconds."""

BENT, SOLVED = 2, 100
"""Penalties, in differing terms, of a factor that depends on the state, and of a difference in the unknown alone on the
left side, such as theta_ddot = ...: there the right side is wrong."""


@dataclass(frozen=True)
class WrongTerm:
    """Sentence on the error of an equation. `alone` is true if exactly one term of the equation differs.

    `cost` is that of the change of this term, infinite for several.
    """

    sentence: str
    alone: bool = False
    cost: float = math.inf


def wrong_term(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> WrongTerm:
    """Return the wrong term of an equation that does not hold. `write` turns an expression into text."""
    label = f"{row.label[0].upper()}{row.label[1:]}"
    constraints = row.statement.constraints
    still = not any(row.slopes.values()) and not any(sample.first_order for sample in samples)
    if still and not constraints:
        name = row.statement.names[0]
        return WrongTerm(
            f"{label} does not hold, and contains no acceleration such as {name}'' or {name}_ddot: it is not an "
            "equation of motion."
        )
    part = wrong_momentum(row, derivation, samples, write)
    if part:
        return WrongTerm(part, alone=True, cost=0.0)
    change = one_change(row, samples, right_terms(derivation), right_denominators(derivation))
    if change is not None:
        return WrongTerm(told_change(change, row, samples[0], write), alone=True, cost=change.cost)
    if still:
        listed = [f"{one.name}, {write(one.expression.xreplace(row.statement.plain))} = 0" for one in constraints]
        which = "the constraint is" if len(listed) == 1 else "the constraints are"
        return WrongTerm(f"{label} does not hold and is not a constraint: {which} {listing(listed)}.")
    given = _Sorted.of(row.zero, row.statement, samples, _solved_for(row, samples[0]))
    if given is None or row.statement.rotations:
        return WrongTerm(f"{label} does not hold.")
    meant = _nearest(given, _candidates(given, _stated_rows(derivation)))
    if meant is None or meant.differing_terms > NEAR * meant.agreeing:
        others = _candidates(given, _solved_rows(derivation))
        nearest = [match for match in (meant, _nearest(given, others)) if match is not None]
        meant = min(nearest, key=lambda match: match.rank[:3], default=None)
    if meant is None or not meant.agreeing:
        return WrongTerm(f"{label} does not hold, and no term of it is that of an equation of motion.")
    product, difference = meant.finding()
    return WrongTerm(_sentence(meant.name, product, difference, row, write))


def _sentence(name: str, product: Any, difference: Difference, row: EquationRow, write: Write) -> str:
    """Return a sentence on a product whose coefficient differs, with the signs as they were typed."""
    side, sign = _side(row, product, difference)
    told = difference.told(product, sign, write)
    constraint = constraint_of(product) if product.is_Symbol else None
    if difference.kind == MISSING and constraint is not None:
        told = told.replace(" is missing.", f", the force of the constraint {constraint}, is missing.")
    return f"{place_of(name, row)}{side} {told}"


@dataclass(frozen=True, eq=False)
class _Sorted:
    """An equation as {product of accelerations, velocities and multipliers: coefficient}, and values at samples.

    `solved` has the unknowns that the equation was solved for.
    """

    statement: Statement
    samples: Sequence[MotionSample]
    coefficients: Mapping[Any, Any]
    solved: frozenset[Any] = frozenset()

    @classmethod
    def of(
        cls, zero: Any, statement: Statement, samples: Sequence[MotionSample], solved: frozenset[Any] = frozenset()
    ) -> _Sorted | None:
        """Return the equation `zero` = 0 by products, or None if it is too long or has no value at any sample.

        `solved` has the unknowns that the equation was solved for.
        """
        coefficients = _by_product(zero, statement)
        if coefficients is None:
            return None
        listed = list(coefficients.values())
        usable = [sample for sample in samples if _values(listed, statement, [sample]) is not None]
        return cls(statement, usable, coefficients, solved) if usable else None

    @cached_property
    def values(self) -> Mapping[Any, Numbers]:
        """Values of each coefficient at the samples, by product."""
        values = _values(list(self.coefficients.values()), self.statement, self.samples)
        return dict(zip(self.coefficients, values or [], strict=True))

    @cached_property
    def terms(self) -> Mapping[Any, list[Numbers]]:
        """Values of the terms of each coefficient at the samples, by product."""
        listed = [(product, term) for product, whole in self.coefficients.items() for term in summands(whole)]
        values = _values([term for _, term in listed], self.statement, self.samples)
        terms: dict[Any, list[Numbers]] = {}
        for (product, _), value in zip(listed, values or [], strict=True):
            terms.setdefault(product, []).append(value)
        return terms

    def numbers(self, expression: Any) -> Numbers | None:
        """Return the values of another expression at the samples, or None if it has no value at one of them."""
        values = _values([expression], self.statement, self.samples)
        return None if values is None else values[0]


def _leading(sample: MotionSample, statement: Statement) -> list[Any]:
    """Return the unknowns: accelerations, multipliers, and velocities of coordinates with first-order equations."""
    velocities = list(statement.plain.values())[1::3]
    return [*unknowns_of(statement), *(velocities[i] for i in sample.first_order)]


def _solved_for(row: EquationRow, sample: MotionSample) -> frozenset[Any]:
    """Return the unknowns of a left side that has only unknowns times numbers; empty for any other left side."""
    leading = _leading(sample, row.statement)
    left = _by_product(row.zero + row.right, row.statement) or {}
    solved = row.right != 0 and all(x in leading and c.is_Rational for x, c in left.items())
    return frozenset(left) if solved and not row.right.has(*left) else frozenset()


def _by_product(zero: Any, statement: Statement) -> dict[Any, Any] | None:
    """Return the coefficients of an expression by product, or None if it has too many terms.

    Only sums that contain velocities, accelerations or multipliers are multiplied out. Others remain as typed.
    """
    moving = (*list(statement.plain.values())[1::3], *unknowns_of(statement))
    terms = spread(zero, lambda factor: factor.has(*moving))
    if terms is None:
        return None
    coefficients: dict[Any, Any] = {}
    for term in terms:
        coefficient, product = term.as_independent(*moving, as_Add=False)
        coefficients[product] = coefficients.get(product, 0) + coefficient
    return {product: value for product, value in coefficients.items() if value != 0}


def _side(row: EquationRow, product: Any, difference: Difference) -> tuple[str, int]:
    """Return words for the side of the equation that has or lacks a term, and its sign: -1 on the right, else 1.

    The sign turns a coefficient of `row.zero` into the typed one. A missing term belongs on the right side if the left
    side has only accelerations, as in a solved equation.
    """
    right = _by_product(row.right, row.statement) or {}
    left = _by_product(row.zero + row.right, row.statement) or {}
    if not right:
        return "", 1
    if difference.there == 0:
        if product.has(*unknowns_of(row.statement)) and left:
            return "", 1
        solved = all(other.has(*unknowns_of(row.statement)) for other in left)
        return (" on the right side", -1) if solved or (product in right and product not in left) else ("", 1)
    typed = summands(difference.there)
    if product not in left or any(-term in summands(right.get(product, sympy.S.Zero)) for term in typed):
        return " on the right side", -1
    on_left = product not in right or any(term in summands(left[product]) for term in typed)
    return ("", 1) if on_left else (" with all terms on the left", 1)


def _values(expressions: Sequence[Any], statement: Statement, samples: Sequence[MotionSample]) -> list[Numbers] | None:
    """Return the values of each expression at the samples, or None if one of them has no value."""
    try:
        program = tape(expressions, statement)
        columns = [values_at(program, sample) for sample in samples]
    except OutsideDomain:
        return None
    return [list(row) for row in zip(*columns, strict=True)] if columns else None


@dataclass(frozen=True, eq=False)
class _Factor:
    """Factor of an expected equation: its values at the samples, and the product whose coefficients determine it."""

    values: Numbers
    product: Any

    @property
    def constant(self) -> Fraction | None:
        """The factor as a small fraction if it has the same value at all samples, else None."""
        return constant_of(self.values)


Candidate = tuple[str, _Sorted, _Factor]
"""A possibly intended equation: the name of its coordinate, the equation, and its factor."""


def _nearest(given: _Sorted, candidates: Iterable[Candidate]) -> _Meant | None:
    """Return the candidate with the fewest differences from an equation, or None if there are no candidates.

    A rank begins with at least the number of differing products. Candidates with more than the best one are not ranked.
    """
    best: _Meant | None = None
    every = (_Meant(name, given, expected, factor) for name, expected, factor in candidates)
    for meant in sorted(every, key=lambda meant: len(meant.differing)):
        if best is None:
            best = meant
        elif len(meant.differing) > best.rank[0]:
            break
        elif meant.differing_terms <= best.rank[0] and meant.rank < best.rank:
            best = meant
    return best


def _candidates(given: _Sorted, rows: Sequence[tuple[str, Any]]) -> Iterator[Candidate]:
    """Yield right equations that a typed one may be a multiple of, each with the possible factors.

    A factor is possible if with it one coefficient of the right equation equals the typed one. `rows` are the right
    equations as pairs of a coordinate's name and an expression that is zero.
    """
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


def _stated_rows(derivation: Derivation) -> list[tuple[str, Any]]:
    """Return the Euler-Lagrange equations as (coordinate name, left - right); empty if too large to write out."""
    try:
        laws = derivation.equations
    except StatementError:
        return []
    return [(name, law.lhs - law.rhs) for name, law in zip(derivation.statement.names, laws, strict=True)]


def _solved_rows(derivation: Derivation) -> list[tuple[str, Any]]:
    """Return (coordinate name, zero) of each solved acceleration, times its denominator; long ones are omitted."""
    statement = derivation.statement
    try:
        solved = list(derivation.accelerations.values())
    except StatementError:
        return []
    symbols = list(statement.plain.values())[2::3]
    rows = zip(statement.names, symbols, map(sympy.fraction, solved), strict=True)
    return [
        (name, symbol * below - above) for name, symbol, (above, below) in rows if above.count_ops() <= LONGEST_FORMULA
    ]


class _Meant:
    """A possibly intended equation times a factor, and the products in which the typed equation differs from it."""

    def __init__(self, name: str, given: _Sorted, expected: _Sorted, factor: _Factor) -> None:
        self.name, self.expected, self.given, self.factor = name, expected, given, factor
        products = list(dict.fromkeys([*expected.coefficients, *given.coefficients]))
        self.differing = [product for product in products if not self._agrees(product)]
        self.agreeing = len(products) - len(self.differing)

    @cached_property
    def differing_terms(self) -> int:
        """Number of terms that differ from the expected ones."""
        return sum(map(self._terms, self.differing))

    @cached_property
    def rank(self) -> tuple[Any, ...]:
        """Sort key: fewest differing terms, a factor of 1 or -1, most agreeing terms, the simplest factor."""
        constant, given = self.factor.constant, self.given
        simple = (1, -1).index(int(constant)) if constant in (1, -1) else 2
        accelerates = 0 if self.factor.product in _leading(given.samples[0], given.statement) else 1
        doubts = BENT * self.bent
        for unknown in given.solved.intersection(self.differing):
            doubts += SOLVED if given.coefficients[unknown] == 1 else BENT
        agreeing = sum(len(terms) for product, terms in given.terms.items() if product not in self.differing)
        agreeing += sum(map(self._agreeing_terms, self.differing))
        return self.differing_terms + doubts, simple, -agreeing, constant is None, self.length, accelerates

    @property
    def bent(self) -> bool:
        """True if the factor depends on the coordinates: equations are seldom multiplied by such a factor."""
        if self.factor.constant is not None:
            return False
        powers = (power.exp for power in self._quotient.atoms(sympy.Pow) if power.exp.is_Rational)
        plain = self.length <= LONGEST_FACTOR and all(abs(exponent) <= HIGHEST_POWER for exponent in powers)
        factor = self.multiple if plain else self._quotient
        return bool(factor.has(*list(self.given.statement.plain.values())[::3]))

    def _terms(self, product: Any) -> int:
        """Return the number of terms of a coefficient that differ from the expected ones.

        It is 1 if the whole coefficient or one typed product in it differs by a factor, or if a product with a rate is
        missing.
        """
        there = self.given.values.get(product)
        if there is None and product != 1:
            return 1
        wanted = self._wanted(product)
        if there is not None and (ratio_of(there, wanted) is not None or self._is_scaled(product)):
            return 1
        off = None if there is None else [a - b for a, b in zip(there, wanted, strict=True)]
        if off and scaled_product(self.given.coefficients[product], off, self.given.numbers) is not None:
            return 1
        agreeing = self._agreeing_terms(product)
        typed, expected = (len(side.terms.get(product, [])) for side in (self.given, self.expected))
        return max(typed - agreeing, expected - agreeing, 1)

    def _is_scaled(self, product: Any) -> bool:
        """Return True if a coefficient is the expected one times a factor, which may depend on parameters."""
        there, wanted = self.given.values[product], self._wanted(product)
        typed, expected = (side.terms.get(product, []) for side in (self.given, self.expected))
        if not all(wanted) or not all(there) or len(typed) != len(expected):
            return False
        left = list(typed)
        for term in expected:
            scaled = [a / b * c * x for a, b, c, x in zip(there, wanted, self.factor.values, term, strict=True)]
            match = next((other for other in left if same(other, scaled)), None)
            if match is None:
                return False
            left.remove(match)
        return True

    def _agreeing_terms(self, product: Any) -> int:
        """Return the number of terms of a coefficient that are as expected."""
        left = list(self.given.terms.get(product, []))
        count = len(left)
        for term in self.expected.terms.get(product, []):
            expected = [c * x for c, x in zip(self.factor.values, term, strict=True)]
            match = next((typed for typed in left if same(typed, expected)), None)
            if match is not None:
                left.remove(match)
        return count - len(left)

    def _wanted(self, product: Any) -> Numbers:
        zero = [0] * len(self.factor.values)
        return [c * r for c, r in zip(self.factor.values, self.expected.values.get(product, zero), strict=True)]

    def _agrees(self, product: Any) -> bool:
        there = self.given.values.get(product, [0] * len(self.factor.values))
        return same(there, self._wanted(product))

    @cached_property
    def multiple(self) -> Any:
        """The factor as a simplified expression."""
        constant = self.factor.constant
        if constant is not None:
            return sympy.Rational(constant)
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
        """Return the first product whose coefficient differs, and the difference.

        A term too many and a missing one are one wrong term: b*x in place of b*x_dot.
        """
        product, *others = self.differing
        difference = self._difference(product)
        if len(others) == 1:
            other = self._difference(others[0])
            if (difference.kind, other.kind) == (MISSING, EXTRA):
                return others[0], Difference(WRONG, other.there, difference.wanted * product / others[0])
            if (difference.kind, other.kind) == (EXTRA, MISSING):
                return product, Difference(WRONG, difference.there, other.wanted * others[0] / product)
        return product, difference

    def _difference(self, product: Any) -> Difference:
        """Return the difference of a coefficient from the expected one times the factor."""
        there = self.given.coefficients.get(product, sympy.S.Zero)
        wanted = self.multiple * self.expected.coefficients.get(product, sympy.S.Zero)
        wanted = wanted if self.factor.constant is not None else simplest(wanted)
        return difference_of(there, wanted, self.given.numbers)
