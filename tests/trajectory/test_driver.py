"""The loop over steps: its counts, grids and directions, flows, and the right status for each end of a run."""

import math
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partialmethod
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import RunError
from lagrange.machine.numpy_machine import NumpySeries
from lagrange.machine.state import Outcome
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.run import flow as flow_of
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, k, m, model, shared_scene, x, y
from tests.refusals import refusal
from tests.trajectory.runs import FIXED, NAMES, planned, run


def settings(name: str) -> dict[str, Any]:
    return {"step": 0.013} if name in FIXED else {"rtol": 1e-8, "atol": 1e-10}


class Counting:
    """A kernel that counts its calls."""

    def __init__(self, kernel: Any) -> None:
        self.kernel, self.program, self.calls = kernel, getattr(kernel, "program", None), 0

    def __call__(self, *args: Any) -> Any:
        self.calls += 1
        return self.kernel(*args)

    def quick(self, parameters: Any) -> None:
        """Return None, so that every call is counted."""


@pytest.mark.few(2)
@pytest.mark.parametrize("name", NAMES)
def test_the_count_is_honest(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations of the right-hand side are counted; for taylor whole series, and one right-hand side at the start."""
    series = Counting(NumpySeries.rows)
    monkeypatch.setattr(NumpySeries, "rows", partialmethod(series))
    compiled = build("numpy", kinetic=m * x.dot**2 / 2, potential=k * x**4, initial={x: 1.0})
    laws: dict[str, Any] = {law: Counting(compiled.law(law)) for law in ("rhs", "momentum", "constrained", "local")}
    compiled._kernels |= {law: laws[law] for law in ("rhs", "momentum")}
    known = compiled._law
    monkeypatch.setattr(compiled, "_law", lambda name: laws.get(name) or known(name))
    result = run(compiled, 1.0, name, **settings(name))
    assert result.evaluations == sum(law.calls for law in laws.values()) + series.calls
    assert (series.calls > 0) == (name == "taylor")


# --- time -----------------------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_backward_is_forward_in_a_mirror(name: str, target: str) -> None:
    """Henon-Heiles is symmetric in time: the run backwards from (q, v) equals the run forwards from (q, -v)."""
    compiled = model("Henon-Heiles", target)
    back = run(compiled, -1.0, name, **settings(name))
    mirrored = {"x_dot": -0.3, "y_dot": 0.1}
    forth = run(compiled, 1.0, name, initial=mirrored, **settings(name))
    assert back.t == pytest.approx(-forth.t, abs=1e-13)
    assert back.y[:2] == pytest.approx(forth.y[:2], abs=1e-12)
    assert back.y[2:] == pytest.approx(-forth.y[2:], abs=1e-12)
    assert back.span == (0.0, -1.0) and back.t[-1] == -1.0


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("direction", [1, -1])
def test_fixed_steps_are_a_grid_that_ends_at_the_end(target: str, direction: int) -> None:
    compiled = model("oscillator", target)
    result = run(compiled, direction * 1.0, "rk4", step=0.3)
    assert result.t * direction == pytest.approx([0, 0.3, 0.6, 0.9, 1.0], abs=1e-15)
    assert result.t[-1] == direction * 1.0
    tenths = run(compiled, direction * 1.0, "rk4", step=0.1)
    assert tenths.steps == 10 and list(tenths.t) == [direction * i * 0.1 for i in range(10)] + [direction * 1.0]
    many = run(compiled, direction * 0.3, "euler", step=1e-4)
    assert many.steps == 3_000 and np.abs(np.diff(many.t) * direction - 1e-4).max() < 1e-15


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_run_of_no_length(name: str, target: str) -> None:
    result = run(model("oscillator", target), 2.0, name, start=2.0)
    assert result.status is Status.SUCCESS and list(result.t) == [2.0] and result.steps == 0
    assert result.y[:, 0] == pytest.approx([1.0, 0.0])
    assert result.dense(np.array([2.0, 2.0])) == pytest.approx(np.array([[1.0, 1.0], [0.0, 0.0]]))


# --- flow -----------------------------------------------------------------------------------------------------
# The flow: what a run gives at its end, at the price of a call, for threads, maps and shooting; errors in words.

START = np.array([0.1, 0.2, 0.3, -0.1])


def named(state: Any) -> dict[str, float]:
    return dict(zip(("x", "y", "x_dot", "y_dot"), map(float, state), strict=True))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_flow_ends_where_a_run_ends_whatever_it_did_before(name: str, target: str) -> None:
    """A call does not reuse the last slope of the call before it, not even after a failure."""
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7, "atol": 1e-9}
    flow = flow_of(compiled, method=name, **options)
    other = START[::-1].copy()
    spans = ((START, 0.0, 1.0), (other, 0.5, -0.7), (START, 3.0, 3.01), (START, 2.0, 2.0), (START, 0.0, 1.0))
    for state, t0, t1 in spans:
        expected = run(compiled, t1, name, start=t0, initial=named(state), **options)
        assert (flow(state, t0, t1) == expected.y[:, -1]).all()
    with pytest.raises(RunError):
        flow(np.full(4, 1e200), 0.0, 0.5)
    assert (flow(START, 0.0, 1.0) == expected.y[:, -1]).all()


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
        assert re.search(words, refusal(flow, [1.0, 0.0], 0.0, 1.0, wrong))


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2", "scipy-rk45", "scipy-lsoda"])
def test_threads_share_a_flow_from_its_first_call_with_parameters_of_their_own(method: str) -> None:
    """Results equal those of calls one after the other; threads have other states, parameters and directions."""
    flow, alone = (flow_of(model("oscillator"), method=method) for _ in range(2))
    values = dict.fromkeys(model("oscillator").statement.parameters, 1.0)
    length = 2.0 if method.startswith("scipy") else 50.0
    calls = [(np.array([1.0 + i / 7, 0.3]), length * (-1) ** i, {**values, k: 1.0 + i % 3}) for i in range(32)]
    expected = [alone(y0, 0.0, end, parameters) for y0, end, parameters in calls]
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads change within a call, not once in several
    try:
        with ThreadPoolExecutor(8) as pool:
            result = list(pool.map(lambda call: flow(call[0], 0.0, call[1], call[2]), calls))
    finally:
        sys.setswitchinterval(before)
    assert [state.tobytes() for state in result] == [state.tobytes() for state in expected]


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_not_a_state_or_a_time_is_refused(target: str) -> None:
    flow = flow_of(model("Henon-Heiles", target))
    assert "y0 has shape (3,): give [q, v] of shape (4,)" in refusal(flow, [0, 0, 0], 0.0, 1.0)
    assert "y0 has shape (4, 2)" in refusal(flow, np.zeros((4, 2)), 0.0, 1.0)
    assert "y0 has entries of type complex128: give real numbers" in refusal(flow, START * 1j, 0.0, 1.0)
    times: list[tuple[Any, str]] = [(math.nan, "is nan: give a finite number"), (math.inf, "is inf")]
    for bad, message in [*times, (1j, "complex number"), ("1", "give a number")]:
        assert re.search(f"the last time .*{message}", refusal(flow, START, 0.0, bad))
        assert re.search(f"the first time .*{message}", refusal(flow, START, bad, 1.0))
    assert "'z' is not a parameter" in refusal(flow, START, 0.0, 1.0, parameters={"z": 1})


@pytest.mark.few(1)
@pytest.mark.parametrize("target", TARGETS)
def test_what_goes_wrong_is_raised_with_the_sentence_of_a_run(target: str) -> None:
    flow = flow_of(model("Henon-Heiles", target))
    with pytest.raises(RunError, match=r"taylor stopped at t = 0 on the way from 0 to 1: x is nan"):
        flow([math.nan, 0, 0, 0], 0.0, 1.0)
    pole = build(target, kinetic=x.dot**2 / 2, potential=-2 * x**3)
    for name in ("dopri5", "taylor"):
        with pytest.raises(RunError, match=rf"{name} stopped at t = .* on the way from 0 to 5"):
            flow_of(pole, method=name)([1.0, 2.0], 0.0, 5.0)
    spherical = flow_of(model("spherical pendulum", target))
    with pytest.raises(RunError, match="the mass matrix is singular at t = 0, theta = 0, phi = 0"):
        spherical([0.0, 0.0, 0.1, 0.2], 0.0, 1.0)
    with pytest.raises(RunError, match="has no inertia with m = 0, so"):
        flow_of(model("coupled masses", target))(START, 0.0, 1.0, parameters={"m": 0.0})


TURN = lg.rotation("R")


@pytest.mark.parametrize(
    ("kinetic", "zeros", "words"),
    [
        (m * x.dot**2 / 2 + k * y.dot**2, (m,), "x has no inertia with m = 0, so"),
        (TURN.body.dot(sp.diag(m, m, k) * TURN.body), (k,), "R has no inertia about the axis z of its body with k = 0"),
        (
            TURN.body.dot(sp.diag(m, m, k) * TURN.body),
            (m, k),
            "a motion with R_body_x = 1, R_body_y = 1, R_body_z = 1 has no inertia with m = 0 and k = 0",
        ),
    ],
)
def test_a_parameter_of_zero_that_takes_an_inertia_away_is_named(kinetic: Any, zeros: Any, words: str) -> None:
    run = lg.System(kinetic, parameters={m: 1, k: 1}).run(1.0, parameters=dict.fromkeys(zeros, 0))
    assert run.status is lg.Status.SINGULAR and words in run.message and len(run.message) <= 400


@pytest.mark.parametrize(("method", "end"), [("rk4", 2e6), ("taylor", 1e9), ("dop853", -1e9)])
def test_an_end_beyond_all_steps_is_refused_at_the_pace_of_the_first(method: str, end: float) -> None:
    flow = flow_of(model("Henon-Heiles"), method=method, step=0.1 if method == "rk4" else None)
    with pytest.raises(RunError, match=r"in 1024 steps\. At this pace the end, .* more than max_steps = 10000000: end"):
        flow(START, 0.0, end)


# --- ends -----------------------------------------------------------------------------------------------------
# Every way a run can end is told as it is, and keeps what was computed until then.

SLOW = "thousands of interpreted Newton steps, the same as on llvm"


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_max_steps(name: str, target: str) -> None:
    if target == "numpy" and name.startswith("radau"):
        pytest.skip(SLOW)
    compiled = model("Henon-Heiles", target)
    options = {"step": 0.02} if name in FIXED else {}
    whole = run(compiled, 8.0, name, **options)
    for limit in (1, 3, 70):
        result = run(compiled, 8.0, name, max_steps=limit, **options)
        if whole.steps + whole.rejected <= limit:
            continue
        assert result.status is Status.MAX_STEPS
        assert result.steps + result.rejected == limit and len(result.t) == result.steps + 1
        assert result.message.startswith(f"{name} used up max_steps = {limit} at t = ")
        assert (result.y == whole.y[:, : result.steps + 1]).all()
    enough = run(compiled, 8.0, name, max_steps=whole.steps + whole.rejected, **options)
    assert enough.status is Status.SUCCESS


@pytest.mark.parametrize("target", TARGETS)
def test_ctrl_c_on_the_way_back_from_a_burst_loses_none_of_it(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = model("Henon-Heiles", target)
    plain = run(compiled, 40.0, "rk4", step=0.1)
    compiled.prepared.clear()  # else the next run takes as many steps at once as this one took
    unit = Problem(compiled, compiled.parameter_values(), 0.0, 1.0, np.array(compiled.statement.initial))
    driver = type(planned("rk4", unit).driver(compiled, compiled.parameter_array()))
    advance, calls = driver.advance, []

    def pressed(self: Any, *arguments: Any) -> Outcome:
        outcome: Outcome = advance(self, *arguments)
        calls.append(outcome)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return outcome

    monkeypatch.setattr(driver, "advance", pressed)
    # However slow the machine is, the second burst is twice as long as the first.
    monkeypatch.setattr("lagrange.trajectory.run_loop.SECONDS_PER_CALL", np.inf)
    monkeypatch.setattr("lagrange.trajectory.run_loop.MOST_GROWTH", 2)
    result = run(compiled, 40.0, "rk4", step=0.1)
    assert result.status is Status.INTERRUPTED and result.steps == len(result.t) - 1 == 64 + 128
    assert (result.y == plain.y[:, :193]).all() and (result.t == plain.t[:193]).all()


# --- times of a flow ------------------------------------------------------------------------------------------
# States of a flow at many times in one call: those of a run with the same output times.

SETTINGS: dict[str, dict[str, Any]] = {"taylor": {}, "dop853": {}, "rk4": {"step": 1e-3}}


@pytest.mark.parametrize("method", SETTINGS)
@pytest.mark.parametrize("name", ["kepler", "cartesian-pendulum"])
@pytest.mark.parametrize("times", [[0.0, 0.1, 0.1, 0.7], [0.0, -0.3, -0.5], [0.4], (0.25, 0.5)])
def test_states_are_those_of_a_run(name: str, method: str, times: Any) -> None:
    model = shared_scene(name).compile(check=False)
    start = np.array(model.statement.initial)
    flow = lg.flow(model, method=method, **SETTINGS[method])
    result = flow(start, 0.0, times)
    run = lg.integrate(model, (0.0, times[-1]), method=method, t_eval=times, **SETTINGS[method])
    np.testing.assert_array_equal(result, run.y)
    # A call for one time follows with the same driver.
    assert flow(start, 0.0, times[-1]) == pytest.approx(result[:, -1], abs=1e-12)
