"""Solvers of other packages through the protocol, what holds for each. How their runs end: `tests/faults`."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from lagrange.trajectory.foreign.sundials import CVODE
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.trajectory.points import (
    Singular,
    oscillator,
    problem,
)
from tests.trajectory.runs import OUTSIDE

SOLVERS: list[Any] = [*map(find, OUTSIDE), *([CVODE("Adams")] if "cvode" in OUTSIDE else [])]


@pytest.fixture(params=SOLVERS, ids=lambda method: getattr(method, "method", "") + method.name)
def method(request: Any) -> Any:
    return request.param


@pytest.fixture(autouse=True)
def silence(capfd: Any) -> Any:
    """SUNDIALS prints from C and scikit-sundae from Python: a run leaves both streams empty."""
    yield
    assert tuple(capfd.readouterr()) == ("", "")


@pytest.mark.few
@pytest.mark.parametrize("t1", [7.0, -7.0])
def test_reaches_the_end_with_a_path_between_the_steps(method: Any, t1: float) -> None:
    run = method.integrate(problem(oscillator, t1))
    assert run.status is Status.SUCCESS and run.method == method.name
    assert run.message == f"{method.name} reached t = {t1:g}." + " Time ran backwards." * (t1 < 0)
    assert run.t[0] == 0 and run.t[-1] == t1 and run.y.shape == (2, len(run.t)) and run.steps == len(run.t) - 1
    assert (np.diff(run.t) * t1 > 0).all() and run.evaluations > run.steps > 5 and run.wall > 0
    times = np.linspace(t1, 0, 500)
    # rtol = 1e-8 over 7 s leaves errors of 1e-5 at most; between the steps they are no larger than twice that.
    np.testing.assert_allclose(run.y[0], np.cos(run.t), atol=1e-5)
    np.testing.assert_allclose(run.dense(times), [np.cos(times), -np.sin(times)], atol=2e-5)
    np.testing.assert_allclose(run.dense(run.t), run.y, atol=1e-12)


@pytest.mark.few
def test_a_stiff_oscillator_ends_in_time_where_the_method_is_for_it(method: Any) -> None:
    def van_der_pol(t: float, x: float, v: float) -> float:
        return 1e5 * (1 - x * x) * v - x

    run = method.integrate(problem(van_der_pol, 1e3, (2.0, 0.0), rtol=1e-5, atol=1e-8, max_steps=3000))
    stiff = method.name in ("scipy-radau", "scipy-bdf", "scipy-lsoda") or getattr(method, "method", "") == "BDF"
    assert run.status is (Status.SUCCESS if stiff else Status.MAX_STEPS)
    if stiff:
        assert run.y[0, -1] == pytest.approx(1.9933, abs=1e-3)


def test_threads_do_not_disturb_each_other(method: Any) -> None:
    expected = method.integrate(problem(oscillator)).y[:, -1]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: method.integrate(problem(oscillator)), range(4)))
    assert [run.status for run in found] == [Status.SUCCESS] * 4
    assert all((run.y[:, -1] == expected).all() for run in found)


def test_output_times_are_met_and_do_not_change_the_steps(method: Any) -> None:
    times = np.array([0.0, 0.3, 1.0, 2.0])
    run = method.integrate(problem(oscillator, t_eval=times))
    free = method.integrate(problem(oscillator))
    assert run.steps == free.steps
    np.testing.assert_array_equal(run.t, times)
    np.testing.assert_array_equal(run.y, free.dense(times))
    np.testing.assert_allclose(run.y[0], np.cos(times), atol=1e-6)


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


def test_a_singular_mass_matrix_is_reported_in_the_models_words(method: Any) -> None:
    run = method.integrate(replace(problem(oscillator), model=Singular(oscillator)))
    assert run.status is Status.SINGULAR
    assert 0.5 <= run.y[0, -1] < 0.6
    assert "on the way from 0 to 2: the mass matrix of the clock is singular at x = 0." in run.message


@pytest.mark.few
def test_progress_is_told_the_time_reached(method: Any) -> None:
    times: list[float] = []

    def slow(t: float, x: float, v: float) -> float:
        time.sleep(2e-3)
        return -x

    run = method.integrate(problem(slow, progress=times.append))
    assert times and times == sorted(times) and times[-1] <= run.t[-1]


def test_a_state_below_atol_is_spoken_of(method: Any) -> None:
    run = method.integrate(problem(oscillator, y0=(1e-20, 0.0)))
    assert "so atol = 1e-10 leaves it fewer digits than rtol = 1e-08 asks for" in run.message
    assert "atol" not in method.integrate(problem(oscillator)).message


def test_a_start_without_inertia_is_singular(method: Any) -> None:
    given = problem(oscillator)
    given.model.column_without_inertia = lambda *_: 0
    given.model.singular_message = lambda *_: "x has no inertia there."
    run = method.integrate(given)
    assert run.status is Status.SINGULAR and "x has no inertia there" in run.message and len(run.t) == 1


def test_what_a_solver_would_bend_is_refused_or_said(method: Any) -> None:
    with pytest.raises(StatementError, match=f"{method.name} chooses its steps by itself: give rtol and atol"):
        method.integrate(problem(oscillator, step=0.1))
    with pytest.raises(StatementError, match="rtol = nan"):
        method.integrate(problem(oscillator, rtol=np.nan))
    run = method.integrate(problem(oscillator, rtol=0.0, atol=0.0, max_steps=300))
    assert "rtol = 0 is below round-off and was raised to" in run.message
    assert np.isfinite(run.y).all() and (run.status is Status.SUCCESS or run.t[-1] < 2)


def test_errors_of_the_model_are_not_swallowed(method: Any) -> None:
    def broken(t: float, x: float, v: float) -> float:
        if t > 0.5:
            raise ValueError("a bug in the model")
        return -x

    with pytest.raises(ValueError, match="a bug in the model"):
        method.integrate(problem(broken))
