"""Shapes of modes, compared with closed forms of linear systems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from tests.dynamics.planar import m, x
from tests.models import shared_scene

k, M, a = lg.parameters("k M a")
x1, x2, x3 = lg.coordinates("x1 x2 x3")


def molecule() -> lg.System:
    return lg.System(
        kinetic=m * (x1.dot**2 + x3.dot**2) / 2 + M * x2.dot**2 / 2,
        potential=k * (x2 - x1) ** 2 / 2 + k * (x3 - x2) ** 2 / 2,
        coordinates=[x1, x2, x3],
        parameters={k: 2.0, m: 16.0, M: 12.0, a: 1.0},
        positions={"left": (x1 - a, 0), "middle": (x2, 0), "right": (x3 + a, 0)},
        links=[("left", "middle", "spring"), ("middle", "right", "spring")],
        name="carbon dioxide",
    )


def test_the_modes_of_a_triatomic_molecule_are_drawn_where_its_atoms_are() -> None:
    """H. Goldstein et al., Classical Mechanics, 3rd ed., section 6.4: 0, sqrt(k/m) and sqrt(k/m (1 + 2 m/M))."""
    shapes = molecule().modes().shapes_in_numbers()
    assert shapes.frequencies == pytest.approx([0, np.sqrt(2 / 16), np.sqrt(2 / 16 * (1 + 32 / 12))])
    expected = np.array([[1, 1, 1], [1, 0, -1], [-0.375, 1, -0.375]])
    assert shapes.components == pytest.approx(expected, abs=1e-12)
    assert shapes.points["left"] == pytest.approx([-1.0, 0.0])
    for name, column in (("left", 0), ("middle", 1), ("right", 2)):
        assert shapes.displacements[name] == pytest.approx(
            np.column_stack([expected[:, column], np.zeros(3)]), abs=1e-12
        )


def test_displacements_are_the_derivatives_of_the_positions() -> None:
    """Displacements of a double pendulum with one arm upright are compared with differences."""
    system = shared_scene("double-pendulum")
    shapes = system.modes({"theta2": np.pi}).shapes_in_numbers()
    names = [q.name for q in system.statement.plain.values()]
    assert names[0] == "theta1"
    values = {p.name: v for p, v in system.parameters.items()}
    l1, l2 = values["l1"], values["l2"]

    def second(q1: float, q2: float) -> Any:
        return np.array([l1 * np.sin(q1) + l2 * np.sin(q2), -l1 * np.cos(q1) - l2 * np.cos(q2)])

    last = list(system.statement.positions)[-1]
    assert shapes.points[last] == pytest.approx(second(0.0, np.pi))
    for row, (b1, b2) in zip(shapes.displacements[last], shapes.components, strict=True):
        h = 1e-6
        assert row == pytest.approx(
            (second(h * b1, np.pi + h * b2) - second(-h * b1, np.pi - h * b2)) / (2 * h), abs=1e-8
        )


def test_shapes_want_values_of_the_parameters() -> None:
    open_ended = lg.System(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1.0})
    with pytest.raises(StatementError, match="shapes are drawn at values of the parameters, and k has none"):
        open_ended.modes().plot()
