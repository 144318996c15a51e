"""The systems of `hard_cases.py`, and what is true of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import combinations
from typing import Any

import heyoka as hy
import mpmath
import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.special import ellipj, ellipk
from sympy import cos, sin, sqrt
from systems import GRAVITY, double_pendulum
from taylor_systems import LONG, Case, equations, in_80_bits, kepler, propagated

import lagrange as lg

EIGHT_PERIOD = 6.32591398292621
SPHERICAL_END = 20.0
MOMENTS, START_RATES = (1.0, 2.0, 3.0), (1.0, 0.0, float(np.sqrt((1 + 1e-4) / 3)))
BODY_END = 120.0


def pericentre(e: float) -> dict[str, float]:
    """Return the state at the pericentre of an orbit of about unit axis, in doubles."""
    return {"x": 1.0 - e, "y": 0.0, "x_dot": 0.0, "y_dot": float(np.sqrt((1 + e) / (1 - e)))}


def kepler_state(start: Mapping[str, float], end: float) -> NDArray[Any]:
    """Return the state after a start at the pericentre, from Kepler's equation with 40 digits."""
    with mpmath.workdps(40):
        r, v = mpmath.mpf(start["x"]), mpmath.mpf(start["y_dot"])
        axis = 1 / (2 / r - v * v)
        e = 1 - r / axis
        motion = axis ** mpmath.mpf("-1.5")
        mean = motion * mpmath.mpf(end)
        anomaly = mpmath.findroot(lambda x: x - e * mpmath.sin(x) - mean, _guess(float(e), float(mean)))
        root, rate = mpmath.sqrt(1 - e * e), motion / (1 - e * mpmath.cos(anomaly))
        state = (
            axis * (mpmath.cos(anomaly) - e),
            axis * root * mpmath.sin(anomaly),
            -axis * rate * mpmath.sin(anomaly),
            axis * rate * root * mpmath.cos(anomaly),
        )
        return np.array([float(value) for value in state])


def _guess(e: float, mean: float) -> float:
    """Return the eccentric anomaly in double precision, by bisection: it lies within e of the mean one."""
    low, high = mean - e, mean + e
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if middle - e * np.sin(middle) < mean else (low, middle)
    return low


def bodies(name: str, masses: tuple[float, ...], places: Any, velocities: Any) -> lg.System:
    """Return point masses in the plane that attract each other, G = 1."""
    points = [lg.coordinates(f"x{i} y{i}") for i in range(len(masses))]
    symbols = lg.parameters(" ".join(f"m{i}" for i in range(len(masses))))
    initial: dict[Any, float] = {}
    for point, place, velocity in zip(points, places, velocities, strict=True):
        initial |= dict(zip(point, place, strict=True))
        initial |= dict(zip((q.dot for q in point), velocity, strict=True))
    return lg.System(
        kinetic=sum(lg.kinetic_energy(m, point) for m, point in zip(symbols, points, strict=True)),
        potential=sum(
            -symbols[i] * symbols[j] / sqrt(sum((a - b) ** 2 for a, b in zip(points[i], points[j], strict=True)))
            for i, j in combinations(range(len(masses)), 2)
        ),
        coordinates=[q for point in points for q in point],
        parameters=dict(zip(symbols, masses, strict=True)),
        initial=initial,
        name=name,
    )


def burrau() -> lg.System:
    """Return masses 3, 4 and 5 at rest in the corners of a triangle (C. Burrau, Astron. Nachr. 195, 1913)."""
    return bodies("Burrau", (3.0, 4.0, 5.0), ((1, 3), (-2, -1), (1, -1)), ((0, 0),) * 3)


def figure_eight() -> lg.System:
    """Return three equal masses that follow each other (A. Chenciner, R. Montgomery, Ann. of Math. 152, 2000)."""
    place, speed = (0.97000435669734, -0.24308753153583), (-0.93240737144104, -0.86473146092102)
    half = (-speed[0] / 2, -speed[1] / 2)
    return bodies("figure-eight", (1.0,) * 3, (place, (-place[0], -place[1]), (0, 0)), (half, half, speed))


def outcome(state: NDArray[Any]) -> str:
    """Return which of Burrau's bodies are bound to each other, and which one leaves them."""
    places, speeds = state[:6].reshape(3, 2), state[6:].reshape(3, 2)
    masses = (3, 4, 5)
    bound = []
    for i, j in combinations(range(3), 2):
        apart, moving = places[i] - places[j], speeds[i] - speeds[j]
        if moving @ moving / 2 - (masses[i] + masses[j]) / np.sqrt(apart @ apart) < 0:
            bound.append(f"{masses[i]} and {masses[j]}")
    return f"bound: {', '.join(bound) or 'none'}"


def kapitza() -> lg.System:
    """Return a pendulum whose pivot is shaken up and down, its angle from above (P. Kapitza, 1951)."""
    theta = lg.coordinate("theta")
    a, omega, g, l = lg.parameters("a omega g l")
    place = (l * sin(theta), a * cos(omega * lg.t) + l * cos(theta))
    return lg.System(
        kinetic=lg.kinetic_energy(1, place),
        potential=lg.gravity(1, place, g),
        parameters={a: 0.2, omega: 20.0, g: GRAVITY, l: 1.0},
        name="Kapitza's pendulum",
    )


def spherical() -> lg.System:
    """Return a pendulum in space, g = l = 1, in spherical angles from below."""
    theta, phi = lg.coordinates("theta phi")
    return lg.System(
        kinetic=(theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2, potential=-cos(theta), name="spherical pendulum"
    )


def cartesian(theta: float, phi: float) -> NDArray[Any]:
    """Return the place of the bob."""
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])


@cache
def _sphere() -> list[Any]:
    x, y, z, u, v, w = symbols = hy.make_vars("x", "y", "z", "u", "v", "w")
    pull = z - (u * u + v * v + w * w)
    return in_80_bits(list(zip(symbols, (u, v, w, pull * x, pull * y, pull * z - LONG(1)), strict=True)))


def spherical_truth(theta: float, turn: float, end: float) -> tuple[NDArray[Any], float]:
    """Return the bob's place by r'' = -g + (g.r - v^2) r on the unit sphere, and how far two tolerances are apart."""
    angle = LONG(theta)
    start = np.array([np.sin(angle), 0, -np.cos(angle), 0, np.sin(angle) * LONG(turn), 0], dtype=LONG)
    fine, rough = (propagated(taylor, start, [end])[0][:3] for taylor in _sphere())
    return fine, float(np.abs(fine - rough).max())


def light_double_pendulum(mass: float) -> lg.System:
    """Return a double pendulum with a light lower bob."""
    system = double_pendulum(cartesian=True)
    stated = system.statement
    values = {symbol: mass if symbol.name == "m2" else 1.0 for symbol in system.parameters}
    values = {symbol: GRAVITY if symbol.name == "g" else value for symbol, value in values.items()}
    a, b = system.coordinates
    return lg.System(
        kinetic=stated.kinetic,
        potential=stated.potential,
        coordinates=[a, b],
        parameters=values,
        initial={a: 1.0, b: 2.0},
        name="light double pendulum",
    )


def pendulum_angle(amplitude: float, gravity: float, end: float) -> float:
    """Return the angle of a single pendulum that starts at rest."""
    k2 = np.sin(amplitude / 2) ** 2
    return float(2 * np.arcsin(np.sqrt(k2) * ellipj(ellipk(k2) - np.sqrt(gravity) * end, k2)[0]))


def elastic_pendulum(k: float) -> lg.System:
    """Return a bob on a spring that starts stretched by a little."""
    r, theta = lg.coordinates("r theta")
    stiffness = lg.parameters("k")
    return lg.System(
        kinetic=(r.dot**2 + r**2 * theta.dot**2) / 2,
        potential=stiffness * (r - 1) ** 2 / 2 - sympy.Rational(981, 100) * r * cos(theta),
        coordinates=[r, theta],
        parameters={stiffness: k},
        initial={r: 1.0 + 1.0 / k, theta: 1.0},
        name=f"elastic pendulum {k:g}",
    )


def rigid_body() -> lg.System:
    """Return a free body in Euler's angles z-x-z, which starts close to the separatrix of its middle axis."""
    phi, theta, psi = lg.coordinates("phi theta psi")
    moments = lg.parameters("I1 I2 I3")
    rates = (
        phi.dot * sin(theta) * sin(psi) + theta.dot * cos(psi),
        phi.dot * sin(theta) * cos(psi) - theta.dot * sin(psi),
        phi.dot * cos(theta) + psi.dot,
    )
    return lg.System(
        kinetic=lg.rotational_energy(moments, rates),
        coordinates=[phi, theta, psi],
        parameters=dict(zip(moments, MOMENTS, strict=True)),
        initial={theta: np.pi / 2, theta.dot: START_RATES[0], psi.dot: START_RATES[2]},
        name="free rigid body",
    )


def body_rates(y: NDArray[Any]) -> NDArray[Any]:
    """Return the angular velocity in the body, (3, N), from states in Euler's angles."""
    _, theta, psi, turn, nod, spin = y
    return np.array(
        [
            turn * np.sin(theta) * np.sin(psi) + nod * np.cos(psi),
            turn * np.sin(theta) * np.cos(psi) - nod * np.sin(psi),
            turn * np.cos(theta) + spin,
        ]
    )


def _constants() -> tuple[NDArray[Any], float, float]:
    """Return the amplitudes, the rate and k^2 of Landau and Lifshitz, Mechanics, section 37."""
    i1, i2, i3 = MOMENTS
    twice_energy = sum(i * w * w for i, w in zip(MOMENTS, START_RATES, strict=True))
    square = sum((i * w) ** 2 for i, w in zip(MOMENTS, START_RATES, strict=True))
    high, low = twice_energy * i3 - square, square - twice_energy * i1
    amplitudes = np.sqrt([high / (i1 * (i3 - i1)), high / (i2 * (i3 - i2)), low / (i3 * (i3 - i1))])
    return amplitudes, float(np.sqrt((i3 - i2) * low / (i1 * i2 * i3))), (i2 - i1) * high / ((i3 - i2) * low)


def jacobi_rates(t: NDArray[Any]) -> NDArray[Any]:
    """Return the angular velocity in the body by Jacobi's functions, (3, N)."""
    amplitudes, rate, k2 = _constants()
    sn, cn, dn, _ = ellipj(rate * t, k2)
    return np.asarray(amplitudes[:, None] * np.array([cn, sn, dn]))


def flips() -> int:
    """Return how often the middle axis turns over within the run."""
    _, rate, k2 = _constants()
    return int(BODY_END * rate / (2 * ellipk(k2)))


def scaled_kepler(method: str, size: float) -> float:
    """Return how far an orbit in other units is from the one in natural units, in those."""
    length, time = size, size**0.5
    return _scaled(kepler().compile(), method, (1.0, 0.0, 0.0, 0.8), length, time, {"mu": length**3 / time**2}, 20.0)


def scaled_double_pendulum(method: str, size: float) -> float:
    """Return how far a double pendulum in other units is from the one in natural units, in those."""
    time = size**0.5
    parameters = {"m1": size, "m2": size, "l1": size, "l2": size, "g": GRAVITY * size / time**2}
    return _scaled(double_pendulum().compile(), method, (0.5, 0.5, 0.0, 0.0), 1.0, time, parameters, 5.0)


@cache
def _natural(name: str, method: str, end: float, start: tuple[float, ...]) -> NDArray[Any]:
    model = {"Kepler": kepler, "double pendulum": double_pendulum}[name]().compile()
    unit = {"mu": 1.0} if name == "Kepler" else {"m1": 1.0, "m2": 1.0, "l1": 1.0, "l2": 1.0, "g": GRAVITY}
    return lg.flow(model, method=method, rtol=1e-13, atol=1e-16)(np.array(start), 0.0, end, unit)


def _scaled(
    model: lg.Model,
    method: str,
    start: tuple[float, ...],
    length: float,
    time: float,
    parameters: Mapping[str, float],
    end: float,
) -> float:
    n = model.dimension
    units = np.array([length] * n + [length / time] * n)
    flow = lg.flow(model, method=method, rtol=1e-13, atol=1e-16 * float(units[-1]), max_steps=1_000_000)
    found = flow(np.array(start) * units, 0.0, end * time, parameters) / units
    return float(np.abs(found - _natural(model.statement.name, method, end, start)).max())


class Claims:
    """Random starts of a fast double pendulum: how long runs are said to hold, and whether they do."""

    def __init__(self, span: float, error: float) -> None:
        self.span, self.error = span, error
        self.system = double_pendulum()
        self.model = self.system.compile()
        self.truth = in_80_bits(equations(Case("trust", "", double_pendulum, (), span), self.system, LONG))[0]

    def held(self, seed: int, method: str, options: Mapping[str, Any]) -> tuple[float, float]:
        """Return the horizon of a run, and its largest error at ten times until then."""
        rng = np.random.default_rng(seed)
        start = np.array([*rng.uniform(-np.pi, np.pi, 2), *rng.uniform(-6.0, 6.0, 2)])
        initial = dict(zip(("theta1", "theta2", "theta1_dot", "theta2_dot"), start.tolist(), strict=True))
        chosen: dict[str, Any] = {"method": method, **options}
        horizon = lg.trust_horizon(self.model, (0.0, self.span), initial, error=self.error, **chosen)
        times = np.linspace(0.0, float(horizon), 11)[1:]
        right = propagated(self.truth, start, times.tolist())
        run = lg.integrate(self.model, (0.0, float(times[-1])), initial, **chosen)
        whole = lg.integrate(self.model, (0.0, self.span), initial, **chosen) if method != "rk4" else run
        return float(horizon), float(np.abs(whole.at(times).T - right).max())
