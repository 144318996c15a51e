"""What a method prepares for a run: its tolerances, and a driver for a model and its parameters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from lagrange.machine.backend import Driver, SingularMassMatrix
from lagrange.machine.driver import DriverState
from lagrange.machine.model import Model
from lagrange.program.actions import LAWS
from lagrange.program.step import StepProgram
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray
from lagrange.trajectory.watch import Watch


@dataclass(frozen=True)
class Tolerances:
    """What a driver is told, and notes for the user.

    That is the relative and absolute tolerance and the longest step, or the size of equal steps. A driver aims at
    `margin` times the tolerances.
    """

    rtol: float = 0.0
    atol: float = 0.0
    step: float = 0.0
    longest: float = math.inf
    margin: float = 1.0
    notes: tuple[str, ...] = ()


Path = Callable[[FloatArray], FloatArray]
"""Dense output: from times (K,) to states (2n, K)."""


class Plan(Protocol):
    """A method made ready for a model."""

    @property
    def tolerances(self) -> Tolerances:
        """What the driver is told."""

    @property
    def form(self) -> str:
        """How a step is computed, in a few words for the status card; nothing where there is no choice."""

    @property
    def watched(self) -> bool:
        """Whether a run by this plan has anything to watch."""

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return a driver for parameters (k,)."""

    def watch(self, problem: Problem, driver: Any) -> Watch | None:
        """Return what watches events and switching surfaces for the plan's driver, or None where there is nothing."""

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: Watch | None) -> Path:
        """Return the dense output from the accepted times (S+1,) and states (S+1, 2n), and what was watched."""

    def failed(self, problem: Problem, state: DriverState) -> FloatArray:
        """Return the state that the step from the last accepted one leads to, with its entries that are not finite."""


@runtime_checkable
class Planned(Protocol):
    """An integrator whose driver can be prepared once for many runs."""

    def plan(self, problem: Problem) -> Plan:
        """Return the plan. Raises StatementError for a setting without a use."""


@dataclass(frozen=True)
class StepPlan:
    """The plan of a method that is a step program."""

    step: StepProgram
    tolerances: Tolerances
    path_of: Callable[[Problem, FloatArray, FloatArray], Path]
    form: str = ""

    @property
    def watched(self) -> bool:
        """Nothing: a step program has no series in which to find roots."""
        return False

    def driver(self, model: Model, parameters: FloatArray) -> Driver:
        """Return the driver of the step around its law."""
        law = LAWS[self.step.law]
        derivative = model.kernel(law.derivative) if self.step.solves else None
        return model.machine.driver(self.step, model.kernel(law.quantity), parameters, derivative)

    def watch(self, problem: Problem, driver: Driver) -> None:
        """Return None: a step program has no series in which to find roots."""

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: Watch | None) -> Path:
        """Return the dense output that the method has; nothing is watched."""
        return self.path_of(problem, times, states)

    def failed(self, problem: Problem, state: DriverState) -> FloatArray:
        """Take the failed step again, by Euler's method if it is implicit; see `Plan`."""
        step, parameters = self.step, problem.parameter_array
        kernel, n = problem.model.kernel("rhs"), len(state.y) // 2
        h = float(state.reals[DriverState.STEP] or 4.0 * state.reals[DriverState.H])

        def f(t: float, y: FloatArray) -> FloatArray:
            slope = kernel(t, np.concatenate([y, np.zeros(n)]) if step.partitioned else y, parameters)
            return slope[n:] if step.partitioned else slope

        with np.errstate(all="ignore"):
            try:
                if step.solves:
                    return np.asarray(state.y + h * kernel(state.t + h, state.y, parameters))
                if step.partitioned:
                    return np.concatenate(step.function(f, state.t, state.y[:n], state.y[n:], h))
                moved = step.function(f, state.t, state.y, h)
            except SingularMassMatrix:
                return state.y
        return np.asarray(moved if step.control is None else moved[0])
