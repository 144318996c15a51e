"""Radau's methods of 2 and 3 stages: adaptive steps for stiff systems, of order 3 and 5.

The unknowns are the increments Z_i of the state at the points c_i. They are predicted by the polynomial through those
of the step before, on which the path is built as well. The error is that of an embedded formula with the slope at the
start, damped so that fast parts count for no more than they do.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.5 and IV.8, eq. 8.5 to 8.20.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lagrange.program.step import Control
from lagrange.trajectory.collocation import CollocationPath
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.gauss import collocation_tableau, lagrange_basis
from lagrange.trajectory.methods.implicit import ImplicitMethod, weighted
from lagrange.trajectory.trajectory import FloatArray

POINTS = {2: (1 / 3, 1.0), 3: ((4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0)}
"""The zeros of Radau's polynomials on [0, 1], by the number of stages."""

DAMPING = {2: 6**-0.5, 3: 1 / (3 + 3 ** (2 / 3) - 3 ** (1 / 3))}
"""The factor of h J with which the error is damped: 1 / the real eigenvalue of A^-1, and for 2 stages, where there is
none, 1 / the size of the complex ones."""


def radau(stages: int) -> Callable[..., Any]:
    """Return the step function, with the error vector behind the state."""
    A, _, c = collocation_tableau(POINTS[stages])
    gamma = DAMPING[stages]
    # The embedded weights make a quadrature of order s with the weight gamma at 0; hF = A^-1 Z turns them to Z.
    moments = np.vander(c, increasing=True).T
    embedded = np.linalg.solve(moments, 1 / np.arange(1, stages + 1) - gamma * np.eye(stages)[0])
    weights = [float(w) for w in (embedded - A[-1]) @ np.linalg.inv(A)]
    basis = [np.poly1d(line[::-1]) for line in lagrange_basis((0.0, *c))[1:]]

    def predict(ratio: Any, *old: Any) -> tuple[Any, ...]:
        def at(polynomial: Any, ci: float) -> Any:
            value: Any = 0
            for coefficient in polynomial.coeffs:
                value = value * (1 + ratio * ci) + float(coefficient)
            return value

        return tuple(weighted([at(one, ci) for one in basis], old) - old[-1] for ci in c)

    def step(f: Callable[..., Any], t: Any, y: Any, h: Any, solve: Any) -> tuple[Any, Any]:
        def residuals(*Z: Any) -> list[Any]:
            slopes = [f(t + h * ci, y + z) for ci, z in zip(c, Z, strict=True)]
            return [weighted(row, slopes) * h - z for row, z in zip(A, Z, strict=True)]

        first = f(t, y)
        Z = solve(residuals, (y * 0,) * stages, predict)
        error = solve.damp(h * gamma, first * (h * gamma) + weighted(weights, Z))
        return y + Z[-1], error

    return step


RADAU3, RADAU5 = radau(2), radau(3)


def path(stages: int) -> Callable[[Problem, FloatArray, FloatArray], CollocationPath]:
    """Return what makes the path: a polynomial of degree s + 1 for each step, of order s + 1."""
    A, _, c = collocation_tableau(POINTS[stages])
    basis = [np.poly1d(line[::-1]) for line in lagrange_basis((0.0, *c))[1:]]

    def make(problem: Problem, times: FloatArray, states: FloatArray) -> CollocationPath:
        slope, jacobian = problem.model.kernel("rhs"), problem.model.kernel("jacobian")
        return CollocationPath(slope, problem.parameter_array, times, states, jacobian, A, c, basis)

    return make


PATHS = {stages: path(stages) for stages in POINTS}


def _method(
    name: str, stages: int, function: Callable[..., Any], rtol: float | None, atol: float | None
) -> ImplicitMethod:
    claims = Claims(2 * stages - 1, adaptive=True, a_stable=True, explicit=False, dense=stages + 1)
    control = Control(stages + 1, least=0.125, most=8.0, hold=1.2)
    return ImplicitMethod(name, claims, function, control=control, path=PATHS[stages], rtol=rtol, atol=atol)


def Radau3(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 2 stages, order 3, for stiff systems at loose tolerances."""
    return _method("radau3", 2, RADAU3, rtol, atol)


def Radau5(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 3 stages, order 5, for stiff systems."""
    return _method("radau5", 3, RADAU5, rtol, atol)
