"""What a model keeps from run to run: nothing of one run is seen in the next, and a second run prepares nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.machine.series.llvm_driver import LlvmTaylorDriver
from lagrange.machine.state import Outcome
from lagrange.statement.coordinate import t
from lagrange.statement.event import event
from lagrange.trajectory.methods.explicit import DOP853
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.plan import DRIVERS_KEPT, PLANS_KEPT, Prepared
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, build, k, m, model, x
from tests.trajectory.runs import FIXED, NAMES, planned, run, same

STARTS = ({"x": 0.1, "y_dot": 0.2}, {"x": -0.2, "y": 0.1, "x_dot": 0.3})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_that_of_a_model_that_has_kept_nothing(name: str, target: str) -> None:
    """Other states, spans and directions, with the options of the run before and with others."""
    compiled = model("Henon-Heiles", target)
    given: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7, "atol": 1e-9}
    spans = (0.0, 0.3), (0.5, 0.2), (0.0, 0.3), (-1.0, -0.9)
    requests = [(STARTS[i % 2], span, given) for i, span in enumerate(spans)]
    if target == "llvm":
        requests.insert(2, (STARTS[0], (0.0, 0.1), {}))
    found = [run(compiled, end, name, begin, start, **options) for start, (begin, end), options in requests]
    for one, (start, (begin, end), options) in zip(found, requests, strict=True):
        compiled.prepared.clear()
        assert same(one, run(compiled, end, name, begin, start, **options))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["taylor", "dop853", "rk4", "verlet", "radau5", "bdf2"])
def test_a_second_run_prepares_nothing(name: str, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = model("Henon-Heiles", target)
    options: dict[str, Any] = {"step": 0.02} if name in FIXED else {"rtol": 1e-7}
    first = run(compiled, 0.3, name, initial=STARTS[0], **options)
    monkeypatch.setattr(type(list(compiled.prepared.values())[-1].plan), "driver", None)
    monkeypatch.setattr(type(find(name)), "plan", None)
    assert same(run(compiled, 0.3, name, initial=STARTS[0], **options), first)


def test_one_call_of_the_driver_for_a_run_as_long_as_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = oscillator()
    unit = lg.Problem(compiled, compiled.parameter_values(), 0.0, 1.0, np.array([1.0, 0.0]))
    driver = type(planned("rk4", unit).driver(compiled, unit.parameter_array))
    advance, asked = driver.advance, []

    def counted(self: Any, state: Any, budget: int, *rest: Any) -> Outcome:
        asked.append(budget)
        outcome: Outcome = advance(self, state, budget, *rest)
        return outcome

    monkeypatch.setattr(driver, "advance", counted)
    for seconds, calls in ((1e9, 2), (1e9, 1), (0.0, 1), (0.0, 8)):
        monkeypatch.setattr("lagrange.trajectory.run_loop.SECONDS_PER_CALL", seconds)
        asked.clear()
        assert run(compiled, 5.0, "rk4", initial={x: 1.0}, step=0.01).steps == 500
        assert len(asked) == calls


def oscillator() -> Model:
    return build("llvm", kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2, parameters={m: 1, k: 1}, initial={x: 1.0})


@pytest.mark.parametrize("method", ["taylor", "dop853", "radau5"])
def test_solutions_stay_as_they_are(method: str) -> None:
    compiled = oscillator()
    first = lg.integrate(compiled, (0.0, 2.0), method=method)
    t, y, at = first.t.copy(), first.y.copy(), first.at([0.3, 1.7])
    lg.integrate(compiled, (0.0, 2.0), {x: 5.0}, method=method)
    assert (first.t == t).all() and (first.y == y).all() and (first.at([0.3, 1.7]) == at).all()


@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4", "radau5"])
def test_after_a_run_that_failed(method: str) -> None:
    """It leaves no driver, and a run with other values succeeds as before it."""
    compiled = build("llvm", kinetic=m * x.dot**2 / 2, potential=-2 * k * x**3, parameters={m: 1, k: 1})
    options: dict[str, Any] = {"step": 0.01} if method == "rk4" else {}
    good = run(compiled, 0.1, method, initial={x: 1.0}, **options)
    assert not run(compiled, 50.0, method, initial={x: 1.0, x.dot: 2.0}, **options).status.complete
    assert not list(compiled.prepared.values())[-1].idle
    assert same(run(compiled, 0.1, method, initial={x: 1.0}, **options), good)


@pytest.mark.parametrize("method", ["taylor", "dop853", "rk4"])
def test_runs_with_events_and_with_output_times_between(method: str) -> None:
    compiled = oscillator()
    wanted: list[dict[str, Any]] = [{}, {"events": [x]}, {}, {"t_eval": [0.5, 1.0, 2.0]}, {}]
    found = [run(compiled, 3.0, method, **options) for options in wanted]
    for one, options in zip(found, wanted, strict=True):
        compiled.prepared.clear()
        fresh = run(compiled, 3.0, method, **options)
        assert same(one, fresh) and all(map(np.array_equal, one.t_events, fresh.t_events))


@pytest.mark.parametrize("method", ["taylor", "dop853"])
def test_a_second_run_with_the_same_events_plans_nothing(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The resets of a plan have its parameters: with others there is another plan."""
    compiled = build(
        "llvm", kinetic=x.dot**2 / 2, potential=k * x**2 / 2, parameters={k: 2.0}, initial={x: 0.0, x.dot: -1.0}
    )
    wall = event(x, direction=-1, reset={x.dot: -k * x.dot / 4})
    given: list[dict[str, Any]] = [{}, {"parameters": {k: 3.0}}]
    first = [run(compiled, 9.0, method, events=[x - k / 10, wall], **options) for options in given]
    # The first reset is at the start, where the loop over steps leaves it to Python.
    assert [one.y_events[1][1][1] for one in first] == pytest.approx([-0.5, -0.75])
    monkeypatch.setattr(type(find(method)), "plan", None)
    for options, expected in zip(given, first, strict=True):
        again = run(compiled, 9.0, method, events=[x - k / 10, wall], **options)
        assert same(again, expected) and all(map(np.array_equal, again.t_events, expected.t_events))
    monkeypatch.undo()
    compiled.prepared.clear()
    for options, expected in zip(given, first, strict=True):
        assert same(run(compiled, 9.0, method, events=[x - k / 10, wall], **options), expected)


@pytest.mark.parametrize("options", [{"events": [x]}, {"t_eval": np.linspace(0.0, 300.0, 7)}])
def test_a_second_run_of_as_many_steps_is_one_call(options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """With events or output times too."""
    compiled, budgets = oscillator(), []
    advance = LlvmTaylorDriver.advance

    def counted(self: LlvmTaylorDriver, state: Any, budget: int, *arrays: Any) -> Outcome:
        budgets.append(budget)
        return advance(self, state, budget, *arrays)

    monkeypatch.setattr(LlvmTaylorDriver, "advance", counted)
    monkeypatch.setattr("lagrange.trajectory.run_loop.SECONDS_PER_CALL", np.inf)  # however busy the machine is
    first = run(compiled, 300.0, "taylor", **options)
    assert first.steps > budgets[0] and len(budgets) > 1
    budgets.clear()
    again = run(compiled, 300.0, "taylor", **options)
    assert np.array_equal(again.t, first.t) and np.array_equal(again.y, first.y)
    assert budgets == [first.steps + first.rejected + 2]


def test_few_plans_and_drivers_are_kept() -> None:
    compiled = oscillator()
    for i in range(3 * PLANS_KEPT):
        run(compiled, 0.1, "dop853", rtol=10.0 ** -(4 + i / 4))
    assert len(compiled.prepared) == PLANS_KEPT
    for i in range(3 * DRIVERS_KEPT):
        run(compiled, 0.1, "dop853", parameters={k: 1.0 + i})
    last: Prepared = list(compiled.prepared.values())[-1]
    assert len(last.idle) == DRIVERS_KEPT


def test_a_method_is_known_by_its_identity() -> None:
    """Two instances with one name and other settings are two methods, also where the first is no more."""
    compiled = oscillator()
    steps = [run(compiled, 5.0, DOP853(rtol=rtol)).steps for rtol in (1e-4, 1e-6, 1e-8, 1e-10)]
    assert steps == sorted(set(steps))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"atol": -0.0}, "atol = -0: give a finite tolerance that is not negative"),
        ({"rtol": np.nan}, "rtol = nan: give a finite tolerance"),
        ({"rtol": [1e-6, 1e-6]}, "rtol is .*: give one number"),
        ({"step": 0.1}, "dop853 chooses its steps by itself"),
    ],
)
def test_what_is_refused_is_refused_after_runs_too(options: dict[str, Any], message: str) -> None:
    compiled = oscillator()
    run(compiled, 0.1, "dop853")
    run(compiled, 0.1, "dop853", atol=0.0)
    with pytest.raises(StatementError, match=message):
        run(compiled, 0.1, "dop853", **options)


def test_what_depends_on_the_span_is_that_of_each_run() -> None:
    """A thousandth of the span where no step is given, and the bound of steps where a force may act briefly."""
    compiled = oscillator()
    assert [run(compiled, end, "rk4").step for end in (1.0, 3.0, 1.0)] == [0.001, 0.003, 0.001]
    pushed = build("llvm", kinetic=x.dot**2 / 2, forces={x: sp.exp(-((t - 5) ** 2))})
    for end in (10.0, 20.0, 10.0):
        found = run(pushed, end, "dop853")
        assert found.steps >= 1000 and np.diff(found.t).max() <= 1.000001 * end / 1000
    with pytest.raises(StatementError, match="below the spacing"):
        [lg.integrate(compiled, (0.0, end), method="rk4", step=1e-3) for end in (1.0, 1e13)]


def test_an_inertia_that_vanishes_at_a_later_start_is_refused() -> None:
    """The mass matrix depends on the state, so that each run looks at its start."""
    compiled = build("llvm", kinetic=x**2 * x.dot**2 / 2, potential=x**4)
    assert run(compiled, 0.1, "dop853", initial={x: 1.0}).status is Status.SUCCESS
    assert run(compiled, 0.1, "dop853", initial={x: 0.0}).status is Status.SINGULAR


def test_plans_of_the_methods_are_those_that_are_kept() -> None:
    compiled = oscillator()
    unit = lg.Problem(compiled, compiled.parameter_values(), 0.0, 1.0, np.array([1.0, 0.0]), rtol=1e-7)
    run(compiled, 1.0, "dop853", rtol=1e-7)
    assert list(compiled.prepared.values())[-1].plan.tolerances == planned("dop853", unit).tolerances
