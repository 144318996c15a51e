"""The error of a run is within the tolerance times the growth of errors, for many systems and tolerances.

The growth is measured: the initial state and later states are changed a little, and the largest effect at the end
counts.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import sqrt

import lagrange as lg
from lagrange.machine.model import Model
from lagrange.trajectory.run import Flow
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import FloatArray
from tests.models import SCENE_NAMES, build, model, shared_scene, stated_in, x, y

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


@pytest.mark.slow
def test_henon_heiles_over_a_million_steps() -> None:
    potential = (x**2 + y**2) / 2 + x**2 * y - y**3 / 3
    galaxy = build(kinetic=(x.dot**2 + y.dot**2) / 2, potential=potential)
    flow = flow_of(galaxy, rtol=1e-16, atol=1e-16)
    starts = [np.array([0.1 + 1e-3 * k, 0.2, 0.3, 0.1]) for k in range(8)]
    assert exponent(flow, galaxy, starts, (5e3, 5e5)) < FASTEST
