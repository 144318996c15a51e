"""The program on the page of C++ runs, and a name of the language is a namespace with a letter more."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import lagrange as lg
from tests.export.systems import named
from tests.export.test_c import run

COMPILE = "g++ -std=c++17 -O1 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wold-style-cast -Werror"

needs_gxx = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")


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


AWKWARD = (
    *("std", "xor", "State", "namespace", "operator", "template", "fabs", "Prepared", "smaller", "union", "signed"),
    *("double", "virtual", "printf", "int64_t", "NULL", "EOF", "Run", "Counts", "size_t", "default_parameters"),
)


@needs_gxx
def test_words_of_the_language_are_names_of_nothing(tmp_path: Path) -> None:
    system = named(AWKWARD[:6], AWKWARD[6:], "new")
    made = system.export("cpp", tmp_path, ["rhs", "energy", "rk4", "main"])
    assert "namespace lagrange::new_ {" in (tmp_path / "new.hpp").read_text()
    for macro in ("TEST", "MAIN"):
        run(f"{COMPILE} -DNEW_{macro} -o {macro} new.cpp", tmp_path)
    assert run("./TEST", tmp_path).endswith("results are right\n")
    head = run("./MAIN 1 1", tmp_path).splitlines()[0]
    assert head.startswith("t,std,xor,State,namespace,operator,template,std_dot,")
    assert len(made.files) == 2
