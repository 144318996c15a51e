"""Radau's methods of 2 and 3 stages, with adaptive steps for stiff systems; one has multipliers as unknowns.

The unknowns are the increments Z_i of the state at the points c_i. Their first guess is the polynomial through the
increments of the last step. This polynomial also gives the dense output. The error is that of an embedded formula with
the slope at the start, damped so that fast components are not overestimated. Source: E. Hairer, G. Wanner, Solving
Ordinary Differential Equations II, 2nd ed., 1996, IV.5 and IV.8, eq. 8.5 to 8.20.

With multipliers (index 2) the stages integrate q' = v and p' = f + G^T lambda. Each satisfies psi = 0: the derivatives
of holonomic constraints, and constraints that are stated in velocities. The multipliers have order 3. The error is that
of the embedded formula, damped by an implicit step along the constraints, for which the multipliers at the start are
not needed. Source: E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by
Runge-Kutta Methods, 1989, theorems 4.4 and 4.6; E. Hairer, G. Wanner, cited above, VII.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.algorithm.dense.collocation import collocation_polynomial
from lagrange.program.step_size_control import Control
from lagrange.trajectory.dense_output import StepPath, step_path
from lagrange.trajectory.integrator import Claims, Problem, built_in
from lagrange.trajectory.methods.implicit import ImplicitMethod, collocation_tableau, lagrange_basis, weighted
from lagrange.trajectory.trajectory import FloatArray

POINTS = {2: (1 / 3, 1.0), 3: ((4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0)}
"""The points c of Radau's methods on [0, 1], by number of stages: the zeros of Radau's polynomials."""

DAMPING = {2: 6**-0.5, 3: 1 / (3 + 3 ** (2 / 3) - 3 ** (1 / 3))}
"""Factor gamma in the damping of the error vector by (I - gamma h J)^-1, with the Jacobian J, by number of stages. It
is 1 / the real eigenvalue of A^-1. For 2 stages both eigenvalues are complex, and gamma is 1 / their size."""


@dataclass(frozen=True)
class RadauStep:
    """The step function of Radau's method with `stages` stages."""

    stages: int

    def __call__(self, f: Callable[..., Any], t: Any, y: Any, h: Any, solve: Any) -> tuple[Any, Any]:
        """Return the state at t + h after a step from y at t, and the error vector of the step.

        `f(t, y)` returns the slopes. `solve(residuals, guess, predict)` returns the unknowns at which the residuals are
        zero: the changes of the state from y to the stages. It begins with `guess` in the first step, later with the
        result of `predict`. `solve.damp(factor, x)` returns (I - factor J)^-1 x, where J is the Jacobian.
        """
        A, _, c = collocation_tableau(POINTS[self.stages])
        gamma = DAMPING[self.stages]

        def residuals(*Z: Any) -> list[Any]:
            slopes = [f(t + h * ci, y + z) for ci, z in zip(c, Z, strict=True)]
            return [weighted(row, slopes) * h - z for row, z in zip(A, Z, strict=True)]

        first = f(t, y)
        Z = solve(residuals, (y * 0,) * self.stages, self.predict)
        error = solve.damp(h * gamma, first * (h * gamma) + weighted(self.embedded(), Z))
        return y + Z[-1], error

    def embedded(self) -> list[float]:
        """Return the weights (stages,) of the stages' increments in the error vector of a step, before its damping."""
        A, _, c = collocation_tableau(POINTS[self.stages])
        # The embedded weights are a quadrature of order s with weight gamma at 0. With hF = A^-1 Z they become weights
        # of Z.
        moments = np.vander(c, increasing=True).T
        weights = np.linalg.solve(
            moments, 1 / np.arange(1, self.stages + 1) - DAMPING[self.stages] * np.eye(self.stages)[0]
        )
        return [float(w) for w in (weights - A[-1]) @ np.linalg.inv(A)]

    def predict(self, ratio: Any, *old: Any) -> tuple[Any, ...]:
        """Return guesses of the next step's increments, one vector for each stage.

        The polynomial through the increments of the last step, `old`, is extrapolated. `ratio` is the length of the
        next step divided by the length of the last.
        """
        _, _, c = collocation_tableau(POINTS[self.stages])
        return tuple(value - old[-1] for value in continued((0.0, *c), c, ratio, (old[0] * 0, *old)))


def continued(points: Sequence[float], next_points: Sequence[float], ratio: Any, old: Sequence[Any]) -> list[Any]:
    """Return the values at `next_points` of the next step of a polynomial that is known on the last step.

    The polynomial has the values `old` at the `points` of the last step. All points are fractions of their own step.
    The next step is `ratio` times as long as the last one.
    """
    basis = [np.poly1d(line[::-1]) for line in lagrange_basis(points)]

    def at(polynomial: Any, ci: float) -> Any:
        value: Any = 0
        for coefficient in polynomial.coeffs:
            value = value * (1 + ratio * ci) + float(coefficient)
        return value

    return [weighted([at(basis_polynomial, ci) for basis_polynomial in basis], old) for ci in next_points]


RADAU3, RADAU5 = RadauStep(2), RadauStep(3)


@dataclass(frozen=True)
class RadauPath:
    """Function that makes the dense output of Radau's method with `stages` stages, of degree and order `stages` + 1."""

    stages: int

    def __call__(self, problem: Problem, times: FloatArray, states: FloatArray) -> StepPath:
        """Return the dense output through accepted times (S+1,) and states (S+1, 2n)."""
        A, _, c = collocation_tableau(POINTS[self.stages])
        return step_path(problem.model, problem.parameter_array, collocation_polynomial(A, c), times, states)


def _method(
    name: str, stages: int, function: Callable[..., Any], rtol: float | None, atol: float | None, law: str = "rhs"
) -> ImplicitMethod:
    path, dense = (RadauPath(stages), stages + 1) if law == "rhs" else (None, 0)
    claims = Claims(2 * stages - 1, adaptive=True, a_stable=True, explicit=False, dense=dense)
    control = Control(stages + 1, least=0.125, most=8.0, hold=1.2)
    return ImplicitMethod(name, claims, function, law=law, control=control, path=path, rtol=rtol, atol=atol)


@built_in("radau3")
def Radau3(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 2 stages, order 3, for stiff systems at loose tolerances."""
    return _method("radau3", 2, RADAU3, rtol, atol)


@built_in("radau5")
def Radau5(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 3 stages, order 5, for stiff systems."""
    return _method("radau5", 3, RADAU5, rtol, atol)


STAGES = 3
"""Number of stages of `radau5_index2`, the method for systems with constraints."""

A, _, C = collocation_tableau(POINTS[STAGES])


def radau5_index2(g: Callable[..., Any], t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, ...]:
    """Return q and v at t + h after a step from q and v at t, then the error vectors of q and v.

    g(t, q, v, lambda) returns five vectors: momenta, forces, constraint forces, and the constraints phi and psi =
    dphi/dt. `solve(residuals, guess)` returns the unknowns for which `residuals` is zero: the changes of the velocity
    and the multipliers at the stages.
    """
    none, gamma = q * 0, DAMPING[STAGES]
    before, *_ = g(t, q, v, none)

    def stages(changes: Any, pushes: Any) -> list[tuple[Any, Any, Any, Any, Any]]:
        speeds = [v + change for change in changes]
        arguments = zip(A, C, speeds, pushes, strict=True)
        return [g(t + h * ci, q + weighted(row, speeds) * h, speed, push) for row, ci, speed, push in arguments]

    def residuals(*unknowns: Any) -> list[Any]:
        results = stages(unknowns[:STAGES], unknowns[STAGES:])
        forces = [f + c for _, f, c, _, _ in results]
        off = [before + weighted(row, forces) * h - p for row, (p, *_) in zip(A, results, strict=True)]
        return [*off, *(psi for *_, psi in results)]

    solution = solve(residuals, (none,) * (2 * STAGES), predict)
    changes, pushes = solution[:STAGES], solution[STAGES:]
    speeds = [v + change for change in changes]
    moves = [weighted(row, speeds) * h for row in A]
    gains = [p - before for p, *_ in stages(changes, pushes)]
    off_place, off_momentum = (weighted(RADAU5.embedded(), increments) for increments in (moves, gains))

    def damped(speed: Any, push: Any) -> tuple[Any, Any]:
        p, f, c, _, psi = g(t, q + off_place + speed * (h * gamma), speed, push)
        return before + off_momentum + (f + c) * (h * gamma) - p, psi

    speed, _ = solve(damped, (v, pushes[0]), lambda _, speed, push: (v, push))
    return q + moves[-1], speeds[-1], off_place + speed * (h * gamma), speed - v


def predict(ratio: Any, *old: Any) -> list[Any]:
    """Return guesses of the unknowns of the next step, by extrapolation of polynomials through the last ones.

    `old` are the velocity changes at the stages of the last step, then the multipliers. `ratio` is the length of the
    next step divided by the length of the last.
    """
    changes, pushes = old[:STAGES], old[STAGES:]
    return [*RADAU5.predict(ratio, *changes), *continued(C, C, ratio, pushes)]


@built_in("radau5-index2")
def Radau5Index2(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 3 stages with multipliers as unknowns, order 5, for stiff systems."""
    return _method("radau5-index2", STAGES, radau5_index2, rtol, atol, "constrained")
