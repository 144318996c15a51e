"""Faults of constraints and contacts."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from sympy import log, sin

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import GAVE_UP, Fault
from tests.faults.motions import NO_NUMBER, t
from tests.mechanisms.formulation import parallelogram_acceleration

x, y, z = lg.coordinates("x y z")

LOST = (*NO_NUMBER, Status.SINGULAR)
"""Allowed statuses of a run at a point where its constraints become singular or have no value."""


def held(constraints: Any, initial: Any = None, potential: Any = None, **more: Any) -> Callable[[], Model]:
    """Return a function that compiles a unit mass in a plane under unit gravity, with constraints."""

    @cache
    def made() -> Model:
        stated: dict[str, Any] = {"kinetic": (x.dot**2 + y.dot**2) / 2, "coordinates": [x, y], "name": "held mass"}
        stated |= {"potential": y if potential is None else potential, **more}
        return lg.System(constraints=constraints, initial=initial or {}, **stated).compile()

    return made


def free(times: FloatArray) -> FloatArray:
    """Return the states of a free motion: x = t and y = 0."""
    return np.array([times, 0 * times, np.ones_like(times), 0 * times])


def swing(start: float, mass: float = 1.0) -> Callable[[FloatArray], FloatArray]:
    """Return the exact motion of a pendulum of unit length under unit gravity, released at an angle."""

    def states(times: FloatArray) -> FloatArray:
        if not times.size:
            return np.empty((4, 0))
        result = solve_ivp(
            lambda _, s: [s[1], -np.sin(s[0])], (0, times[-1]), [start, 0], "DOP853", times, rtol=1e-12, atol=1e-13
        )
        angle, turn = result.y
        return np.array([np.sin(angle), -np.cos(angle), turn * np.cos(angle), turn * np.sin(angle)])

    return states


def driven(times: FloatArray) -> FloatArray:
    """Return the states of a motion with x = sin t in free fall."""
    return np.array([np.sin(times), -(times**2) / 2, np.cos(times), -times])


def logarithm(times: FloatArray) -> FloatArray:
    """Return the states of a motion with x = log(1 - t) in free fall. It ends at t = 1."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array([np.log1p(-times), -(times**2) / 2, -1 / (1 - times), -times])


def straightened(times: FloatArray) -> FloatArray:
    """Return the states of the joint between two rods whose outer ends are 1 + t apart. The motion ends at t = 1."""
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.sqrt(1 - (1 + times) ** 2 / 4)
        return np.array([(1 + times) / 2, -depth, 0.5 + 0 * times, (1 + times) / 4 / depth])


@cache
def parallelograms() -> Model:
    """Return the model of two four-bar linkages. Their rods lie in one line for the first time at t = 0.714."""
    return lg.scene("four-bar-ladder").compile()


def parallel(times: FloatArray) -> FloatArray:
    """Return the states of the motion in which the rods stay parallel."""
    if not times.size:
        return np.empty((12, 0))
    result = solve_ivp(
        lambda _, s: [s[1], parallelogram_acceleration(2, s[0])],
        (0, times[-1]),
        [np.pi / 2, -1],
        "DOP853",
        times,
        rtol=1e-12,
        atol=1e-13,
    )
    angle, turn = result.y
    pins = [place for i in range(3) for place in (i + np.cos(angle), np.sin(angle))]
    return np.array([*pins, *[-turn * np.sin(angle), turn * np.cos(angle)] * 3])


ROD = x**2 + y**2 - 1
AT_ONE = {x: math.sin(1.0), y: -math.cos(1.0)}


MOVED: tuple[Fault, ...] = (
    Fault(
        "typed start",
        "a start on a rod with eight digits",
        held({"rod": ROD}, {x: 0.84147098, y: -0.54030231}),
        truth=swing(1.0),
        close=1e-5,
    ),
    Fault("rod with large units", "1e12 times a rod", held({"rod": 10**12 * ROD}, AT_ONE), truth=swing(1.0)),
    Fault("rod with small units", "1e-12 times a rod", held({"rod": ROD / 10**12}, AT_ONE), truth=swing(1.0)),
    Fault(
        "redundant and allowed",
        "a rod stated twice, with redundant='allow'",
        held({"rod": ROD, "again": 2 * ROD}, AT_ONE, redundant="allow"),
        truth=swing(1.0),
    ),
    Fault(
        "long swing",
        "a rod for ten swings",
        held({"rod": ROD}, AT_ONE),
        end=67.0,
        truth=swing(1.0),
        close=1e-3,
        fine=0.2,
        rough=0.3,
        statuses=GAVE_UP,
        window=(0.0, 67.0),
    ),
    Fault(
        "driven constraint",
        "x = sin t as a constraint, in free fall",
        held({"drive": x - sin(t)}, {x.dot: 1.0}),
        end=2.0,
        truth=driven,
    ),
    Fault(
        "coordinate that is determined",
        "z = x y as a constraint, and z without kinetic energy",
        held({"z": z - x * y}, {x.dot: 1.0}, potential=0, coordinates=[x, y, z]),
        truth=lambda times: np.insert(np.insert(free(times), 2, 0 * times, axis=0), 5, 0 * times, axis=0),
    ),
    Fault(
        "drive out of its domain",
        "x = log(1 - t) as a constraint, past t = 1",
        held({"drive": x - log(1 - t)}, {x.dot: -1.0}),
        end=2.0,
        truth=logarithm,
        compared=0.9,
        rough=0.5,
        statuses=(*LOST, *GAVE_UP),
        window=(0.85, 1.1),
    ),
    Fault(
        "change point",
        "parallelogram linkages through the configuration in which other motions cross theirs",
        parallelograms,
        end=1.2,
        truth=parallel,
        compared=0.71,
        close=1e-4,
        fine=0.05,
        rough=1.0,
        statuses=(*LOST, *GAVE_UP),
        window=(0.6, 1.0),
    ),
    Fault(
        "arm pulled straight",
        "two rods of length 1, the end drawn away at speed 1: straight at t = 1",
        held(
            {"upper": ROD, "lower": (x - 1 - t) ** 2 + y**2 - 1},
            {x: 0.5, y: -math.sqrt(0.75), x.dot: 0.5, y.dot: 0.25 / math.sqrt(0.75)},
        ),
        end=2.0,
        truth=straightened,
        compared=0.8,
        rough=0.5,
        statuses=(*LOST, *GAVE_UP),
        window=(0.8, 1.1),
    ),
)


# --- faults of contacts: an impact, and one whose restitution has no meaning -----------------------------------


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
    return np.array([np.where(late, hit / 2 * g - g**2 / 2, 1 - times**2 / 2), np.where(late, hit / 2 - g, -times)])


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
