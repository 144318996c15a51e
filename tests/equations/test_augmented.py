"""Systems whose inertia comes from constraints: what is solved is definite, and means the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp
from sympy import sin

from lagrange.compiler import machine, model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from tests.models import g, m, stated, x, y
from tests.series_systems import HELD, quaternion


def test_only_a_singular_mass_matrix_is_augmented() -> None:
    for name, make in HELD.items():
        laws = euler_lagrange(make())
        assert (laws.motion.momenta == laws.momenta) == (name != "quaternion")


def test_the_mass_matrix_of_a_quaternion_is_definite_as_it_is_solved() -> None:
    model = model_of(quaternion(), machine("numpy"))
    laws, n = model.equations, model.dimension
    rng = np.random.default_rng(1)
    nodes = tuple(laws.matrix[i][j] for i in range(n) for j in range(n))
    for _ in range(10):
        state = np.concatenate([rng.normal(size=n), np.zeros(n)])
        solved = model.function("matrix", nodes)(0.0, state, model.parameter_array()).reshape(n, n)
        stated_so = model.mass_matrix(state[:n])
        values = np.linalg.eigvalsh(solved)
        assert values[0] > 1e-2 * values[-1]
        assert abs(np.linalg.eigvalsh(stated_so)[0]) < 1e-13 * values[-1]


@pytest.mark.parametrize("target", ["llvm", "numpy"])
def test_a_coordinate_without_inertia_follows_from_its_constraint(target: str) -> None:
    """A bead on y = sin(x) whose inertia is stated along x alone, m x'^2 / 2, and its weight along y."""
    model = model_of(
        stated(
            kinetic=m * x.dot**2 / 2,
            potential=m * g * y,
            coordinates=[x, y],
            constraints={"wire": y - sin(x)},
            initial={x: 0.5, y: sp.sin(sp.Rational(1, 2)).evalf(17), x.dot: 1.0},
        ),
        machine(target),
    )
    weight = dict(zip(map(str, model.statement.parameters), model.parameter_array(), strict=True))
    q, v = np.array([0.7, np.sin(0.7)]), np.array([1.5, 1.5 * np.cos(0.7)])
    a: Any = model.accelerations(q, v)
    # m x'' = lambda dphi/dx and 0 = -m g + lambda: the bead is driven by m g cos(x), and y'' follows.
    assert a[0] == pytest.approx(-weight["g"] * np.cos(0.7), rel=1e-13)
    assert a[1] == pytest.approx(np.cos(0.7) * a[0] - np.sin(0.7) * 1.5**2, rel=1e-13)
    assert model.multipliers(q, v)[0] == pytest.approx(weight["m"] * weight["g"], rel=1e-13)
