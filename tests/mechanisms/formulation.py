"""Motions formulated without constraints or multipliers: in reduced coordinates, by Kane's method, or by hand.

A formulation has its own state z, its slope dz/dt, and the coordinates q(z, t) and velocities v(z, t) of the scene with
constraints. Accelerations are dv/dt along the slope.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from lagrange.statement.coordinate import t

Vector = NDArray[np.float64]
Slope = Callable[[Vector, float], Vector]


@dataclass(frozen=True, eq=False)
class Formulation:
    """One motion. `state` are the symbols of z; `places` and `rates` are q and v in terms of them.

    `slope` is dz/dt, as a function of (z, t) or as expressions. `start` is z at the start of the scene. Random states
    are `start` plus normal deviates of the size `spread`.
    """

    values: Mapping[Any, float]
    state: Sequence[Any]
    places: Sequence[Any]
    rates: Sequence[Any]
    slope: Slope | Sequence[Any]
    start: Sequence[Any]
    spread: float = 0.5

    @cached_property
    def rate(self) -> Slope:
        """The slope dz/dt as a function of (z, t)."""
        return self.slope if callable(self.slope) else self.numbers(self.slope)

    @cached_property
    def first(self) -> Vector:
        """The state z at the start of the scene."""
        return np.array([float(sympy.sympify(item).subs(self.values)) for item in self.start])

    @cached_property
    def lift(self) -> Slope:
        """Coordinates and velocities (q, v) as a function of (z, t)."""
        return self.numbers([*self.places, *self.rates])

    @cached_property
    def _change(self) -> Slope:
        rates = sympy.Matrix(list(self.rates))
        return self.numbers(list(rates.jacobian(list(self.state)).row_join(rates.diff(t))))

    def numbers(self, expressions: Sequence[Any]) -> Slope:
        """Return expressions in z, t and the parameters as a function of (z, t)."""
        known, values = list(self.values), [float(value) for value in self.values.values()]
        compiled = sympy.lambdify([list(self.state), t, known], list(map(sympy.sympify, expressions)), cse=True)
        return lambda z, time: np.array(compiled(z, time, values), dtype=float)

    def accelerations(self, z: Vector, time: float) -> Vector:
        """Return dv/dt."""
        change = self._change(z, time).reshape(len(self.rates), len(self.state) + 1)
        result: Vector = change[:, :-1] @ self.rate(z, time) + change[:, -1]
        return result

    def draws(self, count: int) -> list[Vector]:
        """Return some random states."""
        random = np.random.default_rng(5)
        return [self.first + self.spread * random.normal(size=len(self.state)) for _ in range(count)]

    def states(self, times: Vector) -> Vector:
        """Return (q, v) at some times, (2n, K), by DOP853 with errors near round-off."""
        result = solve_ivp(
            lambda time, z: self.rate(z, time),
            (0.0, times[-1]),
            self.first,
            method="DOP853",
            t_eval=times,
            rtol=1e-13,
            atol=1e-14,
        )
        assert result.success
        return np.array([self.lift(z, time) for z, time in zip(result.y.T, times, strict=True)]).T


@dataclass(frozen=True, eq=False)
class Bodies:
    """Points with masses and angles with moments of inertia, in reduced coordinates.

    `force` is the generalized force.
    """

    masses: Sequence[tuple[Any, Sequence[Any]]] = ()
    spins: Sequence[tuple[Any, Any]] = ()
    potential: Any = 0
    force: Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]] | None = None
    names: Sequence[Any] = field(default_factory=tuple)


def reduced(values: Mapping[Any, float], places: Sequence[Any], bodies: Bodies, **more: Any) -> Formulation:
    """Return the motion in reduced coordinates `bodies.names`, by Lagrange's equations in SymPy."""
    s = list(bodies.names)
    u = [sympy.Symbol(f"{first.name}_rate", real=True) for first in s]

    def rate(expression: Any) -> Any:
        return sum(
            (sympy.diff(expression, first) * second for first, second in zip(s, u, strict=True)), sympy.Integer(0)
        )

    kinetic = sum(mass * rate(first) ** 2 / 2 for mass, point in bodies.masses for first in point)
    kinetic += sum(inertia * rate(angle) ** 2 / 2 for inertia, angle in bodies.spins)
    momenta = [sympy.diff(kinetic, first) for first in u]
    applied = bodies.force(s, u) if bodies.force else [0] * len(s)
    forces = [
        sympy.diff(kinetic - bodies.potential, first) - rate(p) + extra
        for first, p, extra in zip(s, momenta, applied, strict=True)
    ]
    mass = [sympy.diff(p, first) for p in momenta for first in u]
    n = len(s)
    plain = Formulation(values, [*s, *u], places, [rate(first) for first in places], [], ())
    both = plain.numbers([*mass, *forces])

    def slope(z: Vector, time: float) -> Vector:
        result = both(z, time)
        return np.concatenate([z[n:], np.linalg.solve(result[: n * n].reshape(n, n), result[n * n :])])

    return Formulation(values, [*s, *u], places, plain.rates, slope, **more)
