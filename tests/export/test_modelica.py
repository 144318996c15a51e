"""Exported Modelica is read by a grammar of ours, which runs its functions and its test, without OpenModelica."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.languages.modelica import LANGUAGE, function_lines
from lagrange.export.straight_line import Functions
from tests.covering import Share
from tests.export.graphs import as_module, graph, points, wrong
from tests.export.modelica_reader import Failed, Machine
from tests.export.systems import every_scene, held, named
from tests.export.test_modules import coupled, on_a_sphere

CONTENTS = ("rhs", "energy", "jacobian", "mass_matrix", "momenta", "accelerations")


def exported(system: lg.System, folder: Path, *contents: str) -> Machine:
    *packages, script = system.export("modelica", folder, contents or None).files
    texts = [package.read_text() for package in packages]
    for package, text in zip(packages, texts, strict=True):
        assert text.isascii() and text.endswith(";\n")
        assert all(len(line) <= 130 or line.lstrip().startswith("//") for line in text.splitlines())
        assert f'loadFile("{package.name}");' in script.read_text()
    return Machine(*texts)


@pytest.mark.parametrize("scene", every_scene("double-pendulum", "cartesian-pendulum"))
def test_a_scene_conforms(scene: str, tmp_path: Path) -> None:
    """Run the test in the file, and ten steps with its right-hand side; its model has the initial state."""
    system = lg.scene(scene)
    statement = system.statement
    machine = exported(system, tmp_path, *CONTENTS, *held(system))
    tests = [name for name in machine.reader.functions if name.startswith("test_")]
    assert len(tests) == len(CONTENTS) + len(held(system))
    assert [machine.call(name) for name in tests] == [0] * len(tests), machine.warnings[:5]
    motion = machine.reader.models["Motion"]
    n = len(statement.initial)
    assert [left[1] for left, _ in motion["equations"][1 : n + 1]] == ["der"] * n
    model = system.compile()
    p = machine.call("Functions.prepare", model.parameter_array(None))
    y, h = np.array(statement.initial, float), min(1.0, statement.run.t_end) / 1000
    ours = system.run(10 * h, method="rk4", step=h).y[:, -1]

    def rates(t: float, y: Any) -> Any:
        return machine.call("Functions.rhs", t, y, p)

    for k in range(10):
        a = rates(k * h, y)
        b = rates((k + 0.5) * h, y + h / 2 * a)
        c = rates((k + 0.5) * h, y + h / 2 * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + rates((k + 1) * h, y + h * c))
    # A constrained run is projected after each step, by what a step of order 4 leaves: far below this.
    assert y == pytest.approx(ours, rel=1e-9, abs=1e-9)


def test_a_wrong_number_fails_the_self_test(tmp_path: Path) -> None:
    lg.scene("pendulum").export("modelica", tmp_path)
    text, test = ((tmp_path / f"pendulum{end}.mo").read_text() for end in ("", "_test"))
    right, off = Machine(text, test), Machine(text.replace("out[2] := ", "out[2] := 1.00000000001 * ", 1), test)
    (condition, body) = off.reader.models["Test"]["equations"]
    assert condition == ("call", "initial", [])
    right.run(body, {".": "", "failures": None})
    with pytest.raises(Failed, match="6 results are wrong"):
        off.run(body, {".": "", "failures": None})
    assert off.warnings[0].startswith("rhs, state 1, result 2: ") and len(off.warnings) == 6


def test_random_graphs(share: Share) -> None:
    programs = [graph(seed) for seed in range(share(60))]
    module = as_module(programs)
    lines = function_lines(Functions(module, LANGUAGE, statuses=False))
    machine = Machine("\n".join(["package graphs", *lines, "end graphs;"]))
    p = machine.call("Functions.prepare", np.zeros(0))
    for k, one in enumerate(programs):
        for y in points(k, 6):
            found = [float(value) for value in machine.call(f"Functions.{one.name}", 0.0, np.array(y), p)]
            assert list(wrong(one, y, found)) == []


AWKWARD = (
    *("der", "time", "x0", "lam1", "θ", "Real", "a" * 63, "a" * 64, "m", "M", "p", "rates", "Motion", "equation"),
    *("start", "model", "end", "sinus", "Functions", "rhs", "energy", "initial", "input", "fixed", "unit", "algorithm"),
    *(
        "parameter",
        "protected",
        "noEvent",
        "pre",
        "t1",
        "y",
        "out",
        "integer",
        "type",
        "within",
        "Clock",
        "flow",
        "div",
    ),
)


def test_awkward_names(tmp_path: Path) -> None:
    machine = exported(named(AWKWARD[:8], AWKWARD[8:], "package"), tmp_path, "energy")
    assert [machine.call(f"test_{name}") for name in ("rhs", "energy")] == [0, 0]
    declared = [name for _, name, _, _ in machine.reader.models["Motion"]["declared"]]
    assert len(set(declared)) == len(declared) == 2 * 8 + len(AWKWARD) - 8 + 3
    assert {"der_2", "time_2", "theta", "x0", "model_2", "rhs", "energy", "energy_2", "p_2", "p"} <= set(declared)


@pytest.mark.parametrize("stated", [coupled, on_a_sphere])
def test_a_singular_matrix_is_an_assertion(stated: Callable[[], lg.System], tmp_path: Path) -> None:
    system = stated()
    machine = exported(system, tmp_path, "jacobian")
    p = machine.call("Functions.prepare", np.array([1.0, 2.0]))
    good = np.array([1.0, 0.0, 0.0, 0.5])
    assert machine.call("Functions.rhs", 0.0, good, p)[2:] == pytest.approx(
        system.compile().accelerations(good[:2], good[2:]), rel=1e-14
    )
    for name in ("rhs", "jacobian"):
        with pytest.raises(Failed, match="a matrix is singular to round-off"):
            machine.call(f"Functions.{name}", 0.0, np.array([0.0, 0.0, 0.5, 0.1]), p)


def test_a_grammar_of_another_reads_the_package(tmp_path: Path) -> None:
    parser: Any = pytest.importorskip("pymoca.parser", reason="pymoca is not installed")
    exported(lg.scene("cartesian-pendulum"), tmp_path, *CONTENTS, "multipliers")
    tree = parser.parse((tmp_path / "cartesian_pendulum.mo").read_text())
    assert set(tree.classes["cartesian_pendulum"].classes) >= {"Functions", "Motion"}


@pytest.mark.parametrize(
    "text", ["x := 1", "function f algorithm y = 1; end f;", "package a package b end b; end c;", "#"]
)
def test_what_is_no_modelica_is_not_read(text: str) -> None:
    with pytest.raises((ValueError, IndexError)):
        Machine(text)
