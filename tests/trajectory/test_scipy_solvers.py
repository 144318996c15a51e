"""SciPy's solvers through the protocol: every run ends, says how, and keeps what it has."""

from __future__ import annotations

import threading
import time
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from lagrange.trajectory.methods.scipy_solvers import BDF, DOP853, LSODA, RK23, RK45, Radau
from lagrange.trajectory.trajectory import Status
from tests.trajectory.points import (
    Singular,
    blow_up,
    double_pole,
    inf_later,
    leaves_domain,
    nan_later,
    oscillator,
    problem,
    stated_time,
)

METHODS = (RK45, RK23, DOP853, Radau, BDF, LSODA)


@pytest.fixture(params=METHODS, ids=lambda method: method.name)
def method(request: Any) -> Any:
    return request.param()


@pytest.mark.parametrize("t1", [7.0, -7.0])
def test_reaches_the_end_with_a_path_between_the_steps(method: Any, t1: float) -> None:
    run = method.integrate(problem(oscillator, t1))
    assert run.status is Status.SUCCESS and run.method == method.name
    assert run.message == f"{method.name} reached t = {t1:g}."
    assert run.t[0] == 0 and run.t[-1] == t1 and run.y.shape == (2, len(run.t)) and run.steps == len(run.t) - 1
    assert run.evaluations > run.steps > 5 and run.wall > 0
    np.testing.assert_allclose(run.y[0], np.cos(run.t), atol=1e-5)
    times = np.linspace(t1, 0, 500)
    np.testing.assert_allclose(run.dense(times), [np.cos(times), -np.sin(times)], atol=2e-5)
    np.testing.assert_allclose(run.dense(run.t), run.y, atol=1e-12)


def test_output_times_are_met_and_do_not_change_the_steps(method: Any) -> None:
    times = np.array([0.0, 0.3, 1.0, 2.0])
    run = method.integrate(problem(oscillator, t_eval=times))
    assert run.steps == method.integrate(problem(oscillator)).steps
    np.testing.assert_array_equal(run.t, times)
    np.testing.assert_allclose(run.y[0], np.cos(times), atol=1e-6)


@pytest.mark.parametrize("fault", [nan_later, inf_later])
def test_a_derivative_that_turns_bad_stops_the_run_there(method: Any, fault: Any) -> None:
    run = method.integrate(problem(fault))
    assert run.status is Status.NON_FINITE
    assert 0.3 < run.t[-1] <= 0.5000001 and np.isfinite(run.y).all() and run.steps > 0
    assert stated_time(run) == pytest.approx(0.5, abs=0.02)  # LSODA does not go back for the last few thousandths
    assert "on the way from 0 to 2: the acceleration of x is " in run.message
    assert "Look for a division by zero" in run.message


def test_leaving_the_domain_stops_the_run_at_its_edge(method: Any) -> None:
    run = method.integrate(problem(leaves_domain))
    assert run.status is Status.NON_FINITE and "x" in run.message
    assert np.isfinite(run.y).all() and -0.5 <= run.y[0, -1] < 0.5


@pytest.mark.parametrize(("fault", "y0"), [(blow_up, (0.0, 1.0)), (double_pole, (1.0, 2.0))])
def test_a_singularity_of_the_solution_ends_the_run(method: Any, fault: Any, y0: Any) -> None:
    run = method.integrate(problem(fault, y0=y0))
    assert run.status in (Status.STEP_TOO_SMALL, Status.NON_FINITE, Status.DIVERGED), run.message
    assert run.t[-1] == pytest.approx(1.0, abs=1e-2) and np.isfinite(run.y).all()
    assert stated_time(run) == pytest.approx(1.0, abs=1e-2), run.message
    assert "x_dot" in run.message or "of x" in run.message


@pytest.mark.parametrize(
    ("acceleration", "y0", "words"),
    [
        (oscillator, (np.nan, 0.0), "x is nan"),
        (oscillator, (1.0, np.inf), "x_dot is inf"),
        (lambda t, x, v: np.nan, (1.0, 0.0), "the acceleration of x is nan"),
    ],
)
def test_a_start_that_is_not_finite_is_not_run(method: Any, acceleration: Any, y0: Any, words: str) -> None:
    run = method.integrate(problem(acceleration, y0=y0))
    assert run.status is Status.NON_FINITE and run.steps == 0 and run.t.tolist() == [0.0]
    assert run.message.startswith(f"{method.name} stopped at t = 0 on the way from 0 to 2: {words}. Look")
    np.testing.assert_array_equal(run.dense(np.array([0.0]))[:, 0], y0)


def test_bad_right_after_the_start_ends_too(method: Any) -> None:
    run = method.integrate(problem(lambda t, x, v: np.nan if t > 0 else 1.0))
    assert run.status is Status.NON_FINITE and np.isfinite(run.y).all()


def test_a_singular_mass_matrix_is_reported_in_the_models_words(method: Any) -> None:
    run = method.integrate(replace(problem(oscillator), model=Singular(oscillator)))
    assert run.status is Status.SINGULAR
    assert 0.5 <= run.y[0, -1] < 0.6
    assert "on the way from 0 to 2: the mass matrix of the clock is singular at x = 0." in run.message


def test_step_and_time_limits_keep_what_was_computed(method: Any) -> None:
    run = method.integrate(problem(oscillator, 1e6, max_steps=5))
    assert run.status is Status.MAX_STEPS and run.steps == 5 and len(run.t) == 6
    assert "used up max_steps = 5 at t = " in run.message and "Raise max_steps" in run.message

    def slow(t: float, x: float, v: float) -> float:
        time.sleep(1e-3)
        return -x

    run = method.integrate(problem(slow, 1e6, max_wall=0.1))
    assert run.status is Status.MAX_WALL and run.wall < 1
    assert "used up max_wall = 0.1 s at t = " in run.message and "Raise max_wall" in run.message
    times = np.linspace(0.0, 1e6, 11)
    run = method.integrate(problem(oscillator, 1e6, t_eval=times, max_steps=5))
    assert run.t.tolist() == [0.0], "no output beyond the last accepted step"


def test_an_interruption_keeps_what_was_computed(method: Any) -> None:
    def interrupted(t: float, x: float, v: float) -> float:
        if t > 1:
            raise KeyboardInterrupt
        return -x

    run = method.integrate(problem(interrupted))
    assert run.status is Status.INTERRUPTED and 0.3 < run.t[-1] <= 1 and run.steps == len(run.t) - 1
    assert "was interrupted at t = " in run.message and "kept" in run.message


def test_a_stiff_oscillator_ends_in_time_where_the_method_is_for_it(method: Any) -> None:
    def van_der_pol(t: float, x: float, v: float) -> float:
        return 1e5 * (1 - x * x) * v - x

    run = method.integrate(problem(van_der_pol, 1e3, (2.0, 0.0), rtol=1e-5, atol=1e-8, max_steps=3000))
    assert run.status is (Status.MAX_STEPS if method.claims.explicit and method.claims.order != 12 else Status.SUCCESS)
    if run.status is Status.SUCCESS:
        assert run.y[0, -1] == pytest.approx(1.9933, abs=1e-3)


def test_no_warning_leaks_and_errors_of_the_model_are_not_swallowed(method: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        method.integrate(problem(lambda t, x, v: np.exp(np.float64(x) * 1e4), y0=(0.0, 1.0)))

    def broken(t: float, x: float, v: float) -> float:
        if t > 0.5:
            raise ValueError("a bug in the model")
        return -x

    with pytest.raises(ValueError, match="a bug in the model"):
        method.integrate(problem(broken))


def test_what_scipy_would_bend_is_refused_or_said(method: Any) -> None:
    with pytest.raises(StatementError, match=f"{method.name} chooses its steps by itself: give rtol and atol"):
        method.integrate(problem(oscillator, step=0.1))
    with pytest.raises(StatementError, match="rtol = nan"):
        method.integrate(problem(oscillator, rtol=np.nan))
    run = method.integrate(problem(oscillator, rtol=0.0, atol=0.0, max_steps=300))
    assert "rtol = 0 is below round-off and was raised to" in run.message
    assert np.isfinite(run.y).all() and (run.status is Status.SUCCESS or run.t[-1] < 2)


def test_options_bound_the_steps() -> None:
    def pulse(t: float, x: float, v: float) -> float:
        return 1.0 if 50 <= t < 50.1 else 0.0

    run = RK45(max_step=0.05).integrate(problem(pulse, 100.0, (0.0, 0.0), max_steps=10**6))
    assert run.y[1, -1] == pytest.approx(0.1, abs=1e-6)
    assert np.diff(RK45(first_step=1e-3).integrate(problem(oscillator)).t)[0] == pytest.approx(1e-3)
    assert RK45(first_step=1e9).integrate(problem(oscillator)).status is Status.SUCCESS
    with pytest.raises(StatementError, match="max_step = -1 cannot bound a step of scipy-rk45"):
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


def test_threads_do_not_disturb_each_other(method: Any) -> None:
    expected = method.integrate(problem(oscillator)).y[:, -1]
    found: list[Any] = []
    threads = [threading.Thread(target=lambda: found.append(method.integrate(problem(oscillator)))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [run.status for run in found] == [Status.SUCCESS] * 4
    assert all((run.y[:, -1] == expected).all() for run in found)


def test_progress_is_told_the_time_reached() -> None:
    times: list[float] = []

    def slow(t: float, x: float, v: float) -> float:
        time.sleep(2e-3)
        return -x

    run = RK45().integrate(problem(slow, progress=times.append))
    assert times and times == sorted(times) and times[-1] <= run.t[-1]


def test_an_empty_span_is_one_state(method: Any) -> None:
    run = method.integrate(problem(oscillator, 0.0))
    assert run.status is Status.SUCCESS and run.t.tolist() == [0.0] and run.y.tolist() == [[1.0], [0.0]]


def test_a_large_time_is_kept_track_of(method: Any) -> None:
    """From t = 1e12, where doubles are 1e-4 apart; LSODA added its steps to that time, and lost them there."""
    run = method.integrate(problem(oscillator, 1e12 + 8.0, t0=1e12))
    assert (np.diff(run.t) > 0).all()
    if run.status is Status.STEP_TOO_SMALL:
        assert method.name == "scipy-bdf" and run.t[-1] < 1e12 + 8.0  # its first steps are shorter than that
        return
    assert run.status is Status.SUCCESS and run.t[-1] == 1e12 + 8.0
    assert run.y[:, -1] == pytest.approx([np.cos(8.0), -np.sin(8.0)], abs=2e-4)
    assert run.dense(np.array([1e12 + 4.0]))[:, 0] == pytest.approx([np.cos(4.0), -np.sin(4.0)], abs=5e-4)


def test_a_state_below_atol_is_spoken_of(method: Any) -> None:
    run = method.integrate(problem(oscillator, y0=(1e-20, 0.0)))
    assert "atol = 1e-10 leaves it few digits, or none" in run.message
    assert "atol" not in method.integrate(problem(oscillator)).message


def test_a_start_without_inertia_is_singular(method: Any) -> None:
    given = problem(oscillator)
    given.model.column_without_inertia = lambda *_: 0
    given.model.singular_message = lambda t, y: "x has no inertia there."
    run = method.integrate(given)
    assert run.status is Status.SINGULAR and "x has no inertia there" in run.message and len(run.t) == 1
