"""CVODE as a method: every run ends with a status, keeps its states, and prints nothing."""

import itertools
import sys
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy

from lagrange.trajectory.foreign.sundials import CVODE
from lagrange.trajectory.trajectory import Status
from tests.trajectory.runs import double_pole, oscillator, problem

pytest.importorskip("sksundae")


@pytest.fixture(params=["BDF", "Adams"])
def method(request: Any) -> CVODE:
    return CVODE(request.param)


@pytest.fixture(autouse=True)
def silence(capfd: Any) -> Any:
    """Assert that a run prints nothing, neither from C (SUNDIALS) nor from Python (scikit-sundae)."""
    yield
    assert tuple(capfd.readouterr()) == ("", "")


def test_a_bad_derivative_never_ends_well_wherever_it_is_met(method: CVODE) -> None:
    # llnl/sundials#258 loops for ever on NaN, and LLNL/sundials#82 breaks off with the word for success.
    for begin in (0.0, 1e-13, 1e-9, 1e-3, 0.1, 1.0, 1.9, 1.999999):
        run = method.integrate(problem(lambda t, x, v, begin=begin: np.nan if t > begin else -x))
        assert run.status is Status.NON_FINITE and run.t[-1] <= begin, (begin, run.message)
        assert np.isfinite(run.y).all() and np.isfinite(run.dense(np.linspace(0, run.t[-1], 50))).all()


def test_bounds_of_steps_may_be_numbers_of_sympy(method: CVODE) -> None:
    bounded = replace(method, max_step=sympy.Rational(1, 8), first_step=sympy.Rational(1, 16))
    run = bounded.integrate(problem(lambda t, x, v: -x))
    assert run.status is Status.SUCCESS and np.diff(run.t).max() <= 0.125


def test_what_cvode_gives_up_is_told_in_its_words_and_not_printed(method: CVODE) -> None:
    signs = itertools.cycle((1e9, -1e9))
    restless = problem(lambda t, x, v: next(signs) if t > 0 else -x)
    run = replace(method, first_step=1.0).integrate(restless)
    assert run.status is Status.DIVERGED and run.t.tolist() == [0.0]
    assert "CVODE says: " in run.message and "failed too many times" in run.message


def test_steps_that_do_not_move_the_time_end_the_run(method: CVODE) -> None:
    # LLNL/sundials#44: dy/dt = 1/(t - 1) from t = 1 + 1e-15. CVODE warns ten times, and then steps on in silence.
    near = problem(lambda t, x, v: 1 / (t - 1), 1 + 1e-12, (0.0, 0.0), t0=1 + 1e-15, max_steps=10**7)
    began = time.process_time()
    run = method.integrate(near)
    assert run.status is not Status.MAX_STEPS and time.process_time() - began < 60
    assert (np.diff(run.t) > 0).all()
    blown = method.integrate(problem(double_pole, 1.0, (1.0, 2.0), max_steps=10**7))
    assert blown.status is Status.STEP_TOO_SMALL, blown.message
    far = method.integrate(problem(oscillator, 1e17, t0=1e17 - 1024, max_steps=10**7))
    assert far.status is Status.STEP_TOO_SMALL and "below the spacing of floating-point times" in far.message


@pytest.mark.parametrize(("t0", "t1"), [(1e9, float(np.nextafter(1e9, 2e9))), (1.0, 1 - 1e-15), (0.0, 1e-130)])
def test_a_span_of_a_few_spacings_is_run(method: CVODE, t0: float, t1: float) -> None:
    run = method.integrate(problem(lambda t, x, v: 1.0, t1, (0.0, 1.0), t0=t0))
    assert run.status is Status.SUCCESS and run.t[-1] == t1 and run.y[0, -1] == pytest.approx(t1 - t0)
    assert method.integrate(problem(oscillator, 5e-324)).status is Status.STEP_TOO_SMALL


@pytest.mark.few
@pytest.mark.parametrize("t1", [2.0, -2.0])
def test_options_bound_the_steps(method: CVODE, t1: float) -> None:
    bounded = replace(method, max_step=0.01).integrate(problem(oscillator, t1))
    assert np.abs(np.diff(bounded.t)).max() <= 0.01 * (1 + 1e-9)
    first = replace(method, first_step=1e-7).integrate(problem(oscillator, t1))
    assert abs(first.t[1]) == pytest.approx(1e-7)
    low = replace(method, max_order=2)
    assert low.claims.order == 2 and low.integrate(problem(oscillator, t1)).steps > 2 * first.steps
    assert replace(method, first_step=1e9).integrate(problem(oscillator, t1)).status is Status.SUCCESS


def test_what_others_print_while_threads_run_is_let_through(method: CVODE, capfd: Any) -> None:
    threads = [threading.Thread(target=lambda: method.integrate(problem(oscillator))) for _ in range(4)]
    before = sys.stdout
    for thread in threads:
        thread.start()
    sys.stdout.write("x")
    while any(thread.is_alive() for thread in threads):
        sys.stdout.write("x")
    for thread in threads:
        thread.join()
    assert sys.stdout is before and set(capfd.readouterr().out) == {"x"}
