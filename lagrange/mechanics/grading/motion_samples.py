"""Draw the random states at which a student's equations are tested, with true accelerations in many digits."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from types import MappingProxyType
from typing import Any

import sympy

from lagrange.errors import StatementError
from lagrange.evidence.differences import ConstraintSurface, solve_dense
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.evidence.reference import Reference
from lagrange.mechanics.plain_form import PlainForm
from lagrange.statement.random_states import SAMPLE_KINDS, SamplePoint, Sampler, usable
from lagrange.statement.statement import Statement

DIGITS = 60  # Decimal digits of the velocities: more than the accelerations have

LEFT = 1e-40
"""Largest residual of a first-order equation of motion after one Newton step for the velocities, relative to its terms,
if the equation is linear in them. It allows for rounding of numbers with 60 digits."""

SINGULAR = 1e-12
"""Pivot of elimination, relative to its row, below which a matrix, such as a mass matrix, counts as singular"""
LEAST = 1e-9  # Smallest magnitude of a non-zero coordinate or velocity, since difference steps are proportional to it
ROUND_OFF = 1e-14
"""Largest coordinate or velocity that is set to zero, as a rounding error, in a state moved onto the constraints"""
ATTEMPTS = 120  # Largest number of random draws in the search for states


@dataclass(frozen=True)
class MotionSample:
    """A state on the constraints, `point`, with the true `accelerations` (n,) and `multipliers` (m,) of the system.

    `mass` is the mass matrix and `gradient` the gradients of the m constraints, both as tuples of rows. `first_order`
    are the indices of coordinates without inertia, whose equations of motion are of first order.
    """

    point: SamplePoint
    accelerations: tuple[Any, ...]
    multipliers: tuple[Any, ...]
    mass: tuple[list[Any], ...]
    gradient: tuple[list[Any], ...]
    first_order: tuple[int, ...] = ()


def motion_samples(
    statement: Statement,
    count: int,
    seed: int = 0,
    *,
    positive: Collection[str] = (),
    values: Mapping[Any, float] = MappingProxyType({}),
) -> list[MotionSample]:
    """Return `count` random states with the true accelerations; equal seeds give equal states.

    Most parameters, coordinates and velocities are of order one, so that no term of an equation is negligible. The
    coordinates with names in `positive` are positive, and the parameters in `values` have these values. Raises
    StatementError if not enough states are found at which the accelerations are determined.
    """
    sampler, states = Sampler(statement, seed), MotionStates(statement)
    _, order_one, _, near, _ = SAMPLE_KINDS
    points = (sampler.point(near if draw % 3 == 2 else order_one, draw // 3) for draw in range(ATTEMPTS))

    def sample(point: SamplePoint) -> MotionSample | None:
        q = tuple(abs(x) if name in positive else x for name, x in zip(statement.names, point.q, strict=True))
        with suppress(OutsideDomain):
            point = states.satisfied(replace(point, q=q, parameters={**point.parameters, **values}))
            turned = any(x < 0 for name, x in zip(statement.names, point.q, strict=True) if name in positive)
            return None if turned else states.motion(point)
        return None

    samples = [*islice(usable(points, sample), count)]
    if len(samples) == count:
        return samples
    raise StatementError(
        f"{statement.name} has no state, of {ATTEMPTS} that were drawn, at which its motion is determined: give "
        "initial values and parameters at which it runs."
    )


class MotionStates:
    """Finds states that satisfy the constraints and first-order equations of a statement, and their accelerations.

    A first-order equation belongs to a coordinate without inertia, and is a relation between velocities. `indices` are
    the indices of these coordinates, except those that occur in a constraint.
    """

    def __init__(self, statement: Statement) -> None:
        form = PlainForm(statement)
        constraints = [form.read(constraint.expression) for constraint in statement.constraints]
        self.indices = tuple(
            i
            for i, (q, v, momentum) in enumerate(zip(form.q, form.v, form.momenta, strict=True))
            if not any(momentum.diff(other) != 0 for other in form.v)
            and not any(constraint.has(q, v) for constraint in constraints)
        )
        relations = [form.residuals[i] for i in self.indices]
        slopes = [sympy.diff(r, form.v[j]) for r in relations for j in self.indices]
        expressions = [expression.xreplace(form.stated) for expression in (*relations, *slopes)]
        self._relations = Precise(expressions, statement, DIGITS) if relations else None
        self._surface, self.reference = ConstraintSurface(statement), Reference(statement, self.indices)

    def satisfied(self, point: SamplePoint) -> SamplePoint:
        """Return a state near `point` that satisfies the constraints and first-order equations.

        Raises OutsideDomain if none is found.
        """
        if self._surface.holonomic:
            moved = self._surface.nearest(point.q, point.v, point.t, point.parameters)
            q, v = (tuple(0.0 if abs(x) < ROUND_OFF else x for x in entries) for entries in moved)
            point = replace(point, q=q, v=v)
        if self._relations is None:
            return point
        # New velocities of the coordinates without inertia satisfy the relations, which must be linear in them.
        number, n = self._relations.context.mpf, len(self.indices)
        parameters = {p: number(x) for p, x in point.parameters.items()}
        residuals: list[Any] = self._relations(point.q, point.v, point.t, parameters)
        matrix = [residuals[n + i * n : n + (i + 1) * n] for i in range(n)]
        rates: list[Any] = list(point.v)
        for index, step in zip(self.indices, solve_dense(matrix, residuals[:n], SINGULAR), strict=True):
            rates[index] = rates[index] - step
        left = self._relations(point.q, rates, point.t, parameters)[:n]
        if max(map(abs, left)) > LEFT * (1 + max(map(abs, residuals))):
            raise OutsideDomain("the relations are not linear in the velocities")
        return replace(point, v=tuple(rates))

    def motion(self, point: SamplePoint) -> MotionSample:
        """Return a state with its accelerations and multipliers. Raises OutsideDomain if they are not determined."""
        if any(0 < abs(x) < LEAST for x in (*point.q, *point.v)):
            raise OutsideDomain("a coordinate or velocity is too small for differences")
        entries, n, constraint_count = self.reference.at(point, ()), len(point.q), len(self.reference.holonomic)

        def rows(name: str, count: int) -> tuple[list[Any], ...]:
            values = entries[name].value if count else []
            return tuple(list(values[i * n : (i + 1) * n]) for i in range(count))

        return MotionSample(
            point,
            tuple(entries["accelerations"].value),
            tuple(entries["multipliers"].value) if constraint_count else (),
            rows("mass_matrix", n),
            rows("constraint_gradient", constraint_count),
            self.indices,
        )
