"""What a run costs beside its steps: how often its driver comes back, and that no slow way is taken without a need."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.machine.kernel.interpreted import InterpretedKernel
from lagrange.machine.kernel.llvm_kernel import LlvmKernel
from lagrange.machine.steps.llvm_driver import LlvmDriver
from lagrange.trajectory import run_loop
from tests.models import shared_scene


@pytest.mark.parametrize(("seconds", "calls"), [(1e9, [64, 1024]), (0.0, [64] * 16)])
def test_a_run_of_quick_steps_comes_back_seldom(
    seconds: float, calls: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A call costs as much as 50 steps of a small system; steps that are slow come back as often as before."""
    model = shared_scene("pendulum").compile()
    lg.integrate(model, (0.0, 0.1), method="rk4", step=0.01)
    asked: list[int] = []
    advance = LlvmDriver.advance

    def counted(self: Any, state: Any, budget: int, *rest: Any) -> Any:
        asked.append(budget)
        return advance(self, state, budget, *rest)

    monkeypatch.setattr(LlvmDriver, "advance", counted)
    monkeypatch.setattr(run_loop, "SECONDS_PER_CALL", seconds)
    assert lg.integrate(model, (0.0, 10.0), method="rk4", step=0.01).steps == 1000
    assert asked == calls


@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5"])
@pytest.mark.parametrize("initial", [None, {"theta": np.pi / 2}], ids=["plain", "energy near zero"])
@pytest.mark.parametrize("scene", ["pendulum", "elastic-pendulum"])
def test_a_run_looks_at_its_ends_by_quick_calls(
    scene: str, initial: Any, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where nothing is wrong, neither the first slope nor an inertia or an energy is computed the slow way."""
    model = shared_scene(scene).compile()
    step: dict[str, Any] = {"step": 0.01} if method == "rk4" else {}
    expected = lg.integrate(model, (0.0, 0.1), initial, method=method, **step)
    for slow in (LlvmKernel, InterpretedKernel):
        monkeypatch.setattr(slow, "__call__", None)
        monkeypatch.setattr(slow, "columns", None)
    found = lg.integrate(model, (0.0, 0.1), initial, method=method, **step)
    assert found.status is lg.Status.SUCCESS and np.array_equal(found.y, expected.y)


# --- first steps, which begin where their error estimate means something ---------------------------------------

METHODS = ("bs3", "dopri5", "tsit5", "dop853", "verner9")
SCENES = (
    *("bead-on-hoop", "chain-of-springs", "charge-in-field", "double-pendulum", "elastic-pendulum", "henon-heiles"),
    *("kepler", "mass-on-spring", "pendulum", "pleiades", "spherical-pendulum", "sun-earth-moon"),
)
"""Scenes that are at no equilibrium, and whose motion is not a polynomial in time that a method follows exactly."""

MOST_GROWTH = 10.0
"""Step control lets a step grow by this factor at most, whatever its error."""


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_first_step_is_less_than_two_growths_away(name: str, method: str, rtol: float) -> None:
    """An error far below the tolerance is round-off: a step then grows by the most that it may, again and again."""
    model = shared_scene(name).compile()
    span = shared_scene(name).statement.run.t_end or 10.0
    for absolute in (None, rtol):
        found = lg.integrate(model, (0.0, span), method=method, rtol=rtol, atol=absolute, max_steps=6)
        steps = np.diff(found.t)
        assert len(steps) >= 3
        assert steps[2] < 0.9 * MOST_GROWTH**2 * steps[0]
