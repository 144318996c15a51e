"""The commands of the command line beside `lagrange run`: race, ensemble, grade, and pictures."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from lagrange.cli.program import main
from lagrange.members import jobs, store
from lagrange.show.figures.run_figure import WHAT
from tests.drop import DROP, Captured, Patch, data, printed, refused, written
from tests.dynamics.planar import interrupting

VARY = ["--vary", "theta=0.1:2:3", "--vary", "l=0.5:1:2", "--t-end", "1"]


def test_runs_are_counted_and_written(tmp_path: Path, capsys: Captured) -> None:
    said = printed(capsys, "ensemble", "pendulum", *VARY, "--out", str(tmp_path / "map.png"))
    assert said.startswith("pendulum: 6 members (3 x 2), varying theta and l") and "6 success" in said
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    options = ["--set", "g=9", "--method", "rk4", "--step", "0.1"]
    assert data(capsys, "ensemble", "pendulum", *VARY, *options)["shape"] == [3, 2]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("out", "more", "begins"),
    [
        ("a.svg", ["--what", "max:theta_dot", "--keep", "max:theta_dot", "--style", "dark"], b"<?xml"),
        ("a.pdf", ["--points", "20"], b"%PDF"),
        ("a.csv", ["--keep", "end,counts,drift"], b"member,theta,l,t_end,status,theta_end,theta_dot_end,steps"),
    ],
)
def test_every_kind_of_file(out: str, more: list[str], begins: bytes, tmp_path: Path) -> None:
    assert main(["ensemble", "pendulum", *VARY, "--out", str(tmp_path / out), *more]) == 0
    assert (tmp_path / out).read_bytes().startswith(begins)


def test_an_interrupted_store_goes_on(tmp_path: Path, capsys: Captured, monkeypatch: Patch) -> None:
    pytest.importorskip("zarr")
    monkeypatch.setattr(store, "LARGEST_BLOCK", 2)
    monkeypatch.setattr(jobs, "LARGEST_CHUNK", 2)
    monkeypatch.setattr(jobs, "FIRST_CHUNK", 2)
    command = ["ensemble", "pendulum", *VARY, "--workers", "1", "--out", str(tmp_path / "runs.zarr"), "--progress"]
    with monkeypatch.context() as patch:
        patch.setattr(store.StoredResults, "write", interrupting(1)(store.StoredResults.write))
        assert main(command) == 130
    said = capsys.readouterr()
    assert "2 success and 4 interrupted" in said.out and "the same command goes on from here" in said.out
    assert said.err.startswith("2 of 6 members, ") and said.err.endswith(" left\n")
    assert main(command) == 0
    said = capsys.readouterr()
    assert "ended   6 success" in said.out and "2 were stored before" in said.out
    assert said.err.startswith("6 of 6 members, ")


def test_failures_are_an_exit_code(capsys: Captured) -> None:
    assert main(["ensemble", "henon-heiles", "--vary", "x=0:1:3", "--t-end", "15"]) == 1
    assert "step_too_small" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "nothing varies: give --vary NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=1"], "--vary theta=1: write NAME=LOW:HIGH:COUNT"),
        (["--vary", "theta=a:b:3"], "--vary theta: 'a' is not a number"),
        (["--vary", "thet=0:1:3"], "Did you mean 'theta'?"),
        (["--vary", "theta=0:1:0"], "the number of values of theta = 0: give a whole number from 1"),
        (["--vary", "theta=0:1:20000", "--vary", "l=1:2:20000"], "--vary gives 4e+08 members, which run for"),
        (["--vary", "theta=0:1:3", "--keep", "ende"], "Did you mean 'end'?"),
        (["--vary", "theta=0:1:3", "--keep", "max:thet"], "these are theta and theta_dot. Did you mean 'theta'?"),
        (
            ["--vary", "theta=0:1:3", "--out", "a.foo"],
            "--out a.foo: give a name that ends in .png, .svg or .pdf for a picture, in .csv",
        ),
        (["--vary", "theta=0:1:3", "--out", "a.nc"], "A netCDF file is made in Python, by runs.to_xarray()"),
        (
            ["--vary", "theta=0:1:3", "--out", "runs"],
            "or in .zarr for a folder with the results of any number of members.",
        ),
        (["--vary", "theta=0:1:3", "--out", "no/a.csv"], "there is no folder"),
        (
            ["--vary", "theta=0:1:3", "--what", "theta"],
            "--what chooses the quantity of a picture, but no picture is written",
        ),
        (["--vary", "theta=0:1:3", "--out", "a.png", "--what", "thet"], "theta, theta_dot and t_end. Did you mean"),
        (["--vary", "theta=0:1:3", "--out", "a.csv", "--points", "9"], "--points: a table has one line per member"),
        (
            ["--vary", "theta=0:1:3", "--vary", "l=1:2:2", "--vary", "g=9:10:2", "--out", "a.png"],
            "theta, l and g vary, and a picture has two axes",
        ),
        (["--vary", "theta=0:1:3", "--vary", "theta=0:1:3"], "--vary gives theta twice: give it once."),
        (["--vary", "l=1:2:3", "--set", "l=1"], "l has both a range of values, --vary l, and a single value"),
        (["--vary", "l=1:2:3", "--out", "a.png", "--what", "max:theta"], "l, theta, theta_dot and t_end. Add --keep m"),
    ],
)
def test_wrong_requests_are_refused(options: list[str], text: str, capsys: Captured) -> None:
    assert main(["ensemble", "pendulum", *options]) == 2
    assert text in capsys.readouterr().err.replace("\n", " ")


# --- export ---------------------------------------------------------------------------------------------------
# The commands `lagrange export` and `lagrange targets`.


def test_export_writes_files_and_says_how_they_are_tested(tmp_path: Path, capsys: Captured) -> None:
    folder = tmp_path / "new" / "out"
    request = ["export", "pendulum", "--target", "c", "--out", str(folder)]
    said = printed(capsys, *request, "--contents", "rhs, jacobian")
    assert [path.name for path in sorted(folder.iterdir())] == ["pendulum.c", "pendulum.h", "pendulum_test.c"]
    assert f"wrote {folder / 'pendulum.c'}" in said
    assert "  ./pendulum_test" in said
    assert data(capsys, *request, "--set", "l=2.5")["commands"][-1] == "./pendulum_test"
    assert ", 2.5" in (folder / "pendulum.c").read_text()


def test_a_wrong_request_is_said_in_a_sentence(tmp_path: Path, capsys: Captured) -> None:
    assert main(["export", "pendulum", "--target", "cobol", "--out", str(tmp_path)]) == 2
    assert "there is no target 'cobol'; the targets are c" in capsys.readouterr().err
    assert main(["export", "pendulum", "--target", "c", "--out", str(tmp_path), "--contents", "rsh"]) == 2
    assert "contents has the unknown name 'rsh'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_targets_are_listed(capsys: Captured) -> None:
    said = printed(capsys, "targets")
    assert all(name in said and about in said for name, about in lg.targets().items())


# --- the command `lagrange grade`: output and exit codes -------------------------------------------------------


RIGHT = "l*theta_ddot + g*sin(theta) = 0\n"


def graded(folder: Path, text: str | bytes, *options: str) -> int:
    path = folder / "answer.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return main(["grade", "pendulum", str(path), *options])


def test_right_and_wrong_equations(tmp_path: Path, capsys: Captured) -> None:
    assert graded(tmp_path, RIGHT) == 0
    assert capsys.readouterr().out == (
        "The equations are right: they are equivalent to those of the system, at the 5 states tried.\n"
    )
    assert graded(tmp_path, RIGHT.replace("+", "-")) == 1
    assert "has the wrong sign" in capsys.readouterr().out
    assert graded(tmp_path, RIGHT.replace("+", "-"), "--json") == 1
    data = json.loads(capsys.readouterr().out)
    assert (data["right"], data["wrong"]) == (False, [1]) and "theta_ddot" in data["counterexample"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_ddot + c\n", "line 1, column 14: 'c' is not a symbol of this system."),
        ("# nothing\n", "there is no equation: write one equation per line"),
        (
            b"\xff\xfea",
            "the file is not plain text; it may be a document of a word processor. Save the answer as plain text.",
        ),
        (b"PK\x03\x04\0\0theta", "the file is not plain text; it may be a document of a word processor."),
        (b"%PDF-1.4\n\xe2", "the file is not plain text; it may be a document of a word processor."),
        ("theta'' = 0\x1b[2J", "the file is not plain text; it may be a document of a word processor."),
        ("x" * 1_000_001, "the file has more than 1000000 bytes, too many for equations: give a shorter file."),
    ],
)
def test_what_cannot_be_read_is_a_wrong_request(
    text: str | bytes, message: str, tmp_path: Path, capsys: Captured
) -> None:
    assert graded(tmp_path, text) == 2
    assert f"{tmp_path / 'answer.txt'}: {message}" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_answers_of_any_usual_encoding_are_read(encoding: str, tmp_path: Path) -> None:
    assert graded(tmp_path, "l theta\u2019\u2019 = \u2013g sin theta \u00b7 1\r\n".encode(encoding)) == 0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x" * 5000, "the file cannot be read (File name too long): check its name and its permissions."),
        ("nowhere.txt", "nowhere.txt: there is no such file. Give a text file"),
    ],
    ids=["too long", "missing"],
)
def test_a_file_that_cannot_be_opened(name: str, message: str, capsys: Captured) -> None:
    assert main(["grade", "pendulum", name]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_folder_of_answers_becomes_a_table(tmp_path: Path, capsys: Captured) -> None:
    """An unreadable file does not affect the others. Hidden files and folders are ignored."""
    folder = tmp_path / "answers"
    (folder / "older").mkdir(parents=True)
    right, wrong = b"l theta'' = -g sin theta", b"l theta'' = g sin theta"
    for name, answer in {
        "Ada.txt": right,
        "Ben.md": wrong,
        "Ben.txt": wrong,
        "Cam.txt": b"\xff\xfea",
        ".x": b"y",
    }.items():
        (folder / name).write_bytes(answer)
    table = tmp_path / "grades.csv"
    assert main(["grade", "pendulum", str(folder), "--out", str(table)]) == 1
    shown = capsys.readouterr().out
    assert [line.split()[:2] for line in shown.partition("\n\n")[0].splitlines()[2:] if line[0] != " "] == [
        ["Ada", "right"],
        ["Ben.md", "wrong"],
        ["Ben.txt", "wrong"],
        ["Cam", "cannot"],
    ]
    assert "1 of 4 are right, 2 wrong, and 1 cannot be read. Folders inside are left out" in " ".join(shown.split())
    assert max(map(len, shown.partition("\n\n")[0].splitlines())) <= 100
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {"student": "Ada", "verdict": "right", "finding": "", "reading": "l*theta_ddot = -g*sin(theta)"}
    assert "has the wrong sign" in rows[1]["finding"] and rows[3]["finding"].startswith("the file is not plain text")
    assert main(["grade", "pendulum", str(folder), "--json"]) == 1
    assert [row["verdict"] for row in json.loads(capsys.readouterr().out)["answers"]] == [
        "right",
        "wrong",
        "wrong",
        "cannot be read",
    ]


def test_tables_are_for_folders_that_have_answers(tmp_path: Path, capsys: Captured) -> None:
    assert main(["grade", "pendulum", str(tmp_path)]) == 2
    assert f"{tmp_path}: the folder has no files." in " ".join(capsys.readouterr().err.split())
    assert graded(tmp_path, RIGHT, "--out", str(tmp_path / "table.csv")) == 2
    assert "a table is written only for a folder of answers: leave --out out, or give a folder." in " ".join(
        capsys.readouterr().err.split()
    )


# --- the commands that write a run as a picture, still or moving -----------------------------------------------


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


# --- the command `lagrange race`: output, files and exit codes -------------------------------------------------


SCENE = DROP.replace('"m*g*y"', '"m*g*y + sin(y)"')
QUICK = ["--tolerances", "1e-4,1e-8", "--steps", "0.1,0.05,0.025", "--repeats", "1", "--digits", "18"]


@pytest.fixture
def race_scene(tmp_path: Path) -> str:
    return written(tmp_path, SCENE)


def test_the_table_is_printed_and_files_are_written(race_scene: str, tmp_path: Path, capsys: Captured) -> None:
    out = tmp_path / "deep" / "er"
    said = printed(capsys, "race", race_scene, "--methods", "dop853, rk4", *QUICK, "--out", str(out))
    assert said.startswith("drop, t = 0 to 2: largest error of the state at t = 2\n")
    assert said.endswith(f"written to {out}: table.csv and plot.png\n")
    table = np.genfromtxt(out / "table.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["method"].tolist() == ["dop853"] * 2 + ["rk4"] * 3
    assert table["setting"].tolist() == [1e-4, 1e-8, 0.1, 0.05, 0.025]
    assert (np.diff(table["error"][2:]) < 0).all()
    assert (out / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_options_reach_the_race(race_scene: str, capsys: Captured) -> None:
    options = [
        *("--t-end", "1", "--set", "g=4", "--initial", "y_dot=1", "--outputs", "4", "--relative", "--max-wall", "5")
    ]
    plain, race = (data(capsys, "race", race_scene, "--methods", "rk4", *QUICK, *more) for more in ([], options))
    assert (race["t_end"], race["relative"], race["files"]) == (1.0, True, [])
    assert race["measure"] == "largest error of the state at 4 times, relative to each entry's size"
    assert "18 digits" in race["reference"]
    assert [entry["timed"] for entry in race["entries"]] == [1, 1, 1]
    assert plain["entries"][0]["error"] != race["entries"][0]["error"]


def test_no_run_at_the_end_is_a_failure_with_a_table(tmp_path: Path, capsys: Captured) -> None:
    picture = tmp_path / "plot.png"
    picture.write_text("of an earlier race")
    request = ["race", "elastic-pendulum", "--t-end", "1", "--methods", "verlet", *QUICK, "--out", str(tmp_path)]
    assert main(request) == 1
    assert "refused" in capsys.readouterr().out
    assert (tmp_path / "table.csv").exists() and not picture.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "rk5"], "Did you mean 'rk4'"),
        (["--methods", ""], "there is no method ''"),
        (["--tolerances", "1e-6,small"], "--tolerances: 'small' is not a number"),
        (["--tolerances", "0"], "tolerances contains 0"),
        (["--steps", "0.1,,0.2"], "--steps: '' is not a number"),
        (["--t-end", "0"], "no length"),
    ],
    ids=lambda value: " ".join(value)[:30],
)
def test_refusals(race_scene: str, options: list[str], words: str, capsys: Captured) -> None:
    assert main(["race", race_scene, *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
