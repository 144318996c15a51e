"""The functions for Numba's compiled functions: values, parameters, statuses, refusals, how long the code lives."""

from __future__ import annotations

import gc
from functools import cache
from typing import Any

import numpy as np
import pytest

from lagrange.errors import RunError, StatementError
from lagrange.recipes.libraries import NumbaFunction
from tests.models import build, c, l, m, model, x, y
from tests.recipes.agreement import singular, states

numba: Any = pytest.importorskip("numba", reason="numba is not installed")


@cache
def double_pendulum() -> NumbaFunction:
    return model("double pendulum").as_numba()


def test_compiled_loops_call_it_with_any_parameters() -> None:
    of, made = model("double pendulum"), double_pendulum()
    prepare, rhs = made.prepare, made.function

    def walk(y: Any, p: Any, steps: int) -> Any:
        prepared, h = prepare(p), 1e-3
        for k in range(steps):
            y = y + h * rhs(k * h, y, prepared)
        return y

    compiled = numba.njit(walk)
    for values in (None, {m: 2.0, l: 0.9}):
        y = np.array(of.statement.initial)
        found = compiled(y, of.parameter_array(values), 20)
        for k in range(20):
            y = y + 1e-3 * of.rhs(k * 1e-3, y, values)
        np.testing.assert_allclose(found, y, rtol=1e-13)


def test_the_digits_are_those_of_the_model_and_shapes_too() -> None:
    of = model("cart and pole")
    p = of.parameter_array()
    for quantity in ("rhs", "jacobian"):
        made, out = of.as_numba(quantity), np.empty(of.kernel(quantity).program.shape)
        prepared = made.prepare(p)
        for time, state in states(of):
            exact = of.kernel(quantity)(time, state, p)
            np.testing.assert_array_equal(made.function(time, state, prepared), exact)
            assert not made.fill(time, state, prepared, out)
            np.testing.assert_array_equal(out, exact)


def test_a_singular_mass_matrix_is_nan_and_a_status() -> None:
    of = singular(2, "llvm")
    made = of.as_numba()
    prepared, y, out = made.prepare(of.parameter_array()), np.array([0.0, 0.0, 1.0, 1.0]), np.zeros(4)
    assert made.fill(0.0, y, prepared, out) is True
    assert np.isnan(made.function(0.0, y, prepared)).all()


def test_a_singular_constant_matrix_is_nan() -> None:
    """Check a system that is solved once for the parameters."""
    of = build("llvm", kinetic=m * (x.dot**2 + y.dot**2) / 2 + c * x.dot * y.dot, potential=x, coordinates=[x, y])
    made, values = of.as_numba(), of.parameter_array({m: 1.0, c: 1.0})
    with pytest.raises(RunError, match="mass matrix"):
        of.rhs(0.0, np.ones(4), values)
    prepared, regular = made.prepare(values), made.prepare(of.parameter_array())
    assert made.fill(0.0, np.ones(4), prepared, np.zeros(4)) and not made.fill(0.0, np.ones(4), regular, np.zeros(4))
    assert np.isnan(made.function(0.0, np.ones(4), prepared)).all()


def test_wrong_sizes_and_types_are_refused() -> None:
    of, made = model("double pendulum"), double_pendulum()
    prepared = made.prepare(of.parameter_array())
    with pytest.raises(ValueError, match="another number of entries than the model"):
        made.prepare(np.ones(1))
    with pytest.raises(ValueError, match="another size than the model"):
        made.function(0.0, np.ones(3), prepared)
    with pytest.raises(ValueError, match="another size than the model"):
        made.function(0.0, np.ones(4), of.parameter_array())
    with pytest.raises(TypeError):
        made.function(0.0, np.ones(4, dtype=int), prepared)


def test_the_numpy_target_is_refused() -> None:
    with pytest.raises(
        StatementError, match=r"has no address: take that of the llvm target, system\.compile\('llvm'\)"
    ):
        model("double pendulum", "numpy").as_numba()


def test_the_code_outlives_the_model() -> None:
    of = build("llvm", kinetic=x.dot**2 / 2, potential=x**2 / 2)
    made, p = of.as_numba(), of.parameter_array()
    del of
    gc.collect()
    assert made.function(0.0, np.array([1.0, 2.0]), made.prepare(p)).tolist() == [2.0, -1.0]
