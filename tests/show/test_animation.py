"""Animations: what is at each frame, how long it lasts, what is drawn, and every refusal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sympy import Float

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.show.animation.timing import MOST_FRAMES
from lagrange.show.figures.space import spring
from lagrange.statement.coordinate import coordinates
from lagrange.statement.declare import declare
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status
from tests.show.animations import double_pendulum, in_page, in_pixels
from tests.show.examples import free, oscillator, solved

NO_POSITIONS = "No positions are stated: the coordinates are drawn over time. positions={...} states points to draw."


@pytest.mark.parametrize("name", ["double-pendulum", "four-bar", "sun-earth-moon"])
def test_each_frame_is_the_state_at_its_time(name: str) -> None:
    solution = lg.scene(name).run(1e6 if name == "sun-earth-moon" else 3.0)
    animation = solution.animate()
    np.testing.assert_array_equal(animation.states, solution.at(animation.t))
    assert animation.t[0] == 0.0 and animation.t[-1] == solution.t[-1]
    np.testing.assert_allclose(np.diff(animation.t), animation.speed / animation.fps, rtol=1e-9)


@pytest.mark.parametrize(
    ("times", "speed", "fps", "frames"),
    [
        ((0.0, 2.0), 1.0, 30.0, 61),
        ((1.0, -1.0), 0.5, 24.0, 97),
        ((0.0, 1.0), 3.0, 25.0, 9),
        ((0.0, 7.3), None, 30.0, 220),
    ],
)
def test_the_motion_lasts_its_time_over_the_speed(times: Any, speed: Any, fps: float, frames: int) -> None:
    animation = oscillator(times).animate(speed=speed, fps=fps)
    assert animation.seconds == pytest.approx(abs(times[1] - times[0]) / animation.speed, rel=1e-12)
    assert len(animation.t) == frames and animation.fps == pytest.approx(fps, rel=0.05)
    page = in_page(animation.to_html())
    assert page["interval"] * (page["frames"] - 1) == pytest.approx(animation.seconds, rel=1e-12)
    assert page["span"] == [times[0], times[1]]


@pytest.mark.parametrize(
    ("end", "speed"), [(330.0, 20.0), (0.2, 0.02), (3e7, 1e6), (1e-5, 2e-6), (100.0 - 1 / 30, 1.0)]
)
def test_a_run_that_is_too_long_or_too_short_is_shown_at_a_round_speed_and_says_so(end: float, speed: float) -> None:
    animation = oscillator((0.0, end)).animate()
    assert animation.speed == pytest.approx(speed) and 1.0 <= animation.seconds <= 100.0
    said = f"The run lasts {end:.6g} units of time: {speed:g} unit" in repr(animation)
    assert said == (speed > 1) or "of a unit are shown in a second. speed = 1 is real time." in repr(animation)


def test_too_many_frames_are_cut_off_and_that_is_said() -> None:
    animation = oscillator((0.0, 1000.0)).animate(speed=3.0)
    assert len(animation.t) == MOST_FRAMES and animation.t[-1] == pytest.approx(0.1 * (MOST_FRAMES - 1))
    np.testing.assert_allclose(np.diff(animation.t), 0.1)
    note = (
        "The first 3,000 of 10,001 frames are shown, to t = 299.9: more are too many. speed = 20 shows the whole run."
    )
    assert note in animation.notes and note in repr(animation) and note in animation.to_html()
    assert len(oscillator((0.0, 1000.0)).animate(speed=20.0).t) == 1501
    assert "The first 3,000 of 3e+303 frames" in repr(oscillator((0.0, 1.0)).animate(speed=1e-302))


def test_points_are_drawn_where_they_are_to_scale() -> None:
    animation = double_pendulum().animate()
    seen = in_pixels(animation)
    names = [*animation.points]
    assert names == ["first", "second", "origin"]
    np.testing.assert_allclose(animation.points["first"], [np.sin(animation.t), -np.cos(animation.t)], atol=1e-12)
    lengths = np.hypot(*(seen[0] - seen[2]))
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-9)
    places = np.stack([animation.points[name] for name in names])
    places[:, 1] *= -1  # y grows downwards in pixels
    np.testing.assert_allclose(seen - seen[2], (places - places[2]) * lengths[0], atol=1e-9)
    width, height = animation.sheet.size
    assert seen.min() > 0 and (seen.max(axis=(0, 2)) < (width, height)).all()
    assert [joint.kind for joint in animation.sheet.joints] == ["rod", "spring"]


def test_the_page_has_the_same_pixels_and_the_shape_of_a_spring() -> None:
    animation = double_pendulum().animate()
    page = in_page(animation.to_html())
    tracks = animation.sheet.tracks.reshape(6, -1)
    np.testing.assert_allclose(page["rows"][:6], tracks, atol=0.6 * page["grain"])
    assert page["grain"] < 0.03, "a thirtieth of a pixel"
    assert page["joints"] == [[2, 0, False], [0, 1, True]]
    corners = np.array(page["spring"]).reshape(-1, 2).T
    np.testing.assert_allclose(corners, spring(np.zeros(2), np.array([1.0, 0.0]), 1.0), atol=1e-4)


def test_energies_are_drawn_over_time() -> None:
    animation = double_pendulum(np.linspace(0, 1, 5)).animate()
    (chart,) = animation.sheet.charts
    words = [text.text for text in animation.sheet.words]
    assert {"energy:", "kinetic", "potential"} <= {*words}
    kinetic, potential, total = -chart.rows
    t = np.linspace(0, 1, len(kinetic))
    unit = (potential[-1] - potential[0]) / (3 - 3 * np.cos(1) + 1 - np.cos(2))
    np.testing.assert_allclose(potential, potential[0] + unit * (4 - 3 * np.cos(t) - np.cos(2 * t)), atol=1e-6)
    np.testing.assert_allclose(np.ptp(kinetic), 0.0, atol=1e-9)
    np.testing.assert_allclose(total - potential, kinetic[0] - (potential[0] + unit * 4), atol=1e-6)


def test_energies_far_apart_are_drawn_above_the_least_potential() -> None:
    sheet = lg.scene("double-pendulum").run(3.0).animate().sheet
    assert "energy above the least potential:" in [text.text for text in sheet.words]
    kinetic, potential, total = sheet.charts[0].rows
    bottom = kinetic.max()  # where the kinetic energy is 0, in pixels from above
    assert potential.max() == pytest.approx(bottom, abs=0.2)
    np.testing.assert_allclose(bottom - total, (bottom - kinetic) + (bottom - potential), atol=0.2)


def test_round_off_of_an_energy_is_a_level_line() -> None:
    rows = lg.scene("two-point-vortices").run(2.0).animate().sheet.charts[0].rows
    assert np.ptp(rows) < 1e-6, "its energy is 0, and the terms of it are not"


def test_a_heading_without_room_leaves_the_names() -> None:
    words = [text.text for text in lg.scene("elastic-pendulum").run(2.0).animate().sheet.words]
    assert {"kinetic", "potential", "total"} <= {*words} and not [word for word in words if "energy" in word]


def test_an_energy_that_is_not_the_sum_is_not_called_total() -> None:
    words = [text.text for text in lg.scene("bead-on-hoop").run(1.0).animate().sheet.words]
    assert "v·p − L, which is not their sum" in words and "total" not in words


def test_without_positions_the_coordinates_move_and_that_is_said() -> None:
    animation = oscillator(np.linspace(0, 3, 7)).animate()
    assert animation.notes == (NO_POSITIONS,) and NO_POSITIONS in animation._repr_html_()
    coordinate, energies = animation.sheet.charts
    t = np.linspace(0, 3, coordinate.rows.shape[1])
    height = np.ptp(coordinate.rows) / 2
    np.testing.assert_allclose(coordinate.rows[0] - coordinate.rows[0, 0], height * (1 - np.cos(2 * t)), atol=0.05)
    assert len(energies.rows) == 3 and len(animation.sheet.tracks) == 0
    assert animation.frame(20).shape == (*animation.sheet.size[::-1], 4)


def test_curves_are_off_by_less_than_a_pixel_between_their_samples() -> None:
    fast = oscillator((0.0, 60.0)).animate(speed=10.0)
    assert fast.sheet.detail > 1
    row = fast.sheet.charts[0].rows[0]
    t = np.linspace(0, 60, len(row))
    fine = np.linspace(0, 60, 50_000)
    middle, height = (row.max() + row.min()) / 2, np.ptp(row) / 2
    assert np.abs(np.interp(fine, t, row) - (middle - height * np.cos(2 * fine))).max() < 1.0


def moving(*parts: Any, **more: Any) -> Solution:
    a, b = coordinates("a b")
    places = [part(a, b) if callable(part) else Float(part) for part in parts]
    statement = declare(kinetic=a.dot**2 + b.dot**2, positions={"p": places}, name="s", **more)
    return solved(statement, np.linspace(0, 2, 9), lambda t: np.array([t, t**2, np.ones_like(t), 2 * t]))


def test_space_is_seen_as_in_figures_with_a_shadow_on_the_floor() -> None:
    animation = moving(lambda a, b: a, lambda a, b: b, lambda a, b: a * b).animate()
    point, shadow = in_pixels(animation)
    assert animation.sheet.shadows == ((0, 1),)
    words = {text.text for text in animation.sheet.words}
    assert {"x", "y", "z", "7.5"} <= words, "the floor and the upright axis have numbers"
    t = animation.t
    azimuth, elevation = np.radians((-60.0, 25.0))
    across = t * -np.sin(azimuth) + t**2 * np.cos(azimuth)
    scale = np.ptp(point[0]) / np.ptp(across)
    np.testing.assert_allclose(point[0] - point[0, 0], scale * (across - across[0]), atol=1e-6)
    np.testing.assert_allclose(shadow[1] - point[1], scale * t**3 * np.cos(elevation), atol=1e-6)
    np.testing.assert_allclose(shadow[0], point[0])


def test_a_plane_in_space_is_seen_from_above() -> None:
    animation = moving(lambda a, b: a, 0.0, lambda a, b: b).animate()
    assert {"x", "z"} <= {text.text for text in animation.sheet.words} and animation.sheet.shadows == ()


def test_trails_follow_curves_and_not_straight_lines() -> None:
    assert len(double_pendulum().animate().sheet.trails) == 2
    assert double_pendulum().animate(trail=0).sheet.trails == ()
    assert moving(lambda a, b: a, 0.0).animate().sheet.trails == ()
    sheet = double_pendulum((0.0, 5.0)).animate(trail=1.0).sheet
    assert sheet.tail == 30 * sheet.detail


@pytest.mark.parametrize("count", [7, 60])
def test_many_coordinates_share_panels(count: int) -> None:
    sheet = free(count).animate().sheet
    assert len(sheet.charts) <= 7 and sum(len(chart.rows) for chart in sheet.charts[:-1]) == count
    assert max(colour for chart in sheet.charts for colour in chart.colours) < 7 + sheet.lines


@pytest.mark.parametrize("times", [[2.0], [3.0, 3.0]])
def test_one_state_is_one_frame(times: Any) -> None:
    animation = oscillator(times).animate()
    assert len(animation.t) == 1 and animation.seconds == 0.0
    assert animation.frame(0).any() and in_page(animation.to_html())["frames"] == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fps": 0}, "fps = 0: give a number of frames per second from 1 to 60; screens show no more."),
        ({"fps": 1000}, "fps = 1000: give a number of frames per second from 1 to 60; screens show no more."),
        ({"speed": 0}, "speed = 0: give a positive number; 1 is real time, 2 twice as fast."),
        ({"speed": -1.0}, "speed = -1: give a positive number; 1 is real time, 2 twice as fast."),
        ({"speed": 1e300}, "speed = 1e+300 shows the run in 1e-300 s, which is less than a frame: give 30 or less."),
        ({"size": 640}, "size = 640: give width and height in pixels, such as size=(640, 480)."),
        ({"size": (640, 90_000)}, "a side of size = 90000: give a whole number from 160 to 2160."),
        ({"size": (2000, 200)}, "size = (2000, 200) leaves no room for the motion: give a height of 719 or more."),
        ({"trail": -1}, "trail = -1: give the time that trails go back, or 0 for none."),
        ({"style": "drak"}, "style = 'drak': give one of auto, light and dark. Did you mean 'dark'?"),
        ({"path": 3}, "the path is 3 (int): give the path of a file."),
        (
            {"path": "run.avi"},
            "'run.avi' does not say what to write: its name ends in .html for a page with a player, .gif or .mp4 for a "
            "picture that moves, .png for the first frame.",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(options: Any, message: str) -> None:
    with pytest.raises(StatementError) as refusal:
        double_pendulum().animate(**options)
    assert str(refusal.value) == message


def test_nothing_to_animate() -> None:
    with pytest.raises(StatementError, match="there is nothing to animate: the run ended before the first"):
        oscillator([]).animate()
    statement = oscillator().model.statement
    lost = solved(statement, np.array([0.0, 1.0]), lambda t: np.full((2, len(t)), np.nan), Status.NON_FINITE)
    with pytest.raises(StatementError, match="the run has a state that is no finite number, which cannot be drawn"):
        lost.animate()
    with pytest.raises(StatementError, match="p has no finite position at t = 0, so that it cannot be drawn"):
        moving(lambda a, b: 1 / a, 0.0).animate()
    with pytest.raises(StatementError, match="the number of the frame = 99: give a whole number from 0 to 30"):
        double_pendulum().animate().frame(99)
