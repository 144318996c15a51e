"""SciPy's solvers as methods: every run ends with a status and keeps its states."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.trajectory.foreign.scipy_solvers import BDF, DOP853, LSODA, RK23, RK45, Radau
from lagrange.trajectory.trajectory import Status
from tests.models import shared_scene
from tests.trajectory.points import (
    oscillator,
    problem,
)

METHODS = (RK45, RK23, DOP853, Radau, BDF, LSODA)


@pytest.fixture(params=METHODS, ids=lambda method: method.name)
def method(request: Any) -> Any:
    return request.param()


@pytest.mark.few(2)
@pytest.mark.parametrize(("t0", "t1", "rtol"), [(0.0, 7.0, 0.05), (0.0, -7.0, 1e-9), (1e3, 1005.0, 1e-6)])
@pytest.mark.parametrize("name", ["rk23", "rk45", "dop853"])
def test_a_step_taken_again_has_the_path_that_it_had(name: str, t0: float, t1: float, rtol: float) -> None:
    """A run with output times reads SciPy's dense output during the run; without them the steps are repeated later."""
    model = shared_scene("elastic-pendulum").compile()
    times = np.linspace(t0, t1, 400)
    there = lg.integrate(model, (t0, t1), method=f"scipy-{name}", rtol=rtol, t_eval=times)
    again = lg.integrate(model, (t0, t1), method=f"scipy-{name}", rtol=rtol)
    assert there.steps == again.steps and there.evaluations >= again.evaluations
    # The length of a step is rounded with the times at its ends.
    np.testing.assert_allclose(again.at(times), there.y, rtol=0, atol=1e-12)
    assert np.array_equal(again.at(again.t), again.y)


def test_options_bound_the_steps() -> None:
    def pulse(t: float, x: float, v: float) -> float:
        return 1.0 if 50 <= t < 50.1 else 0.0

    run = RK45(max_step=0.05).integrate(problem(pulse, 100.0, (0.0, 0.0), max_steps=10**6))
    assert run.y[1, -1] == pytest.approx(0.1, abs=1e-6)
    assert np.diff(RK45(first_step=1e-3).integrate(problem(oscillator)).t)[0] == pytest.approx(1e-3)
    assert RK45(first_step=1e9).integrate(problem(oscillator)).status is Status.SUCCESS
    with pytest.raises(StatementError, match="max_step = -1, the length of a step of scipy-rk45"):
        RK45(max_step=-1)


def test_an_endless_step_is_broken_off(monkeypatch: Any) -> None:
    class Stuck:
        def __init__(self, fun: Any, t0: float, y0: Any, t1: float, **options: Any) -> None:
            self.fun, self.t, self.y, self.status = fun, t0, y0, "running"

        def step(self) -> None:
            while True:
                self.fun(self.t, self.y)

    monkeypatch.setattr(RK45, "solver", Stuck)
    run = RK45().integrate(problem(oscillator))
    assert run.status is Status.DIVERGED and "5000 evaluations inside one step" in run.message
    assert 5000 < run.evaluations < 5100


def test_what_scipy_warns_of_is_told_and_not_leaked() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = LSODA(first_step=1e6).integrate(problem(oscillator, 1e6))
    assert run.status is Status.DIVERGED and "SciPy says: lsoda: Repeated convergence failures" in run.message


def test_a_large_time_is_kept_track_of(method: Any) -> None:
    """At t = 1e12 the spacing of doubles is 1e-4. LSODA lost its short steps there."""
    run = method.integrate(problem(oscillator, 1e12 + 8.0, t0=1e12))
    assert (np.diff(run.t) > 0).all()
    if run.status is Status.STEP_TOO_SMALL:
        assert method.name == "scipy-bdf" and run.t[-1] < 1e12 + 8.0  # its first steps are shorter than that
        return
    assert run.status is Status.SUCCESS and run.t[-1] == 1e12 + 8.0
    assert run.y[:, -1] == pytest.approx([np.cos(8.0), -np.sin(8.0)], abs=2e-4)
    assert run.dense(np.array([1e12 + 4.0]))[:, 0] == pytest.approx([np.cos(4.0), -np.sin(4.0)], abs=5e-4)
