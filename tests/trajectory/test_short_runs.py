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
