"""Compare a student's equations of motion with the correct ones, in every branch, and name the first wrong term."""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.derivation import Derivation, derive
from lagrange.errors import StatementError, capitalized, listing
from lagrange.evidence.differences import solve_dense
from lagrange.evidence.precise import OutsideDomain, all_ways, describe_way
from lagrange.mechanics.grading.motion_samples import SINGULAR, MotionSample, MotionStates, motion_samples
from lagrange.mechanics.grading.slips import slip_of, with_exact_numbers, with_parameters, wrong_definition
from lagrange.mechanics.grading.student_equations import (
    LARGEST_RESIDUAL,
    EquationRow,
    StudentEquation,
    row_of,
    tape,
    values_at,
)
from lagrange.mechanics.grading.term_difference import LARGEST_FACTOR, Write
from lagrange.mechanics.grading.time_limit import UNNAMED, BudgetSpent, check_size
from lagrange.mechanics.grading.wrong_term import WrongTerm, wrong_term
from lagrange.mechanics.plain_form import time_derivative
from lagrange.statement.coordinate import constraint_of, name_of, rotation_name
from lagrange.statement.display import ShownAsPage
from lagrange.statement.random_states import SamplePoint, Sampler
from lagrange.statement.statement import Statement

DRAWS = 1000  # Random points drawn to reach further branches of conditions; most cost one evaluation of the conditions
MOST = 16  # Largest number of states added to cover other branches

NEAREST = 8.0
"""Largest number of leading digits in which a random coordinate, velocity or parameter agrees with a number in the
equations. States between 3 and 3.0001 are then reached, where another branch of a condition may hold."""

Way = tuple[Any, int]  # A switch (such as a condition or Abs) and one of its outcomes


def branch_samples(
    statement: Statement, rows: Sequence[EquationRow], known: Sequence[MotionSample]
) -> tuple[list[MotionSample], list[Way]]:
    """Return (further samples at which other branches of formulas hold, branches that no sample reaches).

    Branches are outcomes of switches: of conditions, Abs, sign, Min and Max in the statement and in the equations
    `rows`. Each sample has another combination of outcomes than the others and the earlier samples, `known`. Random
    states have entries of all magnitudes, and near the numbers in the equations, energies and forces.
    """
    states = MotionStates(statement)
    switches = [*states.reference.switches, *(switch for row in rows for switch in row.switches)]
    if not switches:
        return [], []

    def ways(point: SamplePoint) -> tuple[int | None, ...]:
        return (*states.reference.inspect(point), *(way for row in rows for way in row.ways(point)))

    samples: list[MotionSample] = []
    seen: set[tuple[int | None, ...]] = set()
    for sample in known:
        with suppress(OutsideDomain):
            seen.add(ways(sample.point))
    for point in _points(statement, rows):
        if len(samples) == MOST:
            break
        with suppress(OutsideDomain):
            point = states.satisfied(point)
            if (outcomes := ways(point)) not in seen:
                samples.append(states.motion(point))
                seen.add(outcomes)
    reached = {pair for outcomes in seen for pair in zip(switches, outcomes, strict=True)}
    every = dict.fromkeys((switch, way) for switch in switches for way in all_ways(switch))
    return samples, [pair for pair in every if pair not in reached]


def _points(statement: Statement, rows: Sequence[EquationRow]) -> Iterator[SamplePoint]:
    """Yield `DRAWS` random states with parameters, whose numbers have all magnitudes.

    Half of the coordinates and velocities are near 1 or a number in the equations `rows`, the energies or the forces.
    """
    sampler, draw = Sampler(statement, 1), random.Random(1)
    expressions = [statement.lagrangian, *statement.forces, *(row.zero for row in rows)]
    every = {1.0} | {abs(float(x)) for term in expressions for x in term.atoms(sympy.Number) if x.is_finite}
    numbers = sorted(x for x in every if x and math.isfinite(x))

    def near() -> float:
        sign, number, way = draw.choice((-1, 1)), draw.choice(numbers), draw.choice((-1, 1))
        return sign * number * (1 + way * 10 ** -draw.uniform(0, NEAREST))

    for _ in range(DRAWS):
        point = sampler.far()
        q, v = (tuple(near() if draw.random() < 0.5 else x for x in entries) for entries in (point.q, point.v))
        values = {p: math.copysign(near(), x) if draw.random() < 0.2 else x for p, x in point.parameters.items()}
        yield replace(point, q=q, v=v, parameters=values)


def with_multiples(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> list[list[MotionSample]]:
    """Return lists of the same samples with different multipliers, because an answer may define multipliers otherwise.

    A multiplier of an answer may be a multiple of that of the system, or have the opposite sign. The first list has the
    multipliers of the system. Each other list has multiples with which the forces in one equation are correct.
    """

    def multiples(row: EquationRow, sample: MotionSample) -> list[Any]:
        """Return the factor of each multiplier that makes its force in `row` the true one; None if undetermined."""
        n = len(sample.mass)
        slopes = row.numbers(sample)
        weights = solve_dense(sample.mass, slopes[:n], SINGULAR)
        exerted = [sum(w * x for w, x in zip(weights, line, strict=True)) for line in sample.gradient]
        size = max(map(abs, exerted), default=0)
        return [
            -part / slope if slope and abs(part) > LARGEST_RESIDUAL * size else None
            for part, slope in zip(exerted, slopes[n:], strict=True)
        ]

    choices = [list(samples)]
    for row in rows:
        if not any(list(row.slopes.values())[len(row.statement.names) :]):
            continue
        with suppress(OutsideDomain):
            scaled = []
            for sample in samples:
                # A multiplier that `row` lacks is scaled to its value in the first equation that has it.
                columns = zip(*(multiples(other, sample) for other in (row, *rows)), strict=True)
                first = [next((x for x in column if x is not None), 1) for column in columns]
                forces = tuple(x * k for x, k in zip(sample.multipliers, first, strict=True))
                scaled.append(replace(sample, multipliers=forces))
            choices.append(scaled)
    return choices


def sentence_on_multipliers(chosen: Sequence[MotionSample], samples: Sequence[MotionSample]) -> str:
    """Return a sentence on the ratio of an answer's multipliers to the multipliers of the system.

    `chosen` are samples with the multipliers of the answer, `samples` the same samples with those of the system.
    """
    pairs = [zip(a.multipliers, b.multipliers, strict=True) for a, b in zip(chosen, samples, strict=True)]
    every = [a / b for pair in pairs for a, b in pair if b]
    ratio = Fraction(str(every[0])).limit_denominator(LARGEST_FACTOR) if every else Fraction(1)
    if any(abs(x * ratio.denominator - ratio.numerator) > LARGEST_RESIDUAL * (1 + abs(ratio.numerator)) for x in every):
        return " Their multipliers are multiples of those of the system."
    if ratio in (1, -1):
        return "" if ratio == 1 else " The multipliers have the opposite sign."
    return f" Their multipliers are {ratio} times those of the system."


NEGATIVE = 0.5  # Cost of a negative force, such as a tension; the change of a sign costs 1
MOST_LISTED = 4  # Largest number of coordinates for which a message lists the whole state
MOST_READ = 2  # Largest number of ambiguous equations whose interpretation a message shows; `.read` has all of them
LONGEST_MESSAGE = 400  # Longest message, in characters. The rest goes to `.details`.
NEGLIGIBLE = 1e-9  # Smaller numbers in a correct equation are tried as zero: the comparison cannot test them
LONGEST_QUOTED = 120  # Longest constraint in a message, in characters
SIGNED_SAMPLES = 16  # Number of random states in the search for conditions, such as x > 0, under which an answer holds
SAMPLES = 5  # Number of random states that are always compared; at fewer a wrong equation may pass by chance


@dataclass(frozen=True)
class _Case:
    """An answer to be compared: its equations `rows`, the statement of the system, and the correct equations.

    `derivation` has the correct equations; for a system with rotations it is of another statement, in rates of bodies.
    `write` turns an expression into text for messages. `distances` are the names of coordinates that are positive in
    all samples. `has_typed_forces` is true if multipliers were typed as forces such as T. `has_false_remark` is true if
    a remark in the answer, such as a relation in equilibrium, does not hold; it is not among the rows.
    """

    rows: Sequence[EquationRow]
    statement: Statement
    derivation: Derivation
    write: Write
    distances: Collection[str]
    has_typed_forces: bool
    has_false_remark: bool

    def wrong(self, samples: Sequence[MotionSample]) -> tuple[int, ...]:
        """Return the indices of the equations that fail at one or more of the samples."""
        return tuple(i for i, row in enumerate(self.rows) if not row.holds(samples))

    def is_unlikely(self, samples: Sequence[MotionSample]) -> bool:
        """Return True if the samples have unlikely multipliers: a negative sum, though they were typed as forces."""
        return self.has_typed_forces and bool(sum(sum(sample.multipliers) for sample in samples) < 0)


@dataclass(frozen=True, repr=False)
class EquationsComparison(ShownAsPage):
    """Result of a comparison: true if the equations are correct. Else `message` names the first wrong term.

    `right` is the result as a bool. `counterexample` maps names to values: a state at which the first wrong equation
    fails, and the true accelerations. It is empty if no such state is known. `details` is the counterexample as a
    sentence. `wrong` lists the indices of the wrong equations in the answer. `read` is the text of the equations as
    they were understood, one per line, in the notation of scene files.
    """

    right: bool
    message: str
    wrong: tuple[int, ...] = ()
    counterexample: Mapping[str, float] = field(default_factory=dict)
    details: str = ""
    read: str = ""

    def __bool__(self) -> bool:
        return self.right

    def __str__(self) -> str:
        return self.message

    def __repr__(self) -> str:
        return f"<EquationsComparison: {'right' if self else 'wrong'}. {self.message}>"


def compare_equations(
    statement: Statement,
    derivation: Derivation,
    equations: Sequence[StudentEquation],
    write: Write,
    distances: Collection[str] = (),
) -> EquationsComparison:
    """Return the result of comparing a student's equations with the equations of motion of a statement.

    `derivation` has the correct equations. `write` turns an expression into text for messages. `distances` are the
    names of coordinates that are positive in the comparison. If the equations do not hold, they are also compared for
    positive distances such as a radius. Raises StatementError if an equation is not linear in the accelerations.
    """
    samples = motion_samples(statement, SAMPLES, positive=distances)
    likeliest = [_likeliest(equation, statement, samples) for equation in equations]
    rows = [row for row in likeliest if not row.equation.aside or row.holds(samples)] or likeliest
    if not distances and not all(row.holds(samples) for row in rows):
        positive = _distances(derivation)
        with suppress(StatementError):  # constraints may leave no state with positive distances
            if positive:
                return compare_equations(statement, derive(statement, positive), equations, write, positive)
    equations = [row.equation for row in rows]
    letters = {multiplier: letter for equation in equations for multiplier, letter in equation.letters.items()}
    has_typed_forces = any(not str(letter).startswith("lam") for letter in letters.values())

    def written(expression: Any) -> str:
        return write(expression.xreplace(letters))

    further, untried = branch_samples(statement, rows, samples)
    entries = [statement.names.index(name) for name in distances]
    samples += [sample for sample in further if all(sample.point.q[i] > 0 for i in entries)]
    case = _Case(
        rows, statement, derivation, written, distances, has_typed_forces, has_false_remark=len(rows) < len(likeliest)
    )
    return _with_remarks(_compared(case, samples, untried), equations, letters)


def _with_remarks(
    result: EquationsComparison, equations: Sequence[StudentEquation], letters: Mapping[Any, Any]
) -> EquationsComparison:
    """Return a result with remarks on how its equations were read, and with their indices in the whole answer.

    `letters` maps multipliers to the letters that were typed for them. A message that gets too long is moved to
    `.details`.
    """
    reported = [equations[i] for i in result.wrong] or equations
    remark = "".join(f" {equation.note}" for equation in reported if equation.note)
    ambiguous = [equation.read for equation in reported if equation.others]
    remark += f" Read as {listing(ambiguous[:MOST_READ])}." if ambiguous else ""
    for multiplier, letter in letters.items():
        if not str(letter).startswith("lam"):
            remark += f" {letter} is read as the force of the constraint {constraint_of(multiplier)}."
    read = "\n".join(equation.read for equation in equations)
    result = replace(result, wrong=tuple(dict.fromkeys(equations[i].index for i in result.wrong)))
    if len(result.message + remark) <= LONGEST_MESSAGE:
        return replace(result, message=result.message + remark, read=read)
    short = result.message.partition(": it ")[0].rstrip(".") + "."
    if not result.wrong:
        remark = ""
    elif len(short + remark) > LONGEST_MESSAGE:
        short, remark = f"{capitalized(reported[0].label)} does not hold: .details names its first wrong term.", ""
    return replace(result, message=short + remark, details=f"{result.message} {result.details}".strip(), read=read)


def _likeliest(equation: StudentEquation, statement: Statement, samples: Sequence[MotionSample]) -> EquationRow:
    """Return the likeliest reading of an ambiguous equation: the first one that holds at all samples, else the first.

    A reading may hold only after exact numbers replace its decimals, or after differentiation. Then `note` says so in a
    sentence. A reading that is not linear in accelerations is skipped. Raises StatementError if no reading is linear.
    """
    rows, refused = list[EquationRow](), list[StatementError]()
    for reading in (equation, *equation.others):
        try:
            row = row_of(reading, statement)
        except StatementError as error:
            refused.append(error)
            continue
        if row.holds(samples):
            return row
        rows.append(row)
    for row in rows:
        moving = [*list(statement.plain.values())[1::3], *row.slopes]
        if {constraint.holonomic for constraint in statement.constraints} == {False} and not row.zero.has(*moving):
            # A student may type the constraint x' = R phi' as x = R phi, which is correct up to a constant.
            note = f"{capitalized(row.equation.label)} is right up to a constant."
            zero = time_derivative(row.zero, statement.plain)
            rate = row_of(replace(row.equation, zero=zero, right=sympy.S.Zero, note=note), statement)
            if zero != 0 and rate.holds(samples):
                return rate
        exact = with_exact_numbers(row, samples)
        if exact is not None:
            return row_of(exact, statement)
    if rows:
        return rows[0]
    raise refused[0]


def _compared(case: _Case, samples: Sequence[MotionSample], untried: Sequence[Way]) -> EquationsComparison:
    """Return the result for an answer at `samples`; `untried` has branches (switch, outcome) that no sample reaches."""
    rows, statement = case.rows, case.statement
    choices = with_multiples(rows, samples)
    negated = [replace(sample, multipliers=tuple(-x for x in sample.multipliers)) for sample in samples]
    count, slopes = len(statement.names), [list(row.slopes.values()) for row in rows]
    # An answer may choose the sign of multipliers unless an equation has both multipliers and accelerations.
    free = not any(any(line[:count]) and any(line[count:]) for line in slopes)
    if statement.constraints and free and not case.is_unlikely(negated):
        choices.append(negated)
    right = next((chosen for chosen in choices if not case.wrong(chosen)), None)
    if right is None:
        choices += [negated] if statement.constraints and choices[-1] is not negated else []
        return _judged_wrong(case, choices)
    missing = _missing(rows, right, has_false_remark=case.has_false_remark)
    if missing:
        start = "The equation holds" if len(rows) == 1 else "The equations hold"
        return EquationsComparison(right=False, message=f"{start}, but {missing}")
    idle = _idle(rows, samples)
    if idle:
        return EquationsComparison(right=False, message=idle)
    where = f" where {listing(f'{name} > 0' for name in case.distances)}" if case.distances else ""
    message = f"The equations are right{where}: they are equivalent to those of the system"
    message += f", at the {len(samples)} states tried.{sentence_on_multipliers(right, samples)}"
    if untried:
        more = f", nor for {len(untried) - 1} other branches" if len(untried) > 1 else ""
        message += f" No state was found where {describe_way(*untried[0], statement)}{more}."
    return EquationsComparison(right=True, message=message)


def _judged_wrong(case: _Case, choices: Sequence[Sequence[MotionSample]]) -> EquationsComparison:
    """Return the result for a wrong answer, with the likeliest cause in its message.

    `choices` are lists of the same samples with different multipliers. The causes are, in this order, numbers in place
    of parameters, a common slip, a wrong definition, a slip of factors or directions, or a wrong term. If a slip
    explains more than the wrong term, the term goes to the details. Else the message has both.
    """
    numbers = _numbers_in_place(case)
    if numbers:
        named = f"The equations are right for {numbers}, but they are asked for in symbols."
        return _refuted(case.rows, case.wrong(choices[0]), choices[0], named)
    rows, start = with_parameters(case.rows, choices)
    case = replace(case, rows=rows)
    condition = _condition(case)
    start += f"The equations hold only where {condition}. " if condition else ""
    common = slip_of(rows, choices, common=True)
    wrong, term = _blamed(case, choices)
    alone = term.alone and len(wrong) == 1
    named = start + term.sentence
    if len(wrong) > 1:
        others = listing(rows[i].equation.label for i in wrong[1:])
        named += f" {capitalized(others)} {'is' if len(wrong) == 2 else 'are'} wrong, too."
    definition = (
        "" if common or (alone and term.shorter) else wrong_definition(rows, choices[0], case.write, alone=alone)
    )
    slip = common or definition or ("" if alone else slip_of(rows, choices, common=False))
    if not slip:
        return _refuted(rows, wrong, choices[0], named)
    certain = definition or (common and not alone)
    if not certain and len(slip + named) < LONGEST_MESSAGE:
        return _refuted(rows, wrong, choices[0], f"{slip} {named}")
    result = _refuted(rows, wrong, choices[0], start + slip)
    return replace(result, details=f"{named} {result.details}".rstrip())


def _distances(derivation: Derivation) -> list[str]:
    """Return the names of the coordinates that are distances, which an answer may assume to be positive.

    An example is the radius of polar coordinates. A distance r occurs in the correct equations as abs(r) or sign(r).
    Where it is zero, a row of the mass matrix that belongs to another coordinate is zero.
    """
    plain, names, distances = derivation.statement.plain, derivation.statement.names, list[str]()
    with suppress(StatementError):
        kinks = _kinks(derivation)
        for i, (name, r) in enumerate(zip(names, list(plain.values())[::3], strict=True)):
            masses = derivation.mass_matrix.xreplace(plain).xreplace({r: sympy.S.Zero}).tolist() if r in kinks else []
            distances += [name] if any(not any(row) for row in (*masses[:i], *masses[i + 1 :])) else []
    return distances


def _kinks(derivation: Derivation) -> list[Any]:
    """Return the expressions x for which abs(x) or sign(x) is in the correct equations.

    Raises StatementError if the equations are too large to be written out.
    """
    laws = [*derivation.equations, *derivation.constraints]
    kinks = [kink for law in laws for kink in sorted(law.atoms(sympy.Abs, sympy.sign), key=str)]
    return list(dict.fromkeys(kink.args[0].xreplace(derivation.statement.plain) for kink in kinks))


def _condition(case: _Case) -> str:
    """Return the condition under which a wrong answer is correct, such as "x > 0"; "" if there is none.

    The condition is on the signs of expressions x for which abs(x) or sign(x) is in the correct equations.
    """
    statement = case.statement
    try:
        arguments = _kinks(case.derivation)
        if not arguments:
            return ""
        samples = motion_samples(statement, SIGNED_SAMPLES, seed=1, positive=case.distances)
        program = tape(arguments, statement)
        signs = [[value > 0 for value in values_at(program, sample)] for sample in samples]
    except (StatementError, OutsideDomain):
        return ""
    holding = [k for k, sample in enumerate(samples) if not case.wrong([sample])]
    shared = {i: signs[holding[0]][i] for i in range(len(arguments)) if len({signs[k][i] for k in holding}) == 1}
    if not shared or holding != [k for k, line in enumerate(signs) if all(line[i] == way for i, way in shared.items())]:
        return ""
    return listing(f"{case.write(arguments[i])} {'>' if way else '<'} 0" for i, way in shared.items())


def _numbers_in_place(case: _Case) -> str:
    """Return the values that an answer has in place of parameters, as a text such as "m = 1 and k = 30".

    The result is "" if the answer is wrong for these values of the parameters, too. It is also "" if all values are 0
    or 1, because then a term or factor was probably forgotten.
    """
    absent = {p: x for p, x in case.statement.defaults.items() if not any(row.zero.has(p) for row in case.rows)}

    def right(values: Mapping[Any, float]) -> bool:
        with suppress(StatementError):
            return not case.wrong(motion_samples(case.statement, 2, positive=case.distances, values=values))
        return False

    if not absent or not right(absent):
        return ""
    for p in list(absent):  # the value of a parameter that cancels, such as a pendulum's mass, is not in the answer
        fewer = {other: x for other, x in absent.items() if other != p}
        absent = fewer if right(fewer) else absent
    return listing(f"{p.name} = {x:.6g}" for p, x in absent.items()) if {*absent.values()} - {0, 1} else ""


def _idle(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> str:
    """Return a sentence on a tiny number that makes no difference in a correct equation, or "" if there is none.

    The equation also holds with zero in place of the number, so the comparison cannot test the number.
    """
    for row in rows:
        for number in sorted(row.zero.atoms(sympy.Number), key=str):
            without = row.zero.xreplace({number: sympy.S.Zero})
            if 0 < abs(number) < NEGLIGIBLE and row.with_zero(without).holds(samples):
                number_text = f"{abs(float(number)):.6g}"
                return f"In {row.equation.label} the number {number_text} makes no difference: leave its term out."
    return ""


def _blamed(case: _Case, choices: Sequence[Sequence[MotionSample]]) -> tuple[tuple[int, ...], WrongTerm]:
    """Return (indices of the wrong equations, wrong term of the first one) for the likeliest multipliers.

    `choices` are lists of the same samples with different multipliers. Of those with the fewest wrong equations, the
    one with the likeliest correction is taken. If multipliers were typed as forces such as T, negative ones are less
    likely.
    """
    wrong_by_choice = [case.wrong(chosen) for chosen in choices]
    fewest = min(len(wrong) for wrong in wrong_by_choice if wrong)
    candidates = []
    for chosen, wrong in zip(choices, wrong_by_choice, strict=True):
        if len(wrong) != fewest:
            continue
        row = case.rows[wrong[0]]
        term = WrongTerm(f"{capitalized(row.equation.label)} does not hold. {UNNAMED}")
        with suppress(BudgetSpent):
            check_size(*row.sides)
            term = wrong_term(row, case.derivation, chosen, case.write)
        candidates.append((term.cost + (NEGATIVE if case.is_unlikely(chosen) else 0.0), wrong, term))
    _, wrong, term = min(candidates, key=lambda candidate: candidate[0])
    return wrong, term


def _missing(rows: Sequence[EquationRow], samples: Sequence[MotionSample], *, has_false_remark: bool) -> str:
    """Return the end of a message on equations that are missing in an answer without wrong ones, or "".

    Equations are missing if some accelerations are not determined. An equation without accelerations is replaced by its
    first or second time derivative. The length of a quaternion needs no equation. Constraints are part of the statement
    and need not be repeated, unless `has_false_remark` is true: a remark, such as a constraint, does not hold.
    """
    statement = rows[0].statement
    names = [rotation_name(q) or name_of(q) for q in statement.coordinates]
    padding = [0.0] * (len(rows[0].slopes) - len(names))
    for sample in samples:
        with suppress(OutsideDomain):
            matrix = [[float(x) for x in row.leading(sample)] for row in rows]
            break
    else:
        raise OutsideDomain("no state at which all equations have values")
    for each in statement.rotations:
        along = [float(x) if name == each else 0.0 for name, x in zip(names, sample.point.q, strict=True)]
        matrix.append(along + padding)
    gradients = [[float(x) for x in row] + padding for row in sample.gradient]
    free = _free([*matrix, *gradients], names)
    if free:
        count, needed = len(rows), len(names) - len(statement.rotations)
        rate = "acceleration" if any(any(row.slopes.values()) for row in rows) else "motion"
        rates = f"the {rate} of {listing(free)} is" if len(free) == 1 else f"the {rate}s of {listing(free)} are"
        if count < needed and not statement.constraints:
            counted = "1 equation is" if count == 1 else f"{count} equations are"
            return f"{counted} given and {needed} are needed: {rates} left open."
        return f"not all are independent: {rates} left open."
    if not has_false_remark:
        return ""
    absent = []
    for constraint, row in zip(statement.constraints, gradients, strict=True):
        if _free(matrix, names) and _rank([*matrix, row])[0] > _rank(matrix)[0]:
            matrix.append(row)
            absent.append(constraint)
    if not absent:
        return ""
    listed = listing(constraint.name for constraint in absent)
    zero = statement.quote(absent[0].expression, LONGEST_QUOTED)
    start = f"the constraint {listed} is" if len(absent) == 1 else f"the constraints {listed} are"
    return f"{start} missing: add {zero} = 0 or its time derivative."


def _rank(matrix: Sequence[Sequence[float]]) -> tuple[int, Any]:
    """Return the rank of a matrix, and its right singular vectors as rows."""
    scaled = np.array([[x / (max(map(abs, row)) or 1.0) for x in row] for row in matrix])
    _, sizes, directions = np.linalg.svd(scaled)
    return int((sizes > 1e-10 * sizes[0]).sum()) if sizes[0] else 0, directions


def _free(matrix: Sequence[Sequence[float]], names: Sequence[str]) -> list[str]:
    """Return those of `names` whose accelerations are not determined by linear equations with coefficients `matrix`."""
    rank, directions = _rank(matrix)
    sizes = np.abs(directions[rank:, : len(names)]).max(axis=0, initial=0.0)
    return list(dict.fromkeys(name for name, size in zip(names, sizes, strict=True) if size > 1e-8))


def _refuted(
    rows: Sequence[EquationRow], wrong: tuple[int, ...], samples: Sequence[MotionSample], named: str
) -> EquationsComparison:
    """Return the result for an answer in which the equations with the indices `wrong` do not hold.

    `named` is the message on the cause. The counterexample is the first sample at which the first wrong equation fails.
    """
    row, names, example, details = rows[wrong[0]], rows[0].statement.names, dict[str, float](), ""
    accelerations = [f"{name}_ddot" for name in names]
    for sample in (sample for sample in samples if not row.holds([sample])):
        with suppress(OutsideDomain):
            left, point, motion = row.residual(sample)[0], sample.point, sample.accelerations
            keys = [*row.statement.state_names, "t", *(p.name for p in point.parameters), *accelerations]
            values = (*point.q, *point.v, point.t, *point.parameters.values(), *motion)
            example = dict(zip(keys, map(float, values), strict=True))
            details = f"the two sides of {row.equation.label} differ by {float(left):.5g}."
            rates = listing(f"{name} = {float(a):.5g}" for name, a in zip(accelerations, motion, strict=True))
            start = f"At {point.describe(names, 5)} the motion has {rates}, and there"
            details = f"{start if len(names) <= MOST_LISTED else 'At the state in .counterexample'} {details}"
            break
    return EquationsComparison(
        right=False, message=named, wrong=wrong, counterexample=MappingProxyType(example), details=details
    )
