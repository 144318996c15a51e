"""Runs for the tests of this folder: methods with fixed steps, systems with constraints, events, failing points."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import numpy as np
from sympy import Integer, cos, log, sin, sqrt, tan

from lagrange.equations.euler_lagrange import StateLayout
from lagrange.graph.node import Graph
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.statement.coordinate import coordinates, parameters, t
from lagrange.statement.event import event
from lagrange.trajectory.integrator import Claims, Problem, RunOptions
from lagrange.trajectory.methods.implicit import ImplicitMethod
from lagrange.trajectory.methods.registry import BUILT_IN, find
from lagrange.trajectory.methods.runge_kutta import DOP853, RungeKutta
from lagrange.trajectory.methods.splitting import Splitting
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.plan import Plan, Planned
from lagrange.trajectory.run import trajectory_of
from lagrange.trajectory.trajectory import Trajectory
from tests.models import build

NAMES = tuple(BUILT_IN)
FIXED = tuple(name for name in NAMES if not find(name).claims.adaptive)
ADAPTIVE = tuple(name for name in NAMES if find(name).claims.adaptive)
IMPLICIT = tuple(name for name in NAMES if isinstance(find(name), ImplicitMethod))
"""The methods that solve for their slopes."""
STEPPED = tuple(name for name in NAMES if not isinstance(find(name), Taylor | ImplicitMethod))
"""The methods that are explicit step programs: a series has no tableau, no fixed order, and no fixed steps."""
OUTSIDE = (
    *(f"scipy-{name}" for name in ("rk23", "rk45", "dop853", "radau", "bdf", "lsoda")),
    *(["cvode"] if find_spec("sksundae") else []),
)
"""Solvers of other packages, as far as they are here."""
SPLITTINGS = tuple(name for name in NAMES if isinstance(find(name), Splitting))
EQUAL = tuple(name for name in IMPLICIT if name in FIXED)
"""Implicit methods with fixed steps; of those below, the ones that solve for momenta and for slopes."""
CONTROLLED = tuple(name for name in IMPLICIT if name in ADAPTIVE)


def implicit(name: str) -> ImplicitMethod:
    """Return the implicit method with a name."""
    result = find(name)
    assert isinstance(result, ImplicitMethod)
    return result


CONSTRAINED = tuple(name for name in IMPLICIT if implicit(name).law == "constrained")
"""The methods whose unknowns are multipliers as well."""
MOMENTA = tuple(name for name in EQUAL if implicit(name).law in ("momentum", "constrained"))
SLOPES = tuple(name for name in EQUAL if name not in MOMENTA)
UNCONSTRAINED = tuple(name for name in MOMENTA if name not in CONSTRAINED)
"""The methods of momenta that leave out the forces of constraints."""


def run(model: Model, end: float, method: Any, start: float = 0.0, initial: Any = None, **options: Any) -> Trajectory:
    """Return the trajectory from `start` to `end`."""
    progress = options.pop("progress", None)
    return trajectory_of(model, (start, end), initial, RunOptions(method, **options), progress=progress)[0]


def same(a: Trajectory, b: Trajectory) -> bool:
    """Return True if two runs are equal to the last bit, except for the time that they took."""
    said = [
        (item.status, item.message, item.steps, item.rejected, item.evaluations, item.span, item.form)
        for item in (a, b)
    ]
    return said[0] == said[1] and np.array_equal(a.t, b.t) and np.array_equal(a.y, b.y)


def stepped(name: str, step: float) -> Any:
    """Return a method with fixed steps; an adaptive method loses its step control."""
    method = find(name)
    if isinstance(method, RungeKutta):
        return RungeKutta(replace(method.tableau, error=None), step=step)
    splitting: Any = method
    return replace(splitting, step=step)


def exact(model: Model, end: float, start: float = 0.0, initial: Any = None, **options: Any) -> Trajectory:
    """Return a run by DOP853 with errors near round-off."""
    return run(model, end, DOP853(rtol=3e-14, atol=1e-16), start, initial, **options)


def planned(name: str, problem: Problem) -> Plan:
    """Return the plan that a method prepares for a run."""
    method = find(name)
    assert isinstance(method, Planned)
    return method.plan(problem)


# --- systems with constraints for tests of methods, with their compiled models and exact motions ---------------


x, y, z, a, b, x1, y1, x2, y2 = coordinates("x y z a b x1 y1 x2 y2")
m, g, l, c = parameters("m g l c")
VALUES = {m: 1.3, g: 9.81, l: 0.7, c: 0.15}
SYMPLECTIC = tuple(name for name in CONSTRAINED if find(name).claims.symplectic)
HOLONOMIC = tuple(name for name in CONSTRAINED if implicit(name).holonomic)


# --- systems --------------------------------------------------------------------------------------------------


def pendulum() -> dict[str, Any]:
    """A pendulum in Cartesian coordinates, released at 2 radians."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "constraints": {"rod": x**2 + y**2 - l**2},
        "initial": {x: 0.7 * np.sin(2.0), y: -0.7 * np.cos(2.0)},
    }


def pumped() -> dict[str, Any]:
    """A pendulum whose rod changes its length in time, with friction."""
    length, change = 0.7, 0.2 * 3.0
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2,
        "potential": m * g * y,
        "dissipation": c * (x.dot**2 + y.dot**2) / 2,
        "forces": {x: cos(2 * t)},
        "constraints": {"rod": x**2 + y**2 - (l + sin(3 * t) / 5) ** 2},
        "initial": {
            x: length * np.sin(1.0), y: -length * np.cos(1.0),
            x.dot: change * np.sin(1.0), y.dot: -change * np.cos(1.0),
        },
    }  # fmt: skip


def spherical() -> dict[str, Any]:
    """A spherical pendulum in Cartesian coordinates."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2 + z.dot**2) / 2,
        "potential": m * g * z,
        "constraints": {"rod": x**2 + y**2 + z**2 - l**2},
        "initial": {x: 0.7 * np.sin(1.2), z: -0.7 * np.cos(1.2), y.dot: 1.5},
    }


def double_pendulum() -> dict[str, Any]:
    """Two rods in Cartesian coordinates."""
    state = from_angles(np.array([1.2, -0.5, 0.3, 0.8]))
    symbols = (x1, y1, x2, y2, x1.dot, y1.dot, x2.dot, y2.dot)
    return {
        "kinetic": m * (x1.dot**2 + y1.dot**2 + x2.dot**2 + y2.dot**2) / 2,
        "potential": m * g * (y1 + y2),
        "coordinates": [x1, y1, x2, y2],
        "constraints": {"upper": x1**2 + y1**2 - l**2, "lower": (x2 - x1) ** 2 + (y2 - y1) ** 2 - l**2},
        "initial": dict(zip(symbols, state, strict=True)),
    }


def guided() -> dict[str, Any]:
    """A double pendulum in angles whose tip is held at one height. Its mass matrix depends on the angles."""
    second = float(np.arccos(1.2 / 0.7 - np.cos(0.4)))
    rate = -np.sin(0.4) * 0.9 / np.sin(second)
    return {
        **angles(),
        "constraints": {"guide": l * cos(a) + l * cos(b) - 1.2},
        "initial": {a: 0.4, b: second, a.dot: 0.9, b.dot: float(rate)},
    }


def angles() -> dict[str, Any]:
    """The double pendulum in angles."""
    return {
        "kinetic": m * l**2 * (2 * a.dot**2 + b.dot**2 + 2 * a.dot * b.dot * cos(a - b)) / 2,
        "potential": -m * g * l * (2 * cos(a) + cos(b)),
        "coordinates": [a, b],
        "initial": {a: 1.2, b: -0.5, a.dot: 0.3, b.dot: 0.8},
    }


def rotor() -> dict[str, Any]:
    """A pendulum whose direction is a unit vector (x, y). T does not depend on both rates, so M is singular."""
    return {
        "kinetic": m * l**2 * (x * y.dot - y * x.dot) ** 2 / 2,
        "potential": m * g * l * y,
        "constraints": {"unit": x**2 + y**2 - 1},
        "initial": {x: np.sin(1.1), y: -np.cos(1.1), x.dot: 1.5 * np.cos(1.1), y.dot: 1.5 * np.sin(1.1)},
    }


def sleigh() -> dict[str, Any]:
    """Chaplygin's sleigh on an incline. Its knife edge is a constraint on velocities."""
    return {
        "kinetic": m * (x.dot**2 + y.dot**2) / 2 + m * a.dot**2 / 5,
        "potential": m * g * y / 3 + m * cos(a) / 7,
        "coordinates": [x, y, a],
        "constraints": {"edge": x.dot * sin(a) - y.dot * cos(a)},
        "initial": {a: 0.3, x.dot: np.cos(0.3), y.dot: np.sin(0.3), a.dot: 0.8},
    }


def from_angles(state: FloatArray) -> FloatArray:
    """Return the Cartesian state of a double pendulum from its state in angles."""
    p, q, pv, qv = state
    upper, rate = np.array([np.sin(p), -np.cos(p)]), np.array([np.cos(p), np.sin(p)]) * pv
    lower, other = np.array([np.sin(q), -np.cos(q)]), np.array([np.cos(q), np.sin(q)]) * qv
    return 0.7 * np.concatenate([upper, upper + lower, rate, rate + other])


SYSTEMS = {one.__name__: one for one in (pendulum, pumped, spherical, double_pendulum, guided, rotor)}


@cache
def system(name: str, target: str = "llvm") -> Model:
    stated = sleigh() if name == "sleigh" else SYSTEMS[name]()
    return build(target, parameters=VALUES, **stated) if "dissipation" in stated else build(target, **stated)


def equal(name: str) -> Any:
    """Return an implicit method with fixed steps; an adaptive method loses its error estimate."""
    method = implicit(name)
    if method.control is None:
        return method
    return ImplicitMethod(
        f"{name}-equal", Claims(method.claims.order, explicit=False), without_error(method.function), law=method.law
    )


@cache
def without_error(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: function(*arguments)[:2]


def held(compiled: Model, result: Any) -> tuple[FloatArray, FloatArray]:
    """Return the magnitudes of the constraints on coordinates (phi) and on velocities (psi) along a run."""
    count, n = len(compiled.equations.constraints), compiled.dimension
    both = np.abs(compiled.evaluate("constraints", result.y[:n], result.y[n:], result.t))
    return both[:count], both[count:]


@cache
def truth(name: str, end: float = 1.0) -> FloatArray:
    last: FloatArray = run(system(name), end, Taylor(rtol=1e-15, atol=1e-15)).y[:, -1]
    return last


# --- runs with events or switching surfaces for several tests, with checks that every such run must pass -------


G = 9.81
FALL = math.sqrt(2 / G)
"""How long a fall from 1 takes."""

WITHOUT_VALUE = [
    (log(x), 0.0, "The event function log(x) is -inf there"),
    (sqrt(x - 1), 0.0, "The event function sqrt(x - 1) is nan there"),
    (tan(x + 1), math.pi / 2 - 1, "The event function tan(x + 1) "),
    (1 / (x - 1), 1.0, "The event function 1/(x - 1) "),
    (sqrt(1 - x), 1.0, "The event function sqrt(1 - x) "),
]
"""Events along x = t that have no value from a time on, and how the message begins."""


def checked_run(
    model: Model, end: float, events: Any = None, start: float = 0.0, method: Any = "taylor", **options: Any
) -> Trajectory:
    """Return a run with events and a time limit, after checks that every result must pass."""
    began = time.process_time()
    result = run(model, end, method, start, events=events, **options)
    assert time.process_time() - began < 60.0
    forward = 1.0 if end >= start else -1.0
    assert (forward * np.diff(result.t) >= 0).all() and np.isfinite(result.y).all()
    for times, states in zip(result.t_events, result.y_events, strict=True):
        assert states.shape == (len(times), len(result.y))
        assert (forward * np.diff(times) >= 0).all()
        if len(times):
            # Nothing happens beyond the last accepted step, or before the first.
            assert forward * (times[-1] - result.span[1]) <= 4e-16 * abs(times[-1])
            assert forward * (times[0] - start) >= 0
    return result


@cache
def free(target: str = "llvm", **initial: float) -> Model:
    """Return a unit mass on a line without a force."""
    return build(target, kinetic=x.dot**2 / 2, initial=initial or {"x_dot": 1.0})


@cache
def ball(target: str = "llvm", height: float = 1.0, speed: float = 0.0) -> Model:
    return build(target, kinetic=y.dot**2 / 2, potential=G * y, initial={y: height, y.dot: speed})


def floor(restitution: Any, level: float = 0.0, **options: Any) -> Any:
    return event(y - level, direction=-1, reset={y.dot: -restitution * y.dot}, **options)


@cache
def harmonic(target: str = "llvm") -> Model:
    """Return an oscillator whose motion is x = sin t."""
    return build(target, kinetic=x.dot**2 / 2, potential=x**2 / 2, initial={x.dot: 1.0})


def bounces(restitution: float, count: int) -> Any:
    """Return the times of the impacts of a ball that falls from height 1."""
    flights = 2 * FALL * restitution ** np.arange(1, count)
    return FALL + np.concatenate([[0.0], np.cumsum(flights)])


# --- A point on a line whose acceleration may fail, for tests of solvers of other packages ---------------------


class Called:
    """A function of (t, y, parameters) as a kernel, without quick calls."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, t: float, y: Any, parameters: Any) -> Any:
        return self.function(t, y, parameters)

    def quick(self, parameters: Any) -> None:
        """Return None: there are no quick calls."""


class Point:
    """A fake model: one coordinate x with the acceleration a(t, x, v)."""

    statement = SimpleNamespace(
        names=("x",), parameters=(), lagrangian=Integer(0), dissipation=Integer(0), forces=(), rotations=()
    )
    layout = StateLayout(("x",), ("x",))
    equations = SimpleNamespace(
        structure=SimpleNamespace(brief=False), constraints=(), accelerations=(), graph=Graph(), rates_are_solved=False
    )

    def __init__(self, acceleration: Any) -> None:
        self.acceleration = acceleration

    def kernel(self, name: str) -> Any:
        return Called(self.rhs if name == "rhs" else self.jacobian)

    def parameter_array(self, parameters: Any) -> Any:
        return np.array(list(parameters.values()))

    def rhs(self, t: float, y: Any, parameters: Any = None) -> Any:
        return np.array([y[1], self.acceleration(t, y[0], y[1])])

    def column_without_inertia(self, t: float, q: Any, v: Any, parameters: Any) -> None:
        """Return None: the point has a mass."""

    def jacobian(self, t: float, y: Any, parameters: Any = None) -> Any:
        columns = []
        for j in range(2):
            h = 1e-6 * max(1.0, abs(y[j]))
            e = np.eye(2)[j] * h
            columns.append((self.rhs(t, y + e) - self.rhs(t, y - e)) / (2 * h))
        return np.array(columns).T


def oscillator(t: float, x: float, v: float) -> float:
    return -x


def problem(acceleration: Any, t1: float = 2.0, y0: Any = (1.0, 0.0), **options: Any) -> Any:
    model: Any = Point(acceleration)
    given: dict[str, Any] = {"t0": 0.0, "max_wall": 1000.0, "max_steps": 20_000, "rtol": 1e-8, "atol": 1e-10}
    return Problem(model=model, parameters={}, t1=t1, y0=np.array(y0, dtype=float), **(given | options))


def double_pole(t: float, x: float, v: float) -> float:
    return 6 * x * x


class Singular(Point):
    """A point whose mass matrix is singular for x < 0.5."""

    def rhs(self, t: float, y: Any, parameters: Any = None) -> Any:
        if not y[0] >= 0.5:
            raise SingularMassMatrix
        return super().rhs(t, y)

    def singular_message(self, t: float, y: Any, column: Any, parameters: Any) -> str:
        return f"the mass matrix of the clock is singular at x = {y[0]:.1f}."
