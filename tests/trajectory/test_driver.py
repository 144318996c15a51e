"""The loop over steps: both machines take the same steps, and every way a run can end is told as it is."""

from __future__ import annotations

from functools import partialmethod
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.machine.series.interpreted_driver import NumpySeries
from lagrange.machine.state import DriverState, Outcome
from lagrange.statement.coordinate import t
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.trajectory import Status, Trajectory
from tests.models import LLVM_FIRST, TARGETS, build, k, m, model, springs, x
from tests.trajectory.runs import ADAPTIVE, FIXED, NAMES, planned, run


def settings(name: str) -> dict[str, Any]:
    return {"step": 0.013} if name in FIXED else {"rtol": 1e-8, "atol": 1e-10}


def loose(name: str) -> dict[str, Any]:
    """Tolerances far above round-off: an error estimate next to it would differ between machines, and the steps too."""
    return {"step": 0.013} if name in FIXED else {"rtol": 1e-4, "atol": 1e-4}


def assert_same(ours: Trajectory, theirs: Trajectory, name: str) -> None:
    assert (ours.steps, ours.rejected, ours.evaluations) == (theirs.steps, theirs.rejected, theirs.evaluations)
    assert np.abs(ours.t - theirs.t).max() < (1e-14 if name in FIXED else 1e-8)
    scale = 1 + np.abs(theirs.y).max()
    assert np.abs(ours.y - theirs.y).max() < (1e-12 if name in FIXED else 1e-7) * scale
    assert ours.status is theirs.status is Status.SUCCESS and ours.message == theirs.message


def assert_near(ours: Trajectory, theirs: Trajectory) -> None:
    """Series at 1e-12: both machines take the same steps, but for what rounding leaves of the last rows."""
    assert ours.status is theirs.status is Status.SUCCESS, ours.message
    assert (ours.steps, ours.rejected) == (theirs.steps, theirs.rejected)
    assert np.abs(ours.t - theirs.t).max() < 1e-11 * theirs.t[-1]
    assert ours.t[-1] == theirs.t[-1] and ours.message == theirs.message
    assert np.abs(ours.y[:, -1] - theirs.y[:, -1]).max() < 1e-10 * (1 + np.abs(theirs.y).max())


@pytest.mark.few
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 16, 17, 21])
def test_series_of_every_length(n: int) -> None:
    method = Taylor(rtol=1e-12, atol=1e-12, order=15)
    assert_near(*(run(springs(target, n), 0.4, method) for target in TARGETS))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 16, 17, 21])
@pytest.mark.parametrize("name", ["rk4", "verlet", "dopri5", "dop853"])
def test_states_of_every_length(name: str, n: int) -> None:
    ours, theirs = (run(springs(target, n), 0.4, name, **loose(name)) for target in TARGETS)
    assert_same(ours, theirs, name)


class Counting:
    """A kernel that counts its calls."""

    def __init__(self, kernel: Any) -> None:
        self.kernel, self.program, self.calls = kernel, getattr(kernel, "program", None), 0

    def __call__(self, *args: Any) -> Any:
        self.calls += 1
        return self.kernel(*args)

    def quick(self, parameters: Any) -> None:
        """Nothing is quick: every call counts."""


@pytest.mark.few
@pytest.mark.parametrize("name", NAMES)
def test_the_count_is_honest(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is counted are right-hand sides; of a Taylor run whole series, and the right-hand side of a first look."""
    series = Counting(NumpySeries.rows)
    monkeypatch.setattr(NumpySeries, "rows", partialmethod(series))
    compiled = build("numpy", kinetic=m * x.dot**2 / 2, potential=k * x**4, initial={x: 1.0})
    laws: list[Any] = [Counting(compiled.kernel(law)) for law in ("rhs", "momentum")]
    compiled._kernels |= {"rhs": laws[0], "momentum": laws[1]}
    laws.append(Counting(compiled.law("constrained")))
    known = compiled._law
    monkeypatch.setattr(compiled, "_law", lambda name: laws[2] if name == "constrained" else known(name))
    found = run(compiled, 1.0, name, **settings(name))
    assert found.evaluations == sum(law.calls for law in laws) + series.calls
    assert (series.calls > 0) == (name == "taylor")


# --- time -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_backward_is_forward_in_a_mirror(name: str, target: str) -> None:
    """Henon-Heiles is even in time: backward from (q, v) is forward from (q, -v)."""
    compiled = model("Henon-Heiles", target)
    back = run(compiled, -1.0, name, **settings(name))
    mirrored = {"x_dot": -0.3, "y_dot": 0.1}
    forth = run(compiled, 1.0, name, initial=mirrored, **settings(name))
    assert back.t == pytest.approx(-forth.t, abs=1e-13)
    assert back.y[:2] == pytest.approx(forth.y[:2], abs=1e-12)
    assert back.y[2:] == pytest.approx(-forth.y[2:], abs=1e-12)
    assert back.span == (0.0, -1.0) and back.t[-1] == -1.0


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("direction", [1, -1])
def test_equal_steps_are_a_grid_that_ends_at_the_end(target: str, direction: int) -> None:
    compiled = model("oscillator", target)
    found = run(compiled, direction * 1.0, "rk4", step=0.3)
    assert found.t * direction == pytest.approx([0, 0.3, 0.6, 0.9, 1.0], abs=1e-15)
    assert found.t[-1] == direction * 1.0
    tenths = run(compiled, direction * 1.0, "rk4", step=0.1)
    assert tenths.steps == 10 and list(tenths.t) == [direction * i * 0.1 for i in range(10)] + [direction * 1.0]
    many = run(compiled, direction * 0.3, "euler", step=1e-4)
    assert many.steps == 3_000 and np.abs(np.diff(many.t) * direction - 1e-4).max() < 1e-15


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_run_of_no_length(name: str, target: str) -> None:
    found = run(model("oscillator", target), 2.0, name, start=2.0)
    assert found.status is Status.SUCCESS and list(found.t) == [2.0] and found.steps == 0
    assert found.y[:, 0] == pytest.approx([1.0, 0.0])
    assert found.dense(np.array([2.0, 2.0])) == pytest.approx(np.array([[1.0, 1.0], [0.0, 0.0]]))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_far_from_time_zero(name: str, target: str) -> None:
    near = run(model("pendulum", target), 2.0, name)
    far = run(model("pendulum", target), 1e9 + 2.0, name, start=1e9)
    assert far.status is Status.SUCCESS
    # The time is rounded at every step, and the bob moves at up to 6 a second.
    rounded = 6 * near.steps * np.spacing(1e9)
    assert far.y[:, -1] == pytest.approx(near.y[:, -1], rel=1e-6, abs=rounded)


# --- the record, and memory -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["rk4", "verlet", "dopri5", "dop853", "taylor"])
@pytest.mark.parametrize("system", ["oscillator", "Henon-Heiles", "8 carried masses"])
def test_a_driver_starts_from_the_state_and_nothing_else(name: str, system: str) -> None:
    """Bursts of one step, with the work array and the rows full of NaN before, give what one burst gives."""
    compiled = model(system)
    unit = Problem(compiled, compiled.parameter_values(), 0.0, 0.3, np.array(compiled.statement.initial))
    plan = planned(name, unit)
    tolerances = plan.tolerances

    def go(budget: int, poison: bool) -> tuple[Any, DriverState]:
        driver: Any = plan.driver(compiled, compiled.parameter_array())
        state = DriverState(0.0, 0.3, unit.y0, tolerances.rtol, tolerances.atol, tolerances.step)
        seen: list[Any] = []
        outcome = Outcome.PAUSED
        while outcome is Outcome.PAUSED:
            times, rows = np.full(budget, np.nan), np.full((budget + 4, len(unit.y0)), np.nan)
            if poison and not seen:
                dirty(driver, len(unit.y0), series=name == "taylor")
            state.counts[DriverState.ROWS] = 0
            outcome = driver.advance(state, budget, times, rows)
            written = state.count(DriverState.ROWS)
            seen.append(rows[:written])
            assert np.isfinite(rows[:written]).all() and np.isfinite(times[:written]).all()
        assert outcome is Outcome.DONE
        return np.concatenate(seen), state

    (first, one), (second, other) = go(10_000, poison=False), go(1, poison=True)
    assert (first == second).all()
    # A burst of Taylor steps ends with the series that proves the last one, which the next burst computes again.
    same = 2 if name == "taylor" else 3
    assert (one.counts[:same] == other.counts[:same]).all() and one.t == other.t == 0.3


def dirty(driver: Any, dimension: int, *, series: bool) -> None:
    """Leave NaN where slopes, new states and errors will stand; what pads a vector to whole blocks stays zero.

    Of a series it is what the rounding of the state lost, the rows, and all the rest.
    """
    if series:
        driver._work[driver._compiled.layout.padded :] = np.nan
        return
    layout = driver._code.layout
    for vector in range(layout.step.states, layout.errors + len(layout.step.errors)):
        start = layout.place(vector)
        driver._work[start : start + layout.length] = np.nan
    driver._work[layout.result : layout.result + dimension] = np.nan


def test_rows_may_be_left_out() -> None:
    compiled = model("oscillator")
    unit = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, np.array([1.0, 0.0]), step=0.1)
    plan = planned("rk4", unit)
    driver = plan.driver(compiled, compiled.parameter_array())
    state = DriverState(0.0, 1.0, unit.y0, 0.0, 0.0, plan.tolerances.step)
    state.counts[DriverState.RECORD] = 0
    assert driver.advance(state, 100, np.empty(0), np.empty((0, 2))) is Outcome.DONE
    assert state.count(DriverState.ROWS) == 0
    assert state.y == pytest.approx(run(compiled, 1.0, "rk4", step=0.1).y[:, -1], rel=0, abs=0)


# --- time-dependent forces -------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", LLVM_FIRST)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_a_brief_force_is_not_stepped_over(name: str, target: str) -> None:
    """A push of 0.1 s within 100 s on a mass at rest: with a step of ten seconds nobody would notice."""
    push = sp.Piecewise((1, (t > 50) & (t < sp.Rational(501, 10))), (0, True))
    compiled = build(target, kinetic=x.dot**2 / 2, forces={x: push})
    for start, end, expected in ((0.0, 100.0, [4.995, 0.1]), (100.0, 0.0, [4.995 + 0.01, -0.1])):
        found = run(compiled, end, name, start=start)
        assert found.y[:, -1] == pytest.approx(expected, abs=2e-2)
        assert found.steps >= 1000
        assert np.abs(np.diff(found.t)).max() == pytest.approx(0.1, rel=1e-9)
    free = run(build(target, kinetic=x.dot**2 / 2, forces={x: sp.Integer(1)}), 100.0, name)
    assert free.steps < 100
