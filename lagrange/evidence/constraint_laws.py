"""Constraints and their rates by numerical differentiation, and states that satisfy them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.evidence import laws
from lagrange.evidence.laws import DifferenceSteps, Nudge, Numbers, Row, StateFunction, along, central, exactly, moved
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.statement.statement import Statement


@dataclass(frozen=True)
class StatedConstraints:
    """The m constraint expressions as functions of (q, v, t); `holonomic` has True for each constraint on positions.

    `for_gradient` is for the gradient G, `for_rates` for time derivatives. They are two functions, so that their
    perturbed copies have independent rounding, as in `Sources`.
    """

    for_gradient: StateFunction
    for_rates: StateFunction
    holonomic: tuple[bool, ...]
    nudge: Nudge = exactly

    @staticmethod
    def alike(values: StateFunction, holonomic: tuple[bool, ...]) -> StatedConstraints:
        """Return constraints that use the same function for G and for the rates."""
        return StatedConstraints(values, values, holonomic)

    def chosen(self, by_position: Sequence[Any], by_velocity: Sequence[Any]) -> Numbers:
        """Return one entry for each constraint: from `by_position` if it is holonomic, else from `by_velocity`."""
        return [
            a if is_holonomic else b
            for a, b, is_holonomic in zip(by_position, by_velocity, self.holonomic, strict=True)
        ]


def gradient(stated: StatedConstraints, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> list[Numbers]:
    """Return the gradient G, m rows of n numbers: dphi/dq of a holonomic constraint, else dpsi/dv."""

    def by_q(j: int) -> Numbers:
        return central(lambda h: stated.for_gradient(moved(q, j, h), v, t), steps.q[j])

    def by_v(j: int) -> Numbers:
        return central(lambda h: stated.for_gradient(q, moved(v, j, h), t), steps.v[j])

    unused: Numbers = [0] * len(stated.holonomic)
    columns = [
        stated.chosen(by_q(j) if any(stated.holonomic) else unused, unused if all(stated.holonomic) else by_v(j))
        for j in range(len(q))
    ]
    return [list(row) for row in zip(*columns, strict=True)]


def velocity_level(stated: StatedConstraints, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> Numbers:
    """Return psi, m numbers: dphi/dt of a holonomic constraint, or the expression of a constraint on velocities."""
    still: Numbers = [0] * len(q)
    moving = _rates(stated, q, v, still, t, steps) if any(stated.holonomic) else [0] * len(stated.holonomic)
    return stated.chosen(moving, stated.for_rates(q, v, t))


def acceleration_level(
    stated: StatedConstraints, q: Numbers, v: Numbers, a: Numbers, t: Any, steps: DifferenceSteps
) -> Numbers:
    """Return dpsi/dt = G a + gamma, m numbers: derivatives along the path q + v s + a s^2/2."""
    v_along, a_along, t_along = _directions(stated, v, a)

    def rates_at(s: Any) -> Numbers:
        moved = along(along(q, v_along, s), a_along, s * s / 2)
        return _rates(stated, moved, along(v, a_along, s), a, t + s * t_along, steps)

    unused: Numbers = [0] * len(stated.holonomic)
    return stated.chosen(
        central(rates_at, steps.motion) if any(stated.holonomic) else unused,
        unused if all(stated.holonomic) else _rates(stated, q, v, a, t, steps),
    )


def _rates(stated: StatedConstraints, q: Numbers, v: Numbers, a: Numbers, t: Any, steps: DifferenceSteps) -> Numbers:
    """Return the first time derivatives of the constraint expressions along the motion, m numbers."""
    v_along, a_along, t_along = _directions(stated, v, a)

    def values_at(s: Any) -> Sequence[Any]:
        moved = along(along(q, v_along, s), a_along, s * s / 2)
        values: Sequence[Any] = stated.for_rates(moved, along(v, a_along, s), t + s * t_along)
        return values

    return central(values_at, steps.motion)


def _directions(stated: StatedConstraints, v: Numbers, a: Numbers) -> tuple[Numbers, Numbers, Any]:
    """Return the time derivatives (v, a, 1) of q, v and t along the motion, perturbed where rounding is measured."""
    nudge = stated.nudge
    v_along = [x * nudge("held velocity", i) for i, x in enumerate(v)]
    a_along = [x * nudge("held acceleration", i) for i, x in enumerate(a)]
    return v_along, a_along, nudge("held time", 0)


def reactions(gradient: Sequence[Numbers], multipliers: Sequence[Any]) -> list[Numbers]:
    """Return the constraint forces G_i^T lambda_i, m rows of n numbers."""
    return [[entry * x for entry in row] for row, x in zip(gradient, multipliers, strict=True)]


def bordered(mass: Sequence[Row], gradient: Sequence[Numbers]) -> list[Row]:
    """Return the rows of [[M, G^T], [G, 0]]. For the right-hand side [h, -gamma] the solution is [a, -lambda]."""
    upper = [dict(row) for row in mass]
    lower = [{i: x for i, x in enumerate(line) if x} for line in gradient]
    for j, line in enumerate(lower, len(mass)):
        for i, x in line.items():
            upper[i][j] = x
    return upper + lower


CONSTRAINT_DIGITS = 60
"""Decimal digits of the evaluations: first differences with steps of 1e-20 keep two thirds of them."""

PRECISE_CORRECTIONS = 30
"""Largest number of Newton corrections of a state towards the constraints."""


class ConstraintSurface:
    """The states (q, v) that satisfy the constraints on positions and on velocities."""

    def __init__(self, statement: Statement, digits: int = CONSTRAINT_DIGITS) -> None:
        self.tape = Precise([constraint.expression for constraint in statement.constraints], statement, digits)
        self.holonomic = tuple(constraint.holonomic for constraint in statement.constraints)
        self.number = self.tape.context.mpf
        self.step = self.number(10) ** -(digits // 3)

    def nearest(
        self, q: Sequence[Any], v: Sequence[Any], t: Any, parameters: Mapping[Any, Any]
    ) -> tuple[Numbers, Numbers]:
        """Return q and v moved along the rows of G until the constraints hold. Raises OutsideDomain if that fails."""
        values = {p: self.number(x) for p, x in parameters.items()}
        position, rates, t = list(map(self.number, q)), list(map(self.number, v)), self.number(t)

        def zero(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
            return self.tape(q, v, t, values)

        stated = StatedConstraints.alike(zero, self.holonomic)
        rows = [i for i, is_holonomic in enumerate(self.holonomic) if is_holonomic]

        def steps(q: Numbers, v: Numbers) -> DifferenceSteps:
            return DifferenceSteps.at(q, v, t, self.step, timed=self.tape.uses_time)

        def on_positions(q: Numbers) -> tuple[Numbers, list[Numbers]]:
            residual, slopes = zero(q, rates, t), gradient(stated, q, rates, t, steps(q, rates))
            return [residual[i] for i in rows], [slopes[i] for i in rows]

        def on_velocities(v: Numbers) -> tuple[Numbers, list[Numbers]]:
            new_steps = steps(position, v)
            return velocity_level(stated, position, v, t, new_steps), gradient(stated, position, v, t, new_steps)

        if rows:
            position = self._corrected(position, on_positions)
        return position, self._corrected(rates, on_velocities)

    def _corrected(self, x: Numbers, at: Callable[[Numbers], tuple[Numbers, list[Numbers]]]) -> Numbers:
        """Return x after Newton corrections -G^T z with G G^T z = residual; `at(x)` returns residual and rows of G."""
        for _ in range(PRECISE_CORRECTIONS):
            residual, rows = at(x)
            square = [[sum(a * b for a, b in zip(row, other, strict=True)) for other in rows] for row in rows]
            z = laws.solve_dense(square, residual, self.step)
            change = [sum(row[j] * by for row, by in zip(rows, z, strict=True)) for j in range(len(x))]
            x = [a - b for a, b in zip(x, change, strict=True)]
            if all(abs(b) <= self.step * (1 + abs(a)) for a, b in zip(x, change, strict=True)):
                return x
        raise OutsideDomain("no state nearby satisfies the constraints")
