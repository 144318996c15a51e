"""Faults of the request and of events: extreme values, wrong steps, interruptions; close roots, infinitely many."""

import math
from functools import cache
from typing import Any

import numpy as np
import sympy as sp

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import GAVE_UP, Fault
from tests.faults.motions import NO_NUMBER, cosine, particle, x

NOT_OF_A_FIXED_STEP = "takes fixed steps and cannot aim at a tolerance"
CHOOSES_ITS_STEPS = "chooses its steps by itself"


def bob() -> Model:
    """Return the model of x'' = -x, released at x = 1."""
    return particle(-x, 1.0)


def interrupt(now: float) -> None:
    """Raise KeyboardInterrupt, as Ctrl-C does."""
    raise KeyboardInterrupt


class Broken(RuntimeError):
    """Exception of a callback that fails."""


def fall_over(now: float) -> None:
    """Raise an exception from a progress callback."""
    raise Broken(f"no terminal at t = {now}")


def asked(name: str, about: str, **more: Any) -> Fault:
    """Return a fault of the request for a run of `bob`."""
    return Fault(name, about, bob, **more)


def of_size(size: float) -> dict[str, Any]:
    """Return a start at x = `size`, its exact motion, and how a run may end whose squares overflow."""
    return {
        "options": {"initial": {x: size}},
        "truth": lambda times: size * cosine(times),
        "statuses": NO_NUMBER,
        "window": (0.0, 1e-300),
    }


LONG: dict[str, Any] = {"max_steps": 10_000_000}
ENDLESS: dict[str, Any] = {"end": 1e9, "truth": cosine, "compared": 1.0}

REQUESTS = (
    asked(
        "negative rtol", "rtol = -1e-6", options={"rtol": -1e-6}, step=None,
        refusal=("rtol = -1e-06: give", NOT_OF_A_FIXED_STEP),
    ),
    asked(
        "step 0", "step = 0", options={"step": 0.0}, step=0.0,
        refusal=(CHOOSES_ITS_STEPS, "step = 0: give a positive"),
    ),
    asked(
        "wrong setting", "a step for an adaptive method, tolerances for one with fixed steps",
        refusal=(CHOOSES_ITS_STEPS, NOT_OF_A_FIXED_STEP), adaptive={"step": 0.1}, equal={"step": None, "rtol": 1e-6},
    ),
    asked(
        "tolerances 0", "rtol = atol = 0", end=0.1, step=None, options={"rtol": 0.0, "atol": 0.0}, truth=cosine,
        close=1e-9, refusal=("", NOT_OF_A_FIXED_STEP), statuses=(*NO_NUMBER, *GAVE_UP),
    ),
    asked("long step", "step = 1 for a run of 0.01", end=0.01, step=1.0, truth=cosine),
    asked("no span", "a run from 0 to 0", end=0.0, truth=cosine),
    asked("backwards", "a run from 0 to -3", end=-3.0, truth=cosine, rough=0.05),
    asked("huge", "x = 1e300, whose square no double holds", **of_size(1e300)),
    asked("large", "x = 1e150", **of_size(1e150)),
    asked("tiny", "x = 1e-300, whose square no double holds", **of_size(1e-300) | {"statuses": ()}),
    asked(
        "late", "at t = 1e16 the spacing of doubles is 2", start=1e16, end=1e16 + 8, window=(1e16, 1e16 + 8),
        statuses=(Status.STEP_TOO_SMALL,), words="spacing of floating-point times",
        refusal=("", "below the spacing of floating-point times"),
    ),
    asked(
        "max_steps", "max_steps = 10", end=1000.0, options={"max_steps": 10}, truth=cosine,
        statuses=(Status.MAX_STEPS,), words="max_steps = 10 at",
    ),
    asked(
        "max_wall", "max_wall = 0.02 s for 1e9 s", **ENDLESS, options=LONG | {"max_wall": 0.02},
        statuses=(Status.MAX_WALL,), words=r"max_wall = 0\.02 s",
    ),
    asked(
        "Ctrl-C", "the run is interrupted", **ENDLESS, options=LONG | {"max_wall": 1000.0, "progress": interrupt},
        statuses=(Status.INTERRUPTED,), words="interrupted",
    ),
    asked(
        "broken callback", "the progress callback raises an exception, which the run must raise", end=1e9,
        options=LONG | {"max_wall": 1000.0, "progress": fall_over}, raises=Broken,
    ),
)  # fmt: skip


# --- faults of events: close roots, roots at the ends of a run or a step, after a reset, and infinitely many ---


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


def crossing(name: str, about: str, *events: Any, at: tuple[tuple[float, ...], ...], **more: Any) -> Fault:
    """Return a fault of events along a free motion to x = 1 at t = 3, with the exact times of the events."""
    return Fault(name, about, free, options={"events": [*events]}, truth=moving, events=at, **{"end": 3.0} | more)


NEAR = dict.fromkeys(("close", "fine", "rough"), 1e-6)
"""Errors of times that are known as well with any method."""

HALF = sp.Rational(1, 2)

EVENTS = (
    crossing("three roots", "x^3 - x has three roots within a step", x**3 - x, end=6.0, at=((1.0, 2.0, 3.0),)),
    crossing("close roots", "two roots 1e-3 apart", (x - 1) * (x - 1.001), end=6.0, at=((3.0, 3.001),), **NEAR),
    crossing(
        "close events", "two events 1e-3 apart, the second of which ends the run",
        x - 1, lg.event(x - sp.Rational(1001, 1000), terminal=True), end=6.0, at=((3.0,), (3.001,)),
        statuses=(Status.EVENT,), **NEAR,
    ),
    Fault(
        "nan event", "the event log(1 - x) + 1 is nan beyond x = 1", lambda: particle(0, 0.0, 1.0), end=2.0,
        options={"events": [sp.log(1 - x) + 1]}, events=((1 - math.exp(-1),),),
        statuses=(Status.NON_FINITE,), window=(0.9, 1.1), words="domain|not finite",
    ),
    crossing("event at the start", "the event is zero at the start: no event, and not found again", x + 2, at=((),)),
    crossing("event at the end", "the event is zero at the end", x - 1, at=((3.0,),)),
    crossing("event between steps", "the event is zero where fixed steps end, once", x + 1, step=0.125, at=((1.0,),)),
    crossing(
        "events at once", "two events at one time, one with a direction that is not met",
        x, 3 * x, lg.event(x, direction=-1), at=((2.0,), (2.0,), ()),
    ),
    Fault(
        "event after a reset", "a ball leaves the floor where it hits it, and does not hit it again at once", ball,
        end=2.3, options={"events": [floor(HALF)], "t_eval": [0.5, 1.5, 2.2]}, truth=bouncing, events=((1.0, 2.0),),
    ),
    Fault(
        "bounces without end",
        "a ball comes to rest after infinitely many impacts, at t = 3, and must not fall through the floor", ball,
        end=6.0, step=1e-3, options={"events": [floor(HALF)], "t_eval": [0.5, 1.5, 2.2, 3.5, 5.5]}, truth=bouncing,
        close=5e-9, statuses=(Status.STEP_TOO_SMALL,), window=(2.9, 3.1), words="infinitely many",
    ),
)  # fmt: skip
