"""Pictures, cards and tables of dynamics, ensembles and races."""

import csv
import json
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from sympy import cos

import lagrange as lg
from lagrange.dynamics.axes import TURN
from lagrange.evidence.trust_horizon import ReferenceSolution, Sensitivity
from lagrange.evidence.work_precision import Entry, Result
from lagrange.show.dynamics import Drawn
from lagrange.show.figures.dynamics_figures import MOST_MODES, PANEL_HEIGHT, PANEL_WIDTH
from lagrange.show.figures.style import DARK
from lagrange.show.race import COLUMNS, Race
from tests.dynamics.planar import damped_pendulum, duffing, hoop, pendulum, star, theta, x, y
from tests.models import shared_scene
from tests.refusals import refusal

RECORDS: dict[str, Callable[[], Any]] = {
    "portrait": lambda: lg.phase_portrait(damped_pendulum(), starts=[{theta: 2.0}]),
    "section": lambda: lg.poincare(
        star(), lg.event(x, direction=1), [{y: 0.3}], energy=0.1, solve_for=x.dot, crossings=20
    ),
    "sweep": lambda: lg.bifurcation(duffing(), "F", [0.2, 0.28], points=8, skip=100),
    "branches": lambda: lg.bifurcation(hoop(), "w", (2.0, 8.0, 10)),
}


@cache
def recorded(kind: str) -> Any:
    """Return a result of a kind, such as a phase portrait."""
    return RECORDS[kind]()


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", RECORDS)
def test_a_record_has_a_card_a_picture_and_a_file(kind: str, tmp_path: Path) -> None:
    record = recorded(kind)
    assert isinstance(record, Drawn)
    figure = record.plot(style="dark")
    assert isinstance(figure, Figure)
    assert figure.get_facecolor() == pytest.approx([*bytes.fromhex(DARK.paper[1:]), 255] / np.array(255.0))
    assert repr(record).startswith(f"{record.statement.name}: success\n")
    page = record._repr_html_()
    assert page.startswith("<table>")
    assert len(re.sub(r"base64,[^']*", "", page)) < 20_000
    assert 1000 < len(page) <= 400_000 + 20_000  # 300,000 bytes of a picture are four thirds as many letters
    written = record.to_png(tmp_path / "picture.png", dpi=50)
    assert written.read_bytes().startswith(b"\x89PNG")
    assert repr(pickle.loads(pickle.dumps(record))) == repr(record)


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", RECORDS)
def test_a_picture_is_drawn_on_axes_of_the_users(kind: str) -> None:
    record = recorded(kind)
    figure = lg.figure(columns=2)
    left, right = figure.axes[:2]
    assert record.plot(ax=left) is figure
    assert left.has_data()
    assert not right.has_data()
    wrong: Any = "left"
    assert "ax is 'left': give axes of Matplotlib, or leave it out" in refusal(record.plot, ax=wrong)
    assert "style = 'blue' is not known" in refusal(record.plot, style="blue")


def lines_of(axis: Axes, colour: str) -> list[Any]:
    return [np.array(line.get_xydata()) for line in axis.get_lines() if line.get_color() == colour]


def test_orbits_are_drawn_within_a_pixel_and_wrapped() -> None:
    """Orbits are compared with the level curve of the energy. A pixel is window/WIDTH by window/HEIGHT."""
    result = lg.phase_portrait(pendulum(), starts=[{theta: 2.5}, {theta.dot: 2.5}])
    (axis,) = result.plot().axes
    drawn = lines_of(axis, "#0b6e99")
    assert len(drawn) == 2
    for line, energy in zip(drawn, (-np.cos(2.5), 2.5**2 / 2 - 1), strict=True):
        good = np.isfinite(line).all(axis=1)
        assert (np.abs(line[good, 0]) <= np.pi + 1e-12).all()
        both = good[1:] & good[:-1]
        middle = (line[1:][both] + line[:-1][both]) / 2
        gradient = np.column_stack(
            [np.sin(middle[:, 0]) * TURN / PANEL_WIDTH, middle[:, 1] * result.plane[1].width / PANEL_HEIGHT]
        )
        off = np.abs(middle[:, 1] ** 2 / 2 - np.cos(middle[:, 0]) - energy) / np.maximum(
            np.linalg.norm(gradient, axis=1), 1e-9
        )
        assert off.max() < 1.0
    # The one that turns over goes out on one side and in on the other.
    assert np.isnan(drawn[1]).any()
    assert np.nanmax(drawn[1][:, 0]) == pytest.approx(np.pi)
    assert np.nanmin(drawn[1][:, 0]) == pytest.approx(-np.pi)


def test_a_portrait_marks_equilibria_and_says_what_is_what() -> None:
    (axis,) = recorded("portrait").plot().axes
    legend = axis.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[2:] == ["separatrix from the saddle", "separatrix to the saddle", "saddle", "stable spiral"]
    assert texts[0] == r"$\dot{\theta} = 0$"
    assert [tick.get_text() for tick in axis.get_xticklabels()] == [r"$-\pi$", r"$-\pi/2$", "$0$", r"$\pi/2$", r"$\pi$"]
    assert axis.get_ylabel() == r"$\dot{\theta}$"


def test_a_section_draws_the_entries_that_are_asked_for() -> None:
    section = recorded("section")
    (axis,) = section.plot(x=y.dot, y="x_dot").axes
    (points,) = [line.get_xydata() for line in axis.get_lines()]
    assert points == pytest.approx(section.points[:, [3, 2]])
    (axis,) = section.plot().axes
    assert len(axis.get_lines()) == 2  # the border too
    assert "x names 'z', which is not a coordinate or velocity of this system" in refusal(section.plot, x="z")
    assert "entry names 'z'" in refusal(lambda: recorded("sweep").plot("z"))
    assert "velocities are zero at equilibria: give a coordin" in refusal(lambda: recorded("branches").plot(theta.dot))


def test_branches_meet_where_they_bifurcate() -> None:
    (axis,) = recorded("branches").plot().axes
    ends = [line[np.isfinite(line).all(axis=1)][0] for line in lines_of(axis, "#0b6e99")]
    critical = np.sqrt(9.81 / 0.5)
    forks = [end for end in ends if end[0] > 2.1]
    assert len(forks) == 2
    assert np.array(forks) == pytest.approx(np.array([[critical, 0.0]] * 2), abs=1e-5)


def test_modes_are_drawn_as_bars_and_on_the_positions() -> None:
    energies: dict[str, Any] = {"kinetic": (x.dot**2 + y.dot**2) / 2, "potential": x**2 + 2 * y**2}
    modes = lg.System(**energies, positions={"a": (x, 0), "b": (y, 1)}).modes()
    figure = modes.plot()
    assert len(figure.axes) == 4
    heights = [bar.get_height() for bar in figure.axes[0].patches if isinstance(bar, Rectangle)]
    shapes = modes.shapes_in_numbers()
    assert heights == pytest.approx(shapes.components[0])
    assert figure.axes[0].get_title("left").startswith("mode 1: $\\omega$ = ")
    # Where nothing is stated to draw there are bars alone, as on axes of the user's.
    bare = lg.System(**energies).modes()
    assert len(bare.plot().axes) == 2
    mine = lg.figure().axes[0]
    bare.plot(ax=mine)
    assert len(mine.patches) == 4
    assert repr(pickle.loads(pickle.dumps(bare))) == repr(bare)


@pytest.mark.slow
def test_titles_of_modes_say_how_they_move_and_many_modes_are_left_out() -> None:
    several: Any = lg.coordinates(" ".join(f"q{k}" for k in range(10)))
    chain = lg.System(
        kinetic=sum(q.dot**2 / 2 for q in several),
        potential=sum((k + 1) * q**2 / 2 for k, q in enumerate(several)),
        forces={several[0]: -several[0].dot / 5},
    )
    figure = chain.modes().plot()
    assert len(figure.axes) == MOST_MODES
    assert figure.get_supxlabel() == "2 more modes not drawn."
    assert ", decay 0.1" in figure.axes[0].get_title("left")
    upright = lg.System(kinetic=theta.dot**2 / 2, potential=cos(theta) + y**2 * 0, coordinates=[theta]).modes()
    assert upright.plot().axes[0].get_title("left") == "mode 1: grows, rate 1"
    free = lg.System(kinetic=x.dot**2 / 2 + y.dot**2 / 2, potential=(x - y) ** 2 / 2).modes()
    assert free.plot().axes[0].get_title("left") == "mode 1: moves freely"


# --- pictures of ensembles show the results of the runs --------------------------------------------------------


PENDULUM, STAR = shared_scene("pendulum"), shared_scene("henon-heiles")


def test_a_map_has_a_colour_for_every_run() -> None:
    runs = lg.ensemble(PENDULUM, 1.0, lg.grid({"theta": (0.1, 2.0, 5), "l": (0.5, 1.5, 4), "m": [2.0]}))
    panel, scale = runs.plot("theta_dot").axes
    (image,) = panel.images
    assert np.array_equal(np.asarray(image.get_array()), runs["theta_dot"].reshape(5, 4).T)
    assert (panel.get_xlabel(), panel.get_ylabel()) == (r"$\theta$ at the start", "$l$")
    assert scale.get_ylabel() == r"$\dot{\theta}$ at the end"
    # Each colour stands around its start.
    width, height = 1.9 / 4 / 2, 1.0 / 3 / 2
    assert image.get_extent() == pytest.approx([0.1 - width, 2.0 + width, 0.5 - height, 1.5 + height])
    uneven = lg.ensemble(PENDULUM, 1.0, lg.grid({"theta": [0.1, 0.2, 0.4], "l": [2.0, 1.0]})).plot("theta_dot")
    assert not uneven.axes[0].images and len(uneven.axes[0].collections) == 1


def test_angles_at_the_end_are_shown_in_one_turn() -> None:
    runs = lg.ensemble(PENDULUM, 5.0, lg.grid({"theta_dot": (0.0, 9.0, 6), "l": (0.5, 1.5, 4)}))
    assert np.abs(runs["theta"]).max() > 2 * np.pi
    panel, scale = runs.plot("theta").axes
    drawn = np.asarray(panel.images[0].get_array())
    assert np.abs(drawn).max() <= np.pi and panel.images[0].get_clim() == (-np.pi, np.pi)
    assert np.exp(1j * drawn) == pytest.approx(np.exp(1j * runs["theta"].reshape(6, 4).T))
    assert [label.get_text() for label in scale.get_yticklabels()][-1] == r"$\pi$"


def test_members_that_failed_are_marked_on_a_map() -> None:
    runs = lg.ensemble(STAR, 15.0, lg.grid({"x": (-0.2, 0.6, 8), "y": (-0.2, 0.6, 9)}))
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


@pytest.mark.slow
def test_last_states_are_drawn_beside_states_at_output_times() -> None:
    grid = lg.grid({"theta": (0.5, 3.0, 4), "theta_dot": (0.0, 9.0, 3)})
    ends = lg.ensemble(PENDULUM, 3.0, grid)
    fans = lg.ensemble(PENDULUM, 3.0, grid, t_eval=[1.0, 3.0])
    maps = (
        runs.plot(name).axes[0].images[0] for runs, name in ((ends, "theta"), (ends, "theta_end"), (fans, "theta_end"))
    )
    plain, named, beside = (np.asarray(drawn.get_array()) for drawn in maps)
    assert np.array_equal(plain, named) and np.array_equal(plain, beside)
    assert np.abs(ends["theta"]).max() > np.pi > np.abs(plain).max()
    assert fans.plot("theta_end").axes[1].get_ylabel() == r"$\theta$ at the end"


def test_a_fan_over_time_names_the_state_and_not_its_start() -> None:
    fans = lg.ensemble(PENDULUM, 3.0, {"theta": [0.5, 1.0, 1.5]}, t_eval=[0.0, 1.0, 3.0])
    assert fans.plot("theta").axes[0].get_ylabel() == r"$\theta$"


def test_a_card_has_the_picture_and_the_first_failure() -> None:
    runs = lg.ensemble(STAR, 15.0, lg.grid({"x": (0.0, 1.0, 6)}))
    assert repr(runs).startswith("henon-heiles: 6 members, varying x\nmethod") and "member 2  taylor stopped" in repr(
        runs
    )
    shown = runs._repr_html_()
    assert shown.startswith("<table>") and "data:image/png;base64," in shown
    lost = lg.ensemble(STAR, 15.0, {"x": [0.9, 1.0]})
    assert "there is nothing to draw" in lost._repr_html_()
    assert "there is nothing to draw" in refusal(lost.plot)


@pytest.mark.slow
def test_a_table_has_a_line_for_each_member(tmp_path: Path) -> None:
    x = PENDULUM.coordinates[0]
    grid = lg.grid({"theta": (0.5, 2.0, 3), "l": [1.0, 2.0]})
    runs = lg.ensemble(PENDULUM, 3.0, grid, events=[x], keep=("end", "counts", ("events", 2)))
    lines = runs.to_csv(tmp_path / "runs.csv").read_text().splitlines()
    table = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    assert [row["status"] for row in table] == ["success"] * 6
    for i, row in enumerate(table):
        assert int(row["member"]) == i and int(row["steps"]) == runs.steps[i]
        assert (float(row["theta"]), float(row["l"])) == (runs.given("theta")[i], runs.given("l")[i])
        assert (float(row["theta_end"]), float(row["theta_dot_end"])) == tuple(runs.y[:, i])
        assert float(row["t_event_0[0]"]) == runs.t_events[0][i, 0]
        assert float(row["y_event_0[0][1]"]) == runs.y_events[0][i, 0, 1]
    over_time = lg.ensemble(PENDULUM, 1.0, grid, t_eval=[0.5])
    assert "cannot hold states at output times" in refusal(over_time.to_csv, tmp_path / "none.csv")


def test_a_curve_is_drawn_over_what_varies_and_failures_are_told() -> None:
    runs = lg.ensemble(STAR, 15.0, lg.grid({"x": (0.0, 1.0, 6)}), keep=("end", "counts"))
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
    ends = lg.ensemble(PENDULUM, 1.0, parameters=sample)
    patches: list[Any] = list(ends.plot("theta").axes[0].patches)
    counts = [patch.get_height() for patch in patches]
    assert sum(counts) == 64
    runs = lg.ensemble(PENDULUM, 1.0, parameters=sample, t_eval=np.linspace(0.0, 1.0, 9))
    middle = runs.plot(runs.model.statement.coordinates[0]).axes[0].lines[-1]
    assert np.allclose(middle.get_ydata(), np.median(runs.y[0], axis=1))
    few = lg.ensemble(PENDULUM, 1.0, {"theta": np.linspace(0.1, 2.0, 12)}, t_eval=[0.0, 0.5, 1.0])
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
    runs = lg.ensemble(PENDULUM, 0.1, lg.grid({"theta": [0.1, 0.2], "l": [1.0, 2.0], "g": [9.0, 10.0]}))
    assert text in refusal(call, runs)


# --- output of a race: the table, records, files and the picture, from invented numbers ------------------------


ADAPTIVE: dict[str, Any] = {"method": "dop853", "adaptive": True}
FIXED: dict[str, Any] = {"method": "rk4", "adaptive": False}
DONE: dict[str, Any] = {"timed": 5, "steps": 120, "evaluations": 1440, "status": "success", "message": "there"}
ENTRIES = (
    Entry(**ADAPTIVE, setting=1e-6, error=2e-7, time=1e-4, **DONE),
    Entry(**ADAPTIVE, setting=1e-9, error=1e-20, resolved=False, time=3e-4, **DONE),
    Entry(**FIXED, setting=0.01, error=5e-7, time=5e-5, **DONE),
    Entry(**FIXED, setting=0.001, error=4e-10, time=2.5, **DONE),
    Entry(
        method="scipy-lsoda",
        adaptive=True,
        setting=1e-6,
        status="max_wall",
        message="used up <max_wall>",
        steps=7,
        evaluations=9,
    ),
)


def made(entries: Any = ENTRIES, *, floor: float = 1e-15, times: tuple[float, ...] = (20.0,), **more: Any) -> Race:
    right = ReferenceSolution(times, ((1.0, 2.0),) * len(times), 1e-20, "an independent run")
    result = Result(tuple(entries), right, Sensitivity(12.0, floor), (1.0, 2.0), (1.0, 1.0), ("A note & more.",))
    return Race(result, "pendulum", (0.0, 20.0), **more)


def test_it_prints_as_a_table_with_its_remarks() -> None:
    lines = repr(made()).splitlines()
    assert lines[0] == "pendulum, t = 0 to 20: largest error of the state at t = 20"
    assert " ".join(lines[2].split()) == "method setting error time / ms steps evaluations status"
    assert " ".join(lines[4].split()) == "dop853 tol = 1e-06 2.0e-07 0.1 120 1440 success"
    assert " ".join(lines[5].split()) == "dop853 tol = 1e-09 < 1.0e-20 0.3 120 1440 success"
    assert " ".join(lines[7].split()) == "rk4 h = 0.001 4.0e-10 2500 120 1440 success"
    assert " ".join(lines[8].split()) == "scipy-lsoda tol = 1e-06 - - 7 9 max_wall"
    assert lines[10:] == [
        "Errors are measured against an independent run, with an error of 1.0e-20.",
        "Within 1e-03: rk4 at h = 0.01 is the fastest, in 0.05 ms.",
        "Within 1e-06: rk4 at h = 0.01 is the fastest, in 0.05 ms.",
        "Within 1e-09: dop853 at tol = 1e-09 is the fastest, in 0.3 ms.",
        "Within 1e-12: dop853 at tol = 1e-09 is the fastest, in 0.3 ms.",
        "A note & more.",
        "scipy-lsoda at tol = 1e-06: used up <max_wall>",
    ]


def test_a_refusal_is_printed_once_for_all_settings() -> None:
    refused = [Entry("verlet", adaptive=False, setting=2.0**-k, message="verlet refuses.") for k in range(1, 10)]
    lines = repr(made([ENTRIES[0], *refused, Entry("rk4", adaptive=False, setting=0.5, message="no")])).splitlines()
    assert [line for line in lines if "refuses" in line] == ["verlet at h = 0.5 to h = 0.00195: verlet refuses."]
    assert lines[-1] == "rk4 at h = 0.5: no"
    assert repr(made(refused[:2])).splitlines()[-1] == "verlet at h = 0.5 and h = 0.25: verlet refuses."


def test_the_measure_is_said() -> None:
    assert made(relative=True).measure() == "largest error of the state at t = 20, relative to each entry's size"
    assert made(times=(10.0, 20.0)).measure() == "largest error of the state at 2 times"


def test_rows_are_records() -> None:
    race = made()
    assert len(race) == len(race.records) == 5
    assert list(race)[2] is race[2] is ENTRIES[2]
    assert tuple(race.records[0]) == COLUMNS
    assert race.records[0]["error"] == 2e-7
    assert race.methods == ("dop853", "rk4", "scipy-lsoda")
    assert (race.uncertainty, race.growth, race.floor) == (1e-20, 12.0, 1e-15)


def test_the_fastest_within_an_error() -> None:
    race = made()
    assert race.fastest(1e-3) is ENTRIES[2]
    assert race.fastest(5e-7) is ENTRIES[2]
    assert race.fastest(4e-10) is ENTRIES[1]
    assert race.fastest(1e-30) is None
    assert "error = 0: give the largest allowed error" in refusal(race.fastest, 0.0)


def test_the_file_has_every_run_and_numbers_round_trip(tmp_path: Path) -> None:
    path = made().to_csv(tmp_path / "table.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(COLUMNS)
    assert [float(row["error"]) for row in rows[:4]] == [entry.error for entry in ENTRIES[:4]]
    assert math.isnan(float(rows[4]["error"]))
    assert [(row["adaptive"], row["resolved"]) for row in rows[:3]] == [("1", "1"), ("1", "0"), ("0", "1")]
    assert rows[4]["message"] == "used up <max_wall>"


def test_data_for_json_has_no_nan() -> None:
    data = json.loads(json.dumps(made(floor=math.inf).to_dict(), allow_nan=False))
    assert data["entries"][4]["error"] is None
    assert data["floor"] is None
    assert (data["system"], data["t_end"], data["uncertainty"]) == ("pendulum", 20.0, 1e-20)


def test_html_is_escaped() -> None:
    page = made()._repr_html_()
    assert page.count("<tr>") == 6
    assert "&lt; 1.0e-20" in page and "&lt;max_wall&gt;" in page and "note &amp; more" in page


# --- the picture --------------------------------------------------------------------------------------------


def test_the_picture_has_a_line_for_each_method_that_got_there() -> None:
    axis = made().plot().axes[0]
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
    assert axis.get_xlabel() == "time of one run / s"
    assert axis.get_ylabel() == "largest error at the end, in the state's units"
    legend = axis.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["dop853\ntol = 1e-6 to 1e-9", "rk4\nh = 1e-2 to 1e-3"]
    points = [np.asarray(line.get_xydata()).tolist() for line in axis.get_lines()]
    assert [line for line in points if line] == [[[1e-4, 2e-7]], [[3e-4, 1e-20]], [[5e-5, 5e-7], [2.5, 4e-10]]]
    markers = {line.get_label(): line.get_marker() for line in axis.get_lines() if line.get_label() in labels}
    assert len(set(markers.values())) == 2


def test_what_the_reference_cannot_tell_is_drawn_open() -> None:
    told, untold = made().plot().axes[0].get_lines()[:2]
    assert untold.get_markerfacecolor() == "#ffffff" != told.get_markerfacecolor()
    assert untold.get_linestyle() == "None"
    assert "is an upper bound" in made().plot().get_supxlabel()
    assert "is an upper bound" not in made(ENTRIES[2:]).plot().get_supxlabel()


def test_the_floor_is_shaded_where_it_shows() -> None:
    assert len(made(floor=1e-9).plot().axes[0].patches) == 1
    assert len(made(ENTRIES[:1], floor=1e-15).plot().axes[0].patches) == 0
    assert len(made(floor=math.inf).plot().axes[0].patches) == 0


@pytest.mark.few(1)
@pytest.mark.parametrize("floor", [5e-21, 1e-6])
def test_the_note_on_the_floor_is_inside_the_axes(floor: float) -> None:
    figure = made(floor=floor).plot()
    figure.draw_without_rendering()
    (axis,) = figure.axes
    low, high = axis.get_ylim()
    assert low < floor < high
    note, frame = axis.texts[0].get_window_extent(), axis.get_window_extent()
    assert frame.y0 < note.y0 and note.y1 < frame.y1


def test_what_is_not_shown_is_said() -> None:
    words = made().plot().get_supxlabel()
    assert "1 of 5 runs did not reach the end" in words
    assert "known to 1.0e-20" in words and "A note & more." in words
    assert "did not reach" not in made(ENTRIES[:4]).plot().get_supxlabel()


def test_there_may_be_nothing_to_draw() -> None:
    assert "nothing to plot" in refusal(lambda: made(ENTRIES[4:]).plot())
    assert "nothing to plot" in refusal(lambda: made([replace(ENTRIES[0], error=math.inf)]).plot())
    assert "Within 1e-03: no run." in repr(made(ENTRIES[4:]))
