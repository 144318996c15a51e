"""Messages for contacts whose laws have no consistent motion, or several: shared forces, and Painleve's paradox."""

from __future__ import annotations

from collections.abc import Sequence

import sympy

from lagrange.equations.regularity import independent_rows
from lagrange.errors import RunError, listing
from lagrange.machine.model import Model
from lagrange.trajectory.contact.bounces import coupling, response_of
from lagrange.trajectory.contact.kinematics import Kinematics, Touch
from lagrange.trajectory.trajectory import FloatArray

LONGEST_REGION = 120
"""Largest number of characters of the condition of Painleve's paradox in a message."""


class Undetermined(RunError):
    """Error: the laws of contact allow no consistent next motion, or several."""


def undetermined(
    kin: Kinematics, touch: Touch, y: FloatArray, chosen: Sequence[int], count: int, what: str
) -> Undetermined:
    """Return the error for contacts `chosen` at a state y (2n,) at which the laws allow `count` motions.

    `what` is "motion" or "impact". If there are several motions, the cause is contacts that depend on each other.
    """
    names = listing(repr(kin.contacts[i].name) for i in chosen)
    rows = touch.directions[[kin.normals[i] for i in chosen]]
    if count and (rank := len(independent_rows(rows))) < len(rows):
        return Undetermined(
            f"The contacts {names} depend on each other (rank {rank} of {len(rows)}) and have friction, so the motion "
            "depends on how they share their forces, which the laws do not determine: state fewer contacts, or equal "
            "friction."
        )
    allowed = f"{count} different motions after this {what}" if count else f"no {what}"
    return Undetermined(
        f"Coulomb's law allows {allowed} at {names} (Painleve's paradox), {_where(kin, touch, y, chosen)}. Lower "
        "the friction, or end the run before."
    )


def _where(kin: Kinematics, touch: Touch, y: FloatArray, chosen: Sequence[int]) -> str:
    """Return where Painleve's paradox occurs at `chosen` contacts: a condition in symbols, or the coordinates."""
    for i in chosen:
        normal, *along = kin.rows[i]
        for way in (1, -1) if len(along) == 1 else ():
            mu = kin.friction(i, touch.rates[along], touch.noise[along]).kinetic
            value = touch.compliance[normal, normal] - mu * way * touch.compliance[normal, along[0]]
            if value <= 0 and way * touch.rates[along[0]] >= -touch.noise[along[0]]:
                region = _region(kin.model, i, way)
                if region:
                    return f"as friction presses {kin.contacts[i].name!r} together where {region} <= 0"
    layout = kin.model.layout
    coordinates = zip(layout.coordinates, layout.split(y)[0].tolist(), strict=False)
    return f"at {listing(f'{name} = {value:.6g}' for name, value in coordinates)}"


def _region(model: Model, which: int, way: int) -> str:
    """Return, as text, the acceleration of a gap due to a unit normal force and the sliding friction that it causes.

    The contact with index `which` slides in the direction `way`, 1 or -1. Where this acceleration is not positive, a
    normal force does not open the gap. The text is "" if it is too long, or if the system has constraints.
    """
    statement, contact = model.statement, model.statement.contacts[which]
    mass = None if statement.constraints else coupling(statement)
    if mass is None:
        return ""
    normal = sympy.Matrix([contact.gap.diff(q) for q in statement.coordinates])
    along = sympy.Matrix([contact.slip[0].diff(rate) for rate in statement.velocities])
    change = normal.dot(response_of(mass, normal - way * contact.friction[1] * along))
    region = statement.quote(sympy.together(sympy.expand(change)), LONGEST_REGION + 1)
    return region if len(region) <= LONGEST_REGION else ""
