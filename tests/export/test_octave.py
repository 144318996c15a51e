"""What MATLAB and Octave have that other languages do not: a file for each function, and arrays that are values."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import lagrange as lg
from lagrange.errors import LagrangeError
from lagrange.export.languages.octave import Names, function
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Callee
from tests.export.callers import Call, called, run, write
from tests.export.graphs import as_module, graph
from tests.export.systems import named
from tests.export.test_fortran import large
from tests.export.test_modules import coupled

needs_octave = pytest.mark.skipif(shutil.which("octave-cli") is None, reason="octave-cli is not installed")

HEAD = """\
function [out, singular] = pendulum_energy(~, y, p)
% [out, singular] = pendulum_energy(t, y, p)
% The energy v.p - L, which is T + V where T is quadratic in the velocities. out: energy.
% y(1) theta, y(2) theta_dot
% singular is true where a matrix is singular to round-off: out is NaN then.
%
% pendulum: equations of motion, made by lagrange
"""
BODY = """\
    out = zeros(1, 1);
    m = p(1);
    theta = y(1);
    theta_dot = y(2);
    x14 = p(4) * (theta_dot * theta_dot);
    out(1) = m * (x14 - (p(5) * cos(theta) + 0.5 * x14));
    singular = false;
end
"""


def test_the_text_of_the_pendulum(tmp_path: Path) -> None:
    made = lg.scene("pendulum").export("octave", tmp_path, ["rhs"])
    names = ["default_parameters", "prepare", "rhs", "test"]
    assert [path.name for path in made.files] == [f"pendulum_{name}.m" for name in names]
    lg.scene("pendulum").export("octave", tmp_path, ["energy"])
    text = (tmp_path / "pendulum_energy.m").read_text()
    assert text.startswith(HEAD)
    assert text.endswith(BODY)


@needs_octave
def test_results_are_nan_where_a_matrix_is_singular(tmp_path: Path) -> None:
    coupled().export("octave", tmp_path, ["rhs"])
    p = "p = coupled_prepare(coupled_default_parameters());"
    program = f"{p} disp(isnan(coupled_rhs(0, [0; 0; 0.5; 0.1], p).')); disp(isnan(coupled_rhs(0, [1 0 0 1], p).'));"
    said = run(f'octave-cli --quiet --no-history --eval "{program}"', tmp_path)
    assert said.split() == ["1"] * 4 + ["0"] * 4


@needs_octave
def test_parts_of_arrays_begin_at_places_that_are_computed(tmp_path: Path) -> None:
    file = write("octave", as_module([graph(0)], [large()]), tmp_path)
    _, found = called("octave", file, [Call("large", 0.0, [0.5, 2.0, 0.0, 0.0], 1)])
    flat = [0.5 * i + j for i in range(100) for j in range(100)]
    assert found.values == [sum(flat[i * 99 + 1 + 99 - i] * 2.0 for i in range(100))]


def test_names_of_functions_have_63_letters_at_most(tmp_path: Path) -> None:
    made = named(["x"], ["k"], "a" * 64).export("octave", tmp_path, ["rhs", "jacobian"])
    assert max(len(path.stem) for path in made.files) == 63
    assert len({path.stem for path in made.files}) == len(made.files)


def test_what_has_no_form_where_arrays_are_values_is_refused() -> None:
    p = Builder("swap", "Exchange two numbers.")
    a, b = p.array("a", size=1), p.array("b", size=1)
    first, second = a[0], b[0]
    a[0], b[0] = second, first
    swap = p.finish()
    p = Builder("twice", "Exchange two parts of one array.")
    both = p.array("both", size=2)
    p.call(swap, p.part(both, 0), p.part(both, 1))
    twice = p.finish()
    with pytest.raises(LagrangeError, match="twice gives two parts of one array to a function that writes both"):
        function(twice, Names({}))
    p = Builder("caller", "Call what is given.")
    p.function("law", Callee((REAL,), ()))(p.given("x", REAL))
    caller = p.finish()
    with pytest.raises(LagrangeError, match="caller calls a function that is given, which has no name"):
        function(caller, Names({}))
