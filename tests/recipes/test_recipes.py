"""The functions for JAX, CasADi and scipy.integrate: values, shapes, refusals, pickles."""

import ctypes
import gc
import math
import pickle
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.machine.python_source import defined
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.recipes.model import Model, NumbaFunction
from lagrange.recipes.sympy import _Writer, number
from lagrange.statement.coordinate import coordinate, t
from tests.models import build, c, g, l, m, model, theta, x, y, z
from tests.models import model as shared
from tests.recipes.agreement import apart, named, singular, states
from tests.refusals import refusal


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
    """The constant matrix of the second system is solved once for the parameters."""
    of = singular(2, "llvm")
    made = of.as_numba()
    prepared, state, out = made.prepare(of.parameter_array()), np.array([0.0, 0.0, 1.0, 1.0]), np.zeros(4)
    assert made.fill(0.0, state, prepared, out) is True
    assert np.isnan(made.function(0.0, state, prepared)).all()
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
    assert re.search(expected, refusal(getattr(model("pendulum", "llvm"), f"as_{package}")))


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


# --- the functions for scipy.integrate: values, derivatives, events, initial states, refusals, pickles ---------


def pendulum() -> Model:
    return shared("pendulum", "llvm")


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "BDF", "LSODA"])
def test_every_solver_runs_as_ours_does(method: str) -> None:
    problem = pendulum().as_scipy({l: 0.9})
    result = solve_ivp(**problem.arguments((0.0, 2.0), {theta: 1.0}, method=method, rtol=1e-9, atol=1e-9))
    ours = lg.integrate(pendulum(), (0.0, 2.0), {theta: 1.0}, parameters={l: 0.9}, rtol=1e-13)
    # Each keeps the error of a step, not that of the run, below its tolerance; BDF loses most, 3e-7.
    np.testing.assert_allclose(result.y[:, -1], ours.y[:, -1], atol=2e-6)
    assert ("jac" in problem.arguments((0, 1), method=method)) is (method in ("Radau", "BDF", "LSODA"))
    assert result.success and bool(result.njev) == (method in ("Radau", "BDF"))  # LSODA sees that it is not stiff


def test_values_are_those_of_the_model_for_one_state_and_for_many() -> None:
    model, values = pendulum(), {m: 2.0, g: 9.0}
    problem = model.as_scipy(values)
    state, many = np.array([0.3, -0.2]), np.array([[0.3, 0.1], [-0.2, 0.5]])
    np.testing.assert_array_equal(problem.fun(0.1, state), model.rhs(0.1, state, values))
    np.testing.assert_array_equal(problem.fun(0.1, many), model.rhs(0.1, many, values))
    np.testing.assert_array_equal(problem.fun(0.1, [0.3, -0.2]), model.rhs(0.1, state, values))
    np.testing.assert_array_equal(problem.jac(0.1, state), model.jacobian(0.1, state, values))


def test_parameters_are_fixed() -> None:
    model = pendulum()
    values = model.parameter_array().copy()
    problem = model.as_scipy(values)
    values[:] = 7.0
    state = np.array([0.3, 0.0])
    np.testing.assert_array_equal(problem.fun(0.0, state), model.rhs(0.0, state))


def test_events_are_those_of_our_runs() -> None:
    lowest = lg.event(theta, direction=-1)
    model = pendulum()
    turning = lg.event(theta.ddot * l + theta.dot, terminal=2)
    problem = model.as_scipy(events=[lowest, turning])
    assert [event.direction for event in problem.events] == [-1.0, 0.0]
    assert [event.terminal for event in problem.events] == [0, 2]
    result = solve_ivp(**problem.arguments((0.0, 5.0), {theta: 1.0}, method="DOP853", rtol=1e-11, atol=1e-12))
    ours = lg.integrate(model, (0.0, 5.0), {theta: 1.0}, events=[lowest, turning], rtol=1e-13)
    assert result.status == 1 and result.t_events is not None and len(result.t_events[1]) == 2
    for first, second in zip(result.t_events, ours.t_events, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-8)


def test_a_reset_and_an_unknown_event_are_refused() -> None:
    with pytest.raises(StatementError, match=r"event 0 has a reset, which SciPy's solvers do not know: end there with"):
        pendulum().as_scipy(events=lg.event(theta, reset={theta.dot: -theta.dot}))
    assert "event 0 contains x" in refusal(pendulum().as_scipy, events=[x])


def test_the_initial_state_is_that_of_a_run() -> None:
    model = named("cartesian-pendulum")
    problem, n = model.as_scipy(), model.dimension
    alone: Any = 3
    np.testing.assert_array_equal(problem.y0(), model.statement.initial)
    off = {model.statement.coordinates[0]: 17.0}
    with pytest.raises(StatementError):
        problem.y0(off)
    assert problem.arguments((1, 2))["t_span"] == (1.0, 2.0) and len(problem.arguments((0, 1))["y0"]) == 2 * n
    assert "the time span is 3" in refusal(problem.arguments, alone)


def test_a_given_table_is_not_left() -> None:
    drive = lg.given("drive", ([0.0, 1.0, 2.0, 3.0], [0.0, 0.3, 0.1, 0.0]))
    model = build("numpy", kinetic=m * (x.dot + drive.dot) ** 2 / 2, potential=x**2, initial={x: 1.0})
    problem = model.as_scipy()
    assert solve_ivp(**problem.arguments((0.0, 3.0))).success
    assert "drive" in refusal(problem.arguments, (0.0, 4.0))


def test_a_state_of_first_order_follows_a_jump_of_its_input() -> None:
    """The input of the filter y' = u - y jumps from 0 to 1 at t = 0, while the velocity in the state is 0."""
    u, x = lg.given("u"), lg.coordinate("x")
    filtered = lg.System(x.dot**2 / 2, coordinates=[x, y], forces={x: y, y: u - y}, dissipation=y.dot**2 / 2)
    problem = filtered.compile().as_scipy(inputs={u: lambda time: 1.0, u.dot: lambda time: 0.0})
    result = solve_ivp(problem.fun, (0.0, 2.0), np.zeros(4), method="DOP853", rtol=1e-10, atol=1e-12)
    # The solver keeps the error of a step below 1e-10.
    assert result.y[1, -1] == pytest.approx(1 - math.exp(-2), abs=1e-8)
    assert result.y[0, -1] == pytest.approx(1 - math.exp(-2), abs=1e-8)  # x'' = y: t**2/2 - t + 1 - exp(-t) = y(2)


def test_a_singular_mass_matrix_is_a_sentence() -> None:
    model = singular(2)
    problem = model.as_scipy()
    with pytest.raises(RunError, match="mass matrix"):
        problem.fun(0.0, np.zeros(4))
    with pytest.raises(RunError):
        problem.jac(0.0, np.zeros(4))


def test_what_is_not_finite_stays_so() -> None:
    problem = build("llvm", kinetic=x.dot**2 / 2, potential=1 / x, initial={x: 1.0}).as_scipy()
    assert problem.fun(0.0, np.array([0.0, 1.0])).tolist() == [1.0, np.inf]


@pytest.mark.parametrize("target", ["numpy", "llvm"])
def test_a_problem_pickles(target: str) -> None:
    model = shared("pendulum", target)
    problem: Any = model.as_scipy({l: 0.9}, events=[theta])
    state = np.array([0.3, -0.2])
    problem.fun(0.0, state)
    again = pickle.loads(pickle.dumps(problem))
    np.testing.assert_array_equal(again.fun(0.1, state), problem.fun(0.1, state))
    assert pickle.loads(pickle.dumps(problem.events[0]))(0.0, state) == 0.3


# --- sympy ----------------------------------------------------------------------------------------------------
# The form in plain symbols: names, numbers, printers, matrices whose pivots are zero.


def test_symbols_are_plain_and_named_as_the_state() -> None:
    form = model("pendulum", "numpy").as_sympy()
    assert [symbol.name for symbol in form.arguments] == ["t", "theta", "theta_dot", "m", "g", "l"]
    for expression in (*form.results, *(item for _, item in form.replacements)):
        assert not expression.atoms(sp.Function("theta"), sp.Derivative) and not expression.has(t, theta)
    (g, l), (q,) = form.p[1:], form.q
    assert [sp.simplify(item) for item in form.expanded()] == [form.v[0], -g * sp.sin(q) / l]


def test_names_of_the_user_are_not_taken_again() -> None:
    first = sp.Symbol("x0", real=True)
    form = build("numpy", kinetic=x.dot**2 * sp.cos(x) ** 2, potential=first * sp.cos(x) ** 2).as_sympy()
    names = [symbol.name for symbol in (*form.arguments, *(symbol for symbol, _ in form.replacements))]
    assert len(dict.fromkeys(names)) == len(names) and "x0" in names and "x1" in names


@pytest.mark.parametrize("value", [0.1, -1e-320, 1e300, 1 / 3, 2.0, 0.25, -0.375, 2.0**60, math.pi])
def test_numbers_are_exact_and_short_where_they_can_be(value: float) -> None:
    assert float(number(value)) == value
    assert number(value).is_Rational or float(sp.ccode(number(value))) == float(str(number(value))) == value
    assert number(value).is_Rational == (value in (2.0, 0.25, -0.375))


def test_numbers_without_a_value() -> None:
    assert number(math.inf) is sp.oo and number(-math.inf) == -sp.oo and number(math.nan) is sp.nan


PRINTERS = [sp.ccode, sp.fcode, sp.pycode, sp.octave_code, sp.julia_code, sp.jscode, sp.rust_code, sp.cxxcode, sp.latex]


@pytest.mark.parametrize("printer", PRINTERS, ids=lambda printer: printer.__name__)
def test_every_printer_takes_every_expression(printer: object) -> None:
    assert callable(printer)
    for name in ("double-pendulum", "cartesian-pendulum"):
        form = named(name).as_sympy()
        for expression in (*form.results, *(item for _, item in form.replacements)):
            text = str(printer(expression))
            assert text and "Not supported" not in text and "Derivative" not in text


def test_rows_are_exchanged_where_a_pivot_is_known_to_be_zero() -> None:
    form = model("saddle", "numpy").as_sympy()
    assert all(item.is_finite is not False for item in form.expanded())
    speeds = x.dot * y.dot + 2 * y.dot * z.dot + 3 * z.dot * x.dot + 2 * y.dot**2 + 5 * z.dot**2
    of = build("numpy", lagrangian=speeds - x**2 - sp.cos(y) * z - z**2 * x, coordinates=[x, y, z])
    form = of.as_sympy()
    rhs = sp.lambdify(form.arguments, form.results, modules="math", cse=form.common)
    for time, state in states(of):
        assert apart(of, "rhs", time, state, rhs(time, *state)) <= 1


def test_a_matrix_without_pivots_is_refused() -> None:
    code = [Instruction("constant", value=0.0), Instruction("state"), Instruction("factor", (0, 0, 0), order=2)]
    code += [Instruction("solve", (2, 1, 1), order=2), Instruction("component", (3,))]
    block = (ProgramBlock("y", 1),)
    program = Program("f", block, 0, tuple(code), 0, (4,), (ProgramBlock("value", 1),), (1,))
    assert "the mass matrix is singular at every state" in refusal(_Writer(program, t, [m], [], iter([y])).results)


# --- the functions for CasADi: names, both kinds of symbols, singular matrices, undefined values ---------------


casadi: Any = pytest.importorskip("casadi", reason="casadi is not installed")


def test_names_and_sizes() -> None:
    of = named("double-pendulum")
    rhs = of.as_casadi()
    assert rhs.name_in() == ["t", "y", "p"] and rhs.name_out() == ["rhs"]
    assert [rhs.numel_in(k) for k in range(3)] == [1, 4, len(of.parameter_array())]
    assert of.as_casadi("energy").name_out() == ["energy"]


def test_no_parameters_and_unknown_symbols() -> None:
    of = named("henon-heiles")
    assert not of.parameter_array().size
    time, y = list(states(of))[1]
    np.testing.assert_allclose(of.as_casadi()(time, y, []).full().ravel(), of.rhs(time, y), rtol=1e-14)
    assert "'DM' is not a kind of CasADi's symbols: they are SX and MX" in refusal(of.as_casadi, symbols="DM")
