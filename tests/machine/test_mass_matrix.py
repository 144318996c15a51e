"""The mass matrix as a user asks for it: with velocities where it depends on them, and never at v = 0 instead."""

from __future__ import annotations

import numpy as np
import pytest

import lagrange as lg

TARGETS = ["llvm", "numpy"]
x, y, z = lg.coordinates("x y z")
c = lg.parameters("c")

RELATIVISTIC = {"lagrangian": -c * (c**2 - x.dot**2 - y.dot**2) ** 0.5, "coordinates": [x, y], "parameters": {c: 3}}
QUARTIC = {"kinetic": x.dot**4 / 4 + (1 + z**2) * z.dot**2 / 2 + y.dot**2 / 2, "potential": x**2}


def relativistic(v: np.ndarray) -> np.ndarray:
    """d2L/dv2 of the free particle of unit mass: gamma (1 + gamma^2 v v^T / c^2)."""
    gamma = 1 / np.sqrt(1 - v @ v / 9)
    found: np.ndarray = gamma * (np.eye(2) + gamma**2 * np.outer(v, v) / 9)
    return found


@pytest.mark.parametrize("target", TARGETS)
def test_a_mass_matrix_that_depends_on_velocities_is_evaluated_at_them(target: str) -> None:
    model = lg.System(**RELATIVISTIC).compile(target)
    v = np.array([[1.2, 0.0, -2.0, 0.3], [0.4, 0.0, 1.5, 2.9]])
    for k in range(4):
        single = model.mass_matrix([0.1, 0.2], v=v[:, k])
        np.testing.assert_allclose(single, relativistic(v[:, k]), rtol=1e-13, atol=1e-15)
    batch = model.mass_matrix(np.zeros((2, 4)), 0.0, None, v)
    np.testing.assert_allclose(np.moveaxis(batch, -1, 0), [relativistic(one) for one in v.T], rtol=1e-13, atol=1e-15)
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


@pytest.mark.parametrize("target", TARGETS)
def test_where_it_does_not_depend_on_them_they_may_be_given_and_change_nothing(target: str) -> None:
    kinetic = (1 + x**2) * x.dot**2 / 2 + lg.t * x.dot * y.dot + y.dot**2
    model = lg.System(kinetic=kinetic, potential=0, coordinates=[x, y]).compile(target)
    q = np.array([[0.3, 1.0, 2.0], [0.1, 0.0, 1.0]])
    np.testing.assert_array_equal(model.mass_matrix(q, 0.5), model.mass_matrix(q, 0.5, v=1e3 * q))
    np.testing.assert_array_equal(model.mass_matrix(q[:, 0], 0.5), [[1.09, 0.5], [0.5, 2.0]])
