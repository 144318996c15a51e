"""Coordinates whose velocity stands nowhere: their acceleration is undefined, and the refusal says what to state."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import sympy

from lagrange.statement.coordinate import velocity_of


def without_velocity(
    coordinates: Sequence[Any],
    velocities: Collection[Any],
    held: Iterable[Any],
    kinetic: Any,
    lagrangian: Any,
    forces: Mapping[Any, Any],
    dissipation: Any,
    *,
    alone: bool,
) -> Any | None:
    """Return the first coordinate whose acceleration no equation can determine, or None.

    `velocities` are those in the energies, and `held` the expressions of the constraints. `kinetic` is T, or L where
    that was stated `alone`. A coordinate without inertia is determined by a constraint, or by a velocity in its own
    equation 0 = dL/dq + Q - dD/dv: in p*q.dot - H the equation of q determines the velocity of p, and with
    D = e.dot**2/2 that of e is e.dot = Q. An energy that is not zero and has no velocity was meant to have one: then
    friction is no reason to go on.
    """
    mistaken = kinetic != 0 and not (kinetic.has(*coordinates) if alone else velocities)
    rates = [velocity_of(q) for q in coordinates]
    for q, rate in zip(coordinates, rates, strict=True):
        if rate in velocities or any(zero.has(q) for zero in held):
            continue
        rubbed = forces.get(q, sympy.S.Zero).has(*rates) or dissipation.diff(rate).has(*rates)
        if rubbed and not mistaken:
            continue
        if not lagrangian.has(q) or not lagrangian.diff(q).has(*rates):
            return q
    return None


def first_order_remedy(rate: str) -> str:
    """Return how a state of first order is stated."""
    return (
        f"If it is a state of first order, such as a current, give its rate as the force on it and {rate}**2/2 as "
        f"dissipation, or the constraint {rate} - (its rate)."
    )
