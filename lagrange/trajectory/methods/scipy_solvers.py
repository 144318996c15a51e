"""SciPy's solvers as integrators, driven step by step so that none of them can run for ever or end in silence."""

from __future__ import annotations

import threading
import time
import warnings
from abc import ABC
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np
import scipy.integrate
from scipy.integrate import OdeSolver

from lagrange.errors import StatementError
from lagrange.machine.backend import SingularMassMatrix
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.messages import message
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

_ONE_AT_A_TIME = threading.RLock()
"""Held by the implicit solvers: capturing their warnings changes the state of the whole process."""


@dataclass(frozen=True, eq=False)
class _Fault:
    """What went wrong, and at which state."""

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""


class _StopError(Exception):
    """Ends a run from inside SciPy's callbacks."""

    def __init__(self, fault: _Fault) -> None:
        super().__init__(fault.detail)
        self.fault = fault


@dataclass
class _Law:
    """The model's right-hand side as SciPy calls it: counted, timed, and with the last fault remembered."""

    problem: Problem
    parameters: FloatArray
    deadline: float
    evaluations: int = 0
    in_step: int = 0
    fault: _Fault | None = None
    last_fault: _Fault | None = None
    fault_at: int = 0
    raised: Exception | None = None
    last_jacobian: FloatArray | None = None

    def begin_step(self) -> None:
        """Forget the last step's faults and count anew."""
        self.in_step = 0
        self.fault = None

    def rhs(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, (2n,); NaN where the model refuses, so that SciPy shortens its step and tries again."""
        self.evaluations += 1
        self.in_step += 1
        if time.perf_counter() > self.deadline:
            raise _StopError(_Fault(Status.MAX_WALL, t, y.copy()))
        if self.in_step > EVALUATIONS_PER_STEP:
            detail = f"SciPy's solver made {EVALUATIONS_PER_STEP} evaluations inside one step."
            raise _StopError(self.fault or _Fault(Status.DIVERGED, t, y.copy(), detail=detail))
        try:
            slope = self.problem.model.kernel("rhs")(t, y, self.parameters)
        except SingularMassMatrix:
            self._refused(t, y)
            return np.full(y.shape, np.nan)
        except Exception as error:
            self.raised = error
            raise
        if not np.isfinite(slope).all():
            self._remember(_Fault(Status.NON_FINITE, t, y.copy(), slope))
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
            else:
                self._remember(_Fault(Status.NON_FINITE, t, y.copy(), detail="Its derivative there is not finite."))
        if self.last_jacobian is None:
            raise _StopError(self.fault or _Fault(Status.NON_FINITE, t, y.copy()))
        return self.last_jacobian

    def _refused(self, t: float, y: FloatArray) -> None:
        if np.isfinite(y).all():
            self._remember(_Fault(Status.SINGULAR, t, y.copy(), detail=self.problem.model.singular_message(t, y)))
        else:
            self._remember(_Fault(Status.NON_FINITE, t, y.copy()))

    def _remember(self, fault: _Fault) -> None:
        """Keep the fault unless it only follows from the one before: a state that is not finite has a reason."""
        if self.fault is None or np.isfinite(fault.y).all():
            self.fault = self.last_fault = fault
            self.fault_at = self.evaluations

    def recent_fault(self) -> _Fault | None:
        """Return a fault of the last few steps: the reason why a solver got stuck."""
        return self.last_fault if self.evaluations - self.fault_at <= 100 else None


@dataclass(frozen=True, eq=False)
class _Step:
    """One accepted step: its end, and SciPy's interpolant over it."""

    t: float
    y: FloatArray
    path: Callable[[FloatArray], FloatArray]


@dataclass
class _Run:
    """What a run has so far; one append per step, so that an interruption never finds half a step."""

    problem: Problem
    method: str
    began: float
    law: _Law
    steps: list[_Step] = field(default_factory=list)
    rejected: int = 0
    unmoved: int = 0

    @property
    def t(self) -> float:
        return self.steps[-1].t if self.steps else self.problem.t0

    @property
    def y(self) -> FloatArray:
        return self.steps[-1].y if self.steps else self.problem.y0

    def end(self, fault: _Fault, notes: tuple[str, ...]) -> Trajectory:
        """Return the trajectory of the accepted steps."""
        problem = self.problem
        edges = np.array([problem.t0, *(step.t for step in self.steps)])
        path = PiecewisePath(edges, problem.y0, tuple(step.path for step in self.steps))
        if problem.t_eval is None:
            t, y = edges, np.stack([problem.y0, *(step.y for step in self.steps)], axis=1)
        else:
            t = problem.t_eval[np.abs(problem.t_eval - problem.t0) <= abs(self.t - problem.t0)]
            y = path(t)
        text = message(fault.status, problem, fault.t, fault.y, self.method, slope=fault.slope, detail=fault.detail)
        text = " ".join([text, *notes])
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


@dataclass(frozen=True)
class ScipyMethod(ABC):
    """One of SciPy's solvers. `max_step` bounds its steps and `first_step` sets the first, both positive times.

    The implicit solvers take the model's compiled Jacobian, and run one at a time in a process.
    """

    max_step: float = np.inf
    first_step: float | None = None

    name: ClassVar[str]
    claims: ClassVar[Claims]
    solver: ClassVar[Callable[..., OdeSolver]]
    stages: ClassVar[int] = 0

    def __post_init__(self) -> None:
        for option, value in (("max_step", self.max_step), ("first_step", self.first_step)):
            if value is not None and not value > 0:
                raise StatementError(f"{option} = {value} cannot bound a step of {self.name}: give a positive time.")

    def integrate(self, problem: Problem) -> Trajectory:
        """Run the problem; see `Integrator`."""
        tolerances = adaptive_settings(self.name, problem, None, None, None)
        began = time.perf_counter()
        deadline = np.inf if problem.max_wall is None else began + problem.max_wall
        law = _Law(problem, problem.parameter_array, deadline)
        run = _Run(problem, self.name, began, law)
        with np.errstate(all="ignore"), _captured(not self.claims.explicit) as caught:
            try:
                fault = self._steps(run, tolerances)
            except _StopError as stopped:
                fault = stopped.fault
                if fault.status is Status.MAX_WALL:
                    fault = _Fault(Status.MAX_WALL, run.t, run.y)
            except KeyboardInterrupt:
                fault = _Fault(Status.INTERRUPTED, run.t, run.y)
        if fault.status is Status.DIVERGED and caught:
            fault = _Fault(fault.status, fault.t, fault.y, detail=f"SciPy says: {caught[-1].message}")
        return run.end(fault, tolerances.notes)

    def _steps(self, run: _Run, tolerances: Tolerances) -> _Fault:
        """Take steps until the end or a fault; return how it ended."""
        problem, law = run.problem, run.law
        if not np.isfinite(run.y).all():
            return _Fault(Status.NON_FINITE, run.t, run.y)
        law.rhs(run.t, run.y)
        if law.fault or problem.t1 == problem.t0:
            return law.fault or _Fault(Status.SUCCESS, run.t, run.y)
        solver = self._start(run, tolerances)
        reported = run.began
        while solver.status == "running":
            if len(run.steps) + run.rejected >= problem.max_steps:
                return _Fault(Status.MAX_STEPS, run.t, run.y)
            if fault := self._step(solver, run):
                return fault
            if problem.progress and time.perf_counter() - reported > 0.05:
                reported = time.perf_counter()
                problem.progress(run.t)
        return _Fault(Status.SUCCESS, run.t, run.y)

    def _start(self, run: _Run, tolerances: Tolerances) -> OdeSolver:
        problem, span = run.problem, abs(run.problem.t1 - run.problem.t0)
        longest = min(self.max_step, tolerances.longest)
        options: dict[str, Any] = {"rtol": tolerances.rtol, "atol": tolerances.atol, "max_step": longest}
        if not self.claims.explicit:
            options["jac"] = run.law.jacobian
        first = None if self.first_step is None else min(self.first_step, span)
        run.law.begin_step()
        return self.solver(run.law.rhs, problem.t0, problem.y0.copy(), problem.t1, first_step=first, **options)

    def _step(self, solver: OdeSolver, run: _Run) -> _Fault | None:
        """Take one step and keep it if it, its end and its interpolant are sound; else return the fault."""
        law = run.law
        law.begin_step()
        try:
            text = solver.step()
            if self.stages:
                run.rejected += max(0, law.in_step // self.stages - 1)
        except ValueError as error:
            if law.raised:
                raise
            return law.fault or _Fault(Status.DIVERGED, run.t, run.y, detail=f"SciPy says: {error}.")
        if solver.status == "failed":
            small = text == OdeSolver.TOO_SMALL_STEP
            return law.fault or _Fault(Status.STEP_TOO_SMALL if small else Status.DIVERGED, run.t, run.y)
        t, y = float(solver.t), np.array(solver.y, dtype=float)
        if t == run.t:
            # LSODA may begin with some steps that do not move a large time, or go on like that for ever.
            run.unmoved += 1
            stuck = run.unmoved > MOST_UNMOVED
            return law.recent_fault() or (_Fault(Status.STEP_TOO_SMALL, t, y) if stuck else None)
        run.unmoved = 0
        if not np.isfinite(y).all():
            return law.fault or _Fault(Status.NON_FINITE, t, y)
        if law.fault:
            # Some trial of this step left the domain; the step stands if its own end did not.
            law.fault = None
            law.rhs(t, y)
        path = solver.dense_output()
        if not law.fault:
            run.steps.append(_Step(t, y, path))
        return law.fault


@contextmanager
def _captured(wanted: bool) -> Iterator[list[warnings.WarningMessage]]:
    if not wanted:
        yield []
        return
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield caught


@final
@dataclass(frozen=True)
class RK45(ScipyMethod):
    """Dormand-Prince 5(4), SciPy's implementation."""

    name: ClassVar[str] = "scipy-rk45"
    claims: ClassVar[Claims] = Claims(order=5, adaptive=True)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.RK45
    stages: ClassVar[int] = scipy.integrate.RK45.n_stages


@final
@dataclass(frozen=True)
class RK23(ScipyMethod):
    """Bogacki-Shampine 3(2), SciPy's implementation."""

    name: ClassVar[str] = "scipy-rk23"
    claims: ClassVar[Claims] = Claims(order=3, adaptive=True)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.RK23
    stages: ClassVar[int] = scipy.integrate.RK23.n_stages


@final
@dataclass(frozen=True)
class DOP853(ScipyMethod):
    """Hairer's DOP853, SciPy's implementation."""

    name: ClassVar[str] = "scipy-dop853"
    claims: ClassVar[Claims] = Claims(order=8, adaptive=True)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.DOP853
    stages: ClassVar[int] = scipy.integrate.DOP853.n_stages


@final
@dataclass(frozen=True)
class Radau(ScipyMethod):
    """Radau IIA of order 5, implicit: for stiff systems."""

    name: ClassVar[str] = "scipy-radau"
    claims: ClassVar[Claims] = Claims(order=5, adaptive=True, a_stable=True, explicit=False)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.Radau


@final
@dataclass(frozen=True)
class BDF(ScipyMethod):
    """Backward differentiation of variable order, at most 5 (the claim): for stiff systems."""

    name: ClassVar[str] = "scipy-bdf"
    claims: ClassVar[Claims] = Claims(order=5, adaptive=True, explicit=False)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.BDF


@final
@dataclass(frozen=True)
class LSODA(ScipyMethod):
    """Adams of variable order, at most 12 (the claim), or backward differentiation where the system is stiff."""

    name: ClassVar[str] = "scipy-lsoda"
    claims: ClassVar[Claims] = Claims(order=12, adaptive=True, explicit=False)
    solver: ClassVar[Callable[..., OdeSolver]] = scipy.integrate.LSODA
