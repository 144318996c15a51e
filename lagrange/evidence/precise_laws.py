"""The residual of the stated laws of motion in multiple precision, by differences with many digits to spare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.evidence import laws
from lagrange.evidence.central_differences import Numbers
from lagrange.evidence.constraint_laws import StatedConstraints, acceleration_level, gradient, reactions
from lagrange.evidence.constraint_surface import ConstraintSurface
from lagrange.evidence.laws import DifferenceSteps, Sources
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.precise import Precise
from lagrange.machine.backend import FloatArray
from lagrange.statement.statement import Statement

GUARD = 14
"""Digits beyond those that the differences lose by design."""


class PreciseLaws:
    """The residual of the equations of motion, from the stated L, Q and D."""

    def __init__(self, statement: Statement, parameters: Mapping[Any, float], digits: int) -> None:
        # A first derivative of a first derivative is differenced: twice the digits of the step are lost, and the
        # step's square is the error.
        self.exponent = digits // 2 + 3
        lagrangian = Precise([statement.lagrangian], statement, digits + 2 * self.exponent + GUARD)
        loads = Precise([*statement.forces, statement.dissipation], statement, digits + 2 * self.exponent + GUARD)
        held = Precise([one.expression for one in statement.constraints], statement, digits + 2 * self.exponent + GUARD)
        self.surface = ConstraintSurface(statement, digits + 2 * self.exponent + GUARD)
        self.context = lagrangian.context
        self.number = self.context.mpf
        values = self.values = {p: self.number(parameters[p]) for p in statement.parameters}

        def energy(q: Sequence[Any], v: Sequence[Any], t: Any) -> Any:
            return lagrangian(q, v, t, values)[0]

        self.source = Sources(
            lagrangian=energy,
            for_momenta=lambda i: energy,
            for_forces=lambda i: energy,
            for_mass=lambda i: energy,
            forces=lambda q, v, t: loads(q, v, t, values)[:-1],
            dissipation=(lambda i: lambda q, v, t: loads(q, v, t, values)[-1]) if statement.dissipation != 0 else None,
            nudge=laws.exactly,
            read=lambda i: range(2 * len(statement.coordinates)),
            touched=lambda j: range(len(statement.coordinates)),
        )
        holonomic = tuple(one.holonomic for one in statement.constraints)
        self.held = StatedConstraints.alike(lambda q, v, t: held(q, v, t, values), holonomic)

    def on_constraints(self, t: Any, state: Numbers) -> Numbers:
        """Return a state that satisfies the constraints to all digits: what it lacks of them grows along a run."""
        if not self.held.holonomic:
            return state
        n = len(state) // 2
        try:
            q, v = self.surface.nearest(state[:n], state[n:], t, self.values)
        except OutsideDomain as reason:
            raise RunError(f"no precise run starts here: {reason}.") from reason
        return [*q, *v]

    def steps(self, q: FloatArray, v: FloatArray, length: float) -> DifferenceSteps:
        """Return the steps of the differences over an interval, from the sizes of its states, (s, n) each."""
        unit = self.number(10) ** -self.exponent
        sizes = [np.abs(x).max(axis=0) for x in (q, v)]
        by_q, by_v = ([unit * (float(x) or 1.0) for x in size] for size in sizes)
        return DifferenceSteps(by_q, by_v, unit * abs(length))

    def residual(
        self, q: Numbers, v: Numbers, a: Numbers, multipliers: Numbers, t: Any, steps: DifferenceSteps
    ) -> Numbers:
        """Return dp/dt - f - G^T lambda, n numbers, and dpsi/dt, m numbers: all zero when a is the acceleration."""
        free = laws.residual(self.source, q, v, a, t, steps)
        if not self.held.holonomic:
            return free
        exerted = zip(*reactions(gradient(self.held, q, v, t, steps), multipliers), strict=True)
        balance = [x - sum(forces) for x, forces in zip(free, exerted, strict=True)]
        return [*balance, *acceleration_level(self.held, q, v, a, t, steps)]
