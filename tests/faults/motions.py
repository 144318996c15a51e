"""Faults of the motion: forces outside their domain, blow-up, collisions, singular masses, stiffness, short pulses."""

import math
from functools import cache
from typing import Any

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.special import lambertw
from sympy import Piecewise, exp, log, sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.trajectory import FloatArray, Status
from tests.faults.fault import GAVE_UP, Fault

x, y, theta, phi = lg.coordinates("x y theta phi")
t = lg.t

NO_NUMBER = (Status.NON_FINITE, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""Allowed statuses of a run at the end of the motion, for example at a pole."""

MU = 1e5


@cache
def particle(force: Any = 0, place: float = 0.0, speed: float = 0.0) -> Model:
    """Return the model of a unit mass on a line."""
    return lg.System(
        kinetic=x.dot**2 / 2, forces={x: force}, coordinates=[x], initial={x: place, x.dot: speed}, name="particle"
    ).compile()


@cache
def on_a_line(kinetic: Any, potential: Any, place: float, speed: float = 0.0) -> Model:
    """Return the model of a system with one coordinate and the given energies."""
    return lg.System(
        kinetic=kinetic, potential=potential, coordinates=[x], initial={x: place, x.dot: speed}, name="body on a line"
    ).compile()


@cache
def sphere(start: float, speed: float, turn: float) -> Model:
    """Return the model of a spherical pendulum in angles, which are singular at the poles."""
    return lg.System(
        kinetic=(theta.dot**2 + sp.sin(theta) ** 2 * phi.dot**2) / 2,
        potential=-sp.cos(theta),
        coordinates=[theta, phi],
        initial={theta: start, theta.dot: speed, phi.dot: turn},
        name="spherical pendulum",
    ).compile()


def cosine(times: FloatArray) -> FloatArray:
    """Return the states of x'' = -x, released at x = 1."""
    return np.array([np.cos(times), -np.sin(times)])


def uniform(times: FloatArray) -> FloatArray:
    """Return the states of a free motion from x = 0 with speed 1."""
    return np.array([times, np.ones_like(times)])


def hyperbola(times: FloatArray) -> FloatArray:
    """Return the states of v' = v^2 from x = 0 with speed 1."""
    return np.array([-np.log1p(-times), 1 / (1 - times)])


def pole(sign: float, towards: float) -> Any:
    """Return the exact motion of x'' = 6 x^2 / sign, with a double pole at the time `towards`."""
    return lambda times: sign * np.array([(towards - times) ** -2.0, 2 * (towards - times) ** -3.0])


def pushed(times: FloatArray) -> FloatArray:
    """Return the states of a body on which a force of 10 acts from t = 50 to 50.1."""
    s = np.clip(times - 50, 0.0, 0.1)
    return np.array([5 * s**2 + np.maximum(times - 50.1, 0.0), 10 * s])


def relaxing(times: FloatArray) -> FloatArray:
    """Return the states of van der Pol's oscillator on its slow manifold: ln x - x^2/2 = t/mu + constant.

    The error is of order 1/mu^2.
    """
    level = times / MU + math.log(2) - 2
    place = np.sqrt(-lambertw(-np.exp(2 * level), -1).real)
    return np.array([place, place / (MU * (1 - place**2))])


def falling_in(times: FloatArray) -> FloatArray:
    """Return the states of x'' = -1/x^2, released at x = 1: t = sqrt(1/2) (a + sin a cos a), x = cos(a)^2."""
    a = np.zeros_like(times)
    for _ in range(60):
        a = a + (math.sqrt(2) * times - a - np.sin(a) * np.cos(a)) / (2 * np.maximum(np.cos(a) ** 2, 0.05))
    place = np.cos(a) ** 2
    return np.array([place, -np.sqrt(2 * (1 / place - 1))])


def shrinking(times: FloatArray) -> FloatArray:
    """Return the states for T = x^2 v^2 / 2 from x = 1 with v = -1: x^2 decreases linearly in time."""
    place = np.sqrt(1 - 2 * times)
    return np.array([place, -1 / place])


@cache
def _swing() -> Any:
    result = solve_ivp(
        lambda _, s: [s[1], -math.sin(s[0])],
        (0, 4),
        [1.0, -0.3],
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
        dense_output=True,
    )
    return result.sol


def through_the_pole(times: FloatArray) -> FloatArray:
    """Return the states of a spherical pendulum that swings in a plane through its pole."""
    swing = _swing()(times)
    nothing = np.zeros_like(times)
    return np.array([swing[0], nothing, swing[1], nothing])


def sliding(times: FloatArray) -> FloatArray:
    """Return the states of a body that dry friction stops at t = 1."""
    s = np.minimum(times, 1.0)
    return np.array([s - s**2 / 2, 1 - s])


LATE = Piecewise((0, t < 0.5), (2000, True))
PULSE = Piecewise((10, (t > 50) & (t < 50.1)), (0, True))

MOTIONS = (
    Fault(
        "nan force",
        "the force is nan after t = 0.5",
        lambda: particle(Piecewise((-x, t < 0.5)), 1.0),
        truth=cosine,
        until=0.5,
        statuses=NO_NUMBER,
        window=(0.48, 0.52),
        words="nan",
    ),
    Fault(
        "infinite force",
        "the force is inf after t = 0.5",
        lambda: particle(exp(LATE) - 1 - x, 1.0),
        truth=cosine,
        until=0.49,
        statuses=NO_NUMBER,
        window=(0.48, 0.52),
        words="nan|inf",
    ),
    Fault(
        "sqrt domain",
        "the force -sqrt(1 - x)/100 ends at x = 1",
        lambda: particle(-sqrt(1 - x) / 100, 0.0, 1.0),
        end=5.0,
        truth=uniform,
        until=0.9,
        close=2e-2,
        fine=2e-2,
        statuses=NO_NUMBER,
        window=(0.95, 1.06),
        words="domain",
    ),
    Fault(
        "log domain",
        "the force log(1 - x)/100 ends at x = 1",
        lambda: particle(log(1 - x) / 100, 0.0, 1.0),
        end=5.0,
        truth=uniform,
        until=0.9,
        close=2e-2,
        fine=2e-2,
        statuses=NO_NUMBER,
        window=(0.95, 1.1),
        words="domain",
    ),
    Fault(
        "division",
        "the force 1/(100 max(0, 1 - x)) divides by zero at x = 1",
        lambda: particle(1 / (100 * sp.Max(0, 1 - x)), 0.0, 1.0),
        end=5.0,
        truth=uniform,
        until=0.9,
        close=5e-2,
        fine=5e-2,
        statuses=NO_NUMBER,
        window=(0.9, 1.05),
        words="division|spacing|did not converge",
    ),
    Fault(
        "blow-up",
        "v' = v^2 is infinite at t = 1",
        lambda: particle(x.dot**2, 0.0, 1.0),
        end=2.0,
        truth=hyperbola,
        until=0.7,
        statuses=NO_NUMBER,
        window=(0.9, 1.2),
    ),
    Fault(
        "double pole",
        "x'' = 6 x^2 is infinite at t = 1",
        lambda: on_a_line(x.dot**2 / 2, -2 * x**3, 1.0, 2.0),
        end=5.0,
        truth=pole(1, 1),
        until=0.6,
        fine=0.05,
        statuses=(*NO_NUMBER, *GAVE_UP),
        window=(0.9, 1.4),
    ),
    Fault(
        "double pole, falling",
        "x'' = -6 x^2 is minus infinite at t = 1",
        lambda: on_a_line(x.dot**2 / 2, 2 * x**3, -1.0, -2.0),
        end=5.0,
        truth=pole(-1, 1),
        until=0.6,
        fine=0.05,
        statuses=(*NO_NUMBER, *GAVE_UP),
        window=(0.9, 1.4),
    ),
    Fault(
        "double pole, backwards",
        "x'' = 6 x^2 is infinite at t = -1, run from 0 to -5",
        lambda: on_a_line(x.dot**2 / 2, -2 * x**3, 1.0, -2.0),
        end=-5.0,
        truth=pole(1, -1),
        until=-0.6,
        fine=0.05,
        statuses=(*NO_NUMBER, *GAVE_UP),
        window=(-1.4, -0.9),
    ),
    Fault(
        "collision",
        "two bodies fall into each other: x'' = -1/x^2",
        lambda: on_a_line(x.dot**2 / 2, -1 / x, 1.0),
        end=3.0,
        step=1e-3,
        truth=falling_in,
        until=1.0,
        statuses=NO_NUMBER,
        window=(1.1, 1.2),
    ),
    Fault(
        "exp overflow",
        "x'' = exp(x) is infinite soon",
        lambda: particle(exp(x), 1.0, 1.0),
        end=50.0,
        statuses=NO_NUMBER,
        window=(0.5, 1.2),
    ),
    Fault(
        "singular on the way",
        "T = x^2 v^2/2 has no inertia at x = 0, reached at t = 0.5",
        lambda: on_a_line(x**2 * x.dot**2 / 2, 0, 1.0, -1.0),
        step=1e-3,
        truth=shrinking,
        until=0.4,
        statuses=(*NO_NUMBER, Status.SINGULAR),
        window=(0.45, 0.7),
    ),
    Fault(
        "no inertia",
        "a spherical pendulum starts at its pole, where the azimuth has no inertia",
        lambda: sphere(0.0, 1.0, 1.0),
        statuses=(Status.SINGULAR,),
        window=(0.0, 0.0),
        words="singular",
    ),
    Fault(
        "gimbal lock",
        "a spherical pendulum swings through its pole without a turn",
        lambda: sphere(1.0, -0.3, 0.0),
        end=4.0,
        truth=through_the_pole,
        statuses=(Status.SINGULAR, *NO_NUMBER),
    ),
    Fault(
        "short pulse",
        "a force acts for 0.1 s within 100 s",
        lambda: particle(PULSE),
        end=100.0,
        step=5e-3,
        truth=pushed,
        close=6e-2,
        fine=6e-2,
    ),
    Fault(
        "stiff",
        "van der Pol's oscillator with mu = 1e5, on its slow manifold",
        lambda: particle(MU * (1 - x**2) * x.dot - x, 2.0, 2 / (MU * (1 - 4.0))),
        end=100.0,
        step=0.1,
        truth=relaxing,
        close=1e-4,
        compared=0.0,
        statuses=(*NO_NUMBER, *GAVE_UP),
    ),
    Fault(
        "dry friction",
        "friction brings a body to rest at t = 1",
        lambda: particle(-sp.sign(x.dot), 0.0, 1.0),
        end=1.5,
        truth=sliding,
        close=1e-2,
        fine=3e-2,
        statuses=(Status.STEP_TOO_SMALL, Status.DIVERGED, *GAVE_UP),
        window=(0.98, 1.5),
    ),
)
