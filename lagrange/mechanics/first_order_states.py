"""States of systems with coordinates whose equations of motion are of first order: these fix velocities.

Where the Lagrangian is linear in the velocity of a coordinate, as for point vortices, its equation is a relation of
velocities, r(q, v, t) = 0. A state of the motion satisfies it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import sympy

from lagrange.evidence.laws import solve
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.precise import Precise
from lagrange.evidence.sample import Point
from lagrange.mechanics.plain_form import PlainForm
from lagrange.statement.statement import Statement

DIGITS = 60
"""Digits of the velocities: more than the derivatives of the motion keep."""

LEFT = 1e-40
"""What a relation that is linear in the velocities leaves at most, relative to its terms: rounding of 60 digits."""

SINGULAR = 1e-12
"""Pivot, relative to its row, from which the relations do not determine the velocities."""


class FirstOrderStates:
    """The relations of the coordinates without inertia of a statement; `places` are the indices of these coordinates.

    A coordinate that a constraint holds is none of them, nor is one whose equation has no velocity.
    """

    def __init__(self, statement: Statement) -> None:
        form = PlainForm(statement)
        held = [form.read(one.expression) for one in statement.constraints]
        self.places = tuple(
            i
            for i, (q, v, momentum) in enumerate(zip(form.q, form.v, form.momenta, strict=True))
            if not any(momentum.diff(other) != 0 for other in form.v) and not any(one.has(q, v) for one in held)
        )
        relations = [form.residuals[i] for i in self.places]
        self._tape = None
        if relations:
            slopes = [sympy.diff(r, form.v[j]) for r in relations for j in self.places]
            self._tape = Precise([one.xreplace(form.stated) for one in (*relations, *slopes)], statement, DIGITS)

    def satisfied(self, point: Point) -> Point:
        """Return a point with the velocities of these coordinates that the relations give, linear in them.

        Raises OutsideDomain where they determine none.
        """
        if self._tape is None:
            return point
        number, n = self._tape.context.mpf, len(self.places)
        parameters = {p: number(x) for p, x in point.parameters.items()}
        found: list[Any] = self._tape(point.q, point.v, point.t, parameters)
        matrix = [found[n + i * n : n + (i + 1) * n] for i in range(n)]
        steps = solve(matrix, [found[:n]], SINGULAR)[0]
        v = list(point.v)
        for place, step in zip(self.places, steps, strict=True):
            v[place] = v[place] - step
        moved = replace(point, v=tuple(v))
        left = self._tape(moved.q, moved.v, moved.t, parameters)[:n]
        if max(map(abs, left)) > LEFT * (1 + max(map(abs, found))):
            raise OutsideDomain("the relations are not linear in the velocities")
        return moved
