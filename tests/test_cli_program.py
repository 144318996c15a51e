"""The command line as a program of its own: imports, pipes, signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange import cli

SCENE = """\
name = "drop"
source = "Galilei"
coordinates = ["y"]
kinetic = "m*y_dot**2/2"
potential = "m*g*y"
parameters = { m = 2.0, g = 10.0 }
"""


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "drop.toml"
    path.write_text(SCENE, "utf-8")
    return str(path)


def command(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lagrange", *arguments], capture_output=True, text=True, check=False, **options
    )


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\nfrom lagrange.cli import main\nmain(['--help'])\nmain(['scenes'])\n"
        "print(sorted({'numpy', 'scipy', 'sympy', 'mpmath', 'matplotlib', 'llvmlite', 'rich'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("usage: lagrange [-h] [--version] COMMAND ...")
    assert found.stdout.endswith("\n[]\n")


def test_a_run_without_out_imports_no_plotting(scene: str) -> None:
    program = f"import sys\nfrom lagrange.cli import main\nmain(['run', {scene!r}])\nprint('matplotlib' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.endswith("\nFalse\n")


def test_as_a_program(scene: str) -> None:
    done = command("run", scene)
    assert (done.returncode, done.stderr) == (0, "")
    wrong = command("run", scene, "--set", "k=1")
    assert wrong.returncode == 2
    assert wrong.stderr == "lagrange: 'k' is no parameter of this system; its parameters are m and g.\n"
    assert command("--version").stdout == f"lagrange {lg.__version__}\n"


def test_a_reader_who_goes_away_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as broken:
        done = subprocess.run(
            [sys.executable, "-m", "lagrange", "scenes"], stdout=broken, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_standard_output_on_a_full_disk() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "lagrange", "scenes"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == "lagrange: the output cannot be written (No space left on device).\n"


def test_a_terminal_that_knows_no_accents(tmp_path: Path) -> None:
    path = tmp_path / "accent.toml"
    path.write_text(SCENE.replace("Galilei", "Störmer"), "utf-8")
    done = command("derive", str(path), env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0
    assert "Source: St\\xf6rmer" in done.stdout


@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
def test_ctrl_c_keeps_the_partial_result(tmp_path: Path) -> None:
    # SciPy's steps are slow enough that the run is still going on any machine: ours would be through in two seconds.
    options = ["--method", "scipy-dop853", "--rtol", "1e-10", "--t-end", "1e6", "--points", "9", "--out"]
    program = [sys.executable, "-m", "lagrange", "run", "double-pendulum", *options, str(tmp_path)]
    for pause in (3.0, 5.0, 8.0):  # on a busy machine it may still be compiling, and has nothing to keep yet
        with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            time.sleep(pause)
            process.send_signal(signal.SIGINT)
            printed, complaint = process.communicate(timeout=60)
        assert process.returncode == 130, complaint
        assert "Traceback" not in complaint
        if printed:
            break
    assert printed.startswith("double-pendulum: interrupted\n")
    assert json.loads((tmp_path / "card.json").read_text("utf-8"))["status"] == "interrupted"


def test_the_library_is_where_it_is_read_from() -> None:
    assert cli.SCENES.is_dir()
