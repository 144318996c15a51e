"""The functions for JAX: transformations, shapes, singular matrices, precision, what has no value."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.errors import RunError, StatementError
from lagrange.machine.python_source import defined
from lagrange.statement.coordinate import coordinate
from tests.models import build, model, x
from tests.recipes.agreement import named, singular, states, unbounded

jax: Any = pytest.importorskip("jax", reason="jax is not installed")


@pytest.fixture(autouse=True)
def _double_precision() -> None:
    jax.config.update("jax_enable_x64", val=True)


def test_a_batch_is_the_states_one_by_one() -> None:
    of = named("double-pendulum")
    rhs, p = of.as_jax(), of.parameter_array()
    many = np.array([y for _, y in states(of, 5)])
    found = jax.jit(jax.vmap(rhs, (None, 0, None)))(0.0, many, p)
    np.testing.assert_allclose(found, [of.rhs(0.0, y) for y in many], rtol=1e-13, atol=1e-13)


def test_gradients_by_parameters_and_by_time_are_differences() -> None:
    of = model("cart and pole", "numpy")
    rhs, (time, y) = of.as_jax(), list(states(of))[1]
    p, h = of.parameter_array(), 1e-6
    slopes = jax.jit(jax.jacfwd(rhs, (0, 2)))(time, y, p)
    by_time = (of.rhs(time + h, y) - of.rhs(time - h, y)) / (2 * h)
    np.testing.assert_allclose(slopes[0], by_time, rtol=1e-7, atol=1e-7)
    for k in range(len(p)):
        step = h * np.eye(len(p))[k]
        difference = (of.rhs(time, y, p + step) - of.rhs(time, y, p - step)) / (2 * h)
        np.testing.assert_allclose(slopes[1][:, k], difference, rtol=1e-6, atol=1e-7)


def test_the_gradient_of_the_energy_by_reverse_sweep() -> None:
    of = model("8 carried masses", "numpy")
    rhs, energy, (time, y) = of.as_jax(), of.as_jax("energy"), list(states(of))[1]
    p = of.parameter_array()
    slope = jax.jit(jax.grad(energy, 1))(time, y, p)
    along = jax.jit(jax.grad(lambda y: (slope * rhs(time, y, p)).sum()))(y)
    np.testing.assert_allclose(along, slope @ of.jacobian(time, y), rtol=1e-10, atol=1e-10)
    assert abs(slope @ of.rhs(time, y)) < 1e-11 * abs(slope).max() * abs(of.rhs(time, y)).max()


@pytest.mark.parametrize("n", [2, 6])
def test_a_singular_mass_matrix_is_nan_throughout_and_told(n: int) -> None:
    """Check a matrix that is written out, and one for LAPACK."""
    of = singular(n)
    rhs, p = of.as_jax(), of.parameter_array()
    regular, degenerate = np.ones(2 * n), np.array([0.0, 0.0, *[1.0] * (2 * n - 2)])
    with pytest.raises(RunError, match="mass matrix"):
        of.rhs(0.0, degenerate)
    both = jax.jit(jax.vmap(lambda y: (rhs(0.0, y, p), *rhs.checked(0.0, y, p))))
    found, unchecked, status = map(np.asarray, both(np.array([regular, degenerate])))
    assert status.tolist() == [False, True] and np.isnan(found[1]).all()
    for result in (found[0], unchecked[0]):
        np.testing.assert_allclose(result, of.rhs(0.0, regular), rtol=1e-13)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_matrix_that_is_not_finite_is_not_singular(n: int) -> None:
    of = unbounded(n)
    p = of.parameter_array()
    checked = jax.jit(of.as_jax().checked)
    for first in (0.0, -1.0, np.nan):
        state = np.array([first, *[1.0] * (2 * n - 1)])
        result, status = checked(0.0, state, p)
        np.testing.assert_array_equal(result, of.interpreted("rhs")(0.0, state, p))
        assert not status


@pytest.mark.parametrize("n", [2, 3, 5])
def test_units_do_not_make_a_matrix_singular(n: int) -> None:
    """Check masses of 1e-120 and 1e120 that are coupled, by determinants, by exchanges and by LAPACK."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    units = [10.0 ** (120 * (-1) ** i) for i in range(n)]
    kinetic = sum((u * q.dot for u, q in zip(units, xs, strict=True)), start=0) ** 2
    kinetic += sum((u * q.dot) ** 2 for u, q in zip(units, xs, strict=True))
    of = build("numpy", kinetic=kinetic, potential=xs[0], coordinates=xs)
    found, status = jax.jit(of.as_jax().checked)(0.0, np.zeros(2 * n), of.parameter_array())
    assert not status
    np.testing.assert_allclose(found, of.rhs(0.0, np.zeros(2 * n)), rtol=1e-13)


def test_what_has_no_value_is_nan_or_infinite_as_in_the_model() -> None:
    of = build("numpy", kinetic=x.dot**2 / 2, potential=1 / x + x ** (5 / 2), initial={x: 1.0})
    rhs, p = of.as_jax(), of.parameter_array()
    for y in ([0.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [np.inf, 1.0], [1.0, -np.inf]):
        state = np.array(y)
        np.testing.assert_array_equal(rhs(0.0, state, p), of.kernel("rhs")(0.0, state, p))


def test_other_shapes_are_refused() -> None:
    rhs = model("pendulum", "numpy").as_jax()
    with pytest.raises(ValueError, match=r"the shapes \(\), \(2, 5\), \(3,\): give \(\), \(2,\), \(3,\)"):
        rhs(0.0, np.zeros((2, 5)), np.ones(3))


def test_single_precision_is_refused_with_what_to_say() -> None:
    jax.config.update("jax_enable_x64", val=False)
    with pytest.raises(StatementError, match=r"single precision.*say jax\.config\.update\('jax_enable_x64', True\)"):
        model("pendulum", "numpy").as_jax()


def test_the_source_is_that_of_a_file() -> None:
    pendulum = model("pendulum", "numpy")
    rhs: Any = pendulum.as_jax()
    names = ", ".join(str(p) for p in pendulum.statement.parameters)
    assert f"y = [theta, theta_dot]\np = [{names}]\n" in rhs.source
    y, p = np.array([0.3, 0.1]), np.array([1.0, 9.81, 0.7])
    np.testing.assert_array_equal(defined(rhs.source, "rhs", {})(0.0, y, p), rhs(0.0, y, p))
