"""Polylines are within a pixel of the curve that they draw, for known functions and for runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lagrange.show.figures.curve import Pixels, first_times, in_plane, over_time
from lagrange.trajectory.trajectory import FloatArray
from tests.show.examples import oscillator
from tests.show.polylines import farthest

PIXELS = Pixels(700.0, 300.0)


def off(values: Callable[[FloatArray], FloatArray], start: FloatArray, exact: FloatArray) -> float:
    """Return the distance in pixels of the exact values of one row from its drawn line."""
    ((t, row),) = over_time(lambda t: values(t)[None], start, PIXELS)
    shown = values(exact)
    scale = np.array([[PIXELS.width / np.ptp(exact)], [PIXELS.height / np.ptp(shown)]])
    return farthest(scale * [exact, shown], [scale * [t, row]])


@pytest.mark.few(1)
@pytest.mark.parametrize("end", [1.0, -40.0, 1000.0])
def test_swings_and_sharp_turns_are_within_a_pixel(end: float) -> None:
    start = np.linspace(0.0, end, 1 + int(20 * abs(end)))
    exact = np.linspace(0.0, end, 60_000)
    assert off(lambda t: np.sin(2 * np.pi * t), start, exact) < 0.5
    assert off(lambda t: 1 / (1.05 - np.cos(2 * np.pi * t)), start, exact) < 0.5
    assert off(lambda t: np.abs(np.sin(np.pi * t)), start, exact) < 0.5


def test_few_samples_are_enough_of_a_line_and_many_share_columns() -> None:
    start = np.linspace(0.0, 1.0, 50)
    (line,) = over_time(lambda t: 3 * t[None], start, PIXELS)
    assert line.shape[1] < 100
    (dense,) = over_time(lambda t: np.sin(2e4 * t)[None], np.linspace(0.0, 1.0, 50_000), PIXELS)
    assert dense.shape[1] <= 4 * 2 * PIXELS.width + 2
    columns = (PIXELS.width * dense[0]).astype(int)
    for column in (0, 100, 500):
        heights = dense[1][columns == column]
        assert heights.max() > 0.999 and heights.min() < -0.999


@pytest.mark.parametrize("each", [4, 6, 11])
def test_ends_of_oscillations_that_share_a_column_are_drawn_whatever_the_first_samples(each: int) -> None:
    count = 2000
    start = np.linspace(0.0, count, each * count + 1)
    (line,) = over_time(lambda t: (np.cos(np.pi * (t - 0.23)) ** 2)[None], start, PIXELS)
    column = np.minimum((PIXELS.width * line[0] / count).astype(int), 699)
    for end in (np.minimum, np.maximum):
        result = np.full(700, 0.5)
        end.at(result, column, line[1])
        assert PIXELS.height * np.abs(result[1:-1] - (0.0 if end is np.minimum else 1.0)).max() < 0.5


def test_the_end_of_a_swing_to_and_fro_on_one_line_is_drawn() -> None:
    def points(t: FloatArray) -> FloatArray:
        return np.array([[np.cos(t - 0.4), 0.5 * np.cos(t - 0.4)]])

    line = in_plane(points, np.linspace(0.0, 2 * np.pi, 6), PIXELS)[1][0]
    assert PIXELS.width * (2 - np.ptp(line[0])) / 2 < 1.0


def test_a_jump_is_found_to_the_pixel_and_a_level_row_is_left_alone() -> None:
    ((t, row),) = over_time(lambda t: np.where(t < 0.7123, 0.0, 1.0)[None], np.linspace(0.0, 1.0, 20), PIXELS)
    assert len(t) < 400
    pixel = 1 / PIXELS.width
    assert 0.7123 - 0.5 * pixel < t[row == 0][-1] < 0.7123 <= t[row == 1][0] < 0.7123 + 0.5 * pixel
    (level,) = over_time(lambda t: 5.0 + 1e-12 * np.sin(1e9 * t)[None], np.linspace(0.0, 1.0, 20), PIXELS)
    assert level.shape[1] < 40


def test_what_is_not_finite_stays_a_gap() -> None:
    with np.errstate(all="ignore"):
        ((t, row),) = over_time(lambda t: np.log(t - 0.5)[None], np.linspace(0.0, 1.0, 20_000), PIXELS)
    assert np.isnan(row[t < 0.5]).all() and np.isfinite(row[t > 0.5]).all()


def test_first_times_are_the_outputs_and_those_between() -> None:
    run = oscillator(np.linspace(0.0, 5.0, 11)).trajectory
    assert set(run.t) <= set(first_times(run)) and len(first_times(run)) >= 500
    many = oscillator(np.linspace(0.0, 5.0, 600_001)).trajectory
    few = first_times(many)
    assert set(few) <= set(many.t) and (few[0], few[-1]) == (0.0, 5.0) and 2e5 < len(few) < 3e5
    assert len(set(np.diff(np.searchsorted(many.t, few)).tolist())) > 2, "the distances are irregular"
