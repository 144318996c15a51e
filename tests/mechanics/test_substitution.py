"""Other expressions for parameters: the system moves as with their values, and what cannot be meant is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy

import lagrange as lg
from tests.refusals import refusal

m, g, l, k, mu = lg.parameters("m g l k mu")
theta, s = lg.coordinates("theta s")


def wagon() -> lg.System:
    kinetic = m * l**2 * theta.dot**2 / 2 + k * (s.dot**2 + l * s.dot * theta.dot * sympy.cos(theta))
    return lg.System(
        kinetic=kinetic,
        potential=-m * g * l * sympy.cos(theta),
        forces={s: -g * s},
        dissipation=k * theta.dot**2 / 2,
        parameters={m: 2.0, g: 9.81, l: 1.3, k: 2.6},
        initial={theta: 0.4, s.dot: 0.1},
        positions={"bob": (s + l * sympy.sin(theta), -l * sympy.cos(theta))},
    )


def test_expressions_stand_wherever_the_parameter_stood() -> None:
    """With k = mu m and mu = 1.3 the system moves as before."""
    changed = wagon().substitute({"k": mu * m, l: sympy.Rational(13, 10)})
    assert {p.name for p in changed.statement.parameters} == {"m", "g", "mu"}
    assert not {k, l} & {p for e in changed.statement.positions["bob"] for p in e.free_symbols}
    q, v = np.array([0.4, 0.2]), np.array([0.3, -0.1])
    found = changed.compile("numpy").accelerations(q, v, parameters={"mu": 1.3})
    # The same formulas with two numbers in them; rounded differently.
    assert found == pytest.approx(wagon().compile("numpy").accelerations(q, v), rel=1e-13)
    assert changed.statement.initial == wagon().statement.initial


def test_two_parameters_change_places() -> None:
    swapped = wagon().substitute({m: k, k: m}).statement
    assert sympy.expand(swapped.kinetic - wagon().statement.kinetic.xreplace({m: k, k: m})) == 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "substitute takes a dict from parameters to values, as {l: 1}, not {}."),
        ({"mass": 1}, "'mass' is not a parameter of this system; its parameters are"),
        ({theta: 0}, "theta is a coordinate: eliminate() solves a constraint for it, transform() states the"),
        ({l: theta}, "the value of l is theta(t), which is not constant: state the system with it, so that its"),
        ({l: sympy.sin(lg.t)}, "the value of l is sin(t), which is not constant"),
        ({l: -1}, "the value of l is -1, but l was declared positive, and SymPy may have dropped an abs or a root"),
        ({l: "1"}, "the value of l is the text '1': give a SymPy expression"),
    ],
)
def test_refusals(given: Any, message: str) -> None:
    assert refusal(wagon().substitute, given).startswith(message)
