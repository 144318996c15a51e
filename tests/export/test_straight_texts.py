"""Features of single languages without loops."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from lagrange.export.elimination import ROWS, factored, solved
from tests.export.callers import LANGUAGES, missing, named, run, section
from tests.export.test_modules import coupled

TEXTS = {
    "fortran": (
        "  pure subroutine energy(t, y, p, out, singular)\n    ! The energy v.p - L, which is T + V where T is",
    ),
    "julia": (
        '"""\n    energy!(out, t, y, p)\n\nThe energy v.p - L, which is T + V where T is quadratic in the velocities.',
        '    length(y) < 2 && throw(DimensionMismatch("y has fewer than 2 numbers"))\n',
    ),
    "rust": (
        "pub fn energy(t: f64, y: &[f64], p: &[f64], out: &mut [f64]) -> bool {\n    let (y, p, out) = (&y[..STATE], ",
    ),
    "modelica": (
        "    Real theta(start = 2.0, fixed = true);\n    Real theta_dot(start = 0.0, fixed = true);\n",
        "    parameter Real p[6] = Functions.prepare({m, g, l});\n",
        "    rates = Functions.rhs(time, {theta, theta_dot}, p);\n    der(theta) = rates[1];\n",
        "    energy = Functions.energy(time, {theta, theta_dot}, p);\n    annotation(experiment(StopTime = 10.0,",
    ),
}
"""Text on which no result of a function depends: comments, checks of sizes, the Modelica model of a pendulum."""


@pytest.mark.parametrize("target", TEXTS)
def test_text_that_no_result_shows(target: str, tmp_path: Path) -> None:
    text = lg.scene("pendulum").export(target, tmp_path, ["energy"]).files[0].read_text()
    assert [part for part in TEXTS[target] if f"\n{part}" not in text] == []


@pytest.mark.parametrize("name", ["test", "random", "dict", "base", "sin"])
def test_no_julia_module_has_the_name_of_one_of_the_library(name: str, tmp_path: Path) -> None:
    x = lg.coordinate("x")
    lg.System(kinetic=x.dot**2 / 2, potential=x**2, name=name).export("julia", tmp_path, ["rhs"])
    own = f"{name.capitalize()}_2" if name != "sin" else "Sin"  # sin is a function, and Sin nothing
    assert f"\nmodule {own}\n" in (tmp_path / f"{name}.jl").read_text()
    assert f"{own}.rhs!,\n" in (tmp_path / f"{name}_test.jl").read_text()


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="octave-cli is not installed")
def test_results_in_octave_are_nan_where_a_matrix_is_singular(tmp_path: Path) -> None:
    coupled().export("octave", tmp_path, ["rhs"])
    p = "p = coupled_prepare(coupled_default_parameters());"
    program = f"{p} disp(isnan(coupled_rhs(0, [0; 0; 0.5; 0.1], p).')); disp(isnan(coupled_rhs(0, [1 0 0 1], p).'));"
    said = run(f'octave-cli --quiet --no-history --eval "{program}"', tmp_path)
    assert said.split() == ["1"] * 4 + ["0"] * 4


def test_names_of_functions_of_octave_have_63_letters_at_most(tmp_path: Path) -> None:
    made = named(["x"], ["k"], "a" * 64).export("octave", tmp_path, ["rhs", "jacobian"])
    assert max(len(path.stem) for path in made.files) == 63
    assert len({path.stem for path in made.files}) == len(made.files)


@pytest.mark.slow
def test_large_local_arrays_of_fortran_are_no_static_ones(tmp_path: Path) -> None:
    for count, word in ((2, "pure subroutine rhs("), (65, "pure recursive subroutine rhs(")):
        q = [lg.coordinate(f"q{k}") for k in range(count)]
        kinetic = sum(a.dot**2 for a in q) + sum(a.dot for a in q) ** 2 / 2
        lg.System(kinetic, sum(a**2 for a in q), name="many").export("fortran", tmp_path, ["rhs"])
        assert word in (tmp_path / "many.f90").read_text()


@pytest.mark.parametrize(("target", "text"), [("rust", "let _ = p;"), ("fortran", "unused1 => p(1)")])
def test_without_parameters_compilers_do_not_warn(target: str, text: str, tmp_path: Path) -> None:
    file, *_ = lg.scene("henon-heiles").export(target, tmp_path, ["rhs"]).files
    assert text in file.read_text().partition("prepare(parameters")[2].partition("rhs(")[0]
    for command in LANGUAGES[target].strict if not missing(target) else ():
        run(command.format(module=file.stem), tmp_path)


# --- linear systems


@pytest.mark.parametrize("kind", ["definite", "indefinite", "nothing on the diagonal"])
def test_every_regular_matrix_is_solved(kind: str) -> None:
    """Random systems whose units differ by 1e8 are solved with an error of some roundings for each unknown."""
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 5, 8) * 4:
        matrix = rng.normal(size=(n, n))
        matrix = matrix @ matrix.T + np.eye(n) if kind == "definite" else matrix + matrix.T
        if kind.startswith("nothing"):
            matrix -= np.diag(np.diagonal(matrix)) * (n > 1)
        units = 10.0 ** rng.integers(-4, 5, size=n)
        expected, scaled = rng.normal(size=n) / units, units[:, None] * matrix * units
        a, x = np.zeros((n + ROWS, n)), np.zeros(n)
        a[:n] = np.tril(scaled)
        assert not factored(n, a)
        solved(n, a, scaled @ expected, x)
        off = 1e-14 * np.linalg.cond(matrix) * n
        assert x * units == pytest.approx(expected * units, rel=off, abs=off)


@pytest.mark.parametrize("entries", [[0.0], [1.0, 1.0, 1.0], [0.0] * 6, [1.0, 2.0, 4.0, 3.0, 6.0, 9.0]])
def test_a_singular_matrix_is_recognized(entries: list[float]) -> None:
    n = {1: 1, 3: 2, 6: 3}[len(entries)]
    for value, expected in ((1.0, True), (np.nan, False)):
        a = np.zeros((n + ROWS, n))
        a[np.tril_indices(n)] = np.multiply(entries, value)
        with np.errstate(all="ignore"):
            assert factored(n, a) == expected


def test_the_commands_on_the_page_of_julia_are_those_of_the_target(tmp_path: Path) -> None:
    made = lg.scene("double-pendulum").export("julia", tmp_path, ["rhs"])
    assert " && ".join(made.commands) in section("Julia")
