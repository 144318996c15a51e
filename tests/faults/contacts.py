"""Faults of contacts: an impact, and one whose restitution has no meaning."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray
from tests.faults.fault import Fault

y = lg.coordinate("y")

NOT_MADE_FOR = "does not locate events|leaves out the forces of constraints|moves coordinates and velocities in turn"
"""Parts of the messages of methods that cannot run to an impact, or with a closed gap as a constraint."""


def ball(restitution: Any) -> Callable[[], Model]:
    """Return a function that makes the model of a unit mass falling under unit gravity on a floor."""

    @cache
    def made() -> Model:
        floor = lg.contact(y, restitution=restitution)
        return lg.System(y.dot**2 / 2, y, contacts={"floor": floor}, initial={y: 1.0}, name="ball").compile()

    return made


def rebound(times: FloatArray) -> FloatArray:
    """Return the states of a fall from height 1 with one impact of restitution 0.5."""
    hit, g = np.sqrt(2), times - np.sqrt(2)
    late = times > hit
    return np.array(
        [
            np.where(late, hit / 2 * g - g**2 / 2, 1 - times**2 / 2),
            np.where(late, hit / 2 - g, -times),
        ]
    )


CONTACTS = (
    Fault(
        "restitution above one",
        "e = 2 - u/8 at impacts with the speed u",
        ball(restitution=2 - lg.impact_speed / 8),
        end=3.0,
        refusal=f"restitution|{NOT_MADE_FOR}",
    ),
    Fault(
        "one impact",
        "restitution 0.5",
        ball(restitution=0.5),
        end=2.5,
        truth=rebound,
        options={"t_eval": np.linspace(0, 2.5, 11)},
        refusal=NOT_MADE_FOR,
    ),
)
