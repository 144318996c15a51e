"""SciPy's solvers as integrators, driven step by step."""

from __future__ import annotations

import threading
import warnings
from abc import ABC
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
import scipy.integrate
from scipy.integrate import OdeSolver

from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.stepwise import Fault, Run, check_bounds, drive_stepwise
from lagrange.trajectory.plan import Tolerances
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

_ONE_AT_A_TIME = threading.RLock()
"""Held by the implicit solvers: capturing their warnings changes the state of the whole process."""


@dataclass(frozen=True, eq=False)
class _Stepper:
    """A solver of SciPy's between two steps; see `Stepper`.

    `stages` are those of one trial step, 0 if not fixed. The solver's time counts from `origin`.
    """

    solver: OdeSolver
    stages: int
    origin: float
    end: float

    @property
    def running(self) -> bool:
        return bool(self.solver.status == "running")

    @property
    def t(self) -> float:
        return self.end if self.solver.status == "finished" else self.origin + float(self.solver.t)

    @property
    def y(self) -> FloatArray:
        return np.array(self.solver.y, dtype=float)

    def advance(self, run: Run) -> Fault | None:
        law = run.law
        try:
            text = self.solver.step()
            if self.stages:
                run.rejected += max(0, law.in_step // self.stages - 1)
        except ValueError as error:
            if law.raised:
                raise
            return law.fault or Fault(Status.DIVERGED, run.t, run.y, detail=f"SciPy says: {error}.")
        if self.solver.status == "failed":
            small = text == OdeSolver.TOO_SMALL_STEP
            return law.fault or Fault(Status.STEP_TOO_SMALL if small else Status.DIVERGED, run.t, run.y)
        return None

    def path(self) -> Callable[[FloatArray], FloatArray]:
        interpolant: Callable[[FloatArray], FloatArray] = self.solver.dense_output()
        return lambda times: interpolant(times - self.origin)


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
    from_zero: ClassVar[bool] = False
    """Whether the solver is told the time since the start, because it loses track of a large one."""

    def __post_init__(self) -> None:
        check_bounds(self.name, self.max_step, self.first_step)

    def integrate(self, problem: Problem) -> Trajectory:
        """Run the problem; see `Integrator`."""
        return drive_stepwise(problem, self.name, "SciPy", self._start, _captured(not self.claims.explicit))

    def _start(self, run: Run, tolerances: Tolerances) -> _Stepper:
        problem, span = run.problem, abs(run.problem.t1 - run.problem.t0)
        longest = min(self.max_step, tolerances.longest)
        options: dict[str, Any] = {"rtol": tolerances.rtol, "atol": tolerances.atol, "max_step": longest}
        law, origin = run.law, problem.t0 if self.from_zero else 0.0
        if not self.claims.explicit:
            options["jac"] = lambda t, y: law.jacobian(origin + t, y)
        first = None if self.first_step is None else min(self.first_step, span)
        begin, end = problem.t0 - origin, problem.t1 - origin
        solver = self.solver(
            lambda t, y: law.rhs(origin + t, y), begin, problem.y0.copy(), end, first_step=first, **options
        )
        return _Stepper(solver, self.stages, origin, problem.t1)


@contextmanager
def _captured(wanted: bool) -> Iterator[list[str]]:
    said: list[str] = []
    if not wanted:
        yield said
        return
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield said
        said += [str(warning.message) for warning in caught]


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
    from_zero: ClassVar[bool] = True
