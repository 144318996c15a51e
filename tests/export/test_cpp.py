"""Exported C++ compiles without a warning, its own test finds every result right, and `main` writes our trajectory."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from tests.export.test_c import CONTENTS, run

COMPILE = "g++ -std=c++17 -O1 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wold-style-cast -Werror"

needs_gxx = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")


def conforms(scene: str, folder: Path) -> None:
    """Compile all contents of a scene, run the self-test, and compare the table of main with our trajectory."""
    system = lg.scene(scene)
    held = ["multipliers"] if system.statement.constraints else []
    made = system.export("cpp", folder, [*CONTENTS, *held])
    header, source = made.files
    assert [header.suffix, source.suffix] == [".hpp", ".cpp"]
    for text in (header.read_text(), source.read_text()):
        assert text.isascii() and text.endswith("\n") and not text.endswith("\n\n")
    macro = source.stem.upper()
    run(f"{COMPILE} -D{macro}_TEST -o tested {source.name}", folder)
    assert run("./tested", folder).endswith("results are right\n")
    end = min(1.0, system.statement.run.t_end)
    run(f"{COMPILE} -D{macro}_MAIN -o ran {source.name}", folder)
    last = np.array(run(f"./ran {end} 4", folder).splitlines()[-1].split(","), dtype=float)
    ours = system.run(end, method="dop853", rtol=1e-12, atol=1e-12).y[:, -1]
    # main takes the tolerance of the scene, 1e-10 or looser; a run of a unit of time multiplies it by some hundreds.
    assert last[1:] == pytest.approx(ours, rel=1e-6, abs=1e-6)


@needs_gxx
@pytest.mark.parametrize("scene", ["double-pendulum", "seven-body-mechanism"])
def test_the_self_test_passes(scene: str, tmp_path: Path) -> None:
    conforms(scene, tmp_path)


@needs_gxx
@pytest.mark.exhaustive
@pytest.mark.parametrize("scene", lg.scenes())
def test_every_scene_conforms(scene: str, tmp_path: Path) -> None:
    conforms(scene, tmp_path)


@needs_gxx
def test_the_commands_run_and_a_wrong_number_fails(tmp_path: Path) -> None:
    made = lg.scene("pendulum").export("cpp", tmp_path)
    assert [run(command, tmp_path) for command in made.commands][-1] == "pendulum: 18 of 18 results are right\n"
    source = tmp_path / "pendulum.cpp"
    source.write_text(source.read_text().replace("out[1] = ", "out[1] = 1.00000000001 * ", 1))
    run(made.commands[0], tmp_path)
    done = subprocess.run(["./pendulum_test"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, "rhs, state 0, result 1:" in done.stdout) == (1, True)


@needs_gxx
def test_the_program_on_the_page_runs(tmp_path: Path) -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "export" / "cpp.md"
    program = page.read_text("utf-8").partition("```cpp\n")[2].partition("```")[0]
    (tmp_path / "program.cpp").write_text(program)
    system = lg.scene("double-pendulum")
    system.export("cpp", tmp_path, ["rhs", "energy", "dop853"])
    run(f"{COMPILE} -o program program.cpp double_pendulum.cpp", tmp_path)
    found = [float(one) for one in run("./program", tmp_path).split()]
    model = system.compile()
    ours = system.run(2.0, initial={"theta1": 1.0, "theta2": 0.5}, rtol=1e-12, parameters={"l2": 0.5}).y[:, -1]
    # The page asks for a tolerance of 1e-10, and two units of time multiply it by less than a hundred.
    energy = model.energy(ours[:2], ours[2:], parameters={"l2": 0.5})
    assert found == pytest.approx([*ours[:2], energy], abs=1e-8)
