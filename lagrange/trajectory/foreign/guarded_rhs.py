"""The model's right-hand side as a solver of another package calls it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.foreign.fault import Fault
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.sizes import Slopes
from lagrange.trajectory.trajectory import FloatArray, Status

EVALUATIONS_PER_STEP = 5_000
"""A step that takes more right-hand sides is taken for an endless loop.

The most measured was 136: DOP853 started with a step 1e6 times too long, before a right-hand side that turns NaN.
"""


class StopError(Exception):
    """Ends a run from inside a callback."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.detail)
        self.fault = fault


@dataclass
class GuardedRhs:
    """The model's right-hand side as a solver calls it: counted, timed, and with the last fault remembered."""

    problem: Problem
    package: str
    parameters: FloatArray
    deadline: float
    evaluations: int = 0
    in_step: int = 0
    fault: Fault | None = None
    last_fault: Fault | None = None
    fault_at: int = 0
    raised: Exception | None = None
    last_jacobian: FloatArray | None = None

    def forget(self) -> None:
        """Forget what the law said on another motion."""
        self.fault = self.last_fault = None
        self.in_step = 0

    def begin_step(self) -> None:
        """Forget the last step's faults and count anew."""
        self.in_step = 0
        self.fault = None

    def rhs(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, (2n,); NaN where the model refuses, so that the solver shortens its step and tries again."""
        self.evaluations += 1
        self.in_step += 1
        if time.perf_counter() > self.deadline:
            raise StopError(Fault(Status.MAX_WALL, t, y.copy()))
        if self.in_step > EVALUATIONS_PER_STEP:
            detail = f"{self.package}'s solver made {EVALUATIONS_PER_STEP} evaluations inside one step."
            raise StopError(self.fault or Fault(Status.DIVERGED, t, y.copy(), detail=detail))
        try:
            slope = self.problem.model.kernel("rhs")(t, y, self.parameters)
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
        """Return slopes whose evaluations count, and whose faults are none of a step."""

        def evaluate(t: float, y: FloatArray) -> FloatArray:
            self.evaluations += 1
            return slopes(t, y)

        return evaluate

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        """Return d rhs / dy, (2n, 2n); where there is none, the last one, which Newton's iteration can do with."""
        try:
            jacobian = self.problem.model.kernel("jacobian")(t, y, self.parameters)
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
            self._remember(Fault(Status.SINGULAR, t, y.copy(), detail=self.problem.model.singular_message(t, y)))
        else:
            self._remember(Fault(Status.NON_FINITE, t, y.copy()))

    def _remember(self, fault: Fault) -> None:
        """Keep the fault unless it only follows from the one before: a state that is not finite has a reason."""
        if self.fault is None or np.isfinite(fault.y).all():
            self.fault = self.last_fault = fault
            self.fault_at = self.evaluations

    def recent_fault(self) -> Fault | None:
        """Return a fault of the last few steps: the reason why a solver got stuck."""
        return self.last_fault if self.evaluations - self.fault_at <= 100 else None
