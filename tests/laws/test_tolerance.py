"""Errors within tolerances in any units, and hard cases with a closed form or a published result.

The growth is measured: the initial state and later states are changed a little, and the largest effect at the end
counts.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import combinations, pairwise, product
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk, mathieu_a
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.export.elimination import ROWS, factored, solved
from lagrange.machine.model import Model
from lagrange.trajectory.run import Flow
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import FloatArray
from tests.models import SCENE_NAMES, build, model, shared_scene, stated_in, x, y
from tests.trajectory.runs import ADAPTIVE

HELD = {"constraints", "contacts", "rotations"}
SCENES = tuple(name for name in SCENE_NAMES if name != "two-point-vortices" and HELD.isdisjoint(stated_in(name)))
"""States are moved one entry at a time, which those of the other scenes may not be."""

MODELS = ("Henon-Heiles", "coupled masses", "8 carried masses", "cart and pole", "chain of 7")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)

PLACES = 8
"""At so many places along the run an error is let in."""

SHIFT = 1e-7
"""Large against round-off and small against the motion: its effect is linear to some digits."""


@cache
def compiled(name: str) -> Model:
    return shared_scene(name).compile(check=False) if name in SCENES else model(name)


def exact(name: str) -> Flow:
    return flow_of(compiled(name), rtol=1e-16, atol=1e-20)


@cache
def course(name: str) -> tuple[float, FloatArray, FloatArray, float]:
    """Return the end time, the end state, the size of each entry, and the factor by which errors grow."""
    run: Any = exact(name)
    end = min(compiled(name).statement.run.t_end, 20.0)
    start = np.array(compiled(name).statement.initial)
    last = run(start, 0.0, end)
    size = np.maximum(np.maximum(np.abs(start), np.abs(last)), 1e-12)
    growth = 1.0
    for place in range(PLACES):
        t = end * place / PLACES
        y = run(start, 0.0, t)
        for i in range(len(y)):
            moved = y.copy()
            moved[i] += SHIFT * max(abs(y[i]), size[i])
            growth = max(growth, float((np.abs(run(moved, t, end) - last) / size).max() / SHIFT))
    return end, last, size, growth


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [*SCENES, *MODELS])
def test_the_reference_agrees_with_another_method(name: str) -> None:
    """The other method is DOP853 near round-off, whose error is about a hundred tolerances times the growth."""
    end, last, size, growth = course(name)
    other = flow_of(compiled(name), method="dop853", rtol=1e-13, atol=1e-16)(compiled(name).statement.initial, 0.0, end)
    assert (np.abs(other - last) / size).max() < 100 * 1e-13 * growth


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("name", [*SCENES, *MODELS])
def test_the_error_is_within_the_tolerance(name: str, tolerance: float) -> None:
    """Steps aim at a tenth of the tolerance, so that their sum stays within it. At 1e-14 rounding counts as well."""
    end, last, size, growth = course(name)
    flow = flow_of(compiled(name), rtol=tolerance, atol=tolerance * 1e-3)
    result = flow(compiled(name).statement.initial, 0.0, end)
    assert (np.abs(result - last) / size).max() <= growth * (tolerance + 2e-14)


# --- energy growth --------------------------------------------------------------------------------------------
# Over long runs the error of the energy grows like a sum of random roundings, with the square root of time.
#
# Anything that has the same sign at every step would grow with time itself: a truncation that is not far below
# round-off, or a constant such as 1/3 rounded once and multiplied at every step.

FASTEST = 0.6
"""The exponent of time allowed. It is 0.5 for independent roundings; eight starts leave it uncertain by 0.1."""


def exponent(flow: Flow, energy: lg.Model, starts: list[FloatArray], times: tuple[float, float]) -> float:
    """Return the exponent of the growth in time of the root mean square error of the energy."""
    n = energy.dimension
    sizes = []
    for t in times:
        errors = []
        for start in starts:
            end = flow(start, 0.0, t)
            first = energy.energy(start[:n], start[n:])
            errors.append((energy.energy(end[:n], end[n:]) - first) / first)
        sizes.append(math.sqrt(np.mean(np.square(errors))))
    assert sizes[0] > 0
    return math.log(sizes[1] / sizes[0]) / math.log(times[1] / times[0])


@pytest.mark.slow
def test_kepler_over_a_hundred_thousand_orbits() -> None:
    orbit = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2))
    flow = flow_of(orbit, rtol=1e-16, atol=1e-16)
    starts = [np.array([0.4 + 1e-3 * k, 0.0, 0.0, 2.0]) for k in range(8)]
    assert exponent(flow, orbit, starts, (2e3 * math.pi, 2e5 * math.pi)) < FASTEST


# --- hard cases with a closed form or a published result, for all explicit adaptive methods of order 5 or more ---


METHODS = [
    row.name
    for row in lg.methods.table()
    if row.claims.adaptive and row.claims.explicit and row.claims.order >= 5 and not row.name.startswith("scipy-")
]
TIGHT: dict[str, Any] = {"rtol": 1e-13, "atol": 1e-16}

theta, phi, psi = lg.coordinates("theta phi psi")


def kepler_state(r: float, v: float, end: float) -> list[float]:
    """Return the state of a Kepler orbit (mu = 1) that starts at the pericentre, from the exact initial doubles."""
    with mpmath.workdps(40):
        axis = 1 / (2 / mpmath.mpf(r) - mpmath.mpf(v) ** 2)
        e, motion = 1 - r / axis, axis ** mpmath.mpf("-1.5")
        low, high = motion * end - e, motion * end + e
        for _ in range(140):
            middle = (low + high) / 2
            low, high = (middle, high) if middle - e * mpmath.sin(middle) < motion * end else (low, middle)
        return [float(axis * (mpmath.cos(low) - e)), float(axis * mpmath.sqrt(1 - e * e) * mpmath.sin(low))]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("e", "allowed"), [(0.99, 1e-8), (0.9999, 1e-6)])
def test_an_orbit_that_is_nearly_a_fall(method: str, e: float, allowed: float) -> None:
    """The run has three revolutions.

    Round-off at the pericentre changes the period by 1e-16/(1 - e). A tolerance of 1e-13 may have a thousand times
    this effect.
    """
    orbit = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2), name="orbit")
    r, v = 1 - e, math.sqrt((1 + e) / (1 - e))
    run = orbit.run(20.0, {x: r, y.dot: v}, method=method, **TIGHT).require()
    assert run.y[:2, -1] == pytest.approx(kepler_state(r, v, 20.0), abs=allowed)


def attracting(masses: Sequence[float], places: Any, velocities: Any) -> lg.System:
    """Return point masses in the plane that attract each other, with G = 1."""
    points = [lg.coordinates(f"x{i} y{i}") for i in range(len(masses))]
    initial: dict[Any, float] = {}
    for point, place, velocity in zip(points, places, velocities, strict=True):
        initial |= dict(zip((*point, *(q.dot for q in point)), (*place, *velocity), strict=True))
    potential = sum(
        -masses[i] * masses[j] / sqrt(sum((a - b) ** 2 for a, b in zip(points[i], points[j], strict=True)))
        for i, j in combinations(range(len(masses)), 2)
    )
    return lg.System(
        kinetic=sum(lg.kinetic_energy(m, point) for m, point in zip(masses, points, strict=True)),
        potential=potential,
        coordinates=[q for point in points for q in point],
        initial=initial,
        name="bodies",
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_the_figure_eight_returns(method: str) -> None:
    """Start and period as published to 14 digits (A. Chenciner, R. Montgomery, 2000, after C. Simo)."""
    place, speed = (0.97000435669734, -0.24308753153583), (-0.93240737144104, -0.86473146092102)
    half = (-speed[0] / 2, -speed[1] / 2)
    eight = attracting((1, 1, 1), (place, (-place[0], -place[1]), (0, 0)), (half, half, speed))
    run = eight.run(6.32591398292621, method=method, **TIGHT).require()
    assert run.y[:, -1] == pytest.approx(run.y[:, 0], abs=2e-11)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_burraus_bodies_part_as_published(method: str) -> None:
    """The mass 3 escapes from the other two (V. Szebehely, C. F. Peters, Astron. J. 72, 1967)."""
    places = np.array([(1, 3), (-2, -1), (1, -1)])
    run = attracting((3, 4, 5), places, ((0, 0),) * 3).run(80.0, method=method, **TIGHT).require()
    where, moving = (part.reshape(3, 2) for part in np.split(run.y[:, -1], 2))
    bound = [
        (i, j)
        for i, j in combinations(range(3), 2)
        if (((moving[i] - moving[j]) ** 2).sum() / 2 < (7 + i + j - 1) / np.linalg.norm(where[i] - where[j]))
    ]
    assert run.energy[0] == pytest.approx(-769 / 60, rel=1e-15)
    assert bound == [(1, 2)]
    assert np.linalg.norm(where[0]) > 10.0


@pytest.mark.few
@pytest.mark.parametrize("method", METHODS)
def test_the_threshold_of_kapitzas_pendulum(method: str) -> None:
    """theta'' = (g - a omega^2 cos(omega t)) theta/l becomes stable at -4 g/(l omega^2) = a_0(2 a/l) of Mathieu."""
    a = lg.parameters("a")
    omega, g = 20.0, 9.81
    place = (sin(theta), a * cos(omega * lg.t) + cos(theta))
    shaken = lg.System(kinetic=lg.kinetic_energy(1, place), potential=g * place[1], parameters={a: 0.2}, name="shaken")
    flow, tiny, period = lg.flow(shaken.compile(), method=method, rtol=1e-12, atol=1e-24), 1e-9, 2 * math.pi / omega

    def trace(amplitude: float) -> float:
        ends = [flow(np.array(start) * tiny, 0.0, period, {a: amplitude}) for start in ([1.0, 0.0], [0.0, 1.0])]
        return float((ends[0][0] + ends[1][1]) / tiny - 2)

    threshold = brentq(lambda q: mathieu_a(0, q) + 4 * g / omega**2, 1e-3, 0.8, xtol=1e-15) / 2
    assert brentq(trace, 0.1, 0.4, xtol=1e-15) == pytest.approx(threshold, rel=1e-10)
    assert threshold == pytest.approx(math.sqrt(2 * g) / omega, rel=0.02)  # a^2 omega^2 = 2 g l, to leading order


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turn", [1e-3, 1e-6])
def test_a_spherical_pendulum_passes_its_pole(method: str, turn: float) -> None:
    """Near the pole the azimuth changes by pi at once. For a small angular momentum the motion is that in a plane."""
    swing = lg.System(
        kinetic=(theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2, potential=-cos(theta), coordinates=[theta, phi]
    )
    run = swing.run(20.0, {theta: 1.0, phi.dot: turn}, method=method, **TIGHT).require()
    k2 = math.sin(0.5) ** 2
    alone = 2 * np.arcsin(math.sqrt(k2) * ellipj(ellipk(k2) - run.t, k2)[0])
    place = np.array([np.sin(run["theta"]) * np.cos(run["phi"]), -np.cos(run["theta"])])
    assert np.abs(place - [np.sin(alone), -np.cos(alone)]).max() < 20 * turn**2 + 1e-10
    assert np.abs(np.sin(run["theta"])).min() < 0.1
    momentum = run.evaluate(sin(theta) ** 2 * phi.dot)
    assert momentum == pytest.approx(math.sin(1.0) ** 2 * turn, rel=1e-9)


# --- the same motion in other units has the same digits: no step, tolerance or floor depends on an absolute size ---


z, r = lg.coordinates("z r")
a, b, c, d = lg.coordinates("a b c d")
m, k, g, ell, mu, drag, force, omega = lg.parameters("m k g ell mu drag force omega")

MASS, LENGTH, TIME = np.eye(3)
STIFFNESS, FORCE = MASS - 2 * TIME, MASS + LENGTH - 2 * TIME
UNITS_OF = {
    m: MASS,
    k: STIFFNESS,
    g: LENGTH - 2 * TIME,
    ell: LENGTH,
    mu: 3 * LENGTH - 2 * TIME,
    drag: MASS - TIME,
    force: FORCE,
    omega: -TIME,
}
"""The exponents of mass, length and time in every parameter."""

OWN = ("bs3", "dopri5", "tsit5", "verner9", "dop853", "radau3", "radau5", "taylor")
THEIRS = ("scipy-rk45", "scipy-rk23", "scipy-dop853", "scipy-radau", "scipy-bdf", "scipy-lsoda", "cvode")
LOW = {"bs3": 1e-5, "radau3": 1e-5, "scipy-rk23": 1e-4, "scipy-bdf": 1e-6, "cvode": 1e-6, "scipy-rk45": 1e-6}
"""Tolerances of methods that would take too many steps at the default."""

UNITS = ((0, -30, 0), (0, -9, 0), (0, 9, 0), (0, 30, 0), (0, 0, -12), (0, 0, 12), (-20, 7, 0), (20, -25, 10))
"""Powers of ten by which masses, lengths and times are as large."""

ROUND_OFF = 1e-12
"""Errors below this are round-off, which is not the same in other units."""


@dataclass(frozen=True, eq=False)
class Case:
    """A motion in SI units, with coordinates and parameters near one.

    `lengths` flags the coordinates that are lengths.
    """

    system: lg.System
    lengths: tuple[bool, ...]
    start: dict[Any, float]
    end: float
    values: dict[Any, float]

    @property
    def names(self) -> tuple[Any, ...]:
        return tuple(self.system.compile().statement.coordinates)


def case(lengths: str, end: float, start: dict[Any, float], values: dict[Any, float], **stated: Any) -> Case:
    system = lg.System(parameters=values, initial=start, **stated)
    return Case(system, tuple(letter == "L" for letter in lengths), start, end, values)


def kinetic(*coordinates: Any) -> Any:
    return m * sum(q.dot**2 for q in coordinates) / 2


def springs(*stations: Any) -> Any:
    return k * sum((p - q) ** 2 for p, q in pairwise(stations)) / 2


swing = m * ell**2 * theta.dot**2 / 2 + m * g * ell * cos(theta)

CASES = {
    "pendulum": case("A", 6.0, {theta: 2.0}, {m: 1, g: 9, ell: 1}, lagrangian=swing, coordinates=[theta]),
    "spring": case("L", 9.0, {x: 1.5}, {m: 1, k: 2}, kinetic=kinetic(x), potential=k * x**2 / 2, coordinates=[x]),
    "orbit": case(
        "LL", 7.0, {x: 0.4, y.dot: 2.0}, {m: 1, mu: 1},
        kinetic=kinetic(x, y), potential=-m * mu / sqrt(x**2 + y**2), coordinates=[x, y],
    ),
    "elastic pendulum": case(
        "LA", 5.0, {r: 1.2, theta: 1.0}, {m: 1, k: 30, g: 9, ell: 1},
        kinetic=m * (r.dot**2 + r**2 * theta.dot**2) / 2,
        potential=k * (r - ell) ** 2 / 2 - m * g * r * cos(theta), coordinates=[r, theta],
    ),
    "driven from rest": case(
        "L", 9.0, {}, {m: 1, k: 2, force: 1, omega: 3, drag: 0.2},
        kinetic=kinetic(x), potential=k * x**2 / 2, coordinates=[x],
        forces={x: force * sin(omega * lg.t) - drag * x.dot},
    ),
    "plucked chain": case(
        "LLLLLLLL", 9.0, {a: 1.0}, {m: 1, k: 1},
        kinetic=kinetic(a, b, c, d, x, y, z, r),
        potential=k * (a**2 + r**2) / 2 + springs(a, b, c, d, x, y, z, r), coordinates=[a, b, c, d, x, y, z, r],
    ),
}  # fmt: skip


def run(name: str, method: str, powers: tuple[int, int, int], *, base: float = 10.0, **options: Any) -> NDArray[Any]:
    """Return the states (2n, N) of a run in other units, converted to SI units."""
    one = CASES[name]
    mass, length, time = (base**power for power in powers)
    model = one.system.compile()
    factor = dict(zip(one.names, (length if lengthy else 1.0 for lengthy in one.lengths), strict=True))
    start = {key: value * _factor(key, factor, time) for key, value in one.start.items()}
    values = {}
    for key, value in one.values.items():
        p, q, s = UNITS_OF[key]
        values[key] = value * mass**p * length**q * time**s
    result = lg.integrate(model, (0.0, one.end * time), start, method=method, parameters=values, **options)
    assert result.status is lg.Status.SUCCESS, result.message
    sizes = np.array([factor[q] for q in one.names] + [factor[q] / time for q in one.names])
    return np.asarray(result.y / sizes[:, None])


def _factor(key: Any, factor: dict[Any, float], time: float) -> float:
    return factor[key] if key in factor else next(f / time for q, f in factor.items() if q.dot == key)


@lru_cache(maxsize=64)
def truth(name: str) -> NDArray[Any]:
    return run(name, "dop853", (0, 0, 0), rtol=1e-13)


@lru_cache(maxsize=1024)
def error(name: str, method: str, powers: tuple[int, int, int]) -> float:
    """Return the largest error of the last state, relative to the largest size of each entry along the run."""
    right = truth(name)
    options = {"rtol": LOW[method]} if method in LOW else {}
    sizes = np.abs(right).max(axis=1)
    apart = np.abs(run(name, method, powers, **options)[:, -1] - right[:, -1])
    return max(float(np.max(apart / np.where(sizes > 0, sizes, 1.0))), ROUND_OFF)


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "method"), [*product(CASES, OWN)])
def test_a_motion_is_the_same_in_all_units(name: str, method: str) -> None:
    plain = error(name, method, (0, 0, 0))
    for powers in UNITS:
        assert plain / 10 <= error(name, method, powers) <= 10 * plain, powers
    if method.startswith("radau") and len(set(CASES[name].lengths)) > 1:
        return  # How Newton's matrix is balanced depends on the units of its rows, where these differ.
    # Powers of two change no rounding.
    options = {"rtol": LOW[method]} if method in LOW else {}
    here, there = run(name, method, (0, 0, 0), **options), run(name, method, (-40, 60, 0), base=2.0, **options)
    assert np.array_equal(here, there)


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "method"), [*product(("orbit", "driven from rest", "plucked chain"), THEIRS)])
def test_solvers_of_other_packages_have_the_same_errors_in_all_units(name: str, method: str) -> None:
    if method == "cvode":
        pytest.importorskip("sksundae")
    plain = error(name, method, (0, 0, 0))
    for powers in ((0, -30, 0), (0, 30, 0), (0, 0, 12), (20, -25, 10)):
        assert plain / 10 <= error(name, method, powers) <= 10 * plain, powers


# --- rods -----------------------------------------------------------------------------------------------------
# Rods with random masses move alike in random units of mass, length and time.


LIGHTEST = 1e-3
"""Mass of some bodies, in the unit of the others: solutions without pivoting then miss their constraints."""

SEEDS = range(30)
FAR = 12
"""Powers of ten of the units, from -FAR to FAR. The square of a length is in a constraint."""


UNSCALED = "radau5-index2"
"""Method whose unknowns are multipliers too, which Newton's method takes in the units of the system."""


def rods(draw: random.Random, unit: tuple[float, float, float]) -> tuple[lg.System, float]:
    """Return one to three bodies on rods in Cartesian coordinates, and the duration of a run.

    Half of the systems hang at rest except for one body. `unit` has the units of mass, length and time. The same
    random numbers give the same system in other units.
    """
    mass, length, time = unit
    count = draw.randint(1, 3)
    q = lg.coordinates(" ".join(f"x{i} y{i}" for i in range(count)))
    masses = [draw.choice([1.0, 1.0, 5.0, LIGHTEST]) for _ in range(count)]
    angles = [draw.uniform(-2.0, 2.0) for _ in range(count)]
    if draw.random() < 0.5:
        angles = [0.0] * (count - 1) + [draw.choice([0.5, 1e-3])]
    ends = np.cumsum([(np.sin(a), -np.cos(a)) for a in angles], axis=0) * length
    joints = [(0, 0), *zip(q[::2], q[1::2], strict=True)]
    system = lg.System(
        m * sum(w * (x.dot**2 + y.dot**2) for w, x, y in zip(masses, q[::2], q[1::2], strict=True)) / 2,
        m * g * sum(w * y for w, y in zip(masses, q[1::2], strict=True)),
        coordinates=list(q),
        constraints=[(x - a) ** 2 + (y - b) ** 2 - ell**2 for (a, b), (x, y) in pairwise(joints)],
        parameters={m: mass, g: 9.81 * length / time**2, ell: length},
        initial=dict(zip(q, map(float, ends.ravel()), strict=True)),
    )
    return system, draw.uniform(0.5, 1.5) * time


def ended(seed: int, unit: tuple[float, float, float], method: str, rtol: float) -> NDArray[Any]:
    """Return the last state of a run, converted to SI units."""
    system, end = rods(random.Random(seed), unit)
    run = lg.integrate(system.compile(check=False), (0.0, end), method=method, rtol=rtol)
    assert run.status is lg.Status.SUCCESS, run.message
    last = run.y[:, -1] / unit[1]
    last[len(last) // 2 :] *= unit[2]
    return np.asarray(last)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_motion_of_rods_is_the_same_in_all_units(seed: int) -> None:
    draw = random.Random(1000 + seed)
    unit = (10.0 ** draw.uniform(-FAR, FAR), 10.0 ** draw.uniform(-FAR, FAR), 10.0 ** draw.uniform(-FAR, FAR))
    method = draw.choice([name for name in ADAPTIVE if name != UNSCALED])
    expected = ended(seed, (1.0, 1.0, 1.0), "taylor", 1e-14)
    result = ended(seed, unit, method, 1e-7)
    # Runs of a tenth of a second to a second multiply the errors of steps by less than 1,000.
    assert result == pytest.approx(expected, abs=1e-4)


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="the rows and columns of multipliers in Newton's matrix are not scaled")
def test_multipliers_may_be_unknowns_in_all_units() -> None:
    ended(27, (3e-12, 6e9, 10.0), UNSCALED, 1e-7)


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("seed", SEEDS)
def test_accelerations_of_rods_are_the_same_in_all_units(seed: int, target: str) -> None:
    (plain, _), (scaled, unit) = rods(random.Random(seed), (1.0, 1.0, 1.0)), in_units(seed)
    expected, result = (
        each.compile(target, check=False).rhs(0.0, list(each.statement.initial)) for each in (plain, scaled)
    )
    # A light body is accelerated by forces that are a thousand times as large: 1e3 of 1e-16.
    assert result / unit == pytest.approx(expected, abs=1e-11 * max(1.0, np.abs(expected).max()))


def in_units(seed: int) -> tuple[lg.System, float]:
    """Return rods in random units, and the unit of acceleration."""
    draw = random.Random(2000 + seed)
    mass, length, time = (10.0 ** draw.uniform(-FAR, FAR) for _ in range(3))
    return rods(random.Random(seed), (mass, length, time))[0], length / time**2


UNSCALED_SEEDS = (3, 23, 36, 41, 52, 153)
"""Systems that were singular in exports that compared an inertia with a constraint, and others."""


@pytest.mark.parametrize("seed", UNSCALED_SEEDS)
def test_printed_eliminations_solve_rods_in_all_units(seed: int) -> None:
    system, unit = in_units(seed)
    model = system.compile("numpy", check=False)
    equations, start = model.equations, np.array(system.statement.initial)
    n, count = len(equations.matrix), len(equations.q)
    a, x = np.zeros((n + ROWS, n)), np.zeros(n)
    entries = tuple(entry for i, row in enumerate(equations.matrix) for entry in row[: i + 1])
    a[np.tril_indices(n)] = model.function("matrix", entries)(0.0, start, model.parameter_array())
    # At rest the accelerations are those of gravity and rods: M a + G^T z = -dV/dq and G a = 0.
    forces = model.evaluate("forces", *model.layout.split(start))
    assert not factored(n, a)
    solved(n, a, np.append(forces, np.zeros(n - count)), x)
    expected = model.rhs(0.0, start)[model.layout.v]
    assert x[:count] / unit == pytest.approx(expected / unit, abs=1e-11 * max(1.0, np.abs(expected / unit).max()))


@pytest.mark.few(1)
@pytest.mark.parametrize("library", [pytest.param("jax", marks=pytest.mark.slow), "casadi"])
@pytest.mark.parametrize("seed", UNSCALED_SEEDS[::2])
def test_traced_accelerations_of_rods_are_the_same_in_all_units(seed: int, library: str) -> None:
    pytest.importorskip(library)
    system, unit = in_units(seed)
    model = system.compile(check=False)
    start, values = np.array(system.statement.initial), model.parameter_array()
    if library == "jax":
        import jax

        jax.config.update("jax_enable_x64", val=True)
        result, singular = model.as_jax().checked(0.0, start, values)
    else:
        result, singular = model.as_casadi(status=True)(0.0, start, values)
    expected = model.rhs(0.0, start) / unit
    assert not bool(singular)
    allowed = 1e-11 * max(1.0, np.abs(expected).max())
    assert np.array(result).ravel() / unit == pytest.approx(expected, abs=allowed)
