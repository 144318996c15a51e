"""All scenes with constraints have the motion of an independent formulation: Kane, Lagrange, Newton or Euler."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

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


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["dopri5", "dop853", "radau5"])
@pytest.mark.parametrize("name", FORMULATIONS)
def test_other_methods_run_to_the_same_end(name: str, method: str) -> None:
    """At the tolerance 1e-9 the largest error is 5e-6, in the scene with flips; that of the others is 1e-6."""
    times, right = expected_states(name)
    run: Any = flow(model(name), method=method, rtol=1e-9, atol=1e-12)
    result = run(np.array(loaded(name).initial), 0.0, times[-1])
    assert np.abs(result - right[:, -1]).max() <= 2e-5 * max(1.0, np.abs(right[:, -1]).max())


def test_two_vortices_turn_evenly_about_their_centre() -> None:
    """The rate is (Gamma1 + Gamma2)/(2 pi d^2), about the centre (Gamma1 r1 + Gamma2 r2)/(Gamma1 + Gamma2)."""
    start = np.array(loaded("two-point-vortices").initial)
    run: Any = flow(model("two-point-vortices"), rtol=1e-13, atol=1e-15)
    for time in (3.0, 20.0):
        angle = 4 / (2 * np.pi) * time
        way = np.array([np.cos(angle), np.sin(angle)])
        result = run(start, 0.0, time)
        assert result[:4] == pytest.approx([*([0.25, 0.0] - way / 4), *([0.25, 0.0] + way * 3 / 4)], abs=1e-12)
