"""Output of a race: the table, records, files and the picture, from invented numbers."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagrange.errors import StatementError
from lagrange.evidence.trust import ReferenceSolution, Sensitivity
from lagrange.evidence.work_precision import Entry, Result
from lagrange.show.race import COLUMNS, Race

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
    with pytest.raises(StatementError, match="error = 0: give the largest allowed error"):
        race.fastest(0.0)


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
    with pytest.raises(StatementError, match="nothing to plot"):
        made(ENTRIES[4:]).plot()
    with pytest.raises(StatementError, match="nothing to plot"):
        made([replace(ENTRIES[0], error=math.inf)]).plot()
    assert "Within 1e-03: no run." in repr(made(ENTRIES[4:]))
