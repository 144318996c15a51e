"""The programs on the pages of Fortran, and of MATLAB and Octave, run and find our numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import lagrange as lg
from tests.export.callers import run, section

FILES = {"fortran": ("gfortran", "program.f90"), "octave": ("octave-cli", "program.m")}
CASES = [
    pytest.param(name, marks=pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed"))
    for name, (tool, _) in FILES.items()
]


@pytest.mark.parametrize("target", CASES)
def test_the_program_on_the_page_runs(target: str, tmp_path: Path) -> None:
    page = section(target.capitalize())
    program, _, behind = page.partition(f"```{target}\n")[2].partition("```")
    (tmp_path / FILES[target][1]).write_text(program)
    system = lg.scene("double-pendulum")
    system.export(target, tmp_path, ["rhs", "energy"])
    printed = run(behind.partition("```sh\n")[2].partition("\n")[0], tmp_path)
    if target == "fortran":
        printed += run("./program", tmp_path)
    found = [float(one) for one in printed.split()]
    model = system.compile()
    ours = system.run(2.0, initial={"theta1": 1.0, "theta2": 0.5}, rtol=1e-12, parameters={"l2": 0.5}).y[:, -1]
    q, v, changed = [1.0, 0.5], [0.0, 0.0], {"l2": 0.5}
    expected = [*model.accelerations(q, v, parameters=changed), model.energy(q, v, parameters=changed)]
    assert found[:3] == pytest.approx(expected, abs=1e-11)  # twelve decimals are printed
    # ode45 has a relative tolerance of 1e-8, and five digits are printed.
    assert found[3:] == pytest.approx(ours[: len(found) - 3], abs=1e-5)


@pytest.mark.parametrize("target", ["fortran", "octave", "julia"])
def test_the_commands_on_the_page_are_those_of_the_target(target: str, tmp_path: Path) -> None:
    page = section(target.capitalize())
    made = lg.scene("double-pendulum").export(target, tmp_path, ["rhs"])
    assert " && ".join(made.commands) in page
