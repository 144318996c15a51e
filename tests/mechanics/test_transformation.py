"""New coordinates: the same motion in them, forces of equal work, and initial states that are solved for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
from sympy import cos, exp, pi, sin, sqrt

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.mechanics import transformation
from tests.refusals import refusal

m, g, k, c, w, mu = lg.parameters("m g k c w mu")
x, y, z, r, phi, theta, X, Y, u = lg.coordinates("x y z r phi theta X Y u")


def particle(**more: Any) -> lg.System:
    stated: dict[str, Any] = {
        "forces": {x: -c * y, y: -z.dot},
        "dissipation": c * (x.dot**2 + y.dot**2) / 2,
        "parameters": {m: 1.3, c: 0.1, w: 0.3, g: 2.0},
        "initial": {x: 1.0, y.dot: 2.0, z: 1.0},
        "positions": {"body": (x, y, z)},
        **more,
    }
    return lg.System(m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, m * g * z, coordinates=[x, y, z], **stated)


away, turn = lg.coordinates("away turn")  # of no other test, which might declare them in another order

TURNING = {x: X * cos(w * lg.t) - Y * sin(w * lg.t), y: X * sin(w * lg.t) + Y * cos(w * lg.t)}
ROUND = {x: r * cos(phi), y: r * sin(phi)}
BALL = {x: r * sin(theta) * cos(phi), y: r * sin(theta) * sin(phi), z: r * cos(theta)}


@pytest.mark.few(1)
@pytest.mark.parametrize("given", [TURNING, ROUND, BALL, {z: exp(u / 3) - 2}, {"x": u + z}], ids=str)
def test_the_motion_is_the_same(given: Any) -> None:
    system = particle()
    new = system.transform(given)
    first, second = system.run(1.5, rtol=1e-12), new.run(1.5, rtol=1e-12)
    for row, point in enumerate(new.statement.positions["body"]):
        # Both err by some 1e-12 a step.
        assert second.evaluate(point)[-1] == pytest.approx(first.y[row, -1], abs=1e-10)


def test_a_name_that_stays_takes_the_force_on_its_new_meaning() -> None:
    new = particle().transform({x: x + y, y: x - y})
    # The forces (-c y, -z') on the old coordinates, along the slopes (1, 1) and (1, -1); damping acts as before.
    pulls = -c * (x - y), -z.dot
    for q, force in zip(new.statement.coordinates[:2], new.statement.forces, strict=False):
        assert sympy.expand(force - (pulls[0] + {x: 1, y: -1}[q] * pulls[1])) == 0


def test_kepler_in_polar_coordinates_is_that_of_the_book() -> None:
    # Goldstein, Classical Mechanics, 3rd ed., section 3.2.
    system = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        -mu / sqrt(x**2 + y**2),
        coordinates=[x, y],
        parameters={m: 1, mu: 1},
        initial={x: 0.0, y: 0.5, x.dot: -2.0, y.dot: 0.3},
    )
    new = system.transform(ROUND, positive=r)
    assert sympy.expand(new.statement.kinetic - m * (r.dot**2 + r**2 * phi.dot**2) / 2) == 0
    assert new.statement.potential == -mu / r
    start = dict(zip((*new.coordinates, *new.statement.velocities), new.statement.initial, strict=True))
    expected = {r: 0.5, phi: float(pi) / 2, r.dot: 0.3, phi.dot: 4.0}
    assert start == pytest.approx(expected, abs=1e-14)
    assert system.transform(ROUND).statement.potential == -mu / sympy.Abs(r)


def test_constraints_come_along_and_time_stands_in_the_velocities() -> None:
    ring = lg.System(
        m * (x.dot**2 + y.dot**2) / 2,
        coordinates=[x, y],
        constraints={"ring": x**2 + y**2 - 1},
        parameters={m: 1, w: 2},
        initial={x: 1.0, y.dot: 0.5},
    )
    new = ring.transform(ROUND)
    assert sympy.expand(new.statement.constraints[0].expression - (r**2 - 1)) == 0
    turning = ring.transform({x: r * cos(phi + w * lg.t), y: r * sin(phi + w * lg.t)})
    start = dict(zip((*turning.coordinates, *turning.statement.velocities), turning.statement.initial, strict=True))
    assert start == pytest.approx({r: 1.0, phi: 0.0, r.dot: 0.0, phi.dot: 0.5 - 2.0}, abs=1e-14)


def test_dimensions_that_were_stated_are_kept_where_they_hold() -> None:
    sized = lg.System(
        m * (x.dot**2 + y.dot**2) / 2, g * m * y, coordinates=[x, y], dimensions={m: "kg", x: "m", y: "m"}
    )
    new = sized.transform(ROUND).statement
    assert {str(key) for key in new.dimensions} == {"m", "g", "t"}
    assert new.dimensions[g] == sized.routhian(x).statement.dimensions[g] == sized.hamiltonian().statement.dimensions[g]


def test_an_initial_state_may_be_given_in_the_new_coordinates() -> None:
    new = particle(initial={y.dot: 1.0}).transform(ROUND, initial={r: 2.0, "phi_dot": 0.5})
    start = dict(zip((*new.coordinates, *new.statement.velocities), new.statement.initial, strict=True))
    assert start == {r: 2.0, phi: 0.0, z: 0.0, r.dot: 0.0, phi.dot: 0.5, z.dot: 0.0}


@pytest.mark.parametrize(
    ("given", "more", "words"),
    [
        ([x], {}, "transform takes a dict from coordinates to expressions in new ones, as {x: r*cos(phi), y: r*sin("),
        ({x: away * cos(turn)}, {}, "the expressions for x have 2 new coordinates (away and turn), and 1 are"),
        ({x: r, y: 2 * r}, {}, "the expressions for x and y have 1 new coordinates (r), and 2 are replaced: a transf"),
        ({x: away + turn, y: 2 * away + 2 * turn}, {}, "x and y do not vary independently with away and turn: the det"),
        ({x: away, y: turn}, {"positive": x}, "positive contains x(t), which is not a new coordinate; they are away"),
        (ROUND, {"initial": 3}, "initial is an int: give a dict from new coordinate or velocity to value, such as {r"),
        ({x: exp(u) + 2}, {}, "no values of u were found at which x = 1, from 256 starts: give initial={u: ...}"),
    ],
)
def test_refusals(given: Any, more: Any, words: str) -> None:
    assert refusal(particle().transform, given, **more).startswith(words)


def test_a_singular_initial_state_is_refused() -> None:
    # At x = y = 0 any angle will do; one that starts with y.dot = 1 needs another than zero.
    with pytest.raises(StatementError, match="the initial velocities have no values in the new coordinates, which"):
        particle(initial={y.dot: 1.0}).transform(ROUND)
    with pytest.raises(StatementError, match="the initial state in the new coordinates needs a value of mu: give one"):
        lg.System(x.dot**2, initial={x: 1.0}).transform({x: mu * u})


def test_a_wrong_transformation_is_found_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transformation, "_forces", lambda change: {z: -1 + 0 * np.pi})
    with pytest.raises(RunError, match=r"the transformation of system is wrong: a formula gives .* is compiled, at "):
        particle().transform(ROUND)


# --- Other expressions for parameters ---


l = lg.parameters("l")
s = lg.coordinate("s")


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
    result = changed.compile("numpy").accelerations(q, v, parameters={"mu": 1.3})
    # The same formulas with two numbers in them; rounded differently.
    assert result == pytest.approx(wagon().compile("numpy").accelerations(q, v), rel=1e-13)
    assert changed.statement.initial == wagon().statement.initial


def test_two_parameters_change_places() -> None:
    swapped = wagon().substitute({m: k, k: m}).statement
    assert sympy.expand(swapped.kinetic - wagon().statement.kinetic.xreplace({m: k, k: m})) == 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": 1}, "'mass' is not a parameter of this system; its parameters are"),
        ({theta: 0}, "theta is a coordinate: eliminate() solves a constraint for it, transform() states the"),
        ({l: theta}, "the value of l is theta(t), which is not constant: state the system with it, so that its"),
        ({l: -1}, "the value of l is -1, but l was declared positive, and SymPy may have dropped an abs or a root"),
    ],
)
def test_values_that_are_refused(given: Any, message: str) -> None:
    assert refusal(wagon().substitute, given).startswith(message)
