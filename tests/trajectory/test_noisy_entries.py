"""Systems at rest but for one entry: the rounding noise of the others does not make the steps short."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from sympy import cos, exp, sin, sqrt

import lagrange as lg

Case = tuple[lg.System, Mapping[Any, float], float]


def chain() -> Case:
    """Ten links in joint angles, straight, the first one let go."""
    angles = lg.coordinates(" ".join(f"a{i}" for i in range(10)))
    kinetic, potential, vx, vy, height, angle, rate = [0] * 7
    for a in angles:
        angle, rate = angle + a, rate + a.dot
        vx, vy, height = vx + rate * cos(angle), vy + rate * sin(angle), height - cos(angle)
        kinetic, potential = kinetic + (vx**2 + vy**2) / 2, potential + 9.81 * height
    return lg.System(kinetic, potential), {angles[0]: 0.5}, 1.0


def toda() -> Case:
    """Fifty masses with springs of exponential force, displaced by a bump of Gaussian shape."""
    places = lg.coordinates(" ".join(f"q{i}" for i in range(50)))
    potential = sum(exp(a - b) + b - a for a, b in pairwise(places))
    start = {q: float(np.exp(-((i - 25) ** 2) / 4)) for i, q in enumerate(places)}
    return lg.System(sum(q.dot**2 for q in places) / 2, potential), start, 5.0


def net() -> Case:
    """A net of nine masses and twelve springs in a plane, with one corner pulled."""
    grid = {(i, j): lg.coordinates(f"x{i}{j} y{i}{j}") for i in range(3) for j in range(3)}
    place = {(i, j): (i + x, j + y) for (i, j), (x, y) in grid.items()}
    edges = [(p, (p[0] + i, p[1] + j)) for p in place for i, j in ((1, 0), (0, 1)) if (p[0] + i, p[1] + j) in place]
    lengths = [sqrt(sum((a - b) ** 2 for a, b in zip(place[p], place[q], strict=True))) for p, q in edges]
    kinetic = sum(q.dot**2 for pair in grid.values() for q in pair) / 2
    return lg.System(kinetic, sum(50 * (d - 1) ** 2 for d in lengths)), {grid[0, 0][0]: -0.3}, 2.0


@pytest.mark.parametrize("method", ["taylor", "dop853"])
@pytest.mark.parametrize("case", [chain, toda, net])
def test_the_default_takes_few_steps(case: Callable[[], Case], method: str) -> None:
    """Steps are at most ten times those with a good `atol`: some are taken before the noise is looked at.

    Without the look the chain takes ten million tries, and the lattice ends as STEP_TOO_SMALL or after as many.
    """
    system, start, end = case()
    model = system.compile()
    free = lg.integrate(model, (0.0, end), start, method=method, max_steps=20_000)
    good = lg.integrate(model, (0.0, end), start, method=method, atol=1e-12)
    assert free.status is lg.Status.SUCCESS and free.steps <= 10 * good.steps
    # Both runs bound the error of a step by 1e-9 of the largest entries, of order one.
    assert np.abs(free.y[:, -1] - good.y[:, -1]).max() < 1e-8
