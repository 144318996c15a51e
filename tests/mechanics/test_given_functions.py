"""Analyses of systems with given functions: with values they are functions of t; open ones are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from sympy import Function, cos, sin

import lagrange as lg

theta = lg.coordinate("theta")
m, g, l = lg.parameters("m g l")


def driven(pivot: Any) -> lg.System:
    """Return a pendulum whose pivot moves along a line."""
    bob = (pivot + l * sin(theta), -l * cos(theta))
    return lg.System(lg.kinetic_energy(m, bob), lg.gravity(m, bob, g), parameters={m: 1, g: 9.81, l: 1})


def test_equations_may_contain_the_given_function_and_its_derivatives() -> None:
    X = lg.given("X", sin(2 * lg.t))
    system = driven(X)
    assert system.compare("l*theta_ddot + g*sin(theta) + X_ddot*cos(theta)")
    assert system.compare([l * theta.ddot + g * sin(theta) - 4 * X * cos(theta)])
    wrong = system.compare("l*theta_ddot + g*sin(theta) - X_ddot*cos(theta)")
    assert not wrong and "wrong sign" in wrong.message
    with pytest.raises(lg.StatementError, match="'Y_ddot' is not a symbol of this system"):
        system.compare("l*theta_ddot + g*sin(theta) + Y_ddot*cos(theta)")


ASKED: dict[str, Callable[[lg.System], Any]] = {
    "hamiltonian": lambda one: one.hamiltonian(),
    "linearize": lambda one: one.linearize(at={theta: 0}),
    "small": lambda one: one.small({theta: 0}),
    "conserved": lambda one: one.conserved(),
    "equilibria": lambda one: one.equilibria(),
    "compare": lambda one: one.compare("theta_ddot"),
}


@pytest.mark.parametrize("asked", ASKED)
def test_open_functions_are_refused(asked: str) -> None:
    with pytest.raises(lg.StatementError, match="X is a given function of time, and has no values to compute with"):
        ASKED[asked](driven(lg.given("X")))
    with pytest.raises(lg.StatementError, match=r"compute with: call linearize\(inputs=\['X'\]\) for a matrix B"):
        driven(lg.given("X")).linearize()
    with pytest.raises(lg.StatementError, match=r"U\(theta\(t\)\) has no formula: a derivation leaves"):
        ASKED[asked](lg.System(m * theta.dot**2 / 2, Function("U")(theta), parameters={m: 1}))
