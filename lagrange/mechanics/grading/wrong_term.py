"""Find the wrong term of a student's equation by comparison with the derived equations, and say so in a sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import combinations, product
from typing import Any

import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, capitalized, listing
from lagrange.evidence.differences import solve_dense
from lagrange.evidence.precise import OutsideDomain
from lagrange.mechanics.grading.motion_samples import SINGULAR, MotionSample
from lagrange.mechanics.grading.one_change import Change, evaluated, one_change
from lagrange.mechanics.grading.student_equations import EquationRow, rate_symbols, tape, values_at
from lagrange.mechanics.grading.term_difference import Difference, Numbers, Write, expanded, same, summands
from lagrange.mechanics.grading.time_limit import check_budget
from lagrange.mechanics.plain_form import simplest, time_derivative
from lagrange.statement.coordinate import constraint_of, name_of, rotation_name, t

MOST_SHARED = 20  # Largest number of terms of a correct equation, of which partial sums are also compared

LONGEST_SOLVED = 300  # Largest number of operations in a solved acceleration whose denominator is compared
LONGEST_FACTOR = 12  # Largest number of operations of a factor of a side that a message quotes
LONGEST_FORMULA = 3_000  # Largest number of operations in a solved acceleration whose terms are compared
LONGEST_RATIO = 60  # Largest number of operations of two terms whose ratio is simplified
MOST_NAMED = 2  # Largest number of wrong terms that are all named; if there are more, only the first one is named
MOST_MATCHED = 60  # Largest number of typed and correct terms together that are matched one by one


@dataclass(frozen=True)
class WrongTerm:
    """A sentence on the error of an equation. `alone` is true if exactly one term of the equation is wrong.

    `cost` is lower for a likelier mistake, such as a sign; it is infinite if several terms are wrong. `shorter` is true
    if the correct term is at most as long as the typed one.
    """

    sentence: str
    alone: bool = False
    cost: float = math.inf
    shorter: bool = False


def wrong_term(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> WrongTerm:
    """Return the wrong term of a typed equation `row` that does not hold at the `samples`.

    `derivation` has the correct equations. `write` turns an expression into text. Raises BudgetSpent if the time is up.
    """
    check_budget()
    label = capitalized(row.equation.label)
    if not row.zero.free_symbols:
        return WrongTerm(f"{label} does not hold, and contains no symbol of this system.")
    constraints = row.statement.constraints
    momentum = _wrong_momentum(row, derivation, samples, write) or _wrong_term_of_momentum(row, samples, write)
    if momentum:
        return WrongTerm(momentum, alone=True, cost=0.0, shorter=True)
    change = one_change(row, samples, _right_terms(derivation), _right_denominators(derivation))
    if change is not None:
        shorter = change.difference.right.count_ops() <= change.difference.typed.count_ops()
        return WrongTerm(
            _change_sentence(change, row, samples[0], write), alone=True, cost=change.cost, shorter=shorter
        )
    still = not any(row.slopes.values()) and not any(sample.first_order for sample in samples)
    if still and not constraints:
        free = [name_of(q) for q in row.statement.coordinates if rotation_name(q) is None]
        example = "{0}'' or {0}_ddot".format(free[0]) if free else f"{row.statement.rotations[0]}_body_x'"
        end = f"contains no acceleration such as {example}: it is not an equation of motion."
        return WrongTerm(f"{label} does not hold, and {end}")
    if still:
        listed = [f"{c.name}, {write(c.expression.xreplace(row.statement.plain))} = 0" for c in constraints]
        which = "the constraint is" if len(listed) == 1 else "the constraints are"
        return WrongTerm(f"{label} does not hold and is not a constraint: {which} {listing(listed)}.")
    several = _undefined_term(row, samples, write) or _several_wrong_terms(row, derivation, samples, write)
    return WrongTerm(several or f"{label} does not hold, and none of its terms is in an equation of motion.")


def _undefined_term(row: EquationRow, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence on a term without a value at one of the samples, as the root of a negative number, or ""."""
    for side in row.sides:
        for term in sympy.Add.make_args(side):
            try:
                evaluated([term], row, samples)
            except OutsideDomain as error:
                return f"{_place_of('', row)} the term {write(term)} has no value at some states: {error}."
    return ""


def _several_wrong_terms(
    row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write
) -> str:
    """Return a sentence on an equation with several wrong terms, or "" if it resembles no correct equation.

    The equation is compared with each correct one, multiplied by each factor for which at least one term agrees. The
    one with the most terms in common is taken; among equals, the one with the simplest factor.
    """
    typed = [(side, term) for side in (0, 1) for term in summands(row.in_full(row.sides[side])) if term != 0]
    signed = [term if side == 0 else -term for side, term in typed]
    best: tuple[int, float] = (0, 0.0)
    sentence = ""
    for name, zero in _right_rows(row, derivation):
        right = summands(zero)
        for factor, unmatched, missing in _compared(signed, right, row, samples):
            rank = (len(typed) - len(unmatched), -float(factor.count_ops()))
            if rank > best:
                best = rank
                wrong, absent = [typed[i] for i in unmatched], [factor * right[j] for j in missing]
                several = max(len(wrong), len(absent)) > MOST_NAMED  # then only the first one is named
                endings = []
                for side, term, correct in (
                    _pairs(wrong[:1], absent, row)[:1] if several else _pairs(wrong, absent, row)
                ):
                    place = "on the right side " if side and row.sides[0] != 0 else ""
                    endings.append(place + _difference(term, correct).ending(sympy.S.One, write))
                sentence = f"{_place_of(name, row)} {' Also, '.join(endings)}"
                sentence += " Other terms of it are wrong or missing, too." if several else ""
    return sentence


def _compared(
    typed: Sequence[Any], right: Sequence[Any], row: EquationRow, samples: Sequence[MotionSample]
) -> Iterator[tuple[Any, list[int], list[int]]]:
    """Compare the terms `typed` of an equation with a factor times `right`, the terms of a correct equation.

    Yield (factor, unmatched, missing). `unmatched` are the indices of entries of `typed` that match no correct term,
    `missing` those of entries of `right` that match no typed term. There is one comparison for each pair of a typed and
    a correct term, whose quotient is the factor.
    """
    if len(typed) + len(right) > MOST_MATCHED:
        return
    try:
        values, expected = evaluated(typed, row, samples), evaluated(right, row, samples)
    except OutsideDomain:
        return
    anchors = typed[:1] if row.sides[0] in row.slopes else typed  # the left side of a solved equation is correct
    for (i, term), (j, correct) in product(enumerate(anchors), enumerate(right)):
        factor = term / correct
        if factor in (1, -1):  # terms that are zero at some states, as on one side of a switch, may have this factor
            yield factor, *_unmatched(values, [[int(factor) * x for x in line] for line in expected])
        elif not factor.has(*row.slopes) and all(expected[j]):
            scale = [a / b for a, b in zip(values[i], expected[j], strict=True)]
            yield factor, *_unmatched(values, [[c * x for c, x in zip(scale, line, strict=True)] for line in expected])


def _right_rows(row: EquationRow, derivation: Derivation) -> list[tuple[str, Any]]:
    """Return pairs (coordinate name, left side - right side) for the correct equations of motion.

    If the typed equation `row` is solved for an acceleration, and there are no constraints, so are the correct ones.
    Accelerations with more than `LONGEST_FORMULA` operations are then left out.
    """
    statement, rates = derivation.statement, rate_symbols(derivation.statement)
    rows: list[tuple[str, Any]] = []
    with suppress(StatementError):
        accelerations = list(statement.plain.values())[2::3]
        if row.sides[0] in accelerations and not row.sides[1].has(*accelerations) and not statement.constraints:
            solved = zip(statement.names, accelerations, derivation.accelerations.values(), strict=True)
            rows += [(name, left - right) for name, left, right in solved if right.count_ops() <= LONGEST_FORMULA]
        else:
            zeros = [law.lhs - law.rhs for law in derivation.equations]
            rows += zip(statement.names, zeros, strict=False)
    return [(name, zero.xreplace(rates).xreplace(statement.plain)) for name, zero in rows]


def _unmatched(typed: Sequence[Numbers], right: Sequence[Numbers]) -> tuple[list[int], list[int]]:
    """Match typed and correct (`right`) terms by values at sampled states; return the indices of both without match."""
    unmatched, missing = [], list(range(len(right)))
    for i, values in enumerate(typed):
        match = next((j for j in missing if same(values, right[j])), None)
        if match is None:
            unmatched.append(i)
        else:
            missing.remove(match)
    return unmatched, missing


def _pairs(
    unmatched: Sequence[tuple[int, Any]], missing: Sequence[Any], row: EquationRow
) -> list[tuple[int, Any, Any]]:
    """Return (side, typed term, correct term) for each wrong or missing term of the equation `row`.

    The side is 0 for left and 1 for right. `unmatched` are the wrong terms, as (side, term), and `missing` the missing
    ones, as terms of the left side. Terms with the most factors in common are paired. A term without a partner is
    paired with zero. The typed terms keep their order. A correct term in the result has the sign of its side.
    """
    partners, alone = dict[int, Any](), list(missing)
    bases = [set(term.as_powers_dict()) for _, term in unmatched]
    while alone and len(partners) < len(unmatched):
        choices = product((k for k in range(len(unmatched)) if k not in partners), alone)
        k, right = max(choices, key=lambda choice: len(bases[choice[0]] & set(choice[1].as_powers_dict())))
        partners[k] = simplest(-right if unmatched[k][0] else right)
        alone.remove(right)
    pairs = [(side, term, partners.get(k, sympy.S.Zero)) for k, (side, term) in enumerate(unmatched)]
    # Of an equation such as m*x'' = ..., terms without an acceleration are missing on the right side.
    solved = row.sides[1] != 0 and all(term.has(*row.slopes) for term in sympy.Add.make_args(row.sides[0]))
    sides = [int(solved and not right.has(*row.slopes)) for right in alone]
    return pairs + [(side, sympy.S.Zero, -right if side else right) for side, right in zip(sides, alone, strict=True)]


def _difference(typed: Any, right: Any) -> Difference:
    """Return the difference of a typed term from the correct term `right`; one of the two may be zero."""
    if typed == 0 or right == 0:
        return Difference("missing" if typed == 0 else "extra", typed, right)
    ratio = sympy.cancel(typed / right) if typed.count_ops() + right.count_ops() <= LONGEST_RATIO else sympy.nan
    if ratio.is_Rational:
        return Difference("scaled", typed, right, Fraction(ratio.p, ratio.q))
    return Difference("wrong", typed, right)


@lru_cache(maxsize=1)
def _right_terms(derivation: Derivation) -> list[Any]:
    """Return terms that a correct equation may have.

    They are terms of the equations of motion and of entries of the mass matrix, if these are not too large, and of the
    constraints and their first and second time derivatives. Rates of rotations stay symbols.
    """
    statement = derivation.statement
    rates = rate_symbols(statement)
    zeros = [constraint.expression.xreplace(statement.plain) for constraint in statement.constraints]
    zeros += [time_derivative(zero, statement.plain) for zero in zeros]
    zeros += [time_derivative(zero, statement.plain) for zero in zeros[len(statement.constraints) :]]
    with suppress(StatementError):
        laws = [(law.lhs - law.rhs).xreplace(rates).xreplace(statement.plain) for law in derivation.equations]
        zeros = laws + zeros + [entry.xreplace(statement.plain) for entry in derivation.mass_matrix]
    parts = [summands(zero) for zero in zeros]
    few, parameters = [terms for terms in parts if len(terms) <= MOST_SHARED], statement.parameters
    # The sum of all terms with one parameter, such as a stiffness, in factored form.
    sharing = [sympy.Add(*(term for term in terms if term.has(p))) for terms in few for p in parameters]
    terms = [term for zero in zeros for term in (*sympy.Add.make_args(zero), *expanded(zero))]
    return terms + [total for total in map(sympy.factor_terms, sharing) if total.has(sympy.Add)]


@lru_cache(maxsize=1)
def _right_denominators(derivation: Derivation) -> list[Any]:
    """Return the denominators of the correct accelerations; [] for constraints, rotations and too large formulas."""
    statement = derivation.statement
    if statement.constraints or statement.rotations:
        return []
    with suppress(StatementError):
        solved = [a for a in derivation.accelerations.values() if a.count_ops() <= LONGEST_SOLVED]
        below = [sympy.fraction(sympy.together(a.xreplace(statement.plain)))[1] for a in solved]
        return list(dict.fromkeys(below))
    return []


def _change_sentence(change: Change, row: EquationRow, sample: MotionSample, write: Write) -> str:
    """Return a sentence on `change`, the correction of the only wrong term of an equation; the term is as typed."""
    total, difference = change.total, change.difference
    start = _place_of(_meant(change.row, sample), row)
    if total.below:
        corrected = total.whole - difference.typed + difference.right
        return f"{start} the denominator {write(total.whole)} is wrong: it should be {write(corrected)}."
    side, other = (row.sides[k] for k in (total.side, 1 - total.side))
    right = " on the right side" if total.side and other != 0 else ""
    solved = total.side and other in list(row.slopes)[: len(sample.accelerations)]
    if solved and difference.typed == side and (side.is_Add or (side.has(sympy.Add) and difference.ratio == -1)):
        factor = sympy.cancel(difference.typed / difference.right)
        if factor.count_ops() <= LONGEST_FACTOR:
            return f"{start} the right side {_factor_ending(factor, write)}"
    if difference.kind == "wrong" and not total.path:
        (above, below), (other, right_below) = map(sympy.fraction, (difference.typed, difference.right))
        if below.is_Add and above == other:
            return f"{start} the denominator {write(below)} is wrong: it should be {write(right_below)}."
    ending = difference.ending(total.around, write)
    name = next((constraint_of(x) for x in difference.right.free_symbols if constraint_of(x) is not None), None)
    if difference.kind == "missing" and name is not None:
        ending = ending.replace(" is missing.", f", the force of the constraint {name}, is missing.")
    return f"{start}{right} {ending}"


def _meant(row: EquationRow, sample: MotionSample) -> str:
    """Return the names of coordinates, or of the constraint, whose equation `row` is, or "" if it is not clear."""
    names, plain, slopes = row.statement.names, list(row.statement.plain.values()), row.leading(sample)
    constraint = _constraint_meant(row, slopes, sample)
    if constraint:
        return f"the constraint {constraint}"
    left = row.sides[0].as_coeff_Mul()[1]
    if left in plain[2::3] or (sample.first_order and left in plain[1::3]):
        return names[plain.index(left) // 3]
    if row.statement.rotations or not any(slopes[: len(names)]):
        return ""
    with suppress(OutsideDomain):
        weights = solve_dense(sample.mass, slopes[: len(names)], SINGULAR)
        used = [name for name, w in zip(names, weights, strict=True) if abs(w) > SINGULAR * max(map(abs, weights))]
        return used[0] if len(used) == 1 else f"{listing(used)} together" if len(used) == 2 else ""
    return ""


def _constraint_meant(row: EquationRow, slopes: Numbers, sample: MotionSample) -> str:
    """Return the name of the constraint that an equation states, or "".

    The gradient of this constraint is parallel to the coefficients of accelerations in the equation, or, if it has no
    accelerations, to its derivatives by coordinates. `slopes` are the coefficients of accelerations and multipliers.
    """
    statement, count = row.statement, len(row.statement.names)
    if any(slopes[count:]):
        return ""
    direction = slopes[:count]
    if not any(row.slopes.values()) and not sample.first_order:
        coordinates = list(statement.plain.values())[::3]
        direction = values_at(tape([sympy.diff(row.zero, q) for q in coordinates], statement), sample)
    for constraint, gradient in zip(statement.constraints, sample.gradient, strict=True):
        size = max(map(abs, direction)) * max(map(abs, gradient))
        pairs = combinations(zip(direction, gradient, strict=True), 2)
        if size > 0 and all(abs(a * d - b * c) <= SINGULAR * size for (a, b), (c, d) in pairs):
            return constraint.name
    return ""


def _place_of(name: str, row: EquationRow) -> str:
    """Return "In equation 2, for x," to begin a sentence; the `name` x is left out if it is "" or in the label."""
    return f"In {row.equation.label}" + ("" if not name or name in row.equation.label else f", for {name},")


def _factor_ending(factor: Any, write: Write) -> str:
    """Return the end of a sentence on a side of an equation that is `factor` times what it should be."""
    if factor == -1:
        return "has the wrong sign: it is -1 times what it should be."
    above, below = sympy.fraction(factor)
    if above.free_symbols:
        return f"has the wrong denominator: it should be divided by {write(factor)}."
    if factor.free_symbols and above == 1:
        return f"has the wrong denominator: it should be multiplied by {write(below)}."
    return f"has the wrong factor: it is {write(factor)} times what it should be."


def _wrong_momentum(row: EquationRow, derivation: Derivation, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence on a wrong expression in a typed d/dt(...), or "".

    It is wrong if the equation would hold with a constant times a momentum in place of the expression.
    """
    statement, momenta = row.statement, list[Any]()
    with suppress(StatementError):
        momenta = [p.xreplace(statement.plain) for p in derivation.momenta.values()]
    pairs = zip(statement.names, momenta, strict=False)  # no momenta if they are too large to write out
    for typed, (name, p) in product(dict.fromkeys(row.equation.differentiated), pairs):
        check_budget()
        if p == 0 or p.count_ops() > LONGEST_SOLVED:
            continue
        if row.sides[1] == 0 and p.is_Mul:  # The student may have divided by parameters.
            p /= sympy.Mul(*(q for q in p.args if q in statement.parameters and not typed.has(q)))
        # The student may have meant a multiple of the momentum. The factor is the ratio with 1 for all coordinates,
        # velocities and the time.
        ones = dict.fromkeys((*statement.plain.values(), t), sympy.S.One)
        value = sympy.cancel(row.in_full(typed) / p).xreplace(ones)
        constants = dict.fromkeys((sympy.Integer(-1 if value.could_extract_minus_sign() else 1), value))
        known = [constant for constant in constants if constant.is_finite is not False and constant != 0]
        for constant, sign in product(known, (1, -1)):
            expected = sympy.Mul(constant, p) if p.is_Mul else constant * p
            change = sign * time_derivative(expected - row.in_full(typed), statement.plain)
            if row.with_zero(row.zero + change).holds(samples):
                sentence = f"the term d/dt({write(typed)}) is wrong: it should be d/dt({write(expected)})."
                return f"{_place_of(name, row)} {sentence}"
    return ""


def _wrong_term_of_momentum(row: EquationRow, samples: Sequence[MotionSample], write: Write) -> str:
    """Return a sentence on a term in a typed d/dt(...) that has a wrong sign, or a wrong factor 2 or 1/2, or "".

    Terms without a velocity are tried first.
    """
    velocities, ratios = list(row.statement.plain.values())[1::3], (Fraction(-1), Fraction(2), Fraction(1, 2))
    for typed in dict.fromkeys(row.equation.differentiated):
        terms = sorted(typed.args if typed.is_Add else (), key=lambda term: term.has(*velocities))
        for term, ratio, sign in product(terms, ratios, (1, -1)):
            right = term / sympy.Rational(ratio)
            change = sign * time_derivative(row.in_full(right - term), row.statement.plain)
            if row.with_zero(row.zero + change).holds(samples):
                difference = Difference("scaled", term, right, ratio).ending(sympy.S.One, write)
                return f"{_place_of('', row)}, in d/dt({write(typed)}), {difference}"
    return ""
