"""Export a model to SciPy's solvers: functions of (t, y), their Jacobian, and event functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError, listing, shown, suggestion
from lagrange.machine.backend import FloatArray, Kernel, Quick, one_state
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.model import Model
from lagrange.statement.declare import initial_state
from lagrange.statement.event import Event
from lagrange.statement.expression import real_number
from lagrange.statement.given.function import check_span
from lagrange.statement.parameters import label_of, table_of
from lagrange.trajectory.constraints.consistent import consistent_start
from lagrange.trajectory.run import time_span

TAKE_JACOBIAN = ("Radau", "BDF", "LSODA")
"""SciPy's methods that use a Jacobian; the others warn if an argument `jac` is passed."""


Inputs = tuple[tuple[int, Callable[[float], Any]], ...]
"""Inputs of a model as pairs (index among the parameters, function of time)."""


def input_functions(model: Model, table: Any) -> Inputs:
    """Return the user's input functions, each as a pair (index among the parameters, function of time).

    `table` maps inputs, by symbol or name, to functions. Raises StatementError for a missing or unknown input.
    """
    indices = {symbol.name: index for index, symbol in enumerate(model.statement.parameters)}
    names = [symbol.name for symbol, _ in model.statement.inputs]
    functions: dict[str, Callable[[float], Any]] = {}
    for key, value in table_of(table, "inputs", "input to function of t").items():
        name = label_of(key)
        if name not in names:
            have = f"they are {listing(names)}" if names else "it has none"
            raise StatementError(f"{name!r} is not an input of this system; {have}.{suggestion(name, names)}")
        if not callable(value) or isinstance(value, sympy.Basic):
            raise StatementError(
                f"the input {name} is {shown(value)}: give a function of the time, such as lambda t: np.sin(t)."
            )
        _check_arity(name, value)
        functions[name] = value
    missing = [name for name in names if name not in functions]
    if missing:
        raise StatementError(
            f"no function for {'input' if len(missing) == 1 else 'inputs'} {listing(missing)}: give inputs="
            f"{{'{missing[0]}': lambda t: ...}}, a function of the time."
        )
    return tuple((indices[name], functions[name]) for name in names)


def _check_arity(name: str, function: Callable[..., Any]) -> None:
    """Raise StatementError unless the function of the input `name` can be called with one argument, the time."""
    try:
        arguments = signature(function)
    except (TypeError, ValueError):  # C functions have no signature
        return
    try:
        arguments.bind(0.0)
    except TypeError:
        raise StatementError(
            f"the input {name} is a function of ({', '.join(arguments.parameters)}): give a function of the time "
            "alone, such as lambda t: np.sin(t)."
        ) from None


def at_time(parameters: FloatArray, inputs: Inputs, t: float) -> FloatArray:
    """Return the `parameters` (k,) with the values of the inputs at time t filled in.

    `inputs` are pairs of an index among the parameters and a function of time. Raises StatementError for an invalid
    value.
    """
    values = parameters.copy() if inputs else parameters
    for index, function in inputs:
        values[index] = real_number(function(t), f"the input at t = {t:g}")
    return values


class ScipyEvent:
    """An event for SciPy: a function of (t, y) with the attributes `terminal` and `direction` that solve_ivp reads."""

    def __init__(self, model: Model, event: Event, parameters: FloatArray, inputs: Inputs = ()) -> None:
        self._made = model, event, parameters, inputs
        self.terminal, self.direction = event.terminal, float(event.direction)
        node = model.equations.translate(event.expression)
        kernel: Kernel = PythonKernel(model.function("event", (node,)).program)
        self._kernel = kernel
        self._value = one_state(kernel, parameters)

    def __reduce__(self) -> tuple[Any, ...]:
        return ScipyEvent, self._made

    def __call__(self, t: float, y: Any) -> float:
        """Return the value of the event function at time t and state y; its zeros are the events."""
        _, _, parameters, inputs = self._made
        time, state = float(t), np.ascontiguousarray(y, dtype=float)
        if inputs:
            return float(self._kernel(time, state, at_time(parameters, inputs, time))[0])
        return float(self._value(time, state)[0])


@dataclass(frozen=True, eq=False)
class ScipyProblem:
    """The equations of motion of a model with fixed parameters (k,), for scipy.integrate. Instances can be pickled.

    `inputs` are pairs of an index among the parameters and a function of time.
    """

    model: Model
    parameters: FloatArray
    stated_events: tuple[Event, ...] = ()
    inputs: Inputs = ()

    def __post_init__(self) -> None:
        for index, event in enumerate(self.stated_events):
            if event.reset:
                raise StatementError(
                    f"event {index} has a reset, which SciPy's solvers do not know: end there with terminal=True and "
                    "start again from the new state, or call system.run(), which takes resets."
                )

    def __reduce__(self) -> tuple[Any, ...]:
        return ScipyProblem, (self.model, self.parameters, self.stated_events, self.inputs)

    def fun(self, t: float, y: Any) -> FloatArray:
        """Return dy/dt, (2n,), or (2n, k) for columns of states. Raises RunError if a mass matrix is singular."""
        rates = None if self.inputs else self._quick["rhs"].whole(t, y)
        if rates is not None:
            return rates
        return self.model.called(self.model.kernel("rhs"), t, y, at_time(self.parameters, self.inputs, t))

    def jac(self, t: float, y: Any) -> FloatArray:
        """Return the Jacobian of `fun` by y, (2n, 2n). Raises RunError if the mass matrix is singular."""
        jacobian = None if self.inputs else self._quick["jacobian"].whole(t, y)
        return self.model.jacobian(t, y, at_time(self.parameters, self.inputs, t)) if jacobian is None else jacobian

    @cached_property
    def _quick(self) -> Quick:
        return Quick(self.model.kernel, lambda: self.parameters)

    @cached_property
    def events(self) -> list[ScipyEvent]:
        """Event functions of the problem, in the order of the argument `events` of `as_scipy`."""
        return [ScipyEvent(self.model, event, self.parameters, self.inputs) for event in self.stated_events]

    def y0(self, initial: Mapping[Any, Any] | None = None, t: float = 0.0) -> FloatArray:
        """Return an initial state (2n,) at time t: the stated state, with the entries in `initial` replaced.

        If constraints are violated only by rounding, the state is projected onto them. Raises StatementError for a
        larger violation. Velocities of coordinates without inertia are computed if they are zero.
        """
        statement, time = self.model.statement, real_number(t, "the time t")
        state = initial_state({} if initial is None else initial, statement.coordinates, statement.initial)
        return consistent_start(self.model, time, np.array(state), at_time(self.parameters, self.inputs, time))

    def arguments(
        self,
        t_span: Sequence[float],
        initial: Mapping[Any, Any] | None = None,
        *,
        method: str = "RK45",
        **options: Any,
    ) -> dict[str, Any]:
        """Return the arguments of scipy.integrate.solve_ivp; `options` are further arguments, such as rtol and atol.

        `t_span` has the start and end time, and `initial` replaces entries of the stated initial state. The Jacobian is
        included for methods that need it. Raises StatementError for an invalid span or initial state.
        """
        t0, t1 = time_span(t_span)
        check_span(self.model.statement, t0, t1)
        arguments = {"fun": self.fun, "t_span": (t0, t1), "y0": self.y0(initial, t0), "method": method, **options}
        if method in TAKE_JACOBIAN:
            arguments.setdefault("jac", self.jac)
        if self.stated_events:
            arguments["events"] = self.events
        return arguments
