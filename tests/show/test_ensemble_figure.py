"""Pictures of ensembles: what is drawn is what the runs gave."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import lagrange as lg


@cache
def pendulum() -> lg.System:
    return lg.scene("pendulum")


def test_a_map_has_a_colour_for_every_run() -> None:
    runs = lg.ensemble(pendulum(), 1.0, lg.grid({"theta": (0.1, 2.0, 5), "l": (0.5, 1.5, 4), "m": [2.0]}))
    axis = runs.plot("theta_dot").axes[0]
    drawn = np.asarray(axis.collections[0].get_array())
    assert np.array_equal(drawn, runs["theta_dot"].reshape(5, 4))
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("l", r"$\theta$")


def test_a_curve_is_drawn_over_what_varies_and_failures_are_told() -> None:
    runs = lg.ensemble(lg.scene("henon-heiles"), 15.0, lg.grid({"x": (0.0, 1.0, 6)}), keep=("end", "counts"))
    figure = runs.plot("steps", style="dark")
    line = figure.axes[0].lines[0]
    assert np.array_equal(line.get_xdata(), np.linspace(0.0, 1.0, 6)) and np.array_equal(line.get_ydata(), runs.steps)
    assert "did not get to the end" in figure.get_supxlabel()


def test_samples_are_a_histogram_and_rows_over_time_a_fan() -> None:
    sample = lg.sample({"l": (0.9, 1.1)}, 64, seed=2)
    ends = lg.ensemble(pendulum(), 1.0, parameters=sample)
    patches: list[Any] = list(ends.plot("theta").axes[0].patches)
    counts = [patch.get_height() for patch in patches]
    assert sum(counts) == 64
    runs = lg.ensemble(pendulum(), 1.0, parameters=sample, t_eval=np.linspace(0.0, 1.0, 9))
    middle = runs.plot(runs.model.statement.coordinates[0]).axes[0].lines[-1]
    assert np.allclose(middle.get_ydata(), np.median(runs.y[0], axis=1))
    few = lg.ensemble(pendulum(), 1.0, {"theta": np.linspace(0.1, 2.0, 12)}, t_eval=[0.0, 0.5, 1.0])
    lines = few.plot().axes[0].lines
    assert [np.asarray(line.get_ydata()).tolist() for line in lines] == few.y[0].T.tolist()
    assert len({line.get_color() for line in lines}) == 12


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda runs: runs.plot("mass"), "'mass' is no coordinate, no velocity and nothing that varies or was kept"),
        (lambda runs: runs.plot(style="bright"), "style = 'bright' is not known"),
        (lambda runs: runs.plot(), "3 things vary, theta, l and g: a picture has two axes"),
    ],
)
def test_what_cannot_be_drawn_is_refused(call: Any, text: str) -> None:
    runs = lg.ensemble(pendulum(), 0.1, lg.grid({"theta": [0.1, 0.2], "l": [1.0, 2.0], "g": [9.0, 10.0]}))
    with pytest.raises(lg.StatementError) as refusal:
        call(runs)
    assert text in str(refusal.value)
