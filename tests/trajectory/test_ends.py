"""Every way a run can end is told as it is, and keeps what was computed until then."""

from __future__ import annotations

import os
import signal
import threading
import time
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.machine.model import Model
from lagrange.machine.state import Outcome
from lagrange.statement.coordinate import t
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, M, build, k, m, model, x, y, z
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
@pytest.mark.parametrize("name", NAMES)
def test_max_wall(name: str, target: str) -> None:
    began = time.process_time()
    options = {"step": 1e-6} if name in FIXED else {}
    # So little that it ends before the steps are worth compiling well, which takes the longest.
    found = run(model("Henon-Heiles", target), 1e7, name, max_wall=0.02, **options)
    assert found.status is Status.MAX_WALL and "used up max_wall = 0.02 s at t = " in found.message
    # Of the processor's time, whatever else the machine does: the whole way would take hours, and most is compiling.
    assert time.process_time() - began < 60.0
    # An interpreted Newton step may take longer than that: then the start is all there is.
    assert len(found.t) == found.steps + 1 and np.isfinite(found.y).all()


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


@cache
def walled(target: str) -> Model:
    wall = sp.Piecewise((k, x < 1))
    return build(target, kinetic=m * x.dot**2 / 2, forces={x: wall}, initial={x.dot: 1.0})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_right_hand_side_that_ends(name: str, target: str) -> None:
    """The force has no value beyond x = 1: the run stops there, and says which entry is not a number."""
    compiled = walled(target)
    found = run(compiled, 5.0, name, **({"step": 0.01} if name in FIXED else {}))
    assert found.status is Status.NON_FINITE
    assert np.isfinite(found.y).all() and 0.4 < found.t[-1] < 0.75
    assert f"{name} stopped at t = " in found.message
    # The last slope of a step that ends beyond the wall may be all that is not a number: a method has it for its error.
    assert "x_dot is nan" in found.message or "the acceleration of x is nan" in found.message
    assert "Look for a division by zero" in found.message
    if name in ADAPTIVE:
        assert found.y[0, -1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_right_hand_side_without_a_start(name: str, target: str) -> None:
    compiled = build(target, kinetic=m * x.dot**2 / 2, forces={x: sp.sqrt(x - 1)})
    found = run(compiled, 1.0, name)
    assert found.status is Status.NON_FINITE and list(found.t) == [0.0] and found.steps == 0
    assert "the acceleration of x is nan" in found.message


def guide(target: str) -> Model:
    """Nothing resists x at y = 0."""
    return build(
        target,
        kinetic=m * (x.dot * y + y.dot) ** 2 / 2 + M * y.dot**2 / 2,
        potential=k * y**2 / 2,
        coordinates=[x, y],
        initial={x: 0.3, y: 0.5, y.dot: -1.0},
    )


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", [name for name in NAMES if not find(name).claims.symplectic])
def test_a_singular_mass_matrix_at_the_start(name: str, target: str) -> None:
    found = run(guide(target), 1.0, name, initial={y: 0.0})
    assert found.status is Status.SINGULAR and found.steps == 0 and list(found.t) == [0.0]
    assert "the mass matrix is singular at t = 0, x = 0.3, y = 0: the accelerations are not determined" in found.message
    pole = run(model("spherical pendulum", target), 1.0, name, initial={"theta": 0.0})
    assert pole.status is Status.SINGULAR and "singular at t = 0, theta = 0, phi = 0" in pole.message


def fading(target: str) -> Model:
    """Two masses that a spring and an inertia between them couple; from t = 1 the second has none of its own."""
    return build(
        target,
        kinetic=m * (x.dot + z.dot) ** 2 / 2 + sp.Max(0, 1 - t) * m * z.dot**2 / 2,
        potential=k * (x - z) ** 2 / 2,
        coordinates=[x, z],
        initial={x: 0.3},
    )


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", [name for name in NAMES if not find(name).claims.symplectic])
def test_a_mass_matrix_that_becomes_singular_on_the_way(name: str, target: str) -> None:
    found = run(fading(target), 5.0, name, **({"step": 0.01} if name in FIXED else {"rtol": 1e-5, "atol": 1e-5}))
    assert found.status in (Status.SINGULAR, Status.STEP_TOO_SMALL, Status.NON_FINITE, Status.DIVERGED), found.message
    assert found.t[-1] < 5.0 and np.isfinite(found.y).all() and len(found.t) > 1
    if name == "discrete-gradient":
        # Its unknowns reach over the step, and Newton's method may fail before the matrix at any of them does.
        assert found.status in (Status.SINGULAR, Status.DIVERGED)
    elif name in FIXED:
        assert found.status is Status.SINGULAR
        assert f"{name} stopped at t = " in found.message and "the mass matrix is singular" in found.message


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_a_singularity_in_time(name: str, target: str) -> None:
    """x'' = 6 x^2 blows up like 1/(t* - t)^2."""
    if target == "numpy" and name.startswith("radau"):
        pytest.skip(SLOW)
    compiled = build(target, kinetic=x.dot**2 / 2, potential=-2 * x**3, initial={x: 1.0, x.dot: 2.0})
    found = run(compiled, 5.0, name)
    assert found.status in (Status.STEP_TOO_SMALL, Status.NON_FINITE)
    assert found.t[-1] == pytest.approx(1.0, abs=1e-6) and np.isfinite(found.y).all()
    if found.status is Status.STEP_TOO_SMALL:
        assert "below the spacing of floating-point times" in found.message


@cache
def pulled() -> Model:
    return build(kinetic=x.dot**2 / 2, forces={x: 1 - x})


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
