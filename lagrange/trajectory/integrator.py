"""Options of a run (max_steps, default absolute tolerance, memory limit), and the protocol of integrators."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple, Protocol, TypeVar

from numpy.typing import ArrayLike

from lagrange.algorithm.constants import LEAST_FLOOR
from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import ordered
from lagrange.machine.state import DriverState
from lagrange.statement.event import Event
from lagrange.statement.expression import flag, positive_number, real_array, whole_number
from lagrange.trajectory.trajectory import FloatArray, Trajectory

FLOOR_SHARE = 1e-3
"""Default absolute tolerance: RTOL times this fraction of the largest size of an entry of the state in the run. The
tolerance of the entry is this number plus RTOL times its present size. So each entry has its own scale, and the same
motion in other units has the same steps. A fraction of 1 would lose three digits of a comet that comes a thousand times
nearer to the sun. A fraction of 0 would follow entries that have decayed to rounding. For sizes near 1 the default is
an absolute tolerance of 1e-12."""

LEAST_SHARE = 2.0**-52
"""Smallest ratio of the default absolute tolerance of an entry to the entry's largest size: the spacing of doubles."""

LEAST_ATOL = 1e-300
"""Replaces an absolute tolerance of zero, so that a coordinate that is exactly zero has a finite error ratio."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances and step lengths of a driver, and notes for the user.

    `rtol` and `atol` are the relative and absolute tolerance. `step` is the size of fixed steps, and 0 for steps of
    variable size, which `longest` bounds. If `share` is not zero, the absolute tolerance of an entry of the state
    begins with `atol`. Later it is at least `share` times the largest size of the entry so far. A driver multiplies the
    tolerances by `margin`.
    """

    rtol: float = 0.0
    atol: float = 0.0
    share: float = 0.0
    step: float = 0.0
    longest: float = math.inf
    margin: float = 1.0
    notes: tuple[str, ...] = ()

    def begin(self, t0: float, t1: float, y0: FloatArray) -> DriverState:
        """Return the state of a driver at the start of a run from time `t0` and state `y0` (2n,) to `t1`."""
        h = self.step if t1 >= t0 else -self.step
        aim = self.margin
        floor = max(aim * self.atol, LEAST_FLOOR)
        state = DriverState(t0, t1, y0, aim * self.rtol, floor, h, aim * self.share)
        state.reals[DriverState.LONGEST] = self.longest
        return state


MAX_STEPS = 10_000_000
"""Largest number of trial steps of a run, accepted or not. The states of a double pendulum then take 0.4 GB."""


class RunOptions(NamedTuple):
    """The options of `lagrange.integrate`. None means that the method or the system's scene chooses."""

    method: Any = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    t_eval: ArrayLike | None = None
    events: Any = None
    max_steps: int | None = None
    max_wall: float | None = None
    max_memory: float | None = None
    parameters: Mapping[Any, Any] | None = None

    @property
    def step_limit(self) -> int:
        """Largest number of trial steps, by default `MAX_STEPS`. Raises StatementError unless it is at least 1."""
        return MAX_STEPS if self.max_steps is None else whole_number(self.max_steps, "max_steps", 1)

    @property
    def wall_limit(self) -> float | None:
        """Time limit of the run in seconds, or None for no limit. Raises StatementError unless it is positive."""
        remedy = "give a positive number of seconds"
        return None if self.max_wall is None else positive_number(self.max_wall, "max_wall", remedy)

    @property
    def memory_limit(self) -> float | None:
        """Largest number of bytes that the run may store, or None. Raises StatementError unless it is positive."""
        remedy = "give a positive number of bytes"
        return None if self.max_memory is None else positive_number(self.max_memory, "max_memory", remedy)


DEFAULT_OPTIONS = RunOptions()
"""Options in which the user chose nothing."""


@dataclass(frozen=True)
class Claims:
    """The properties that a method claims. Tests check them for every registered method.

    `order` is the order of convergence. `adaptive`: the method controls its step by tolerances. `symplectic`: the map
    of one step is symplectic for systems with a constant mass matrix. Methods that integrate momenta are symplectic for
    all systems without constraints, and methods with multipliers also with constraints on coordinates. `symmetric`: a
    step of -h reverses a step of h. `a_stable`: no decaying mode limits the step. `explicit`: a step solves no
    equations. `energy`: the energy of a conservative system is conserved up to rounding. `events`: the method locates
    events. `dense` is the order of the dense output.
    """

    order: int
    adaptive: bool = False
    symplectic: bool = False
    symmetric: bool = False
    a_stable: bool = False
    explicit: bool = True
    events: bool = False
    energy: bool = False
    dense: int = 0

    def __post_init__(self) -> None:
        for name in ("order", "dense"):
            object.__setattr__(self, name, whole_number(getattr(self, name), name, 0))
        for name in ("adaptive", "symplectic", "symmetric", "a_stable", "explicit", "events", "energy"):
            flag(getattr(self, name), name)


@dataclass(frozen=True, eq=False)
class Problem:
    """One initial value problem: y' = f(t, y) from (t0, y0) to t1, which may be before t0.

    `parameters` has a value for each of the model's parameters. `t_eval` is sorted in the direction of the run and
    within the span, or None for every accepted step. `step`, `rtol` and `atol` are None if the method chooses.
    `max_steps` is the largest number of trial steps, accepted or not, and `max_wall` the time limit in seconds.
    `max_memory` is the largest number of stored bytes, None for a quarter of the machine's memory. `began` is the time
    of the request by `time.perf_counter`. `events` are checked against the model's statement. `progress` is called
    several times during the run with the time that the run has reached. If this problem is a segment of a run, `whole`
    is the problem of the whole run, for messages with its span and limits, and `largest` (2n,) are the largest absolute
    values of the entries in the run so far.
    """

    model: Model
    parameters: Mapping[Any, float]
    t0: float
    t1: float
    y0: FloatArray
    t_eval: FloatArray | None = None
    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    max_steps: int = MAX_STEPS
    max_wall: float | None = None
    max_memory: float | None = None
    events: tuple[Event, ...] = ()
    progress: Callable[[float], None] | None = None
    whole: Problem | None = None
    largest: FloatArray | None = None
    began: float = field(default_factory=time.perf_counter)
    _values: FloatArray | None = field(default=None, init=False, repr=False)

    def __repr__(self) -> str:
        return f"<Problem of {shown(self.model)} from t = {shown(self.t0)} to {shown(self.t1)}>"

    def __post_init__(self) -> None:
        y0 = real_array(self.y0, "y0")
        if y0 is not self.y0:
            object.__setattr__(self, "y0", y0)
        if self.t_eval is not None:
            object.__setattr__(self, "t_eval", real_array(self.t_eval, "t_eval"))

    @property
    def parameter_array(self) -> FloatArray:
        """The parameters' values (k,) in the statement's order, as kernels take them. The array is computed once."""
        values = self._values
        if values is None:
            values = ordered(self.parameters, self.model.statement.parameters)
            object.__setattr__(self, "_values", values)
        return values


def part_of(problem: Problem, t0: float, t1: float, y0: FloatArray, **options: Any) -> Problem:
    """Return the problem from the state `y0` (2n,) at t0 to t1, without output times, events, step size and progress.

    `options` are new values of other fields.
    """
    return replace(problem, t0=t0, t1=t1, y0=y0, t_eval=None, step=None, events=(), progress=None, **options)


def run_by(integrator: Integrator, problem: Problem) -> Trajectory:
    """Return the trajectory of a problem. Raises StatementError if a user's integrator returns something else."""
    trajectory: Any = integrator.integrate(problem)
    if not isinstance(trajectory, Trajectory):
        raise StatementError(
            f"method {integrator.name} returned {shown(trajectory)}: integrate() must return an lg.Trajectory."
        )
    return trajectory


class Integrator(Protocol):
    """Protocol of an object that turns a `Problem` into a `Trajectory`.

    A failure during the run raises no error: the trajectory then has the states up to the failure, with a status and a
    message that names time and coordinate. Raises StatementError for a request that the method does not support.
    """

    @property
    def name(self) -> str:
        """The name under which the method is registered."""

    @property
    def claims(self) -> Claims:
        """The properties that the method claims, such as its order."""

    def integrate(self, problem: Problem) -> Trajectory:
        """Run the problem and return its trajectory."""


def method_repr(method: Integrator, **options: float | None) -> str:
    """Return the repr of a method: its name, order and the options that are set, without coefficients."""
    listed = "".join(f", {name} = {shown(value)}" for name, value in options.items() if value is not None)
    return f"<{method.name}: a method of order {method.claims.order}{listed}>"


MEMORY_DIVISOR = 4
"""The default memory limit of a run is the memory of the machine divided by this. At the end of the run the states are
copied to one array. Derived quantities, such as the energy, need the same amount of memory again."""

ASSUMED_MEMORY = 8 * 2**30
"""Number of bytes of memory that are assumed if the machine does not report it."""


def memory_limit(problem: Problem) -> float:
    """Return the number of bytes that stored states may take: `max_memory`, or a part of the machine's memory."""
    return machine_memory() / MEMORY_DIVISOR if problem.max_memory is None else problem.max_memory


@cache
def machine_memory() -> int:
    """Return the memory of this machine in bytes."""
    names = getattr(os, "sysconf_names", {})  # not available on Windows
    if not {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= names.keys():
        return ASSUMED_MEMORY
    pages = os.sysconf("SC_PHYS_PAGES")
    return pages * os.sysconf("SC_PAGE_SIZE") if pages > 0 else ASSUMED_MEMORY


Maker = TypeVar("Maker", bound=Callable[..., Any])

_ENTERED: dict[str, dict[str, Callable[..., Any]]] = {}


def built_in(name: str) -> Callable[[Maker], Maker]:
    """Return a decorator that makes a function or class a method: `method="name"` calls it without arguments.

    The function or class is public as `lagrange.methods.X` under its own name X. The first line of its docstring is its
    row in the table of methods. The tests check its claims.
    """

    def enter(maker: Maker) -> Maker:
        _ENTERED.setdefault(maker.__module__, {})[name] = maker
        return maker

    return enter


def entered(family: str) -> dict[str, Callable[..., Any]]:
    """Return the constructors of the methods in the module `family`, by method name, in the order of the file."""
    return _ENTERED[family]
