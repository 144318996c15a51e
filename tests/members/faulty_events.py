"""Faults of events of single members of an ensemble whose other members are healthy."""

from __future__ import annotations

from functools import cache
from typing import Any

from sympy import Piecewise, log

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import Status
from tests.faults.constraints import ROD
from tests.faults.constraints import x as place
from tests.faults.constraints import y as height
from tests.faults.motions import NO_NUMBER, x
from tests.members.faulty import Faulty, c

ENDED, WELL = (Status.EVENT,), (Status.SUCCESS,)
ENDLESS = (Status.STEP_TOO_SMALL,)
"""How a member ends at a terminal event, as its neighbours do, or where events accumulate."""


@cache
def falling(force: Any = -2) -> Model:
    """Return the model of a unit mass on a line under a force, with a parameter c that only events contain."""
    return lg.System(
        kinetic=x.dot**2 / 2, forces={x: force + 0 * c}, initial={x: 1.0}, parameters={c: 0.5}, name="falling body"
    ).compile()


@cache
def bob() -> Model:
    """Return the model of a bob on a rod, with a parameter c that only events contain."""
    return lg.System(
        kinetic=(place.dot**2 + height.dot**2) / 2,
        potential=height,
        coordinates=[place, height],
        constraints={"rod": ROD},
        initial={place: 0.6, height: -0.8},
        parameters={c: -1.0},
        name="bob",
    ).compile()


kick = Piecewise((1.0, c > 0.9), (c * height.dot, True))
"""What a positive c makes of a velocity across the rod's end: one along the rod."""


def floor(share: Any) -> dict[str, Any]:
    """Return the event of an impact on a floor that keeps a fraction of the speed."""
    return {"events": [lg.event(x, direction=-1, reset={x.dot: -share * x.dot})]}


FAULTY_EVENTS = (
    Faulty(
        "nan event on the way",
        lambda: falling(0),
        "x",
        0.0,
        (-9.0, -4.0),
        NO_NUMBER,
        end=2.0,
        held={"x_dot": 1.0},
        options={"events": [log(1 - x) + 1]},
    ),
    Faulty("nan event by a number", falling, "c", -1.0, (0.5, 2.0), NO_NUMBER, options={"events": [x - log(c)]}),
    Faulty(
        "terminal event",
        lambda: falling(0),
        "x",
        -0.3,
        (-9.0, -4.0),
        ENDED,
        held={"x_dot": 1.0},
        options={"events": [lg.event(x, terminal=True)]},
    ),
    Faulty(
        "grazing event",
        falling,
        "x_dot",
        1.0,
        (0.1, 0.6),
        (*ENDED, *WELL),
        held={"x": 0.0},
        options={"events": [lg.event(x - 0.25, terminal=True)]},
    ),
    Faulty("bounces without end", falling, "c", 0.5, (0.9, 1.0), ENDLESS, end=6.0, options=floor(c)),
    Faulty("reset to inf", falling, "c", 0.0, (0.5, 1.0), NO_NUMBER, end=2.0, options=floor(1 / c)),
    Faulty(
        "reset off a constraint",
        bob,
        "c",
        1.0,
        (-1.0, -0.5),
        (Status.DIVERGED,),
        end=2.0,
        options={"events": [lg.event(place, reset={place.dot: c * place.dot, height.dot: kick})]},
    ),
)
"""Ways in which events of `tests.faults` go wrong, or nearly so: their values, their zeros and their resets."""
