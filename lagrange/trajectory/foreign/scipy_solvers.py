"""SciPy's solvers (scipy-rk45, scipy-dop853, scipy-lsoda, ...) as integrators, driven step by step."""

from __future__ import annotations

import threading
import warnings
from abc import ABC
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import scipy.integrate
from scipy.integrate import OdeSolver

from lagrange.trajectory.dense_output import StepInterpolant
from lagrange.trajectory.foreign.driver import Fault, GuardedRhs, check_bounds, drive_stepwise
from lagrange.trajectory.integrator import Claims, Problem, Tolerances
from lagrange.trajectory.sizes import slopes_of
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

_ONE_AT_A_TIME = threading.RLock()
"""Lock of the implicit solvers: capturing their warnings changes global state of the process."""


class _ScipyStepper:
    """A SciPy solver between two steps: implements `Stepper`. The solver's time counts from `origin`."""

    def __init__(
        self,
        method: ScipyMethod,
        law: GuardedRhs,
        tolerances: Tolerances,
        floors: FloatArray,
        t: float,
        y: FloatArray,
        first: float,
    ) -> None:
        self.law, self.method, self.end = law, method, law.problem.t1
        self.origin = origin = t if method.from_zero else 0.0
        self.forward = 1.0 if self.end > t else -1.0
        self.rejected = 0
        problem = law.problem
        self.later = method.repeats and not problem.events and problem.t_eval is None
        longest = min(method.max_step, tolerances.longest)
        options: dict[str, Any] = {"rtol": tolerances.rtol, "atol": floors, "max_step": longest}
        if not method.claims.explicit:
            options["jac"] = lambda s, y: law.jacobian(origin + s, y)
        first = min(first, method.first_step or np.inf)
        if first < np.inf:
            options["first_step"] = min(first, abs(self.end - t))
        solver_span = t - origin, self.end - origin
        rhs = law.rhs if origin == 0.0 else lambda s, y: law.rhs(origin + s, y)
        self.t, self.y = t, y
        self.solver = method.solver(rhs, solver_span[0], y.copy(), solver_span[1], **options)

    def advance(self, t: float, y: FloatArray) -> Fault | None:
        law, solver = self.law, self.solver
        self.rejected = 0
        try:
            text = solver.step()
        except ValueError as error:
            if law.raised:
                raise
            return law.fault or Fault(Status.DIVERGED, t, y, detail=f"SciPy says: {error}.")
        if stages := self.method.stages:
            self.rejected = max(0, law.in_step // stages - 1)
        status = solver.status
        if status == "failed":
            small = text == OdeSolver.TOO_SMALL_STEP
            return law.fault or Fault(Status.STEP_TOO_SMALL if small else Status.DIVERGED, t, y)
        reached = self.origin + float(solver.t)
        self.t = reached if status == "running" and self.forward * (self.end - reached) > 0 else self.end
        self.y = solver.y.copy()
        return None

    def interpolant(self, t: float, y: FloatArray) -> partial[StepInterpolant]:
        if self.later:
            return partial(_taken_again, self.method, self.law, (t, self.t), (y, self.y))
        solver, degree = self.solver, self.method.degree
        solver_times = float(solver.t_old), float(solver.t)
        return partial(StepInterpolant.read, (t, self.t), (y, self.y), solver_times, solver.dense_output(), degree)


def _taken_again(
    method: ScipyMethod, law: GuardedRhs, times: tuple[float, float], ends: tuple[FloatArray, FloatArray]
) -> StepInterpolant:
    """Return the path over an accepted step of a one-step method, by repeating the step.

    `law` is the right-hand side. `times` and `ends` are the times and the states (2n,) at both ends of the step. With
    an infinite tolerance the repeated step is accepted and equals the first. Few runs need states between their steps,
    and the solvers' own paths would take a tenth to a third of a run.
    """
    slopes = slopes_of(law.problem.model, law.parameters)
    solver = method.solver(slopes, times[0], ends[0], times[1], atol=np.inf, first_step=abs(times[1] - times[0]))
    solver.step()
    solver_times = times[0], float(solver.t)
    return StepInterpolant.read(times, ends, solver_times, solver.dense_output(), method.degree)


@dataclass(frozen=True)
class ScipyMethod(ABC):
    """One of SciPy's solvers, restarted at resets by events.

    `max_step` bounds the steps and `first_step` is the first step; both are positive times. The implicit solvers use
    the model's compiled Jacobian. In a process only one implicit solver runs at a time.
    """

    max_step: float = np.inf
    first_step: float | None = None

    name: ClassVar[str]
    claims: ClassVar[Claims]
    solver: ClassVar[Callable[..., OdeSolver]]
    degree: ClassVar[int]
    """The highest degree of the polynomials that the solver uses as dense output of its steps."""
    from_zero: ClassVar[bool] = False
    """True if the solver gets the time since its start, because it loses precision at large times."""
    stages: ClassVar[int] = 0
    """Number of evaluations of the right-hand side in one trial step. It is 0 if the number varies."""
    repeats: ClassVar[bool] = False
    """True if a step depends only on the state and the times of its ends, so that its path can be recomputed."""
    first_power: ClassVar[int] = 0
    """Power p of the first step h, whose error grows as h**p. It is 0 if the solver's h does not depend on the time."""

    def __post_init__(self) -> None:
        check_bounds(self.name, self.max_step, self.first_step)

    def integrate(self, problem: Problem) -> Trajectory:
        """Return the trajectory of the problem."""
        start, power = partial(_ScipyStepper, self), self.first_power if self.first_step is None else 0
        # Explicit solvers give no warnings.
        listening: AbstractContextManager[Sequence[Any]] = nullcontext([]) if self.claims.explicit else _captured()
        return drive_stepwise(problem, self.name, "SciPy", start, listening, power)


@contextmanager
def _captured() -> Iterator[list[warnings.WarningMessage]]:
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield caught


class RK45(ScipyMethod):
    """Dormand-Prince 5(4), SciPy's implementation."""

    name, claims = "scipy-rk45", Claims(order=5, adaptive=True, events=True)
    solver, stages, degree = scipy.integrate.RK45, scipy.integrate.RK45.n_stages, 4
    repeats, first_power = True, 5


class RK23(ScipyMethod):
    """Bogacki-Shampine 3(2), SciPy's implementation."""

    name, claims = "scipy-rk23", Claims(order=3, adaptive=True, events=True)
    solver, stages, degree = scipy.integrate.RK23, scipy.integrate.RK23.n_stages, 3
    repeats, first_power = True, 3


class DOP853(ScipyMethod):
    """Hairer's DOP853, SciPy's implementation."""

    name, claims = "scipy-dop853", Claims(order=8, adaptive=True, events=True)
    solver, stages, degree = scipy.integrate.DOP853, scipy.integrate.DOP853.n_stages, 7
    repeats, first_power = True, 8


class Radau(ScipyMethod):
    """Radau IIA of order 5, implicit: for stiff systems."""

    name, claims = "scipy-radau", Claims(order=5, adaptive=True, a_stable=True, explicit=False, events=True)
    solver, degree, first_power = scipy.integrate.Radau, 3, 4


class BDF(ScipyMethod):
    """Backward differentiation of variable order up to 5, for stiff systems."""

    name, claims = "scipy-bdf", Claims(order=5, adaptive=True, explicit=False, events=True)
    solver, degree, first_power = scipy.integrate.BDF, 5, 2


class LSODA(ScipyMethod):
    """Adams of variable order up to 12, or backward differentiation where the system is stiff."""

    name, claims = "scipy-lsoda", Claims(order=12, adaptive=True, explicit=False, events=True)
    solver, degree, from_zero = scipy.integrate.LSODA, 12, True
