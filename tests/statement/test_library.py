"""The scene library: each scene loads, names its source, and has accelerations derived by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.statement.coordinate import t
from lagrange.statement.scene.library import LIBRARY, library
from lagrange.statement.statement import Statement
from tests.mechanisms.scenes import FORMULATIONS
from tests.models import loaded, shared_scene, stated_in

NAMES = [entry.name for entry in library()]

REQUIRED = {
    *("rock", "falling-ball", "thrown-ball", "mass-on-spring", "pendulum", "double-pendulum", "elastic-pendulum"),
    *("spherical-pendulum", "bead-on-hoop", "charge-in-field", "kepler", "sun-earth-moon", "chain-of-springs"),
    *("henon-heiles", "pleiades", "cartesian-pendulum", "cartesian-double-pendulum", "slider-crank", "four-bar"),
    *("four-bar-change-point", "four-bar-ladder", "bead-on-wire", "atwood-machine", "swinging-atwood-machine"),
    *("rolling-disc", "chaplygin-sleigh", "knife-edge", "differential-drive"),
    *("hanging-chain", "ladder", "particle-on-sphere", "seven-body-mechanism", "two-point-vortices"),
}
APART = {name for name in NAMES if not stated_in(name).isdisjoint({"contacts", "rotations"})}
"""Scenes with contacts and rotations; `tests/contact` and `tests/laws` hold their runs against closed forms."""
HELD = {"constraints", "contacts", "rotations"}
FREE = [name for name in NAMES if name != "two-point-vortices" and HELD.isdisjoint(stated_in(name))]
"""Scenes without constraints and with inertia; `tests/mechanisms` formulates the others independently."""


Formula = Callable[[Mapping[str, float], list[float], list[float], float], list[float]]
"""(parameters, q, v, t) -> accelerations, as on paper."""


def falling_ball(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    weight = p["m"] * p["g"]
    buoyancy = p["rho"] * p["g"] * 4 / 3 * math.pi * p["r"] ** 3
    drag = 0.5 * p["rho"] * v[0] ** 2 * p["c"] * 2 * math.pi * p["r"] ** 2
    return [(buoyancy - weight - math.copysign(drag, v[0])) / p["m"]]


def thrown_ball(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    drag = p["gamma"] * p["D"] ** 2 * math.hypot(*v) / p["m"]
    return [-drag * v[0], -p["g"] - drag * v[1]]


def double_pendulum(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    m1, m2, l1, l2, g = (p[name] for name in ("m1", "m2", "l1", "l2", "g"))
    d = q[0] - q[1]
    bottom = 2 * m1 + m2 - m2 * math.cos(2 * d)
    first = (
        -g * (2 * m1 + m2) * math.sin(q[0])
        - m2 * g * math.sin(q[0] - 2 * q[1])
        - 2 * math.sin(d) * m2 * (v[1] ** 2 * l2 + v[0] ** 2 * l1 * math.cos(d))
    )
    second = (
        2
        * math.sin(d)
        * (v[0] ** 2 * l1 * (m1 + m2) + g * (m1 + m2) * math.cos(q[0]) + v[1] ** 2 * l2 * m2 * math.cos(d))
    )
    return [first / (l1 * bottom), second / (l2 * bottom)]


def elastic_pendulum(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    (r, theta), (rv, w) = q, v
    return [
        r * w**2 + p["g"] * math.cos(theta) - p["k"] / p["m"] * (r - p["rest"]),
        (-p["g"] * math.sin(theta) - 2 * rv * w) / r,
    ]


def spherical_pendulum(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    s, c = math.sin(q[0]), math.cos(q[0])
    return [s * c * v[1] ** 2 - p["g"] / p["l"] * s, -2 * c / s * v[0] * v[1]]


def bead_on_hoop(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    s, c = math.sin(q[0]), math.cos(q[0])
    # gravity along the tangent of the hoop, whose plane has turned by Omega t about the tilted axis
    along = -math.cos(p["tilt"]) * s + math.sin(p["tilt"]) * c * math.cos(p["Omega"] * time)
    return [p["Omega"] ** 2 * s * c + p["g"] / p["R"] * along]


def chain(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    x = [0.0, *q, 0.0]
    return [p["k"] / p["m"] * (x[i - 1] - 2 * x[i] + x[i + 1]) for i in range(1, 6)]


def gravity(masses: list[float], positions: Any) -> Any:
    """Return Newton's gravitational accelerations divided by G, (bodies, axes)."""
    return np.array(
        [
            sum(m * (b - a) / np.linalg.norm(b - a) ** 3 for m, b in zip(masses, positions, strict=True) if b is not a)
            for a in positions
        ]
    )


def sun_earth_moon(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    bodies = list(np.array(q).reshape(3, 3))
    return list(p["G"] * gravity([p["ms"], p["me"], p["mm"]], bodies).ravel())


def pleiades(p: Mapping[str, float], q: list[float], v: list[float], time: float) -> list[float]:
    bodies = list(np.array(q).reshape(2, 7).T)
    return list(p["G"] * gravity([p[f"m{i}"] for i in range(1, 8)], bodies).T.ravel())


FORMULAS: dict[str, Formula] = {
    "rock": lambda p, q, v, time: [0.0, -p["g"]],
    "falling-ball": falling_ball,
    "thrown-ball": thrown_ball,
    "mass-on-spring": lambda p, q, v, time: [(-p["k"] * (q[0] - p["rest"]) - p["c"] * v[0]) / p["m"]],
    "pendulum": lambda p, q, v, time: [-p["g"] / p["l"] * math.sin(q[0])],
    "double-pendulum": double_pendulum,
    "elastic-pendulum": elastic_pendulum,
    "spherical-pendulum": spherical_pendulum,
    "bead-on-hoop": bead_on_hoop,
    "charge-in-field": lambda p, q, v, time: [p["q"] * p["B"] / p["m"] * a for a in (v[1], -v[0], 0.0)],
    "kepler": lambda p, q, v, time: [-p["mu"] * x / math.hypot(*q) ** 3 for x in q],
    "sun-earth-moon": sun_earth_moon,
    "chain-of-springs": chain,
    "henon-heiles": lambda p, q, v, time: [-q[0] - 2 * q[0] * q[1], -q[1] - q[0] ** 2 + q[1] ** 2],
    "pleiades": pleiades,
}


def test_the_library_is_complete() -> None:
    assert set(NAMES) >= REQUIRED
    assert set(FORMULAS) == set(FREE)
    assert {*FORMULAS, *FORMULATIONS, "seven-body-mechanism", *APART} == set(NAMES) and len(APART) == 20


@pytest.mark.few(12)
@pytest.mark.parametrize("entry", library(), ids=lambda entry: entry.name)
def test_every_scene_says_what_it_is_and_where_it_is_from(entry: Any) -> None:
    assert entry.path.stem == entry.name
    assert entry.path.parent == LIBRARY
    assert len(entry.about) > 20
    assert re.search(r"\b(1[6-9]|20)\d\d\b", entry.source), "a source has a year"
    statement = loaded(entry.name)
    assert (statement.name, statement.about, statement.source) == (entry.name, entry.about, entry.source)
    assert statement.positions
    assert statement.run.t_end > 0
    assert statement.run.method is None
    assert set(statement.defaults) == set(statement.parameters)


@pytest.mark.parametrize("name", FREE)
def test_every_scene_moves_as_derived_by_hand(name: str) -> None:
    statement = loaded(name)
    model, formula = shared_scene(name).compile("numpy", check=False), FORMULAS[name]
    parameters = {symbol.name: value for symbol, value in statement.defaults.items()}
    n = len(statement.names)
    start = np.array(statement.initial)
    size = np.abs(start).max()
    for seed in range(5):
        random = np.random.default_rng(seed)
        q, v = start[:n] + 0.1 * size * random.normal(size=n), start[n:] + 0.1 * size * random.normal(size=n)
        if name == "falling-ball":
            v = random.normal(size=1)
        time = float(random.uniform(0, 10))
        expected = np.array(formula(parameters, list(q), list(v), time))
        assert model.accelerations(q, v, time) == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(expected).max())


# --- particular facts --------------------------------------------------------------------------------------------


def value(statement: Statement, name: str) -> float:
    return {symbol.name: value for symbol, value in statement.defaults.items()}[name]


@pytest.mark.parametrize(
    ("name", "masses"),
    [
        ("bead-on-hoop", {"bead": "m"}),
        ("double-pendulum", {"bob1": "m1", "bob2": "m2"}),
        ("elastic-pendulum", {"bob": "m"}),
        ("spherical-pendulum", {"bob": "m"}),
        ("pendulum", {"bob": "m"}),
        ("chain-of-springs", {f"mass{i}": "m" for i in range(1, 6)}),
        ("sun-earth-moon", {"sun": "ms", "earth": "me", "moon": "mm"}),
        ("pleiades", {f"body{i}": f"m{i}" for i in range(1, 8)}),
    ],
)
def test_the_positions_have_the_kinetic_energy(name: str, masses: dict[str, str]) -> None:
    statement = loaded(name)
    total = sum(
        value(statement, mass) * sum(sympy.diff(e, t) ** 2 for e in statement.positions[point]) / 2
        for point, mass in masses.items()
    )
    plain = [x.xreplace(statement.plain).subs(statement.defaults) for x in (total, statement.kinetic)]
    numbers = {symbol: 0.3 + 0.1 * i for i, symbol in enumerate(sorted(plain[1].free_symbols | {t}, key=str))}
    numbers |= dict.fromkeys(plain[0].free_symbols - set(numbers), 0.9)
    first, second = (float(x.subs(numbers)) for x in plain)
    assert first == pytest.approx(second, rel=1e-12)


def test_the_pleiades_start_as_published() -> None:
    statement = loaded("pleiades")
    x, y = [3, 3, -1, -3, 2, -2, 2], [3, -3, 2, 0, 0, -4, 4]
    x_dot, y_dot = [0, 0, 0, 0, 0, 1.75, -1.5], [0, 0, 0, -1.25, 1, 0, 0]
    assert list(statement.initial) == [*x, *y, *x_dot, *y_dot]
    assert [value(statement, f"m{i}") for i in range(1, 8)] == [1, 2, 3, 4, 5, 6, 7]
    assert (statement.run.t_end, statement.run.rtol, statement.run.atol) == (3.0, 1e-12, 1e-14)


def test_sun_earth_and_moon_are_where_they_were() -> None:
    statement = loaded("sun-earth-moon")
    q = np.array(statement.initial[:9]).reshape(3, 3)
    v = np.array(statement.initial[9:]).reshape(3, 3)
    astronomical_unit = 149_597_870_700.0
    earth, moon = q[1] - q[0], q[2] - q[1]
    assert np.linalg.norm(earth) / astronomical_unit == pytest.approx(0.98332, abs=2e-5)  # two days before perihelion
    assert np.linalg.norm(moon) == pytest.approx(400.9e6, rel=1e-3)
    assert np.linalg.norm(v[1] - v[0]) == pytest.approx(30_290, rel=1e-3)
    phase = math.degrees(math.atan2(moon[1], moon[0]) - math.atan2(-earth[1], -earth[0])) % 360
    assert phase == pytest.approx(360 - 62.6, abs=0.5)  # new on 6 January at 18 h
    masses = [value(statement, name) for name in ("ms", "me", "mm")]
    assert masses == pytest.approx([1.98842e30, 5.97219e24, 7.3458e22], rel=1e-5)
