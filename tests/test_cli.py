"""The command line: output, files, exit codes, and its messages."""

import errno
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.cli.program import main
from lagrange.trajectory.trajectory import Status
from tests.drop import DROP, Captured, Patch, data, printed, refused, written


@pytest.fixture
def scene(tmp_path: Path) -> str:
    return written(tmp_path, DROP)


# --- run ----------------------------------------------------------------------------------------------------


def test_run_writes_trajectory_picture_and_card(scene: str, tmp_path: Path, capsys: Captured) -> None:
    out = tmp_path / "deep" / "er"
    assert main(["run", scene, "--out", str(out), "--points", "5", "--set", "g=4", "--initial", "y_dot=1"]) == 0
    assert capsys.readouterr().out.endswith(f"written to {out}: trajectory.csv, trajectory.png and card.json\n")
    assert sorted(path.name for path in out.iterdir()) == ["card.json", "trajectory.csv", "trajectory.png"]
    table = np.genfromtxt(out / "trajectory.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["t"], [0, 0.5, 1, 1.5, 2])
    np.testing.assert_allclose(table["y"], 5 + table["t"] - 2 * table["t"] ** 2, rtol=1e-8)
    assert (out / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    card = json.loads((out / "card.json").read_text("utf-8"))
    assert (card["system"], card["status"], card["parameters"]) == ("drop", "success", {"m": 2.0, "g": 4.0})
    assert card["initial"] == {"y": 5.0, "y_dot": 1.0}


def test_run_options_reach_the_run(scene: str, capsys: Captured) -> None:
    card = data(capsys, "run", scene, "--method", "rk4", "--step", "0.25", "--t-end", "1")
    assert (card["method"], card["steps"], card["t_end"]) == ("rk4", 4, 1.0)
    assert data(capsys, "run", scene, "--rtol", "1e-3", "--atol", "1e-3", "--no-check")["files"] == []


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2.0),
        ("-1e-3", -1e-3),
        ("+.5", 0.5),
        ("pi", np.pi),
        ("-pi/6", -np.pi / 6),
        ("2*pi/3", 2 * np.pi / 3),
        ("30deg", np.pi / 6),
        ("1/4", 0.25),
    ],
)
def test_numbers(text: str, value: float, scene: str, capsys: Captured) -> None:
    card = data(capsys, "run", scene, "--t-end", "0.1", "--initial", f"y = {text}")
    assert card["initial"]["y"] == pytest.approx(value, rel=1e-15)


def test_json_is_one_document_with_the_card_and_the_files(scene: str, tmp_path: Path, capsys: Captured) -> None:
    card = data(capsys, "run", scene, "--out", str(tmp_path))
    assert card["files"] == [str(tmp_path / name) for name in ("trajectory.csv", "trajectory.png", "card.json")]
    assert card["complete"] is True


ENDS: dict[str, tuple[str, list[str], list[str]]] = {
    # potential energy instead of m*g*y, options, and the first words on the way out
    "blow-up": ("-m*y**4/4", ["--t-end", "50"], ["step_too_small", "non_finite", "max_steps"]),
    "unreliable": ("-m/y", ["--method", "verlet", "--step", "1e-3"], ["unreliable"]),
}


@pytest.mark.parametrize("end", ENDS)
def test_a_run_that_does_not_follow_the_motion_fails_and_keeps_what_there_is(
    end: str, tmp_path: Path, capsys: Captured
) -> None:
    potential, options, statuses = ENDS[end]
    text = DROP.replace('"m*g*y"', f'"{potential}"').replace("y = 5.0", "y = 1.0").replace("g = 10.0\n", "")
    assert main(["run", written(tmp_path, text), "--out", str(tmp_path / "out"), *options]) == 1
    card = json.loads((tmp_path / "out" / "card.json").read_text("utf-8"))
    assert card["status"] in statuses and not card["complete"]
    assert capsys.readouterr().out.startswith(f"drop: {card['status']}")
    rows = len((tmp_path / "out" / "trajectory.csv").read_text("utf-8").splitlines())
    assert rows == 2002 if end == "unreliable" else rows > 3


def test_a_run_without_output_leaves_no_old_picture(scene: str, tmp_path: Path, monkeypatch: Patch) -> None:
    finished = lg.System.from_scene(scene).run(0.5)
    empty = replace(finished.trajectory, t=np.empty(0), y=np.empty((2, 0)), status=Status.NON_FINITE)
    monkeypatch.setattr(lg.System, "run", lambda *_, **__: replace(finished, trajectory=empty))
    (tmp_path / "trajectory.png").write_text("old")
    assert main(["run", scene, "--out", str(tmp_path)]) == 1
    assert not (tmp_path / "trajectory.png").exists()
    assert (tmp_path / "trajectory.csv").read_text("utf-8") == "t,y,y_dot\n"


def test_an_interrupted_run_is_written_and_says_130(scene: str, tmp_path: Path, monkeypatch: Patch) -> None:
    finished = lg.System.from_scene(scene).run(0.5)
    stopped = replace(finished, trajectory=replace(finished.trajectory, status=Status.INTERRUPTED))
    monkeypatch.setattr(lg.System, "run", lambda *_, **__: stopped)
    assert main(["run", scene, "--out", str(tmp_path / "out")]) == 130
    assert json.loads((tmp_path / "out" / "card.json").read_text("utf-8"))["status"] == "interrupted"


def test_an_interruption_elsewhere_says_130(scene: str, monkeypatch: Patch, capsys: Captured) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(lg.System, "from_scene", interrupt)
    assert refused(capsys, "run", scene, code=130) == "interrupted; no file was left half written."


# --- refusals of run ----------------------------------------------------------------------------------------


NO_NUMBER = "is not a number. Write one such as 2, 1e-3, 30deg or pi/6."
TOO_FEW = "is not a number of output times. Give 2 or more, below 100 million."


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "m"], "--set m: write NAME=VALUE, such as --set m=2."),
        (["--set", "=2"], "--set =2: write NAME=VALUE, such as --set m=2."),
        (["--set", "m=1", "--set", "m=2"], "--set gives m twice: give it once."),
        *((["--set", f"m={text}"], f"--set m: {text!r} {NO_NUMBER}") for text in ("heavy", "nan", "", "1/0", "1.2.3")),
        (["--initial", "y=__import__('os')"], f"--initial y: \"__import__('os')\" {NO_NUMBER}"),
        (["--t-end", "soon"], f"--t-end: 'soon' {NO_NUMBER}"),
        (["--rtol", "x"], f"--rtol: 'x' {NO_NUMBER}"),
        *((["--points", text], f"--points: {text!r} {TOO_FEW}") for text in ("1", "1e3")),
        (["--out", ""], "--out: the name of the folder is empty. Give one, such as --out out, or . for this one."),
        (["--set", "M=1"], "'M' is not a parameter of this system; its parameters are m and g."),
        (["--set", "y=1"], "--set y=1: y is a coordinate or velocity: write --initial y=1."),
        (["--initial", "m=1"], "--initial m=1: m is a parameter: write --set m=1."),
        (["--out", "run.png"], "--out run.png: this command writes several files into a folder: name a folder, such a"),
    ],
)
def test_wrong_requests(arguments: list[str], message: str, scene: str, capsys: Captured) -> None:
    assert message in refused(capsys, "run", scene, *arguments)


def test_unknown_scenes(tmp_path: Path, capsys: Captured) -> None:
    assert refused(capsys, "run", "pendulun").endswith("Did you mean 'pendulum'?")
    assert "the library has no scene" in refused(capsys, "run", "x" * 5000)
    missing = str(tmp_path / "nowhere.toml")
    assert missing in refused(capsys, "run", missing)
    assert "nowhere.toml" in refused(capsys, "derive", "nowhere.toml")
    assert refused(capsys, "check", str(tmp_path)).startswith(str(tmp_path))


def test_refusals_as_json(scene: str, capsys: Captured) -> None:
    assert main(["run", scene, "--set", "m", "--json"]) == 2
    captured = capsys.readouterr()
    message = "--set m: write NAME=VALUE, such as --set m=2."
    assert json.loads(captured.out) == {"error": message, "exit_code": 2}
    assert captured.err == f"lagrange: {message}\n"


def test_out_that_cannot_be_a_folder(scene: str, capsys: Captured, monkeypatch: Patch) -> None:
    out = f"{scene}/inside"
    assert (
        refused(capsys, "run", scene, "--out", out)
        == f"--out {out}: the folder cannot be made (Not a directory). Name another folder."
    )
    assert (
        refused(capsys, "run", scene, "--out", scene)
        == f"--out {scene}: the folder cannot be made (File exists). Name another folder."
    )
    assert "the folder cannot be made (embedded null byte)" in refused(capsys, "run", scene, "--out", "a\0b")
    monkeypatch.setattr(os, "access", lambda *_: False)
    folder = str(Path(scene).parent)
    assert (
        refused(capsys, "run", scene, "--out", folder)
        == f"--out {folder}: the folder may not be written to. Name another folder."
    )


def test_a_full_disk_is_one_message_and_leaves_nothing_half_written(
    scene: str, tmp_path: Path, capsys: Captured, monkeypatch: Patch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    out = tmp_path / "out"
    message = refused(capsys, "run", scene, "--out", str(out), code=1)
    assert message == (
        f"Cannot write {out / 'trajectory.csv'}: the disk is full. Nothing was written; free some space or write "
        "elsewhere."
    )
    assert list(out.iterdir()) == []


# --- derive, check, scenes, new -----------------------------------------------------------------------------


def test_derive(scene: str, capsys: Captured) -> None:
    text = printed(capsys, "derive", scene)
    assert text.startswith("drop\n\nStated\n    A stone that falls.\n    Source: Galilei\n    T = m*y_dot**2/2\n")
    assert "\n    m*y_ddot + m*g = 0\n" in text
    assert "\nRemarks\n    Nothing depends on time explicitly" in text
    assert r"\[ m \ddot{y} + m g = 0 \]" in printed(capsys, "derive", scene, "--format", "latex")
    assert printed(capsys, "derive", scene, "--format", "markdown").startswith("# drop\n")
    above = {"title": "Fall", "author": "Ada", "date": "1 May", "problem": "Derive it."}
    text = printed(capsys, "derive", scene, *(word for field in above.items() for word in (f"--{field[0]}", field[1])))
    assert text.startswith("Fall\nAda\n1 May\nDerive it.\n\nStated\n")


def test_check(scene: str, capsys: Captured) -> None:
    assert printed(capsys, "check", scene).rstrip().splitlines()[-1] == "Everything holds."
    report = data(capsys, "check", scene)
    assert report["holds"] is True and report["system"] == "drop"


def test_a_check_that_fails_says_1(scene: str, monkeypatch: Patch, capsys: Captured) -> None:
    report = lg.System.from_scene(scene).check()
    wrong = replace(report, unexplained=("the compiled energy has no value at point 1",))
    monkeypatch.setattr(lg.System, "check", lambda *_, **__: wrong)
    assert main(["check", scene]) == 1
    assert "no value at point 1" in capsys.readouterr().out


def test_scenes(capsys: Captured) -> None:
    lines = printed(capsys, "scenes").splitlines()
    assert max(map(len, lines)) <= 100
    text = " ".join(" ".join(lines).split())
    result = data(capsys, "scenes")
    assert [entry["name"] for entry in result] == lg.scenes()
    assert all(entry["source"] for entry in result)
    assert all(entry["name"] in text and entry["about"] in text for entry in result)


def test_new_writes_a_scene_that_runs(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "made" / "my-swing.toml"
    said = printed(capsys, "new", "my-swing", "--out", str(tmp_path / "made"))
    assert said == f"{path} is a pendulum for now: change it, then  lagrange run {path}\n"
    assert lg.System.from_scene(path).name == "my-swing"
    assert main(["run", str(path)]) == 0


def test_new_never_overwrites(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("precious")
    assert refused(capsys, "new", "mine", "--out", str(tmp_path)) == (
        f"{path} exists already and was not changed: choose another name, or remove it first."
    )
    assert path.read_text() == "precious"


@pytest.mark.parametrize("name", ["", "../x", "a/b", "-x", ".hidden", 'a"b', "x" * 65, "é"])
def test_new_refuses_names(name: str, tmp_path: Path, capsys: Captured) -> None:
    assert main(["new", "--out", str(tmp_path), "--", name]) == 2
    assert capsys.readouterr().err == (
        f"lagrange: {name!r} cannot name a scene: use 1 to 64 letters, digits, - and _, such as double-pendulum.\n"
    )
    assert list(tmp_path.iterdir()) == []


# --- the program ----------------------------------------------------------------------------------------------
# The command line as a separate process: imports, pipes, signals.


def command(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lagrange", *arguments], capture_output=True, text=True, check=False, **options
    )


HEAVY = ("numpy", "scipy", "sympy", "mpmath", "matplotlib", "llvmlite", "rich")


@pytest.mark.parametrize(
    ("calls", "unwanted"),
    [
        ((["--help"], ["scenes"]), HEAVY),
        pytest.param(
            (["run", "pendulum"],), ("matplotlib", "scipy.stats", "scipy.interpolate"), marks=pytest.mark.slow
        ),
    ],
    ids=["help", "a run without --out"],
)
def test_a_command_imports_nothing_heavy_that_it_does_not_use(calls: Any, unwanted: tuple[str, ...]) -> None:
    program = (
        f"import sys\nfrom lagrange.cli.program import main\nfor words in {calls}: main(words)\n"
        f"print(sorted(set({unwanted}) & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.endswith("\n[]\n")


PRINTING = [("scenes",), ("scenes", "--json"), ("--help",), ("run", "--help"), ("--version",)]


def printing_to(stream: Any, *arguments: str, before: str = "") -> tuple[int, str]:
    """Return the exit code and stderr of a command whose output goes to a stream, after shell code `before`."""
    program = ["sh", "-c", f'{before} exec "$@"', "sh", sys.executable, "-m", "lagrange", *arguments]
    done = subprocess.run(program, stdout=stream, stderr=subprocess.PIPE, text=True, check=False)
    return done.returncode, done.stderr


@pytest.mark.few(1)
@pytest.mark.skipif(os.name != "posix", reason="pipes break the POSIX way")
@pytest.mark.parametrize("arguments", PRINTING, ids=" ".join)
def test_a_reader_who_goes_away_is_told_by_the_exit_code_alone(arguments: tuple[str, ...]) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as broken:
        assert printing_to(broken, *arguments) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize(
    ("before", "reason"),
    [("exec >/dev/full;", "No space left on device"), ("exec >&-;", "standard output is closed")],
    ids=["full", "closed"],
)
@pytest.mark.parametrize("arguments", PRINTING, ids=" ".join)
def test_standard_output_that_cannot_be_written(arguments: tuple[str, ...], before: str, reason: str) -> None:
    result = printing_to(subprocess.DEVNULL, *arguments, before=before)
    assert result == (1, f"lagrange: the output cannot be written ({reason}).\n")


@pytest.mark.skipif(os.name != "posix", reason="the shell is that of POSIX")
@pytest.mark.parametrize(
    "before", ["exec 2>&-;", pytest.param("exec 2>/dev/full;", marks=pytest.mark.slow)], ids=["closed", "full"]
)
def test_standard_error_that_nobody_reads_leaves_the_exit_code_and_the_output(tmp_path: Path, before: str) -> None:
    with (tmp_path / "printed").open("w") as printed:
        assert printing_to(printed, "run", "nothing", before=before) == (2, "")
        assert printing_to(printed, "--version", before=before) == (0, "")
    assert (tmp_path / "printed").read_text() == f"lagrange {lg.__version__}\n", "no refusal goes to the output"


@pytest.mark.slow
def test_a_terminal_that_knows_no_accents(tmp_path: Path) -> None:
    path = written(tmp_path, DROP.replace("Galilei", "Störmer"))
    done = command("derive", path, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0
    assert "Source: St\\xf6rmer" in done.stdout


STEPPING = """\
import sys
from lagrange.__main__ import main
from scipy.integrate import DOP853
step = DOP853.step
def told(self):
    if self.t > 10.0:
        DOP853.step = step
        print("stepping", file=sys.stderr, flush=True)
    return step(self)
DOP853.step = told
sys.exit(main())
"""
"""The program, which says on its standard error when a run has results to keep."""


@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_keeps_the_partial_result(tmp_path: Path, number: signal.Signals, code: int) -> None:
    # SciPy's steps are slow enough that the run is still going on any machine: ours would be through in two seconds.
    options = ["--method", "scipy-dop853", "--rtol", "1e-10", "--t-end", "1e6", "--points", "9", "--out"]
    program = [sys.executable, "-c", STEPPING, "run", "double-pendulum", *options, str(tmp_path)]
    # Whatever becomes of this process, the run ends with its minutes of the processor.
    program = ["sh", "-c", 'ulimit -t 180 && exec "$@"', "sh", *program]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None and process.stderr.readline() == "stepping\n"
            process.send_signal(number)
            printed, complaint = process.communicate(timeout=300)
        finally:
            process.kill()
    assert process.returncode == code, complaint
    assert "Traceback" not in complaint
    assert printed.startswith("double-pendulum: interrupted\n")
    assert json.loads((tmp_path / "card.json").read_text("utf-8"))["status"] == "interrupted"


# --- the terminal ---------------------------------------------------------------------------------------------
# The command line on a terminal: lines that fit, and suggestions for misspelled words.


def on_a_terminal(columns: int, *arguments: str, encoding: str = "utf-8") -> tuple[int, list[str]]:
    """Run a command on a terminal with a number of columns. Return its exit code and lines, without progress."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    without = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    environment = {**without, "TERM": "xterm", "PYTHONIOENCODING": encoding}
    command = [sys.executable, "-m", "lagrange", *arguments]
    with subprocess.Popen(command, stdin=its, stdout=its, stderr=its, env=environment) as process:
        os.close(its)
        said = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # how Linux says that the other side is closed
                part = b""
            if not part:
                break
            said += part
        code = process.wait()
    os.close(ours)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", said.decode(encoding)).replace("\r\n", "\n")
    shown = [line.rpartition("\r")[2] for line in text.split("\n")]  # what stands after the last carriage return
    return code, [line for line in shown if line and "━" not in line and line != "compiling "]


def test_lines_fit_a_terminal_without_unicode() -> None:
    code, lines = on_a_terminal(60, "scenes", "--long", encoding="ascii")
    assert code == 0 and max(map(len, lines)) <= 60
    place = lines.index("kepler: A planet on an ellipse of eccentricity 0.6; one")
    assert lines[place + 1 : place + 3] == ["  revolution takes 2 pi.", "  coordinates  x, y"]
    assert "  source       E. Hairer, C. Lubich, G. Wanner, Geometric" in lines
    assert "               Numerical Integration, 2nd ed. (2006)," in lines


@pytest.mark.parametrize("command", [["scenes"], pytest.param(["check", "pendulum"], marks=pytest.mark.slow)])
def test_tables_fit_a_terminal_with_their_rules(command: list[str]) -> None:
    code, lines = on_a_terminal(60, *command)
    assert code == 0 and max(map(len, lines)) <= 60
    assert any(set(line) <= {"-", " "} for line in lines)


def test_refusals_fit_a_terminal_and_are_one_line_in_a_pipe(capsys: Captured) -> None:
    code, lines = on_a_terminal(60, "run", "nopendulum")
    assert code == 2 and len(lines) > 5 and max(map(len, lines)) <= 60
    assert lines[0].startswith("lagrange: the library has no scene 'nopendulum'; it has") and lines[1].startswith("  ")
    assert main(["run", "nopendulum"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and " ".join(line.strip() for line in lines) == said.rstrip("\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rum", "pendulum"], "lagrange: error: argument COMMAND: invalid choice: 'rum' (choose from 'run', 'plot', "),
        (["rum", "pendulum"], "Did you mean 'run'?"),
        (["animate", "pendulum", "--speeed", "3"], "lagrange animate: error: unrecognized arguments: --speeed 3. Did"),
        (["derive", "pendulum", "more"], "lagrange derive: error: unrecognized arguments: more."),
        (["run"], "lagrange run: error: the following arguments are required: SCENE."),
        ([], "lagrange: error: the following arguments are required: COMMAND"),
        (["derive", "pendulum", "--format", "pdf"], "invalid choice: 'pdf'"),
        (["run", "a", "--meth", "rk4"], "unrecognized arguments: --meth rk4"),
    ],
)
def test_a_word_that_is_none_is_refused_with_the_one_that_was_meant(
    arguments: list[str], message: str, capsys: Captured
) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("usage: lagrange") and message in said.err


def test_help_fits_80_columns(capsys: Captured, monkeypatch: Patch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    page = printed(capsys, "--help")
    commands = re.findall(r"^    ([a-z]+) ", page, re.MULTILINE)
    assert {"run", "plot", "animate", "ensemble"} <= {*commands}
    assert re.search(r"\n    ensemble +\w", page), "a command and what it does stand in one line"
    for command in commands:
        page += printed(capsys, command, "--help")
    assert max(map(len, page.splitlines())) <= 80


def test_scenes_in_long(capsys: Captured) -> None:
    parts = printed(capsys, "scenes", "--long").rstrip("\n").split("\n\n")
    assert [part.partition(":")[0] for part in parts] == lg.scenes()
    atwood = next(part for part in parts if part.startswith("cartesian-pendulum"))
    assert "\n  coordinates  x, y\n  constraints  rod: " in atwood and "\n  method       taylor to t = 10.0\n" in atwood
    assert all("\n  source       " in part for part in parts)
    ball, top = (next(part for part in parts if part.startswith(name)) for name in ("bouncing-ball", "free-top"))
    assert "\n  contacts     floor\n" in ball and "\n  coordinates  R\n" in top
