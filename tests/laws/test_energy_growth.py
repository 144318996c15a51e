"""Over long runs the error of the energy grows like a sum of random roundings, with the square root of time.

Anything that has the same sign at every step would grow with time itself: a truncation that is not far below
round-off, or a constant such as 1/3 rounded once and multiplied at every step.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from sympy import sqrt

import lagrange as lg
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import FloatArray
from tests.models import build, x, y

FASTEST = 0.6
"""The exponent of time allowed. It is 0.5 for independent roundings; eight starts leave it uncertain by 0.1."""


def exponent(flow: Flow, energy: lg.Model, starts: list[FloatArray], times: tuple[float, float]) -> float:
    """Return the exponent with which the root mean square of the energy's error grows from one time to another."""
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
