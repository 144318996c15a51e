"""Laws of motion and steps in multiple precision: a step function is called with mpmath's numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mpmath
import numpy as np

from lagrange.program.step import StepProgram

Rhs = Callable[[Any, Any], Any]
"""y' of y = [q, v]."""

DIGITS = 60

TURNS = 40
"""Corrections of Newton's method, at most; it takes 4 to 8."""


@dataclass(frozen=True, eq=False)
class Law:
    """A system y' = rhs(t, y) with y = [q, v], and an initial state.

    `momentum(t, q, v)` returns p and f with dp/dt = f, and `mass(q)` returns M.
    """

    rhs: Rhs
    momentum: Callable[..., Any]
    mass: Callable[[Any], Any]
    places: tuple[str, ...]

    @property
    def start(self) -> Any:
        """The initial state, which has no symmetry."""
        return array(map(mpmath.mpf, self.places))

    @property
    def canonical(self) -> Law:
        """The law whose state is [q, p]."""
        return replace(self, rhs=self.hamilton)

    def hamilton(self, t: Any, y: Any) -> Any:
        q, p = np.split(y, 2)
        v = self.velocities(q, p)
        return np.concatenate([v, self.momentum(t, q, v)[1]])

    def constrained(self, t: Any, q: Any, v: Any, multipliers: Any) -> Any:
        """Return the law for methods with multipliers.

        The system has no constraints, so the multipliers have no effect.
        """
        return (*self.momentum(t, q, v), multipliers * 0, multipliers, multipliers)

    def velocities(self, q: Any, p: Any) -> Any:
        return array(mpmath.lu_solve(mpmath.matrix(self.mass(q).tolist()), mpmath.matrix(p.tolist())))

    def accelerations(self, t: Any, q: Any) -> Any:
        return self.rhs(t, np.concatenate([q, q * 0]))[len(q) :]


def array(numbers: Any) -> Any:
    return np.array(list(numbers), dtype=object)


def unit_mass(q: Any) -> Any:
    return np.eye(len(q), dtype=int)


def _driven_pendulum(t: Any, y: Any) -> Any:
    return array([y[1], -mpmath.sin(y[0]) * (1 + t)])


def _henon_heiles(t: Any, y: Any) -> Any:
    return array([y[2], y[3], -y[0] - 2 * y[0] * y[1], -y[1] - y[0] ** 2 + y[1] ** 2])


def separable(rhs: Rhs, *start: str) -> Law:
    """Return a law with unit masses, so that momenta equal velocities."""
    return Law(rhs, lambda t, q, v: (v, rhs(t, np.concatenate([q, v]))[len(q) :]), unit_mass, start)


def _double_pendulum(t: Any, y: Any) -> Any:
    """Right-hand side of a double pendulum with equal masses and rods. Its kinetic energy depends on the angles."""
    a, b, va, vb = y
    c, s = mpmath.cos(a - b), mpmath.sin(a - b)
    f, g = -(vb**2) * s - 2 * mpmath.sin(a), va**2 * s - mpmath.sin(b)
    return array([va, vb, (f - c * g) / (2 - c**2), (2 * g - c * f) / (2 - c**2)])


def _momenta_of_double_pendulum(t: Any, q: Any, v: Any) -> Any:
    pull = v[0] * v[1] * mpmath.sin(q[0] - q[1])
    return _mass_of_double_pendulum(q) @ v, array([-pull - 2 * mpmath.sin(q[0]), pull - mpmath.sin(q[1])])


def _mass_of_double_pendulum(q: Any) -> Any:
    c = mpmath.cos(q[0] - q[1])
    return np.array([[2, c], [c, 1]])


DRIVEN_PENDULUM = separable(_driven_pendulum, "0.4", "0.3")
HENON_HEILES = separable(_henon_heiles, "0.4", "0.3", "0.2", "-0.5")

DOUBLE_PENDULUM = Law(
    _double_pendulum, _momenta_of_double_pendulum, _mass_of_double_pendulum, ("0.4", "0.3", "0.2", "-0.5")
)


class Newton:
    """The argument `solve` of an implicit step function: Newton's method in multiple precision.

    The Jacobian is a difference quotient, inverted in doubles, so that a correction gains some 15 digits.
    """

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Any = None) -> Any:
        guess = guess() if callable(guess) else guess
        several = isinstance(guess, tuple)
        parts = guess if several else (guess,)
        count, z = len(parts), np.concatenate(parts)

        def value(unknowns: Any) -> Any:
            result = residual(*np.split(unknowns, count))
            return np.concatenate(result) if isinstance(result, (tuple, list)) else result

        inverse, size = np.empty((0, 0)), 1.0
        for _ in range(TURNS):
            off = value(z)
            if size > 1e-8:
                d = mpmath.mpf(10) ** -20
                columns = [(value(z + d * e) - off) / d for e in np.eye(len(z), dtype=int)]
                inverse = np.linalg.inv(np.array(columns).T.astype(float))
            correction = inverse @ off
            z = z - correction
            size = float(max(abs(correction)))
            if size < mpmath.mpf(10) ** (4 - mpmath.mp.dps):
                return tuple(np.split(z, count)) if several else z
        raise AssertionError(f"Newton's method left a correction of {size}")

    def damp(self, factor: Any, vector: Any) -> Any:
        """Return the error vector unchanged, since no step size follows from it here."""
        return vector


def precise_step(step: StepProgram, law: Law, t: Any, y: Any, h: Any) -> Any:
    """Return the state after one step from y = [q, v], in the arithmetic of the arguments."""
    solve = [Newton()] if step.solves else []
    if step.states == 2:
        return np.concatenate(step.function(getattr(law, step.law), t, *np.split(y, 2), h, *solve)[:2])
    result = step.function(law.rhs, t, y, h, *solve)
    return result if step.control is None else result[0]
