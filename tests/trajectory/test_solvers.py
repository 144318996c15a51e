"""Solvers of other packages as methods: properties of all of them. `tests/faults` tests how their runs end."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sympy import sqrt

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.event import event
from lagrange.trajectory.foreign.scipy_solvers import BDF, DOP853, LSODA, RK23, RK45, Radau
from lagrange.trajectory.foreign.sundials import CVODE
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import Status
from tests.models import build, shared_scene, x
from tests.refusals import refusal
from tests.trajectory.runs import FALL, OUTSIDE, Singular, ball, bounces, checked_run, floor, free, oscillator, problem

SOLVERS: list[Any] = [*map(find, OUTSIDE), *([CVODE("Adams")] if "cvode" in OUTSIDE else [])]


@pytest.fixture(params=SOLVERS, ids=lambda method: getattr(method, "method", "") + method.name)
def method(request: Any) -> Any:
    return request.param


@pytest.fixture(autouse=True)
def silence(capfd: Any) -> Any:
    """Assert that a run prints nothing, neither from C (SUNDIALS) nor from Python (scikit-sundae)."""
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


def test_what_a_solver_would_bend_is_refused_or_said(method: Any) -> None:
    with pytest.raises(StatementError, match=f"{method.name} chooses its steps by itself: give rtol and atol"):
        method.integrate(problem(oscillator, step=0.1))
    assert "rtol = nan" in refusal(method.integrate, problem(oscillator, rtol=np.nan))
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


# --- events ---------------------------------------------------------------------------------------------------
# Events with solvers of other packages: started anew after a reset, on a path that is a polynomial on each step.

MULTISTEP = [name for name in OUTSIDE if name in ("scipy-bdf", "scipy-lsoda", "cvode")]
"""Methods that start with a path of order 1."""
ADAMS: list[Any] = [lg.methods.CVODE(method="Adams")] if "cvode" in OUTSIDE else []


@pytest.mark.parametrize("rtol", [1e-9, 1e-5])
@pytest.mark.parametrize("restitution", [0.5, 0.9])
@pytest.mark.parametrize("method", [*OUTSIDE, *ADAMS])
def test_a_ball_comes_to_rest_in_words(method: Any, restitution: float, rtol: float) -> None:
    """The ball never falls through the floor. Multistep methods resolve flights down to their tolerance."""
    result = checked_run(ball(), 100.0, [floor(restitution)], method=method, rtol=rtol, atol=1e-3 * rtol)
    assert result.status is Status.STEP_TOO_SMALL and "infinitely many" in result.message
    assert result.y[0].min() > -1e-12 and result.dense(np.linspace(0, result.t[-1], 1000))[0].min() > -rtol
    end, several = FALL * (1 + restitution) / (1 - restitution), method in MULTISTEP or method in ADAMS
    off = 2e4 * rtol**0.75 if several else 1e-10
    assert result.t[-1] == pytest.approx(end, abs=off)
    times = result.t_events[0]
    assert len(times) > 8 and times == pytest.approx(bounces(restitution, len(times)), abs=off)
    apex = result.y_events[0][:, 1]
    assert (np.diff(np.abs(apex)) < 0).all()


@pytest.mark.few(2)
@pytest.mark.parametrize("method", OUTSIDE)
def test_what_failed_beyond_an_event_has_not_happened(method: str) -> None:
    """The force has no value beyond x = 1.05, but an event at x = 1 ends or reflects the motion."""
    model = build(kinetic=x.dot**2 / 2, forces={x: sqrt(1.05 - x) / 10}, initial={x.dot: 1.0})
    ended = checked_run(model, 3.0, [event(x - 1, terminal=True)], method=method)
    assert ended.status is Status.EVENT and ended.message == f"{method} stopped at an event at t = {ended.t[-1]:.6g}."
    turned = checked_run(model, 1.5, [event(x - 1, direction=1, reset={x.dot: -x.dot})], method=method)
    assert turned.status is Status.SUCCESS and turned.y[0].max() < 1 + 1e-9 and len(turned.t_events[0]) == 1
    past = checked_run(model, 3.0, [x - 1], method=method)
    assert past.status is Status.NON_FINITE and len(past.t_events[0]) == 1 and past.t[-1] < 1.1


@pytest.mark.parametrize("start", [0.0, 1e9, -1e9])
@pytest.mark.parametrize("method", OUTSIDE)
def test_a_large_time_moves_no_event(method: str, start: float) -> None:
    """The solver's time begins at 0, because the spacing of doubles at the start is 1e-7."""
    result = checked_run(free(), start + 3.5, [event(x - 1, reset={x: 0})], start, method)
    spacing = float(np.spacing(abs(start)))
    assert result.status is Status.SUCCESS
    assert result.t_events[0] - start == pytest.approx([1.0, 2.0, 3.0], abs=1e-13 + 4 * spacing)
    assert result.y_events[0][:, 0] == pytest.approx([1.0] * 3, rel=1e-12)


# --- SciPy -----------------------------------------------------------------------------------------------------
# What holds for SciPy's solvers alone: paths of steps that are taken again, bounds of steps, warnings, large times.


@pytest.mark.few(1)
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
    assert "max_step = -1, the length of a step of scipy-rk45" in refusal(RK45, max_step=-1)


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


@pytest.mark.parametrize("solver", [RK45, RK23, DOP853, Radau, BDF, LSODA])
def test_a_large_time_is_kept_track_of(solver: Any) -> None:
    """At t = 1e12 the spacing of doubles is 1e-4. LSODA lost its short steps there."""
    run = solver().integrate(problem(oscillator, 1e12 + 8.0, t0=1e12))
    assert (np.diff(run.t) > 0).all()
    if run.status is Status.STEP_TOO_SMALL:
        assert solver is BDF and run.t[-1] < 1e12 + 8.0  # its first steps are shorter than that
        return
    assert run.status is Status.SUCCESS and run.t[-1] == 1e12 + 8.0
    assert run.y[:, -1] == pytest.approx([np.cos(8.0), -np.sin(8.0)], abs=2e-4)
    assert run.dense(np.array([1e12 + 4.0]))[:, 0] == pytest.approx([np.cos(4.0), -np.sin(4.0)], abs=5e-4)
