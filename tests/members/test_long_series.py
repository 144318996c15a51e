"""Members whose series are computed in a loop over orders: they end, and find events, as a run of their own does.

A wrong series would not conserve the energy, and a run alone would take its place: these are counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import cos, sin, sqrt

import lagrange as lg
from lagrange.members import lanes
from tests.members.test_member_events import HENON, agree, runs_alone, without_lanes


def chain(links: int) -> lg.System:
    """Return pendulums below one another: the mass matrix moves, and is full."""
    angles = [lg.coordinate(f"theta{i}") for i in range(links)]
    x = y = kinetic = potential = 0
    for angle in angles:
        x, y = x + sin(angle), y - cos(angle)
        kinetic, potential = kinetic + lg.kinetic_energy(1, (x, y)), potential + 9.81 * y
    return lg.System(kinetic=kinetic, potential=potential, coordinates=angles)


def bodies() -> lg.System:
    """Return three bodies in the plane, which attract each other: constant masses, squares and powers."""
    places = [lg.coordinates(f"x{i} y{i}") for i in range(3)]
    pairs = [(a, b) for i, a in enumerate(places) for b in places[:i]]
    return lg.System(
        kinetic=sum(lg.kinetic_energy(1, place) for place in places),
        potential=-sum(1 / sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + 0.1) for a, b in pairs),
        coordinates=[q for place in places for q in place],
    )


@pytest.fixture
def by_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute the smallest series in a loop over orders."""
    monkeypatch.setattr(lanes, "MOST_WRITTEN_OUT", 0)


MADE = {"two links": (2, 1e-9), "four links": (4, 1e-12), "thirteen links": (13, 1e-9)}
"""Orders that are even and odd; an inverse that is written out, and one in loops."""


@pytest.mark.usefixtures("by_order")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (k > 0)) for k, name in enumerate([*MADE, "bodies"])]
)
def test_a_member_ends_where_a_run_of_its_own_ends(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Round-off grows by less than 100 in this time."""
    links, rtol = MADE.get(name, (0, 1e-11))
    system = chain(links) if links else bodies()
    names = system.compile().layout.names()
    rng = np.random.default_rng(4)
    starts = dict(zip(names, rng.uniform(-1.5, 1.5, (len(names), 11)), strict=True))
    given: dict[str, Any] = {"method": "taylor", "rtol": rtol, "keep": ("end", "counts")}
    with runs_alone(monkeypatch) as left:
        together = lg.ensemble(system, 0.5, starts, **given)
    with without_lanes(monkeypatch):
        alone = lg.ensemble(system, 0.5, starts, workers=1, **given)
    assert "side by side" in together.form and "one after" in alone.form and sum(left) == 0
    agree(together, alone, 1e-11)


@pytest.mark.slow
@pytest.mark.usefixtures("by_order")
@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (k > 0)) for k, case in enumerate(list(HENON)[:6])]
)
def test_events_of_a_member_are_those_of_its_run(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lyapunov growth over t = 20 multiplies round-off by less than 100. Lanes leave what they cannot resolve to runs
    alone: three members where a product of velocities has many zeros."""
    henon = lg.scene("henon-heiles")
    x, y = henon.coordinates
    given: dict[str, Any] = {"events": HENON[case](x, y), "rtol": 1e-10, "keep": ("end", ("events", 4), ("max", x))}
    starts = {"x": np.linspace(0.05, 0.2, 13)}
    with runs_alone(monkeypatch) as left:
        together = lg.ensemble(henon, 20.0, starts, **given)
    with without_lanes(monkeypatch):
        agree(together, lg.ensemble(henon, 20.0, starts, workers=1, **given))
    assert "side by side" in together.form and sum(left) <= 3
