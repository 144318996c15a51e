"""Animations: frames, drawn objects, refusals, and files that are written completely or not at all."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence
from playwright.sync_api import Browser

import lagrange as lg
from lagrange.errors import RunError
from lagrange.page.document import hash_of, short
from lagrange.page.player import LEVELS
from lagrange.show.animation import film, gif
from lagrange.show.animation.film import MovingScene
from lagrange.show.animation.recording import MOST_FRAMES, thinned
from lagrange.statement.declare import declare
from lagrange.trajectory.trajectory import Status
from tests.models import shared_scene
from tests.page.browser import opened, program, started
from tests.refusals import refusal
from tests.show.examples import (
    bouncing,
    double_pendulum,
    free,
    in_page,
    in_pixels,
    k,
    m,
    moving,
    oscillator,
    solved,
    texts,
    unpacked,
    x,
)

NO_POSITIONS = "No positions are stated: the coordinates are drawn over time. positions={...} states points to draw."


def scene_of(animation: Any) -> MovingScene:
    scene = animation.film.scene
    assert isinstance(scene, MovingScene)
    return scene


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "name", ["double-pendulum", "four-bar", pytest.param("sun-earth-moon", marks=pytest.mark.slow)]
)
def test_each_frame_is_the_state_at_its_time(name: str) -> None:
    solution = shared_scene(name).run(1e6 if name == "sun-earth-moon" else 3.0)
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
    for (column, row), colour in zip(seen[:2, :, 12].astype(int), scene_of(animation).colours, strict=True):
        assert "#" + "".join(f"{part:02x}" for part in frame[row, column, :3]) == colour


def test_a_recording_has_the_states_of_the_run_and_no_model() -> None:
    animation = shared_scene("double-pendulum").run(3.0).animate()
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
    film = shared_scene("double-pendulum").run(3.0).animate().film
    kinetic, potential, total = film.panels[0].rows
    assert film.panels[0].title == "energies, V and E above the least V" and potential.min() == 0.0
    np.testing.assert_allclose(total, kinetic + potential, atol=1e-12)


def test_round_off_of_an_energy_is_a_level_line() -> None:
    statement = declare(
        lagrangian=m * x.dot**2 / 2 - k * x**2 / 2 + 2, parameters={m: 1, k: 4}, positions={"p": (x, 0)}
    )
    times = np.linspace(0.0, 2.0, 9)
    animation = solved(statement, times, lambda t: np.array([np.cos(2 * t), -2 * np.sin(2 * t)])).animate()
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
    places = {f"p{k}": (k, lg.coordinate(f"x{k}")) for k in range(1, 13)}
    animation = free(12, positions=places).animate()
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
    assert "there is nothing to animate: the run ended before the first" in refusal(lambda: oscillator([]).animate())
    statement = oscillator().model.statement
    lost = solved(statement, np.array([0.0, 1.0]), lambda t: np.full((2, len(t)), np.nan), Status.NON_FINITE)
    assert "the run has a state that is not a finite number, which cannot be drawn" in refusal(lost.animate)
    assert "p has no finite position at t = 0, so that i" in refusal(lambda: moving(lambda a, b: 1 / a, 0.0).animate())
    assert "the number of the frame = 99: give a whole numbe" in refusal(lambda: double_pendulum().animate().frame(99))


# --- files of animations (HTML, GIF, MP4) are written completely or not at all ---------------------------------


WHITE, BLUE = (255, 255, 255), (0x0B, 0x6E, 0x99)


def left_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def near(colour: Any, expected: tuple[int, int, int]) -> bool:
    return bool(np.abs(np.array(colour, dtype=int)[:3] - expected).max() <= 12)


@pytest.mark.parametrize("name", ["a.html", "b.GIF", "c.png", "d.mp4"])
def test_the_ending_of_the_name_says_what_is_written(name: str, tmp_path: Path) -> None:
    if name.endswith("mp4") and not gif.has_ffmpeg():
        pytest.skip("ffmpeg is not installed")
    made = double_pendulum((0.0, 0.2)).animate(tmp_path / name, speed=1, size=(200, 241))
    assert made.path == tmp_path / name and left_in(tmp_path) == [name] and f"written to {made.path}" in repr(made)
    start = {"html": b"<!doctype html>", "GIF": b"GIF89a", "png": b"\x89PNG", "mp4": b"\x00\x00\x00"}
    assert (tmp_path / name).read_bytes().startswith(start[name[2:]])


def frames_of(path: Path) -> list[tuple[int, Any]]:
    """Return the duration in milliseconds and the pixels (height, width, 3) of each frame of a GIF."""
    with Image.open(path) as image:
        return [
            (item.info["duration"], np.asarray(item.convert("RGB"), dtype=int))
            for item in ImageSequence.Iterator(image)
        ]


def test_frames_of_a_gif_are_the_frames_drawn(tmp_path: Path) -> None:
    made = double_pendulum((0.0, 0.5)).animate(tmp_path / "a.gif", speed=1, fps=24, size=(320, 300))
    durations = []
    for number, (duration, seen) in enumerate(frames_of(tmp_path / "a.gif")):
        durations.append(duration)
        frame = made.frame(number)[:, :, :3].astype(int)
        assert np.abs(seen - frame).mean() < 1.0 and (seen[0, 0] == WHITE).all(), number
        x, y = in_pixels(made)[0, :, number].astype(int)
        assert near(seen[y, x], BLUE)
    assert len(durations) == len(made.t) == 13 and b"NETSCAPE2.0" in (tmp_path / "a.gif").read_bytes()
    assert {*durations} == {40, 50} and sum(durations[:-1]) == 500, "hundredths of a second that add up"


def test_a_gif_has_no_frames_that_browsers_slow_down(tmp_path: Path) -> None:
    double_pendulum((0.0, 0.5)).animate(tmp_path / "a.gif", fps=60, speed=1, size=(200, 240))
    durations = [duration for duration, _ in frames_of(tmp_path / "a.gif")]
    assert len(durations) == 16 and min(durations) >= 20


def test_an_mp4_lasts_as_long(tmp_path: Path) -> None:
    if not shutil.which("ffprobe"):
        pytest.skip("ffprobe is not installed")
    made = double_pendulum((0.0, 1.0)).animate(tmp_path / "a.mp4", speed=2.0, size=(201, 241))
    asked = ("-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames,width,height", "-of", "csv=p=0")
    said = subprocess.run(["ffprobe", *asked, str(made.path)], capture_output=True, text=True, check=True, timeout=600)
    assert said.stdout.strip() == f"202,242,{len(made.t)}"


def test_without_ffmpeg_a_page_is_written_and_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    note = "ffmpeg is not installed, which a.mp4 needs: a.html is written instead, with a player."
    with pytest.warns(UserWarning, match=note):
        made = oscillator().animate(tmp_path / "a.mp4")
    assert made.path == tmp_path / "a.html" and left_in(tmp_path) == ["a.html"] and note in made.notes
    assert refusal(oscillator().animate, tmp_path / "a.mp4") == (
        f"{tmp_path / 'a.mp4'} needs the program ffmpeg, which is not installed. The page {tmp_path / 'a.html'} "
        "would be written instead, but this file exists already: name a file that ends in .html or .gif."
    )


def test_what_ffmpeg_refuses_is_said_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "broken"
    program.write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(gif, "PROGRAM", str(program))
    with pytest.raises(RunError) as refusal:
        double_pendulum().animate(tmp_path / "a.mp4", size=(200, 240))
    assert str(refusal.value) == (
        "ffmpeg made no MP4 (Unknown encoder libx264). Nothing was written; name a file that ends in .gif or .html."
    )
    assert left_in(tmp_path) == ["broken"]


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_an_interruption_leaves_what_was_there(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if suffix == "mp4" and not gif.has_ffmpeg():
        pytest.skip("ffmpeg is not installed")
    target = tmp_path / f"a.{suffix}"
    target.write_text("old")
    whole = film.Film.frame

    def interrupted(self: film.Film, number: int) -> film.Pixels:
        if number == 7:
            raise KeyboardInterrupt
        return whole(self, number)

    monkeypatch.setattr(film.Film, "frame", interrupted)
    with pytest.raises(KeyboardInterrupt):
        double_pendulum().animate(target, size=(200, 240))
    assert target.read_text() == "old" and left_in(tmp_path) == [target.name]


def test_a_player_needs_nothing_and_runs_its_own_scripts_alone() -> None:
    name = "</script><script>alert(1)</script><!--"
    made = double_pendulum(name=name).animate()
    page, shown = made.to_html(), made._repr_html_()
    assert page.count("</script>") == 3 and page.count("<script>") == 1 and "<!--" not in page
    assert "http:" not in page and "https:" not in page and "src=" not in page and in_page(page)["name"] == name
    policy = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)[0]
    loader = re.findall("<script>(.*?)</script>", page, re.DOTALL)[0]
    style, scripts = unpacked(page)
    assert policy.split("; ") == [
        "default-src 'none'",
        f"script-src {hash_of(loader)} {hash_of(scripts)}",
        f"style-src {hash_of(style)}",
        "base-uri 'none'",
        "form-action 'none'",
    ]
    assert shown.startswith("<iframe ") and 'sandbox="allow-scripts"' in shown and shown.count('"') == 8
    assert "prefers-reduced-motion" in scripts and "<noscript>" in page


def test_scripts_are_short_and_the_same() -> None:
    code = "// a\nlet x = 1; // kept\n    /** b */\n/**\n * c\n */\n  y = '/* d */';\n"
    assert short(code) == "let x = 1; // kept\ny = '';"


def test_a_player_too_large_for_a_notebook_is_a_picture_and_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    made = double_pendulum().animate()
    size = len(made.to_html())
    monkeypatch.setattr("lagrange.page.player.LARGEST_SHOWN", size - 1)
    shown = made._repr_html_()
    assert shown.startswith('<img alt="double" src="data:image/png;base64,iVBOR')
    said = f"The player has {size // 1000} kB, too much for a notebook: .save(&#x27;double.html&#x27;) writes it."
    assert said in shown


def test_colours_follow_the_reader_or_the_style() -> None:
    auto, light, dark = (double_pendulum().animate(style=style) for style in ("auto", "light", "dark"))
    assert '<html lang="en">' in auto.to_html()
    assert '<html lang="en" data-style="light">' in light.to_html()
    assert '<html lang="en" data-style="dark">' in dark.to_html()
    assert (light.frame(0)[0, 0, :3] == 255).all() and near(dark.frame(0)[0, 0], (0x16, 0x19, 0x1D))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if program() is None:
        pytest.skip("there is no Chromium on this machine")
    with started() as made:
        yield made


CLOCK = "document.querySelector('#seek').getAttribute('aria-valuetext')"


def test_keys_and_controls_of_the_player(browser: Browser, tmp_path: Path) -> None:
    made = double_pendulum().animate(tmp_path / "a.html")
    with opened(browser, tmp_path / "a.html") as tab:
        tab.press("Space")
        assert tab.text("#play") == "Play"
        for key, clock in [("Home", "0.00"), ("ArrowRight", "0.03"), ("End", "1.00"), ("ArrowLeft", "0.97")]:
            tab.press(key)
            assert tab.text("#time") == clock == tab.value(CLOCK)
        tab.press("PageUp")
        assert tab.text("#time") == "0.00"
        tab.type("#seek", 15, "input")
        assert tab.text("#time") == "0.50" and tab.text("#play") == "Play"
        state = tab.value("lagrange.state()")
        assert state["y"] == pytest.approx(made.states[:, 15], abs=2e-4)
        tab.press("+")
        assert tab.text("#speed-value") == "× 2"
        tab.press("l")
        assert tab.value("document.querySelector('#loop').ariaPressed") == "false"
        tab.press("Space")
        tab.wait("document.querySelector('#play').textContent === 'Play'")
        assert tab.text("#time") == "1.00", "without repetition it stops at the end"
        assert tab.complaints == []


def test_the_player_pauses_out_of_sight_and_repeats(browser: Browser, tmp_path: Path) -> None:
    page = double_pendulum().animate().to_html()
    (tmp_path / "a.html").write_text(page)
    with opened(browser, tmp_path / "a.html") as tab:
        tab.wait("(window.most = Math.max(window.most ?? 0, lagrange.state().t)) > lagrange.state().t + 0.5")
        assert tab.text("#play") == "Pause"
        tab.value("document.querySelector('main').style.display = 'none'")
        later = "new Promise((done) => setTimeout(() => requestAnimationFrame(done), 50))"
        tab.wait(f"(async () => {{ const t = lagrange.state().t; await {later}; return t === lagrange.state().t; }})()")


def test_no_state_is_interpolated_across_a_reset(browser: Browser, tmp_path: Path) -> None:
    run = bouncing()
    recording = thinned(run.animate(tmp_path / "a.html").recording)
    jump = int(recording.jumps[0])
    with opened(browser, tmp_path / "a.html") as tab:
        for k, share in ((jump, 0.0), (jump - 1, 0.5)):
            t = float(recording.t[k] + recording.t[k + 1]) / 2
            tab.value(f"lagrange.seek({t!r})")
            here, beyond = recording.states[:, k], recording.states[:, k + 1]
            assert tab.value("lagrange.state()")["y"] == pytest.approx(here + share * (beyond - here), abs=2e-3)
