"""States of a flow at many times in one call: those of a run with the same output times."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.machine.series.driver import SeriesDriver
from tests.models import shared_scene

SETTINGS: dict[str, dict[str, Any]] = {"taylor": {}, "dop853": {}, "rk4": {"step": 1e-3}}


@pytest.mark.parametrize("method", SETTINGS)
@pytest.mark.parametrize("name", ["kepler", "cartesian-pendulum"])
@pytest.mark.parametrize("times", [[0.0, 0.1, 0.1, 0.7], [0.0, -0.3, -0.5], [0.4], (0.25, 0.5)])
def test_states_are_those_of_a_run(name: str, method: str, times: Any) -> None:
    model = shared_scene(name).compile(check=False)
    start = np.array(model.statement.initial)
    flow = lg.flow(model, method=method, **SETTINGS[method])
    found = flow(start, 0.0, times)
    run = lg.integrate(model, (0.0, times[-1]), method=method, t_eval=times, **SETTINGS[method])
    np.testing.assert_array_equal(found, run.y)
    # A call for one time follows with the same driver.
    assert flow(start, 0.0, times[-1]) == pytest.approx(found[:, -1], abs=1e-12)


def test_one_time_at_the_start_and_none_are_shapes_too() -> None:
    flow = lg.flow(shared_scene("kepler").compile(check=False))
    start = np.array([1.0, 0.0, 0.0, 1.0])
    assert flow(start, 2.0, [2.0, 2.0]).tolist() == np.array([start, start]).T.tolist()
    assert flow(start, 2.0, []).shape == (4, 0)


def test_times_on_the_way_take_no_steps_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    model = shared_scene("kepler").compile(check=False)
    flow, advance = lg.flow(model), SeriesDriver.advance
    calls: list[int] = []

    def counted(driver: Any, state: Any, budget: int, *rows: Any) -> Any:
        calls.append(budget)
        return advance(driver, state, budget, *rows)

    monkeypatch.setattr(SeriesDriver, "advance", counted)
    flow(np.array(model.statement.initial), 0.0, np.linspace(0.0, 1.0, 101))
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([0.3, 0.1], "outside the time span"),
        ([0.2, 0.1, 0.3], "not sorted in the direction of the run"),
        ([[0.1, 0.2]], "has shape"),
        ("abc", "the last time is 'abc'"),
        ([0.1, float("nan")], "nan"),
        ([0.1, "x"], "give real numbers"),
    ],
)
def test_wrong_times_are_refused(times: Any, words: str) -> None:
    flow = lg.flow(shared_scene("kepler").compile(check=False))
    with pytest.raises(StatementError, match=words):
        flow([1.0, 0.0, 0.0, 1.0], 0.0, times)
