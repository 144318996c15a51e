"""Symplectic splittings: coordinates and velocities moved in turn, where the equations of motion allow it.

With a constant mass matrix and accelerations a(q, t) alone, drift (q with v) and kick (v with a) are each solved
exactly, and their composition is symplectic in (q, p = M v).
Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, I.1, II.5 and VI.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from lagrange.errors import StatementError
from lagrange.program.step import StepProgram, trace
from lagrange.trajectory.dense import HermitePath
from lagrange.trajectory.driver import drive
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.settings import fixed_settings
from lagrange.trajectory.plan import StepPlan
from lagrange.trajectory.trajectory import FloatArray, Trajectory


@dataclass(frozen=True)
class Splitting:
    """A composition of kicks and drifts: `stages` are pairs (kick, drift) of fractions of the step, kick first."""

    name: str
    order: int
    stages: tuple[tuple[float, float], ...]
    symmetric: bool
    step: float | None = None

    def __post_init__(self) -> None:
        for what, total in (("kicks", sum(k for k, _ in self.stages)), ("drifts", sum(d for _, d in self.stages))):
            if abs(total - 1) > 1e-14:
                raise StatementError(f"the {what} of {self.name} add up to {total:.17g}: they must add up to one step.")

    @property
    def claims(self) -> Claims:
        """Order, symplecticity, and symmetry in time."""
        return Claims(order=self.order, symplectic=True, symmetric=self.symmetric)

    def plan(self, problem: Problem) -> StepPlan:
        """Return the plan. Raises StatementError where the splitting is not legal."""
        check_splits(self.name, problem)
        tolerances = fixed_settings(self.name, problem, self.step, None, None)
        return StepPlan(splitting_step(self.name, self.stages), tolerances, _path)

    def integrate(self, problem: Problem) -> Trajectory:
        """Run the problem; see `Integrator`."""
        return drive(problem, self.plan(problem), self.name)


def _path(problem: Problem, times: FloatArray, states: FloatArray) -> HermitePath:
    return HermitePath(problem.model.kernel("rhs"), problem.parameter_array, times, states)


def check_splits(name: str, problem: Problem) -> None:
    """Refuse a system whose kinetic energy is not separable or whose forces depend on velocities."""
    structure = problem.model.equations.structure
    if not structure.constant_mass:
        reason = "its mass matrix changes along the motion"
    elif not structure.position_only:
        reason = "its accelerations depend on velocities"
    else:
        return
    raise StatementError(
        f"{name} moves coordinates and velocities in turn, which is not symplectic, and not of its order, for "
        f"{problem.model.statement.name}: {reason}. Use rk4, dopri5 or dop853."
    )


@lru_cache(maxsize=64)
def splitting_step(name: str, stages: tuple[tuple[float, float], ...]) -> StepProgram:
    """Return the step program of a splitting. Time moves with the coordinates."""

    def step(a: Callable[..., Any], t: Any, q: Any, v: Any, h: Any) -> tuple[Any, Any]:
        now = t
        passed = 0.0
        for kick, drift in stages:
            if kick:
                v = v + a(now, q) * (h * kick)
            if drift:
                q = q + v * (h * drift)
                passed += drift
                now = t + h if passed == 1.0 else t + h * passed
        return q, v

    return trace(name, step, partitioned=True)


def SymplecticEuler(step: float | None = None) -> Splitting:
    """Return the symplectic Euler method, order 1: velocities first, then coordinates with the new velocities."""
    return Splitting("symplectic-euler", 1, ((1.0, 1.0),), symmetric=False, step=step)


def Verlet(step: float | None = None) -> Splitting:
    """Return the Stormer-Verlet method in velocity form, order 2: half a kick, a drift, half a kick."""
    return Splitting("verlet", 2, ((0.5, 1.0), (0.5, 0.0)), symmetric=True, step=step)
