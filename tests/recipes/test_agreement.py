"""Every recipe gives the results of the model, for all scenes and random systems."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings

from lagrange.errors import RunError
from lagrange.recipes.model import Model
from lagrange.statement.coordinate import t
from tests.covering import examples
from tests.laws.mechanisms import potentials
from tests.laws.test_random_systems import kinetic_energies, states, x, y
from tests.models import build
from tests.recipes.agreement import EPS, OWN, SCENES, apart, named, sensitivity, singular, unbounded
from tests.recipes.agreement import states as states_of

Function = Callable[[float, Any, Any], Any]
CASADI, JAX, SYMPY = "casadi", "jax", "sympy"
few = settings(max_examples=examples(12), suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


@cache
def ready(package: str) -> None:
    """Skip a test whose package is not installed."""
    module = pytest.importorskip(package, reason=f"{package} is not installed")
    if package == JAX:
        module.config.update("jax_enable_x64", val=True)


def by(package: str, model: Model, quantity: str = "rhs") -> Function:
    """Return a quantity, computed by the recipe of a package."""
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
    result = by(package, model, quantity)
    for time, state in states_of(model, count):
        assert apart(model, quantity, time, state, result(time, state, model.parameter_array())) <= 1, (time, state)


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
@pytest.mark.parametrize("package", [CASADI, SYMPY])
def test_casadi_and_sympy_compute_what_the_model_does(package: str, name: str) -> None:
    check(package, named(name))


def every_system(*quick: str) -> list[Any]:
    """Return all systems as test parameters; a default run takes few, because JAX compiles each operation."""
    return [pytest.param(name, marks=[pytest.mark.slow] * (name not in quick)) for name in [*SCENES, *OWN]]


# Time and angles, a constraint, a matrix for LAPACK, conditions.
@pytest.mark.few(1)
@pytest.mark.parametrize("name", every_system("cart and pole", "cartesian-pendulum", "8 carried masses", "friction"))
def test_jax_computes_what_the_model_does(name: str) -> None:
    check(JAX, named(name), count=2)


QUANTITIES = ["jacobian", "mass_matrix", "energy", "momenta", "multipliers"]


@pytest.mark.few(1)
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_other_quantities_have_their_shapes(quantity: str) -> None:
    model = named("cartesian-pendulum")
    shape = model.interpreted(quantity).program.shape
    ready(JAX)
    result = model.as_jax(quantity)
    time, state = list(states_of(model))[1]
    p = model.parameter_array()
    assert result(time, state, p).shape == shape
    assert apart(model, quantity, time, state, result(time, state, p)) <= 1
    ready(CASADI)
    matrix = model.as_casadi(quantity)(time, state, p).full()
    assert matrix.shape == (*shape, 1, 1)[:2]
    assert apart(model, quantity, time, state, matrix) <= 1
    assert model.as_sympy(quantity).shape == shape
    check(SYMPY, model, quantity)


def derivative_apart(model: Model, time: float, state: Any, result: Any) -> float:
    """Return the difference of a derivative from the model's Jacobian, in units of the allowed rounding error.

    A derivative of the elimination has about ten times the operations of ours.
    """
    exact = model.jacobian(time, state)
    bound = 40 * EPS * np.abs(exact).max() + 40 * sensitivity(model, "jacobian", time, state)
    return float(np.abs(np.asarray(result, dtype=float) - exact).max() / bound)


@pytest.mark.few
@pytest.mark.parametrize("name", [*SCENES, *OWN])
def test_derivatives_by_casadi_are_the_jacobian(name: str) -> None:
    ready(CASADI)
    model = named(name)
    slope = model.as_casadi().jacobian()
    for time, state in list(states_of(model))[1:]:
        result = slope(time, state, model.parameter_array(), 0)[1].full()
        assert derivative_apart(model, time, state, result) <= 1


@pytest.mark.few(1)
@pytest.mark.parametrize("name", every_system("cart and pole", "8 carried masses"))
def test_derivatives_by_jax_are_the_jacobian(name: str) -> None:
    ready(JAX)
    import jax

    model = named(name)
    time, state = list(states_of(model))[1]
    result = jax.jit(jax.jacfwd(model.as_jax(), 1))(time, state, model.parameter_array())
    assert derivative_apart(model, time, state, result) <= 1


@few
@given(kinetic_energies(x, y, t), potentials(x, y, t), states)
def test_random_systems(kinetic: Any, potential: Any, state: Any) -> None:
    model = build("numpy", kinetic=kinetic, potential=potential, coordinates=[x, y])
    state = np.where(np.abs(state) < 1e-100, 0.0, state)  # JAX takes doubles below 2.2e-308 for zero
    for package in (SYMPY, CASADI, JAX):
        result = by(package, model)(0.3, state, model.parameter_array())
        assert apart(model, "rhs", 0.3, state, result) <= 1, package


def told(package: str, model: Model, *states: Any, **options: Any) -> list[tuple[Any, bool]]:
    """Return the accelerations at states, and True if the recipe reports a singular matrix."""
    ready(package)
    p = model.parameter_array()
    if package == CASADI:
        checked: Any = model.as_casadi(status=True, **options)
    else:
        import jax

        checked = jax.jit(model.as_jax().checked)
    actual = [checked(0.0, np.array(state), p) for state in states]
    return [(np.array(result).ravel(), bool(float(status))) for result, status in actual]


@pytest.mark.parametrize(
    ("package", "options"),
    [(CASADI, {"symbols": "SX"}), (CASADI, {"symbols": "MX"}), pytest.param(JAX, {}, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("n", [2, 6])
def test_a_singular_mass_matrix_is_nan_throughout_and_told(n: int, package: str, options: Any) -> None:
    """A singular mass matrix gives NaN in all entries, for an unrolled matrix and for one solved by LAPACK."""
    of = singular(n)
    regular, degenerate = np.ones(2 * n), np.array([0.0, 0.0, *[1.0] * (2 * n - 2)])
    with pytest.raises(RunError, match="mass matrix"):
        of.rhs(0.0, degenerate)
    (result, fine), (_, bad) = told(package, of, regular, degenerate, **options)
    assert (fine, bad) == (False, True)
    np.testing.assert_allclose(result, of.rhs(0.0, regular), rtol=1e-13)
    assert np.isnan(np.asarray(by(package, of)(0.0, degenerate, of.parameter_array()))).all()


@pytest.mark.parametrize("package", [CASADI, JAX])
@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_matrix_that_is_not_finite_is_not_singular(n: int, package: str) -> None:
    of = unbounded(n)
    starts = [np.array([first, *[1.0] * (2 * n - 1)]) for first in (0.0, -1.0, np.nan)]
    for state, (result, status) in zip(starts, told(package, of, *starts), strict=True):
        np.testing.assert_array_equal(result, of.interpreted("rhs")(0.0, state, of.parameter_array()))
        assert not status
