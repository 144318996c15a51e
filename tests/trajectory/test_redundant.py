"""Redundant constraints with redundant='allow': right accelerations, forces of least norm, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import SceneError, StatementError
from tests.models import TARGETS, g, l, m, phi, x, y

ROD = x**2 + y**2 - l**2


def pendulum(constraints: Any, **options: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2,
        potential=m * g * y,
        constraints=constraints,
        parameters={m: 1.3, g: 9.81, l: 1.0},
        initial={x: 0.6, y: -0.8},
        **options,
    )


ALONE = pendulum({"rod": ROD})
TWICE = pendulum({"rod": ROD, "twice": 2 * ROD, "rate": x * x.dot + y * y.dot}, redundant="allow")


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_the_motion_is_that_of_independent_constraints(method: str, target: str) -> None:
    result, expected = (system.run(3.0, method=method, target=target) for system in (TWICE, ALONE))
    assert result.status is lg.Status.SUCCESS
    assert result.y[:, -1] == pytest.approx(expected.y[:, -1], abs=1e-8)


@pytest.mark.parametrize("target", TARGETS)
def test_the_multipliers_have_the_least_norm(target: str) -> None:
    """The constraints are 2, 4 and 1 times the same row, and so are their shares of the force."""
    model, q, v = TWICE.compile(target), [0.6, -0.8], [0.3, 0.225]
    tension = ALONE.compile(target).multipliers(q, v)[0]
    assert model.multipliers(q, v) == pytest.approx(2 * tension * np.array([2.0, 4.0, 1.0]) / 21, rel=1e-12)
    forces = model.kernel("constraint_forces")(0.0, np.array([*q, *v]), model.parameter_array())
    assert forces.shape == (3, 2) and forces.sum(axis=0) == pytest.approx(2 * tension * np.array(q), rel=1e-12)
    solution = TWICE.run(0.1)
    assert solution.multipliers["twice"] == pytest.approx(2 * solution.multipliers["rod"], rel=1e-12)


def test_constraints_that_follow_only_where_all_hold() -> None:
    """A table on three parallel cranks, of which two suffice. The six constraints are dependent only where all hold."""
    a1, a2, a3 = cranks = lg.coordinates("a1 a2 a3")
    held: dict[str, Any] = {}
    for i, (a, d, e) in enumerate(zip(cranks, (-1.0, 0.5, 0.0), (0.0, 0.0, 1.0), strict=True)):
        held[f"x{i}"] = x + d * cos(phi) - e * sin(phi) - d - cos(a)
        held[f"y{i}"] = y + d * sin(phi) + e * cos(phi) - e - sin(a)
    table: dict[str, Any] = {
        "kinetic": (x.dot**2 + y.dot**2 + phi.dot**2 + a1.dot**2 + a2.dot**2 + a3.dot**2) / 2,
        "potential": 9.81 * y,
        "coordinates": [x, y, phi, *cranks],
        "constraints": held,
        "initial": {x: float(cos(0.7)), y: float(sin(0.7)), **dict.fromkeys(cranks, 0.7)},
    }
    with pytest.raises(StatementError, match=r"are dependent here: .* or state the system with redundant='allow'"):
        lg.System(**table).run(0.5, check=False)
    free = lg.System(**table, redundant="allow")
    start = free.consistent({a1.dot: 3.0, a2.dot: 3.0, a3.dot: 3.0}).initial
    turn = lg.coordinate("turn")
    swing = lg.System(kinetic=2 * turn.dot**2, potential=9.81 * sin(turn))
    result, expected = free.run(0.5, start), swing.run(0.5, {turn: 0.7, turn.dot: start[a1.dot]})
    assert result.y[:6, -1] == pytest.approx(
        [np.cos(expected.y[0, -1]), np.sin(expected.y[0, -1]), 0.0, *[expected.y[0, -1]] * 3], abs=1e-8
    )


def test_more_constraints_than_coordinates_may_follow_from_one_another() -> None:
    with pytest.raises(StatementError, match="3 constraints"):
        pendulum([ROD, 2 * ROD, 3 * ROD])
    assert pendulum([ROD, 2 * ROD, 3 * ROD], redundant="allow").run(0.1).status is lg.Status.SUCCESS


def test_all_of_them_must_hold_at_the_start() -> None:
    with pytest.raises(StatementError, match=r"'twice' .* is -0\.22"):
        TWICE.run(1.0, {x: 0.5})
    with pytest.raises(StatementError, match="no state was found that satisfies the constraints 'a' and 'b' together"):
        pendulum({"a": x - 1, "b": x - 2}, redundant="allow")


def test_a_scene_may_allow_them(tmp_path: Path) -> None:
    path = tmp_path / "twice.toml"
    scene = 'coordinates = ["x", "y"]\nkinetic = "(x_dot**2 + y_dot**2)/2"\npotential = "y"\nredundant = {}\n'
    lines = '[constraints]\nrod = "x**2 + y**2 - 1"\ntwice = "2*x**2 + 2*y**2 - 2"\n[initial]\nx = 1.0\n'
    path.write_text(scene.format('"allow"') + lines)
    assert len(lg.System.from_scene(path).laws.constraints) == 1
    path.write_text(scene.format('"yes"') + lines)
    with pytest.raises(SceneError, match="redundant is 'yes': give one of refuse and allow"):
        lg.System.from_scene(path)
