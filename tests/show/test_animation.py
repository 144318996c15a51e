"""Animations: the content and duration of frames, drawn objects, and all refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.page.player import LEVELS
from lagrange.show.animation.film import MovingScene
from lagrange.show.animation.recording import MOST_FRAMES
from lagrange.trajectory.trajectory import Status
from tests.refusals import refusal
from tests.show.animations import bouncing, double_pendulum, in_page, in_pixels, texts, unpacked
from tests.show.examples import moving, oscillator, solved

NO_POSITIONS = "No positions are stated: the coordinates are drawn over time. positions={...} states points to draw."


def scene_of(animation: Any) -> MovingScene:
    scene = animation.film.scene
    assert isinstance(scene, MovingScene)
    return scene


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["double-pendulum", "four-bar", "sun-earth-moon"])
def test_each_frame_is_the_state_at_its_time(name: str) -> None:
    solution = lg.scene(name).run(1e6 if name == "sun-earth-moon" else 3.0)
    animation = solution.animate()
    np.testing.assert_array_equal(animation.states, solution.at(animation.t))
    assert animation.t[0] == 0.0 and animation.t[-1] == solution.t[-1]
    np.testing.assert_allclose(np.diff(animation.t), animation.timing.speed / animation.timing.fps, rtol=1e-9)


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
    assert animation.timing.seconds == pytest.approx(abs(times[1] - times[0]) / animation.timing.speed, rel=1e-12)
    assert len(animation.t) == frames and animation.timing.fps == pytest.approx(fps, rel=0.05)
    record = in_page(animation.to_html())["record"]
    assert (record["count"] - 1) / record["detail"] / record["fps"] == pytest.approx(
        animation.timing.seconds, rel=1e-12
    )
    assert [record["begin"], record["end"]] == [times[0], times[1]]


@pytest.mark.parametrize(
    ("end", "speed"), [(330.0, 20.0), (0.2, 0.02), (3e7, 1e6), (1e-5, 2e-6), (100.0 - 1 / 30, 1.0)]
)
def test_a_run_that_is_too_long_or_too_short_is_shown_at_a_round_speed_and_says_so(end: float, speed: float) -> None:
    animation = oscillator((0.0, end)).animate()
    assert animation.timing.speed == pytest.approx(speed) and 1.0 <= animation.timing.seconds <= 100.0
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
    width, height = animation.film.size
    assert seen.min() > 0 and (seen.max(axis=(0, 2)) < (width, height)).all()
    frame = animation.frame(12)
    for (x, y), colour in zip(seen[:2, :, 12].astype(int), scene_of(animation).colours, strict=True):
        assert "#" + "".join(f"{part:02x}" for part in frame[y, x, :3]) == colour


def test_a_recording_has_the_states_of_the_run_and_no_model() -> None:
    animation = lg.scene("double-pendulum").run(3.0).animate()
    page = animation.to_html()
    data, detail = in_page(page), in_page(page)["record"]["detail"]
    rows = data["rows"][:, ::detail]
    expected = [*animation.points["bob1"], *animation.points["bob2"], *animation.states]
    for row, exact in zip(rows, expected, strict=False):
        np.testing.assert_allclose(row, exact, atol=0.51 * np.ptp(exact) / LEVELS, rtol=1e-6)
    energies = dict(zip(data["energies"], rows[8:], strict=False))
    np.testing.assert_allclose(energies["T"] + energies["V"], energies["E"], atol=1e-3 * np.ptp(energies["T"]))
    assert rows[8:].min() > -1e-9, "V and E are drawn from the least V"
    assert data["links"] == [[2, 0, "rod"], [0, 1, "rod"]] and data["kept"]
    scripts = unpacked(page)[1]
    assert "class Recording" in scripts and "class Motion" not in scripts and "<math" not in page


def test_curves_are_exact_between_the_frames() -> None:
    data = in_page(oscillator((0.0, 60.0)).animate(speed=10.0).to_html())
    row, fine = data["rows"][0], np.linspace(0, 60, 50_000)
    assert data["record"]["detail"] > 1
    t = np.linspace(0, 60, len(row))
    middle, height = (row.max() + row.min()) / 2, np.ptp(row) / 2
    assert np.abs(np.interp(fine, t, row) - (middle + height * np.cos(2 * fine))).max() < 2e-3 * height


def test_a_recording_says_between_which_samples_a_state_was_reset() -> None:
    run = bouncing()
    recording = run.animate().recording
    bounces = run.t_events[0]
    assert len(recording.jumps) == len(bounces) > 1, "the highest places, which are events too, are no jumps"
    for jump, bounce in zip(recording.jumps, bounces, strict=True):
        assert recording.t[jump] < bounce <= recording.t[jump + 1]
        assert recording.states[1, jump] < 0 < recording.states[1, jump + 1]
    record = in_page(run.animate().to_html())["record"]
    t = np.linspace(0.0, 2.0, record["count"])
    assert all(t[k] < bounce <= t[k + 1] for k, bounce in zip(record["jumps"], bounces, strict=True))


def test_energies_far_apart_are_drawn_above_the_least_potential() -> None:
    film = lg.scene("double-pendulum").run(3.0).animate().film
    kinetic, potential, total = film.panels[0].rows
    assert film.panels[0].title == "energies, V and E above the least V" and potential.min() == 0.0
    np.testing.assert_allclose(total, kinetic + potential, atol=1e-12)


def test_round_off_of_an_energy_is_a_level_line() -> None:
    animation = lg.scene("two-point-vortices").run(2.0).animate()
    animation.frame(0)
    low, high = animation.film._drawn.figure.axes[-1].get_ylim()
    assert np.ptp(animation.film.panels[0].rows) < 1e-6 * (high - low), "its energy is 0, and its terms are not"


def test_without_positions_the_coordinates_move_and_that_is_said() -> None:
    animation = oscillator(np.linspace(0, 3, 7)).animate()
    assert animation.notes == (NO_POSITIONS,) and NO_POSITIONS in animation._repr_html_()
    coordinate, energies = animation.film.panels
    np.testing.assert_allclose(coordinate.rows, animation.recording.states[:1])
    assert len(energies.rows) == 3 and animation.film.scene is None
    assert animation.frame(20).shape == (*animation.film.size[::-1], 4)


def test_space_is_seen_as_in_figures_with_a_shadow_on_the_floor() -> None:
    animation = moving(lambda a, b: a, lambda a, b: b, lambda a, b: a * b).animate()
    (point,) = in_pixels(animation)
    scene, t = animation.film.scene, animation.t
    assert scene is not None and scene.shadows is not None
    assert {"x", "y", "z", "7.5"} <= texts(animation), "the floor and the upright axis have numbers"
    azimuth, elevation = np.radians((-60.0, 25.0))
    across = t * -np.sin(azimuth) + t**2 * np.cos(azimuth)
    scale = np.ptp(point[0]) / np.ptp(across)
    np.testing.assert_allclose(point[0] - point[0, 0], scale * (across - across[0]), atol=1e-6)
    above = scene.seen[0, 1] - scene.shadows[0, 1]
    np.testing.assert_allclose(above, np.cos(elevation) * animation.recording.t**3, atol=1e-12)


def test_trails_last_their_time() -> None:
    assert scene_of(double_pendulum().animate(trail=0)).tail == 0
    animation = double_pendulum((0.0, 5.0)).animate(trail=1.0)
    assert scene_of(animation).tail == 30 * animation.recording.detail
    assert '<option value="1" selected>' in animation.to_html()


def test_many_points_are_alike_and_have_no_legend() -> None:
    xs = lg.coordinates(" ".join(f"x{k}" for k in range(12)))
    places = {f"p{k}": (k, x) for k, x in enumerate(xs)}
    many = lg.System(kinetic=sum(x.dot**2 for x in xs) / 2, positions=places, initial={xs[0].dot: 1.0}).run(1.0)
    animation = many.animate()
    assert len({*scene_of(animation).colours}) == 1 and not {*places} & texts(animation)
    data = in_page(animation.to_html())
    assert {*data["colours"]} == {0} and data["size"] < 0.5 and '<ul class="legend">' not in animation.to_html()
    assert {"first", "second"} <= texts(double_pendulum().animate())


@pytest.mark.parametrize("times", [[2.0], [3.0, 3.0]])
def test_one_state_is_one_frame(times: Any) -> None:
    animation = oscillator(times).animate()
    assert len(animation.t) == 1 and animation.timing.seconds == 0.0
    assert animation.frame(0).any() and in_page(animation.to_html())["record"]["count"] == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fps": 0}, "fps = 0: give a number of frames per second from 1 to 60; screens show no more."),
        ({"speed": 0}, "speed = 0: give a positive number; 1 is real time, 2 twice as fast."),
        (
            {"speed": 1e300},
            "speed = 1e+300 shows the run in 1e-300 s, shorter than one frame: give a speed of 30 or less.",
        ),
        ({"size": 640}, "size = 640: give width and height in pixels, such as size=(640, 480)."),
        ({"size": (640, 90_000)}, "a side of size = 90000: give a whole number from 160 to 2160."),
        ({"size": (2000, 200)}, "size = (2000, 200) leaves no room for the motion: give a height of 832 or more."),
        ({"trail": -1}, "trail = -1: give the time that trails go back, or 0 for none."),
        ({"style": "drak"}, "style = 'drak': give one of auto, light and dark. Did you mean 'dark'?"),
        ({"path": 3}, "the path is 3 (int): give the path of a file."),
        (
            {"path": "run.avi"},
            "the name 'run.avi' has no known suffix: give one that ends in .html for a page with a player, "
            ".gif or .mp4 for a picture that moves, .png for the first frame.",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(options: Any, message: str) -> None:
    assert refusal(double_pendulum().animate, **options) == message


def test_nothing_to_animate() -> None:
    with pytest.raises(StatementError, match="there is nothing to animate: the run ended before the first"):
        oscillator([]).animate()
    statement = oscillator().model.statement
    lost = solved(statement, np.array([0.0, 1.0]), lambda t: np.full((2, len(t)), np.nan), Status.NON_FINITE)
    with pytest.raises(StatementError, match="the run has a state that is not a finite number, which cannot be drawn"):
        lost.animate()
    with pytest.raises(StatementError, match="p has no finite position at t = 0, so that it cannot be drawn"):
        moving(lambda a, b: 1 / a, 0.0).animate()
    with pytest.raises(StatementError, match="the number of the frame = 99: give a whole number from 0 to 30"):
        double_pendulum().animate().frame(99)
