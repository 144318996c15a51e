"""What comes back from a run: shapes, the start, the parameters' values, and limits on what is kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.trajectory.integrate import integrate
from lagrange.trajectory.methods.registry import DEFAULT
from lagrange.trajectory.trajectory import Status
from tests.models import TARGETS, VALUES, build, k, m, model, x, y
from tests.trajectory.runs import NAMES, run


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", NAMES)
def test_a_trajectory_has_its_start_its_end_and_its_shapes(name: str, target: str) -> None:
    compiled = model("Henon-Heiles", target)
    found = run(compiled, 1.0, name, initial={x: 0.25, y.dot: 0.5})
    assert found.t[0] == 0.0 and found.t[-1] == 1.0 and found.span == (0.0, 1.0)
    assert list(found.y[:, 0]) == [0.25, 0.2, 0.3, 0.5]  # what is not named keeps the statement's value
    assert found.y.shape == (4, found.steps + 1) and found.t.shape == (found.steps + 1,)
    assert found.y.dtype == found.t.dtype == np.float64
    assert found.method == name and found.status is Status.SUCCESS and found.wall > 0
    assert found.message.startswith(f"{name} reached t = 1.")
    assert isinstance(found.steps, int) and isinstance(found.evaluations, int)


def test_the_values_of_all_parameters_come_back() -> None:
    compiled = build(kinetic=m * x.dot**2 / 2, potential=k * x**2 / 2)
    _, values = integrate(compiled, (0, 1), {"x": 1}, parameters={"k": 5})
    assert {symbol.name: value for symbol, value in values.items()} == {"m": VALUES[m], "k": 5.0}


def test_the_default_method_is_the_one_that_is_documented() -> None:
    found, _ = integrate(model("oscillator"), (0.0, 1.0))
    assert found.method == DEFAULT == "taylor"


@pytest.mark.parametrize("span", [(0, 1), [0.0, 1.0], np.array([0.0, 1.0]), (np.float64(0), np.int64(1))])
def test_a_span_is_any_two_numbers(span: Any) -> None:
    found, _ = integrate(model("oscillator"), span)
    assert found.span == (0.0, 1.0)


def test_the_start_may_be_keyed_by_symbol_or_name() -> None:
    starts: list[Any] = [{x: 0.5, x.dot: 2}, {"x": 0.5, "x_dot": 2}, {"x": np.float64(0.5), x.dot: 2.0}]
    for start in starts:
        assert list(run(model("oscillator"), 0.1, "rk4", initial=start).y[:, 0]) == [0.5, 2.0]


def test_output_times_may_be_whole_numbers_and_repeat() -> None:
    found = run(model("oscillator"), 4.0, "dop853", t_eval=[0, 1, 1, 4])
    assert list(found.t) == [0, 1, 1, 4] and (found.y[:, 1] == found.y[:, 2]).all()


def test_a_run_does_not_touch_what_it_was_given() -> None:
    times = np.linspace(0, 1, 5)
    start, values = {"x": 0.5}, {"k": 2.0}
    run(model("oscillator"), 1.0, "dop853", initial=start, parameters=values, t_eval=times)
    assert start == {"x": 0.5} and values == {"k": 2.0} and (times == np.linspace(0, 1, 5)).all()


def test_runs_do_not_share_their_arrays() -> None:
    first, second = (run(model("oscillator"), 1.0, "rk4", step=0.1) for _ in range(2))
    kept = second.y.copy()
    first.y[:] = 0.0
    first.t[:] = 0.0
    assert (second.y == kept).all() and second.t[-1] == 1.0
