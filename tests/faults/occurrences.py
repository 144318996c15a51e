"""Faults of events: close roots, roots at the ends of a run or a step, after a reset, and infinitely many."""

import math
from functools import cache

import numpy as np
import sympy as sp

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import Fault
from tests.faults.motions import particle, x


def moving(times: FloatArray) -> FloatArray:
    """Return the states of a free motion from x = -2 with speed 1."""
    return np.array([times - 2, np.ones_like(times)])


def free() -> Model:
    """Return the model of a free body that starts at x = -2 with speed 1."""
    return particle(0, -2.0, 1.0)


@cache
def ball() -> Model:
    """Return the model of a ball above a floor, with g = 2."""
    return lg.System(kinetic=x.dot**2 / 2, potential=2 * x, initial={x: 1.0}, name="ball").compile()


def bouncing(times: FloatArray) -> FloatArray:
    """Return the states of a ball dropped from height 1 with impacts at t = 1, 2, 2.5, ...; it rests from t = 3 on.

    Each impact halves the speed.
    """
    count = np.arange(60)
    impacts = np.append(3 - 4 * 0.5**count, 3.0)
    speeds = np.append(2 * 0.5**count, 0.0)
    last = np.searchsorted(impacts, times, side="right") - 1
    s, v = times - impacts[last], speeds[last]
    return np.where(last == 60, 0.0, np.array([v * s - s**2, v - 2 * s]))


def floor(restitution: sp.Expr) -> lg.Event:
    """Return the event of an impact on the floor."""
    return lg.event(x, direction=-1, reset={x.dot: -restitution * x.dot})


EVENTS = (
    Fault(
        "three roots",
        "x^3 - x has three roots within a step",
        free,
        end=6.0,
        options={"events": [x**3 - x]},
        truth=moving,
        events=((1.0, 2.0, 3.0),),
    ),
    Fault(
        "close roots",
        "two roots 1e-3 apart",
        free,
        end=6.0,
        options={"events": [(x - 1) * (x - 1.001)]},
        truth=moving,
        close=1e-6,
        fine=1e-6,
        rough=1e-6,
        events=((3.0, 3.001),),
    ),
    Fault(
        "close events",
        "two events 1e-3 apart, the second of which ends the run",
        free,
        end=6.0,
        options={"events": [x - 1, lg.event(x - sp.Rational(1001, 1000), terminal=True)]},
        truth=moving,
        events=((3.0,), (3.001,)),
        close=1e-6,
        fine=1e-6,
        rough=1e-6,
        statuses=(Status.EVENT,),
    ),
    Fault(
        "nan event",
        "the event log(1 - x) + 1 is nan beyond x = 1",
        lambda: particle(0, 0.0, 1.0),
        end=2.0,
        options={"events": [sp.log(1 - x) + 1]},
        events=((1 - math.exp(-1),),),
        statuses=(Status.NON_FINITE,),
        window=(0.9, 1.1),
        words="domain|not finite",
    ),
    Fault(
        "event at the start",
        "the event is zero at the start: no event, and not found again",
        free,
        end=3.0,
        options={"events": [x + 2]},
        truth=moving,
        events=((),),
    ),
    Fault(
        "event at the end",
        "the event is zero at the end",
        free,
        end=3.0,
        options={"events": [x - 1]},
        truth=moving,
        events=((3.0,),),
    ),
    Fault(
        "event between steps",
        "the event is zero where equal steps end, once",
        free,
        end=3.0,
        step=0.125,
        options={"events": [x + 1]},
        truth=moving,
        events=((1.0,),),
    ),
    Fault(
        "events at once",
        "two events at one time, one with a direction that is not met",
        free,
        end=3.0,
        options={"events": [x, 3 * x, lg.event(x, direction=-1)]},
        truth=moving,
        events=((2.0,), (2.0,), ()),
    ),
    Fault(
        "event after a reset",
        "a ball leaves the floor where it hits it, and does not hit it again at once",
        ball,
        end=2.3,
        options={"events": [floor(sp.Rational(1, 2))], "t_eval": [0.5, 1.5, 2.2]},
        truth=bouncing,
        events=((1.0, 2.0),),
    ),
    Fault(
        "bounces without end",
        "a ball comes to rest after infinitely many impacts, at t = 3, and must not fall through the floor",
        ball,
        end=6.0,
        step=1e-3,
        options={"events": [floor(sp.Rational(1, 2))], "t_eval": [0.5, 1.5, 2.2, 3.5, 5.5]},
        truth=bouncing,
        close=5e-9,
        statuses=(Status.STEP_TOO_SMALL,),
        window=(2.9, 3.1),
        words="infinitely many",
    ),
)
