"""Files of animations (HTML, GIF, MP4) are written completely or not at all."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

from lagrange.errors import RunError
from lagrange.page.document import hash_of, short
from lagrange.show.animation import film, gif
from lagrange.show.animation.recording import thinned
from tests.page.browser import Browser, program
from tests.refusals import refusal
from tests.show.animations import bouncing, double_pendulum, in_page, in_pixels, unpacked
from tests.show.examples import oscillator

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
    made = double_pendulum((0.0, 1.0)).animate(tmp_path / "a.gif", fps=24, size=(320, 300))
    durations = []
    for number, (duration, seen) in enumerate(frames_of(tmp_path / "a.gif")):
        durations.append(duration)
        frame = made.frame(number)[:, :, :3].astype(int)
        assert np.abs(seen - frame).mean() < 1.0 and (seen[0, 0] == WHITE).all(), number
        x, y = in_pixels(made)[0, :, number].astype(int)
        assert near(seen[y, x], BLUE)
    assert len(durations) == len(made.t) == 25 and b"NETSCAPE2.0" in (tmp_path / "a.gif").read_bytes()
    assert {*durations} == {40, 50} and sum(durations[:-1]) == 1000, "hundredths of a second that add up"


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
    with Browser() as opened:
        yield opened


CLOCK = "document.querySelector('#seek').getAttribute('aria-valuetext')"


def test_keys_and_controls_of_the_player(browser: Browser, tmp_path: Path) -> None:
    made = double_pendulum().animate(tmp_path / "a.html")
    with browser.open(tmp_path / "a.html") as tab:
        tab.press(" ", "Space")
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
        tab.press(" ", "Space")
        tab.wait("document.querySelector('#play').textContent === 'Play'")
        assert tab.text("#time") == "1.00", "without repetition it stops at the end"
        assert tab.complaints() == []


def test_the_player_pauses_out_of_sight_and_repeats(browser: Browser, tmp_path: Path) -> None:
    page = double_pendulum().animate().to_html()
    (tmp_path / "a.html").write_text(page)
    with browser.open(tmp_path / "a.html") as tab:
        tab.wait("(window.most = Math.max(window.most ?? 0, lagrange.state().t)) > lagrange.state().t + 0.5")
        assert tab.text("#play") == "Pause"
        tab.value("document.querySelector('main').style.display = 'none'")
        later = "new Promise((done) => setTimeout(() => requestAnimationFrame(done), 50))"
        tab.wait(f"(async () => {{ const t = lagrange.state().t; await {later}; return t === lagrange.state().t; }})()")


def test_no_state_is_interpolated_across_a_reset(browser: Browser, tmp_path: Path) -> None:
    run = bouncing()
    recording = thinned(run.animate(tmp_path / "a.html").recording)
    jump = int(recording.jumps[0])
    with browser.open(tmp_path / "a.html") as tab:
        for k, share in ((jump, 0.0), (jump - 1, 0.5)):
            t = float(recording.t[k] + recording.t[k + 1]) / 2
            tab.value(f"lagrange.seek({t!r})")
            here, beyond = recording.states[:, k], recording.states[:, k + 1]
            assert tab.value("lagrange.state()")["y"] == pytest.approx(here + share * (beyond - here), abs=2e-3)
