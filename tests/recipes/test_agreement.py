"""Every recipe computes what the model computes: all scenes, and systems drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings

from lagrange.recipes.model import Model
from lagrange.statement.coordinate import t
from tests.covering import examples
from tests.laws.mechanisms import potentials
from tests.laws.test_random_systems import kinetic_energies, states, x, y
from tests.models import build
from tests.recipes.agreement import EPS, OWN, SCENES, apart, named, sensitivity
from tests.recipes.agreement import states as states_of

Function = Callable[[float, Any, Any], Any]
CASADI, JAX, NUMBA, SYMPY = "casadi", "jax", "numba", "sympy"
few = settings(max_examples=examples(12), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


@cache
def ready(package: str) -> None:
    """Skip a test whose package is not installed."""
    module = pytest.importorskip(package, reason=f"{package} is not installed")
    if package == JAX:
        module.config.update("jax_enable_x64", val=True)


def by(package: str, model: Model, quantity: str = "rhs") -> Function:
    """Return a quantity as the recipe of a package computes it."""
    ready(package)
    if package == JAX:
        import jax

        compiled: Function = jax.jit(model.as_jax(quantity))
        return compiled
    if package == CASADI:
        made = model.as_casadi(quantity)
        return lambda time, state, p: made(time, state, p).full()
    form = model.as_sympy(quantity)
    plain = sp.lambdify(form.arguments, form.results, modules="math", cse=form.common)
    return lambda time, state, p: plain(time, *state, *p)


def check(package: str, model: Model, quantity: str = "rhs", count: int = 3) -> None:
    found = by(package, model, quantity)
    for time, state in states_of(model, count):
        assert apart(model, quantity, time, state, found(time, state, model.parameter_array())) <= 1, (time, state)


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
def test_casadi_computes_what_the_model_does(name: str) -> None:
    check(CASADI, named(name))


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
def test_sympy_computes_what_the_model_does(name: str) -> None:
    check(SYMPY, named(name))


def every_system(*quick: str) -> list[Any]:
    """Return all systems as parameters: JAX compiles each operation, and a default run takes few."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in quick)) for name in [*SCENES, *OWN]]


# Time and angles, a constraint, a matrix for LAPACK, conditions.
@pytest.mark.few(2)
@pytest.mark.parametrize("name", every_system("cart and pole", "cartesian-pendulum", "8 carried masses", "friction"))
def test_jax_computes_what_the_model_does(name: str) -> None:
    check(JAX, named(name), count=2)


QUANTITIES = ["jacobian", "mass_matrix", "energy", "momenta", "multipliers"]


@pytest.mark.few(2)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_other_quantities_have_their_shapes(quantity: str) -> None:
    model = named("cartesian-pendulum")
    shape = model.interpreted(quantity).program.shape
    ready(JAX)
    found = model.as_jax(quantity)
    time, state = list(states_of(model))[1]
    p = model.parameter_array()
    assert found(time, state, p).shape == shape
    assert apart(model, quantity, time, state, found(time, state, p)) <= 1
    ready(CASADI)
    matrix = model.as_casadi(quantity)(time, state, p).full()
    assert matrix.shape == (*shape, 1, 1)[:2]
    assert apart(model, quantity, time, state, matrix) <= 1
    assert model.as_sympy(quantity).shape == shape
    check(SYMPY, model, quantity)


def derivative_apart(model: Model, time: float, state: Any, found: Any) -> float:
    """Return how far a derivative is from the Jacobian of the model, where 1 is what rounding may do.

    A derivative by another rule, of an elimination instead of a solution, has some ten times the operations.
    """
    exact = model.jacobian(time, state)
    bound = 40 * EPS * np.abs(exact).max() + 40 * sensitivity(model, "jacobian", time, state)
    return float(np.abs(np.asarray(found, dtype=float) - exact).max() / bound)


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
def test_derivatives_by_casadi_are_the_jacobian(name: str) -> None:
    ready(CASADI)
    model = named(name)
    slope = model.as_casadi().jacobian()
    for time, state in list(states_of(model))[1:]:
        found = slope(time, state, model.parameter_array(), 0)[1].full()
        assert derivative_apart(model, time, state, found) <= 1


@pytest.mark.few(1)
@pytest.mark.parametrize("name", every_system("cart and pole", "8 carried masses"))
def test_derivatives_by_jax_are_the_jacobian(name: str) -> None:
    ready(JAX)
    import jax

    model = named(name)
    time, state = list(states_of(model))[1]
    found = jax.jit(jax.jacfwd(model.as_jax(), 1))(time, state, model.parameter_array())
    assert derivative_apart(model, time, state, found) <= 1


@few
@given(kinetic_energies(x, y, t), potentials(x, y, t), states)
def test_random_systems(kinetic: Any, potential: Any, state: Any) -> None:
    model = build("numpy", kinetic=kinetic, potential=potential, coordinates=[x, y])
    state = np.where(np.abs(state) < 1e-100, 0.0, state)  # JAX takes doubles below 2.2e-308 for zero
    for package in (SYMPY, CASADI, JAX):
        found = by(package, model)(0.3, state, model.parameter_array())
        assert apart(model, "rhs", 0.3, state, found) <= 1, package
