"""`quick_check`: one test of a newly compiled model, cheap enough for every compilation.

The compiled accelerations are inserted into the Euler-Lagrange equations as stated, projected on a random direction w:

    w . (d/dt dL/dv - dL/dq - Q + dD/dv) = 0    along    q + v s + a s^2/2

With constraints w is random among the directions that they allow, G w = 0, along which their forces do no work, and
the second rates of phi, and the rates of constraints on velocities, vanish in a random combination.

With a random direction, a fault in any entry shows with probability one. The derivatives are central differences of the
stated L at 50 digits: four evaluations of L for the first term, two for the second. If the left-hand side is not small
relative to its terms, the evaluation is repeated with every intermediate number slightly perturbed, which estimates
rounding (see `lagrange.evidence.reference`). If it is larger than that, the accelerations are checked one by one.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

import numpy as np

from lagrange.errors import FAULT, RunError
from lagrange.evidence.compare import LIMIT, TINY, relative_error
from lagrange.evidence.constraint_laws import StatedConstraints, acceleration_level
from lagrange.evidence.laws import DifferenceSteps, along
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.evidence.reference import Reference
from lagrange.evidence.sample import SAMPLE_KINDS, Point, Sampler, sampled_statement
from lagrange.machine.model import Model
from lagrange.statement.statement import Statement

DIGITS = 50
DIFFERENCE_STEP = "1e-12"
PERTURBATION = 1e-15
SUSPICIOUS = 1e-12
"""Residual, relative to its size, from which the accelerations are checked one by one."""

MOST_DRAWS = 24
"""Random points before the initial state, which comes last because terms vanish at rest and upright."""

MOST_CONFIRMED = 24
"""With more coordinates a second point is asked before a full test, which takes a second for 24 and half a minute for
80: rounding grows with the size of the system, and makes one point in ten suspicious."""

CONFIRMATIONS = 3
"""Full tests of suspicious points before giving up; each costs as much as a point of `check`."""


def quick_check(model: Model) -> None:
    """Check the compiled accelerations against the stated energies at one random point, in one random direction.

    Raises RunError, with the entry, the place and the two values, if they disagree. A system without a usable point,
    even at its initial state, passes.
    """
    statement, of_model = sampled_statement(model)
    probe = _Probe(statement)
    sampler = Sampler(statement, seed=0)
    confirmations = suspicious = 0
    for attempt in range(MOST_DRAWS + 1):
        point = sampler.initial() if attempt == MOST_DRAWS else sampler.point(SAMPLE_KINDS[(attempt + 1) % 4], attempt)
        a = _accelerations(model, of_model(point))
        virtual = [w * (abs(x) or 1.0) for w, x in zip(probe.direction, point.q, strict=True)]
        direction = _allowed(model, of_model(point), virtual)
        # Equations without accelerations do not hold at random states: of these the rates are looked at, one by one.
        if all(map(math.isfinite, a)) and not probe.suspects(point, a, direction):
            return
        if not probe.has_value(point):
            continue
        # This is not yet a fault: the mass matrix may be singular here, a number too large, or a kink too near.
        if len(a) > MOST_CONFIRMED and (suspicious := suspicious + 1) == 1:
            continue
        if _confirm(model, statement, point, a) or (confirmations := confirmations + 1) == CONFIRMATIONS:
            return


def _accelerations(model: Model, point: Point) -> list[float]:
    """Return the compiled accelerations from the kernel of a run; NaN where the model refuses."""
    try:
        return [float(x) for x in model.accelerations(point.q, point.v, point.t, point.parameters)]
    except RunError:
        return [math.nan] * len(point.q)


def _allowed(model: Model, point: Point, direction: Sequence[float]) -> list[float]:
    """Return the part of a direction that the constraints allow, orthogonal to the rows of G in doubles.

    G comes from what is compiled: if it were wrong, the forces of the constraints would not vanish in that direction.
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
    for _ in range(2):  # once leaves what rounding made of the first projection
        w = w - basis @ (basis.T @ w)
    return [float(x) for x in w]


def _confirm(model: Model, statement: Statement, point: Point, a: Sequence[float]) -> bool:
    """Return True if the accelerations are right after all, False if the point cannot be used.

    Raises RunError if they are wrong.
    """
    try:
        part = Reference(statement, model.equations.first_order).at(point, [])["accelerations"]
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
    """The projected Euler-Lagrange equation of a statement, as stated and slightly perturbed."""

    def __init__(self, statement: Statement) -> None:
        self.plain = Precise([statement.lagrangian], statement, DIGITS)
        self.number = self.plain.context.mpf
        loaded = any(force != 0 for force in statement.forces)
        self.forces = Precise(statement.forces, statement, DIGITS) if loaded else None
        self.dissipation = Precise([statement.dissipation], statement, DIGITS) if statement.dissipation != 0 else None
        self.draw = random.Random(0)
        self.direction = [self._factor(0.5) for _ in statement.coordinates]
        self.holonomic = tuple(one.holonomic for one in statement.constraints)
        self.held = Precise([one.expression for one in statement.constraints], statement, DIGITS)
        self.weights = [self.number(self._factor(0.5)) for _ in statement.constraints]

    def has_value(self, point: Point) -> bool:
        """Return whether the energies and forces have values at the point."""
        try:
            for tape in (self.plain, self.forces, self.dissipation, self.held):
                if tape is not None:
                    tape(point.q, point.v, point.t, point.parameters)
        except OutsideDomain:
            return False
        return True

    def suspects(self, point: Point, a: Sequence[float], direction: Sequence[float]) -> bool:
        """Return whether a residual exceeds rounding, or cannot be evaluated; `direction` is one that is allowed."""
        try:
            q, v, exact, w = [[self.number(x) for x in numbers] for numbers in (point.q, point.v, a, direction)]
            residuals = [
                self._residual(self.plain, self.plain, point, q, v, exact, w),
                *self._held(self.held, point, q, v, exact),
            ]
            if all(abs(residual) <= SUSPICIOUS * largest for residual, largest in residuals):
                return False
            off = [x * (1 + self.number(PERTURBATION) * self._factor(1.0)) for x in exact]
            tapes = [self.plain.perturbed(PERTURBATION, seed) for seed in (1, 2)]
            moved = [
                self._residual(tapes[0], tapes[1], point, q, v, off, w),
                *self._held(self.held.perturbed(PERTURBATION, 3), point, q, v, off),
            ]
        except OutsideDomain:
            return True
        unit = self.number(PERTURBATION)
        return any(
            abs(residual) > SUSPICIOUS * abs(other - residual) / unit + TINY
            for (residual, _), (other, _) in zip(residuals, moved, strict=True)
        )

    def _held(self, tape: Precise, point: Point, q: Any, v: Any, a: Any) -> list[tuple[Any, Any]]:
        """Return a random combination of G a + gamma, and its largest term: nothing without constraints."""
        if not self.holonomic:
            return []
        parameters = {p: self.number(x) for p, x in point.parameters.items()}
        stated = StatedConstraints.alike(lambda q, v, t: tape(q, v, t, parameters), self.holonomic)
        step = self.number(DIFFERENCE_STEP)
        sizes = [[step * (abs(x) or 1) for x in half] for half in (q, v)]
        steps = DifferenceSteps(sizes[0], sizes[1], self._time_step(point, q, v))
        t, still = self.number(point.t), [self.number(0)] * len(q)
        whole, bias = (acceleration_level(stated, q, v, along_a, t, steps) for along_a in (a, still))
        terms = [weight * x for weight, x in zip(self.weights, whole, strict=True)]
        return [(sum(terms), max(map(abs, [*bias, *(x - b for x, b in zip(whole, bias, strict=True))])))]

    def _residual(
        self, for_rate: Precise, for_force: Precise, point: Point, q: Any, v: Any, a: Any, w: Any
    ) -> tuple[Any, Any]:
        """Return the left-hand side along w, and its largest term."""
        parameters = {p: self.number(x) for p, x in point.parameters.items()}
        t, step, ahead = self.number(point.t), self.number(DIFFERENCE_STEP), self._time_step(point, q, v)

        def slope(tape: Precise, at_q: Any, at_v: Any, at_t: Any, dq: Any, dv: Any) -> Any:
            upper = tape(along(at_q, dq, step), along(at_v, dv, step), at_t, parameters)[0]
            lower = tape(along(at_q, dq, -step), along(at_v, dv, -step), at_t, parameters)[0]
            return (upper - lower) / (2 * step)

        still = [0] * len(q)

        def momentum(s: Any) -> Any:
            return slope(for_rate, along(q, v, s), along(v, a, s), t + s, still, w)

        terms = [(momentum(ahead) - momentum(-ahead)) / (2 * ahead), -slope(for_force, q, v, t, w, still)]
        if self.forces is not None:
            loads = self.forces(q, v, t, parameters)
            terms += [-x * force for x, force in zip(w, loads, strict=True)]
        if self.dissipation is not None:
            terms.append(slope(self.dissipation, q, v, t, still, w))
        return sum(terms), max(map(abs, terms))

    def _time_step(self, point: Point, q: Any, v: Any) -> Any:
        """Return a step along the motion in which no coordinate changes by more than `DIFFERENCE_STEP` of itself."""
        times = [abs(x / y) for x, y in zip(q, v, strict=True) if x and y]
        if self.plain.uses_time or self.held.uses_time or not times:
            times.append(self.number(abs(point.t) or 1.0))
        return self.number(DIFFERENCE_STEP) * min(times)

    def _factor(self, least: float) -> float:
        return self.draw.uniform(least, 1.5) * self.draw.choice((-1, 1))
