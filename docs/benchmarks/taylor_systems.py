"""The runs that `taylor.py` measures: their statements for lagrange, and what heyoka makes of the same T and V."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from math import prod
from time import perf_counter
from typing import Any

import heyoka as hy
import numpy as np
import sympy
from numpy.typing import NDArray
from sympy import cos, sqrt
from systems import GRAVITY, chain, double_pendulum, henon_heiles

import lagrange as lg

STARTS, SPREAD = 4, 2e-3
"""Each system starts from so many states, each this much larger than the last, for errors near round-off are chance."""

LONG = np.longdouble
MODES = {"compact": True, "default": False}
REFERENCE, CHECK = 1e-19, 1e-18
"""Tolerances of the reference in 80-bit arithmetic, and of the run that it must agree with."""

GAUSS = 2.95912208286e-4
BODIES: dict[str, tuple[float, tuple[float, ...], tuple[float, ...]]] = {
    "sun": (1.00000597682, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "jupiter": (0.000954786104043, (-3.5023653, -3.8169847, -1.5507963), (0.00565429, -0.00412490, -0.00190589)),
    "saturn": (0.000285583733151, (9.0755314, -3.0458353, -1.6483708), (0.00168318, 0.00483525, 0.00192462)),
    "uranus": (0.0000437273164546, (8.3101420, -16.2901086, -7.2521278), (0.00354178, 0.00137102, 0.00055029)),
    "neptune": (0.0000517759138449, (11.4707666, -25.7294829, -10.8169456), (0.00288930, 0.00114527, 0.00039677)),
    "pluto": (1 / 1.3e8, (-15.5387357, -25.2225594, -3.1902382), (0.00276725, -0.00170702, -0.00136504)),
}
"""Mass, AU and AU/day (E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, I.2.4)."""


@dataclass(frozen=True)
class Case:
    """A run: a system, its initial state [q, v] and the time at the end."""

    name: str
    about: str
    system: Callable[[], lg.System]
    start: tuple[float, ...]
    t_end: float
    unrolled: float = 0.0
    """The least tolerance at which heyoka compiles it in less than a minute without its compact mode."""
    products: bool = False
    """Whether heyoka is given powers above the second as products."""

    def starts(self) -> NDArray[Any]:
        """Return the initial states, one per row."""
        return np.array([np.array(self.start) * (1 + SPREAD * k) for k in range(STARTS)])

    def initial(self, model: lg.Model) -> dict[str, float]:
        """Return the initial state by the names of its numbers."""
        return dict(zip(model.layout.names(), self.start, strict=True))


def pendulum() -> lg.System:
    """Return the pendulum of the textbooks."""
    theta = lg.coordinate("theta")
    m, g, l = lg.parameters("m g l")
    return lg.System(
        kinetic=m * l**2 * theta.dot**2 / 2,
        potential=-m * g * l * cos(theta),
        parameters={m: 1.0, g: GRAVITY, l: 1.0},
        name="pendulum",
    )


def kepler() -> lg.System:
    """Return a planet around a fixed sun, Cartesian, in the plane."""
    x, y = lg.coordinates("x y")
    mu = lg.parameters("mu")
    return lg.System(
        kinetic=lg.kinetic_energy(1, (x, y)),
        potential=-mu / sqrt(x**2 + y**2),
        parameters={mu: 1.0},
        name="Kepler",
    )


def outer_planets() -> lg.System:
    """Return the sun, the outer planets and Pluto in space."""
    places = {name: lg.coordinates(" ".join(f"{axis}_{name}" for axis in "xyz")) for name in BODIES}
    masses = {name: lg.parameters(f"m_{name}") for name in BODIES}
    G = lg.parameters("G")
    return lg.System(
        kinetic=sum(lg.kinetic_energy(masses[name], place) for name, place in places.items()),
        potential=sum(
            -G * masses[a] * masses[b] / sqrt(sum((p - q) ** 2 for p, q in zip(places[a], places[b], strict=True)))
            for a, b in combinations(BODIES, 2)
        ),
        coordinates=[q for place in places.values() for q in place],
        parameters={G: GAUSS, **{masses[name]: body[0] for name, body in BODIES.items()}},
        name="outer solar system",
    )


def springs(n: int, *, cubic: bool = True) -> lg.System:
    """Return n masses on a line between two walls (E. Fermi, J. Pasta, S. Ulam, M. Tsingou, 1955)."""
    places = [lg.coordinate(f"q{i + 1}") for i in range(n)]
    alpha, beta = lg.parameters("alpha beta")
    stretches = [b - a for a, b in pairwise([0, *places, 0])]
    potential = sum(d**2 / 2 + beta * d**4 / 4 for d in stretches)
    if cubic:
        potential += sum(alpha * d**3 / 3 for d in stretches)
    return lg.System(
        kinetic=sum(lg.kinetic_energy(1, q) for q in places),
        potential=potential,
        coordinates=places,
        parameters={alpha: 0.25, beta: 1.0} if cubic else {beta: 1.0},
        name=f"{n} masses and springs",
    )


def links(n: int) -> tuple[float, ...]:
    """Return the initial state of a chain in absolute angles, at rest."""
    return (*(0.5 + 0.4 * np.sin(0.7 * i) for i in range(n)), *(0.0 for _ in range(n)))


def relative(state: NDArray[Any]) -> NDArray[Any]:
    """Return a chain's state in relative angles, from that in absolute ones."""
    q, v = np.split(state, 2)
    zero = np.zeros(1, dtype=state.dtype)
    return np.concatenate([np.diff(q, prepend=zero), np.diff(v, prepend=zero)])


def chain_system(n: int, *, turned: bool = False) -> lg.System:
    """Return the chain of n links, its angles relative to the link above if `turned`."""
    return lg.System(**chain(n, relative=turned))


def _mode() -> tuple[float, ...]:
    """Return the first mode with a little of the second, without which the spring in the middle is not stretched."""
    x = np.pi * np.arange(1, 65) / 65
    return (*(4 * np.sin(x) + 0.3 * np.sin(2 * x)), *np.zeros(64))


def _pulse() -> tuple[float, ...]:
    """Return a bump among masses at rest in their places."""
    x = np.arange(1, 65)
    return (*np.where(abs(x - 32) < 8, 1 + np.cos(np.pi * (x - 32) / 8), 0.0), *np.zeros(64))


def _solar() -> tuple[float, ...]:
    return (*(x for body in BODIES.values() for x in body[1]), *(v for body in BODIES.values() for v in body[2]))


_CHAINS = {5: (10.0, 0.0), 10: (5.0, 1e-11), 20: (2.0, 1.0), 30: (1.0, 1.0)}
_DOUBLE = (1.0, 1.5, 0.0, 0.0)

CASES = (
    Case("pendulum", "from 2 rad", pendulum, (2.0, 0.0), 20.0),
    Case("henon-heiles", "energy 0.12", henon_heiles, (0.0, 0.1, 0.48, 0.0), 50.0),
    Case("kepler", "eccentricity 0.6, 10 orbits", kepler, (0.4, 0.0, 0.0, 2.0), 20 * np.pi),
    Case("double", "double pendulum, textbook L", double_pendulum, _DOUBLE, 10.0),
    Case("double-sums", "double pendulum, Cartesian sums", partial(double_pendulum, cartesian=True), _DOUBLE, 10.0),
    *(
        Case(f"chain{n}", f"{n} links, Cartesian sums", partial(chain_system, n), links(n), t_end, unrolled)
        for n, (t_end, unrolled) in _CHAINS.items()
    ),
    Case("solar", "sun, four planets, Pluto", outer_planets, _solar(), 50000.0),
    *(
        Case(f"{name}{end}", f"64 masses, {about}{words}", system, start, 50.0, products=products)
        for name, about, system, start in (
            ("fput", "springs d^2/2 + d^3/12 + d^4/4, first mode", partial(springs, 64), _mode()),
            ("fput-equal", "springs d^2/2 + d^4/4, equal neighbours", partial(springs, 64, cubic=False), _pulse()),
        )
        for products, end, words in (
            (False, "", ""),
            (True, "-products", ", heyoka given products for powers"),
        )
    ),
)


@dataclass(frozen=True)
class Rival:
    """An integrator of heyoka, and the seconds from T and V to it."""

    mode: str
    tolerance: float
    integrator: Any
    seconds: float

    def run(self, y0: NDArray[Any], t_end: float) -> int:
        """Run from a state at time 0 to the end, and return the number of steps."""
        self.integrator.time = 0.0
        self.integrator.state[:] = y0
        return int(self.integrator.propagate_until(t_end)[3])


def equations(case: Case, system: lg.System, real: Any) -> list[tuple[Any, Any]]:
    """Return heyoka's own equations from the stated L, parameters as numbers of the type `real`."""
    stated, plain = system.statement, system.statement.plain
    L = stated.lagrangian.xreplace(plain)
    table = {symbol: hy.expression(real(value)) for symbol, value in system.parameters.items()}
    for number in L.atoms(sympy.Rational):
        table[number] = hy.expression(real(number.p) / real(number.q))
    if case.products:
        for power in L.atoms(sympy.Pow):
            if power.exp.is_Integer and power.exp > 2:
                table[power] = prod([hy.from_sympy(power.base, s_dict=table)] * int(power.exp))
    q, v = (
        [hy.expression(plain[symbol].name) for symbol in group] for group in (stated.coordinates, stated.velocities)
    )
    return list(hy.lagrangian(hy.from_sympy(L, s_dict=table), q, v))


def rival(case: Case, system: lg.System, mode: str, tolerance: float) -> Rival:
    """Return heyoka's integrator in double precision."""
    begun = perf_counter()
    right = equations(case, system, float)
    made = hy.taylor_adaptive(right, case.starts()[0], tol=tolerance, compact_mode=MODES[mode])
    return Rival(mode, tolerance, made, perf_counter() - begun)


def in_80_bits(equations: Sequence[tuple[Any, Any]]) -> list[Any]:
    """Return heyoka's integrators in 80-bit arithmetic: that of the reference, and the one that it must agree with."""
    zero = np.zeros(len(equations), dtype=LONG)
    return [
        hy.taylor_adaptive(equations, zero, tol=LONG(tolerance), fp_type=LONG, compact_mode=True, high_accuracy=True)
        for tolerance in (REFERENCE, CHECK)
    ]


def propagated(taylor: Any, start: NDArray[Any], times: Sequence[float]) -> NDArray[Any]:
    """Return the states at rising times, (K, 2n), of a run of heyoka's from time 0 in 80-bit arithmetic."""
    taylor.time = LONG(0)
    taylor.state[:] = start.astype(LONG)
    states = []
    for time in times:
        taylor.propagate_until(LONG(time))
        states.append(taylor.state.copy())
    return np.array(states)


def reference(case: Case, system: lg.System, starts: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return the states at the end in 80-bit arithmetic, for two tolerances: (2, starts, 2n).

    `starts` (m, 2n) stand in the place of those of the case.
    """
    y0 = case.starts() if starts is None else starts
    integrators = in_80_bits(equations(case, system, LONG))
    return np.array([[propagated(taylor, start, [case.t_end])[0] for start in y0] for taylor in integrators])


def final_state(system: lg.System, end: float) -> tuple[NDArray[Any], float]:
    """Return the state at the end in 80-bit arithmetic, and how far two tolerances are apart."""
    start = np.array(system.statement.initial)
    fine, rough = reference(Case(system.name, "", lambda: system, (), end), system, start[None])[:, 0]
    return fine, float(np.abs(fine - rough).max())
