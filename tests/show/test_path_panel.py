"""The panel of paths and the phase plane: names and numbers, room around marks, and motions small for their place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.show.figures.paths import Box
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from tests.show.examples import m, oscillator, solved, x
from tests.show.test_picture_laws import drawn, nothing_overlaps

a, b = coordinates("a b")


def moving(*place: Any, size: float = 1.0, units: bool = False) -> Solution:
    """Return a point at a place that depends on a = size sin(t) and b = size sin(2 t)."""
    statement = declare(
        kinetic=m * (a.dot**2 + b.dot**2) / 2,
        positions={"p": place},
        parameters={m: 1},
        dimensions={m: "kg", a: "m", b: "m", lg.t: "s"} if units else None,
        name="s",
    )
    return solved(
        statement,
        np.linspace(0.0, 6.0, 9),
        lambda t: size * np.array([np.sin(t), np.sin(2 * t), np.cos(t), 2 * np.cos(2 * t)]),
    )


def test_a_view_of_space_has_units_at_its_floor_alone() -> None:
    axis = moving(a, b, a + b, units=True).plot("path").axes[0]
    assert axis.get_xlabel() == axis.get_ylabel() == ""
    assert {"x (m)", "y (m)", "z (m)"} <= {text.get_text() for text in axis.texts}


def test_of_a_long_run_the_last_part_is_drawn_and_marks_have_room() -> None:
    run = oscillator(np.linspace(0.0, 2000.0, 9), positions={"p": (x, 0)})
    (axis,) = drawn(run.plot("path")).axes
    assert axis.get_title("left").startswith("path from t = ")
    low, high = axis.get_xlim()
    assert low < -1.05 and high > 1.05


def test_small_motions_far_away_are_drawn_with_all_digits() -> None:
    (axis,) = moving(a + 1e6, b - 3e5).plot("path").axes
    nothing_overlaps(axis.figure)
    assert "1000000" in [text.get_text() for text in axis.get_xticklabels()]


def test_of_a_level_line_the_phase_plane_is_drawn() -> None:
    far = solved(
        moving(a, b).model.statement,
        np.linspace(0.0, 6.0, 9),
        lambda t: np.array([1e6 + np.sin(t), 0 * t, np.cos(t), 0 * t]),
    )
    nothing_overlaps(far.plot("phase", of="a"))
    level = drawn(far.plot("phase", of="b")).axes[0]
    assert level.get_xlim() == (-1.0, 1.0)


def test_round_off_of_a_place_fills_no_panel() -> None:
    (axis,) = drawn(moving(a + 10, 0, size=1e-11).plot("path")).axes
    assert axis.get_xlim() == pytest.approx((5.0, 15.0))


def test_long_numbers_below_a_plane_stand_apart() -> None:
    nothing_overlaps(moving(150 * a + 1e6, 300 * b + 2e5).plot("path"))


def test_many_points_have_one_colour_and_no_legend() -> None:
    for count, names in ((10, 10), (11, 0)):
        places = {f"p{k}": (a + k, b) for k in range(count)}
        statement = declare(kinetic=m * (a.dot**2 + b.dot**2) / 2, positions=places, parameters={m: 1}, name="s")
        t = np.linspace(0.0, 6.0, 9)
        run = solved(statement, t, lambda t: np.array([np.sin(t), np.cos(t), np.cos(t), -np.sin(t)]))
        (axis,) = run.plot("path").axes
        assert len(axis.get_legend_handles_labels()[1]) == names
        ends = [line for line in axis.lines if line.get_marker() == "o"]
        assert len({line.get_markeredgecolor() for line in ends}) == (count if names else 1)
        assert (max(line.get_markersize() for line in ends) > 6) == bool(names)


def test_points_with_links_are_drawn_to_scale_even_if_they_form_a_strip() -> None:
    places = {"left": (0, 0), "right": (a * 0 + 40, b)}
    for links, aspect in (([("left", "right")], 1.0), ([], "auto")):
        statement = declare(
            kinetic=m * (a.dot**2 + b.dot**2) / 2, positions=places, links=links, parameters={m: 1}, name="s"
        )
        t = np.linspace(0.0, 6.0, 9)
        run = solved(statement, t, lambda t: np.array([np.sin(t), np.cos(t), np.cos(t), -np.sin(t)]))
        assert run.plot("path").axes[0].get_aspect() == aspect


@pytest.mark.parametrize("size", [1.0, 3.0, 7.0, 9.9])
def test_every_axis_of_space_has_numbers(size: float) -> None:
    box = Box(np.array([-1.0, -1.0, 0.04 * size]), np.array([1.0, 1.0, 0.1 * size]))
    for k in range(3):
        ticks = box.ticks(k)
        assert len(ticks) >= 3 and ((ticks >= box.low[k]) & (ticks <= box.high[k])).all()
