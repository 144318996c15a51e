"""Solvers of other packages, driven step by step so that none of them can run for ever or end in silence."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from lagrange.errors import StatementError
from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message, small_state
from lagrange.trajectory.methods.settings import adaptive_settings
from lagrange.trajectory.piecewise import PiecewisePath
from lagrange.trajectory.plan import Tolerances
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

EVALUATIONS_PER_STEP = 5_000
"""A step that takes more right-hand sides is taken for an endless loop.

The most measured was 136: DOP853 started with a step 1e6 times too long, before a right-hand side that turns NaN.
"""

MOST_UNMOVED = 20
"""Steps in a row that may leave the time where it is; LSODA begins with two of them at t = 1e9."""


@dataclass(frozen=True, eq=False)
class Fault:
    """What went wrong, and at which state."""

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""


class StopError(Exception):
    """Ends a run from inside a callback."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.detail)
        self.fault = fault


@dataclass
class Law:
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


@dataclass(frozen=True, eq=False)
class Step:
    """One accepted step: its end, and the solver's interpolant over it."""

    t: float
    y: FloatArray
    path: Callable[[FloatArray], FloatArray]


@dataclass
class Run:
    """What a run has so far; one append per step, so that an interruption never finds half a step."""

    problem: Problem
    method: str
    began: float
    law: Law
    steps: list[Step] = field(default_factory=list)
    rejected: int = 0
    unmoved: int = 0

    @property
    def t(self) -> float:
        """The time reached."""
        return self.steps[-1].t if self.steps else self.problem.t0

    @property
    def y(self) -> FloatArray:
        """The state there, (2n,)."""
        return self.steps[-1].y if self.steps else self.problem.y0

    def end(self, fault: Fault, tolerances: Tolerances) -> Trajectory:
        """Return the trajectory of the accepted steps."""
        problem = self.problem
        edges = np.array([problem.t0, *(step.t for step in self.steps)])
        states = np.stack([problem.y0, *(step.y for step in self.steps)], axis=1)
        path = PiecewisePath(edges, problem.y0, tuple(step.path for step in self.steps))
        if problem.t_eval is None:
            t, y = edges, states
        else:
            t = problem.t_eval[np.abs(problem.t_eval - problem.t0) <= abs(self.t - problem.t0)]
            y = path(t)
        text = message(fault.status, problem, fault.t, fault.y, self.method, slope=fault.slope, detail=fault.detail)
        text = " ".join([text, *tolerances.notes, *small_state(fault.status, states, tolerances.atol)])
        wall = time.perf_counter() - self.began
        evaluations = self.law.evaluations
        return Trajectory(
            t=t,
            y=y,
            status=fault.status,
            message=text,
            method=self.method,
            steps=len(self.steps),
            rejected=self.rejected,
            evaluations=evaluations,
            wall=wall,
            span=(float(edges[0]), float(edges[-1])),
            dense=path,
        )


class Stepper(Protocol):
    """A solver of another package, between two of its steps."""

    @property
    def running(self) -> bool:
        """Whether the end is still ahead."""

    @property
    def t(self) -> float:
        """The time reached."""

    @property
    def y(self) -> FloatArray:
        """The state there, (2n,), an array of its own."""

    def advance(self, run: Run) -> Fault | None:
        """Take one step; return why there is none. Counts rejected steps in `run`, where the package tells."""

    def path(self) -> Callable[[FloatArray], FloatArray]:
        """Return the interpolant over the last step, from times (k,) to states (2n, k)."""


def check_bounds(name: str, max_step: float, first_step: float | None) -> None:
    """Refuse bounds of steps that are not positive times."""
    for option, value in (("max_step", max_step), ("first_step", first_step)):
        if value is not None and not value > 0:
            raise StatementError(f"{option} = {value} cannot bound a step of {name}: give a positive time.")


def drive_stepwise(
    problem: Problem,
    name: str,
    package: str,
    start: Callable[[Run, Tolerances], Stepper],
    listening: AbstractContextManager[list[str]],
) -> Trajectory:
    """Run a problem by the solver that `start` makes; see `Integrator.integrate` for what comes back.

    `listening` collects what the package says by other ways than its results; the last of it explains a divergence.
    """
    tolerances = adaptive_settings(name, problem, None, None, None)
    began = time.perf_counter()
    deadline = np.inf if problem.max_wall is None else began + problem.max_wall
    law = Law(problem, package, problem.parameter_array, deadline)
    run = Run(problem, name, began, law)
    with np.errstate(all="ignore"), listening as said:
        try:
            fault = _steps(run, tolerances, start)
        except StopError as stopped:
            fault = stopped.fault
            if fault.status is Status.MAX_WALL:
                fault = Fault(Status.MAX_WALL, run.t, run.y)
        except KeyboardInterrupt:
            fault = Fault(Status.INTERRUPTED, run.t, run.y)
    if fault.status is Status.DIVERGED and said:
        fault = Fault(fault.status, fault.t, fault.y, detail=f"{package} says: {said[-1]}")
    return run.end(fault, tolerances)


def _steps(run: Run, tolerances: Tolerances, start: Callable[[Run, Tolerances], Stepper]) -> Fault:
    """Take steps until the end or a fault; return how it ended."""
    problem, law = run.problem, run.law
    if not np.isfinite(run.y).all():
        return Fault(Status.NON_FINITE, run.t, run.y)
    q, v = np.split(run.y, 2)
    if problem.model.column_without_inertia(run.t, q, v, law.parameters) is not None:
        detail = problem.model.singular_message(run.t, run.y)
        return Fault(Status.SINGULAR, run.t, run.y, detail=detail)
    law.rhs(run.t, run.y)
    if law.fault or problem.t1 == problem.t0:
        return law.fault or Fault(Status.SUCCESS, run.t, run.y)
    law.begin_step()
    solver = start(run, tolerances)
    reported = run.began
    while solver.running:
        if len(run.steps) + run.rejected >= problem.max_steps:
            return Fault(Status.MAX_STEPS, run.t, run.y)
        if fault := _step(solver, run):
            return fault
        if problem.progress and time.perf_counter() - reported > 0.05:
            reported = time.perf_counter()
            problem.progress(run.t)
    return Fault(Status.SUCCESS, run.t, run.y)


def _step(solver: Stepper, run: Run) -> Fault | None:
    """Take one step and keep it if it, its end and its interpolant are sound; else return the fault."""
    law = run.law
    law.begin_step()
    if fault := solver.advance(run):
        return fault
    t, y = solver.t, solver.y
    if t == run.t:
        # LSODA may begin with some steps that do not move a large time, or go on like that for ever.
        run.unmoved += 1
        stuck = run.unmoved > MOST_UNMOVED
        return law.recent_fault() or (Fault(Status.STEP_TOO_SMALL, t, y) if stuck else None)
    run.unmoved = 0
    if not np.isfinite(y).all():
        return law.fault or Fault(Status.NON_FINITE, t, y)
    if law.fault:
        # Some trial of this step left the domain; the step stands if its own end did not.
        law.fault = None
        law.rhs(t, y)
    path = solver.path()
    if not law.fault:
        run.steps.append(Step(t, y, path))
    return law.fault
