"""Find the single change of one term, such as its sign or factor, that corrects a wrong equation.

The change may also add or remove a term. It is found from values at random states, with the true accelerations.

Every sum in the equation is tried: both sides, brackets and denominators. At each state the difference of the two sides
determines by how much the sum has to change. If this change is the same simple fraction of one term at all states, or
the fraction times a few powers of symbols, the term is wrong. The equations of motion, the constraints, the multipliers
and the rates of rotations enter as numbers only, so all kinds of systems are treated alike.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain, combinations, product
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.mechanics.grading.motion_samples import MotionSample
from lagrange.mechanics.grading.student_equations import DIGITS, EquationRow, abbreviations, unknowns_of
from lagrange.mechanics.grading.term_difference import (
    LARGEST_FACTOR,
    Difference,
    Numbers,
    constant_of,
    expanded,
    scaled_by,
)
from lagrange.mechanics.grading.time_limit import check_budget
from lagrange.mechanics.plain_form import time_derivative
from lagrange.statement.coordinate import constraint_of

MOST_FACTORS = 26  # Largest number of factors whose powers a change may contain: 26 make 6,000 pairs of powers
MOST_TRIPLED = 12  # Largest number of factors of which products of three are tried: 12 make 1,800 products
MOST_MODELS = 120  # Largest number of correct terms of which a missing or replaced term may be a multiple
LONGEST = 600  # Largest number of operations of an equation whose terms are changed

LONGEST_EXPANDED = 80
"""Largest number of operations of a corrected term that is expanded to look for it among terms of correct equations"""
CLOSE = 1e-9  # Largest difference of two logarithms that count as equal; rounding is about 1e-14
NONE = 1e-20  # A sum below this fraction of its terms counts as zero: the accelerations have about 30 digits
# Costs of changes: of a sign, of a factor 2 or 1/2, of another number, of an extra, a missing and a replaced term.
# A change with a lower cost is a likelier mistake.
SIGN, DOUBLED, FRACTION, LEFT_OUT, MISSED, REPLACED = 1.0, 1.1, 1.3, 1.4, 1.6, 2.4
# Costs of a sine in place of a cosine, of one power, and of a sum or an unknown in a factor
SWAPPED, POWER, OF_FACTOR = 0.2, 0.35, 1.2
OF_NUMBER = 0.3  # Added cost of a change after which the equation is a correct one times a number such as 3

OF_DERIVATIVE = 1.5  # Added cost of changing a single term of a typed d/dt(...)
# Added costs of a change of a whole sum, of a term with an acceleration, and of a left side that is an acceleration
OF_SIDE, OF_RATE, OF_SOLVED = 0.45, 0.15, 5.0
DENOMINATOR = 0.1  # Added cost of a change in a denominator
# Added costs of an acceleration and of a multiplier that the equation does not have elsewhere
NEW_RATE, NEW_FORCE = 1.0, 0.5
# Changes of the cost if a correct equation has the new term: without a multiplier, with one, with the opposite sign
NATURAL, FORCE, TURNED = -0.3, -0.28, -0.1
NUMBERED = 0.05  # Added cost of a corrected term with a number


@dataclass(frozen=True)
class Sum:
    """A sum in a typed equation, as the expression `whole`, and its place in the equation.

    `side` is 0 for the left side and 1 for the right side. `path` has the indices of SymPy arguments that lead to the
    sum. `around` is the product of the factors that multiply the sum. `below` is true if the sum is in a denominator.
    `terms` are the terms of the sum. Like terms are not combined if they were typed separately.
    """

    side: int
    path: tuple[int, ...]
    whole: Any
    terms: tuple[Any, ...]
    around: Any = sympy.S.One
    below: bool = False


@dataclass(frozen=True)
class Change:
    """A change of a sum in an equation, `total`, that makes the equation correct. A lower `cost` is a likelier mistake.

    `difference` is the change of one term of the sum, or of the whole sum. `row` is the equation after the change.
    """

    total: Sum
    difference: Difference
    cost: float
    row: EquationRow


def one_change(
    row: EquationRow, samples: Sequence[MotionSample], models: Sequence[Any], denominators: Sequence[Any]
) -> Change | None:
    """Return the likeliest change of one term after which a typed equation holds at all samples, or None.

    `models` are terms of correct equations; a missing or wrong term may be a multiple of one. `denominators` are the
    denominators of the correct formulas for accelerations.
    """
    if sum(side.count_ops() for side in row.sides) > LONGEST:
        return None
    try:
        search = _Search(row, samples, models, denominators)
        choices = sorted(search.choices(), key=lambda choice: choice[0])
    except OutsideDomain:
        return None
    best: Change | None = None
    for cost, total, difference in choices[:40]:
        if best is not None and cost >= best.cost:
            break
        corrected = search.corrected(total, difference)
        if corrected is not None and corrected.holds(samples) and not _is_empty(corrected, row, samples[0]):
            cost += OF_NUMBER if search.has_unlikely_factor(corrected) else 0.0
            if best is None or cost < best.cost:
                best = Change(total, difference, cost, corrected)
    return best


def evaluated(expressions: Sequence[Any], row: EquationRow, samples: Sequence[MotionSample]) -> list[Numbers]:
    """Return the values of expressions at the samples, with the true values of accelerations and multipliers.

    The result has one list for each expression. Symbols that the answer defines have their values in the equation
    `row`. Raises OutsideDomain if an expression has no value, and BudgetSpent if the time is up.
    """
    check_budget()
    unknowns = unknowns_of(row.statement)
    inputs = [sympy.Dummy() for _ in unknowns]
    stated = {symbol: leaf for leaf, symbol in row.statement.plain.items()} | dict(zip(unknowns, inputs, strict=True))
    listed = [row.in_full(expression).xreplace(stated) for expression in expressions]
    program = Precise(listed, row.statement, DIGITS, inputs)
    columns = []
    for sample in samples:
        point, number = sample.point, program.context.mpf
        solved = zip(inputs, (*sample.accelerations, *sample.multipliers), strict=True)
        numbers = {p: number(x) for p, x in (*point.parameters.items(), *solved)}
        columns.append(program(point.q, point.v, point.t, numbers))
    return [list(line) for line in zip(*columns, strict=True)]


def _is_empty(corrected: EquationRow, row: EquationRow, sample: MotionSample) -> bool:
    """Return True if an equation after a change, `corrected`, is trivial, such as x'' = x''.

    The result is also True if only the typed equation `row` has accelerations, or if coefficients have no value.
    """
    if not any(row.slopes.values()):
        # Without constraints, an equation that holds at all states and has no acceleration is an identity.
        free = not (row.statement.constraints or sample.first_order or any(corrected.slopes.values()))
        return bool(free or sympy.expand(corrected.zero) == 0)
    with suppress(OutsideDomain):
        slopes, stated = (each.numbers(sample) for each in (corrected, row))
        return bool(max(map(abs, slopes)) <= NONE * max(map(abs, stated)))
    return True


def _sums(side: int, expression: Any, typed: Sequence[Any]) -> Iterator[Sum]:
    """Yield the sums in one side of an equation: the side itself, and the sums in its products and denominators.

    `expression` is this side, the left one if `side` is 0, the right one if it is 1. `typed` are its terms before like
    terms were combined; () if nothing was combined.
    """
    terms = sympy.Add.make_args(expression)
    if typed:
        added = (*typed, *sympy.Add.make_args(expression - sympy.Add(*typed)))
        terms = terms if Counter(term for term in added if term != 0) == Counter(terms) else added
    waiting = [Sum(side, (), expression, terms)]
    while waiting:
        total = waiting.pop()
        yield total
        for k, term in enumerate(sympy.Add.make_args(total.whole)):
            path = (*total.path, k) if total.whole.is_Add else total.path
            factors = [((*path, i), factor) for i, factor in enumerate(term.args)] if term.is_Mul else [(path, term)]
            for inner, factor in factors:
                if factor.is_Add and factor is not total.whole:
                    around = total.around * sympy.Mul(*(other for place, other in factors if place != inner))
                    waiting.append(Sum(side, inner, factor, factor.args, around, total.below))
                elif factor.is_Pow and factor.exp == -1:
                    waiting.append(Sum(side, (*inner, 0), factor.base, sympy.Add.make_args(factor.base), below=True))


def _with(expression: Any, path: Sequence[int], part: Any) -> Any:
    """Return an expression with `part` at one place; `path` has the indices of SymPy arguments that lead to it."""
    if not path:
        return part
    first, *rest = path
    args = list(expression.args)
    args[first] = _with(args[first], rest, part)
    return expression.func(*args)


class _Search:
    """Search for changes of one term that correct an equation, by values of terms and factors at sampled states."""

    def __init__(
        self, row: EquationRow, samples: Sequence[MotionSample], models: Sequence[Any], denominators: Sequence[Any]
    ) -> None:
        self.row, self.samples = row, samples
        count, velocities = len(row.statement.names), list(row.statement.plain.values())[1::3]
        self.unknowns = unknowns_of(row.statement)
        accelerations, self.forces = self.unknowns[:count], self.unknowns[count:]
        self.absent = [symbol for symbol in self.unknowns if not row.zero.has(symbol)]

        # Other symbols that are likely on the left side: definitions with an acceleration, velocities of first order
        shorthands = {**abbreviations(row.statement), **row.equation.meanings}
        self.rates = [symbol for symbol, value in shorthands.items() if value.has(*self.unknowns)]
        self.rates += [velocities[i] for i in samples[0].first_order]
        self.moving = [*accelerations, *self.rates]
        self.rate_side = 0 if row.sides[0].has(*self.unknowns, *self.rates) else 1

        # The typed sums, and the terms that come from a typed d/dt(...)
        typed = (*row.equation.terms, (), ())[:2]
        self.sums = [total for side in (0, 1) for total in _sums(side, row.sides[side], typed[side])]
        rates = [time_derivative(row.in_full(p), row.statement.plain) for p in row.equation.differentiated]
        derived = {term for rate in rates for term in sympy.Add.make_args(rate)}
        self.derived = {sign * term for term in derived for sign in (1, -1)}.difference(*typed)

        # The terms of correct equations, and among them those of which a missing term may be a multiple. An equation
        # without velocities, such as a constraint, misses no term with velocities or accelerations.
        self.right = {sympy.Add(*expanded(term)) for term in models}
        self.below = {base for term in models for base in _sums_below(term)}
        moving = [*self.unknowns, *velocities]
        if not row.zero.has(*moving):
            models = [term for term in models if not term.has(*moving)]
        self.models = list(dict.fromkeys(term.as_coeff_Mul()[1] for term in models))[:MOST_MODELS]

        terms = [term * total.around for total in self.sums for term in total.terms]
        self.typed_bases = {base for term in terms for base in _bases(term)}
        self.bases = self._candidates((*terms, *self.models, *denominators))
        self.base_values, self.model_values = self.values(self.bases), self.values(self.models)

    def values(self, expressions: Sequence[Any]) -> list[Numbers]:
        """Return the values of expressions at all sampled states, a list each. Raises OutsideDomain without a value."""
        return evaluated(expressions, self.row, self.samples)

    def _candidates(self, terms: Sequence[Any]) -> list[Any]:
        """Return the expressions whose powers may be missing or wrong factors: bases of the factors in `terms`.

        They are in the order of the terms. A sine comes with its cosine. If they are few, all parameters are added.
        """
        candidates: dict[Any, None] = {}
        for base in (base for term in terms for base in _bases(term)):
            if base.is_number or (base.is_Add and len(base.args) > 4):
                continue
            candidates[base] = None
            if isinstance(base, (sympy.sin, sympy.cos)):
                candidates |= {sympy.sin(base.args[0]): None, sympy.cos(base.args[0]): None}
        with_parameters = candidates | dict.fromkeys(self.row.statement.parameters)
        return list(with_parameters if len(with_parameters) <= MOST_FACTORS else candidates)[:MOST_FACTORS]

    @cached_property
    def products(self) -> tuple[list[tuple[tuple[int, int], ...]], Any, list[float]]:
        """Products of powers of one to three candidate factors, as (keys, table, costs) with an entry for each product.

        A key is ((index of a factor, exponent), ...). A row of the table has the logarithms of the product's magnitudes
        at the sampled states, minus their mean. A product with a lower cost is a likelier mistake.
        """
        values = self.base_values
        usable = [i for i, line in enumerate(values) if all(line)]
        powers = [[(i, e)] for i in usable for e in (1, -1, 2, -2)]
        keys: list[tuple[tuple[int, int], ...]] = [(), *(tuple(power) for power in powers)]
        keys += [((i, e), (j, f)) for i, j in combinations(usable, 2) for e, f in product((1, -1, 2, -2), repeat=2)]
        if len(usable) <= MOST_TRIPLED:
            signs = [*product((1, -1), repeat=3)]
            keys += [tuple(zip(chosen, sign, strict=True)) for chosen in combinations(usable, 3) for sign in signs]
        logs = {i: _centred(values[i]) for i in usable}
        zero = np.zeros(len(self.samples))
        table = np.array([sum((e * logs[i] for i, e in key), zero) for key in keys])
        return keys, table, [self._price(key) for key in keys]

    def _price(self, key: Sequence[tuple[int, int]]) -> float:
        """Return the cost of a product of powers; `key` has (index of a candidate factor, exponent) for each power."""
        bases = [self.bases[i] for i, _ in key]
        if len(key) == 2 and {e for _, e in key} == {1, -1}:  # one factor in place of another
            kinds = {type(base) for base in bases}
            if kinds == {sympy.sin, sympy.cos} and bases[0].args == bases[1].args:
                return SWAPPED
            if not any(base.is_Add for base in bases) and len({base.has(*self.unknowns) for base in bases}) == 1:
                return POWER + SWAPPED
        unlikely = [
            base for base in bases if base.has(*self.unknowns) or (base.is_Add and base not in self.typed_bases)
        ]
        return POWER * sum(abs(e) for _, e in key) + OF_FACTOR * len(unlikely)

    def multiples(self, values: Numbers) -> Iterator[tuple[float, Any, Any]]:
        """Yield (cost, c, product of powers), where the rational number c times the product has the given values.

        `values` has one number for each sampled state. Nothing is yielded if one of them is zero. At most 20 products
        are tried.
        """
        if not all(values):
            return
        keys, table, prices = self.products
        near = np.nonzero(np.abs(table - _centred(values)).max(axis=1) < CLOSE)[0]
        for i in near[:20]:
            powers = [[x**e for x in self.base_values[k]] for k, e in keys[i]]
            ratios = [value / math.prod(parts) for value, *parts in zip(values, *powers, strict=True)]
            number = constant_of(ratios)
            if number:
                yield prices[i], sympy.Rational(number), sympy.Mul(*(self.bases[k] ** e for k, e in keys[i]))

    def choices(self) -> Iterator[tuple[float, Sum, Difference]]:
        """Yield (cost, sum, difference) for all changes of one term of a sum that correct the equation."""
        for total, changes in self._changes():
            below = DENOMINATOR if total.below else 0.0
            for cost, difference in chain(self._changed_terms(total, changes), self._missing_terms(total, changes)):
                yield cost + below + self._cost_of_right(total, difference.right), total, difference

    def _changed_terms(self, total: Sum, changes: Numbers) -> Iterator[tuple[float, Difference]]:
        """Yield (cost, difference) for changes of one term of the sum `total`, or of the whole sum.

        `changes` are the amounts by which the sum has to change at the sampled states.
        """
        parts = [(term, False) for term in total.terms]  # pairs (expression, True for the whole sum)
        if len(parts) > 1:
            parts.append((total.whole, True))
        elif total.below:
            return  # The factors of a lone term in a denominator are factors of the whole term.
        values = self.values([part for part, _ in parts])
        for (part, is_whole), value in zip(parts, values, strict=True):
            cost_of_part = self._cost_of_typed(total, part) + (OF_SIDE if is_whole else 0.0)
            for cost, difference in self._of_term(part, value, changes):
                if not (is_whole and difference.kind == "extra"):
                    yield cost + cost_of_part, difference

    def _missing_terms(self, total: Sum, changes: Numbers) -> Iterator[tuple[float, Difference]]:
        """Yield (cost, difference) for missing terms of a sum, whose values at the sampled states are `changes`."""
        has_unknowns = total.whole.has(*self.unknowns)
        for cost, term in self._among_models(changes):
            if total.path and term.has(*self.unknowns) and not has_unknowns:
                continue  # An acceleration is not added to a bracket without one.
            cost += self._cost_of_side(total, term) + (OF_RATE if term.has(*self.moving) else 0.0)
            yield cost, Difference("missing", sympy.S.Zero, term)

    def _cost_of_right(self, total: Sum, right: Any) -> float:
        """Return the cost to add if `right` is the new term of the sum `total`; terms of correct equations lower it."""
        term = (right * total.around).xreplace(dict(self.row.equation.meanings))
        signed = term if total.side == self.rate_side else -term
        if term.count_ops() <= LONGEST_EXPANDED and self.below >= _sums_below(signed):
            signed = sympy.Add(*expanded(signed))
        absent = [symbol for symbol in self.absent if term.has(symbol)]
        cost = max((NEW_RATE if constraint_of(symbol) is None else NEW_FORCE for symbol in absent), default=0.0)
        if signed not in self.right and -signed not in self.right:
            return cost if abs(term.as_coeff_Mul()[0]) == 1 else cost + NUMBERED
        if term.has(*self.forces):
            return cost + FORCE
        return cost + (NATURAL if signed in self.right else TURNED)

    def _changes(self) -> Iterator[tuple[Sum, Numbers]]:
        """Yield each sum whose change can make the equation correct, with the necessary change at each sampled state.

        A whole side changes by the residual, left minus right side. As a function of any other sum, the residual is a
        quotient of two linear functions. Its values for the sum itself, twice and four times the sum determine this
        function. Decimals times powers of two are exact.
        """
        left, right = self.row.sides
        zeros = [left - right]
        for total in self.sums:
            for times in (2, 4):
                sides = list(self.row.sides)
                sides[total.side] = _with(sides[total.side], total.path, times * total.whole)
                zeros.append(sides[0] - sides[1])
        residual, *varied = self.values(zeros)
        wholes = self.values([total.whole for total in self.sums])
        for k, (total, whole) in enumerate(zip(self.sums, wholes, strict=True)):
            if total.whole == 0:
                continue
            if not total.path:
                yield total, [x if total.side else -x for x in residual]
                continue
            twice, fourfold = varied[2 * k : 2 * k + 2]
            steps = [_root(*triple) for triple in zip(residual, twice, fourfold, strict=True)]
            if None not in steps:
                yield total, [step * value for step, value in zip(steps, whole, strict=True)]

    def _of_term(self, term: Any, value: Numbers, changes: Numbers) -> Iterator[tuple[float, Difference]]:
        """Yield (cost, difference) for corrections of a term that change its value by `changes`.

        `value` are its values at the sampled states. A correction is zero, the term times a number and powers, or a
        multiple of a term of a correct equation.
        """
        required = [a + b for a, b in zip(value, changes, strict=True)]
        if max(map(abs, required)) <= NONE * max(map(abs, value)):
            yield LEFT_OUT, Difference("extra", term, sympy.S.Zero)
            return
        for cost, number, factor in self._quotients(required, value):
            right = (term if number == 1 else scaled_by(number, term)) * factor
            decimal, rest = right.as_coeff_Mul()
            if decimal.is_Float:
                right = sympy.Rational(Fraction(float(decimal)).limit_denominator(LARGEST_FACTOR)) * rest
            if factor != 1:
                cost += SIGN + (0 if number == 1 else 0.2 if number == -1 else 0.7)
                yield cost, Difference("wrong", term, right)
                continue
            if number == -1:
                cost = SIGN
            elif number in (2, sympy.S.Half):
                cost = DOUBLED
            else:
                cost = FRACTION + len(str(number)) / 20
            yield cost, Difference("scaled", term, right, 1 / Fraction(number.p, number.q))
        for cost, right in self._among_models(required):
            yield cost + REPLACED - MISSED, Difference("wrong", term, right)

    def _among_models(self, values: Numbers) -> Iterator[tuple[float, Any]]:
        """Yield (cost, term) for multiples of terms of correct equations with these `values` at the sampled states."""
        for model, line in zip(self.models, self.model_values, strict=True):
            for cost, number, factor in self._quotients(values, line):
                plain = 0 if abs(number) == 1 else 0.3
                yield MISSED + cost + plain, number * model * factor

    def _quotients(self, values: Numbers, divisors: Numbers) -> Iterator[tuple[float, Any, Any]]:
        """Yield (cost, number, product of powers), where number times product is values/divisors.

        Both lists have a number for each sampled state. Where divisors are zero, as on one side of a switch, the values
        must be zero, and only numbers are tried.
        """
        ratios = [x / y for x, y in zip(values, divisors, strict=True) if y]
        if len(ratios) == len(values):
            yield from self.multiples(ratios)
        elif ratios and all(y or abs(x) <= NONE * max(map(abs, values)) for x, y in zip(values, divisors, strict=True)):
            number = constant_of(ratios)
            if number:
                yield 0.0, sympy.Rational(number), sympy.S.One

    def _cost_of_typed(self, total: Sum, term: Any) -> float:
        """Return the cost that is added for a change of `term` in the sum `total`, by its place in the equation.

        Terms of a typed d/dt(...), and an acceleration that is alone on one side, are unlikely to be wrong.
        """
        if term in self.derived:
            return OF_DERIVATIVE
        if not term.has(*self.unknowns, *self.rates):
            return 0.0
        number, factor = term.as_coeff_Mul()
        opposite = self.row.sides[1 - total.side]
        if len(total.terms) == 1 and not total.path and factor.is_Symbol and opposite.count_ops():
            return OF_SOLVED if number == 1 else 0.0
        return OF_RATE if term.has(*self.moving) else 0.0

    def _cost_of_side(self, total: Sum, missing: Any) -> float:
        """Return the cost that is added if `missing` is a missing term of the sum `total`, by its side of the equation.

        It is zero within brackets. Terms with accelerations may be on one side, and the others on the other side. Then
        it is zero for the side of terms like this one. It is high for a side that is zero.
        """
        containing, opposite = self.row.sides[total.side], self.row.sides[1 - total.side]
        if total.path:
            return 0.0
        if containing == 0:
            return OF_SOLVED
        if opposite == 0:
            return 0.0
        # True for a side if each of its terms has an acceleration or a multiplier, or comes from a typed derivative.
        has_rates, other_has = (
            all(term.has(*self.unknowns) or term in self.derived for term in sympy.Add.make_args(side))
            for side in (containing, opposite)
        )
        if has_rates != other_has and has_rates == missing.has(*self.unknowns):
            return 0.0
        return OF_RATE * (1 + total.side) / 2

    def has_unlikely_factor(self, row: EquationRow) -> bool:
        """Return True if the equation `row` is a correct equation times an unlikely factor, such as 3 m.

        Only the coefficients of accelerations are compared. A factor is likely if it is a product of symbols, without a
        number other than 1 or -1.
        """
        try:
            slopes = [row.numbers(sample) for sample in self.samples]
        except OutsideDomain:
            return False
        for i in range(len(self.row.statement.names)):
            masses = [sample.mass[i] for sample in self.samples]
            if all(mass[i] for mass in masses):
                factors = [line[i] / mass[i] for line, mass in zip(slopes, masses, strict=True)]
                residuals = [
                    max(abs(slope - factor * entry) for slope, entry in zip(line, mass, strict=False))
                    for line, mass, factor in zip(slopes, masses, factors, strict=True)
                ]
                if all(x <= CLOSE * max(map(abs, line)) for x, line in zip(residuals, slopes, strict=True)):
                    numbers = sorted((cost, abs(number)) for cost, number, _ in self.multiples(factors))
                    return not numbers or numbers[0][1] != 1
        return False

    def corrected(self, total: Sum, difference: Difference) -> EquationRow | None:
        """Return the equation with the sum `total` changed by `difference`, or None if not linear in accelerations."""
        sides = list(self.row.sides)
        rest = 0 if difference.typed == total.whole else total.whole - difference.typed
        sides[total.side] = _with(sides[total.side], total.path, rest + difference.right)
        try:
            return self.row.with_zero(sides[0] - sides[1], sides[1])
        except StatementError:
            return None


def _bases(term: Any) -> list[Any]:
    """Return the bases of the factors of a product of powers, such as m and l for m*l**2."""
    return [factor.as_base_exp()[0] for factor in sympy.Mul.make_args(term)]


def _sums_below(term: Any) -> set[Any]:
    """Return the sums that are factors in the denominator of a product, such as a + b for x/(a + b)**2."""
    powers = (factor for factor in sympy.Mul.make_args(term) if factor.is_Pow and factor.base.is_Add)
    return {power.base for power in powers if power.exp.is_negative}


def _root(first: Any, second: Any, third: Any) -> Any:
    """Return the zero x of f = (a + b*x)/(1 + d*x), or None; `first`, `second`, `third` are f at x = 0, 1 and 3."""
    if abs(third - second) <= NONE * (abs(third) + abs(second)):
        return None
    d = (3 * second - 2 * first - third) / (3 * (third - second))
    b = second * (1 + d) - first
    return -first / b if b else None


def _centred(values: Numbers) -> Any:
    """Return the logarithms of the magnitudes of values, minus their mean: the same for values times a constant."""
    with np.errstate(all="ignore"):
        logs = np.log(np.array([abs(float(x)) for x in values]))
        return logs - logs.mean()
