"""Pictures of ensembles show the results of the runs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from tests.refusals import refusal


@cache
def pendulum() -> lg.System:
    return lg.scene("pendulum")


def test_a_map_has_a_colour_for_every_run() -> None:
    runs = lg.ensemble(pendulum(), 1.0, lg.grid({"theta": (0.1, 2.0, 5), "l": (0.5, 1.5, 4), "m": [2.0]}))
    panel, scale = runs.plot("theta_dot").axes
    (image,) = panel.images
    assert np.array_equal(np.asarray(image.get_array()), runs["theta_dot"].reshape(5, 4).T)
    assert (panel.get_xlabel(), panel.get_ylabel()) == (r"$\theta$ at the start", "$l$")
    assert scale.get_ylabel() == r"$\dot{\theta}$ at the end"
    # Each colour stands around its start.
    width, height = 1.9 / 4 / 2, 1.0 / 3 / 2
    assert image.get_extent() == pytest.approx([0.1 - width, 2.0 + width, 0.5 - height, 1.5 + height])
    uneven = lg.ensemble(pendulum(), 1.0, lg.grid({"theta": [0.1, 0.2, 0.4], "l": [2.0, 1.0]})).plot("theta_dot")
    assert not uneven.axes[0].images and len(uneven.axes[0].collections) == 1


def test_angles_at_the_end_are_shown_in_one_turn() -> None:
    runs = lg.ensemble(pendulum(), 5.0, lg.grid({"theta_dot": (0.0, 9.0, 6), "l": (0.5, 1.5, 4)}))
    assert np.abs(runs["theta"]).max() > 2 * np.pi
    panel, scale = runs.plot("theta").axes
    drawn = np.asarray(panel.images[0].get_array())
    assert np.abs(drawn).max() <= np.pi and panel.images[0].get_clim() == (-np.pi, np.pi)
    assert np.exp(1j * drawn) == pytest.approx(np.exp(1j * runs["theta"].reshape(6, 4).T))
    assert [label.get_text() for label in scale.get_yticklabels()][-1] == r"$\pi$"


def test_members_that_failed_are_marked_on_a_map() -> None:
    runs = lg.ensemble(lg.scene("henon-heiles"), 15.0, lg.grid({"x": (-0.2, 0.6, 8), "y": (-0.2, 0.6, 9)}))
    figure = runs.plot("y")
    values, marks = figure.axes[0].images
    failed = np.array([not status.complete for status in runs.status]).reshape(8, 9).T
    assert 0 < failed.sum() < failed.size
    assert [np.ma.getmaskarray(np.ma.asanyarray(item.get_array())).tolist() for item in (values, marks)] == [
        failed.tolist(),
        (~failed).tolist(),
    ]
    (crosses,) = figure.axes[0].lines
    assert np.size(crosses.get_xdata()) == failed.sum()
    assert figure.get_supxlabel() == f"{failed.sum()} of 72 members failed, in red."


@pytest.mark.slow
def test_units_and_what_was_kept_are_named() -> None:
    x = lg.coordinate("x")
    m, g = lg.parameters("m g")
    ball = lg.System(
        kinetic=m * x.dot**2 / 2,
        potential=m * g * x,
        parameters={m: 1.0, g: 9.81},
        initial={x: 1.0},
        dimensions={m: "kg", g: "m/s**2", x: "m", lg.t: "s"},
        name="ball",
    )
    grid = lg.grid({"x": (1.0, 2.0, 3), "x_dot": (0.0, 3.0, 3)})
    runs = lg.ensemble(ball, 1.0, grid, events=[lg.event(x - 1.5, direction=-1)], keep=("events", ("max", x)))
    panel, scale = runs.plot("max(x)").axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("$x$ (m) at the start", r"$\dot{x}$ (m/s) at the start")
    assert scale.get_ylabel() == "largest $x$ (m)"
    figure = runs.plot("t_event_0")
    assert figure.axes[1].get_ylabel() == "first time of x - 1.5 = 0 (s)"
    assert figure.get_supxlabel() == f"{np.isnan(runs.t_events[0]).sum()} of 9 members have none."


def test_last_states_are_drawn_beside_states_at_output_times() -> None:
    grid = lg.grid({"theta": (0.5, 3.0, 4), "theta_dot": (0.0, 9.0, 3)})
    ends = lg.ensemble(pendulum(), 3.0, grid)
    fans = lg.ensemble(pendulum(), 3.0, grid, t_eval=[1.0, 3.0])
    maps = (
        runs.plot(name).axes[0].images[0] for runs, name in ((ends, "theta"), (ends, "theta_end"), (fans, "theta_end"))
    )
    plain, named, beside = (np.asarray(drawn.get_array()) for drawn in maps)
    assert np.array_equal(plain, named) and np.array_equal(plain, beside)
    assert np.abs(ends["theta"]).max() > np.pi > np.abs(plain).max()
    assert fans.plot("theta_end").axes[1].get_ylabel() == r"$\theta$ at the end"


def test_a_fan_over_time_names_the_state_and_not_its_start() -> None:
    fans = lg.ensemble(pendulum(), 3.0, {"theta": [0.5, 1.0, 1.5]}, t_eval=[0.0, 1.0, 3.0])
    assert fans.plot("theta").axes[0].get_ylabel() == r"$\theta$"


def test_a_card_has_the_picture_and_the_first_failure() -> None:
    runs = lg.ensemble(lg.scene("henon-heiles"), 15.0, lg.grid({"x": (0.0, 1.0, 6)}))
    assert repr(runs).startswith("henon-heiles: 6 members, varying x\nmethod") and "member 2  taylor stopped" in repr(
        runs
    )
    shown = runs._repr_html_()
    assert shown.startswith("<table>") and "data:image/png;base64," in shown
    lost = lg.ensemble(lg.scene("henon-heiles"), 15.0, {"x": [0.9, 1.0]})
    assert "there is nothing to draw" in lost._repr_html_()
    with pytest.raises(lg.StatementError, match="there is nothing to draw"):
        lost.plot()


def test_a_table_has_a_line_for_each_member(tmp_path: Path) -> None:
    x = pendulum().coordinates[0]
    grid = lg.grid({"theta": (0.5, 2.0, 3), "l": [1.0, 2.0]})
    runs = lg.ensemble(pendulum(), 3.0, grid, events=[x], keep=("end", "counts", ("events", 2)))
    lines = runs.to_csv(tmp_path / "runs.csv").read_text().splitlines()
    table = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    assert [row["status"] for row in table] == ["success"] * 6
    for i, row in enumerate(table):
        assert int(row["member"]) == i and int(row["steps"]) == runs.steps[i]
        assert (float(row["theta"]), float(row["l"])) == (runs.given("theta")[i], runs.given("l")[i])
        assert (float(row["theta_end"]), float(row["theta_dot_end"])) == tuple(runs.y[:, i])
        assert float(row["t_event_0[0]"]) == runs.t_events[0][i, 0]
        assert float(row["y_event_0[0][1]"]) == runs.y_events[0][i, 0, 1]
    over_time = lg.ensemble(pendulum(), 1.0, grid, t_eval=[0.5])
    with pytest.raises(lg.StatementError, match="cannot hold states at output times"):
        over_time.to_csv(tmp_path / "none.csv")


def test_a_curve_is_drawn_over_what_varies_and_failures_are_told() -> None:
    runs = lg.ensemble(lg.scene("henon-heiles"), 15.0, lg.grid({"x": (0.0, 1.0, 6)}), keep=("end", "counts"))
    figure = runs.plot("steps", style="dark")
    line, crosses = figure.axes[0].lines
    failed = np.array([not status.complete for status in runs.status])
    assert np.array_equal(line.get_xdata(), np.linspace(0.0, 1.0, 6))
    assert np.array_equal(np.asarray(line.get_ydata())[~failed], runs.steps[~failed])
    assert np.isnan(np.asarray(line.get_ydata())[failed]).all()
    assert np.array_equal(crosses.get_xdata(), np.linspace(0.0, 1.0, 6)[failed])
    assert figure.get_supxlabel() == f"{failed.sum()} of 6 members failed."


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
        (lambda runs: runs.plot("mass"), "'mass' is not a coordinate, a velocity or a quantity that varies or was kep"),
        (lambda runs: runs.plot(style="bright"), "style = 'bright' is not known"),
        (lambda runs: runs.plot(), "3 quantities vary, theta, l and g: a picture has two axes"),
    ],
)
def test_what_cannot_be_drawn_is_refused(call: Any, text: str) -> None:
    runs = lg.ensemble(pendulum(), 0.1, lg.grid({"theta": [0.1, 0.2], "l": [1.0, 2.0], "g": [9.0, 10.0]}))
    assert text in refusal(call, runs)
