"""A model as SciPy's solvers take it: functions of (t, y), their derivative, and events with attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray, Kernel
from lagrange.machine.calls import Quick, one_state
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.model import Model
from lagrange.statement.declare import initial_state
from lagrange.statement.event import Event
from lagrange.statement.given import check_span
from lagrange.statement.number import real_number
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.integrate import time_span

TAKE_JACOBIAN = ("Radau", "BDF", "LSODA")
"""SciPy's methods that use a derivative; the others warn of one."""


class ScipyEvent:
    """An event as SciPy wants it: a function of (t, y) with `terminal` and `direction`."""

    def __init__(self, model: Model, event: Event, parameters: FloatArray) -> None:
        self._made = model, event, parameters
        self.terminal, self.direction = event.terminal, float(event.direction)
        node = model.equations.translate(event.expression)
        kernel: Kernel = PythonKernel(model.function("event", (node,)).program)
        self._value = one_state(kernel, parameters)

    def __reduce__(self) -> tuple[Any, ...]:
        return ScipyEvent, self._made

    def __call__(self, t: float, y: Any) -> float:
        """Return the value whose zeros are the event."""
        return float(self._value(float(t), np.ascontiguousarray(y, dtype=float))[0])


@dataclass(frozen=True, eq=False)
class ScipyProblem:
    """The equations of motion of a model with fixed parameters (k,), for scipy.integrate; it pickles."""

    model: Model
    parameters: FloatArray
    stated_events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        for place, event in enumerate(self.stated_events):
            if event.reset:
                raise StatementError(
                    f"event {place} has a reset, which SciPy's solvers do not know: end there with terminal=True and "
                    "start again from the new state, or call system.run(), which takes resets."
                )

    def __reduce__(self) -> tuple[Any, ...]:
        return ScipyProblem, (self.model, self.parameters, self.stated_events)

    def fun(self, t: float, y: Any) -> FloatArray:
        """Return dy/dt, (2n,), or (2n, k) for columns of states. Raises RunError where the mass matrix is singular."""
        found = self._quick["rhs"].whole(t, y)
        return self.model.rhs(t, y, self.parameters) if found is None else found

    def jac(self, t: float, y: Any) -> FloatArray:
        """Return the derivative of `fun` by y, (2n, 2n). Raises RunError where the mass matrix is singular."""
        found = self._quick["jacobian"].whole(t, y)
        return self.model.jacobian(t, y, self.parameters) if found is None else found

    @cached_property
    def _quick(self) -> Quick:
        return Quick(self.model.kernel, lambda: self.parameters)

    @cached_property
    def events(self) -> list[ScipyEvent]:
        """The events, in the order in which they were given."""
        return [ScipyEvent(self.model, event, self.parameters) for event in self.stated_events]

    def y0(self, initial: Mapping[Any, Any] | None = None, t: float = 0.0) -> FloatArray:
        """Return an initial state (2n,) at time t: a dict over that of the statement.

        With constraints it is moved onto them where it is off by rounding. Raises StatementError where it is off by
        more.
        """
        statement, time = self.model.statement, real_number(t, "the time t")
        found = initial_state({} if initial is None else initial, statement.coordinates, statement.initial)
        state = np.array(found)
        return consistent_start(self.model, time, state, self.parameters) if statement.constraints else state

    def arguments(
        self,
        t_span: Sequence[float],
        initial: Mapping[Any, Any] | None = None,
        *,
        method: str = "RK45",
        **options: Any,
    ) -> dict[str, Any]:
        """Return the arguments of scipy.integrate.solve_ivp; `options` are those of SciPy, such as rtol and atol.

        The derivative goes to those methods that take one. Raises StatementError as a run does.
        """
        t0, t1 = time_span(t_span)
        check_span(self.model.statement, t0, t1)
        found = {"fun": self.fun, "t_span": (t0, t1), "y0": self.y0(initial, t0), "method": method, **options}
        if method in TAKE_JACOBIAN:
            found.setdefault("jac", self.jac)
        if self.stated_events:
            found["events"] = self.events
        return found
