"""The commands that write a run as a picture, still or moving."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from lagrange.cli.program import main
from lagrange.show.figures.run_figure import WHAT
from tests.drop import DROP, Captured, Patch, data, printed, refused, written


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: Patch) -> str:
    monkeypatch.chdir(tmp_path)
    return os.path.relpath(written(tmp_path, DROP))


def test_a_scene_without_positions_says_that_its_coordinates_are_drawn(
    scene: str, tmp_path: Path, capsys: Captured
) -> None:
    path = written(tmp_path, DROP.replace('positions = { stone = ["0", "y"] }\n', ""))
    assert "\nNo positions are stated: the coordinates are drawn over time." in printed(capsys, "animate", path)


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml"), ("a.pdf", b"%PDF")])
def test_plot_writes_a_picture(name: str, start: bytes, scene: str, capsys: Captured) -> None:
    said = printed(capsys, "plot", scene, "--out", name, "--t-end", "0.5", "--set", "g=3")
    assert said == f"written to {Path(name).resolve()}\n"
    assert Path(name).read_bytes().startswith(start)


def test_plot_shows_what_is_asked_for(scene: str, capsys: Captured) -> None:
    options = ("--out", "a.svg", "--what", "phase, energies", "--style", "dark")
    assert "written to" in printed(capsys, "plot", scene, *options)
    text = Path("a.svg").read_text("utf-8").lower()
    assert "#16191d" in text and text.count('id="axes_') == 2
    assert "what = 'phases' is not a quantity to plot" in refused(capsys, "plot", scene, "--what", "phases")


def test_help_names_all_that_a_picture_shows(capsys: Captured) -> None:
    text = " ".join(printed(capsys, "plot", "--help").split())
    assert f"names with commas: {', '.join(WHAT)}, or a coordinate" in text


def test_without_a_name_the_picture_has_that_of_the_scene(scene: str, capsys: Captured) -> None:
    assert main(["plot", scene, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "file": str(Path("drop.png").resolve()),
        "status": "success",
        "message": "taylor reached t = 2.",
    }
    assert printed(capsys, "animate", scene) == (
        f"animation of drop: 61 frames, 2 s in real time, t = 0 to 2\nwritten to {Path('drop.html').resolve()}\n"
    )


def test_options_of_an_animation_reach_it(capsys: Captured, tmp_path: Path) -> None:
    out = tmp_path / "a.gif"
    options = ("--speed", "2", "--fps", "10", "--size", "200x240", "--style", "dark", "--trail", "0", "--t-end", "1")
    made = data(capsys, "animate", "pendulum", "--out", str(out), *options)
    assert (made["frames"], made["seconds"], made["speed"], made["notes"]) == (6, 0.5, 2.0, [])
    assert made["file"] == str(out) and out.read_bytes()[6:10] == bytes((200, 0, 240, 0))


def test_too_many_frames_and_a_missing_ffmpeg_are_said(scene: str, capsys: Captured, monkeypatch: Patch) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    said = printed(capsys, "animate", scene, "--out", "a.mp4", "--speed", "1e-3")
    assert "The first 3,000 of 60,001 frames are shown, to t = 0.0999667: more are too many." in said
    assert "ffmpeg is not installed, which a.mp4 needs: a.html is written instead, with a player." in said
    assert Path("a.html").exists() and not Path("a.mp4").exists()


def test_a_run_that_ends_early_is_drawn_and_fails(tmp_path: Path, capsys: Captured) -> None:
    blow_up = DROP.replace('"m*g*y"', '"-m*y**4/4"').replace("y = 5.0", "y = 1.0").replace("g = 10.0\n", "")
    path = written(tmp_path, blow_up)
    for command, name in (("plot", "a.png"), ("animate", "a.html")):
        said = printed(capsys, command, path, "--t-end", "50", "--out", str(tmp_path / name), code=1)
        assert not said.startswith(("written", "animation")) and f"written to {tmp_path / name}" in said
        assert (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plot", "--out", "a.bmp"], "--out a.bmp: name a file that ends in .png, .svg or .pdf."),
        (["plot", "--out", ""], "--out: the name of the file is empty. Give one, such as --out run.png."),
        (["animate", "--out", ""], "--out: the name of the file is empty. Give one, such as --out run.html."),
        (
            ["animate", "--size", "640"],
            "--size: '640' is not a size. Write width and height in pixels, such as 640x480.",
        ),
        (["animate", "--speed", "-1"], "speed = -1: give a positive number; 1 is real time, 2 twice as fast."),
        (["animate", "--trail", "long"], "--trail: 'long' is not a number. Write one such as 2, 1e-3, 30deg or pi/6."),
        (
            ["plot", "--set", "M=1"],
            "'M' is not a parameter of this system; its parameters are m and g. Did you mean 'm'?",
        ),
    ],
)
def test_wrong_requests(arguments: list[str], message: str, scene: str, capsys: Captured, tmp_path: Path) -> None:
    command, *options = arguments
    before = sorted(path.name for path in tmp_path.iterdir())
    assert refused(capsys, command, scene, *options) == message
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_file_that_cannot_be_written_is_refused_before_the_run(
    scene: str, capsys: Captured, monkeypatch: Patch
) -> None:
    monkeypatch.setattr("lagrange.cli.writing.load_scene", None)
    for command, name in (("plot", "nowhere/a.png"), ("animate", "nowhere/a.gif")):
        folder = Path(name).resolve().parent
        assert refused(capsys, command, scene, "--out", name) == (
            f"Cannot write {folder / Path(name).name}: there is no folder {folder}. Make this folder, or name another."
        )
