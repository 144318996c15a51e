"""A scene file for tests of the command line, and what a refused command says."""

import json
from pathlib import Path
from typing import Any

import pytest

from lagrange.cli.program import main

DROP = """\
name = "drop"
about = "A stone that falls."
source = "Galilei"
coordinates = ["y"]
kinetic = "m*y_dot**2/2"
potential = "m*g*y"
positions = { stone = ["0", "y"] }
[parameters]
m = 2.0
g = 10.0
[initial]
y = 5.0
[run]
t_end = 2.0
"""


Captured = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def printed(capsys: Captured, *arguments: str, code: int = 0) -> str:
    """Return what a command prints that ends with a code, and that complains about nothing."""
    assert main(arguments) == code
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def data(capsys: Captured, *arguments: str, code: int = 0) -> Any:
    """Return the document that a command prints with --json."""
    return json.loads(printed(capsys, *arguments, "--json", code=code))


def written(folder: Path, text: str) -> str:
    """Write a scene and return where it is."""
    path = folder / "drop.toml"
    path.write_text(text, "utf-8")
    return str(path)


def refused(capsys: Captured, *arguments: str, code: int = 2) -> str:
    """Return the one message of a command that ends with a code and prints nothing else."""
    assert main(arguments) == code
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("lagrange: ") and "Traceback" not in captured.err
    return captured.err.removeprefix("lagrange: ").rstrip("\n")
