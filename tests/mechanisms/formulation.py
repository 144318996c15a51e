"""Random and regular mechanisms, and motions formulated without multipliers.

A formulation has its own state z, its slope dz/dt, and the coordinates q(z, t) and velocities v(z, t) of the scene with
constraints. Accelerations are dv/dt along the slope.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np
import sympy
import sympy as sp
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
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


# --- random mechanisms in a plane: rods with coupled masses, a pivot that may move, and a knife edge -----------


SEEDS = range(6)


@cache
def mechanism(seed: int) -> lg.System:
    """Return a mechanism. Every second one has a moving pivot, and every third a skate on a spring."""
    rng = np.random.default_rng(seed)
    points = [lg.coordinates(f"x{i} y{i}") for i in range(1 + seed % 3)]
    pivot: Any = (sp.sin(2 * lg.t) / 10, 0) if seed % 2 else (0, 0)
    kinetic, potential = sp.Integer(0), sp.Integer(0)
    rods: dict[str, Any] = {}
    initial: dict[Any, float] = {}
    # States are drawn at random too: their order must not be that in which other tests declared these names.
    order: list[Any] = [q for point in points for q in point]
    before: Any = pivot
    velocity: Any = (sp.Integer(0), sp.Integer(0))
    place = np.zeros(2)
    for i, point in enumerate(points):
        mass, length, angle = map(float, (*rng.uniform(0.5, 2.0, 2), rng.uniform(-2.5, 2.5)))
        own = tuple(q.dot for q in point)
        # A point mass and a uniform rod to the point before, which couples the velocities of both.
        kinetic += sum(mass * v**2 / 2 + mass * (v**2 + v * w + w**2) / 12 for v, w in zip(own, velocity, strict=True))
        potential += 9.81 * mass * point[1] + point[0] ** 2 / 2
        rods[f"rod{i}"] = sum((p - b) ** 2 for p, b in zip(point, before, strict=True)) - length**2
        place = place + length * np.array([np.sin(angle), -np.cos(angle)])
        initial |= dict(zip(point, place.tolist(), strict=True))
        initial |= {q.dot: float(rng.normal()) for q in point}
        before, velocity = point, own
    if seed % 3 == 2:
        u, w, heading = lg.coordinates("u w heading")
        order += [u, w, heading]
        kinetic += (u.dot**2 + w.dot**2 + heading.dot**2 / 3) / 2
        potential += (u - before[0]) ** 2 + (w - before[1]) ** 2
        rods["edge"] = u.dot * sp.sin(heading) - w.dot * sp.cos(heading)
        initial |= {heading: float(rng.uniform(0, 6)), heading.dot: 1.0, u.dot: 0.4}
    given: dict[str, Any] = {
        "kinetic": kinetic,
        "potential": potential,
        "coordinates": order,
        "constraints": rods,
        "name": f"mechanism {seed}",
    }
    return lg.System(**given, initial=lg.System(**given, initial=initial).consistent(initial).initial)


@cache
def compiled(seed: int, target: str = "llvm") -> Model:
    """Return the model of a mechanism."""
    return mechanism(seed).compile(target)


def initial_state(seed: int) -> FloatArray:
    """Return the initial state of a mechanism, which satisfies its constraints."""
    return np.array(compiled(seed).statement.initial, dtype=float)
