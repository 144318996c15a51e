"""Every way a run can end is told as it is, and keeps what was computed until then."""

from __future__ import annotations

import os
import signal
import threading
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.machine.model import Model
from lagrange.machine.state import Outcome
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, m, model, x
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, planned, run

SLOW = "thousands of interpreted Newton steps, the same as on llvm"
TIME_LIMIT = 1000.0
"""Seconds after which something waits for what does not come, on the busiest machine."""


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_max_steps(name: str, target: str) -> None:
    if target == "numpy" and name.startswith("radau"):
        pytest.skip(SLOW)
    compiled = model("Henon-Heiles", target)
    options = {"step": 0.02} if name in FIXED else {}
    whole = run(compiled, 8.0, name, **options)
    for limit in (1, 3, 70):
        found = run(compiled, 8.0, name, max_steps=limit, **options)
        if whole.steps + whole.rejected <= limit:
            continue
        assert found.status is Status.MAX_STEPS
        assert found.steps + found.rejected == limit and len(found.t) == found.steps + 1
        assert found.message.startswith(f"{name} used up max_steps = {limit} at t = ")
        assert (found.y == whole.y[:, : found.steps + 1]).all()
    enough = run(compiled, 8.0, name, max_steps=whole.steps + whole.rejected, **options)
    assert enough.status is Status.SUCCESS


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["rk4", "verlet", "dopri5", "dop853", "taylor"])
def test_ctrl_c_keeps_what_there_is(name: str, target: str) -> None:
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 1e-6} if name in FIXED else {}
    bursts = threading.Semaphore(0)

    def press() -> None:
        # After some bursts, on the way through the next one; the limits are for a run that nothing interrupts.
        if all(bursts.acquire(timeout=TIME_LIMIT) for _ in range(3)):
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    found = run(compiled, 1e7, name, max_wall=TIME_LIMIT, progress=lambda t: bursts.release(), **options)
    thread.join()
    assert found.status is Status.INTERRUPTED
    assert (
        f"{name} was interrupted at t = " in found.message and "what was computed until then is kept" in found.message
    )
    assert 0 < found.t[-1] < 1e7 and len(found.t) > 2
    assert len(found.t) == found.y.shape[1] and (np.diff(found.t) > 0).all() and np.isfinite(found.y).all()
    energy = compiled.energy(found.y[:2], found.y[2:])
    assert np.abs(energy / energy[0] - 1).max() < 1e-3


@pytest.mark.parametrize("target", TARGETS)
def test_ctrl_c_on_the_way_back_from_a_burst_loses_none_of_it(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = model("Henon-Heiles", target)
    plain = run(compiled, 40.0, "rk4", step=0.1)
    compiled.prepared.clear()  # else the next run takes as many steps at once as this one took
    unit = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, np.array(compiled.statement.initial))
    driver = type(planned("rk4", unit).driver(compiled, compiled.parameter_array()))
    advance, calls = driver.advance, []

    def pressed(self: Any, *given: Any) -> Outcome:
        outcome: Outcome = advance(self, *given)
        calls.append(outcome)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return outcome

    monkeypatch.setattr(driver, "advance", pressed)
    # However slow the machine is, the second burst is twice as long as the first.
    monkeypatch.setattr("lagrange.trajectory.run_loop.SECONDS_PER_CALL", np.inf)
    monkeypatch.setattr("lagrange.trajectory.run_loop.MOST_GROWTH", 2)
    found = run(compiled, 40.0, "rk4", step=0.1)
    assert found.status is Status.INTERRUPTED and found.steps == len(found.t) - 1 == 64 + 128
    assert (found.y == plain.y[:, :193]).all() and (found.t == plain.t[:193]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_right_hand_side_without_a_start(name: str, target: str) -> None:
    compiled = build(target, kinetic=m * x.dot**2 / 2, forces={x: sp.sqrt(x - 1)})
    found = run(compiled, 1.0, name)
    assert found.status is Status.NON_FINITE and list(found.t) == [0.0] and found.steps == 0
    assert "the acceleration of x is nan" in found.message


def pulled() -> Model:
    return build(kinetic=x.dot**2 / 2, forces={x: 1 - x})


@pytest.mark.few
@pytest.mark.parametrize("name", ADAPTIVE)
def test_tolerances_of_zero_from_rest(name: str) -> None:
    """Every scale of the error is zero at the start."""
    found = run(pulled(), 3.0, name, rtol=0.0, atol=0.0)
    assert found.status is Status.SUCCESS and found.y[0, -1] == pytest.approx(1 - np.cos(3), abs=1e-10)
    least = 1.11e-16 if name == "taylor" else 2.22e-14  # a series has no estimate made of differences, full of noise
    assert f"rtol = 0 is below round-off and was raised to {least}" in found.message


@pytest.mark.parametrize("target", TARGETS)
def test_progress_is_told_where_the_run_is(target: str) -> None:
    seen: list[float] = []
    run(model("oscillator", target), 5.0, "euler", step=1e-3, progress=seen.append)
    assert seen == sorted(seen) and seen[0] > 0 and seen[-1] <= 5.0
