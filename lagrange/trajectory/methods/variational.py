"""Variational integrators: steps from a discrete principle of least action, without and with holonomic constraints.

They advance momenta p = dL/dv by forces. Each is symplectic in (q, p) for any mass matrix. Forces and dissipation enter
by the principle of Lagrange and d'Alembert; time may be explicit. In a step function g(t, q, v) returns the momenta p
and forces f, and solve(residuals, guess) returns the unknowns for which the function `residuals` is zero. The unknowns
are velocities. The last unknown is the velocity at the end of the step, which gives the momentum there. Source: J. E.
Marsden, M. West, Discrete mechanics and variational integrators, Acta Numerica 10, 2001, sections 2.3, 2.6 and 3.2; E.
Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, VI.6.

With holonomic constraints the multipliers are among the unknowns. Coordinates and velocities satisfy the constraints at
both ends of a step: the positions are moved to phi = 0, then the velocities to dphi/dt = 0, each up to rounding.
Without constraints each method equals the method that it generalizes. In a step function g(t, q, v, lambda) returns p,
f, the constraint forces c = G^T lambda, phi, and psi = dphi/dt. Source: E. Hairer, C. Lubich, G. Wanner, cited above,
VII.1.4; L. O. Jay, SIAM J. Numer. Anal. 33, 1996; S. Leyendecker, J. E. Marsden, M. Ortiz, ZAMM 88, 2008.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lagrange.trajectory.integrator import Claims, built_in
from lagrange.trajectory.methods.implicit import Abscissa, ImplicitMethod, gauss_tableau, lobatto_pair, weighted

Momenta = Callable[..., tuple[Any, Any]]
"""Type of the function g that a variational step evaluates: g(t, q, v) returns the momenta p and the forces f."""


def variational_trapezoid(g: Momenta, t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, Any]:
    """Return (q, v) at t + h after a step whose discrete action is the mean of h L at both ends.

    L is taken at the mean velocity of the step, which is unknown like the velocity at the end. g(t, q, v) returns
    momenta and forces. `solve(residuals, guess)` returns the unknowns for which the function `residuals` is zero.
    """
    before, _ = g(t, q, v)

    def residuals(mean: Any, end: Any) -> tuple[Any, Any]:
        p0, f0 = g(t, q, mean)
        p1, f1 = g(t + h, q + mean * h, mean)
        after, _ = g(t + h, q + mean * h, end)
        return before + f0 * (h / 2) - (p0 + p1) / 2, (p0 + p1) / 2 + f1 * (h / 2) - after

    mean, end = solve(residuals, (v, v))
    return q + mean * h, end


@dataclass(frozen=True)
class Galerkin:
    """The step function that integrates q' = v and p' = f with the Runge-Kutta tableau A, b, c of s stages.

    p are the momenta and f the forces. With the tableau of Gauss's method, q is a polynomial of degree s on the step,
    and the action of this polynomial is integrated with s points. With one stage the action is h L at the midpoint.
    """

    A: tuple[tuple[Abscissa, ...], ...]
    b: tuple[Abscissa, ...]
    c: tuple[Abscissa, ...]

    def __call__(self, g: Momenta, t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, Any]:
        """Return (q, v) at t + h after a step from q and v at t. g(t, q, v) returns momenta and forces.

        `solve(residuals, guess)` returns the unknown velocities for which the function `residuals` is zero.
        """
        A, b, c = self.A, self.b, self.c
        before, _ = g(t, q, v)

        def residuals(*velocities: Any) -> list[Any]:
            *inner, end = velocities
            positions = [q + weighted(row, inner) * h for row in A]
            stages = [g(t + h * ci, position, vi) for ci, position, vi in zip(c, positions, inner, strict=True)]
            forces = [f for _, f in stages]
            off = [before + weighted(row, forces) * h - p for row, (p, _) in zip(A, stages, strict=True)]
            after, _ = g(t + h, q + weighted(b, inner) * h, end)
            return [*off, before + weighted(b, forces) * h - after]

        *inner, end = solve(residuals, (v,) * (len(b) + 1))
        return q + weighted(b, inner) * h, end


VARIATIONAL_MIDPOINT, GALERKIN4, GALERKIN6 = (Galerkin(*gauss_tableau(stages)) for stages in (1, 2, 3))

_, WEIGHTS, NODES = gauss_tableau(5)
DISCRETE_GRADIENT = Galerkin(tuple(tuple(node * weight for weight in WEIGHTS) for node in NODES), WEIGHTS, NODES)
"""Step function that moves (q, p) by the mean gradient of the energy on the straight line of the step.

The mean is computed by Gauss's quadrature. The energy changes by the product of mean gradient and step, which are
perpendicular. So the energy is conserved, up to the error of the quadrature. Source: R. I. McLachlan, G. R. W. Quispel,
N. Robidoux, Phil. Trans. R. Soc. A 357, 1999, eq. 2.4; E. Hairer, C. Lubich, G. Wanner, Geometric Numerical
Integration, V.5."""


def _method(
    name: str, order: int, function: Callable[..., Any], step: float | None, law: str = "momentum", **claims: bool
) -> ImplicitMethod:
    """Return the method `name` with fixed steps by the step function `function`, of the claimed `order`.

    `claims` are its other claimed properties. With the `law` "constrained" its steps end on the constraints.
    """
    promised = Claims(order, symmetric=True, explicit=False, **claims)
    return ImplicitMethod(name, promised, function, law=law, step=step, holonomic=law == "constrained")


@built_in("variational-midpoint")
def VariationalMidpoint(step: float | None = None) -> ImplicitMethod:
    """Return the variational midpoint rule, order 2, symplectic for any mass matrix."""
    return _method("variational-midpoint", 2, VARIATIONAL_MIDPOINT, step, symplectic=True, a_stable=True)


@built_in("variational-trapezoid")
def VariationalTrapezoid(step: float | None = None) -> ImplicitMethod:
    """Return the variational trapezoidal rule, order 2, symplectic for any mass matrix."""
    return _method("variational-trapezoid", 2, variational_trapezoid, step, symplectic=True)


@built_in("galerkin4")
def Galerkin4(step: float | None = None) -> ImplicitMethod:
    """Return the Galerkin variational integrator with 2 Gauss points, order 4, symplectic for any mass matrix."""
    return _method("galerkin4", 4, GALERKIN4, step, symplectic=True, a_stable=True)


@built_in("galerkin6")
def Galerkin6(step: float | None = None) -> ImplicitMethod:
    """Return the Galerkin variational integrator with 3 Gauss points, order 6, symplectic for any mass matrix."""
    return _method("galerkin6", 6, GALERKIN6, step, symplectic=True, a_stable=True)


@built_in("discrete-gradient")
def DiscreteGradient(step: float | None = None) -> ImplicitMethod:
    """Return the mean value discrete gradient method, order 2, which conserves the energy to round-off."""
    return _method("discrete-gradient", 2, DISCRETE_GRADIENT, step, energy=True, a_stable=True)


Constrained = Callable[..., tuple[Any, Any, Any, Any, Any]]
"""Type of the function g that a step with constraints evaluates. g(t, q, v, lambda) returns five vectors: momenta,
forces, constraint forces, the constraints phi on positions, and psi = dphi/dt."""


@dataclass(frozen=True)
class LobattoPair:
    """The step that integrates q' = v with Lobatto IIIA and p' = f + c with IIIB, with phi = 0 at every stage.

    f are the forces and c the constraint forces. `A`, `b` and `c` are the tableau of IIIA, and `conjugate` is the
    matrix of IIIB. The last column of IIIB is zero. So the multiplier at the end changes only the momentum there, and
    makes the velocity satisfy the constraints.
    """

    A: tuple[tuple[Abscissa, ...], ...]
    b: tuple[Abscissa, ...]
    c: tuple[Abscissa, ...]
    conjugate: tuple[tuple[Abscissa, ...], ...]

    def __call__(self, g: Constrained, t: Any, q: Any, v: Any, h: Any, solve: Callable[..., Any]) -> tuple[Any, Any]:
        """Return (q, v) at t + h after a step from q and v at t. `g` is the function of the type `Constrained`.

        `solve(residuals, guess)` returns the unknowns for which `residuals` is zero: velocities and multipliers.
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

    phi are the holonomic constraints. The discrete action of the step is h L at its midpoint and mean velocity. `g` is
    the function of the type `Constrained`. `solve(residuals, guess)` returns the unknowns for which `residuals` is
    zero.
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


@built_in("rattle")
def Rattle(step: float | None = None) -> ImplicitMethod:
    """Return RATTLE, order 2, symplectic with holonomic constraints and for any mass matrix."""
    return _method("rattle", 2, RATTLE, step, "constrained", symplectic=True)


@built_in("constrained-midpoint")
def ConstrainedMidpoint(step: float | None = None) -> ImplicitMethod:
    """Return the variational midpoint rule with holonomic constraints, order 2, symplectic for any mass matrix."""
    return _method("constrained-midpoint", 2, constrained_midpoint, step, "constrained", symplectic=True, a_stable=True)


@built_in("lobatto4")
def Lobatto4(step: float | None = None) -> ImplicitMethod:
    """Return Lobatto's pair IIIA-IIIB of 3 stages, order 4, symplectic with holonomic constraints."""
    return _method("lobatto4", 4, LOBATTO4, step, "constrained", symplectic=True)
