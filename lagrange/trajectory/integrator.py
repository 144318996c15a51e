"""The protocol of all integrators: those of this package, of SciPy and of users."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.machine.parameters import ordered
from lagrange.statement.event import Event
from lagrange.statement.number import flag, real_array, whole_number
from lagrange.trajectory.options import MAX_STEPS
from lagrange.trajectory.trajectory import FloatArray, Trajectory


@dataclass(frozen=True)
class Claims:
    """The properties that a method claims; tests check them for every registered method.

    `symplectic` holds for systems with a constant mass matrix, for methods of the law of momenta for all systems
    without constraints, and for those with multipliers also with constraints on coordinates. `symmetric`: a step of -h
    undoes a step of h. `energy`: the energy of a conservative system is conserved to round-off. `events`: the method
    locates events. `dense` is the order of the dense output.
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
    """One initial value problem: y' = f(t, y) from (t0, y0) to t1, which may lie before t0.

    `parameters` has a value for each of the model's parameters. `t_eval` is sorted in the direction of the run
    and lies inside the span, or is None for every accepted step. `step`, `rtol` and `atol` are None where the
    user left the choice to the method. `max_steps` is the largest number of tried steps, accepted or not, and
    `max_wall` the time limit in seconds. `max_memory` is the largest number of kept bytes, None for a quarter of the
    machine's memory. `began` is the time of the request by `time.perf_counter`. `events` are checked against the
    model's statement. `progress` is called with the time reached, several times during the run.
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
    began: float = field(default_factory=time.perf_counter)
    _values: FloatArray | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        y0 = real_array(self.y0, "y0")
        if y0 is not self.y0:
            object.__setattr__(self, "y0", y0)
        if self.t_eval is not None:
            object.__setattr__(self, "t_eval", real_array(self.t_eval, "t_eval"))

    @property
    def parameter_array(self) -> FloatArray:
        """The parameters' values (k,) in the statement's order, as kernels take them; computed once."""
        values = self._values
        if values is None:
            values = ordered(self.parameters, self.model.statement.parameters)
            object.__setattr__(self, "_values", values)
        return values


def run_by(integrator: Integrator, problem: Problem) -> Trajectory:
    """Run a problem. Raises StatementError if a method of a user does not return a trajectory."""
    trajectory: Any = integrator.integrate(problem)
    if not isinstance(trajectory, Trajectory):
        raise StatementError(
            f"method {integrator.name} returned {shown(trajectory)}: integrate() must return an lg.Trajectory."
        )
    return trajectory


class Integrator(Protocol):
    """An object that turns a `Problem` into a `Trajectory`.

    A failure during the run raises no error: the trajectory then has the states until the failure, with a status and a
    message that names time and coordinate. Raises StatementError for a request that the method does not support.
    """

    @property
    def name(self) -> str:
        """The registered name."""

    @property
    def claims(self) -> Claims:
        """The claimed properties of the method."""

    def integrate(self, problem: Problem) -> Trajectory:
        """Run the problem and return its trajectory."""


def method_repr(method: Integrator, **options: float | None) -> str:
    """Return the repr of a method: its name, order and the options that were given, not its coefficients."""
    given = "".join(f", {name} = {shown(value)}" for name, value in options.items() if value is not None)
    return f"<{method.name}: a method of order {method.claims.order}{given}>"
