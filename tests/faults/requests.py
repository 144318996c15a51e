"""Faults of the request: values that are NaN or infinite, wrong steps and tolerances, limits, interruptions."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import GAVE_UP, Fault
from tests.faults.motions import NO_NUMBER, cosine, k, particle, x

NOT_OF_A_FIXED_STEP = "takes equal steps and cannot aim at a tolerance"
CHOOSES_ITS_STEPS = "chooses its steps by itself"


def bob() -> Model:
    """Return the model of x'' = -x, released at x = 1."""
    return particle(-x, 1.0)


@cache
def spring() -> Model:
    """Return the model of a spring whose stiffness is a parameter."""
    return lg.System(
        kinetic=x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 1.0}, initial={x: 1.0}, name="spring"
    ).compile()


def scaled(size: float) -> Callable[[FloatArray], FloatArray]:
    """Return the exact motion of x'' = -x, released at x = `size`."""
    return lambda times: size * cosine(times)


def interrupt(now: float) -> None:
    """Raise KeyboardInterrupt, as Ctrl-C does."""
    raise KeyboardInterrupt


class Broken(RuntimeError):
    """Exception of a callback that fails."""


def fall_over(now: float) -> None:
    """Raise an exception from a progress callback."""
    raise Broken(f"no terminal at t = {now}")


LONG: dict[str, Any] = {"max_steps": 10_000_000}


def asked(
    name: str, about: str, refusal: str | tuple[str, str], model: Callable[[], Model] = bob, **more: Any
) -> Fault:
    """Return the fault of a request that must be refused."""
    return Fault(name, about, model, refusal=refusal, **more)


REQUESTS = (
    asked("nan state", "x = nan at the start", "initial value of x is nan", options={"initial": {x: math.nan}}),
    asked("infinite state", "x = inf at the start", "initial value of x is inf", options={"initial": {x: math.inf}}),
    asked("nan parameter", "k = nan", "k.* nan", spring, options={"parameters": {k: math.nan}}),
    asked(
        "wrong length",
        "two initial values for one coordinate",
        "initial value of x",
        options={"initial": {x: [1.0, 2.0]}},
    ),
    asked("unknown coordinate", "a start for a coordinate that is not there", "q", options={"initial": {"q": 1.0}}),
    asked(
        "negative rtol",
        "rtol = -1e-6",
        ("rtol = -1e-06: give", NOT_OF_A_FIXED_STEP),
        options={"rtol": -1e-6},
        step=None,
    ),
    asked("nan rtol", "rtol = nan", ("rtol = nan: give", NOT_OF_A_FIXED_STEP), options={"rtol": math.nan}, step=None),
    asked("step 0", "step = 0", (CHOOSES_ITS_STEPS, "step = 0: give a positive"), options={"step": 0.0}, step=0.0),
    asked("step < 0", "step = -0.1", (CHOOSES_ITS_STEPS, "step = -0.1: give"), options={"step": -0.1}, step=-0.1),
    asked(
        "step nan", "step = nan", (CHOOSES_ITS_STEPS, "step is nan: give"), options={"step": math.nan}, step=math.nan
    ),
    asked(
        "step inf", "step = inf", (CHOOSES_ITS_STEPS, "step is inf: give"), options={"step": math.inf}, step=math.inf
    ),
    asked(
        "wrong setting",
        "a step for an adaptive method, tolerances for one with equal steps",
        (CHOOSES_ITS_STEPS, NOT_OF_A_FIXED_STEP),
        adaptive={"step": 0.1},
        equal={"step": None, "rtol": 1e-6},
    ),
    asked(
        "output beyond the end", "t_eval leads to t = 2 of 1", "outside the time span", options={"t_eval": [0.5, 2.0]}
    ),
    asked("nan output", "t_eval contains nan", "t_eval contains nan", options={"t_eval": [0.5, math.nan]}),
    asked("no steps", "max_steps = 0", "max_steps = 0: give", options={"max_steps": 0}),
    asked("infinite span", "a run to t = inf", "last time is inf", end=math.inf),
    Fault(
        "tolerances 0",
        "rtol = atol = 0",
        bob,
        end=0.1,
        step=None,
        options={"rtol": 0.0, "atol": 0.0},
        truth=cosine,
        close=1e-9,
        refusal=("", NOT_OF_A_FIXED_STEP),
        statuses=(*NO_NUMBER, *GAVE_UP),
    ),
    Fault(
        "long step",
        "step = 1 for a run of 0.01",
        bob,
        end=0.01,
        step=1.0,
        truth=cosine,
    ),
    Fault("no span", "a run from 0 to 0", bob, end=0.0, truth=cosine),
    Fault("backwards", "a run from 0 to -3", bob, end=-3.0, truth=cosine, rough=0.05),
    Fault(
        "huge",
        "x = 1e300, whose square no double holds",
        bob,
        options={"initial": {x: 1e300}},
        truth=scaled(1e300),
        statuses=NO_NUMBER,
        window=(0.0, 1e-300),
    ),
    Fault(
        "large",
        "x = 1e150",
        bob,
        options={"initial": {x: 1e150}},
        truth=scaled(1e150),
        statuses=NO_NUMBER,
        window=(0.0, 1e-300),
    ),
    Fault(
        "tiny",
        "x = 1e-300, whose square no double holds",
        bob,
        options={"initial": {x: 1e-300}},
        truth=scaled(1e-300),
    ),
    Fault(
        "late",
        "at t = 1e16 the spacing of doubles is 2",
        bob,
        start=1e16,
        end=1e16 + 8,
        statuses=(Status.STEP_TOO_SMALL,),
        words="spacing of floating-point times",
        refusal=("", "below the spacing of floating-point times"),
        window=(1e16, 1e16 + 8),
    ),
    Fault(
        "max_steps",
        "max_steps = 10",
        bob,
        end=1000.0,
        options={"max_steps": 10},
        truth=cosine,
        statuses=(Status.MAX_STEPS,),
        words="max_steps = 10 at",
    ),
    Fault(
        "max_wall",
        "max_wall = 0.02 s for 1e9 s",
        bob,
        end=1e9,
        options=LONG | {"max_wall": 0.02},
        truth=cosine,
        compared=1.0,
        statuses=(Status.MAX_WALL,),
        words=r"max_wall = 0\.02 s",
    ),
    Fault(
        "Ctrl-C",
        "the run is interrupted",
        bob,
        end=1e9,
        options=LONG | {"max_wall": 1000.0, "progress": interrupt},
        truth=cosine,
        compared=1.0,
        statuses=(Status.INTERRUPTED,),
        words="interrupted",
    ),
    Fault(
        "broken callback",
        "the progress callback raises an exception, which the run must raise",
        bob,
        end=1e9,
        options=LONG | {"max_wall": 1000.0, "progress": fall_over},
        raises=Broken,
    ),
)
