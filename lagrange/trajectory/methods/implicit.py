"""Implicit methods with fixed steps (Euler, trapezoidal, Gauss, BDF2): step functions that solve for their slopes.

A step function step(f, t, y, h, solve) returns the state at t + h. f(t, y) is the slope of the state y, and
solve(residuals, guess) returns the unknowns for which the function `residuals` is zero.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, sections IV.3, IV.5 and V.1.

The tableaus of collocation methods are computed from their points. Coefficients are exact for exact points; Gauss's
points are computed to many digits. A compiled step gets the coefficients as exact numbers, because a tableau conserves
only as well as they are accurate. Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed.,
2006, II.1.2 and II.1.3.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.program.step import StepProgram, trace
from lagrange.program.step_size_control import Control
from lagrange.statement.expression import flag, one_of, text
from lagrange.trajectory.dense_output import StepPath, hermite_path
from lagrange.trajectory.integrator import Claims, Problem, built_in, method_repr
from lagrange.trajectory.methods.tolerances import (
    adaptive_settings,
    check_holonomic,
    check_options,
    check_unconstrained,
    fixed_settings,
)
from lagrange.trajectory.plan import StepPlan
from lagrange.trajectory.run_loop import drive_by
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True)
class ImplicitMethod:
    """An integrator with an implicit step function, step(f, t, y, h, solve).

    `law` names the function that the step function evaluates. It is "rhs" for the slope f of the state, or "momentum"
    or "constrained" for the functions g of `lagrange.trajectory.methods.variational`, in step(g, t, q, v, h, solve).
    `claims` are the claimed properties. With a `control` of the step size, the step function also returns an error
    vector for each state vector, and the method takes `rtol` and `atol`. Otherwise the method takes fixed steps of size
    `step`.

    With a `starter`, which takes the first step, the step function has a further argument after the state: the state
    one step before. `path` makes the dense output; the default is a Hermite path. The steps of a `holonomic` method end
    on the constraints: their states are not projected, and constraints stated in velocities are refused.
    """

    name: str
    claims: Claims
    function: Callable[..., Any]
    law: str = "rhs"
    control: Control | None = None
    starter: Callable[..., Any] | None = None
    path: Callable[[Problem, FloatArray, FloatArray], StepPath] | None = None
    holonomic: bool = False
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None

    def __repr__(self) -> str:
        return method_repr(self, step=self.step, rtol=self.rtol, atol=self.atol)

    def __post_init__(self) -> None:
        text(self.name, "name")
        if not isinstance(self.claims, Claims):
            raise StatementError(f"the claims of {self.name} are {shown(self.claims)}: give an lg.Claims.")
        one_of(self.law, ("rhs", "momentum", "constrained"), "the law of a method is not {given}: give one of {known}.")
        for what, value in (("function", self.function), ("starter", self.starter), ("path", self.path)):
            if not (callable(value) and isinstance(value, Hashable)) and (value is not None or what == "function"):
                raise StatementError(f"the {what} of {self.name} is {shown(value)}: give a function.")
        if self.control is not None and not isinstance(self.control, Control):
            raise StatementError(
                f"the step control of {self.name} is {shown(self.control)}: give a Control, or None for fixed steps."
            )
        flag(self.holonomic, f"holonomic of {self.name}")
        check_options(self.step, self.rtol, self.atol)
        if self.path is None:
            object.__setattr__(self, "claims", replace(self.claims, dense=max(3, self.claims.order - 1)))

    @property
    def program(self) -> StepProgram:
        """The program that computes one step of the method."""
        return _program(self.name, self.function, self.law, self.control, self.starter)

    def plan(self, problem: Problem) -> StepPlan:
        """Return the plan of a run: the step program, the tolerances or step size, and the dense output."""
        chosen = adaptive_settings if self.control else fixed_settings
        tolerances = chosen(self.name, problem, self.step, self.rtol, self.atol)
        if self.holonomic:
            check_holonomic(self.name, problem.model)
        if self.law == "momentum":
            check_unconstrained(self.name, problem.model)
        path = self.path or hermite_path(self.claims.order)
        return StepPlan(self.program, tolerances, path, projected=not self.holonomic)

    integrate = drive_by


@lru_cache(maxsize=64)
def _program(
    name: str,
    function: Callable[..., Any],
    law: str,
    control: Control | None,
    starter: Callable[..., Any] | None,
) -> StepProgram:
    first = None if starter is None else trace(f"start of {name}", starter, law=law, implicit=True)
    return trace(name, function, law=law, implicit=True, control=control, starter=first)


def trapezoidal(f: Callable[..., Any], t: Any, y: Any, h: Any, solve: Callable[..., Any]) -> Any:
    """Return y at t + h by the mean of the slopes f at both ends of the step. The slope at the end is the unknown.

    `solve(residuals, guess)` returns the unknown for which the function `residuals` is zero.
    """
    first = f(t, y)
    k = solve(lambda k: f(t + h, y + (first + k) * (h / 2)) - k, first)
    return y + (first + k) * (h / 2)


Abscissa = float | Fraction
Tableau = tuple[tuple[tuple[Any, ...], ...], tuple[Any, ...], tuple[Any, ...]]
"""Type of the coefficients of an implicit Runge-Kutta method: the matrix A, the weights b and the abscissae c."""

BITS = 200
"""Number of binary digits to which the points of Gauss's methods and their coefficients A and b are computed."""


def lagrange_basis(points: Sequence[Abscissa]) -> list[list[Any]]:
    """Return the Lagrange polynomials of some points, one for each point: it is 1 there, and 0 at the other points.

    A polynomial is the list of its coefficients, the constant first.
    """
    basis = []
    for point in points:
        line: list[Any] = [1]
        for other in points:
            if other != point:
                shifted = zip([0, *line], [*line, 0], strict=True)
                line = [(high - other * low) / (point - other) for high, low in shifted]
        basis.append(line)
    return basis


def collocation_tableau(points: Sequence[Abscissa]) -> Tableau:
    """Return the tableau A, b, c of collocation at the `points` c of [0, 1].

    A and b are the integrals of the Lagrange polynomials of the points, from 0 to c_i and from 0 to 1.
    """
    basis = lagrange_basis(points)

    def integral(line: Sequence[Any], end: Any) -> Any:
        return sum(factor * end**k / k for k, factor in enumerate(line, 1))

    A = tuple(tuple(integral(line, c) for line in basis) for c in points)
    return A, tuple(integral(line, 1) for line in basis), tuple(points)


def gauss_tableau(stages: int) -> Tableau:
    """Return the tableau A, b, c of Gauss's method: collocation at the zeros of the Legendre polynomial on [0, 1]."""
    zeros = [_zero(x, stages) for x in np.polynomial.legendre.leggauss(stages)[0]]
    A, b, c = collocation_tableau([(1 + x) / 2 for x in zeros])
    return tuple(tuple(map(_rounded, row)) for row in A), tuple(map(_rounded, b)), c


def lobatto_pair(stages: int) -> tuple[Any, ...]:
    """Return A, b, c of the method Lobatto IIIA with 2 or 3 stages, then the matrix A of Lobatto IIIB.

    The two methods are a symplectic pair, with the same b and c. Source: E. Hairer, C. Lubich, G. Wanner, Geometric
    Numerical Integration, 2nd ed., 2006, II.1.4 and VI.4.2.
    """
    A, b, c = collocation_tableau([Fraction(i, stages - 1) for i in range(stages)])
    conjugate = tuple(tuple(bj - bj * A[j][i] / bi for j, bj in enumerate(b)) for i, bi in enumerate(b))
    return A, b, c, conjugate


def _zero(near: float, degree: int) -> Fraction:
    """Return the zero, rounded to 200 bits, of the Legendre polynomial of a `degree` that is nearest to `near`.

    `near` is the zero as a double. Newton's method takes three steps in fractions, each of which doubles the number of
    correct digits.
    """
    x = Fraction(near)
    for _ in range(3):
        before, value = Fraction(1), x
        for n in range(1, degree):
            before, value = value, ((2 * n + 1) * x * value - n * before) / (n + 1)
        x = _rounded(x - value * (x**2 - 1) / (degree * (x * value - before)))
    return x


def _rounded(x: Fraction) -> Fraction:
    return Fraction(round(x * 2**BITS), 2**BITS)


@dataclass(frozen=True)
class Collocation:
    """The step function of an implicit Runge-Kutta method A, b, c, whose unknowns are the slopes of the stages."""

    A: tuple[tuple[Abscissa, ...], ...]
    b: tuple[Abscissa, ...]
    c: tuple[Abscissa, ...]

    def __call__(self, f: Callable[..., Any], t: Any, y: Any, h: Any, solve: Callable[..., Any]) -> Any:
        """Return the state at t + h after a step from y at t. `f(t, y)` returns slopes.

        `solve(residuals, guess)` returns the slopes of the stages for which the function `residuals` is zero.
        """

        def residuals(*slopes: Any) -> tuple[Any, ...]:
            stages = [y + weighted(row, slopes) * h for row in self.A]
            return tuple(f(t + h * ci, stage) - k for ci, stage, k in zip(self.c, stages, slopes, strict=True))

        slopes = solve(residuals, lambda: (f(t, y),) * len(self.b))
        return y + weighted(self.b, slopes) * h


def weighted(weights: Sequence[Abscissa], vectors: Sequence[Any]) -> Any:
    """Return the sum of the vectors, each times the weight with the same index."""
    return sum(vector * weight for weight, vector in zip(weights, vectors, strict=True))


BACKWARD_EULER = Collocation(*collocation_tableau([Fraction(1)]))
MIDPOINT, GAUSS2, GAUSS3 = (Collocation(*gauss_tableau(stages)) for stages in (1, 2, 3))
STARTER = Collocation(*collocation_tableau((Fraction(1, 3), Fraction(1))))
"""Radau's step of 2 stages, order 3, with fixed steps: the first step of methods that use two previous states."""


def bdf2(f: Callable[..., Any], t: Any, y: Any, before: Any, h: Any, solve: Callable[..., Any]) -> Any:
    """Return the state at t + h after a step of the formula BDF2 from y at t and the state `before` at t - h.

    The parabola through the three states has the slope f(t + h, y_new) at its end, which is the unknown.
    `solve(residuals, guess)` returns the unknown for which the function `residuals` is zero.
    """
    base = (y * 4 - before) / 3
    k = solve(lambda k: f(t + h, base + k * (h * Fraction(2, 3))) - k, lambda: f(t, y))
    return base + k * (h * Fraction(2, 3))


@built_in("backward-euler")
def BackwardEuler(step: float | None = None) -> ImplicitMethod:
    """Return the backward Euler method, order 1, which damps fast components."""
    return ImplicitMethod("backward-euler", Claims(1, a_stable=True, explicit=False), BACKWARD_EULER, step=step)


@built_in("trapezoidal")
def Trapezoidal(step: float | None = None) -> ImplicitMethod:
    """Return the trapezoidal rule, order 2."""
    return ImplicitMethod(
        "trapezoidal", Claims(2, symmetric=True, a_stable=True, explicit=False), trapezoidal, step=step
    )


@built_in("implicit-midpoint")
def ImplicitMidpoint(step: float | None = None) -> ImplicitMethod:
    """Return the implicit midpoint rule, order 2."""
    claims = Claims(2, symplectic=True, symmetric=True, a_stable=True, explicit=False)
    return ImplicitMethod("implicit-midpoint", claims, MIDPOINT, step=step)


@built_in("gauss2")
def Gauss2(step: float | None = None) -> ImplicitMethod:
    """Return Gauss's method of 2 stages, order 4."""
    claims = Claims(4, symplectic=True, symmetric=True, a_stable=True, explicit=False)
    return ImplicitMethod("gauss2", claims, GAUSS2, step=step)


@built_in("gauss3")
def Gauss3(step: float | None = None) -> ImplicitMethod:
    """Return Gauss's method of 3 stages, order 6."""
    claims = Claims(6, symplectic=True, symmetric=True, a_stable=True, explicit=False)
    return ImplicitMethod("gauss3", claims, GAUSS3, step=step)


@built_in("bdf2")
def BDF2(step: float | None = None) -> ImplicitMethod:
    """Return the backward differentiation formula of two steps, order 2, for stiff systems; Radau's step starts it."""
    claims = Claims(2, a_stable=True, explicit=False)
    return ImplicitMethod("bdf2", claims, bdf2, starter=STARTER, step=step)
