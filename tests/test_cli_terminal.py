"""The command line on a terminal: lines that fit, and suggestions for misspelled words."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.cli.program import main
from tests.drop import DROP, written


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
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", said.decode(encoding)).replace("\r", "")
    return code, [line for line in text.split("\n") if line and "━" not in line and line != "compiling "]


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


def test_refusals_fit_a_terminal_and_are_one_line_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    code, lines = on_a_terminal(60, "run", "nopendulum")
    assert code == 2 and len(lines) > 5 and max(map(len, lines)) <= 60
    assert lines[0].startswith("lagrange: the library has no scene 'nopendulum'; it has") and lines[1].startswith("  ")
    assert main(["run", "nopendulum"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and " ".join(line.strip() for line in lines) == said.rstrip("\n")


def test_in_a_pipe_a_run_is_the_card_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", written(tmp_path, DROP)]) == 0
    said = capsys.readouterr().out
    assert said.rstrip("\n").splitlines()[-1].startswith("message") and said.isascii()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rum", "pendulum"], "lagrange: error: argument COMMAND: invalid choice: 'rum' (choose from 'run', 'plot', "),
        (["rum", "pendulum"], "Did you mean 'run'?"),
        (["animate", "pendulum", "--speeed", "3"], "lagrange animate: error: unrecognized arguments: --speeed 3. Did"),
        (["derive", "pendulum", "more"], "lagrange derive: error: unrecognized arguments: more."),
        (["run"], "lagrange run: error: the following arguments are required: SCENE."),
    ],
)
def test_a_word_that_is_none_is_refused_with_the_one_that_was_meant(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("usage: lagrange") and message in said.err


def test_help_fits_80_columns(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["--help"]) == 0
    page = capsys.readouterr().out
    commands = re.findall(r"^    ([a-z]+) ", page, re.MULTILINE)
    assert {"run", "plot", "animate", "ensemble"} <= {*commands}
    assert re.search(r"\n    ensemble +\w", page), "a command and what it does stand in one line"
    for command in commands:
        assert main([command, "--help"]) == 0
        page += capsys.readouterr().out
    assert max(map(len, page.splitlines())) <= 80


def test_scenes_in_long(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "--long"]) == 0
    parts = capsys.readouterr().out.rstrip("\n").split("\n\n")
    assert [part.partition(":")[0] for part in parts] == lg.scenes()
    atwood = next(part for part in parts if part.startswith("cartesian-pendulum"))
    assert "\n  coordinates  x, y\n  constraints  rod: " in atwood and "\n  method       taylor to t = 10.0\n" in atwood
    assert all("\n  source       " in part for part in parts)
    ball, top = (next(part for part in parts if part.startswith(name)) for name in ("bouncing-ball", "free-top"))
    assert "\n  contacts     floor\n" in ball and "\n  coordinates  R\n" in top
