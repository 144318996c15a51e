"""The model's right-hand side as a callback for a solver of another package."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.calls import nothing, one_state
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.sizes import Slopes
from lagrange.trajectory.trajectory import FloatArray, Status


@dataclass(frozen=True, eq=False)
class Fault:
    """The status and time at which a run ends, the state (2n,) for the message, and its derivative if not finite."""

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""


EVALUATIONS_PER_STEP = 5_000
"""A step with more evaluations of the right-hand side counts as an endless loop. The largest measured number is 136:
DOP853 started with a step 1e6 times too long before a right-hand side that is NaN.
"""


class StopError(Exception):
    """Exception raised inside a solver's callback to end the run; it carries the `fault`."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.detail)
        self.fault = fault


class GuardedRhs:
    """The model's right-hand side as a callback: it counts calls, checks the time limit, and records the last fault."""

    def __init__(self, problem: Problem, package: str, parameters: FloatArray, deadline: float) -> None:
        self.problem, self.package = problem, package
        self.parameters, self.deadline = parameters, deadline
        self.evaluations = 0
        self.fault: Fault | None = None
        self.last_fault: Fault | None = None
        self.fault_at = 0
        self.raised: Exception | None = None
        self.last_jacobian: FloatArray | None = None
        self._timed = deadline < math.inf
        self._kernel = problem.model.kernel("rhs")
        try:
            quick = self._kernel.quick(self.parameters)
        except SingularMassMatrix:
            quick = None
        self._quick: Callable[[float, FloatArray], FloatArray | None] = nothing if quick is None else quick.whole
        self._step_began, self._most = 0, EVALUATIONS_PER_STEP

    @property
    def in_step(self) -> int:
        """Number of evaluations of the right-hand side since the step began."""
        return self.evaluations - self._step_began

    def forget(self) -> None:
        """Discard the recorded faults, because a new motion begins, for example after a reset by an event."""
        self.last_fault = None
        self.begin_step()

    def begin_step(self) -> None:
        """Discard the fault of the last step, and restart the count of evaluations in a step."""
        self._step_began = self.evaluations
        self._most = self._step_began + EVALUATIONS_PER_STEP
        self.fault = None

    def rhs(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, (2n,); NaN if the model raises an error, so that the solver tries a shorter step."""
        self.evaluations = count = self.evaluations + 1
        if count > self._most or self._timed:
            self._check_limits(t, y)
        slope = self._quick(t, y)
        return self._slope(t, y) if slope is None else slope

    def _check_limits(self, t: float, y: FloatArray) -> None:
        """Raise StopError if the time limit is reached, or if a step needs too many evaluations."""
        if time.perf_counter() > self.deadline:
            raise StopError(Fault(Status.MAX_WALL, t, y.copy()))
        if self.evaluations > self._most:
            detail = f"{self.package}'s solver made {EVALUATIONS_PER_STEP} evaluations inside one step."
            raise StopError(self.fault or Fault(Status.DIVERGED, t, y.copy(), detail=detail))

    def _slope(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, and record a fault if it is not finite."""
        try:
            slope = self._kernel(t, y, self.parameters)
        except SingularMassMatrix:
            self._refused(t, y)
            return np.full(y.shape, np.nan)
        except Exception as error:
            self.raised = error
            raise
        if not np.isfinite(slope).all():
            self._remember(Fault(Status.NON_FINITE, t, y.copy(), slope))
        return slope

    def counted(self, slopes: Slopes) -> Slopes:
        """Return the function `slopes` with its calls counted. A result that is not finite counts as no fault."""

        def evaluate(t: float, y: FloatArray) -> FloatArray:
            self.evaluations += 1
            return slopes(t, y)

        return evaluate

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        """Return the Jacobian of the right-hand side by the state, (2n, 2n), at (t, y).

        If it is not finite, return the last finite one, so that Newton's method continues.
        """
        try:
            jacobian = one_state(self.problem.model.kernel("jacobian"), self.parameters)(float(t), y)
        except SingularMassMatrix:
            self._refused(t, y)
        except Exception as error:
            self.raised = error
            raise
        else:
            if np.isfinite(jacobian).all():
                self.last_jacobian = jacobian
            elif self.fault is None:
                self._remember(Fault(Status.NON_FINITE, t, y.copy(), detail="Its derivative there is not finite."))
        if self.last_jacobian is None:
            raise StopError(self.fault or Fault(Status.NON_FINITE, t, y.copy()))
        return self.last_jacobian

    def _refused(self, t: float, y: FloatArray) -> None:
        if np.isfinite(y).all():
            detail = self.problem.model.singular_message(t, y, None, self.problem.parameter_array)
            self._remember(Fault(Status.SINGULAR, t, y.copy(), detail=detail))
        else:
            self._remember(Fault(Status.NON_FINITE, t, y.copy()))

    def _remember(self, fault: Fault) -> None:
        """Record a fault, unless its state is not finite and an earlier fault of the step, its cause, is recorded."""
        if self.fault is None or np.isfinite(fault.y).all():
            self.fault = self.last_fault = fault
            self.fault_at = self.evaluations

    def recent_fault(self) -> Fault | None:
        """Return a fault of the last few steps, the probable reason why a solver makes no progress, or None."""
        return self.last_fault if self.evaluations - self.fault_at <= 100 else None
