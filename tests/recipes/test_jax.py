"""The functions for JAX: transformations, shapes, singular matrices, precision, undefined values."""

from __future__ import annotations

import ctypes
import gc
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.machine.python_source import defined
from lagrange.recipes.model import NumbaFunction
from lagrange.statement.coordinate import coordinate
from tests.models import build, c, l, m, model, x, y
from tests.recipes.agreement import singular, states


@pytest.fixture
def jax() -> Any:
    """Return JAX with double precision, which no other file of tests loads."""
    package = pytest.importorskip("jax", reason="jax is not installed")
    package.config.update("jax_enable_x64", val=True)
    return package


@pytest.fixture
def numba() -> Any:
    return pytest.importorskip("numba", reason="numba is not installed")


def test_gradients_by_parameters_and_by_time_are_differences(jax: Any) -> None:
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


@pytest.mark.few(1)
@pytest.mark.parametrize("n", [2, 3, 5])
def test_units_do_not_make_a_matrix_singular(n: int, jax: Any) -> None:
    """Coupled masses of 1e-120 and 1e120 are solved by determinants, by exchanges and by LAPACK."""
    xs = [coordinate(f"x{i}") for i in range(n)]
    units = [10.0 ** (120 * (-1) ** i) for i in range(n)]
    kinetic = sum((u * q.dot for u, q in zip(units, xs, strict=True)), start=0) ** 2
    kinetic += sum((u * q.dot) ** 2 for u, q in zip(units, xs, strict=True))
    of = build("numpy", kinetic=kinetic, potential=xs[0], coordinates=xs)
    result, status = jax.jit(of.as_jax().checked)(0.0, np.zeros(2 * n), of.parameter_array())
    assert not status
    np.testing.assert_allclose(result, of.rhs(0.0, np.zeros(2 * n)), rtol=1e-13)


@pytest.mark.usefixtures("jax")
def test_other_shapes_are_refused() -> None:
    rhs = model("pendulum", "numpy").as_jax()
    with pytest.raises(ValueError, match=r"the shapes \(\), \(2, 5\), \(3,\): give \(\), \(2,\), \(3,\)"):
        rhs(0.0, np.zeros((2, 5)), np.ones(3))


def test_single_precision_is_refused_with_what_to_say(jax: Any) -> None:
    jax.config.update("jax_enable_x64", val=False)
    with pytest.raises(StatementError, match=r"single precision.*call jax\.config\.update\('jax_enable_x64', True\)"):
        model("pendulum", "numpy").as_jax()


@pytest.mark.usefixtures("jax")
def test_the_source_is_that_of_a_file() -> None:
    pendulum = model("pendulum", "numpy")
    rhs: Any = pendulum.as_jax()
    names = ", ".join(str(p) for p in pendulum.statement.parameters)
    assert f"y = [theta, theta_dot]\np = [{names}]\n" in rhs.source
    y, p = np.array([0.3, 0.1]), np.array([1.0, 9.81, 0.7])
    np.testing.assert_array_equal(defined(rhs.source, "rhs", {})(0.0, y, p), rhs(0.0, y, p))


# --- numba ----------------------------------------------------------------------------------------------------
# The functions for Numba's compiled functions: values, parameters, statuses, refusals, how long the code lives.


@cache
def double_pendulum() -> NumbaFunction:
    return model("double pendulum").as_numba()


@pytest.mark.slow
def test_compiled_loops_call_it_with_any_parameters(numba: Any) -> None:
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
        result = compiled(y, of.parameter_array(values), 20)
        for k in range(20):
            y = y + 1e-3 * of.rhs(k * 1e-3, y, values)
        np.testing.assert_allclose(result, y, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.usefixtures("numba")
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


@pytest.mark.slow
@pytest.mark.usefixtures("numba")
def test_a_singular_mass_matrix_is_nan_and_a_status() -> None:
    of = singular(2, "llvm")
    made = of.as_numba()
    prepared, y, out = made.prepare(of.parameter_array()), np.array([0.0, 0.0, 1.0, 1.0]), np.zeros(4)
    assert made.fill(0.0, y, prepared, out) is True
    assert np.isnan(made.function(0.0, y, prepared)).all()


@pytest.mark.slow
@pytest.mark.usefixtures("numba")
def test_a_singular_constant_matrix_is_nan() -> None:
    """The constant matrix of this system is solved once for the parameters."""
    of = build("llvm", kinetic=m * (x.dot**2 + y.dot**2) / 2 + c * x.dot * y.dot, potential=x, coordinates=[x, y])
    made, values = of.as_numba(), of.parameter_array({m: 1.0, c: 1.0})
    with pytest.raises(RunError, match="mass matrix"):
        of.rhs(0.0, np.ones(4), values)
    prepared, regular = made.prepare(values), made.prepare(of.parameter_array())
    assert made.fill(0.0, np.ones(4), prepared, np.zeros(4)) and not made.fill(0.0, np.ones(4), regular, np.zeros(4))
    assert np.isnan(made.function(0.0, np.ones(4), prepared)).all()


@pytest.mark.slow
@pytest.mark.usefixtures("numba")
def test_wrong_sizes_and_types_are_refused() -> None:
    of, made = model("double pendulum"), double_pendulum()
    prepared = made.prepare(of.parameter_array())
    with pytest.raises(ValueError, match="p has a wrong number of entries"):
        made.prepare(np.ones(1))
    with pytest.raises(ValueError, match="arrays of the sizes of the model"):
        made.function(0.0, np.ones(3), prepared)
    with pytest.raises(ValueError, match="arrays of the sizes of the model"):
        made.function(0.0, np.ones(4), of.parameter_array())
    with pytest.raises(TypeError):
        made.function(0.0, np.ones(4, dtype=int), prepared)


@pytest.mark.usefixtures("numba")
def test_the_numpy_target_is_refused() -> None:
    with pytest.raises(
        StatementError, match=r"has no address: take the machine code of the llvm target, system\.compile\('llvm'\)"
    ):
        model("double pendulum", "numpy").as_numba()


@pytest.mark.slow
@pytest.mark.usefixtures("numba")
def test_the_code_outlives_the_model() -> None:
    of = build("llvm", kinetic=x.dot**2 / 2, potential=x**2 / 2)
    made, p = of.as_numba(), of.parameter_array()
    del of
    gc.collect()
    assert made.function(0.0, np.array([1.0, 2.0]), made.prepare(p)).tolist() == [2.0, -1.0]


# --- c --------------------------------------------------------------------------------------------------------
# The address of a kernel, called from C: the code on the page compiles without warnings and runs.

PAGE = Path(__file__).resolve().parents[2] / "docs" / "other-solvers.md"
LAW = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


def test_the_integrator_on_the_page(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("cc is not installed")
    (text,) = re.findall(r"^```c\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "heun.c").write_text(text, encoding="utf-8")
    warnings = ["-Wall", "-Wextra", "-Werror"]
    # Without contraction into multiply-adds the digits are those of NumPy, on any processor.
    given = [*warnings, "-ffp-contract=off", "-shared", "-fPIC", "-o", "heun.so", "heun.c"]
    subprocess.run([compiler, *given], cwd=tmp_path, check=True)
    heun = ctypes.CDLL(str(tmp_path / "heun.so")).heun
    for of, status in ((model("double pendulum"), 0), (singular(2, "llvm"), 1)):
        kernel: Any = of.kernel("rhs")
        p, h = of.parameter_array(), 1e-3
        start = np.array([0.0, 0.0, 1.0, 1.0]) if status else np.array(of.statement.initial)
        y, work = start.copy(), np.empty(12)
        prepared = kernel.prepare(p)
        law = LAW(kernel.address)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (prepared, y, work)]
        sizes = [ctypes.c_double(h), ctypes.c_int64(50), ctypes.c_int64(4)]
        assert heun(law, pointers[0], *sizes, *pointers[1:]) == status
        if status:
            continue
        expected = start
        for k in range(50):
            first = of.rhs(k * h, expected)
            expected = expected + h / 2 * (first + of.rhs((k + 1) * h, expected + h * first))
        np.testing.assert_allclose(y, expected, rtol=1e-14)


# --- missing --------------------------------------------------------------------------------------------------
# A recipe without its package is refused with the package and the command that installs it.


@pytest.mark.parametrize("command", ["pip install jax", "pip install casadi", "pip install numba"])
def test_a_missing_package_is_named_with_its_command(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    package = command.split()[2]
    monkeypatch.setitem(sys.modules, package, None)
    expected = rf"model\.as_{package}\(\) needs {package}, which cannot be imported \(.*\): {command}$"
    with pytest.raises(StatementError, match=expected):
        getattr(model("pendulum", "llvm"), f"as_{package}")()


@pytest.mark.parametrize("method", ["as_jax", "as_casadi", "as_numba", "as_sympy"])
def test_an_unknown_quantity_is_refused_with_the_list(method: str) -> None:
    with pytest.raises(
        StatementError, match=r"'rsh' is not a quantity of a model: they are rhs, jacobian.*\. Did you mean 'rhs'\?"
    ):
        getattr(model("pendulum", "llvm"), method)("rsh")


def test_the_public_class_has_the_recipes() -> None:
    assert isinstance(lg.scene("pendulum").compile("numpy"), lg.Model)
    assert {name for name in dir(lg.Model) if name.startswith("as_")} == {
        *("as_casadi", "as_jax", "as_numba", "as_scipy", "as_sympy")
    }
