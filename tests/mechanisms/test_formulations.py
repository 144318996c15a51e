"""All scenes with constraints have the motion of an independent formulation: Kane, Lagrange, Newton or Euler."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.compiler import machine, model_of
from lagrange.machine.model import Model
from lagrange.trajectory.run import flow
from tests.covering import Share
from tests.mechanisms.formulation import Formulation
from tests.mechanisms.scenes import FORMULATIONS
from tests.models import loaded


@cache
def formulation(name: str) -> Formulation:
    return FORMULATIONS[name]()


@cache
def model(name: str, target: str = "llvm") -> Model:
    return model_of(loaded(name), machine(target))


@pytest.mark.few
@pytest.mark.parametrize("name", [*FORMULATIONS])
def test_a_scene_starts_where_its_formulation_does_and_on_its_constraints(name: str) -> None:
    start = np.array(loaded(name).initial)
    assert formulation(name).lift(formulation(name).first, 0.0) == pytest.approx(start, rel=1e-14, abs=2e-15)
    n = len(start) // 2
    if not loaded(name).constraints:
        return
    off = model(name).evaluate("constraints", start[:n], start[n:])
    size = max(1.0, np.abs(start).max())
    assert np.abs(off).max() <= 1e-15 * size**2


@pytest.mark.parametrize("target", ["llvm", "numpy"])
@pytest.mark.parametrize("name", FORMULATIONS)
def test_the_accelerations_are_those_of_the_formulation(name: str, target: str, share: Share) -> None:
    compiled, expected = model(name, target), formulation(name)
    n = compiled.dimension
    for z in expected.draws(share(20)):
        time = 0.7
        state = expected.lift(z, time)
        result = compiled.accelerations(state[:n], state[n:], time)
        right = expected.accelerations(z, time)
        assert np.abs(result - right).max() <= 1e-11 * max(1.0, np.abs(right).max()), z


@cache
def expected_states(name: str) -> Any:
    """Return five times along the run of a scene, and the states there."""
    times = np.linspace(0.0, loaded(name).run.t_end, 6)[1:]
    return times, formulation(name).states(times)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", [*FORMULATIONS])
def test_the_run_is_that_of_the_formulation(name: str) -> None:
    times, right = expected_states(name)
    run: Any = flow(model(name), rtol=1e-13, atol=1e-15)
    size = np.maximum(np.abs(right).max(axis=1), 1.0)
    for time, expected in zip(times, right.T, strict=True):
        result = run(np.array(loaded(name).initial), 0.0, time)
        assert (np.abs(result - expected) / size).max() <= 1e-8, time


def test_a_velocity_constraint_put_into_the_lagrangian_of_the_rolling_disc_gives_another_motion() -> None:
    """The table in docs/constraints.md. Kane's method gives the accelerations of the scene."""
    q1, q2, q3 = lg.coordinates("q1 q2 q3")
    along, across = q3.dot + q1.dot * sin(q2), q1.dot * cos(q2)
    # The velocity of the centre is that of a rotation about the contact, which is taken to be at rest.
    kinetic = (along**2 + q2.dot**2) / 2 + (q2.dot**2 + 2 * along**2 + across**2) / 8
    wrong = lg.System(kinetic, cos(q2), coordinates=[q1, q2, q3]).compile(check=False)
    y = formulation("rolling-disc").lift(np.array([0.4, -0.7, 1.3, 0.2, -0.5, 0.4, -2.0, 1.1]), 0.0)
    right = model("rolling-disc").accelerations(y[:5], y[5:])[:3]
    assert right == pytest.approx([1.12283, -2.95154, -0.00999], abs=1e-5)
    assert wrong.accelerations(y[:3], y[5:8]) == pytest.approx([5.30670, -2.95154, 2.97867], abs=1e-5)
