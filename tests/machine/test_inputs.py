"""Open functions of time as inputs of a model: parameters whose rates may occur in the equations."""

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from tests.refusals import refusal
from tests.statement.examples import VALUES, X, at, driven, theta, u

STATE = [0.7, -1.3]
CLOSE: dict[str, Any] = {"rtol": 1e-13, "atol": 1e-13}
"""Some roundings of terms of order one."""


@cache
def models(target: str) -> tuple[Any, Any]:
    """Return the model with open inputs, and the model with their values."""
    system = driven()
    return system.compile(target), system.substitute(VALUES).compile(target)


@pytest.mark.parametrize("target", [pytest.param("llvm", marks=pytest.mark.slow), "numpy"])
def test_an_input_with_the_values_of_a_function_gives_what_the_function_gives(target: str) -> None:
    opened, valued = models(target)
    for t in (0.0, 0.4, 2.5):
        for name in ("rhs", "jacobian", "energy", "momenta", "bias", "mass_matrix"):
            expected = valued.evaluate(name, STATE[:1], STATE[1:], t)
            np.testing.assert_allclose(opened.evaluate(name, STATE[:1], STATE[1:], t, at(t)), expected, **CLOSE)


def test_the_inputs_are_the_last_parameters_and_none_that_is_not_needed() -> None:
    model = driven().compile("numpy")
    assert model.inputs == ("X", "X_dot", "X_ddot", "u")
    assert [p.name for p in model.statement.parameters] == ["m", "g", "l", "X", "X_dot", "X_ddot", "u"]
    again = pickle.loads(pickle.dumps(model))
    assert again.inputs == model.inputs
    np.testing.assert_array_equal(again.rhs(0.0, STATE, at(1.0)), model.rhs(0.0, STATE, at(1.0)))


def test_a_constraint_that_an_input_moves_needs_its_second_rate() -> None:
    height, moved = lg.given("h"), lg.coordinate("y")
    mass = lg.parameters("M")
    lift = lg.System(mass * moved.dot**2 / 2, 0, constraints=[moved - height], parameters={mass: 2})
    model = lift.compile("numpy")
    assert model.inputs[-3:] == ("h", "h_dot", "h_ddot")
    values = {"h": 1.0, "h_dot": 2.0, "h_ddot": 3.0}
    assert model.rhs(0.0, [1.0, 2.0], values)[1] == pytest.approx(3.0, rel=1e-14)
    assert abs(model.multipliers([1.0], [2.0], 0.0, values)[0]) == pytest.approx(6.0, rel=1e-14)


def test_without_a_value_and_in_a_run_an_open_function_is_named() -> None:
    system = driven()
    model = system.compile("numpy")
    assert "no value for parameters X, X_dot, X_ddot and u" in refusal(model.rhs, 0.0, STATE)
    values = {**at(0.0)}
    for run in (
        lambda: system.run(1.0, parameters=values),
        lambda: lg.integrate(model, (0.0, 1.0), parameters=values),
        lambda: lg.flow(model),
        lambda: lg.ensemble(system, 1.0, initial={theta: [0.1, 0.2]}, parameters=values),
        system.check,
        system.conserved,
    ):
        assert "X and u are given functions of time, and have no values" in refusal(run)


def test_solve_ivp_takes_inputs_as_functions_of_time() -> None:
    from scipy.integrate import solve_ivp

    opened, valued = models("numpy")
    functions = {name: (lambda t, name=name: at(t)[name]) for name in opened.inputs}
    problem = opened.as_scipy(inputs=functions, events=[theta - 0.5])
    second = valued.as_scipy(events=[theta - 0.5])
    result, expected = (
        solve_ivp(**first.arguments((0, 0.5), {theta: 1}, method="RK45", rtol=1e-6)) for first in (problem, second)
    )
    np.testing.assert_allclose(result.y[:, -1], expected.y[:, -1], rtol=1e-9)
    assert result.t_events is not None and expected.t_events is not None
    np.testing.assert_allclose(result.t_events[0], expected.t_events[0], rtol=1e-9)


def test_functions_of_inputs_are_asked_for_by_name() -> None:
    opened, valued = models("numpy")
    assert "no function for inputs X, X_dot, X_ddot and u: give inputs=" in refusal(opened.as_scipy)
    with pytest.raises(lg.StatementError, match=r"'w' is not an input of this system; they are X, X_dot, X_ddot and u"):
        opened.as_scipy(inputs={"w": abs})
    assert "'u' is not an input of this system; it has none" in refusal(valued.as_scipy, inputs={u: abs})
    with pytest.raises(lg.StatementError, match=r"the input u is .*: give a function of the time"):
        opened.as_scipy(inputs={u: 2.0})
    with pytest.raises(
        lg.StatementError, match=r"the input u is a function of \(t, y\): give a function of the time alone"
    ):
        opened.as_scipy(inputs={X: abs, X.dot: abs, X.ddot: abs, u: lambda t, y: t})
    problem = opened.as_scipy(inputs={X: abs, X.dot: abs, X.ddot: abs, u: lambda t: "much"})
    assert "the input at t = 0" in refusal(problem.fun, 0.0, STATE)


# --- mass matrix ----------------------------------------------------------------------------------------------
# The mass matrix as a user asks for it: with velocities where it depends on them, and never at v = 0 instead.

TARGETS = ["llvm", "numpy"]
x, y, z = lg.coordinates("x y z")
c = lg.parameters("c")

RELATIVISTIC = {"lagrangian": -c * (c**2 - x.dot**2 - y.dot**2) ** 0.5, "coordinates": [x, y], "parameters": {c: 3}}
QUARTIC = {"kinetic": x.dot**4 / 4 + (1 + z**2) * z.dot**2 / 2 + y.dot**2 / 2, "potential": x**2}


def relativistic(v: np.ndarray) -> np.ndarray:
    """d2L/dv2 of the free particle of unit mass: gamma (1 + gamma^2 v v^T / c^2)."""
    gamma = 1 / np.sqrt(1 - v @ v / 9)
    result: np.ndarray = gamma * (np.eye(2) + gamma**2 * np.outer(v, v) / 9)
    return result


@pytest.mark.parametrize("target", TARGETS)
def test_a_mass_matrix_that_depends_on_velocities_is_evaluated_at_them(target: str) -> None:
    model = lg.System(**RELATIVISTIC).compile(target)
    v = np.array([[1.2, 0.0, -2.0, 0.3], [0.4, 0.0, 1.5, 2.9]])
    for k in range(4):
        single = model.mass_matrix([0.1, 0.2], v=v[:, k])
        np.testing.assert_allclose(single, relativistic(v[:, k]), rtol=1e-13, atol=1e-15)
    batch = model.mass_matrix(np.zeros((2, 4)), 0.0, None, v)
    np.testing.assert_allclose(np.moveaxis(batch, -1, 0), [relativistic(item) for item in v.T], rtol=1e-13, atol=1e-15)
    heavy = model.mass_matrix([0.0, 0.0], parameters={c: 1e9}, v=[1.2, 0.4])
    np.testing.assert_allclose(heavy, np.eye(2), atol=1e-15)


@pytest.mark.parametrize("target", TARGETS)
def test_without_them_it_is_refused_in_the_names_of_the_velocities(target: str) -> None:
    remedy = "give the velocities too, in the shape of q, as mass_matrix\\(q, v=v\\)\\."
    for stated, names in ((RELATIVISTIC, "x.dot and y.dot"), (QUARTIC, "x.dot")):
        model = lg.System(**stated).compile(target)
        for q in (np.ones(model.dimension), np.ones((model.dimension, 3))):
            with pytest.raises(lg.StatementError, match=f"the mass matrix of this system depends on {names}: {remedy}"):
                model.mass_matrix(q)
    with pytest.raises(lg.StatementError, match=r"q has shape \(2,\) and v \(2, 3\): give both the same shape"):
        lg.System(**RELATIVISTIC).compile(target).mass_matrix([1.0, 2.0], v=np.ones((2, 3)))
