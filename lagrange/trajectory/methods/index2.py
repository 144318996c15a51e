"""Radau's method of 3 stages on constraints of velocities, with multipliers as unknowns: index 2, adaptive, order 5.

The stages integrate q' = v and p' = f + G^T lambda. Each satisfies psi = 0: the derivatives of holonomic constraints,
and constraints that are stated in velocities. The multipliers have order 3. The error is that of Hairer and Wanner's
embedded formula, damped by an implicit step along the constraints, for which the multipliers at the start are not
needed. Source: E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems by Runge-Kutta
Methods, 1989, theorems 4.4 and 4.6; E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996,
IV.8 and VII.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lagrange.program.step import Control
from lagrange.trajectory.integrator import Claims
from lagrange.trajectory.methods.built_in import built_in
from lagrange.trajectory.methods.implicit import ImplicitMethod, weighted
from lagrange.trajectory.methods.radau import DAMPING, POINTS, RADAU5, continued
from lagrange.trajectory.tableaux.gauss import collocation_tableau

STAGES = 3
A, B, C = collocation_tableau(POINTS[STAGES])


def radau5_index2(g: Callable[..., Any], t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, ...]:
    """Return q and v at t + h after a step from q and v at t, then the error vectors of q and v.

    g(t, q, v, lambda) returns momenta, forces, constraint forces, and the constraints phi and psi = dphi/dt.
    solve(residuals, guess) returns the zero of the residuals. The unknowns are the changes of the velocity and the
    multipliers at the stages.
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
    """Return guesses of the unknowns of the next step: the polynomials through those of the last, extrapolated.

    `old` are the unknowns of the last step, the velocity changes and then the multipliers at the stages. `ratio` is
    the length of the next step divided by that of the last.
    """
    changes, pushes = old[:STAGES], old[STAGES:]
    return [*RADAU5.predict(ratio, *changes), *continued(C, C, ratio, pushes)]


@built_in("radau5-index2")
def Radau5Index2(rtol: float | None = None, atol: float | None = None) -> ImplicitMethod:
    """Return Radau's adaptive method of 3 stages with multipliers as unknowns, order 5, for stiff systems."""
    claims = Claims(2 * STAGES - 1, adaptive=True, a_stable=True, explicit=False)
    control = Control(STAGES + 1, least=0.125, most=8.0, hold=1.2)
    return ImplicitMethod(
        "radau5-index2", claims, radau5_index2, law="constrained", control=control, rtol=rtol, atol=atol
    )
