"""Faults of the motion and of constraints: forces outside their domain, blow-up, singular masses, typed starts."""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.special import lambertw
from sympy import Piecewise, exp, log, sin, sqrt

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

AFTER_HALF: dict[str, Any] = {"truth": cosine, "statuses": NO_NUMBER, "window": (0.48, 0.52)}
"""The end of a run of x'' = -x whose force has no value from t = 0.5 on."""
AT_THE_EDGE: dict[str, Any] = {"end": 5.0, "truth": uniform, "until": 0.9, "statuses": NO_NUMBER}
"""The end of a nearly free run whose force has no value beyond x = 1."""


def double_pole(name: str, about: str, sign: int, towards: int) -> Fault:
    """Return x'' = 6 x^2 / sign, which is infinite at the time `towards`, 1 or -1, run past it."""
    model = partial(on_a_line, x.dot**2 / 2, -2 * sign * x**3, float(sign), 2.0 * sign * towards)
    low, high = sorted((0.9 * towards, 1.4 * towards))
    return Fault(
        name, about, model, end=5.0 * towards, truth=pole(sign, towards), until=0.6 * towards, fine=0.05,
        statuses=(*NO_NUMBER, *GAVE_UP), window=(low, high),
    )  # fmt: skip


MOTIONS = (
    Fault(
        "nan force", "the force is nan after t = 0.5",
        lambda: particle(Piecewise((-x, t < 0.5)), 1.0), until=0.5, words="nan", **AFTER_HALF,
    ),
    Fault(
        "infinite force", "the force is inf after t = 0.5",
        lambda: particle(exp(LATE) - 1 - x, 1.0), until=0.49, words="nan|inf", **AFTER_HALF,
    ),
    Fault(
        "sqrt domain", "the force -sqrt(1 - x)/100 ends at x = 1", lambda: particle(-sqrt(1 - x) / 100, 0.0, 1.0),
        close=2e-2, fine=2e-2, window=(0.95, 1.06), words="domain", **AT_THE_EDGE,
    ),
    Fault(
        "log domain", "the force log(1 - x)/100 ends at x = 1", lambda: particle(log(1 - x) / 100, 0.0, 1.0),
        close=2e-2, fine=2e-2, window=(0.95, 1.1), words="domain", **AT_THE_EDGE,
    ),
    Fault(
        "division", "the force 1/(100 max(0, 1 - x)) divides by zero at x = 1",
        lambda: particle(1 / (100 * sp.Max(0, 1 - x)), 0.0, 1.0),
        close=5e-2, fine=5e-2, window=(0.9, 1.05), words="division|spacing|did not converge", **AT_THE_EDGE,
    ),
    Fault(
        "blow-up", "v' = v^2 is infinite at t = 1", lambda: particle(x.dot**2, 0.0, 1.0),
        end=2.0, truth=hyperbola, until=0.7, statuses=NO_NUMBER, window=(0.9, 1.2),
    ),
    double_pole("double pole", "x'' = 6 x^2 is infinite at t = 1", 1, 1),
    double_pole("double pole, falling", "x'' = -6 x^2 is minus infinite at t = 1", -1, 1),
    double_pole("double pole, backwards", "x'' = 6 x^2 is infinite at t = -1, run from 0 to -5", 1, -1),
    Fault(
        "collision", "two bodies fall into each other: x'' = -1/x^2", lambda: on_a_line(x.dot**2 / 2, -1 / x, 1.0),
        end=3.0, step=1e-3, truth=falling_in, until=1.0, statuses=NO_NUMBER, window=(1.1, 1.2),
    ),
    Fault(
        "exp overflow", "x'' = exp(x) is infinite soon", lambda: particle(exp(x), 1.0, 1.0),
        end=50.0, statuses=NO_NUMBER, window=(0.5, 1.2),
    ),
    Fault(
        "singular on the way", "T = x^2 v^2/2 has no inertia at x = 0, reached at t = 0.5",
        lambda: on_a_line(x**2 * x.dot**2 / 2, 0, 1.0, -1.0),
        step=1e-3, truth=shrinking, until=0.4, statuses=(*NO_NUMBER, Status.SINGULAR), window=(0.45, 0.7),
    ),
    Fault(
        "no inertia", "a spherical pendulum starts at its pole, where the azimuth has no inertia",
        lambda: sphere(0.0, 1.0, 1.0), statuses=(Status.SINGULAR,), window=(0.0, 0.0), words="singular",
    ),
    Fault(
        "gimbal lock", "a spherical pendulum swings through its pole without a turn",
        lambda: sphere(1.0, -0.3, 0.0), end=4.0, truth=through_the_pole, statuses=(Status.SINGULAR, *NO_NUMBER),
    ),
    Fault(
        "short pulse", "a force acts for 0.1 s within 100 s", lambda: particle(PULSE),
        end=100.0, step=5e-3, truth=pushed, close=6e-2, fine=6e-2,
    ),
    Fault(
        "stiff", "van der Pol's oscillator with mu = 1e5, on its slow manifold",
        lambda: particle(MU * (1 - x**2) * x.dot - x, 2.0, 2 / (MU * (1 - 4.0))),
        end=100.0, step=0.1, truth=relaxing, close=1e-4, compared=0.0, statuses=(*NO_NUMBER, *GAVE_UP),
    ),
    Fault(
        "dry friction", "friction brings a body to rest at t = 1", lambda: particle(-sp.sign(x.dot), 0.0, 1.0),
        end=1.5, truth=sliding, close=1e-2, fine=3e-2,
        statuses=(Status.STEP_TOO_SMALL, Status.DIVERGED, *GAVE_UP), window=(0.98, 1.5),
    ),
)  # fmt: skip


# --- faults of constraints and contacts ------------------------------------------------------------------------


z = lg.coordinate("z")

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
    """Return the states of the motion in which the rods stay parallel: T = 3 w^2/2 and V = 3.5 g sin(angle)."""
    if not times.size:
        return np.empty((12, 0))
    result = solve_ivp(
        lambda _, s: [s[1], -9.81 * 3.5 / 3 * math.cos(s[0])],
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
        "typed start", "a start on a rod with eight digits",
        held({"rod": ROD}, {x: 0.84147098, y: -0.54030231}), truth=swing(1.0), close=1e-5,
    ),
    Fault("rod with large units", "1e12 times a rod", held({"rod": 10**12 * ROD}, AT_ONE), truth=swing(1.0)),
    Fault("rod with small units", "1e-12 times a rod", held({"rod": ROD / 10**12}, AT_ONE), truth=swing(1.0)),
    Fault(
        "redundant and allowed", "a rod stated twice, with redundant='allow'",
        held({"rod": ROD, "again": 2 * ROD}, AT_ONE, redundant="allow"), truth=swing(1.0),
    ),
    Fault(
        "long swing", "a rod for ten swings", held({"rod": ROD}, AT_ONE), end=67.0, truth=swing(1.0),
        close=1e-3, fine=0.2, rough=0.3, statuses=GAVE_UP, window=(0.0, 67.0),
    ),
    Fault(
        "driven constraint", "x = sin t as a constraint, in free fall",
        held({"drive": x - sin(t)}, {x.dot: 1.0}), end=2.0, truth=driven,
    ),
    Fault(
        "coordinate that is determined", "z = x y as a constraint, and z without kinetic energy",
        held({"z": z - x * y}, {x.dot: 1.0}, potential=0, coordinates=[x, y, z]),
        truth=lambda times: np.insert(np.insert(free(times), 2, 0 * times, axis=0), 5, 0 * times, axis=0),
    ),
    Fault(
        "drive out of its domain", "x = log(1 - t) as a constraint, past t = 1",
        held({"drive": x - log(1 - t)}, {x.dot: -1.0}), end=2.0, truth=logarithm, compared=0.9, rough=0.5,
        statuses=(*LOST, *GAVE_UP), window=(0.85, 1.1),
    ),
    Fault(
        "change point", "parallelogram linkages through the configuration in which other motions cross theirs",
        parallelograms, end=1.2, truth=parallel, compared=0.71, close=1e-4, fine=0.05, rough=1.0,
        statuses=(*LOST, *GAVE_UP), window=(0.6, 1.0),
    ),
    Fault(
        "arm pulled straight", "two rods of length 1, the end drawn away at speed 1: straight at t = 1",
        held(
            {"upper": ROD, "lower": (x - 1 - t) ** 2 + y**2 - 1},
            {x: 0.5, y: -math.sqrt(0.75), x.dot: 0.5, y.dot: 0.25 / math.sqrt(0.75)},
        ),
        end=2.0, truth=straightened, compared=0.8, rough=0.5, statuses=(*LOST, *GAVE_UP), window=(0.8, 1.1),
    ),
)  # fmt: skip


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
