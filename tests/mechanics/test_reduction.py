"""Eliminated coordinates: the smaller system has the motion of the system with the constraint."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, exp, sin, sqrt

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.statement import Link
from tests.refusals import refusal

m, g, l, a, c = lg.parameters("m g l a c")
x, y, z, u, theta = lg.coordinates("x y z u theta")
ROD = x**2 + y**2 - l**2


def bead() -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"wire": y - a * x**2},
        dissipation=c * y.dot**2 / 2,
        forces={y: -l, x: -x},
        parameters={m: 1.2, g: 9.81, a: 0.7, c: 0.1, l: 0.3},
        initial={x: 0.6, y: 0.252, x.dot: 0.2, y.dot: 2 * 0.7 * 0.6 * 0.2},
        positions={"bead": (x, y)},
        links=[("origin", "bead")],
        name="bead",
    )


def test_a_bead_keeps_one_coordinate_and_all_that_was_stated() -> None:
    small = bead().eliminate(y).statement
    assert small.names == ("x",)
    assert small.constraints == ()
    assert sympy.expand(small.kinetic - m * (x.dot**2 + (2 * a * x * x.dot) ** 2) / 2) == 0
    assert sympy.expand(small.potential - m * g * a * x**2) == 0
    assert sympy.expand(small.dissipation - c * (2 * a * x * x.dot) ** 2 / 2) == 0
    assert sympy.expand(small.forces[0] - (-x - 2 * l * a * x)) == 0
    assert small.positions["bead"] == (x, a * x**2)
    assert small.links == (Link("origin", "bead"),)
    assert small.initial == (0.6, 0.2)
    assert small.defaults == bead().statement.defaults
    assert small.name == "bead"


@pytest.mark.parametrize("key", [y, "y", "wire"])
def test_coordinates_and_constraints_are_named_alike(key: Any) -> None:
    assert bead().eliminate(key).statement.names == ("x",)


@pytest.mark.parametrize(
    ("initial", "words"),
    [
        ({x: 0.6, y: -0.8}, "y is -0.8 there, and 0.8"),
        ({x: 0.6, y: 0.8, x.dot: 1.0, y.dot: 0.75}, "y.dot is 0.75 there, and -0.75"),
        ({x: 1.0, y.dot: 0.5}, "y.dot is 0.5 there, and undefined by"),
        ({x: 1.2, y: 0.8}, "y is 0.8 there, and 0.663325*I by"),
    ],
)
def test_a_branch_that_the_motion_does_not_start_on_is_refused(initial: Any, words: str) -> None:
    rod = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2, constraints={"rod": ROD}, parameters={m: 1, l: 1}, initial=initial
    )
    with pytest.raises(StatementError) as refusal:
        rod.eliminate({y: sqrt(l**2 - x**2)})
    assert str(refusal.value).startswith("y = 'sqrt(l**2 - x**2)' does not hold at the initial state: " + words)
    assert "Give the expression of the branch that is meant, or other initial values." in str(refusal.value)


def test_initial_values_that_were_not_given_follow_from_the_branch() -> None:
    """Stated initial values may be rounded; missing ones follow from the branch."""
    stated: dict[str, Any] = {"kinetic": x.dot**2 + y.dot**2, "constraints": {"rod": ROD}, "parameters": {l: 1}}
    for initial in ({x: 0.6, x.dot: 1.0}, {x: 1 / 3, y: 0.942809}):
        small = lg.System(**stated, initial=initial).eliminate({y: sqrt(l**2 - x**2)})
        assert small.statement.initial == (initial[x], initial.get(x.dot, 0.0))


def test_a_lagrangian_stays_one() -> None:
    system = lg.System(lagrangian=x.dot**2 / 2 + y.dot**2 / 2 - x * y, constraints=[y - 2 * x])
    small = system.eliminate(y).statement
    assert small.potential == 0
    assert sympy.expand(small.lagrangian - (5 * x.dot**2 / 2 - 2 * x**2)) == 0


# --- the law -----------------------------------------------------------------------------------------------------


def random_system(seed: int) -> tuple[lg.System, Any, bool]:
    """Return a system, the expression of y by its random constraint, and whether that is surely always defined."""
    draw = np.random.default_rng(seed)

    def number() -> Any:
        return sympy.Rational(int(draw.integers(1, 9)), int(draw.integers(1, 9))) * int(draw.choice([-1, 1]))

    inner = [x, z, x * z, sin(x), cos(z), x**2, lg.t, exp(-(z**2)), x * lg.t]
    shape = sum(number() * inner[int(i)] for i in draw.choice(len(inner), 3, replace=False))
    kind = int(draw.integers(5))
    factor = [number(), a, 1 + x**2, exp(z), 2 + cos(x)][kind]
    velocities = (x.dot, y.dot, z.dot)
    kinetic = sum(abs(number()) * v**2 for v in velocities) + x.dot * z.dot * cos(y) / 9 + y.dot * x.dot * z / 99
    potential = number() * y**2 + number() * sin(y * x) + number() * z * y
    system = lg.System(
        kinetic=kinetic,
        potential=potential,
        coordinates=[x, y, z],
        constraints={"tie": factor * y - shape},
        forces={x: number() * y * x.dot, y: number() * z.dot + y, z: number() * lg.t},
        dissipation=abs(number()) * y.dot**2 / 2 + abs(number()) * (x.dot - y.dot) ** 2 / 4,
        parameters={a: 1.4},
    )
    return system, shape / factor, kind < 4


@pytest.mark.few
@pytest.mark.parametrize("seed", range(24))
def test_the_smaller_system_has_the_same_accelerations(seed: int) -> None:
    system, solved, safe = random_system(seed)
    small = system.eliminate(y if safe else {y: solved})
    q, v, t = np.array([0.4, -0.7]), np.array([0.3, 0.9]), 0.6
    model = small.compile(check=False)
    state = np.concatenate([q, v])[:, None]
    value = float(model.evaluate_expression(solved, [t], state)[0])
    rate = solved.diff(lg.t)
    speed = float(model.evaluate_expression(rate, [t], state)[0])
    whole = system.compile(check=False).accelerations([q[0], value, q[1]], [v[0], speed, v[1]], t)
    # Ten digits are right where a hundred operations cancel; a term that is missing is a hundredth at least.
    np.testing.assert_allclose(model.accelerations(q, v, t), whole[[0, 2]], rtol=1e-10, atol=1e-10)


# --- refusals ----------------------------------------------------------------------------------------------------


def pair(**constraints: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2 + theta.dot**2) / 2, coordinates=[x, y, theta], constraints=constraints
    )


@pytest.mark.parametrize(
    ("constraints", "expected", "words"),
    [
        ({"rod": ROD}, (), "eliminate() has no arguments: give a coordinate that a constraint determines."),
        ({"rod": ROD}, (z,), "'z' is not a coordinate of this system; they are x, y and theta."),
        ({"rod": ROD}, (y,), "rod does not determine y safely: it is not linear in y, so that y may have several"),
        ({"arm": x * y - theta * cos(x)}, (theta,), "arm does not determine theta safely: the coefficient of theta"),
        ({"rod": ROD}, ("rod",), "the constraint rod determines no coordinate safely: in no coordinate is it linear"),
        ({"roll": x.dot - y * theta.dot}, (x,), "x is in no constraint on positions: roll is a constraint on"),
        ({"roll": x.dot - y * theta.dot}, ("roll",), "the constraint roll determines no coordinate: roll is a"),
        ({"rod": ROD}, ({y: l - x},), "y = 'l - x' does not solve a constraint: give a solution of one of rod, the"),
        ({"rod": ROD}, ({y: y + x},), "the value of y is 'x(t) + y(t)': give an expression in the other coordinates,"),
        ({"tie": y - x, "same": theta - x}, (y, theta, x), "x is the only coordinate left: without it nothing moves."),
    ],
)
def test_what_cannot_be_eliminated_is_refused(constraints: Any, expected: Any, words: str) -> None:
    assert refusal(pair(**constraints).eliminate, *expected).startswith(words)


@pytest.mark.parametrize("expected", [y, "floor", {y: 0}])
def test_a_multiplier_in_a_force_keeps_its_constraint(expected: Any) -> None:
    """The message was "a force contains lambda[floor], but system has no constraints"."""
    block = lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints={"floor": y},
        forces={x: -c * lg.multiplier("floor") * sympy.sign(x.dot)},
    )
    with pytest.raises(StatementError, match="the force on x contains the multiplier of floor, which has no value"):
        block.eliminate(expected)


def test_a_branch_has_to_hold_near_the_initial_state_alone() -> None:
    roof = lg.System(
        kinetic=(x.dot**2 + y.dot**2) / 2,
        potential=g * y,
        constraints={"roof": y - sympy.Abs(x)},
        parameters={g: 1},
        initial={x: -1, y: 1},
    )
    assert roof.eliminate({y: -x}).accelerations() == {x: g / 2}
    with pytest.raises(StatementError, match="y = 'x' does not solve a constraint"):
        roof.eliminate({y: x})
