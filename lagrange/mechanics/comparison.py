"""Whether equations that somebody derived are those of a system, and where they are not, which term is wrong.

An equation is right if the motion satisfies it at every state: it is then a linear combination of the equations of
motion, whatever it was multiplied by or solved for. Equations are complete if they determine the accelerations, with
the constraints where there are any. Both are decided by numbers, from derivatives of the stated energies to 30 digits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from lagrange.equations.derivation import Derivation
from lagrange.errors import listing
from lagrange.evidence.operations import OutsideDomain
from lagrange.mechanics.equation_row import HELD, EquationRow, row_of
from lagrange.mechanics.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.multiplier_multiples import multiples_of_multipliers, told_of
from lagrange.mechanics.student_equations import StudentEquation
from lagrange.mechanics.wrong_term import wrong_term
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

MOST_TOLD = 4
"""Coordinates up to which a message tells the whole state."""

SAMPLES = 5
"""States at which equations are compared: a wrong one would have to hold by chance at all of them."""


@dataclass(frozen=True, repr=False)
class EquationsComparison(ShownAsPage):
    """The result: true if the equations are those of the system, else `message` names the first wrong term.

    `finding` is the message without the counterexample in numbers, for a table of many results.
    `counterexample` has a state, by name, at which the first wrong equation does not hold, with the true accelerations;
    it is empty where there is none. `wrong` has the places of the wrong equations.
    """

    right: bool
    message: str
    wrong: tuple[int, ...] = ()
    counterexample: Mapping[str, float] = field(default_factory=dict)
    finding: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "finding", self.finding or self.message)

    def __bool__(self) -> bool:
        return self.right

    def __str__(self) -> str:
        return self.message

    def __repr__(self) -> str:
        return f"<EquationsComparison: {'right' if self else 'wrong'}. {self.message}>"


def compare_equations(
    statement: Statement, derivation: Derivation, equations: Sequence[StudentEquation]
) -> EquationsComparison:
    """Compare equations with those of a statement. Raises StatementError where they are not linear in accelerations."""
    rows = [row_of(equation, statement) for equation in equations]
    samples = motion_samples(statement, SAMPLES)
    wrong = tuple(i for i, row in enumerate(rows) if not row.holds(samples))
    multiples = multiples_of_multipliers(rows, samples) if wrong else None
    wrong = () if multiples else wrong
    if wrong:
        return _refuted(derivation, rows, wrong, samples)
    free = _undetermined(rows, samples)
    if free:
        return EquationsComparison(right=False, message=_incomplete(statement, rows, free))
    right = "The equations are right: they are equivalent to those of the system."
    return EquationsComparison(right=True, message=right + (told_of(multiples) if multiples else ""))


def _undetermined(rows: Sequence[EquationRow], samples: Sequence[MotionSample]) -> list[str]:
    """Return the coordinates whose accelerations the equations leave open, with the constraints, at every state."""
    names, sample = rows[0].statement.names, samples[0]
    n, unknowns = len(names), len(rows[0].slopes)
    matrix = [[float(x) for x in row.numbers(sample)[0]] for row in rows]
    matrix += [[float(x) for x in row] + [0.0] * (unknowns - n) for row in sample.gradient]
    scaled = np.array([[x / (max(map(abs, row)) or 1.0) for x in row] for row in matrix])
    _, sizes, directions = np.linalg.svd(scaled)
    rank = int((sizes > 1e-10 * sizes[0]).sum()) if sizes[0] else 0
    free = np.abs(directions[rank:, :n]).max(axis=0, initial=0.0)
    return [name for name, size in zip(names, free, strict=True) if size > 1e-8]


def _incomplete(statement: Statement, rows: Sequence[EquationRow], free: Sequence[str]) -> str:
    """Return what is missing of equations that all hold."""
    given, needed = len(rows), len(statement.names)
    held = "The equation holds" if given == 1 else "The equations hold"
    if given < needed and not statement.constraints:
        counted = "1 equation is" if given == 1 else f"{given} equations are"
        return f"{held}, but {counted} given and {needed} are needed: the acceleration of {listing(free)} is left open."
    return f"{held}, but not all are independent: the acceleration of {listing(free)} is left open."


def _refuted(
    derivation: Derivation, rows: Sequence[EquationRow], wrong: tuple[int, ...], samples: Sequence[MotionSample]
) -> EquationsComparison:
    """Return the result for equations of which some do not hold."""
    row = rows[wrong[0]]
    sample = _where_it_fails(row, samples)
    example = {} if sample is None else _counterexample(row, sample)
    named = wrong_term(row, derivation, samples)
    told = "" if sample is None else f" {_told(row, sample)}"
    more = ""
    if len(wrong) > 1:
        others = listing(rows[i].label for i in wrong[1:])
        more = f" {others[0].upper()}{others[1:]} {'is' if len(wrong) == 2 else 'are'} wrong, too."
    return EquationsComparison(
        right=False,
        message=named + told + more,
        wrong=wrong,
        counterexample=MappingProxyType(example),
        finding=named + more,
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
