"""States at times that a user chooses, and files with lines at a stated rate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from tests.show.examples import oscillator


def rows(path: Path) -> Any:
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


@pytest.mark.parametrize("times", [[0.0, 5.0], [1.0, -0.5]])
def test_a_file_has_lines_at_a_stated_rate_from_dense_output(times: list[float], tmp_path: Path) -> None:
    solution = oscillator(times)
    found = rows(solution.to_csv(tmp_path / "run.csv", rate=10))
    forward = np.sign(times[1] - times[0])
    np.testing.assert_allclose(found[:, 0], times[0] + forward * np.arange(abs(times[1] - times[0]) * 10 + 1) / 10)
    np.testing.assert_allclose(found[:, 1], np.cos(2 * found[:, 0]), atol=1e-14)
    assert found[-1, 0] == times[1]


def test_a_file_has_lines_at_stated_times(tmp_path: Path) -> None:
    found = rows(oscillator().to_csv(tmp_path / "run.csv", t=[0.5, 0.125]))
    np.testing.assert_array_equal(found[:, 0], [0.5, 0.125])
    np.testing.assert_allclose(found[:, 2], -2 * np.sin([1.0, 0.25]))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate": 0}, "rate = 0: give a positive number of lines to a unit of time"),
        ({"rate": float("inf")}, "rate is inf: give a finite number"),
        ({"rate": 1e8}, r"rate = 1e\+08 gives 5e\+08 lines from t = 0 to 5: give one that makes at most"),
        ({"rate": 2, "t": [1.0]}, "give rate= or t= and not both"),
        ({"t": [6.0]}, "t = 6 is outside the run, which went from 0 to 5"),
    ],
)
def test_lines_that_cannot_be_written_are_refused(given: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(StatementError, match=message):
        oscillator().to_csv(tmp_path / "run.csv", **given)
    assert not list(tmp_path.iterdir())


def test_a_sampled_run_is_the_run_at_other_times() -> None:
    run = oscillator().sampled([0.25, 3.0])
    np.testing.assert_allclose(run["x"], np.cos([0.5, 6.0]))
    np.testing.assert_allclose(run.energy, 2.0)
    assert run.at(4.0)[0] == pytest.approx(np.cos(8.0))
