"""Test a newly compiled model at one random point (`quick_check`); it is cheap enough for every compilation.

The compiled accelerations are inserted into the stated Euler-Lagrange equations, projected on a random direction w:

    w . (d/dt dL/dv - dL/dq - Q + dD/dv) = 0    along    q + v s + a s^2/2

With constraints, w is a random direction with G w = 0, along which the constraint forces do no work. In addition a
random combination of the second time derivatives of phi, and of the rates of constraints on velocities, must vanish.

With a random direction, a fault in any entry is visible with probability one. The derivatives are central differences
of the stated L at 50 digits: four evaluations of L for the first term, two for the second. If the left-hand side is not
small relative to its terms, the evaluation is repeated with every intermediate number slightly perturbed. The change of
the left-hand side estimates its rounding error, as in `lagrange.evidence.reference`. If the left-hand side exceeds this
estimate, each acceleration is checked individually.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from sympy import diff

from lagrange.errors import FAULT, RunError
from lagrange.evidence.differences import QUICK_DIFFERENCE_STEP, DifferenceSteps, StatedConstraints, along, central
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.evidence.reference import Reference
from lagrange.evidence.report import LIMIT, TINY_ERROR, relative_error
from lagrange.machine.model import Model
from lagrange.statement.coordinate import t
from lagrange.statement.given.function import with_values
from lagrange.statement.random_states import SamplePoint, Sampler, holds, random_points
from lagrange.statement.statement import REFUSE, Statement

DIGITS_OF_TEST = 50
PERTURBATION = 1e-15
SUSPICIOUS = 1e-12
"""Largest residual, relative to its largest term, that passes without an estimate of its rounding error."""

MOST_DRAWS = 24
"""Number of random points tried before the initial state, at which many terms vanish."""

MOST_CONFIRMED = 24
"""Largest number of coordinates for which the first suspicious point gets a full test.

In larger systems only later suspicious points get one. A full test takes 1 s for 24 coordinates and 30 s for 80.
Rounding grows with the size of the system, and makes one point in ten suspicious.
"""

CONFIRMATIONS = 3
"""Largest number of full tests of suspicious points; each takes as long as a point of `check`."""


def quick_check(model: Model) -> None:
    """Check the compiled accelerations against the stated energies at one random point, in one random direction.

    Raises RunError, with the entry, the state and the two values, if they disagree. A system passes without a test if
    the energies have no value at any point, including the initial state.
    """
    statement, model_point = sampled_statement(model)
    probe = _Probe(statement)
    confirmations = suspicious = 0

    def passes(point: SamplePoint) -> bool | None:
        nonlocal confirmations, suspicious
        at = model_point(point)
        try:
            a = [float(x) for x in model.accelerations(at.q, at.v, at.t, at.parameters)]
        except RunError:
            a = [math.nan] * len(at.q)
        virtual = [w * (abs(x) or 1.0) for w, x in zip(probe.direction, point.q, strict=True)]
        direction = _allowed(model, at, virtual)
        # Equations without accelerations do not hold at random states. The full test checks their time derivatives.
        if all(map(math.isfinite, a)) and not probe.suspects(point, a, direction):
            return True
        if not probe.has_value(point):
            return None
        # There may be no fault: the mass matrix may be singular here, a number too large, or a kink too near.
        if len(a) > MOST_CONFIRMED and (suspicious := suspicious + 1) == 1:
            return None
        if _is_confirmed(model, statement, point, a) or (confirmations := confirmations + 1) == CONFIRMATIONS:
            return True
        return None

    holds(chain(random_points(statement, 0, MOST_DRAWS), [Sampler(statement, 0).initial()]), passes, 1)


def _allowed(model: Model, point: SamplePoint, direction: Sequence[float]) -> list[float]:
    """Return the component of a direction that the constraints allow: orthogonal to the rows of the compiled G.

    A wrong G gives a wrong direction, so that the test fails.
    """
    if not model.statement.constraints:
        return list(direction)
    kernel = model.interpreted("constraint_gradient")
    stated, solved = model.equations.stated.names, model.equations.constraints.names
    kept = [i for i, name in enumerate(stated) if name in solved]
    rows = kernel(point.t, np.array([*point.q, *point.v]), model.parameter_array(point.parameters))[kept]
    if not np.isfinite(rows).all():
        return list(direction)
    basis, _ = np.linalg.qr(rows.T)
    w = np.array(direction)
    for _ in range(2):  # the second projection removes the rounding of the first
        w = w - basis @ (basis.T @ w)
    return [float(x) for x in w]


def _is_confirmed(model: Model, statement: Statement, point: SamplePoint, a: Sequence[float]) -> bool:
    """Return True if the compiled accelerations `a` are right at a point, False if the point is not usable.

    Raises RunError if an acceleration is wrong.
    """
    try:
        reference = Reference(statement, model.equations.first_order, model.equations.rates_are_solved)
        part = reference.at(point, [])["accelerations"]
    except OutsideDomain:
        return False
    for name, value, expected, error, size in zip(statement.names, a, part.value, part.error, part.size, strict=True):
        off = float(relative_error(abs(expected - value), size, error))
        if not off <= LIMIT:
            raise RunError(
                f"the compiled accelerations of {statement.name} are wrong: {name}_ddot is {value:.17g} where the "
                f"energies as stated give {float(expected):.17g} (relative error {off:.1e}), at "
                f"{point.describe(statement.names)}. {FAULT}"
            )
    return True


class _Probe:
    """Residuals of the equation of motion, projected on a direction, and of the constraints, to many digits.

    Each residual is computed again with slightly changed intermediate numbers. Its change estimates the rounding error.
    """

    def __init__(self, statement: Statement) -> None:
        self.plain = Precise([statement.lagrangian], statement, DIGITS_OF_TEST)
        self.number = self.plain.context.mpf
        loaded = any(force != 0 for force in statement.forces)
        self.forces = Precise(statement.forces, statement, DIGITS_OF_TEST) if loaded else None
        self.dissipation = (
            Precise([statement.dissipation], statement, DIGITS_OF_TEST) if statement.dissipation != 0 else None
        )
        self.draw = random.Random(0)
        self.direction = [self._factor(0.5) for _ in statement.coordinates]
        self.holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.constraints = Precise(
            [constraint.expression for constraint in statement.constraints], statement, DIGITS_OF_TEST
        )
        self.weights = [self.number(self._factor(0.5)) for _ in statement.constraints]

    def has_value(self, point: SamplePoint) -> bool:
        """Return True if the energies, forces and constraints have values at the point."""
        try:
            for tape in (self.plain, self.forces, self.dissipation, self.constraints):
                if tape is not None:
                    tape(point.q, point.v, point.t, point.parameters)
        except OutsideDomain:
            return False
        return True

    def suspects(self, point: SamplePoint, a: Sequence[float], direction: Sequence[float]) -> bool:
        """Return True if the equation of motion projected on `direction` seems not to hold at a point.

        `a` are the compiled accelerations. The result is True if the left-hand side exceeds its rounding error or has
        no value. The second time derivatives of constraints are tested in the same way.
        """
        try:
            q, v, exact, w = [[self.number(x) for x in numbers] for numbers in (point.q, point.v, a, direction)]
            residuals = [
                self._residual(self.plain, self.plain, point, q, v, exact, w),
                *self._constraint_residual(self.constraints, point, q, v, exact),
            ]
            if all(abs(residual) <= SUSPICIOUS * largest for residual, largest in residuals):
                return False
            off = [x * (1 + self.number(PERTURBATION) * self._factor(1.0)) for x in exact]
            tapes = [self.plain.perturbed(PERTURBATION, seed) for seed in (1, 2)]
            moved = [
                self._residual(tapes[0], tapes[1], point, q, v, off, w),
                *self._constraint_residual(self.constraints.perturbed(PERTURBATION, 3), point, q, v, off),
            ]
        except OutsideDomain:
            return True
        unit = self.number(PERTURBATION)
        return any(
            abs(residual) > SUSPICIOUS * abs(other - residual) / unit + TINY_ERROR
            for (residual, _), (other, _) in zip(residuals, moved, strict=True)
        )

    def _constraint_residual(
        self, program: Precise, point: SamplePoint, q: Any, v: Any, a: Any
    ) -> list[tuple[Any, Any]]:
        """Return [(random combination of the entries of G a + gamma, its largest term)], or [] without constraints.

        `program` computes the constraint expressions.
        """
        if not self.holonomic:
            return []
        parameters = {p: self.number(x) for p, x in point.parameters.items()}
        stated = StatedConstraints.alike(lambda q, v, t: program(q, v, t, parameters), self.holonomic)
        t, still, steps = self.number(point.t), [self.number(0)] * len(q), self._steps(point, q, v)
        whole, bias = (stated.acceleration_level(q, v, t, steps, along_a) for along_a in (a, still))
        terms = [weight * x for weight, x in zip(self.weights, whole, strict=True)]
        return [(sum(terms), max(map(abs, [*bias, *(x - b for x, b in zip(whole, bias, strict=True))])))]

    def _residual(
        self, for_rate: Precise, for_force: Precise, point: SamplePoint, q: Any, v: Any, a: Any, w: Any
    ) -> tuple[Any, Any]:
        """Return the left-hand side of the equation of motion projected on the direction w, and its largest term.

        q, v and a are coordinates, velocities and accelerations. `for_rate` and `for_force` are programs for L, used in
        d/dt dL/dv and in dL/dq.
        """
        parameters = {p: self.number(x) for p, x in point.parameters.items()}
        t, step, ahead = self.number(point.t), self.number(QUICK_DIFFERENCE_STEP), self._steps(point, q, v).motion

        def slope(tape: Precise, at_q: Any, at_v: Any, at_t: Any, dq: Any, dv: Any) -> Any:
            return central(lambda s: tape(along(at_q, dq, s), along(at_v, dv, s), at_t, parameters), step)[0]

        still = [0] * len(q)

        rates = central(lambda s: [slope(for_rate, along(q, v, s), along(v, a, s), t + s, still, w)], ahead)
        terms = [*rates, -slope(for_force, q, v, t, w, still)]
        if self.forces is not None:
            loads = self.forces(q, v, t, parameters)
            terms += [-x * force for x, force in zip(w, loads, strict=True)]
        if self.dissipation is not None:
            terms.append(slope(self.dissipation, q, v, t, still, w))
        return sum(terms), max(map(abs, terms))

    def _steps(self, point: SamplePoint, q: Any, v: Any) -> DifferenceSteps:
        timed = self.plain.uses_time or self.constraints.uses_time
        return DifferenceSteps.at(q, v, self.number(point.t), self.number(QUICK_DIFFERENCE_STEP), timed=timed)

    def _factor(self, least: float) -> float:
        return self.draw.uniform(least, 1.5) * self.draw.choice((-1, 1))


def solved_statement(model: Model) -> Statement:
    """Return the statement of a model, without constraints that follow from other constraints."""
    statement = model.statement
    if not statement.constraints:
        return statement
    solved = model.equations.constraints.names
    kept = tuple(constraint for constraint in statement.constraints if constraint.name in solved)
    if len(kept) == len(statement.constraints):
        return statement
    return replace(statement, constraints=kept, redundant=REFUSE)


def sampled_statement(model: Model) -> tuple[Statement, Callable[[SamplePoint], SamplePoint]]:
    """Return the statement with which a model is tested, and a function from its points to points of the model.

    Inputs of the model become polynomials in time with random coefficients, so that their values and rates are
    consistent.
    """
    statement = solved_statement(model)
    if not statement.inputs or statement.open_form is None:
        return statement, lambda point: point
    kept = [constraint.name for constraint in statement.constraints]
    stated = replace(
        statement.open_form, constraints=tuple(c for c in statement.open_form.constraints if c.name in kept)
    )
    varying = with_values(stated)
    polynomials = dict(varying.prescribed)
    rates, table = dict(statement.inputs), dict[Any, Any]()
    for leaf, value in statement.prescribed:
        symbol, polynomial = value, polynomials[leaf]
        while symbol in rates and symbol not in table:
            table[symbol] = polynomial
            symbol, polynomial = rates[symbol], diff(polynomial, t)

    def model_point(point: SamplePoint) -> SamplePoint:
        at = {**point.parameters, t: point.t}
        inputs = {symbol: float(value.xreplace(at)) for symbol, value in table.items()}
        values = {p: inputs[p] if p in inputs else point.parameters[p] for p in statement.parameters}
        return replace(point, parameters=values)

    return varying, model_point
