"""The functions for scipy.integrate: values, derivatives, events, initial states, refusals, pickles."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import lagrange as lg
from lagrange.errors import RunError, StatementError
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.recipes.model import Model
from lagrange.recipes.sympy import _Writer, number
from lagrange.statement.coordinate import t
from tests.models import build, g, l, m, model, theta, x, y, z
from tests.models import model as shared
from tests.recipes.agreement import apart, named, singular, states


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
    with pytest.raises(StatementError, match="event 0 contains x"):
        pendulum().as_scipy(events=[x])


def test_the_initial_state_is_that_of_a_run() -> None:
    model = named("cartesian-pendulum")
    problem, n = model.as_scipy(), model.dimension
    alone: Any = 3
    np.testing.assert_array_equal(problem.y0(), model.statement.initial)
    off = {model.statement.coordinates[0]: 17.0}
    with pytest.raises(StatementError):
        problem.y0(off)
    assert problem.arguments((1, 2))["t_span"] == (1.0, 2.0) and len(problem.arguments((0, 1))["y0"]) == 2 * n
    with pytest.raises(StatementError, match="the time span is 3"):
        problem.arguments(alone)


def test_a_given_table_is_not_left() -> None:
    drive = lg.given("drive", ([0.0, 1.0, 2.0, 3.0], [0.0, 0.3, 0.1, 0.0]))
    model = build("numpy", kinetic=m * (x.dot + drive.dot) ** 2 / 2, potential=x**2, initial={x: 1.0})
    problem = model.as_scipy()
    assert solve_ivp(**problem.arguments((0.0, 3.0))).success
    with pytest.raises(StatementError, match="drive"):
        problem.arguments((0.0, 4.0))


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
    with pytest.raises(StatementError, match="the mass matrix is singular at every state"):
        _Writer(program, t, [m], [], iter([y])).results()
