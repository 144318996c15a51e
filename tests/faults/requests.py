"""Faults of the request: extreme values, wrong steps and tolerances, limits, interruptions."""

from collections.abc import Callable
from typing import Any

from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import GAVE_UP, Fault
from tests.faults.motions import NO_NUMBER, cosine, particle, x

NOT_OF_A_FIXED_STEP = "takes equal steps and cannot aim at a tolerance"
CHOOSES_ITS_STEPS = "chooses its steps by itself"


def bob() -> Model:
    """Return the model of x'' = -x, released at x = 1."""
    return particle(-x, 1.0)


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


REQUESTS = (
    Fault(
        "negative rtol",
        "rtol = -1e-6",
        bob,
        options={"rtol": -1e-6},
        step=None,
        refusal=("rtol = -1e-06: give", NOT_OF_A_FIXED_STEP),
    ),
    Fault(
        "step 0",
        "step = 0",
        bob,
        options={"step": 0.0},
        step=0.0,
        refusal=(CHOOSES_ITS_STEPS, "step = 0: give a positive"),
    ),
    Fault(
        "wrong setting",
        "a step for an adaptive method, tolerances for one with equal steps",
        bob,
        refusal=(CHOOSES_ITS_STEPS, NOT_OF_A_FIXED_STEP),
        adaptive={"step": 0.1},
        equal={"step": None, "rtol": 1e-6},
    ),
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
    Fault("long step", "step = 1 for a run of 0.01", bob, end=0.01, step=1.0, truth=cosine),
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
        "tiny", "x = 1e-300, whose square no double holds", bob, options={"initial": {x: 1e-300}}, truth=scaled(1e-300)
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
