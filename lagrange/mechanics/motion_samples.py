"""States of a statement with the accelerations and multipliers of the motion, to many digits, without compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from lagrange.errors import StatementError
from lagrange.evidence.constraint_surface import ConstraintSurface
from lagrange.evidence.operations import OutsideDomain
from lagrange.evidence.reference import Reference
from lagrange.evidence.sample import SAMPLE_KINDS, Point, Sampler
from lagrange.statement.statement import Statement

LEAST = 1e-9
"""The least size of a coordinate or velocity that is not zero: derivatives are differences in units of it."""

ROUND_OFF = 1e-14
"""The size of an entry, among others of order one, that a constraint makes zero."""

ATTEMPTS = 120
"""Draws for one state before the search is given up."""


@dataclass(frozen=True)
class MotionSample:
    """A state on the constraints, with the accelerations (n,), the multipliers (m,) and the matrices M and G there."""

    point: Point
    accelerations: tuple[Any, ...]
    multipliers: tuple[Any, ...]
    mass: tuple[list[Any], ...]
    gradient: tuple[list[Any], ...]

    @property
    def parameters(self) -> Mapping[Any, float]:
        """The values of the parameters."""
        return self.point.parameters


def motion_samples(statement: Statement, count: int, seed: int = 0) -> list[MotionSample]:
    """Return so many states at which the statement determines the motion, the same for the same seed.

    Parameters and states are of order one, so that no term hides behind another. Raises StatementError where no such
    states are found.
    """
    sampler, surface, reference = Sampler(statement, seed), ConstraintSurface(statement), Reference(statement)
    found: list[MotionSample] = []
    order_one = SAMPLE_KINDS[1]
    near = SAMPLE_KINDS[3]
    for attempt in range(ATTEMPTS):
        if len(found) == count:
            return found
        point = sampler.point(near if attempt % 3 == 2 else order_one, attempt // 3)
        with suppress(OutsideDomain):
            found.append(motion_at(on_constraints(point, surface), reference))
    raise StatementError(
        f"{statement.name} has no state, of {ATTEMPTS} that were drawn, at which its motion is determined: give "
        "initial values and parameters at which it runs."
    )


def on_constraints(point: Point, surface: ConstraintSurface) -> Point:
    """Return a point near the given one on the constraints, to 40 digits. Raises OutsideDomain where there is none."""
    if not surface.holonomic:
        return point
    q, v = surface.nearest(point.q, point.v, point.t, point.parameters)
    return replace(point, q=tuple(map(_without_noise, q)), v=tuple(map(_without_noise, v)))


def _without_noise(value: Any) -> Any:
    """Return an entry of a state on the constraints, zero where it is the round-off of zero."""
    return 0.0 if abs(value) < ROUND_OFF else value


def motion_at(point: Point, reference: Reference) -> MotionSample:
    """Return the motion at a point that satisfies the constraints. Raises OutsideDomain where it is not determined."""
    if any(0 < abs(x) < LEAST for x in (*point.q, *point.v)):
        raise OutsideDomain("a coordinate or velocity is too small for differences")
    entries, n, held = reference.at(point, ()), len(point.q), len(reference.holonomic)

    def rows(name: str, count: int) -> tuple[list[Any], ...]:
        values = entries[name].value if count else []
        return tuple(list(values[i * n : (i + 1) * n]) for i in range(count))

    return MotionSample(
        point,
        tuple(entries["accelerations"].value),
        tuple(entries["multipliers"].value) if held else (),
        rows("mass_matrix", n),
        rows("constraint_gradient", held),
    )
