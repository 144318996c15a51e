"""Symplectic methods for systems with holonomic constraints, whose multipliers are among the unknowns.

Coordinates and velocities satisfy the constraints at both ends of a step: the positions are moved to phi = 0, then the
velocities to dphi/dt = 0, each up to rounding. Without constraints each method equals the method that it generalizes.
The law is p, f, c, phi, psi = g(t, q, v, lambda): momenta, forces, constraint forces c = G^T lambda, and constraints
phi and psi = dphi/dt. The mass matrix may be any, and forces may depend on time. In a step function
solve(residuals, guess) returns the unknowns for which the function `residuals` is zero.
Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, VII.1.4; L. O. Jay, SIAM J.
Numer. Anal. 33, 1996; S. Leyendecker, J. E. Marsden, M. Ortiz, ZAMM 88, 2008.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.trajectory.integrator import Claims
from lagrange.trajectory.methods.built_in import built_in
from lagrange.trajectory.methods.implicit import ImplicitMethod, weighted
from lagrange.trajectory.tableaux.gauss import Abscissa, lobatto_pair

Constrained = Callable[..., tuple[Any, Any, Any, Any, Any]]
"""The law p, f, c, phi, psi = g(t, q, v, lambda)."""


@dataclass(frozen=True)
class LobattoPair:
    """The step that integrates q' = v with Lobatto IIIA and p' = f + c with IIIB, with phi = 0 at every stage.

    The last column of IIIB is zero. So the multiplier at the end changes only the momentum there, and makes the
    velocity satisfy the constraints.
    """

    A: tuple[tuple[Abscissa, ...], ...]
    b: tuple[Abscissa, ...]
    c: tuple[Abscissa, ...]
    conjugate: tuple[tuple[Abscissa, ...], ...]

    def __call__(self, g: Constrained, t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, Any]:
        """Return the coordinates and velocities at t + h after a step from q and v at time t.

        g(t, q, v, lambda) returns momenta, forces, constraint forces, phi, and psi = dphi/dt. solve(residuals, guess)
        returns the unknowns at which the residuals are zero.
        """
        b, count = self.b, len(self.b)
        none = q * 0
        before, *_ = g(t, q, v, none)

        def stages(speeds: Any, pushes: Any) -> list[tuple[Any, Any, Any, Any, Any]]:
            positions = [q + weighted(row, speeds) * h for row in self.A]
            arguments = zip(self.c, positions, speeds, pushes, strict=False)
            return [g(t + h * ci, position, speed, push) for ci, position, speed, push in arguments]

        def residuals(*unknowns: Any) -> list[Any]:
            speeds, pushes = unknowns[:count], unknowns[count:]
            # The last stage has no multiplier: its phi is padded with the multiplier of the first stage.
            results = stages(speeds, (*pushes, pushes[0]))
            forces = [f + c for _, f, c, _, _ in results[:-1]]
            rows = zip(self.conjugate, results, strict=True)
            off = [before + weighted(row[:-1], forces) * h - p for row, (p, *_) in rows]
            return [*off, *(phi for _, _, _, phi, _ in results[1:])]

        solution = solve(residuals, (*(v,) * count, *(none,) * (count - 1)))
        speeds, pushes = solution[:count], solution[count:]
        momentum = before + weighted(b[:-1], [f + c for _, f, c, _, _ in stages(speeds, pushes)]) * h
        position = q + weighted(b, speeds) * h

        def ends(end: Any, push: Any) -> tuple[Any, Any]:
            _, f, c, _, _ = g(t + h, position, speeds[-1], push)
            after, _, _, _, psi = g(t + h, position, end, push)
            return momentum + (f + c) * (h * b[-1]) - after, psi

        end, _ = solve(ends, (speeds[-1], none))
        return position, end


RATTLE, LOBATTO4 = (LobattoPair(*lobatto_pair(stages)) for stages in (2, 3))


def constrained_midpoint(g: Constrained, t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, Any]:
    """Return (q, v) at t + h after a step of the variational midpoint rule, with phi = 0 at both ends.

    The discrete action of the step is h L at its midpoint and mean velocity. g(t, q, v, lambda) returns momenta,
    forces, constraint forces, phi, and psi = dphi/dt. solve(residuals, guess) returns the unknowns at which the
    residuals are zero.
    """
    none = q * 0
    before, *_ = g(t, q, v, none)

    def positions(mean: Any, push: Any) -> tuple[Any, Any]:
        p, f, *_ = g(t + h / 2, q + mean * (h / 2), mean, none)
        _, _, c, _, _ = g(t, q, v, push)
        _, _, _, phi, _ = g(t + h, q + mean * h, mean, push)
        return before + (f + c) * (h / 2) - p, phi

    mean, _ = solve(positions, (v, none))
    p, f, *_ = g(t + h / 2, q + mean * (h / 2), mean, none)

    def velocities(end: Any, push: Any) -> tuple[Any, Any]:
        after, _, c, _, psi = g(t + h, q + mean * h, end, push)
        return p + (f + c) * (h / 2) - after, psi

    end, _ = solve(velocities, (mean, none))
    return q + mean * h, end


def _method(name: str, order: int, function: Callable[..., Any], step: float | None, **claims: bool) -> ImplicitMethod:
    promised = Claims(order, symplectic=True, symmetric=True, explicit=False, **claims)
    return ImplicitMethod(name, promised, function, law="constrained", step=step, holonomic=True)


@built_in("rattle")
def Rattle(step: float | None = None) -> ImplicitMethod:
    """Return RATTLE, order 2, symplectic with holonomic constraints and for any mass matrix."""
    return _method("rattle", 2, RATTLE, step)


@built_in("constrained-midpoint")
def ConstrainedMidpoint(step: float | None = None) -> ImplicitMethod:
    """Return the variational midpoint rule with holonomic constraints, order 2, symplectic for any mass matrix."""
    return _method("constrained-midpoint", 2, constrained_midpoint, step, a_stable=True)


@built_in("lobatto4")
def Lobatto4(step: float | None = None) -> ImplicitMethod:
    """Return Lobatto's pair IIIA-IIIB of 3 stages, order 4, symplectic with holonomic constraints."""
    return _method("lobatto4", 4, LOBATTO4, step)
