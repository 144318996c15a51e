"""Constraints by numerical differentiation of what was stated, written as the definitions read.

A holonomic constraint states phi(q, t) = 0, and psi is dphi/dt along the motion; others state psi(q, v, t) = 0. Then

    G = dphi/dq, or dpsi/dv        dpsi/dt = G a + gamma        M a = h + G^T lambda
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.evidence.central_differences import Numbers, central
from lagrange.evidence.laws import DifferenceSteps, Nudge, StateFunction, along, exactly, moved


@dataclass(frozen=True)
class StatedConstraints:
    """The m expressions that are stated to be zero, as functions of (q, v, t), and which of them are holonomic.

    They are stored twice, for G and for what has no accelerations, as the Lagrangian is in `Sources`.
    """

    for_gradient: StateFunction
    for_rates: StateFunction
    holonomic: tuple[bool, ...]
    nudge: Nudge = exactly

    @staticmethod
    def alike(values: StateFunction, holonomic: tuple[bool, ...]) -> StatedConstraints:
        """Return what is computed in one way for G and for the rates."""
        return StatedConstraints(values, values, holonomic)

    def chosen(self, by_position: Sequence[Any], by_velocity: Sequence[Any]) -> Numbers:
        """Return the entries of holonomic constraints from one list, those of others from another."""
        return [a if place else b for a, b, place in zip(by_position, by_velocity, self.holonomic, strict=True)]


def gradient(stated: StatedConstraints, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> list[Numbers]:
    """Return G, m rows of n numbers."""

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


def position_level(stated: StatedConstraints, q: Numbers, v: Numbers, t: Any) -> Numbers:
    """Return phi, m numbers; 0 for what is stated in velocities."""
    return stated.chosen(stated.for_rates(q, v, t), [0] * len(stated.holonomic))


def velocity_level(stated: StatedConstraints, q: Numbers, v: Numbers, t: Any, steps: DifferenceSteps) -> Numbers:
    """Return psi, m numbers."""
    still: Numbers = [0] * len(q)
    moving = _rates(stated, q, v, still, t, steps) if any(stated.holonomic) else [0] * len(stated.holonomic)
    return stated.chosen(moving, stated.for_rates(q, v, t))


def acceleration_level(
    stated: StatedConstraints, q: Numbers, v: Numbers, a: Numbers, t: Any, steps: DifferenceSteps
) -> Numbers:
    """Return dpsi/dt = G a + gamma, m numbers: the second rate of phi, the first of psi, along q + v s + a s^2/2."""
    v_along, a_along, t_along = _directions(stated, v, a)

    def rates_at(s: Any) -> Numbers:
        there = along(along(q, v_along, s), a_along, s * s / 2)
        return _rates(stated, there, along(v, a_along, s), a, t + s * t_along, steps)

    unused: Numbers = [0] * len(stated.holonomic)
    return stated.chosen(
        central(rates_at, steps.motion) if any(stated.holonomic) else unused,
        unused if all(stated.holonomic) else _rates(stated, q, v, a, t, steps),
    )


def _rates(stated: StatedConstraints, q: Numbers, v: Numbers, a: Numbers, t: Any, steps: DifferenceSteps) -> Numbers:
    """Return the rates of what is stated along the motion."""
    v_along, a_along, t_along = _directions(stated, v, a)

    def values_at(s: Any) -> Sequence[Any]:
        there = along(along(q, v_along, s), a_along, s * s / 2)
        values: Sequence[Any] = stated.for_rates(there, along(v, a_along, s), t + s * t_along)
        return values

    return central(values_at, steps.motion)


def _directions(stated: StatedConstraints, v: Numbers, a: Numbers) -> tuple[Numbers, Numbers, Any]:
    """Return velocities, accelerations and the rate of time, each a little off where rounding is measured."""
    nudge = stated.nudge
    v_along = [x * nudge("held velocity", i) for i, x in enumerate(v)]
    a_along = [x * nudge("held acceleration", i) for i, x in enumerate(a)]
    return v_along, a_along, nudge("held time", 0)


def reactions(gradient: Sequence[Numbers], multipliers: Sequence[Any]) -> list[Numbers]:
    """Return G_i^T lambda_i, m rows of n numbers."""
    return [[entry * x for entry in row] for row, x in zip(gradient, multipliers, strict=True)]


def bordered(mass: Sequence[Numbers], gradient: Sequence[Numbers]) -> list[Numbers]:
    """Return [[M, G^T], [G, 0]], n + m rows; with h and -gamma on the right it is solved by a and -lambda."""
    upper = [[*row, *(line[i] for line in gradient)] for i, row in enumerate(mass)]
    return upper + [[*line, *([0] * len(gradient))] for line in gradient]
