"""Faults of contacts: starts inside a body, laws without a meaning, and an impact."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from sympy import cos, diff, sin

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray
from tests.faults.fault import Fault

y = lg.coordinate("y")

NOT_MADE_FOR = "does not locate events|leaves out the forces of constraints|moves coordinates and velocities in turn"
"""Parts of the messages of methods that cannot run to an impact, or with a closed gap as a constraint."""


def ball(initial: Any = None, **law: Any) -> Callable[[], Model]:
    """Return a function that makes the model of a unit mass falling under unit gravity on a floor."""

    @cache
    def made() -> Model:
        floor, start = lg.contact(y, **law), {y: 1.0} if initial is None else initial
        return lg.System(y.dot**2 / 2, y, contacts={"floor": floor}, initial=start, name="ball").compile()

    return made


@cache
def rod() -> Model:
    """Return a rod on a rough floor, in the region of Painleve's paradox."""
    x, theta = lg.coordinates("x theta")
    floor = lg.contact(y - sin(theta) / 2, slip=diff(x + cos(theta) / 2, lg.t), friction=1.4)
    start = {theta: np.pi / 3, y: np.sin(np.pi / 3) / 2, x.dot: 3.0}
    kinetic = (x.dot**2 + y.dot**2) / 2 + theta.dot**2 / 24
    return lg.System(kinetic, 9.81 * y, contacts={"floor": floor}, initial=start, name="rod").compile()


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
    Fault("start inside a body", "y = -0.5", ball({y: -0.5}), refusal=f"inside a body|{NOT_MADE_FOR}"),
    Fault(
        "restitution above one",
        "e = 2 - u/8 at impacts with the speed u",
        ball(restitution=2 - lg.impact_speed / 8),
        end=3.0,
        refusal=f"restitution|{NOT_MADE_FOR}",
    ),
    Fault(
        "run backwards through contacts",
        "t from 1 to 0",
        ball(),
        start=1.0,
        end=0.0,
        refusal=f"run forwards|{NOT_MADE_FOR}",
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
    Fault("Painleve's paradox", "a rod at 60 degrees, mu = 1.4", rod, refusal=f"Painleve|{NOT_MADE_FOR}"),
)
