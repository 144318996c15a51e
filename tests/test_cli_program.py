"""The command line as a separate process: imports, pipes, signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import lagrange as lg
from lagrange.cli.program import SCENES
from tests.drop import DROP, written


@pytest.fixture
def scene(tmp_path: Path) -> str:
    return written(tmp_path, DROP)


def command(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lagrange", *arguments], capture_output=True, text=True, check=False, **options
    )


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\nfrom lagrange.cli.program import main\nmain(['--help'])\nmain(['scenes'])\n"
        "print(sorted({'numpy', 'scipy', 'sympy', 'mpmath', 'matplotlib', 'llvmlite', 'rich'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.startswith("usage: lagrange [-h] [--version] COMMAND ...")
    assert result.stdout.endswith("\n[]\n")


@pytest.mark.slow
def test_a_run_without_out_imports_neither_plotting_nor_statistics(scene: str) -> None:
    program = (
        f"import sys\nfrom lagrange.cli.program import main\nmain(['run', {scene!r}])\n"
        "print(sorted({'matplotlib', 'scipy.stats', 'scipy.interpolate'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.endswith("\n[]\n")


@pytest.mark.slow
def test_as_a_program(scene: str) -> None:
    done = command("run", scene)
    assert (done.returncode, done.stderr) == (0, "")
    assert command("--version").stdout == f"lagrange {lg.__version__}\n"


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


@pytest.mark.few(1)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("arguments", PRINTING, ids=" ".join)
def test_standard_output_on_a_full_disk(arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        result = printing_to(full, *arguments)
    assert result == (1, "lagrange: the output cannot be written (No space left on device).\n")


@pytest.mark.few(1)
@pytest.mark.skipif(os.name != "posix", reason="the shell is that of POSIX")
@pytest.mark.parametrize("arguments", PRINTING, ids=" ".join)
def test_standard_output_that_is_closed(arguments: tuple[str, ...]) -> None:
    result = printing_to(subprocess.DEVNULL, *arguments, before="exec >&-;")
    assert result == (1, "lagrange: the output cannot be written (standard output is closed).\n")


@pytest.mark.skipif(os.name != "posix", reason="the shell is that of POSIX")
@pytest.mark.parametrize(
    "before", ["exec 2>&-;", pytest.param("exec 2>/dev/full;", marks=pytest.mark.slow)], ids=["closed", "full"]
)
def test_standard_error_that_nobody_reads_leaves_the_exit_code_and_the_output(tmp_path: Path, before: str) -> None:
    with (tmp_path / "printed").open("w") as printed:
        assert printing_to(printed, "run", "nothing", before=before) == (2, "")
        assert printing_to(printed, "--version", before=before) == (0, "")
    assert (tmp_path / "printed").read_text() == f"lagrange {lg.__version__}\n", "no refusal goes to the output"


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


def test_the_library_is_where_it_is_read_from() -> None:
    assert SCENES.is_dir()
