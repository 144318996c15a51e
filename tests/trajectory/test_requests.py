"""Requests for runs: each invalid one is refused with a message, each valid one is run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from tests import systems
from tests.refusals import refusal

theta = lg.coordinate("theta")
m, g, l = lg.parameters("m g l")


@pytest.fixture(scope="module")
def pendulum() -> lg.System:
    return systems.pendulum(initial={theta: 1.0})


@pytest.fixture(scope="module")
def coupled() -> lg.System:
    x, y = lg.coordinates("x y")
    return lg.System(
        kinetic=(x.dot**2 + y.dot**2 + x.dot * y.dot * sympy.cos(x - y)) / 2, potential=x**2 + y**2, name="coupled"
    )


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"method": "hopfrog"}, "there is no method 'hopfrog'; the methods are euler, "),
        ({"method": "dop583"}, "Did you mean 'dop853'?"),
        ({"method": 4}, "method is 4: give a name, such as 'taylor', or an instance"),
        ({"method": lg.methods.RungeKutta}, "give a name, such as 'taylor', or an instance"),
        ({"method": "rk4", "rtol": 1e-3}, "rk4 takes equal steps and cannot aim at a tolerance: give step="),
        ({"step": 0.1}, "taylor chooses its steps by itself: give rtol and atol"),
        ({"method": "rk4", "step": -0.1}, "step = -0.1: give a positive size"),
        ({"method": "rk4", "step": 0.0}, "step = 0: give a positive size"),
        ({"method": "rk4", "step": float("nan")}, "step is nan: give a finite number"),
        ({"method": "rk4", "step": 1e-30}, "step = 1e-30 is below the spacing of floating-point times"),
        ({"rtol": -1e-3}, "rtol = -0.001: give a finite tolerance that is not negative"),
        ({"atol": float("nan")}, "atol = nan: give a finite tolerance that is not negative"),
        (
            {"rtol": [1e-9, 1e-9]},
            "rtol is [1e-09, 1e-09]: give one number, which holds for all entries of the state",
        ),
        ({"atol": np.array([1e-9])}, "atol is array([1.e-09]): give one number, which holds for all entries"),
        ({"atol": "a", "method": "dop853"}, "atol is 'a' (str): give a number"),
        ({"rtol": True}, "rtol is True (bool): give a number"),
        ({"rtol": 1, "method": "dop853"}, "rtol = 1 allows errors as large as the state itself: give a smaller"),
        ({"rtol": 1.0}, "rtol = 1 allows errors as large as the state itself: give a smaller"),
        ({"rtol": 2, "method": "scipy-rk45"}, "rtol = 2 allows errors as large as the state itself: give a smaller"),
        (
            {"rtol": 1e-12, "method": lg.methods.Taylor(rtol=1e-3)},
            "rtol is given twice, 1e-12 for the run and 0.001 for taylor itself: leave one of them out.",
        ),
        (
            {"step": 0.1, "method": lg.methods.RK4(step=0.2)},
            "step is given twice, 0.1 for the run and 0.2 for rk4 itself: leave one of them out.",
        ),
        ({"t_eval": [0.0, 2.0]}, "t_eval contains 2, outside the time span from 0 to 1"),
        ({"t_eval": [0.5, 0.2]}, "t_eval is not sorted in the direction of the run: give the times in increasing"),
        ({"t_eval": [0.5, float("nan")]}, "t_eval contains nan, outside the time span"),
        ({"t_eval": [[0.5]]}, "t_eval has shape (1, 1)"),
        ({"t_eval": 1000}, "give a list of times, such as np.linspace(0, "),
        ({"t_eval": ["a"]}, "t_eval has entries of type <U1: give real numbers"),
        ({"events": lambda t, y: y[0]}, "give a SymPy expression whose zero is the event, such as theta - 1"),
        ({"events": [g - 9]}, "event 0 is g - 9, which is constant along a run"),
        ({"max_steps": 0}, "max_steps = 0: give a whole number of at least 1"),
        ({"max_steps": 1.5}, "max_steps = 1.5: give a whole number of at least 1"),
        ({"max_memory": 0}, "max_memory = 0: give a positive number of bytes"),
        ({"max_memory": "1"}, "'1'"),
        ({"max_wall": -1.0}, "max_wall = -1: give a positive number of seconds"),
        (
            {"parameters": {"mm": 2.0}},
            "'mm' is not a parameter of this system; its parameters are m,",
        ),
        ({"initial": {"thet": 1.0}}, "initial names 'thet', which is not a coordinate or velocity of this system"),
        ({"initial": [1.0]}, "initial is a list: give a dict such as {theta: 1.0}"),
        ({"target": "fortran"}, "there is no target 'fortran'; the targets are llvm and numpy"),
    ],
)
def test_a_request_that_cannot_be_meant_is_refused(pendulum: lg.System, request_: dict[str, Any], words: str) -> None:
    assert words in refusal(pendulum.run, 1.0, **request_)


@pytest.mark.parametrize("span", [5.0, (0.0,), (0.0, 1.0, 2.0), "01", (0.0, float("inf")), (0.0, "1")])
def test_a_span_is_two_times(pendulum: lg.System, span: Any) -> None:
    with pytest.raises(lg.StatementError, match="time"):
        lg.integrate(pendulum.compile(), span)


def test_a_model_is_asked_for(pendulum: lg.System) -> None:
    words = "is not a compiled model: give system.compile"
    not_a_model: Any = pendulum
    with pytest.raises(lg.StatementError, match=words):
        lg.integrate(not_a_model, (0.0, 1.0))
    with pytest.raises(lg.StatementError, match=words):
        lg.flow(not_a_model)


def test_a_missing_parameter_is_named() -> None:
    system = lg.System(kinetic=m * l**2 * theta.dot**2 / 2, potential=-m * g * l * sympy.cos(theta), parameters={m: 1})
    with pytest.raises(lg.StatementError, match=r"no value for parameters (l and g|g and l): give one"):
        system.run(1.0)
    assert system.run(1.0, parameters={l: 1.0, "g": 9.81}).status is lg.Status.SUCCESS


def test_energies_must_be_finite_at_the_start() -> None:
    x = lg.coordinate("x")
    system = lg.System(kinetic=x.dot**2 / 2, potential=1 / x, name="barrier")
    with pytest.raises(
        lg.StatementError, match=r"energy of barrier is \w+ at the initial state \(x = 0 and x\.dot = 0\)"
    ):
        system.run(1.0)


@pytest.mark.parametrize("name", ["verlet", "symplectic-euler"])
def test_a_splitting_is_refused_where_it_is_not_symplectic(coupled: lg.System, name: str) -> None:
    with pytest.raises(
        lg.StatementError,
        match=r"its mass matrix changes along the motion\. Use variational-midpoint or galerkin4, which are symplectic "
        r"for any mass matrix, or rk4 or dop853\.$",
    ):
        coupled.run(1.0, method=name)
    for remedy in ("variational-midpoint", "galerkin4", "rk4", "dop853"):
        assert coupled.run(0.1, method=remedy).status is lg.Status.SUCCESS


def test_a_splitting_is_refused_where_accelerations_depend_on_velocities() -> None:
    x = lg.coordinate("x")
    damped = lg.System(kinetic=x.dot**2 / 2, dissipation=x.dot**2 / 2, initial={x: 1.0})
    with pytest.raises(
        lg.StatementError,
        match=r"depend on velocities, as with friction or a magnetic field\. With friction use rk4 or dop853; without, "
        r"variational-midpoint or galerkin4, which are symplectic\.$",
    ):
        damped.run(1.0, method="verlet")


def test_no_step_means_a_thousand_and_says_so(pendulum: lg.System) -> None:
    solution = pendulum.run(2.0, method="rk4")
    assert solution.steps == 1000 and "No step was given: 1000 equal steps of 0.002 were taken." in solution.message


def test_the_same_tolerance_given_twice_is_given_once(pendulum: lg.System) -> None:
    method = lg.methods.DOP853(rtol=1e-6, atol=1e-8)
    assert (pendulum.run(1.0, method=method, rtol=1e-6).y == pendulum.run(1.0, method=method).y).all()
