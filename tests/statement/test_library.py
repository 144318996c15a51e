"""The scene library: each scene loads, names its source, and has the equations of a book."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
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


def attraction(bodies: Mapping[str, str], axes: str) -> tuple[str, ...]:
    """Return Newton's law of gravitation for bodies, by the endings of their coordinates and their masses."""

    def cubed(i: str, j: str) -> str:
        return f"({' + '.join(f'({axis}{i} - {axis}{j})**2' for axis in axes)})**(3/2)"

    return tuple(
        f"{axis}{i}_ddot = "
        + " + ".join(f"G*{mass}*({axis}{j} - {axis}{i})/{cubed(i, j)}" for j, mass in bodies.items() if j != i)
        for axis in axes
        for i in bodies
    )


DRAG = "gamma*D**2*sqrt(x_dot**2 + y_dot**2)"
BOOK: dict[str, tuple[str, ...]] = {
    "rock": ("x'' = 0", "y'' = -g"),
    "falling-ball": ("m*y'' = -m*g + rho*g*4/3*pi*r**3 - rho*c*pi*r**2*abs(y')*y'",),
    "thrown-ball": (f"m*x'' = -{DRAG}*x'", f"m*y'' = -m*g - {DRAG}*y'"),
    "mass-on-spring": ("m*x'' = -k*(x - rest) - c*x'",),
    "pendulum": ("theta'' = -g/l*sin(theta)",),
    "double-pendulum": (
        "(m1 + m2)*l1*theta1'' + m2*l2*theta2''*cos(theta1 - theta2) + m2*l2*theta2'**2*sin(theta1 - theta2)"
        " + (m1 + m2)*g*sin(theta1) = 0",
        "l2*theta2'' + l1*theta1''*cos(theta1 - theta2) - l1*theta1'**2*sin(theta1 - theta2) + g*sin(theta2) = 0",
    ),
    "elastic-pendulum": (
        "r'' = r*theta'**2 + g*cos(theta) - k/m*(r - rest)",
        "r*theta'' = -g*sin(theta) - 2*r'*theta'",
    ),
    "spherical-pendulum": (
        "theta'' = sin(theta)*cos(theta)*phi'**2 - g/l*sin(theta)",
        "sin(theta)*phi'' = -2*cos(theta)*theta'*phi'",
    ),
    # Gravity along the tangent of the hoop, whose plane has turned by Omega t about the tilted axis.
    "bead-on-hoop": (
        "R*theta'' = R*Omega**2*sin(theta)*cos(theta) - g*(cos(tilt)*sin(theta) - sin(tilt)*cos(theta)*cos(Omega*t))",
    ),
    "charge-in-field": ("m*x'' = q*B*y'", "m*y'' = -q*B*x'", "z'' = 0"),
    "kepler": tuple(f"{axis}'' = -mu*{axis}/(x**2 + y**2)**(3/2)" for axis in "xy"),
    "sun-earth-moon": attraction({"s": "ms", "e": "me", "m": "mm"}, "xyz"),
    "chain-of-springs": (
        "m*x1'' = k*(x2 - 2*x1)",
        *(f"m*x{i}'' = k*(x{i - 1} - 2*x{i} + x{i + 1})" for i in (2, 3, 4)),
        "m*x5'' = k*(x4 - 2*x5)",
    ),
    "henon-heiles": ("x'' = -x - 2*x*y", "y'' = -y - x**2 + y**2"),
    "pleiades": attraction({str(i): f"m{i}" for i in range(1, 8)}, "xy"),
}
"""Equations of motion as in books."""


def test_the_library_is_complete() -> None:
    assert set(NAMES) >= REQUIRED
    assert set(BOOK) == set(FREE)
    assert {*BOOK, *FORMULATIONS, "seven-body-mechanism", *APART} == set(NAMES) and len(APART) == 20


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
def test_every_scene_has_the_equations_of_the_book(name: str) -> None:
    assert shared_scene(name).compare([*BOOK[name]])


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
