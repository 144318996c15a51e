"""The functions for scipy.integrate: values, derivatives, events, initial states, refusals, pickles."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.recipes.model import Model
from tests.models import build, g, l, m, theta, x
from tests.models import model as shared
from tests.recipes.agreement import named, singular


def pendulum() -> Model:
    return shared("pendulum", "llvm")


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "BDF", "LSODA"])
def test_every_solver_runs_as_ours_does(method: str) -> None:
    problem = pendulum().as_scipy({l: 0.9})
    found = solve_ivp(**problem.arguments((0.0, 2.0), {theta: 1.0}, method=method, rtol=1e-9, atol=1e-9))
    ours = lg.integrate(pendulum(), (0.0, 2.0), {theta: 1.0}, parameters={l: 0.9}, rtol=1e-13)
    # Each keeps the error of a step, not that of the run, below its tolerance; BDF loses most, 3e-7.
    np.testing.assert_allclose(found.y[:, -1], ours.y[:, -1], atol=2e-6)
    assert ("jac" in problem.arguments((0, 1), method=method)) is (method in ("Radau", "BDF", "LSODA"))
    assert found.success and bool(found.njev) == (method in ("Radau", "BDF"))  # LSODA sees that it is not stiff


def test_values_are_those_of_the_model_for_one_state_and_for_many() -> None:
    model, values = pendulum(), {m: 2.0, g: 9.0}
    problem = model.as_scipy(values)
    state, many = np.array([0.3, -0.2]), np.array([[0.3, 0.1], [-0.2, 0.5]])
    np.testing.assert_array_equal(problem.fun(0.1, state), model.rhs(0.1, state, values))
    np.testing.assert_array_equal(problem.fun(0.1, many), model.rhs(0.1, many, values))
    np.testing.assert_array_equal(problem.fun(0.1, [0.3, -0.2]), model.rhs(0.1, state, values))
    np.testing.assert_array_equal(problem.jac(0.1, state), model.jacobian(0.1, state, values))


def test_parameters_are_fixed() -> None:
    model = pendulum()
    values = model.parameter_array().copy()
    problem = model.as_scipy(values)
    values[:] = 7.0
    state = np.array([0.3, 0.0])
    np.testing.assert_array_equal(problem.fun(0.0, state), model.rhs(0.0, state))


def test_events_are_those_of_our_runs() -> None:
    lowest = lg.event(theta, direction=-1)
    model = pendulum()
    turning = lg.event(theta.ddot * l + theta.dot, terminal=2)
    problem = model.as_scipy(events=[lowest, turning])
    assert [event.direction for event in problem.events] == [-1.0, 0.0]
    assert [event.terminal for event in problem.events] == [0, 2]
    found = solve_ivp(**problem.arguments((0.0, 5.0), {theta: 1.0}, method="DOP853", rtol=1e-11, atol=1e-12))
    ours = lg.integrate(model, (0.0, 5.0), {theta: 1.0}, events=[lowest, turning], rtol=1e-13)
    assert found.status == 1 and found.t_events is not None and len(found.t_events[1]) == 2
    for one, other in zip(found.t_events, ours.t_events, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)


def test_a_reset_and_an_unknown_event_are_refused() -> None:
    with pytest.raises(StatementError, match=r"event 0 has a reset, which SciPy's solvers do not know: end there with"):
        pendulum().as_scipy(events=lg.event(theta, reset={theta.dot: -theta.dot}))
    with pytest.raises(StatementError, match="event 0 contains x"):
        pendulum().as_scipy(events=[x])


def test_the_initial_state_is_that_of_a_run() -> None:
    model = named("cartesian-pendulum")
    problem, n = model.as_scipy(), model.dimension
    alone: Any = 3
    np.testing.assert_array_equal(problem.y0(), model.statement.initial)
    off = {model.statement.coordinates[0]: 17.0}
    with pytest.raises(StatementError):
        problem.y0(off)
    assert problem.arguments((1, 2))["t_span"] == (1.0, 2.0) and len(problem.arguments((0, 1))["y0"]) == 2 * n
    with pytest.raises(StatementError, match="the time span is 3"):
        problem.arguments(alone)


def test_a_given_table_is_not_left() -> None:
    drive = lg.given("drive", ([0.0, 1.0, 2.0, 3.0], [0.0, 0.3, 0.1, 0.0]))
    model = build("numpy", kinetic=m * (x.dot + drive.dot) ** 2 / 2, potential=x**2, initial={x: 1.0})
    problem = model.as_scipy()
    assert solve_ivp(**problem.arguments((0.0, 3.0))).success
    with pytest.raises(StatementError, match="drive"):
        problem.arguments((0.0, 4.0))


def test_a_singular_mass_matrix_is_a_sentence() -> None:
    model = singular(2)
    problem = model.as_scipy()
    with pytest.raises(RunError, match="mass matrix"):
        problem.fun(0.0, np.zeros(4))
    with pytest.raises(RunError):
        problem.jac(0.0, np.zeros(4))


def test_what_is_not_finite_stays_so() -> None:
    problem = build("llvm", kinetic=x.dot**2 / 2, potential=1 / x, initial={x: 1.0}).as_scipy()
    assert problem.fun(0.0, np.array([0.0, 1.0])).tolist() == [1.0, np.inf]


@pytest.mark.parametrize("target", ["numpy", "llvm"])
def test_a_problem_pickles(target: str) -> None:
    model = shared("pendulum", target)
    problem: Any = model.as_scipy({l: 0.9}, events=[theta])
    state = np.array([0.3, -0.2])
    problem.fun(0.0, state)
    again = pickle.loads(pickle.dumps(problem))
    np.testing.assert_array_equal(again.fun(0.1, state), problem.fun(0.1, state))
    assert pickle.loads(pickle.dumps(problem.events[0]))(0.0, state) == 0.3
