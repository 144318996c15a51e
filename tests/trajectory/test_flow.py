"""The flow: what a run gives at its end, at the price of a call, for threads, maps and shooting; errors in words."""

from __future__ import annotations

import math
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.errors import RunError, StatementError
from lagrange.trajectory.methods.explicit import RK4
from lagrange.trajectory.methods.taylor import Taylor
from lagrange.trajectory.run import flow as flow_of
from tests.models import TARGETS, build, k, m, model, x
from tests.trajectory.runs import ADAPTIVE, FIXED, IMPLICIT, NAMES, run

START = np.array([0.1, 0.2, 0.3, -0.1])


def named(state: Any) -> dict[str, float]:
    return dict(zip(("x", "y", "x_dot", "y_dot"), map(float, state), strict=True))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_flow_ends_where_a_run_ends(name: str, target: str) -> None:
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7, "atol": 1e-9}
    flow = flow_of(compiled, method=name, **options)
    other = START[::-1].copy()
    for state, t0, t1 in ((START, 0.0, 1.0), (other, 0.5, -0.7), (START, 3.0, 3.01), (START, 0.0, 1.0)):
        expected = run(compiled, t1, name, start=t0, initial=named(state), **options)
        assert (flow(state, t0, t1) == expected.y[:, -1]).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_no_call_knows_of_the_one_before(name: str, target: str) -> None:
    """The last slope of one call is not the first of the next, not even after a failure."""
    options: dict[str, Any] = {"step": 0.02} if name in FIXED else {}
    flow = flow_of(model("Henon-Heiles", target), method=name, **options)
    first = flow(START, 0.0, 0.5)
    flow(np.array([-0.2, 0.1, 0.0, 0.4]), 0.0, 0.5)
    assert (flow(START, 0.0, 0.5) == first).all()
    with pytest.raises(RunError):
        flow(np.full(4, 1e200), 0.0, 0.5)
    assert (flow(START, 0.0, 0.5) == first).all()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", FIXED)
def test_without_a_step_a_thousandth_of_each_call(name: str, target: str) -> None:
    if target == "numpy" and name in IMPLICIT:
        pytest.skip("thousands of interpreted Newton steps, the same as on llvm")
    compiled = model("Henon-Heiles", target)
    flow = flow_of(compiled, method=name)
    for end in (0.25, -0.5):
        assert (flow(START, 0.0, end) == run(compiled, end, name, initial=named(START)).y[:, -1]).all()


@pytest.mark.parametrize("target", TARGETS)
def test_parameters_of_each_call(target: str) -> None:
    compiled = build(target, kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2)
    flow = flow_of(compiled, rtol=1e-12, atol=1e-14)
    values: dict[Any, float] = {"m": 1.0}
    for stiffness in (1.0, 4.0, 1.0):
        values["k"] = stiffness  # the caller's own dict, changed between calls
        found = flow([1.0, 0.0], 0.0, 1.0, parameters=values)
        assert found == pytest.approx(
            [math.cos(math.sqrt(stiffness)), -math.sqrt(stiffness) * math.sin(math.sqrt(stiffness))]
        )
    default = compiled.parameter_values()
    omega = math.sqrt(default[k] / default[m])
    assert flow([1.0, 0.0], 0.0, 1.0)[0] == pytest.approx(math.cos(omega))


@pytest.mark.parametrize("method", ["dop853", "scipy-dop853"])
def test_parameters_as_an_array_with_any_method(method: str) -> None:
    compiled = build("llvm", kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2)
    flow = flow_of(compiled, method=method)
    values = np.array([{m: 1.0, k: 4.0}[symbol] for symbol in compiled.statement.parameters])
    for stiffness in (4.0, 9.0):
        values[compiled.statement.parameters.index(k)] = stiffness  # the caller's own array, changed between calls
        expected = flow([1.0, 0.0], 0.0, 1.0, {m: 1.0, k: stiffness})
        assert (flow([1.0, 0.0], 0.0, 1.0, values) == expected).all()
        assert expected[0] == pytest.approx(math.cos(math.sqrt(stiffness)), abs=1e-7)
    for wrong, words in ((np.ones(3), "parameters has shape"), (np.array([1.0, np.nan]), "is nan: give a finite")):
        with pytest.raises(StatementError, match=words):
            flow([1.0, 0.0], 0.0, 1.0, wrong)


@pytest.mark.parametrize("target", TARGETS)
def test_there_and_back_and_in_pieces(target: str) -> None:
    flow = flow_of(model("double pendulum", target), rtol=1e-13, atol=1e-14)
    start = np.array([0.5, 0.6, 0.1, -0.2])
    end = flow(start, 0.0, 1.0)
    assert flow(end, 1.0, 0.0) == pytest.approx(start, abs=1e-10)
    assert flow(flow(start, 0.0, 0.4), 0.4, 1.0) == pytest.approx(end, abs=1e-10)
    assert (flow(start, 2.0, 2.0) == start).all() and flow(start, 2.0, 2.0) is not start


def test_the_result_is_the_callers_own() -> None:
    flow = flow_of(model("Henon-Heiles"))
    state = START.copy()
    first = flow(state, 0.0, 1.0)
    kept = first.copy()
    flow(first, 1.0, 2.0)
    assert (first == kept).all() and (state == START).all()
    assert (flow(START.tolist(), 0, 1) == kept).all()
    assert (flow(START.astype(object).astype(float)[::1], np.float64(0), float(np.int64(1))) == kept).all()


@pytest.mark.parametrize("target", TARGETS)
def test_threads_share_a_flow(target: str) -> None:
    flow = flow_of(model("Henon-Heiles", target))
    states = [START * (1 + 0.05 * i) for i in range(12)]
    expected = [flow(state, 0.0, 2.0) for state in states]
    with ThreadPoolExecutor(6) as pool:
        for _ in range(3):
            found = list(pool.map(lambda state: flow(state, 0.0, 2.0), states))
            assert all((a == b).all() for a, b in zip(found, expected, strict=True))


@pytest.mark.few
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2", "scipy-rk45", "scipy-lsoda"])
def test_threads_share_a_flow_from_its_first_call_with_parameters_of_their_own(method: str) -> None:
    """The bits of calls in a row, whatever runs beside them: other states, other parameters, either direction."""
    flow, alone = (flow_of(model("oscillator"), method=method) for _ in range(2))
    values = dict.fromkeys(model("oscillator").statement.parameters, 1.0)
    length = 2.0 if method.startswith("scipy") else 50.0
    calls = [(np.array([1.0 + i / 7, 0.3]), length * (-1) ** i, {**values, k: 1.0 + i % 3}) for i in range(32)]
    expected = [alone(y0, 0.0, end, parameters) for y0, end, parameters in calls]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads change within a call, not once in several
    try:
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda call: flow(call[0], 0.0, call[1], call[2]), calls))
    finally:
        sys.setswitchinterval(before)
    assert [state.tobytes() for state in found] == [state.tobytes() for state in expected]


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_not_a_state_or_a_time_is_refused(target: str) -> None:
    flow = flow_of(model("Henon-Heiles", target))
    with pytest.raises(StatementError, match=r"y0 has shape \(3,\): give \[q, v\] of shape \(4,\)"):
        flow([0, 0, 0], 0.0, 1.0)
    with pytest.raises(StatementError, match=r"y0 has shape \(4, 2\)"):
        flow(np.zeros((4, 2)), 0.0, 1.0)
    with pytest.raises(StatementError, match="y0 has entries of type complex128: give real numbers"):
        flow(START * 1j, 0.0, 1.0)
    times: list[tuple[Any, str]] = [(math.nan, "is nan: give a finite number"), (math.inf, "is inf")]
    for bad, message in [*times, (1j, "complex number"), ("1", "give a number")]:
        with pytest.raises(StatementError, match=f"the last time .*{message}"):
            flow(START, 0.0, bad)
        with pytest.raises(StatementError, match=f"the first time .*{message}"):
            flow(START, bad, 1.0)
    with pytest.raises(StatementError, match="'z' is not a parameter"):
        flow(START, 0.0, 1.0, parameters={"z": 1})


@pytest.mark.parametrize("target", TARGETS)
def test_what_goes_wrong_is_raised_with_the_sentence_of_a_run(target: str) -> None:
    flow = flow_of(model("Henon-Heiles", target))
    with pytest.raises(RunError, match=r"taylor stopped at t = 0 on the way from 0 to 1: x is nan"):
        flow([math.nan, 0, 0, 0], 0.0, 1.0)
    pole = build(target, kinetic=x.dot**2 / 2, potential=-2 * x**3)
    for name in ADAPTIVE:
        if target == "numpy" and name not in ("dopri5", "taylor"):
            continue  # thousands of interpreted steps up to the pole, the same as on llvm
        with pytest.raises(RunError, match=rf"{name} stopped at t = .* on the way from 0 to 5"):
            flow_of(pole, method=name)([1.0, 2.0], 0.0, 5.0)
    spherical = flow_of(model("spherical pendulum", target))
    with pytest.raises(RunError, match="the mass matrix is singular at t = 0, theta = 0, phi = 0"):
        spherical([0.0, 0.0, 0.1, 0.2], 0.0, 1.0)
    with pytest.raises(RunError, match="the mass matrix is singular"):
        flow_of(model("coupled masses", target))(START, 0.0, 1.0, parameters={"m": 0.0})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["rk4", "dop853", "taylor"])
def test_a_limit_of_steps_is_kept(name: str, target: str) -> None:
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 0.01} if name in FIXED else {}
    with pytest.raises(RunError, match=f"{name} used up max_steps = 10 at t = "):
        flow_of(compiled, method=name, max_steps=10, **options)(START, 0.0, 20.0)
    whole = run(compiled, 2.0, name, initial=named(START), **options)
    needed = whole.steps + whole.rejected
    assert (flow_of(compiled, method=name, max_steps=needed, **options)(START, 0.0, 2.0) == whole.y[:, -1]).all()
    limits: list[Any] = [0, -3, 1.5]
    for limit in limits:
        with pytest.raises(StatementError, match=f"max_steps = {limit}: give a whole number of at least 1"):
            flow_of(compiled, method=name, max_steps=limit, **options)


def test_a_flow_without_an_end_comes_back() -> None:
    """A right-hand side that no step can pass: the verdict comes from a run, and no loop goes on for ever."""
    wall = build(kinetic=m * x.dot**2 / 2, forces={x: sp.Piecewise((k, x < 1))})
    with pytest.raises(RunError, match="x_dot is nan"):
        flow_of(wall)([0.0, 1.0], 0.0, 5.0)


@pytest.mark.parametrize(("method", "end"), [("rk4", 2e6), ("taylor", 1e9), ("dop853", -1e9)])
def test_an_end_beyond_all_steps_is_refused_at_the_pace_of_the_first(method: str, end: float) -> None:
    flow = flow_of(model("Henon-Heiles"), method=method, step=0.1 if method == "rk4" else None)
    with pytest.raises(RunError, match=r"in 1024 steps\. At this pace the end, .* more than max_steps = 10000000: end"):
        flow(START, 0.0, end)


def test_settings_without_a_use_are_refused() -> None:
    compiled = model("Henon-Heiles")
    with pytest.raises(StatementError, match="rk4 takes equal steps and cannot aim at a tolerance"):
        flow_of(compiled, method="rk4", rtol=1e-3)
    with pytest.raises(StatementError, match="dop853 chooses its steps by itself"):
        flow_of(compiled, method="dop853", step=0.1)
    with pytest.raises(StatementError, match="verlet moves coordinates and velocities in turn"):
        flow_of(model("double pendulum"), method="verlet")
    with pytest.raises(StatementError, match="there is no method 'dop83'"):
        flow_of(compiled, method="dop83")
    text: Any = "pendulum"
    with pytest.raises(StatementError, match="is not a compiled model"):
        flow_of(text)


def test_instances_bring_their_own_settings() -> None:
    compiled = model("Henon-Heiles")
    assert (
        flow_of(compiled, method=RK4(step=0.05))(START, 0.0, 1.0)
        == flow_of(compiled, method="rk4", step=0.05)(START, 0.0, 1.0)
    ).all()
    assert (
        flow_of(compiled, method=Taylor(rtol=1e-4))(START, 0.0, 9.0) == flow_of(compiled, rtol=1e-4)(START, 0.0, 9.0)
    ).all()


@pytest.mark.parametrize("method", ["scipy-rk45", "scipy-radau"])
def test_integrators_without_a_step_program_flow_too(method: str) -> None:
    flow = flow_of(model("Henon-Heiles"), method=method, rtol=1e-8, atol=1e-10)
    assert flow(START, 0.0, 1.0) == pytest.approx(flow_of(model("Henon-Heiles"))(START, 0.0, 1.0), abs=1e-6)
