"""Features of exported C alone; `test_modules.py` has what it shares with other languages."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.errors import StatementError

WARNINGS = "cc -std=c99 -O1 -Wall -Wextra -Wconversion -Werror"
CONTENTS = ("rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations", "rk4", "dop853", "main")

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")


def run(command: str, folder: Path) -> str:
    done = subprocess.run(shlex.split(command), cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@needs_cc
@pytest.mark.parametrize(
    "scene", ["kepler", *(pytest.param(name, marks=pytest.mark.slow) for name in ("pleiades", "cartesian-pendulum"))]
)
def test_the_taylor_integrator_passes_its_test(scene: str, tmp_path: Path) -> None:
    """The exported integrator passes its test: unrolled, in a loop over orders, and with projection."""
    name = scene.replace("-", "_")
    made = lg.scene(scene).export("c", tmp_path, ["taylor", "main"])
    assert [path.name for path in made.files] == [f"{name}{end}" for end in (".h", ".c", "_test.c", "_main.c")]
    for program in ("test", "main"):
        run(f"{WARNINGS} -o warned {name}.c {name}_{program}.c -lm", tmp_path)
    for command in made.commands:
        said = run(command, tmp_path)
    assert said.endswith("results are right\n")


@pytest.mark.slow
@needs_cc
def test_main_runs_by_taylor_series(tmp_path: Path) -> None:
    system = lg.scene("kepler")
    system.export("c", tmp_path, ["main", "taylor"])
    run("cc -O2 -o main kepler.c kepler_main.c -lm", tmp_path)
    _, *rows = run("./main 20 2", tmp_path).splitlines()
    ours = system.run(20.0, t_eval=[0.0, 10.0, 20.0], method="taylor", rtol=1e-10, atol=1e-10)
    for row, state in zip(rows, ours.y.T, strict=True):
        assert [float(cell) for cell in row.split(",")[1:]] == pytest.approx(state, abs=1e-9)


def test_switching_surfaces_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(StatementError, match=r"crosses no switching surfaces .*leave 'taylor' out of contents"):
        lg.scene("falling-ball").export("c", tmp_path / "made", ["taylor"])
    assert not (tmp_path / "made").exists()


@needs_cc
def test_events_are_functions(tmp_path: Path) -> None:
    system = lg.scene("pendulum")
    (theta,) = system.coordinates
    made = system.export("c", tmp_path, events=[theta.dot, lg.event(theta - 1, direction=1)])
    header = (tmp_path / "pendulum.h").read_text()
    assert "out: event0, event1" in header
    assert "event1 = theta - 1 (rising)" in header
    for command in made.commands:
        said = run(command, tmp_path)
    assert said == "pendulum: 30 of 30 results are right\n"


@needs_cc
def test_main_refuses_what_is_no_number(tmp_path: Path) -> None:
    lg.scene("pendulum").export("c", tmp_path, ["main"])
    run("cc -O0 -o main pendulum.c pendulum_main.c -lm", tmp_path)
    for words in ("abc", "2 2.7", "nan", "2 0", "1 2 3"):
        done = subprocess.run(["./main", *words.split()], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "") and "give a" in done.stderr, words


@needs_cc
@pytest.mark.parametrize(
    "method", ["rk4", *(pytest.param(name, marks=pytest.mark.slow) for name in ("taylor", "dop853"))]
)
def test_a_start_off_the_constraints_is_refused(method: str, tmp_path: Path) -> None:
    lg.scene("cartesian-pendulum").export("c", tmp_path, [method])
    call = "0.0, 0.01, y, p" if method == "rk4" else "t, 1.0, y, p, 1e-9, 1e-9, 100000"
    (tmp_path / "start.c").write_text(f"""\
#include <stdio.h>
#include <stdlib.h>
#include "cartesian_pendulum.h"
int main(int count, char **words) {{
    double p[CARTESIAN_PENDULUM_PREPARED], t[] = {{0.0}}, y[] = {{0.0, -1.0, 0.0, 0.0}};
    y[1] += strtod(words[count - 1], NULL);
    cartesian_pendulum_prepare(cartesian_pendulum_default_parameters, p);
    (void)t;
    printf("%d", (int)cartesian_pendulum_{method}({call}));
    return 0;
}}
""")
    run("cc -O1 -o start start.c cartesian_pendulum.c -lm", tmp_path)
    assert [run(f"./start {off}", tmp_path) for off in ("0", "1e-9", "1e-3", "0.2", "nan")] == ["0", "0", "9", "9", "9"]


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_a_program_of_cpp_includes_the_header(tmp_path: Path) -> None:
    lg.scene("pendulum").export("c++", tmp_path, ["rhs"])
    program = '#include "pendulum.h"\nint main() { double p[PENDULUM_PREPARED]; return pendulum_prepare('
    (tmp_path / "program.cpp").write_text(f"{program}pendulum_default_parameters, p); }}\n")
    run("cc -std=c99 -c pendulum.c", tmp_path)
    run("g++ -std=c++17 -Wall -Wextra -Werror -o program program.cpp pendulum.o -lm", tmp_path)
    run("./program", tmp_path)
