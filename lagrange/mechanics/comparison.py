"""Whether equations that somebody derived are those of a system, in each of their branches; else the wrong term."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.derivation import Derivation
from lagrange.errors import StatementError, listing
from lagrange.evidence.laws import solve
from lagrange.evidence.precise import OutsideDomain
from lagrange.evidence.sample import Point, Sampler
from lagrange.evidence.switches import all_ways, describe_way
from lagrange.mechanics.motion_samples import MotionSample, MotionStates, motion_samples
from lagrange.mechanics.student_equations import HELD, EquationRow, StudentEquation, row_of
from lagrange.mechanics.term_difference import LARGEST_FACTOR, Write
from lagrange.mechanics.wrong_term import SINGULAR, slip_of, wrong_term
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

DRAWS = 1000
"""Points drawn in search of other branches; most of them cost one evaluation of the conditions."""

MOST = 16
"""States that may be added for them."""

NEAREST = 8.0
"""Digits to which an entry may agree with a number of the equations: a branch between 3 and 3.0001 is met."""

Way = tuple[Any, int]
"""A switch and one of its outcomes."""


def branch_samples(
    statement: Statement, rows: Sequence[EquationRow], known: Sequence[MotionSample]
) -> tuple[list[MotionSample], list[Way]]:
    """Return states at which switches of the statement or the equations go together in a way that no state has yet.

    Also the outcomes of switches that no state has. Entries of states are drawn of any size, and near the numbers that
    stand in the equations, energies and forces.
    """
    states = MotionStates(statement)
    switches = [*states.reference.switches, *(switch for row in rows for switch in row.switches)]
    if not switches:
        return [], []

    def ways(point: Point) -> tuple[int | None, ...]:
        return (*states.reference.inspect(point), *(way for row in rows for way in row.ways(point)))

    found: list[MotionSample] = []
    seen: set[tuple[int | None, ...]] = set()
    for sample in known:
        with suppress(OutsideDomain):
            seen.add(ways(sample.point))
    for point in _points(statement, _numbers(statement, rows)):
        if len(found) == MOST:
            break
        with suppress(OutsideDomain):
            point = states.satisfied(point)
            if (taken := ways(point)) not in seen:
                found.append(states.motion(point))
                seen.add(taken)
    had = {pair for taken in seen for pair in zip(switches, taken, strict=True)}
    every = dict.fromkeys((switch, way) for switch in switches for way in all_ways(switch))
    return found, [pair for pair in every if pair not in had]


def _numbers(statement: Statement, rows: Sequence[EquationRow]) -> list[float]:
    """Return the sizes of the numbers that stand in the equations, the energies and the forces, 1 among them."""
    expressions = [statement.lagrangian, *statement.forces, *(row.zero for row in rows)]
    numbers = {abs(float(x)) for one in expressions for x in one.atoms(sympy.Number) if x.is_finite}
    return sorted(x for x in numbers | {1.0} if x and math.isfinite(x))


def _points(statement: Statement, numbers: Sequence[float]) -> Iterator[Point]:
    """Yield points with entries of any size, half of them near one of the numbers."""
    sampler, draw = Sampler(statement, 1), random.Random(1)

    def near() -> float:
        return (
            draw.choice((-1, 1)) * draw.choice(numbers) * (1 + draw.choice((-1, 1)) * 10 ** -draw.uniform(0, NEAREST))
        )

    for _ in range(DRAWS):
        point = sampler.far()
        q, v = (tuple(near() if draw.random() < 0.5 else x for x in entries) for entries in (point.q, point.v))
        values = {p: math.copysign(near(), x) if draw.random() < 0.2 else x for p, x in point.parameters.items()}
        yield replace(point, q=q, v=v, parameters=values)


def multiples_of_multipliers(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> list[list[Any]] | None:
    """Return how many times each multiplier of some equations is that of the system, at each sample.

    None where the equations do not hold with any multiples, the same in all of them.
    """
    try:
        found = [_multiples(rows, sample) for sample in samples]
    except OutsideDomain:
        return None
    return [one for one in found if one] if all(found) else None


def told_of(multiples: Sequence[Sequence[Any]]) -> str:
    """Return how the multipliers of right equations differ from those of the system, as a sentence."""
    every = [one for row in multiples for one in row]
    ratio = Fraction(str(every[0])).limit_denominator(LARGEST_FACTOR)
    if any(abs(one * ratio.denominator - ratio.numerator) > HELD * (1 + abs(ratio.numerator)) for one in every):
        return " Their multipliers are multiples of those of the system."
    if ratio == -1:
        return " The multipliers have the opposite sign."
    return f" Their multipliers are {ratio} times those of the system."


def _multiples(rows: Sequence[EquationRow], sample: MotionSample) -> list[Any]:
    """Return the multiples at a sample, in the order of the constraints; empty where there are none."""
    n = len(sample.mass)
    found: list[Any] = [None] * len(sample.multipliers)
    for row in rows:
        slopes, rest = row.numbers(sample)
        weights = solve(sample.mass, [slopes[:n]], SINGULAR)[0]
        exerted = [sum(w * x for w, x in zip(weights, line, strict=True)) for line in sample.gradient]
        terms = [slope * a for slope, a in zip(slopes, sample.accelerations, strict=False)]
        terms += [-part * multiplier for part, multiplier in zip(exerted, sample.multipliers, strict=True)]
        if abs(sum(terms) + rest) > HELD * (sum(map(abs, terms)) + abs(rest)):
            return []  # other terms than those of multipliers are wrong
        size = max(map(abs, exerted), default=0)
        for j, (part, slope) in enumerate(zip(exerted, slopes[n:], strict=True)):
            none = abs(part) <= HELD * size
            if none != (slope == 0):
                return []
            if none:
                continue
            multiple = -part / slope
            if found[j] is not None and abs(multiple - found[j]) > HELD * (abs(multiple) + abs(found[j])):
                return []
            found[j] = multiple
    return [one for one in found if one is not None]


MOST_TOLD = 4
"""Coordinates up to which a message tells the whole state."""

MOST_READ = 2
"""Equations with several readings whose reading a message shows; `.read` has all of them."""

LONGEST_MESSAGE = 400
"""Characters of a message. What is longer goes to `.details`."""

SAMPLES = 5
"""States at which equations without switches are compared: a wrong one would have to hold by chance at all of them."""


@dataclass(frozen=True, repr=False)
class EquationsComparison(ShownAsPage):
    """The result: true if the equations are those of the system, else `message` names the first wrong term.

    `counterexample` has a state, by name, at which the first wrong equation does not hold, with the true accelerations;
    it is empty where there is none. `details` tells it in a sentence. `wrong` has the places of the wrong equations.
    `read` has the equations as they were understood, one a line, in the notation of scene files.
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
    statement: Statement, derivation: Derivation, equations: Sequence[StudentEquation], write: Write
) -> EquationsComparison:
    """Compare equations with those of a statement. `write` returns the text of an expression for messages.

    Raises StatementError where they are not linear in accelerations.
    """
    samples = motion_samples(statement, SAMPLES)
    understood = [_likeliest(equation, statement, samples) for equation in equations]
    rows = [row for _, row in understood]
    further, untried = branch_samples(statement, rows, samples)
    samples += further
    result, alone = _compared(derivation, rows, samples, untried, write)
    told = ""
    if result.wrong:
        slip = slip_of([one for one, _ in understood], statement, samples, alone=alone)
        told = f" {slip}" if slip else ""
    shown = [i for i, given in enumerate(equations) if given.others and (i in result.wrong or not result.wrong)]
    told += f" Read as {listing(understood[i][0].read for i in shown[:MOST_READ])}." if shown else ""
    read = "\n".join(equation.read for equation, _ in understood)
    if len(result.message + told) <= LONGEST_MESSAGE:
        return replace(result, message=result.message + told, read=read)
    short = result.message.partition(": it ")[0].rstrip(".") + "."
    if not result.wrong:
        told = ""
    elif len(short + told) > LONGEST_MESSAGE:
        label = equations[result.wrong[0]].label
        short, told = f"{label[0].upper()}{label[1:]} does not hold: .details names its first wrong term.", ""
    return replace(result, message=short + told, details=f"{result.message} {result.details}".strip(), read=read)


def _likeliest(
    equation: StudentEquation, statement: Statement, samples: Sequence[MotionSample]
) -> tuple[StudentEquation, EquationRow]:
    """Return the first reading of an equation that the motion satisfies, or the first one if it satisfies none.

    A reading that is not linear in the accelerations counts only if all are. Raises StatementError then.
    """
    rows: list[tuple[StudentEquation, EquationRow]] = []
    refused: StatementError | None = None
    for reading in (equation, *equation.others):
        try:
            row = row_of(reading, statement)
        except StatementError as error:
            refused = refused or error
            continue
        if row.holds(samples):
            return reading, row
        rows.append((reading, row))
    if rows:
        return rows[0]
    raise refused or StatementError(f"{equation.label} cannot be read.")


def _compared(
    derivation: Derivation,
    rows: Sequence[EquationRow],
    samples: Sequence[MotionSample],
    untried: Sequence[Way],
    write: Write,
) -> tuple[EquationsComparison, bool]:
    """Return the result for one reading of each equation, and whether one term alone is wrong.

    `untried` are branches without a sample.
    """
    statement = rows[0].statement
    wrong = tuple(i for i, row in enumerate(rows) if not row.holds(samples))
    names = len(statement.names)
    # Beside them may stand the constraints, and equations without multipliers that hold.
    open_rows = [row for i, row in enumerate(rows) if i in wrong or any(list(row.slopes.values())[names:])]
    moving = all(any(rows[i].slopes.values()) for i in wrong)
    multiples = multiples_of_multipliers(open_rows, samples) if wrong and moving else None
    wrong = () if multiples else wrong
    if wrong:
        rows, wrong, write = _with_their_multipliers(rows, wrong, samples, write)
        term = wrong_term(rows[wrong[0]], derivation, samples, write)
        return _refuted(rows, wrong, samples, term.sentence), term.alone and len(wrong) == 1
    free = _undetermined(rows, samples)
    if free:
        return EquationsComparison(right=False, message=_incomplete(statement, rows, free)), False
    right = f"The equations are right: they are equivalent to those of the system, at the {len(samples)} states tried."
    message = right + (told_of(multiples) if multiples else "") + _without_sample(untried, statement)
    return EquationsComparison(right=True, message=message), False


def _with_their_multipliers(
    rows: Sequence[EquationRow], wrong: tuple[int, ...], samples: Sequence[MotionSample], write: Write
) -> tuple[Sequence[EquationRow], tuple[int, ...], Write]:
    """Return equations, places of the wrong ones and the writer, with the sign of the multipliers that fits best.

    A tension counts against the gradient of its constraint: more equations may hold with the other sign.
    """
    turned = {one.multiplier: -one.multiplier for one in rows[0].statement.constraints}
    if not any(row.zero.has(*turned) for row in rows):
        return rows, wrong, write
    others = [row.with_symbols(turned) for row in rows]
    places = tuple(i for i, row in enumerate(others) if not row.holds(samples))
    if not places or (len(places), -places[0]) >= (len(wrong), -wrong[0]):
        return rows, wrong, write
    return others, places, lambda expression: write(expression.xreplace(turned))


def _without_sample(left: Sequence[Way], statement: Statement) -> str:
    """Return a sentence on the branches of which no state was found, empty if there are none."""
    if not left:
        return ""
    more = f", nor for {len(left) - 1} other branches" if len(left) > 1 else ""
    return f" No state was found where {describe_way(*left[0], statement)}{more}."


def _undetermined(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> list[str]:
    """Return the coordinates whose accelerations the equations leave open, with the constraints, at every state.

    An equation of first order counts with its rate of change.
    """
    names, sample = rows[0].statement.names, samples[0]
    n, unknowns = len(names), len(rows[0].slopes)
    matrix = [[float(x) for x in row.leading(sample)] for row in rows]
    matrix += [[float(x) for x in row] + [0.0] * (unknowns - n) for row in sample.gradient]
    scaled = np.array([[x / (max(map(abs, row)) or 1.0) for x in row] for row in matrix])
    _, sizes, directions = np.linalg.svd(scaled)
    rank = int((sizes > 1e-10 * sizes[0]).sum()) if sizes[0] else 0
    free = np.abs(directions[rank:, :n]).max(axis=0, initial=0.0)
    return [name for name, size in zip(names, free, strict=True) if size > 1e-8]


def _incomplete(statement: Statement, rows: Sequence[EquationRow], free: Sequence[str]) -> str:
    """Return what is missing of equations that all hold."""
    given, needed = len(rows), len(statement.names)
    rate = "acceleration" if any(any(row.slopes.values()) for row in rows) else "motion"
    held = "The equation holds" if given == 1 else "The equations hold"
    if given < needed and not statement.constraints:
        counted = "1 equation is" if given == 1 else f"{given} equations are"
        return f"{held}, but {counted} given and {needed} are needed: the {rate} of {listing(free)} is left open."
    return f"{held}, but not all are independent: the {rate} of {listing(free)} is left open."


def _refuted(
    rows: Sequence[EquationRow], wrong: tuple[int, ...], samples: Sequence[MotionSample], named: str
) -> EquationsComparison:
    """Return the result for equations of which some do not hold; `named` is the sentence on the first wrong term."""
    row = rows[wrong[0]]
    sample = _where_it_fails(row, samples)
    example = {} if sample is None else _counterexample(row, sample)
    details = "" if sample is None else _told(row, sample)
    more = ""
    if len(wrong) > 1:
        others = listing(rows[i].label for i in wrong[1:])
        more = f" {others[0].upper()}{others[1:]} {'is' if len(wrong) == 2 else 'are'} wrong, too."
    return EquationsComparison(
        right=False,
        message=named + more,
        wrong=wrong,
        counterexample=MappingProxyType(example),
        details=details,
    )


def _where_it_fails(row: EquationRow, samples: Sequence[MotionSample]) -> MotionSample | None:
    """Return a state at which an equation does not hold, None where it has no value at any."""
    for sample in samples:
        try:
            left, size = row.residual(sample)
        except OutsideDomain:
            continue
        if abs(left) > HELD * size:
            return sample
    return None


def _counterexample(row: EquationRow, sample: MotionSample) -> dict[str, float]:
    statement, point = row.statement, sample.point
    keys = [*statement.state_names, "t", *(p.name for p in point.parameters)]
    values = [*point.q, *point.v, point.t, *point.parameters.values()]
    keys += [f"{name}_ddot" for name in statement.names]
    return dict(zip(keys, (float(x) for x in (*values, *sample.accelerations)), strict=True))


def _told(row: EquationRow, sample: MotionSample) -> str:
    """Return the counterexample as a sentence."""
    left, _ = row.residual(sample)
    names = row.statement.names
    if len(names) > MOST_TOLD:
        return f"At the state in .counterexample the two sides of {row.label} differ by {float(left):.5g}."
    motion = listing(f"{name}_ddot = {float(a):.5g}" for name, a in zip(names, sample.accelerations, strict=True))
    state = sample.point.describe(names, 5)
    return f"At {state} the motion has {motion}, and there the two sides of {row.label} differ by {float(left):.5g}."
