"""Names of values in exported files say what a value is, and differ in the letters that a language distinguishes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import sympy

import lagrange as lg
from lagrange.evidence.precise_run import evaluate
from lagrange.export.contents import names_of
from lagrange.export.straight_line import with_outputs
from lagrange.export.target import find, target_names
from tests.export.systems import named


def test_names_that_differ_beyond_63_letters_stay_different(tmp_path: Path) -> None:
    long = "a" * 63
    system = named([long, f"{long}b", f"{'c' * 62}1", f"{'c' * 62}12"], ["x8", "x9", f"{long}d"])
    system.export("c", tmp_path, ["rhs", "energy"])
    text = (tmp_path / "named.c").read_text()
    body = text.partition("int named_rhs(")[2].partition("\n}\n")[0]
    defined = re.findall(r"const double (\w+) =", body)
    assert len({name[:63] for name in defined}) == len(defined) >= 8
    assert max(map(len, defined)) == 63


@pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not installed")
def test_constants_of_headers_are_renamed(tmp_path: Path) -> None:
    """Compilers define more than the standard of C asks for unless they are told not to."""
    system = named(["M_PI", "SIZE_MAX"], ["M_E", "SEEK_SET", "RAND_MAX", "INT8_MAX", "MAXFLOAT"])
    system.export("c", tmp_path, ["rhs", "energy"])
    command = ["cc", "-std=gnu99", "-Wall", "-Werror", "-fsyntax-only", "named.c", "named_test.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


ENTRIES = {
    "double-pendulum": {"mass_theta1_theta1", "mass_theta1_theta2", "mass_theta2_theta2"},
    "four-bar": {
        *("mass_theta1_theta1", "mass_theta1_theta2", "mass_theta2_theta2", "mass_theta3_theta3"),
        *(f"gradient_{one}_theta{k}" for one in "xy" for k in (1, 2, 3)),
    },
}
"""The entries of the matrix that gives the accelerations, which are not zero, by scene."""


@pytest.mark.parametrize("target", [name for name in target_names() if name not in ("fmu", "octave")])
@pytest.mark.parametrize("scene", ENTRIES)
def test_entries_of_the_matrix_are_named(scene: str, target: str, tmp_path: Path) -> None:
    files = lg.scene(scene).export(target, tmp_path, None if find(target).always else ["rhs"]).files
    text = files[1 if target == "c" else 0].read_text()
    assert set(re.findall(r"\b((?:mass|gradient)_\w+)(?:: f64)? :?= ", text)) == ENTRIES[scene]


@pytest.mark.parametrize("scene", ENTRIES)
def test_named_entries_are_those_of_the_equations(scene: str) -> None:
    """The mass matrix is the second derivative of T, and gradients are derivatives of constraints, by SymPy."""
    system = lg.scene(scene)
    statement, model = system.statement, system.compile("numpy")
    program = model.law("rhs").program
    named = {ref: name for ref, name in names_of(model).of(program).items() if name in ENTRIES[scene]}
    state, values = statement.initial, model.parameter_array(None).tolist()
    found = evaluate(with_outputs(program, program.instructions, tuple(named)), 0.0, state, values)
    at = {**dict(zip(statement.parameters, values, strict=True)), sympy.Symbol("t"): 0.0}
    at |= dict(zip((*statement.velocities, *statement.coordinates), (*state[len(state) // 2 :], *state), strict=False))
    every = dict(zip(statement.names, zip(statement.coordinates, statement.velocities, strict=True), strict=True))
    for name, value in zip(named.values(), found, strict=True):
        kind, a, b = name.split("_")
        if kind == "mass":
            exact = sympy.diff(statement.kinetic, every[a][1], every[b][1])
        else:
            (constraint,) = (one.expression for one in statement.constraints if one.name == a)
            exact = sympy.diff(constraint, every[b][0])
        assert float(value) == pytest.approx(float(exact.subs(at)), rel=1e-12), name
