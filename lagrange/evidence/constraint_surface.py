"""States on the constraints of a statement, found by Newton's method in multiple precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lagrange.evidence import laws
from lagrange.evidence.central_differences import Numbers
from lagrange.evidence.constraint_laws import StatedConstraints, gradient, velocity_level
from lagrange.evidence.laws import DifferenceSteps
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.precise import Precise
from lagrange.statement.statement import Statement

DIGITS = 60
"""Digits of the evaluations: two thirds of them are left by first differences with steps of 1e-20."""

MOST_CORRECTIONS = 30
"""Corrections of a state before it counts as not to be brought onto the constraints."""


class ConstraintSurface:
    """The states (q, v) at which the constraints hold on positions and on velocities."""

    def __init__(self, statement: Statement, digits: int = DIGITS) -> None:
        self.tape = Precise([one.expression for one in statement.constraints], statement, digits)
        self.holonomic = tuple(one.holonomic for one in statement.constraints)
        self.number = self.tape.context.mpf
        self.step = self.number(10) ** -(digits // 3)

    def nearest(
        self, q: Sequence[Any], v: Sequence[Any], t: Any, parameters: Mapping[Any, Any]
    ) -> tuple[Numbers, Numbers]:
        """Return coordinates and velocities near the given ones, moved along the rows of G until the constraints hold.

        Raises OutsideDomain where none are found, and where the constraints depend on one another.
        """
        values = {p: self.number(x) for p, x in parameters.items()}
        places, rates, t = list(map(self.number, q)), list(map(self.number, v)), self.number(t)

        def zero(q: Sequence[Any], v: Sequence[Any], t: Any) -> Numbers:
            return self.tape(q, v, t, values)

        stated = StatedConstraints.alike(zero, self.holonomic)
        rows = [i for i, place in enumerate(self.holonomic) if place]

        def on_positions(q: Numbers) -> tuple[Numbers, list[Numbers]]:
            found, slopes = zero(q, rates, t), gradient(stated, q, rates, t, self._steps(q, rates, t))
            return [found[i] for i in rows], [slopes[i] for i in rows]

        def on_velocities(v: Numbers) -> tuple[Numbers, list[Numbers]]:
            steps = self._steps(places, v, t)
            return velocity_level(stated, places, v, t, steps), gradient(stated, places, v, t, steps)

        if rows:
            places = self._corrected(places, on_positions)
        return places, self._corrected(rates, on_velocities)

    def _steps(self, q: Numbers, v: Numbers, t: Any) -> DifferenceSteps:
        by_q, by_v = ([self.step * (abs(x) or 1) for x in values] for values in (q, v))
        times = [abs(x) / abs(rate) for x, rate in zip(q, v, strict=True) if x and rate]
        return DifferenceSteps(by_q, by_v, self.step * min(times, default=abs(t) or self.number(1)))

    def _corrected(self, x: Numbers, at: Callable[[Numbers], tuple[Numbers, list[Numbers]]]) -> Numbers:
        """Return x less G^T z, with G G^T z = the residual, until the corrections are round-off."""
        for _ in range(MOST_CORRECTIONS):
            residual, rows = at(x)
            square = [[sum(a * b for a, b in zip(row, other, strict=True)) for other in rows] for row in rows]
            (z,) = laws.solve(square, [residual], self.step)
            change = [sum(row[j] * by for row, by in zip(rows, z, strict=True)) for j in range(len(x))]
            x = [a - b for a, b in zip(x, change, strict=True)]
            if all(abs(b) <= self.step * (1 + abs(a)) for a, b in zip(x, change, strict=True)):
                return x
        raise OutsideDomain("no state nearby satisfies the constraints")
