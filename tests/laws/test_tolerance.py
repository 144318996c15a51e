"""The error of a run is within the tolerance times the growth of errors, for many systems and tolerances.

The growth is measured: the initial state and later states are changed a little, and the largest effect at the end
counts.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from lagrange.machine.model import Model
from lagrange.trajectory.run import Flow
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import FloatArray
from tests.models import SCENE_NAMES, model, shared_scene, stated_in

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


@pytest.mark.few(2)
@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("name", [*SCENES, *MODELS])
def test_the_error_is_within_the_tolerance(name: str, tolerance: float) -> None:
    """Steps aim at a tenth of the tolerance, so that their sum stays within it. At 1e-14 rounding counts as well."""
    end, last, size, growth = course(name)
    flow = flow_of(compiled(name), rtol=tolerance, atol=tolerance * 1e-3)
    result = flow(compiled(name).statement.initial, 0.0, end)
    assert (np.abs(result - last) / size).max() <= growth * (tolerance + 2e-14)
